// The healing automaton, as docs/theory/automaton.md has it. Twin: src/cicatrix/healing/twin.py, same bits.
#pragma once

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <vector>

#include "team.hpp"

namespace cicatrix {

struct Rules {
    double p_edge, p_layer, feedback;
    int64_t layer_sites, substeps, min_free;
    bool level_set;
    uint32_t path_noise;  // path costs are drawn from 0 .. path_noise
    uint64_t seed;
};

// What one step did.
struct Counts {
    int64_t edge = 0, layer = 0, dropped = 0, clamped = 0;
};

// What this rank had to look at in the last step, and the memory that it holds.
struct Work {
    int64_t ranks = 0;  // that shared the step
    int64_t stored_tiles = 0, active_tiles = 0;  // of 32 sites
    int64_t mixed_sites = 0;                       // of tiles where the density is not everywhere the same
    int64_t edge_cells = 0, layer_cells = 0, shore_sites = 0;
    int64_t bytes = 0;
};

// Cells were lost or doubled: a fault of the program.
struct InvariantFault : std::runtime_error {
    using std::runtime_error::runtime_error;
};

class AutomatonCore {
   public:
    virtual ~AutomatonCore() = default;

    // One step under the cue W (one number, or one per site in C order) over W_ref. team: ranks that hold the same lattice and
    // do the step together, or null.
    virtual Counts advance(const double* W, bool per_site, double W_ref, Team* team) = 0;

    // Rows of bits, least significant first, one after the other without a gap between bytes.
    virtual void occupancy(uint8_t* rows) const = 0;

    virtual int64_t n_cells() const = 0;
    virtual int64_t n_open() const = 0;
    virtual int64_t step() const = 0;
    virtual Work work() const = 0;
};

// fillable, occupied: rows of bits as `occupancy` gives them. threads, tiles_per_piece (of work) >= 1; isa: "" for the best of this machine.
std::unique_ptr<AutomatonCore> make_automaton(const std::vector<int64_t>& shape, const uint8_t* fillable,
                                              const uint8_t* occupied, const Rules& rules, int64_t step, int threads,
                                              int64_t tiles_per_piece, const char* isa);

// Names of the instruction sets that this machine can run, the best one last.
std::vector<const char*> instruction_sets();

}  // namespace cicatrix

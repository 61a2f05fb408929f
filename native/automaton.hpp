// The healing automaton specified in docs/theory/automaton.md. NumPy reference implementation: src/cicatrix/healing/reference.py,
// bit-identical.
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
    uint32_t path_noise;  // largest random addition to the cost of a site: drawn from 0 .. path_noise
    uint64_t seed;
};

// Counts of one step: edge divisions, layer divisions, dropped divisions, clamped probabilities.
struct Counts {
    int64_t edge = 0, layer = 0, dropped = 0, clamped = 0;
};

// Work of this rank in the last step, and its memory.
struct Work {
    int64_t ranks = 0;  // number of ranks that shared the step
    int64_t stored_tiles = 0, active_tiles = 0;  // tiles of 32 sites
    int64_t mixed_sites = 0;                       // sites of tiles in which the density is not uniform
    int64_t edge_cells = 0, layer_cells = 0, shore_sites = 0;
    int64_t bytes = 0;
};

// Thrown if cells were lost or duplicated, which would be a bug in the program.
struct InvariantFault : std::runtime_error {
    using std::runtime_error::runtime_error;
};

class AutomatonCore {
   public:
    virtual ~AutomatonCore() = default;

    // Do one step with the cue W / W_ref; W is one number, or one per site in C order. team: ranks that hold the same lattice
    // and share the step, or null.
    virtual Counts advance(const double* W, bool per_site, double W_ref, Team* team) = 0;

    // Write the occupancy as rows of bits, least significant first; each row takes whole bytes, without gaps between rows.
    virtual void occupancy(uint8_t* rows) const = 0;

    virtual int64_t n_cells() const = 0;
    virtual int64_t n_open() const = 0;
    virtual int64_t step() const = 0;
    virtual Work work() const = 0;
};

// Make an automaton. fillable, occupied: rows of bits in the format of `occupancy`; threads, tiles_per_piece (smallest piece of
// work) >= 1; isa: instruction set, "" for the best one of this machine.
std::unique_ptr<AutomatonCore> make_automaton(const std::vector<int64_t>& shape, const uint8_t* fillable,
                                              const uint8_t* occupied, const Rules& rules, int64_t step, int threads,
                                              int64_t tiles_per_piece, const char* isa);

// Names of the instruction sets that this machine can run, the best one last.
std::vector<const char*> instruction_sets();

}  // namespace cicatrix

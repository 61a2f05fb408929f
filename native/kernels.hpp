// The inner loops of the automaton, compiled once per instruction set; kernels.cpp holds them, automaton.cpp calls them.
//
// Sites are kept in blocks of 32 along the last axis. A stored block has a number (id); what lies beside it in its own row is
// id - 1 and id + 1, what lies beside it in row offset k is beside[k][id]. Numbers per site lie at id * 32 + lane.
#pragma once

#include <cstddef>
#include <cstdint>

namespace cicatrix {

constexpr int kLanes = 32;
constexpr int kMaxRows = 7;
constexpr uint16_t kFar = 65535;     // no path
constexpr uint16_t kNoPath = 65520;  // costs from here on belong to sites that no path leads through

struct Direction {
    int row;   // row offset, an index into kRows
    int lane;  // shift along the last axis
};

// Root lattices A2 and A3 in axial storage: neighbours in the order of the specification, and the rows they lie in.
template <int D>
struct Geometry;

template <>
struct Geometry<2> {
    static constexpr int rows = 3, directions = 6;
    static constexpr int row[rows][2] = {{0, 0}, {1, 0}, {-1, 0}};
    static constexpr Direction neighbour[directions] = {{1, 0}, {2, 0}, {0, 1}, {0, -1}, {1, -1}, {2, 1}};
    static constexpr uint16_t bulk = 8191, own = 2;
    static constexpr int shift = 3;
};

template <>
struct Geometry<3> {
    static constexpr int rows = 7, directions = 12;
    static constexpr int row[rows][2] = {{0, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, -1}, {-1, 1}};
    static constexpr Direction neighbour[directions] = {{1, 0},  {2, 0},  {3, 0}, {4, 0},  {0, 1}, {0, -1},
                                                        {5, 0},  {1, -1}, {6, 0}, {3, -1}, {2, 1}, {4, 1}};
    static constexpr uint16_t bulk = 4095, own = 4;
    static constexpr int shift = 4;
};

struct Ids {
    const int32_t* first;
    size_t count;
};

// What names a random word beside the site: counter and key of the generator; first_site[id] is the number of lane 0.
struct Draw {
    const int64_t* first_site;
    uint32_t step, phase, key[2];
};

using Beside = const int32_t* const*;

struct Kernels {
    const char* name;

    // Four words for each counter (group, step, phase) under the key.
    void (*philox)(const uint64_t* group, size_t n, uint32_t step, uint32_t phase, const uint32_t* key, uint32_t* out);
    // Sites of `mask` whose random word is below a limit (2^32: all). One call of the generator serves four sites.
    void (*draw)(Ids ids, Draw draw, const uint32_t* mask, uint64_t limit, uint32_t* hit);
    // base + floor(word n / 2^32) at the sites of `mask`, 1 <= n < 65536.
    void (*random_values)(Ids ids, Draw draw, const uint32_t* mask, uint16_t base, uint32_t n, uint16_t* out);
    // How many bits are set.
    int64_t (*count_bits)(Ids ids, const uint32_t* bits);
    // Density of undisturbed sites: bulk where a bit is set, else 0.
    void (*expand)(Ids ids, const uint32_t* bits, uint16_t bulk, uint16_t* u);
    // Sites with U > level and with U == level, as bits.
    void (*compare)(Ids ids, const uint16_t* u, uint16_t level, uint32_t* above, uint32_t* equal);
    // How many lanes have U >= level.
    int64_t (*count_from)(Ids ids, const uint16_t* u, uint16_t level);
    // Blocks whose lanes are not all equal; returns how many, and counts those that are all bulk.
    size_t (*mixed)(Ids ids, const uint16_t* u, uint16_t bulk, int32_t* out, int64_t* n_bulk);

    struct ByDimension {
        // The first sub-step, straight from the bits.
        void (*start)(Ids ids, Beside beside, const uint8_t* plain, const uint16_t* own, const uint32_t* fillable,
                      const uint32_t* bits, uint16_t* out);
        // One sub-step of the integer diffusion; where plain[id] is 0, own weights and the mask of fillable sites are used.
        void (*diffuse)(Ids ids, Beside beside, const uint8_t* plain, const uint16_t* own, const uint32_t* fillable,
                        const uint16_t* u, uint16_t* out);
        // Own weights: own + missing neighbours.
        void (*weigh)(Ids ids, Beside beside, const uint8_t* plain, const uint32_t* fillable, uint16_t* own);
        // Bits of `mask` with a neighbour in `bits`, and bits of `bits` with a neighbour that is not in it.
        void (*touching)(Ids ids, Beside beside, const uint32_t* mask, const uint32_t* bits, uint32_t* out);
        void (*border)(Ids ids, Beside beside, const uint32_t* bits, uint32_t* out);
        // d = unit * (number of neighbours in `bits`) + extra - kNoPath at the sites of `mask`.
        void (*price)(Ids ids, Beside beside, const uint32_t* bits, const uint32_t* mask, uint16_t unit,
                      const uint16_t* extra, uint16_t* d);
        // Bits that are set or have a neighbour set.
        void (*dilate)(Ids ids, Beside beside, const uint32_t* bits, uint32_t* out);
        // d = min(d, cost + least neighbour), in place, until nothing changes within these blocks; true if anything did.
        bool (*relax)(Ids ids, Beside beside, const uint16_t* cost, uint16_t* d, uint8_t* dirty);
    } dimension[2];
};

const Kernels& kernels_portable();
#ifdef CICATRIX_X86
const Kernels& kernels_v2();
const Kernels& kernels_v3();
const Kernels& kernels_v4();
#endif

}  // namespace cicatrix

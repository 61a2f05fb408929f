// The inner loops of the automaton, compiled once per instruction set; kernels.cpp holds them, automaton.cpp calls them.
//
// Sites are kept in tiles of 32: four lines of eight sites along the last axis, 4 x 8 in 2-D and 2 x 2 x 8 in 3-D. A stored tile
// has a number (id); what lies beside it in its own row of tiles is id - 1 and id + 1, what lies beside it in row offset k is
// beside[k][id]. Numbers per site lie at id * 32 + lane, lane = 8 * line + place; bit number lane of a word is that site too.
#pragma once

#include <cstddef>
#include <cstdint>

namespace cicatrix {

constexpr int kLanes = 32;
constexpr int kMaxRows = 7;
constexpr uint16_t kFar = 65535;     // no path
// costs from here on belong to sites that no path leads through: a free site keeps its settling draw there. Where such a sum does not
// saturate the distance is 65520 or more, and with the cost of any hop it does.
constexpr uint16_t kNoPath = 65520;

// A step to a neighbour: along the first axis, the second (3-D) and the last.
struct Direction {
    int first, second, last;
};

// Root lattices A2 and A3 in axial storage: neighbours in the order of the specification, and the rows of tiles they lie in.
template <int D>
struct Geometry;

template <>
struct Geometry<2> {
    static constexpr int rows = 3, directions = 6;
    static constexpr int height = 4, depth = 1;  // lines of a tile along the first and the second axis
    static constexpr int row[rows][2] = {{0, 0}, {1, 0}, {-1, 0}};
    static constexpr Direction neighbour[directions] = {{1, 0, 0},  {-1, 0, 0}, {0, 0, 1},
                                                        {0, 0, -1}, {1, 0, -1}, {-1, 0, 1}};
    static constexpr uint16_t bulk = 8191, own = 2;
    static constexpr int shift = 3;
};

template <>
struct Geometry<3> {
    static constexpr int rows = 7, directions = 12;
    static constexpr int height = 2, depth = 2;
    static constexpr int row[rows][2] = {{0, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, -1}, {-1, 1}};
    static constexpr Direction neighbour[directions] = {{1, 0, 0},  {-1, 0, 0}, {0, 1, 0},  {0, -1, 0},
                                                        {0, 0, 1},  {0, 0, -1}, {1, -1, 0}, {1, 0, -1},
                                                        {-1, 1, 0}, {0, 1, -1}, {-1, 0, 1}, {0, -1, 1}};
    static constexpr uint16_t bulk = 4095, own = 4;
    static constexpr int shift = 4;
};

constexpr int kLines = 4, kPlaces = 8;  // of a tile

// Which lanes of a tile the tile beside it sees, by row offset and right.
template <int D>
struct Seen {
    uint32_t by[Geometry<D>::rows][3] = {};

    constexpr Seen() {
        using G = Geometry<D>;
        for (int lane = 0; lane < kLanes; ++lane)
            for (const Direction& d : G::neighbour) {
                const int i = lane / kPlaces / G::depth + d.first, j = lane / kPlaces % G::depth + d.second;
                const int right = tile_of(lane % kPlaces + d.last, kPlaces);
                for (int k = 0; k < G::rows; ++k)
                    if (G::row[k][0] == tile_of(i, G::height) && G::row[k][1] == tile_of(j, G::depth))
                        by[k][right + 1] |= 1u << lane;
            }
        by[0][1] = 0;
    }

    static constexpr int tile_of(int x, int size) { return x < 0 ? -1 : x >= size; }
};

struct Ids {
    const int32_t* first;
    size_t count;
};

// What names a random word beside the site: counter and key of the generator; the first site of a line of a tile has the
// number first_site[id] + line[..].
struct Draw {
    const int64_t* first_site;
    int64_t line[kLines];
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
    // Sites with U > high, and with low <= U <= high, as bits; returns how many tiles are not everywhere the same.
    int64_t (*sift)(Ids ids, const uint16_t* u, uint16_t low, uint16_t high, uint32_t* above, uint32_t* within);

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
        // d = min(d, cost + least neighbour), in place, until nothing changes within these tiles; true if anything did.
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

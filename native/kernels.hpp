// The inner loops of the automaton, compiled once per instruction set; kernels.cpp holds them, automaton.cpp calls them.
//
// Sites are stored in tiles of 32: four lines of eight sites along the last axis, 4 x 8 in 2-D and 2 x 2 x 8 in 3-D. A stored
// tile has a number (id); its neighbours in the same row of tiles are id - 1 and id + 1, its neighbour at row offset k is
// beside[k][id]. Values per site lie at id * 32 + lane, lane = 8 * line + place; bits per site are bit `lane` of a 32-bit word.
#pragma once

#include <cstddef>
#include <cstdint>

namespace cicatrix {

constexpr int kLanes = 32;
constexpr int kMaxRows = 7;
constexpr uint16_t kFar = 65535;     // distance of a site without a path
// Costs from here on belong to sites that paths cannot pass: a free site stores its random settling cost there. A distance that
// includes such a cost is at least 65520, so that any further hop saturates it.
constexpr uint16_t kNoPath = 65520;

// A step to a neighbour: along the first axis, the second (3-D) and the last.
struct Direction {
    int first, second, last;
};

// Root lattices A2 and A3 in axial storage: neighbours in the order of docs/theory/automaton.md, and their rows of tiles.
template <int D>
struct Geometry;

template <>
struct Geometry<2> {
    static constexpr int rows = 3, directions = 6;
    static constexpr int height = 4, depth = 1;  // number of lines of a tile along the first and the second axis
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

constexpr int kLines = 4, kPlaces = 8;  // lines of a tile, and sites of a line

// Lanes of a tile that have a neighbour in the adjacent tile, by row offset and by tiles to the right (-1, 0, 1).
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

// Arguments of the random generator: site numbers (the first site of a line of a tile has number first_site[id] + line[..]),
// step, phase and key.
struct Draw {
    const int64_t* first_site;
    int64_t line[kLines];
    uint32_t step, phase, key[2];
};

using Beside = const int32_t* const*;

struct Kernels {
    const char* name;

    // Four random words for each counter (group, step, phase) under the key.
    void (*philox)(const uint64_t* group, size_t n, uint32_t step, uint32_t phase, const uint32_t* key, uint32_t* out);
    // Mark the sites of `mask` whose random word is below a limit (2^32: all). One call of the generator serves four sites.
    void (*draw)(Ids ids, Draw draw, const uint32_t* mask, uint64_t limit, uint32_t* hit);
    // Write base + floor(word n / 2^32) at the sites of `mask`, 1 <= n < 65536.
    void (*random_values)(Ids ids, Draw draw, const uint32_t* mask, uint16_t base, uint32_t n, uint16_t* out);
    // Return the number of set bits.
    int64_t (*count_bits)(Ids ids, const uint32_t* bits);
    // Write the density of undisturbed sites: bulk where a bit is set, else 0.
    void (*expand)(Ids ids, const uint32_t* bits, uint16_t bulk, uint16_t* u);
    // Mark the sites with U > high, and those with low <= U <= high; return the number of tiles in which U is not uniform.
    int64_t (*sift)(Ids ids, const uint16_t* u, uint16_t low, uint16_t high, uint32_t* above, uint32_t* within);

    struct ByDimension {
        // First sub-step of the integer diffusion, directly from the occupancy bits.
        void (*start)(Ids ids, Beside beside, const uint8_t* plain, const uint16_t* own, const uint32_t* fillable,
                      const uint32_t* bits, uint16_t* out);
        // One sub-step of the integer diffusion; if plain[id] is 0, it uses own weights and the mask of fillable sites.
        void (*diffuse)(Ids ids, Beside beside, const uint8_t* plain, const uint16_t* own, const uint32_t* fillable,
                        const uint16_t* u, uint16_t* out);
        // Weight of each site's own density: G::own plus the number of unfillable neighbours.
        void (*weigh)(Ids ids, Beside beside, const uint8_t* plain, const uint32_t* fillable, uint16_t* own);
        // Sites of `mask` with a neighbour in `bits` (touching), and sites of `bits` with a neighbour not in `bits` (border).
        void (*touching)(Ids ids, Beside beside, const uint32_t* mask, const uint32_t* bits, uint32_t* out);
        void (*border)(Ids ids, Beside beside, const uint32_t* bits, uint32_t* out);
        // d = unit * (number of neighbours in `bits`) + extra - kNoPath at the sites of `mask`.
        void (*price)(Ids ids, Beside beside, const uint32_t* bits, const uint32_t* mask, uint16_t unit,
                      const uint16_t* extra, uint16_t* d);
        // Sites that are set or have a neighbour that is set.
        void (*dilate)(Ids ids, Beside beside, const uint32_t* bits, uint32_t* out);
        // Iterate d = min(d, cost + smallest d of the neighbours) in place until these tiles converge; true if any d changed.
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

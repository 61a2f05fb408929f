// MPI ranks that share a step. Each stores all bits of the lattice, computes the tiles that it owns and a halo around them, and
// receives the changes in other tiles by messages.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

namespace cicatrix {

class Team {
   public:
    virtual ~Team() = default;
    virtual int rank() const = 0;
    virtual int size() const = 0;
    // Return the messages of all ranks, in rank order. Collective: every rank must call it.
    virtual std::vector<std::string> gather(const std::string& mine) = 0;
};

// Position of a site on the Morton curve; neighbouring sites mostly have similar positions.
inline uint64_t morton(uint64_t i, uint64_t j, uint64_t k) {
    auto spread = [](uint64_t x) {  // insert two zero bits after each of 21 bits
        x &= 0x1FFFFF;
        x = (x | x << 32) & 0x001F00000000FFFF;
        x = (x | x << 16) & 0x001F0000FF0000FF;
        x = (x | x << 8) & 0x100F00F00F00F00F;
        x = (x | x << 4) & 0x10C30C30C30C30C3;
        return (x | x << 2) & 0x1249249249249249;
    };
    return spread(i) << 2 | spread(j) << 1 | spread(k);
}

// Interval of the Morton curve.
struct Stretch {
    uint64_t first = 0, last = std::numeric_limits<uint64_t>::max();  // inclusive

    static Stretch none() { return {1, 0}; }
    bool has(uint64_t place) const { return first <= place && place <= last; }
};

// Interval number `part` of `parts` intervals that contain equally many of these positions.
inline Stretch stretch_of(std::vector<uint64_t> places, int part, int parts) {
    Stretch out;
    auto cut = [&](int n) {
        const auto at = places.begin() + static_cast<int64_t>(places.size()) * n / parts;
        std::nth_element(places.begin(), at, places.end());
        return *at;
    };
    if (part > 0) out.first = cut(part);
    if (part < parts - 1) out.last = cut(part + 1) - 1;
    return out;
}

}  // namespace cicatrix

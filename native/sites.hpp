// Sites of a band, probabilities as integer thresholds, and random words for lists of sites.
#pragma once

#include <cmath>
#include <cstdint>
#include <new>
#include <vector>

#include "kernels.hpp"

namespace cicatrix {

enum Phase : uint32_t { kEdgeDivision, kMotilityTie, kLayerDivision, kPathCost, kRedistributionTie, kSettle };

constexpr uint32_t kHopCost = 64, kSettleCost = 48;

// Thrown if the band is too narrow for the step to be exact; the step is then repeated in a wider band.
struct TooNarrow {};

inline uint32_t below(uint32_t word, uint64_t n) { return static_cast<uint32_t>((uint64_t{word} * n) >> 32); }

// Integer form of a probability: the event happens if word < threshold.
inline uint64_t threshold(double p) { return static_cast<uint64_t>(std::floor(p * 4294967296.0)); }

inline int popcount(uint32_t x) {  // in plain code, because baseline x86-64 has no instruction for it
    x -= x >> 1 & 0x55555555u;
    x = (x & 0x33333333u) + (x >> 2 & 0x33333333u);
    return static_cast<int>(((x + (x >> 4)) & 0x0F0F0F0Fu) * 0x01010101u >> 24);
}

using Site = uint32_t;  // id * 32 + lane

// Allocator of memory aligned to cache lines, so that no 64-byte tile crosses two of them.
template <class T>
struct LineAllocator {
    using value_type = T;
    static constexpr std::align_val_t line{64};

    LineAllocator() = default;
    template <class U>
    LineAllocator(const LineAllocator<U>&) {}
    T* allocate(size_t n) { return static_cast<T*>(::operator new(n * sizeof(T), line)); }
    void deallocate(T* p, size_t) { ::operator delete(p, line); }
    template <class U>
    bool operator==(const LineAllocator<U>&) const { return true; }
    template <class U>
    bool operator!=(const LineAllocator<U>&) const { return false; }
};

using Values = std::vector<uint16_t, LineAllocator<uint16_t>>;  // 32 values per tile

// One random word per site of a list; one call of the generator serves four sites.
class Words {
   public:
    void clear() { sites_.clear(), groups_.clear(), places_.clear(); }

    void add(Site site, uint64_t number) {
        const uint64_t group = number >> 2;
        if (groups_.empty() || groups_.back() != group) groups_.push_back(group);
        sites_.push_back(site);
        places_.push_back(static_cast<uint32_t>(4 * (groups_.size() - 1) + (number & 3)));
    }

    void draw(const Kernels& kernels, uint64_t step, Phase phase, const uint32_t* key) {
        words_.resize(4 * groups_.size());
        kernels.philox(groups_.data(), groups_.size(), static_cast<uint32_t>(step), phase, key, words_.data());
    }

    size_t size() const { return sites_.size(); }
    Site site(size_t i) const { return sites_[i]; }
    uint32_t word(size_t i) const { return words_[places_[i]]; }

   private:
    std::vector<Site> sites_;
    std::vector<uint64_t> groups_;
    std::vector<uint32_t> places_, words_;
};

}  // namespace cicatrix

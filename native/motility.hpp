// Motility: diffuse the cells in integers, then keep the level that holds as many.
#pragma once

#include <numeric>
#include <utility>
#include <vector>

#include "stage.hpp"

namespace cicatrix {

template <int D>
class Motility {
    using G = Geometry<D>;

   public:
    explicit Motility(Stage<D>& stage) : s_(stage) {}

    void move() {
        if (s_.rules.substeps == 0) return;
        const int64_t count = s_.count_bits(s_.band.core, s_.cells());
        if (count == 0) return;
        const uint16_t* u = diffuse();
        const auto [level, above, reached] = level_of(u, count);
        const bool keeps_all_bulk = level == G::bulk && reached == count;  // so do the cells beyond the band
        if (!s_.is_whole && !(0 < level && level < G::bulk) && !keeps_all_bulk) {
            s_.too_flat = true;
            throw TooNarrow();
        }
        keep_level(u, level, count - above);
    }

    // Integer density after all sub-steps, in the core of the band and right beside it.
    const uint16_t* diffuse() {
        const size_t n = kLanes * (s_.band.size() + 2);
        density_[0].resize(n), density_[1].resize(n);
        uint16_t* u[2] = {density_[0].data() + kLanes, density_[1].data() + kLanes};
        s_.pieces(s_.band.rim, [&](int, Ids ids) {
            s_.kernels.expand(ids, s_.cells(), G::bulk, u[0]);
            s_.kernels.expand(ids, s_.cells(), G::bulk, u[1]);
        });
        find_weights();
        auto sub_step = [&](int64_t i, Ids ids) {
            const uint16_t* own = own_.data() + kLanes;
            if (i == 0)
                s_.by.start(ids, s_.band.beside(), s_.plain(), own, s_.fill(), s_.cells(), u[1]);
            else
                s_.by.diffuse(ids, s_.band.beside(), s_.plain(), own, s_.fill(), u[i & 1], u[(i + 1) & 1]);
        };
        if (s_.pool.threads() == 1)
            in_waves(sub_step);
        else
            for (int64_t i = 0; i < s_.rules.substeps; ++i) s_.pieces(s_.band.core, [&](int, Ids ids) { sub_step(i, ids); });
        return u[s_.rules.substeps & 1];
    }

    int64_t bytes() const {
        return static_cast<int64_t>(2 * (density_[0].capacity() + density_[1].capacity() + own_.capacity()) +
                                    4 * (above_.capacity() + equal_.capacity()));
    }

   private:
    // All sub-steps while the planes they need are in the cache: plane p does sub-step i when plane p + 1 has done i - 1.
    template <class SubStep>
    void in_waves(SubStep&& sub_step) {
        const std::vector<size_t> cuts = s_.slabs(s_.band.core, kTilesPerWave, 1);
        const int64_t n = static_cast<int64_t>(cuts.size()) - 1;
        for (int64_t wave = 0; wave < n + s_.rules.substeps - 1; ++wave)
            for (int64_t i = std::max<int64_t>(0, wave - n + 1); i <= std::min(wave, s_.rules.substeps - 1); ++i) {
                const size_t first = cuts[wave - i], last = cuts[wave - i + 1];
                sub_step(i, Ids{s_.band.core.data() + first, last - first});
            }
    }

    // Tiles around which every site can be filled need no weights of their own.
    void find_weights() {
        if (s_.all_plain) return;
        own_.resize(kLanes * (s_.band.size() + 2));
        s_.pieces(s_.band.core, [&](int, Ids ids) {
            s_.by.weigh(ids, s_.band.beside(), s_.plain(), s_.fill(), own_.data() + kLanes);
        });
    }

    struct Level {
        uint16_t level;
        int64_t above, reached;  // sites above it, sites at it or above
    };

    // The level U0 that `count` fillable sites of the core reach: by bisection, first near the level of the last step.
    Level level_of(const uint16_t* u, int64_t count) {
        mixed_.resize(s_.band.core.size());
        int64_t n_bulk = 0;
        mixed_.resize(s_.kernels.mixed(Ids{s_.band.core.data(), s_.band.core.size()}, u, G::bulk, mixed_.data(), &n_bulk));
        s_.work.mixed_sites = kLanes * static_cast<int64_t>(mixed_.size());
        auto from = [&](uint32_t level) {
            std::vector<int64_t> parts(s_.most_pieces(), 0);
            s_.pieces(mixed_, [&](int i, Ids ids) { parts[i] = s_.kernels.count_from(ids, u, static_cast<uint16_t>(level)); });
            return std::accumulate(parts.begin(), parts.end(), kLanes * n_bulk);
        };
        uint32_t low = 0, high = G::bulk + 1;  // from(low) >= count > from(high)
        int64_t above = 0, reached = kLanes * static_cast<int64_t>(s_.band.core.size());
        auto ask = [&](uint32_t middle) {
            if (middle <= low || middle >= high) return;
            const int64_t n = from(middle);
            if (n >= count)
                low = middle, reached = n;
            else
                high = middle, above = n;
        };
        for (uint32_t far = 8; far < G::bulk && low + far < high; far *= 8)
            ask(last_level_ + far), ask(last_level_ - std::min(far, last_level_));
        while (high - low > 1) ask((low + high) / 2);
        last_level_ = low;
        return {static_cast<uint16_t>(low), above, reached};
    }

    // Cells sit where U > level, and at `wanted` of the sites at the level.
    void keep_level(const uint16_t* u, uint16_t level, int64_t wanted) {
        above_.resize(s_.band.size()), equal_.resize(s_.band.size());
        s_.pieces(s_.band.core, [&](int, Ids ids) { s_.kernels.compare(ids, u, level, above_.data(), equal_.data()); });
        s_.words.clear();
        for (int32_t id : s_.band.core) {
            s_.cells()[id] = above_[id] & s_.fill()[id];
            s_.free()[id] = s_.fill()[id] & ~s_.cells()[id];
            for (uint32_t left = equal_[id] & s_.fill()[id]; left; left &= left - 1)
                s_.add_word(static_cast<Site>(id) * kLanes + __builtin_ctz(left));
        }
        for (Site site : s_.first_of(kMotilityTie, wanted)) s_.settle_at(site);
    }

    static constexpr size_t kTilesPerWave = 64;  // some of them fit into the first cache, with all their sub-steps

    Stage<D>& s_;
    Values density_[2], own_;
    std::vector<int32_t> mixed_;
    std::vector<uint32_t> above_, equal_;
    uint32_t last_level_ = G::bulk / 2;
};

}  // namespace cicatrix

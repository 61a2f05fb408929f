// Motility: diffuse the occupancy in integer arithmetic, then threshold it so that the number of cells is conserved.
#pragma once

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
        const uint16_t* u = diffuse();
        const Level level = level_of(u);
        if (level.count == 0) return;
        const bool keeps_all_bulk = level.value == G::bulk && level.at == level.wanted;  // as cells outside the band do
        if (!s_.is_whole && !(0 < level.value && level.value < G::bulk) && !keeps_all_bulk) {
            s_.too_flat = true;
            throw TooNarrow();
        }
        keep_level(u, level);
    }

    // Return the integer density after all sub-steps, in the core of the band and its rim.
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
                                    4 * (above_.capacity() + within_.capacity()));
    }

   private:
    // Do all sub-steps while the slabs that they need are in the cache: slab p does sub-step i after slab p + 1 has done i - 1.
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

    // Compute the weight of each site's own density, unless all tiles are plain, whose weight is constant.
    void find_weights() {
        if (s_.all_plain) return;
        own_.resize(kLanes * (s_.band.size() + 2));
        s_.pieces(s_.band.core, [&](int, Ids ids) {
            s_.by.weigh(ids, s_.band.beside(), s_.plain(), s_.fill(), own_.data() + kLanes);
        });
    }

    struct Level {
        uint16_t value = 0;
        int64_t count = 0, at = 0, wanted = 0;  // number of cells; sites at this level, and how many of these get a cell
    };

    struct Window {
        int low, high;
    };

    // Return the level U0 that as many sites of the core reach as there are cells in it. The search starts in a window around
    // the last level, then covers all levels. above_ and within_ then mark the sites above the window and in it.
    Level level_of(const uint16_t* u) {
        above_.resize(s_.band.size()), within_.resize(s_.band.size());
        Level level;
        if (!find(u, {std::max(last_ - kAbout, 0), std::min<int>(last_ + kAbout, G::bulk)}, level)) find(u, {0, G::bulk}, level);
        last_ = level.value;
        return level;
    }

    // Search for the level in a window; return true if it lies there.
    bool find(const uint16_t* u, Window window, Level& level) {
        std::vector<int64_t> lanes = s_.sum([&] { return tally(u, window); });
        level.count = level.wanted = lanes.back();
        lanes.pop_back();
        for (size_t i = lanes.size(); i-- > 0; level.wanted -= lanes[i])
            if (lanes[i] >= level.wanted) {
                level.value = static_cast<uint16_t>(window.low + i), level.at = lanes[i];
                return window.low + i <= static_cast<size_t>(window.high) || level.count == 0;
            }
        return false;
    }

    // Count, in this rank's core, the sites at each density of the window, the sites above it, and the cells.
    std::vector<int64_t> tally(const uint16_t* u, Window window) {
        std::vector<std::vector<int64_t>> parts(s_.most_pieces());
        const size_t size = window.high - window.low + 1;
        s_.pieces(s_.band.own_core(), [&](int i, Ids ids) {
            parts[i].assign(size + 3, 0);
            int64_t* n = parts[i].data();
            n[size + 2] = s_.kernels.sift(ids, u, window.low, window.high, above_.data(), within_.data());
            for (size_t k = 0; k < ids.count; ++k) {
                const int32_t id = ids.first[k];
                const uint16_t* reached = u + kLanes * size_t(id);
                for (uint32_t left = within_[id]; left; left &= left - 1) ++n[reached[__builtin_ctz(left)] - window.low];
            }
            n[size] = s_.kernels.count_bits(ids, above_.data()), n[size + 1] = s_.kernels.count_bits(ids, s_.cells());
        });
        std::vector<int64_t> all(size + 3, 0);
        for (const auto& part : parts)
            for (size_t i = 0; i < part.size(); ++i) all[i] += part[i];
        s_.work.mixed_sites = kLanes * all.back();
        all.pop_back();
        return all;
    }

    // Put cells where U > level, and at the wanted number of the sites at the level.
    void keep_level(const uint16_t* u, const Level& level) {
        const bool takes_all = level.wanted == level.at;
        s_.words.clear();
        for (int32_t id : s_.band.own_core()) {
            uint32_t cells = above_[id], ties = 0;
            for (uint32_t left = within_[id]; left; left &= left - 1) {
                const uint16_t reached = u[kLanes * size_t(id) + __builtin_ctz(left)];
                if (reached == level.value) ties |= left & -left;
                if (reached > level.value) cells |= left & -left;
            }
            s_.set_cells(id, (takes_all ? cells | ties : cells) & s_.fill()[id]);
            if (!takes_all) s_.add_words(id, ties & s_.fill()[id]);
        }
        if (!takes_all) s_.settle_first(kMotilityTie, level.wanted);
    }

    static constexpr int kAbout = 64;            // half width of the search window, in levels
    static constexpr size_t kTilesPerWave = 64;  // smallest slab; a few of them fit into the first-level cache

    Stage<D>& s_;
    Values density_[2], own_;
    std::vector<uint32_t> above_, within_;
    int last_ = G::bulk / 2;  // level of the last step
};

}  // namespace cicatrix

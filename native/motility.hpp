// Motility: diffuse the cells in integers, then keep the level that holds as many.
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
        const bool keeps_all_bulk = level.value == G::bulk && level.at == level.wanted;  // so do the cells beyond the band
        if (!s_.is_whole && !(0 < level.value && level.value < G::bulk) && !keeps_all_bulk) {
            s_.too_flat = true;
            throw TooNarrow();
        }
        keep_level(u, level);
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
        uint16_t value = 0;
        int64_t count = 0, at = 0, wanted = 0;  // cells; lanes at this level, and how many of them hold a cell
    };

    // The level U0 that as many sites of the core reach as there are cells in it.
    Level level_of(const uint16_t* u) {
        const std::vector<int64_t> fine = histogram(u);
        std::vector<int64_t> coarse(fine.size() / kFine + 1, 0);  // and one more number, of the cells
        for (size_t i = 0; i < fine.size(); ++i) coarse[i / kFine] += fine[i];
        coarse.back() = s_.count_bits(s_.band.own_core(), s_.cells());
        coarse = s_.sum([&] { return coarse; });
        Level level;
        level.wanted = level.count = coarse.back();
        coarse.pop_back();
        const size_t first = kFine * reached_by(coarse, level.wanted);
        const auto some = fine.begin() + first;
        const std::vector<int64_t> here = s_.sum([&] { return std::vector<int64_t>(some, some + kFine); });
        const size_t place = reached_by(here, level.wanted);
        level.value = static_cast<uint16_t>(first + place), level.at = here[place];
        return level;
    }

    // The last bin such that it and those after it hold `wanted`; leaves how many of them lie in this bin.
    static size_t reached_by(const std::vector<int64_t>& bins, int64_t& wanted) {
        size_t i = bins.size() - 1;
        for (; i > 0 && bins[i] < wanted; --i) wanted -= bins[i];
        return i;
    }

    // How many lanes of the own core have each density.
    std::vector<int64_t> histogram(const uint16_t* u) {
        const std::vector<int32_t>& core = s_.band.own_core();
        mixed_.resize(core.size());
        int64_t n_bulk = 0;
        mixed_.resize(s_.kernels.mixed(Ids{core.data(), core.size()}, u, G::bulk, mixed_.data(), &n_bulk));
        s_.work.mixed_sites = kLanes * static_cast<int64_t>(mixed_.size());
        std::vector<std::vector<uint32_t>> parts(s_.most_pieces());  // a table that fits into the first cache
        s_.pieces(mixed_, [&](int i, Ids ids) {
            parts[i].assign(size_t{G::bulk} + 1, 0);
            uint32_t* n = parts[i].data();
            for (size_t k = 0; k < ids.count; ++k) {
                const uint16_t* here = u + kLanes * size_t(ids.first[k]);
                for (int lane = 0; lane < kLanes; ++lane) ++n[here[lane]];
            }
        });
        std::vector<int64_t> all(size_t{G::bulk} + 1, 0);
        for (const auto& part : parts)
            for (size_t level = 0; level < part.size(); ++level) all[level] += part[level];
        all[0] += kLanes * (static_cast<int64_t>(core.size()) - n_bulk) - s_.work.mixed_sites;
        all[G::bulk] += kLanes * n_bulk;
        return all;
    }

    // Cells sit where U > level, and at the wanted number of the sites at the level.
    void keep_level(const uint16_t* u, const Level& level) {
        above_.resize(s_.band.size()), equal_.resize(s_.band.size());
        s_.pieces(s_.band.own_core(), [&](int, Ids ids) { s_.kernels.compare(ids, u, level.value, above_.data(), equal_.data()); });
        const bool takes_all = level.wanted == level.at;
        s_.words.clear();
        for (int32_t id : s_.band.own_core()) {
            s_.set_cells(id, (takes_all ? above_[id] | equal_[id] : above_[id]) & s_.fill()[id]);
            if (!takes_all) s_.add_words(id, equal_[id] & s_.fill()[id]);
        }
        if (!takes_all) s_.settle_first(kMotilityTie, level.wanted);
    }

    static constexpr size_t kFine = 128;          // levels of a coarse bin
    static constexpr size_t kTilesPerWave = 64;  // some of them fit into the first cache, with all their sub-steps

    Stage<D>& s_;
    Values density_[2], own_;
    std::vector<int32_t> mixed_;
    std::vector<uint32_t> above_, equal_;
};

}  // namespace cicatrix

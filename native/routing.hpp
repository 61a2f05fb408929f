// Redistribution along noisy shortest paths: every daughter is a token that walks to a free site.
#pragma once

#include <algorithm>
#include <utility>
#include <vector>

#include "stage.hpp"

namespace cicatrix {

// Cells of the layer, tile by tile.
struct Layer {
    std::vector<int32_t> tiles, own;
    std::vector<uint32_t> padded;  // bits by id, one more entry at either end
    bool is_shared = false;

    uint32_t* bits() { return padded.data() + 1; }
    const std::vector<int32_t>& own_tiles() const { return is_shared ? own : tiles; }
};

template <int D>
class Routing {
    using G = Geometry<D>;
    using Around = typename Stage<D>::Around;

   public:
    Routing(Stage<D>& stage, Layer& layer) : s_(stage), layer_(layer) {}

    // Let the own tokens of each rank find their sites; returns how many own sites were filled.
    int64_t place(const std::vector<Site>& parents) {
        open_paths();
        relax_layer();
        n_settled_ = 0;
        std::vector<uint64_t> tokens = s_.together([&] { return names(walk_first(parents)); });
        while (true) {
            const std::vector<Site> rest = land(tokens);
            if (tokens.empty()) return n_settled_;
            tokens = s_.together([&] { return names(walk(rest)); });
        }
    }

    int64_t bytes() const {
        return static_cast<int64_t>(2 * (cost_.capacity() + distance_.capacity()) + 4 * stamp_.capacity() + dirty_.capacity());
    }

   private:
    uint16_t* cost() { return cost_.data() + kLanes; }
    uint16_t* distance() { return distance_.data() + kLanes; }

    // Costs of the layer, prices of the empty sites beside it.
    void open_paths() {
        const size_t n = kLanes * (s_.band.size() + 2);
        cost_.resize(n), distance_.resize(n), stamp_.resize(n, 0);
        s_.ranges(s_.band.size(), [&](int, size_t first, size_t last) {
            std::fill(cost() + kLanes * first, cost() + kLanes * last, kFar);
            std::fill(distance() + kLanes * first, distance() + kLanes * last, kFar);
        });
        s_.pieces(layer_.tiles, [&](int, Ids ids) {
            s_.kernels.random_values(ids, s_.random(kPathCost), layer_.bits(), kHopCost, s_.rules.path_noise + 1, cost());
        });
        s_.pieces(s_.band.active, [&](int, Ids ids) { s_.by.touching(ids, s_.band.beside(), s_.free(), layer_.bits(), s_.scratch()); });
        s_.collect(s_.band.active, shore_, [&](int32_t id, std::vector<int32_t>& found) {
            if (s_.scratch()[id]) found.push_back(id);
        });
        s_.work.shore_sites = s_.count_bits(shore_, s_.scratch());
        s_.pieces(shore_, [&](int, Ids ids) {
            s_.kernels.random_values(ids, s_.random(kSettle), s_.free(), kNoPath, kUnit, cost());
            s_.by.price(ids, s_.band.beside(), s_.free(), s_.scratch(), kUnit, cost(), distance());
        });
    }

    std::vector<uint64_t> names(const std::vector<Site>& sites) const {
        std::vector<uint64_t> out;
        out.reserve(sites.size());
        for (Site site : sites) out.push_back(s_.name(site));
        return out;
    }

    // The first round: down the field of the whole layer where it is known to be exact.
    std::vector<Site> walk_first(const std::vector<Site>& parents) {
        const uint64_t exact = s_.is_shared ? std::min<uint64_t>(kFar, kHopCost * (s_.sight - 1)) : kFar;
        std::vector<Site> tokens(parents), unsure;
        for (Site site : tokens)
            if (s_.is_shared && distance()[site] >= exact) unsure.push_back(site);
        s_.ranges(tokens.size(), [&](int, size_t first, size_t last) {
            for (size_t i = first; i < last; ++i) tokens[i] = distance()[tokens[i]] < exact ? descend(tokens[i]) : s_.kNowhere;
        });
        tokens.erase(std::remove(tokens.begin(), tokens.end(), s_.kNowhere), tokens.end());
        s_.pieces(layer_.tiles, [&](int, Ids ids) { clear(ids, distance()); });
        for (Site site : walk(unsure)) tokens.push_back(site);
        return tokens;
    }

    static void clear(Ids ids, uint16_t* values) {
        for (size_t i = 0; i < ids.count; ++i) std::fill_n(values + kLanes * size_t(ids.first[i]), kLanes, kFar);
    }

    static constexpr uint16_t kUnit = kSettleCost / G::directions;

    // The fewer cells beside an empty site, the dearer it is to settle there.
    void price(Site site) {
        if (cost()[site] == kFar) cost()[site] = static_cast<uint16_t>(kNoPath + below(s_.word_at(site, kSettle), kUnit));
        uint32_t n_free = 0;
        for (Site other : s_.around(site)) n_free += s_.has(s_.free(), other);
        distance()[site] = static_cast<uint16_t>(kUnit * n_free + cost()[site] - kNoPath);
    }

    // Solve d = cost + least neighbour in the layer. Pieces are slabs of two planes or more, so that every other one can be
    // worked on at once: none reads or marks what another writes. The solution is unique, whatever the order.
    void relax_layer() {
        dirty_.assign(s_.band.size() + 2, 0);
        for (int32_t id : shore_)  // paths begin beside it
            for (int k = 0; k < G::rows; ++k) std::fill_n(dirty_.begin() + s_.band.beside(k, id), 3, 1);
        const size_t size = layer_.tiles.size() / s_.pool.pieces(layer_.tiles.size());
        const std::vector<size_t> cuts = s_.slabs(layer_.tiles, std::max<size_t>(size, 1), 2);
        const int n = static_cast<int>(cuts.size()) - 1;
        for (bool changed = true; changed;) {
            std::vector<uint8_t> moved(n, 0);
            for (int parity = 0; parity < 2; ++parity)
                s_.pool.each((n + 1 - parity) / 2, [&](int i) {
                    const int slab = 2 * i + parity;
                    const Ids ids{layer_.tiles.data() + cuts[slab], cuts[slab + 1] - cuts[slab]};
                    moved[slab] = s_.by.relax(ids, s_.band.beside(), cost(), distance(), dirty_.data() + 1);
                });
            changed = n > 1 && std::any_of(moved.begin(), moved.end(), [](uint8_t m) { return m != 0; });
        }
    }

    // Walk to the neighbour of least distance, the first among equals, until the site is free.
    Site descend(Site site) {
        while (!s_.has(s_.free(), site)) {
            const Around others = s_.around(site);
            Site best = others.site[0];
            for (Site other : others)
                if (distance()[other] < distance()[best]) best = other;
            site = best;
        }
        return site;
    }

    // One token of each site stays there. Leaves the others in the list; returns those that this rank has to move.
    std::vector<Site> land(std::vector<uint64_t>& tokens) {
        std::sort(tokens.begin(), tokens.end());
        std::vector<Site> mine;
        size_t n_left = 0;
        for (size_t i = 0; i < tokens.size(); ++i) {
            const Site site = s_.site_of(tokens[i]);
            if (i > 0 && tokens[i] == tokens[i - 1]) {
                tokens[n_left++] = tokens[i];
                if (s_.is_own(site)) mine.push_back(site);
            } else if (site != s_.kNowhere) {
                settle(site);
            }
        }
        tokens.resize(n_left);
        return mine;
    }

    void settle(Site site) {
        s_.settle_at(site);
        n_settled_ += s_.is_own(site);
        cost()[site] = static_cast<uint16_t>(kHopCost + below(s_.word_at(site, kPathCost), s_.rules.path_noise + 1));
        distance()[site] = kFar;
    }

    // Move tokens to free sites, those without a path are dropped. The field is solved near the tokens only: a path that
    // leaves `reach` hops costs at least 64 (reach + 1), so smaller distances are exact; for the others it is doubled.
    std::vector<Site> walk(std::vector<Site> tokens) {
        std::vector<Site> done;
        for (int64_t reach = 2; !tokens.empty(); reach *= 2) {
            if (s_.is_shared && reach + 2 > s_.sight) throw TooNarrow();
            const bool is_all = find_near(tokens, reach);
            solve_near();
            const uint64_t exact = is_all ? uint64_t{kFar} : std::min<uint64_t>(kFar, kHopCost * (reach + 1));
            std::vector<Site> far;
            for (Site site : tokens) {
                if (distance()[site] < exact)
                    done.push_back(descend(site));
                else if (!is_all)
                    far.push_back(site);
            }
            for (Site site : near_) distance()[site] = kFar;
            tokens = std::move(far);
        }
        return done;
    }

    bool find_near(const std::vector<Site>& tokens, int64_t reach) {
        ++generation_;
        near_.clear();
        auto add = [&](Site site) {
            if (stamp()[site] != generation_) stamp()[site] = generation_, near_.push_back(site);
        };
        for (Site site : tokens) add(site);
        size_t ring = 0;
        for (int64_t hop = 1; hop < reach && ring < near_.size(); ++hop) {
            const size_t last = near_.size();
            for (; ring < last; ++ring) {
                for (Site other : s_.around(near_[ring]))
                    if (cost()[other] < kNoPath) add(other);
            }
        }
        return ring == near_.size();
    }

    void solve_near() {
        for (Site site : near_)
            for (Site other : s_.around(site))
                if (s_.has(s_.free(), other)) price(other);
        for (bool changed = true; changed;) {
            changed = false;
            for (size_t i = near_.size(); i-- > 0;) {
                const Site site = near_[i];
                uint32_t best = kFar;
                for (Site other : s_.around(site)) best = std::min<uint32_t>(best, distance()[other]);
                best += cost()[site];
                if (best < distance()[site]) distance()[site] = static_cast<uint16_t>(best), changed = true;
            }
        }
    }

    uint32_t* stamp() { return stamp_.data() + kLanes; }

    Stage<D>& s_;
    Layer& layer_;
    Values cost_, distance_;
    std::vector<uint8_t> dirty_;
    std::vector<uint32_t> stamp_;
    uint32_t generation_ = 0;
    std::vector<int32_t> shore_;
    std::vector<Site> near_;
    int64_t n_settled_ = 0;
};

}  // namespace cicatrix

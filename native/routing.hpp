// Redistribution along noisy shortest paths: every daughter cell is a token that moves to a free site.
#pragma once

#include <algorithm>
#include <utility>
#include <vector>

#include "stage.hpp"

namespace cicatrix {

// Cells of the active layer, by tile.
struct Layer {
    std::vector<int32_t> tiles, own;
    std::vector<uint32_t> padded;  // bits by id, with one more entry at each end
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

    // Move the tokens of all ranks to free sites; return the number of sites owned by this rank that were filled.
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
        return static_cast<int64_t>(2 * (cost_.capacity() + distance_.capacity()) + dirty_.capacity());
    }

   private:
    uint16_t* cost() { return cost_.data() + kLanes; }
    const uint16_t* cost() const { return cost_.data() + kLanes; }
    uint16_t* distance() { return distance_.data() + kLanes; }

    // Set the costs of the layer's sites, and the settling costs of the empty sites next to the layer.
    void open_paths() {
        const size_t n = kLanes * (s_.band.size() + 2);
        for (int32_t id : written_)
            for (Values* values : {&cost_, &distance_}) std::fill_n(values->begin() + kLanes * (size_t(id) + 1), kLanes, kFar);
        if (cost_.size() < n) cost_.resize(n, kFar), distance_.resize(n, kFar);
        written_ = layer_.tiles;
        s_.pieces(layer_.tiles, [&](int, Ids ids) {
            s_.kernels.random_values(ids, s_.random(kPathCost), layer_.bits(), kHopCost, s_.rules.path_noise + 1, cost());
        });
        s_.pieces(s_.band.active, [&](int, Ids ids) { s_.by.touching(ids, s_.band.beside(), s_.free(), layer_.bits(), s_.scratch()); });
        s_.collect(s_.band.active, shore_, [&](int32_t id, std::vector<int32_t>& found) {
            if (s_.scratch()[id]) found.push_back(id);
        });
        written_.insert(written_.end(), shore_.begin(), shore_.end());
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

    // First round: descend the distance field of the whole layer where it is known to be exact; search for the other tokens.
    std::vector<Site> walk_first(const std::vector<Site>& parents) {
        const uint64_t exact = s_.is_shared ? std::min<uint64_t>(kFar, kHopCost * (s_.sight - 1)) : kFar;
        std::vector<Site> tokens(parents), unsure;
        for (Site site : tokens)
            if (s_.is_shared && distance()[site] >= exact) unsure.push_back(site);
        s_.ranges(tokens.size(), kTilesPerToken, [&](int, size_t first, size_t last) {
            for (size_t i = first; i < last; ++i) tokens[i] = distance()[tokens[i]] < exact ? descend(tokens[i]) : s_.kNowhere;
        });
        tokens.erase(std::remove(tokens.begin(), tokens.end(), s_.kNowhere), tokens.end());
        for (Site site : walk(unsure)) tokens.push_back(site);
        return tokens;
    }

    static constexpr uint16_t kUnit = kSettleCost / G::directions;

    // Cost of settling at an empty site; it is higher the fewer cells are next to it.
    uint32_t price(Site site) const {
        const uint16_t known = cost()[site];
        const uint32_t extra = known == kFar ? below(s_.word_at(site, kSettle), kUnit) : known - kNoPath;
        uint32_t n_free = 0;
        for (Site other : s_.around(site)) n_free += s_.has(s_.free(), other);
        return kUnit * n_free + extra;
    }

    // Solve d = cost + smallest d of the neighbours in the layer. Pieces are slabs of at least two planes, and every other slab
    // is relaxed at the same time, so that none reads or marks data that another writes. The solution is unique for any order.
    void relax_layer() {
        dirty_.assign(s_.band.size() + 2, 0);
        for (int32_t id : shore_)  // d is known at the empty sites, so relaxation starts next to them
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

    // Move to the neighbour of smallest distance, the first among equals, until the site is free.
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

    // Settle one token at each site. The others remain in the list; return those that this rank has to move.
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
        written_.push_back(static_cast<int32_t>(site >> 5));
        cost()[site] = static_cast<uint16_t>(kHopCost + below(s_.word_at(site, kPathCost), s_.rules.path_noise + 1));
    }

    // Move tokens to free sites and drop those without a path.
    std::vector<Site> walk(const std::vector<Site>& tokens) {
        std::vector<Site> done(tokens.size());
        s_.ranges(tokens.size(), kTilesPerToken, [&](int, size_t first, size_t last) {
            Search search(*this);
            for (size_t i = first; i < last; ++i)
                done[i] = i > first && tokens[i] == tokens[i - 1] ? done[i - 1] : search.nearest(tokens[i]);
        });
        done.erase(std::remove(done.begin(), done.end(), s_.kNowhere), done.end());
        return done;
    }

    // Destination of one token without the distance field, by Dijkstra's algorithm from its site; the same as by descending.
    class Search {
       public:
        explicit Search(Routing& routing) : r_(routing), table_(256) {}

        Site nearest(Site start) {
            begin(start);
            const uint32_t longest = kFar - r_.cost()[start];  // lengths from here on count as no path
            uint32_t least = longest;  // length of the shortest path to a free site so far
            for (size_t n = 0; !heap_.empty() && heap_.front().length <= least && heap_.front().length < longest; ++n) {
                std::pop_heap(heap_.begin(), heap_.end());
                const Reached here = heap_.back();
                heap_.pop_back();
                if (find(here.site).length != here.length) continue;
                passed_.push_back(here.site);
                look_around(here, least);
            }
            return least < longest ? follow(start, least) : kNowhere;
        }

       private:
        struct Reached {
            uint32_t length;
            Site site;
            uint32_t hops;
            bool operator<(const Reached& other) const { return length > other.length; }  // puts the nearest at the heap's top
        };
        struct Entry {
            Site site = kNowhere;
            uint32_t length = 0, round = 0;
            Site next = kNowhere;  // next site on a shortest path
        };

        void begin(Site start) {
            ++round_, n_entries_ = 0;
            heap_.clear(), passed_.clear();
            find(start).length = 0;
            heap_.push_back({0, start, 0});
        }

        void look_around(const Reached& here, uint32_t& least) {
            if (r_.s_.is_shared && here.hops + 3 > static_cast<uint64_t>(r_.s_.sight)) throw TooNarrow();
            for (Site other : r_.s_.around(here.site)) {
                const bool is_free = r_.s_.has(r_.s_.free(), other);
                if (!is_free && r_.cost()[other] >= kNoPath) continue;
                const uint32_t length = here.length + (is_free ? r_.price(other) : r_.cost()[other]);
                if (length > least) continue;
                Entry& entry = find(other);
                if (length >= entry.length) continue;
                entry.length = length;
                if (is_free)
                    least = length;
                else
                    heap_.push_back({length, other, here.hops + 1}), std::push_heap(heap_.begin(), heap_.end());
            }
        }

        // Follow the shortest path that takes the first possible direction at every site.
        Site follow(Site start, uint32_t least) {
            for (size_t i = passed_.size(); i-- > 0;) {
                const uint32_t length = find(passed_[i]).length;
                Site next = kNowhere;
                for (Site other : r_.s_.around(passed_[i])) {
                    const Entry* there = look(other);
                    if (!there) continue;
                    const bool is_free = r_.s_.has(r_.s_.free(), other);
                    if (is_free ? there->length == least && length + r_.price(other) == least
                                : there->next != kNowhere && length + r_.cost()[other] == there->length) {
                        next = other;
                        break;
                    }
                }
                find(passed_[i]).next = next;
            }
            Site site = start;
            while (!r_.s_.has(r_.s_.free(), site)) site = find(site).next;
            return site;
        }

        const Entry* look(Site site) const {
            for (size_t i = place(site);; i = (i + 1) & (table_.size() - 1)) {
                if (table_[i].round != round_) return nullptr;
                if (table_[i].site == site) return &table_[i];
            }
        }

        // Return the entry of a site; a new entry has infinite length.
        Entry& find(Site site) {
            if (2 * n_entries_ > table_.size()) grow();
            for (size_t i = place(site);; i = (i + 1) & (table_.size() - 1)) {
                if (table_[i].round == round_ && table_[i].site != site) continue;
                if (table_[i].round != round_) table_[i] = {site, ~uint32_t{0}, round_, kNowhere}, ++n_entries_;
                return table_[i];
            }
        }

        void grow() {
            std::vector<Entry> old(2 * table_.size());
            old.swap(table_);
            n_entries_ = 0;
            for (const Entry& entry : old)
                if (entry.round == round_) find(entry.site) = entry;
        }

        size_t place(Site site) const { return (site * 0x9E3779B1u >> 7) & (table_.size() - 1); }

        Routing& r_;
        std::vector<Entry> table_;
        std::vector<Reached> heap_;
        std::vector<Site> passed_;
        size_t n_entries_ = 0;
        uint32_t round_ = 0;
    };

    static constexpr Site kNowhere = Stage<D>::kNowhere;
    static constexpr size_t kTilesPerToken = 16;  // approximate work per token, in tiles

    Stage<D>& s_;
    Layer& layer_;
    Values cost_, distance_;
    std::vector<uint8_t> dirty_;
    std::vector<int32_t> shore_, written_;  // tiles; costs and distances are kFar in tiles that are not in written_
    int64_t n_settled_ = 0;
};

}  // namespace cicatrix

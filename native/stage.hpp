// Data and helpers shared by the phases of a step: lattice, band, cells in the band, distribution of work.
#pragma once

#include <algorithm>
#include <array>
#include <cstring>
#include <string>
#include <tuple>
#include <vector>

#include "automaton.hpp"
#include "band.hpp"
#include "kernels.hpp"
#include "philox.hpp"
#include "pool.hpp"
#include "sites.hpp"
#include "team.hpp"

namespace cicatrix {

template <int D>
class Stage {
    using G = Geometry<D>;

   public:
    Stage(const std::vector<int64_t>& shape, const Rules& the_rules, int64_t first_step, int threads,
          int64_t tiles_per_piece, const Kernels& the_kernels)
        : rows(shape), rules(the_rules), key{static_cast<uint32_t>(rules.seed), static_cast<uint32_t>(rules.seed >> 32)},
          kernels(the_kernels), by(kernels.dimension[D - 2]), pool(threads, tiles_per_piece), fillable(rows.count() * rows.tiles),
          occupied(fillable.size()), band(rows), step(first_step), is_plain_(fillable.size()) {}

    // Find the plain tiles: all sites can be filled, in the tile itself and in the tiles around it.
    void find_plain() {
        for (int64_t row = 0; row < rows.count(); ++row) {
            if (rows.on_frame(row)) continue;
            for (int64_t word = row * rows.tiles + 1; word < (row + 1) * rows.tiles - 1; ++word) {
                uint32_t full = ~0u;
                for (int k = 0; k < G::rows; ++k) {
                    const uint32_t* here = fillable.data() + word + rows.stride(k) * rows.tiles;
                    full &= here[-1] & here[0] & here[1];
                }
                is_plain_[word] = full == ~0u;
            }
        }
    }

    // Load the tiles of the band: cells, sites that can be filled, free sites.
    void load() {
        const size_t n = band.size();
        cells_.resize(n + 2), fill_.resize(n + 2), free_.resize(n + 2), scratch_.resize(n + 2), plain_.resize(n);
        std::vector<uint8_t> all(most_pieces(), 1);
        ranges(n, [&](int i, size_t first, size_t last) {
            for (size_t id = first; id < last; ++id) {
                const int64_t word = band.word[id];
                cells()[id] = occupied[word], plain_[id] = is_plain_[word];
                fill()[id] = plain_[id] ? ~0u : fillable[word];
                free()[id] = fill()[id] & ~cells()[id];
                all[i] &= is_plain_[word];
            }
        });
        all_plain = std::all_of(all.begin(), all.end(), [](uint8_t a) { return a != 0; });
    }

    uint32_t* scratch() { return scratch_.data() + 1; }
    uint32_t* cells() { return cells_.data() + 1; }
    uint32_t* fill() { return fill_.data() + 1; }
    uint32_t* free() { return free_.data() + 1; }
    const uint8_t* plain() const { return plain_.data(); }

    // ---- communication between ranks; with a single rank each function returns that rank's own data

    // Concatenate the results of all ranks. If the band is too narrow on one rank, all of them throw TooNarrow.
    template <class Find>
    auto together(Find&& find) {
        if (!is_shared) return find();
        using List = decltype(find());
        using T = typename List::value_type;
        std::string message(1, 'd');
        try {
            const List mine = find();
            message.append(reinterpret_cast<const char*>(mine.data()), mine.size() * sizeof(T));
        } catch (const TooNarrow&) {
            message = "f";
        }
        List all;
        bool is_done = true;
        for (const std::string& other : team->gather(message)) {
            is_done &= other.front() == 'd';
            all.resize(all.size() + other.size() / sizeof(T));
            std::memcpy(all.data() + all.size() - other.size() / sizeof(T), other.data() + 1, other.size() - 1);
        }
        if (!is_done) throw TooNarrow();
        return all;
    }

    // Sum over the ranks of each of the numbers that a rank counts.
    template <class Count>
    std::vector<int64_t> sum(Count&& count) {
        size_t n = 0;
        std::vector<int64_t> all = together([&] {
            std::vector<int64_t> mine = count();
            n = mine.size();
            return mine;
        });
        for (size_t i = n; i < all.size(); ++i) all[i % n] += all[i];
        all.resize(n);
        return all;
    }

    struct Change {
        int64_t word;
        uint64_t cells;
    };

    // Exchange the tiles that changed since the last step: send those among `ids`, return those of all ranks.
    std::vector<Change> changes(const std::vector<int32_t>& ids) {
        return together([&] {
            std::vector<Change> mine;
            for (int32_t id : ids)
                if (cells()[id] != occupied[band.word[id]]) mine.push_back({band.word[id], cells()[id]});
            return mine;
        });
    }

    // Exchange the results of edge division and motility, which change no tile outside the core.
    void share_cells() {
        if (!is_shared) return;
        const std::vector<Change> all = changes(band.own_core());
        load();
        for (const Change& change : all)
            if (const int32_t id = band.find(change.word); id >= 0) set_cells(id, static_cast<uint32_t>(change.cells));
    }

    void set_cells(int32_t id, uint32_t bits) { cells()[id] = bits, free()[id] = fill()[id] & ~bits; }

    // Global identifier of a token's site: its lattice number; with a single rank, the local site itself.
    uint64_t name(Site site) const { return is_shared ? number(site) : site; }

    Site site_of(uint64_t name) const {
        if (!is_shared) return static_cast<Site>(name);
        const int64_t line = static_cast<int64_t>(name) / rows.width, at = static_cast<int64_t>(name) % rows.width;
        const int32_t id = band.find(rows.row_of_line(line) * rows.tiles + at / kPlaces + 1);
        return id < 0 ? kNowhere : static_cast<Site>(id * kLanes + rows.line_of_tile(line) * kPlaces + at % kPlaces);
    }

    bool is_own(Site site) const { return site != kNowhere && band.is_own(static_cast<int32_t>(site >> 5)); }

    static constexpr Site kNowhere = ~Site{0};

    // ----

    int64_t count_bits(const std::vector<int32_t>& ids, const uint32_t* bits) const {
        return kernels.count_bits(Ids{ids.data(), ids.size()}, bits);
    }

    Draw random(Phase phase) const {
        return {band.first_site.data(), {lines[0], lines[1], lines[2], lines[3]}, static_cast<uint32_t>(step), phase,
                {key[0], key[1]}};
    }

    uint64_t number(Site site) const {
        return band.first_site[site >> 5] + lines[(site & 31) / kPlaces] + site % kPlaces;
    }

    // All neighbours of a site, in the order of docs/theory/automaton.md.
    struct Around {
        Site site[G::directions];
        const Site* begin() const { return site; }
        const Site* end() const { return site + G::directions; }
    };

    Around around(Site site) const {
        const int32_t id = site >> 5;
        if (!band.is_active[id]) throw TooNarrow();
        int32_t tile[G::rows];
        for (int k = 0; k < G::rows; ++k) tile[k] = band.beside(k, id);
        Around out;
        for (int k = 0; k < G::directions; ++k) {
            const Move& move = moves[site & 31][k];
            out.site[k] = static_cast<Site>((tile[move.row] + move.right) * kLanes + move.lane);
        }
        return out;
    }

    static bool has(const uint32_t* bits, Site site) { return bits[site >> 5] >> (site & 31) & 1; }

    void settle_at(Site site) {
        cells()[site >> 5] |= 1u << (site & 31);
        free()[site >> 5] &= ~(1u << (site & 31));
    }

    // Divide 0 .. n - 1 among the threads: job(piece number, first, last).
    template <class Job>
    void ranges(size_t n, Job&& job) {
        ranges(n, 1, job);
    }

    // The same, with each item as much work as `weight` tiles.
    template <class Job>
    void ranges(size_t n, size_t weight, Job&& job) {
        const int used = pool.pieces(weight * n);
        pool.each(used, [&](int i) { job(i, n * i / used, n * (i + 1) / used); });
    }

    // Divide a list of tiles among the threads: job(piece number, ids).
    template <class Job>
    void pieces(const std::vector<int32_t>& ids, Job&& job) {
        ranges(ids.size(), [&](int i, size_t first, size_t last) { job(i, Ids{ids.data() + first, last - first}); });
    }

    // Concatenate, in order, what find(id, list) appends for each of these tiles.
    template <class T, class Find>
    void collect(const std::vector<int32_t>& ids, std::vector<T>& all, Find&& find) {
        all.clear();
        if (pool.threads() == 1) {
            for (int32_t id : ids) find(id, all);
            return;
        }
        std::vector<std::vector<T>> parts(most_pieces());
        pieces(ids, [&](int i, Ids some) {
            for (size_t k = 0; k < some.count; ++k) find(some.first[k], parts[i]);
        });
        for (const auto& part : parts) all.insert(all.end(), part.begin(), part.end());
    }

    int most_pieces() const { return pool.most_pieces(); }

    static void add_sites(int32_t id, uint32_t bits, std::vector<Site>& sites) {
        for (; bits; bits &= bits - 1) sites.push_back(static_cast<Site>(id) * kLanes + __builtin_ctz(bits));
    }

    void add_word(Site site) { words.add(site, number(site)); }

    void add_words(int32_t id, uint32_t bits) {
        for (; bits; bits &= bits - 1) add_word(static_cast<Site>(id) * kLanes + __builtin_ctz(bits));
    }

    // Fill, of the sites in `words` of all ranks, the `wanted` ones with the smallest (word, number).
    void settle_first(Phase phase, int64_t wanted) {
        struct Lot {
            uint64_t word, number;
            bool operator<(const Lot& other) const { return std::tie(word, number) < std::tie(other.word, other.number); }
        };
        if (!is_shared && wanted >= static_cast<int64_t>(words.size())) {
            for (size_t i = 0; i < words.size(); ++i) settle_at(words.site(i));
            return;
        }
        words.draw(kernels, step, phase, key);
        auto draw = [&](size_t i) { return Lot{words.word(i), number(words.site(i))}; };
        std::vector<Lot> order = together([&] {
            std::vector<Lot> mine(words.size());
            for (size_t i = 0; i < mine.size(); ++i) mine[i] = draw(i);
            return mine;
        });
        const bool takes_all = wanted >= static_cast<int64_t>(order.size());
        if (!takes_all) std::nth_element(order.begin(), order.begin() + wanted, order.end());
        for (size_t i = 0; i < words.size(); ++i)
            if (takes_all || draw(i) < order[wanted]) settle_at(words.site(i));
    }

    // Find the sites within some hops of a free site, through occupied and unfillable sites alike.
    void find_zone(int64_t hops) {
        zone[0] = free_, zone[1] = free_;
        collect(band.active, not_free_, [&](int32_t id, std::vector<int32_t>& found) {
            if (free()[id] != ~0u) found.push_back(id);
        });
        for (int64_t i = 0; i < hops; ++i) {
            pieces(not_free_, [&](int, Ids ids) {
                by.dilate(ids, band.beside(), zone[0].data() + 1, zone[1].data() + 1);
            });
            std::swap(zone[0], zone[1]);
        }
        for (int32_t id : band.outer)  // the zone must not extend to inactive tiles
            require_inside(id, zone[0][id + 1] & ~free()[id]);
    }

    // Require that all neighbours of these sites of a tile lie in active tiles or outside the lattice; else throw TooNarrow.
    void require_inside(int32_t id, uint32_t sites) const {
        static constexpr Seen<D> seen;
        for (int k = 0; sites && k < G::rows; ++k)
            for (int right = -1; right <= 1; ++right)
                if (sites & seen.by[k][right + 1] && leads_out(band.beside(k, id) + right)) throw TooNarrow();
    }

    bool leads_out(int32_t id) const { return !band.is_active[id] && !band.is_frame[id]; }

    uint32_t word_at(Site site, Phase phase) const {
        uint32_t words[4];
        const uint64_t group = number(site) >> 2;
        philox_block(static_cast<uint32_t>(group), static_cast<uint32_t>(group >> 32), static_cast<uint32_t>(step), phase,
                     key[0], key[1], words);
        return words[number(site) & 3];
    }

    // Cut a list of tiles between planes of the first axis into slabs of at least `size` tiles and `planes` planes.
    std::vector<size_t> slabs(const std::vector<int32_t>& ids, size_t size, int64_t planes) const {
        std::vector<size_t> cuts{0};
        size_t i = 0;
        int64_t first_plane = 0;  // first plane of the slab
        for (int64_t plane = 0; i < ids.size(); ++plane) {
            if (i == 0) first_plane = plane;
            if (i - cuts.back() >= size && plane - first_plane >= planes) cuts.push_back(i), first_plane = plane;
            while (i < ids.size() && ids[i] < band.plane_ends[plane]) ++i;
        }
        cuts.push_back(ids.size());
        return cuts;
    }

    uint32_t free_word(int64_t word) const { return fillable[word] & ~occupied[word]; }

    int64_t bytes() const {
        int64_t n = band.bytes() + static_cast<int64_t>(is_plain_.capacity() + plain_.capacity());
        for (const auto* v : {&fillable, &occupied, &cells_, &fill_, &free_, &zone[0], &zone[1], &scratch_})
            n += static_cast<int64_t>(4 * v->capacity());
        return n;
    }

    Rows<D> rows;
    Rules rules;
    uint32_t key[2];
    const Kernels& kernels;
    const Kernels::ByDimension& by;
    Pool pool;
    std::vector<uint32_t> fillable, occupied;  // tiles of the lattice
    Band<D> band;
    int64_t step;
    bool is_whole = false, too_flat = false;
    Team* team = nullptr;
    bool is_shared = false;  // true if several ranks share this step
    int64_t sight = 0;       // if so: hops around the owned tiles within which layer and cells are known
    bool all_plain = false;  // true if all tiles of the band are plain
    Words words;
    Work work;

    // Bits of the tiles of the band. Arrays indexed by id have one more entry at each end.
    std::vector<uint32_t> zone[2];

   private:
    // Neighbour of a lane in one direction: row offset, tiles to the right, lane in that tile.
    struct Move {
        int8_t row, right, lane;
    };

    using Moves = std::array<std::array<Move, G::directions>, kLanes>;

    static Moves all_moves() {
        auto split = [](int x, int size, int& tile) {
            tile = x < 0 ? -1 : x >= size ? 1 : 0;
            return x - tile * size;
        };
        Moves moves{};
        for (int lane = 0; lane < kLanes; ++lane)
            for (int k = 0; k < G::directions; ++k) {
                const Direction& d = G::neighbour[k];
                const int line = lane / kPlaces;
                int tile_first, tile_second, right;
                const int i = split(line / G::depth + d.first, G::height, tile_first);
                const int j = split(line % G::depth + d.second, G::depth, tile_second);
                const int place = split(lane % kPlaces + d.last, kPlaces, right);
                int row = 0;
                while (G::row[row][0] != tile_first || G::row[row][1] != tile_second) ++row;
                const int there = (i * G::depth + j) * kPlaces + place;
                moves[lane][k] = {static_cast<int8_t>(row), static_cast<int8_t>(right), static_cast<int8_t>(there)};
            }
        return moves;
    }

    std::vector<uint32_t> cells_, fill_, free_, scratch_;
    std::vector<int32_t> not_free_;          // tiles with a site that is not free
    std::vector<uint8_t> is_plain_, plain_;  // by tile of the lattice, by tile of the band
    const Moves moves = all_moves();
    const int64_t lines[kLines] = {rows.line(0), rows.line(1), rows.line(2), rows.line(3)};
};

}  // namespace cicatrix

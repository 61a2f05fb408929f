// The part of a lattice that a step computes: tiles of 32 sites within some hops of the front.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <iterator>
#include <stdexcept>
#include <vector>

#include "kernels.hpp"
#include "pool.hpp"
#include "team.hpp"

namespace cicatrix {

// Rows of tiles of a lattice, with a frame of one additional tile on every side, so that every tile has all neighbours.
template <int D>
struct Rows {
    using G = Geometry<D>;
    std::array<int64_t, 2> across{1, 1};  // number of sites along the first and, in 3-D, the second axis
    int64_t width = 0;                    // number of sites along the last axis
    int64_t outer = 0, inner = 1;         // number of rows of tiles along the first and the second axis, frame included
    int64_t tiles = 0;                    // number of tiles in a row, frame included

    explicit Rows(const std::vector<int64_t>& n) : width(n[D - 1]) {
        for (int axis = 0; axis < D - 1; ++axis) across[axis] = n[axis];
        outer = (across[0] + G::height - 1) / G::height + 2;
        inner = D == 3 ? (across[1] + G::depth - 1) / G::depth + 2 : 1;
        tiles = (width + kPlaces - 1) / kPlaces + 2;
    }

    int64_t count() const { return outer * inner; }
    int64_t n_lines() const { return across[0] * across[1]; }
    // Row of tiles that contains the n-th line of sites, and which line of its tiles that is.
    int64_t row_of_line(int64_t n) const {
        const int64_t i = n / across[1] / G::height + 1;
        return D == 3 ? i * inner + n % across[1] / G::depth + 1 : i;
    }
    int line_of_tile(int64_t n) const {
        return static_cast<int>(n / across[1] % G::height * G::depth + (D == 3 ? n % across[1] % G::depth : 0));
    }
    // Number (in the C order of the lattice) of the first site of the row's first tile; meaningless on the frame.
    int64_t first_site(int64_t row) const {
        const int64_t i = (row / inner - 1) * G::height, j = D == 3 ? (row % inner - 1) * G::depth : 0;
        return (i * across[1] + j) * width;
    }
    // Difference of site number between the first site of a line of a tile and the first site of the tile.
    int64_t line(int number) const { return (number / G::depth * across[1] + number % G::depth) * width; }
    bool on_frame(int64_t row) const {
        const int64_t i = row / inner, j = row % inner;
        return i == 0 || i == outer - 1 || (D == 3 && (j == 0 || j == inner - 1));
    }
    // Position of the first site of a tile on the Morton curve.
    uint64_t place(int64_t word) const {
        const int64_t row = word / tiles;
        return morton(row / inner * G::height, D == 3 ? row % inner * G::depth : 0, word % tiles * kPlaces);
    }
    // Difference of row number for row offset k.
    int64_t stride(int k) const { return G::row[k][0] * inner + G::row[k][1]; }
};

// A tile with free sites that have a neighbour which is not free. `first`: their positions along the first axis (one bit each);
// `low`, `high`: range of their places along the last axis.
struct Front {
    int64_t word;
    uint8_t first, low, high;
};

// Set of tiles of a lattice, one bit per tile.
template <int D>
class TileSet {
    using G = Geometry<D>;

   public:
    explicit TileSet(const Rows<D>& rows)
        : rows_(rows), words_((rows.tiles + 63) / 64), bits_(rows.count() * words_), inner_(words_) {
        for (int64_t b = 1; b < rows.tiles - 1; ++b) inner_[b >> 6] |= uint64_t{1} << (b & 63);
    }

    void clear(int64_t first, int64_t last) { std::fill(at(first * rows_.inner), at(last * rows_.inner), 0); }

    const uint64_t* row(int64_t r) const { return bits_.data() + r * words_; }
    int64_t words() const { return words_; }
    bool has(int64_t r, int64_t b) const { return row(r)[b >> 6] >> (b & 63) & 1; }

    void add(int64_t r, int64_t first, int64_t last) {
        uint64_t *here = at(r) + (first >> 6), from = ~uint64_t{0} << (first & 63);
        for (int64_t more = (last >> 6) - (first >> 6); more > 0; --more, from = ~uint64_t{0}) *here++ |= from;
        *here |= from & ~uint64_t{0} >> (63 - (last & 63));
    }

    // Extend the set by some rows along the first and the second axis, in the range first .. last - 1 of the first axis.
    void widen(int64_t along_first, int64_t along_second, int64_t first, int64_t last) {
        for (int64_t i = first; i < last && D == 3; ++i) spread(at(i * rows_.inner), rows_.inner, words_, along_second);
        spread(at(first * rows_.inner), last - first, rows_.inner * words_, along_first);
    }

    void drop_frame(int64_t first, int64_t last) {
        for (int64_t r = first * rows_.inner; r < last * rows_.inner; ++r) {
            uint64_t* here = bits_.data() + r * words_;
            if (rows_.on_frame(r)) std::fill(here, here + words_, 0);
        }
    }

    // Set to the tiles that are not in the other set, without the frame.
    void complement(const TileSet& other, int64_t first, int64_t last) {
        for (int64_t r = first * rows_.inner; r < last * rows_.inner; ++r) {
            uint64_t* to = bits_.data() + r * words_;
            for (int64_t w = 0; w < words_; ++w) to[w] = rows_.on_frame(r) ? 0 : ~other.row(r)[w] & inner_[w];
        }
    }

    // Set to the other set, extended by one tile on every side.
    void surround(const TileSet& other, int64_t first, int64_t last) {
        for (int64_t r = first * rows_.inner; r < last * rows_.inner; ++r) beside(other.row(r), bits_.data() + r * words_);
        widen(1, 1, first, last);
    }

    // Set to the tiles of `among` within some hops of `from`.
    void near_to(const TileSet& from, int64_t hops, const TileSet& among, int64_t first, int64_t last) {
        std::vector<uint64_t> narrow(words_);
        for (int64_t r = first * rows_.inner; r < last * rows_.inner; ++r) {
            std::copy_n(from.row(r), words_, bits_.data() + r * words_);
            for (int64_t done = 0; done < hops; done += kPlaces) {
                std::copy_n(row(r), words_, narrow.data());
                beside(narrow.data(), bits_.data() + r * words_);
            }
        }
        widen(in_rows(hops, G::height), in_rows(hops, G::depth), first, last);
        for (int64_t w = first * rows_.inner * words_; w < last * rows_.inner * words_; ++w) bits_[w] &= among.bits_[w];
    }

    // Set to the tiles of the other set that lie in an interval of the Morton curve.
    void take(const TileSet& other, const Stretch& stretch, int64_t first, int64_t last) {
        for (int64_t r = first * rows_.inner; r < last * rows_.inner; ++r)
            for (int64_t w = 0; w < words_; ++w) {
                uint64_t& to = bits_[r * words_ + w] = other.bits_[r * words_ + w];
                for (uint64_t left = to; left; left &= left - 1)
                    if (!stretch.has(rows_.place(r * rows_.tiles + 64 * w + __builtin_ctzll(left)))) to &= ~(left & -left);
            }
    }

    static int64_t in_rows(int64_t hops, int size) { return (hops + size - 1) / size; }

   private:
    uint64_t* at(int64_t r) { return bits_.data() + r * words_; }

    // Extend a row of tiles by one tile on each side.
    void beside(const uint64_t* from, uint64_t* to) const {
        for (int64_t w = 0; w < words_; ++w) {
            to[w] = from[w] | from[w] << 1 | from[w] >> 1;
            if (w > 0) to[w] |= from[w - 1] >> 63;
            if (w + 1 < words_) to[w] |= from[w + 1] << 63;
        }
    }

    // bits[i] = or of bits[i - reach .. i + reach] for n rows of `size` words, in place, by doubling.
    static void spread(uint64_t* bits, int64_t n, int64_t size, int64_t reach) {
        for (int64_t done = 0; done < reach;) {
            const int64_t shift = std::min(done + 1, reach - done);
            if (shift < n)
                for (int64_t i = (n - shift) * size - 1; i >= 0; --i) bits[i + shift * size] |= bits[i];
            done += shift;
        }
        for (int64_t done = 0; done < reach;) {
            const int64_t shift = std::min(done + 1, reach - done);
            if (shift < n)
                for (int64_t i = 0; i < (n - shift) * size; ++i) bits[i] |= bits[i + shift * size];
            done += shift;
        }
    }

    Rows<D> rows_;
    int64_t words_;
    std::vector<uint64_t> bits_, inner_;
};

// Part of the band that one of several ranks computes: it owns the tiles of an interval of the Morton curve, and also computes
// the tiles within `halo` hops (`core_halo` in the core) of them.
struct Share {
    Stretch stretch;
    int64_t halo, core_halo;
};

// Stored tiles, numbered along the rows. All neighbours of an active tile are stored. A single rank owns all active tiles.
template <int D>
class Band {
    using G = Geometry<D>;

   public:
    explicit Band(const Rows<D>& rows)
        : rows_(rows), near_(rows), core_(rows), own_(rows), stored_(rows), rim_(rows), outside_(rows), beyond_(rows),
          first_run_(rows.count() + 1) {}

    // Build the band: tiles within `reach` hops of the front are active, tiles within `inner` hops form the core; with `whole`
    // all tiles are both. With several ranks (`share`), keep only the owned tiles and their halo.
    void build(const std::vector<Front>& front, int64_t reach, int64_t inner, bool whole, const Share* share, Pool& pool) {
        int64_t low = 1, high = rows_.outer - 1;  // range along the first axis
        if (!whole) {
            low = rows_.outer, high = 0;
            for (const Front& f : front) {
                const int64_t i = f.word / rows_.tiles / rows_.inner;
                low = std::min(low, i), high = std::max(high, i + 1);
            }
            const int64_t rows = Tiles::in_rows(reach, G::height);
            low = std::max<int64_t>(1, low - rows), high = std::min(rows_.outer - 1, high + rows);
        }
        const int64_t from = low - 1, to = high + 1;
        near_.clear(from, to), core_.clear(from, to);
        if (whole) {
            for (int64_t r = 0; r < rows_.count(); ++r)
                for (auto* set : {&near_, &core_})
                    if (!rows_.on_frame(r)) set->add(r, 1, rows_.tiles - 2);
        } else {
            mark(near_, front, reach, from, to);
            mark(core_, front, inner, from, to);
        }
        outside_.complement(near_, from, to);
        beyond_.surround(outside_, from, to);
        is_shared_ = share != nullptr;
        if (share) {
            own_.take(near_, share->stretch, from, to);
            keep_about_own(core_, share->core_halo, from, to);
            keep_about_own(near_, share->halo, from, to);
        }
        stored_.surround(near_, from, to);
        rim_.surround(core_, from, to);
        enumerate(from * rows_.inner, to * rows_.inner, pool);
    }

    // Id of the tile at a place in the framed lattice; -1 if it is not stored.
    int32_t find(int64_t where) const {
        const int64_t r = where / rows_.tiles, b = where % rows_.tiles;
        if (r < first_row_ || r >= last_row_) return -1;
        const auto end = runs_.begin() + first_run_[r + 1];
        const auto run = std::partition_point(runs_.begin() + first_run_[r], end, [b](const Run& it) { return it.last < b; });
        return run == end || run->first > b ? -1 : run->id + static_cast<int32_t>(b - run->first);
    }

    const std::vector<int32_t>& own() const { return is_shared_ ? own_active_ : active; }
    const std::vector<int32_t>& own_core() const { return is_shared_ ? own_core_ : core; }
    bool is_own(int32_t id) const { return !is_shared_ || own_.has(word[id] / rows_.tiles, word[id] % rows_.tiles); }

    int32_t size() const { return static_cast<int32_t>(word.size()); }
    int64_t bytes() const {
        int64_t n = static_cast<int64_t>(8 * (word.capacity() + first_site.capacity()) + is_active.capacity() +
                                         is_frame.capacity() + is_core_or_rim.capacity());
        for (const auto* v : {&active, &core, &rim, &outer, &plane_ends, &first_run_, &own_active_, &own_core_})
            n += static_cast<int64_t>(4 * v->capacity());
        for (const auto& v : rows_beside_) n += static_cast<int64_t>(4 * v.capacity());
        return n;
    }
    Beside beside() const { return beside_; }
    int32_t beside(int row, int32_t id) const { return row ? rows_beside_[row][id] : id; }

    std::vector<int64_t> word;        // place of the tile in the framed lattice
    std::vector<uint8_t> is_active;
    std::vector<uint8_t> is_frame;
    std::vector<int32_t> active, core;
    std::vector<uint8_t> is_core_or_rim;
    std::vector<int32_t> rim;    // tiles next to the core but not in it
    std::vector<int32_t> outer;  // owned tiles next to a tile (not of the frame) that is active on no rank
    std::vector<int64_t> first_site;  // site number of lane 0
    std::vector<int32_t> plane_ends;  // for each plane of the first axis, the id after its last tile

   private:
    struct Run {
        int64_t first, last;  // tiles
        int32_t id;           // id of the first tile
    };

    using Tiles = TileSet<D>;

    void keep_about_own(Tiles& set, int64_t hops, int64_t from, int64_t to) {
        Tiles& about = stored_;  // used as scratch memory, as it has not been built yet
        about.near_to(own_, hops, set, from, to);
        std::swap(about, set);
    }

    // Row offset along the first axis, and how many sites to the left and right can be reached there.
    struct Along {
        int64_t rows, left, right;
    };

    // Return the rows and sites within `reach` hops of sites at these places of a tile along the first axis, at any place along
    // the second. A step (+-e_i or e_i - e_j) adds at most 1 to the sum of positive and of negative components, so forward steps
    // along one axis use up the reach forward along the others, and likewise backward.
    static std::vector<Along> stretches(int places, int64_t reach) {
        std::vector<Along> found;
        for (int64_t rows = -Tiles::in_rows(reach, G::height); rows <= Tiles::in_rows(reach, G::height); ++rows) {
            int64_t left = -1, right = -1;
            for (int from = 0; from < G::height; ++from)
                for (int to = 0; to < G::height; ++to) {
                    const int64_t up = rows * G::height + to - from;
                    if (!(places >> from & 1) || std::abs(up) > reach) continue;
                    left = std::max(left, reach + std::min<int64_t>(up, 0));
                    right = std::max(right, reach - std::max<int64_t>(up, 0));
                }
            if (left >= 0) found.push_back({rows, left, right});
        }
        return found;
    }

    void mark(Tiles& set, const std::vector<Front>& front, int64_t reach, int64_t from, int64_t to) {
        std::vector<Along> by_places[1 << G::height];
        for (int places = 1; places < 1 << G::height; ++places) by_places[places] = stretches(places, reach);
        for (const Front& f : front) {
            const int64_t row = f.word / rows_.tiles, tile = f.word - row * rows_.tiles, plane = row / rows_.inner;
            for (const Along& s : by_places[f.first]) {
                if (plane + s.rows < 1 || plane + s.rows > rows_.outer - 2) continue;
                const int64_t left = (f.low - s.left - (kPlaces - 1)) / kPlaces, right = (f.high + s.right) / kPlaces;
                set.add(row + s.rows * rows_.inner, std::max<int64_t>(1, tile + left), std::min(rows_.tiles - 2, tile + right));
            }
        }
        set.widen(0, Tiles::in_rows(reach, G::depth), from, to);
        set.drop_frame(from, to);
    }

    void enumerate(int64_t first, int64_t last, Pool& pool) {
        first_row_ = first, last_row_ = last;
        runs_.clear(), plane_ends.clear();
        int64_t n = 0;
        for (int64_t r = first; r < last; ++r) {
            first_run_[r] = static_cast<int32_t>(runs_.size());
            n = find_runs(r, n);
            if ((r + 1) % rows_.inner == 0) plane_ends.push_back(static_cast<int32_t>(n));
            if (n >= kMostTiles) throw std::length_error("the front is too large: more than 2^26 tiles of 32 sites");
        }
        first_run_[last] = static_cast<int32_t>(runs_.size());
        word.resize(n), first_site.resize(n), is_active.resize(n), is_frame.resize(n), is_core_or_rim.resize(n);
        for (int k = 1; k < G::rows; ++k) {
            rows_beside_[k].resize(n);
            beside_[k] = rows_beside_[k].data();
        }
        const int parts = pool.pieces(n);
        std::vector<Lists> lists(parts);
        pool.each(parts, [&](int i) {
            const int64_t from = first + (last - first) * i / parts, to = first + (last - first) * (i + 1) / parts;
            for (int64_t r = from; r < to; ++r) describe_row(r, first, last, lists[i]);
        });
        active.clear(), core.clear(), rim.clear(), outer.clear(), own_active_.clear(), own_core_.clear();
        for (const Lists& some : lists) {
            active.insert(active.end(), some.active.begin(), some.active.end());
            core.insert(core.end(), some.core.begin(), some.core.end());
            rim.insert(rim.end(), some.rim.begin(), some.rim.end());
            outer.insert(outer.end(), some.outer.begin(), some.outer.end());
        }
        if (!is_shared_) return;
        std::copy_if(active.begin(), active.end(), std::back_inserter(own_active_), [&](int32_t id) { return is_own(id); });
        std::copy_if(core.begin(), core.end(), std::back_inserter(own_core_), [&](int32_t id) { return is_own(id); });
    }

    static constexpr int64_t kMostTiles = int64_t{1} << 26;  // so that sites have 31-bit numbers

    struct Lists {
        std::vector<int32_t> active, core, rim, outer;
    };

    void describe_row(int64_t r, int64_t first, int64_t last, Lists& lists) {
        for (int32_t i = first_run_[r]; i < first_run_[r + 1]; ++i) describe(r, runs_[i], lists);
        for (int k = 1; k < G::rows; ++k) {
            const int64_t other = r + rows_.stride(k);
            if (other >= first && other < last) join(r, other, rows_beside_[k]);
        }
    }

    // Find the runs of consecutive tiles in a row and number the tiles from n; return the next number.
    int64_t find_runs(int64_t r, int64_t n) {
        const uint64_t* bits = stored_.row(r);
        for (int64_t w = 0; w < stored_.words(); ++w) {
            uint64_t left = bits[w];
            while (left) {
                const int first = __builtin_ctzll(left);
                const uint64_t gone = ~(left >> first);
                const int count = gone ? __builtin_ctzll(gone) : 64 - first;
                const int64_t tile = 64 * w + first;
                const bool goes_on = first == 0 && static_cast<int32_t>(runs_.size()) > first_run_[r] &&
                                     runs_.back().last == tile - 1;
                if (goes_on)
                    runs_.back().last += count;
                else
                    runs_.push_back({tile, tile + count - 1, static_cast<int32_t>(n)});
                n += count;
                left = first + count >= 64 ? 0 : left & ~uint64_t{0} << (first + count);
            }
        }
        return n;
    }

    void describe(int64_t r, const Run& run, Lists& lists) {
        const bool row_on_frame = rows_.on_frame(r);
        const int64_t row_word = r * rows_.tiles, row_site = rows_.first_site(r) - kPlaces;
        const uint64_t *near = near_.row(r), *core_bits = core_.row(r), *rim_bits = rim_.row(r), *beyond = beyond_.row(r);
        int32_t id = run.id;
        for (int64_t b = run.first; b <= run.last; ++b, ++id) {
            const auto in = [b](const uint64_t* bits) { return static_cast<uint8_t>(bits[b >> 6] >> (b & 63) & 1); };
            word[id] = row_word + b;
            first_site[id] = row_site + b * kPlaces;
            is_frame[id] = row_on_frame || b == 0 || b == rows_.tiles - 1;
            is_active[id] = in(near);
            is_core_or_rim[id] = in(rim_bits);
            if (in(rim_bits) && !in(core_bits)) lists.rim.push_back(id);
            if (!in(near)) continue;
            lists.active.push_back(id);
            if (in(core_bits)) lists.core.push_back(id);
            if (in(beyond) && is_own(id)) lists.outer.push_back(id);
        }
    }

    // Store, for each tile of row r, the id of the tile beside it in row `other`.
    void join(int64_t r, int64_t other, std::vector<int32_t>& out) {
        int32_t b = first_run_[other];
        for (int32_t a = first_run_[r]; a < first_run_[r + 1]; ++a) {
            while (b < first_run_[other + 1] && runs_[b].last < runs_[a].first) ++b;
            for (int32_t c = b; c < first_run_[other + 1] && runs_[c].first <= runs_[a].last; ++c) {
                const int64_t low = std::max(runs_[a].first, runs_[c].first), high = std::min(runs_[a].last, runs_[c].last);
                for (int64_t tile = low; tile <= high; ++tile)
                    out[runs_[a].id + (tile - runs_[a].first)] = runs_[c].id + static_cast<int32_t>(tile - runs_[c].first);
            }
        }
    }

    Rows<D> rows_;
    Tiles near_, core_, own_, stored_, rim_, outside_, beyond_;
    bool is_shared_ = false;
    std::vector<int32_t> own_active_, own_core_;
    int64_t first_row_ = 0, last_row_ = 0;
    std::vector<int32_t> first_run_;
    std::vector<Run> runs_;
    std::array<std::vector<int32_t>, kMaxRows> rows_beside_;
    const int32_t* beside_[kMaxRows] = {};
};

}  // namespace cicatrix

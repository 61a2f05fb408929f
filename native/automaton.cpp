#include "automaton.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>
#include <string>
#include <tuple>

#include "band.hpp"
#include "kernels.hpp"
#include "philox.hpp"
#include "pool.hpp"

namespace cicatrix {
namespace {

enum Phase : uint32_t { kEdgeDivision, kMotilityTie, kLayerDivision, kPathCost, kRedistributionTie, kSettle };

constexpr uint32_t kHopCost = 64, kSettleCost = 48;
constexpr size_t kTilesPerPiece = 1024;  // less is not worth a thread's while
constexpr size_t kTilesPerWave = 64;     // some of them fit into the first cache, with all their sub-steps

// The band was too narrow for the step to be exact: the step is done again in a wider one.
struct TooNarrow {};

inline uint32_t below(uint32_t word, uint64_t n) { return static_cast<uint32_t>((uint64_t{word} * n) >> 32); }

// Integer form of a probability: an event happens where word < threshold.
inline uint64_t threshold(double p) { return static_cast<uint64_t>(std::floor(p * 4294967296.0)); }

inline int popcount(uint32_t x) {  // the baseline of x86-64 has no instruction for it
    x -= x >> 1 & 0x55555555u;
    x = (x & 0x33333333u) + (x >> 2 & 0x33333333u);
    return static_cast<int>(((x + (x >> 4)) & 0x0F0F0F0Fu) * 0x01010101u >> 24);
}

using Site = uint32_t;  // id * 32 + lane

// One random word per site of a list, four sites to a call of the generator.
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

template <int D>
class Core final : public AutomatonCore {
    using G = Geometry<D>;

   public:
    Core(const std::vector<int64_t>& shape, const uint8_t* fillable, const uint8_t* occupied, const Rules& rules,
         int64_t step, int threads, const Kernels& kernels)
        : rows_(shape), rules_(rules), key_{static_cast<uint32_t>(rules.seed), static_cast<uint32_t>(rules.seed >> 32)},
          kernels_(kernels), by_(kernels.dimension[D - 2]), pool_(threads), fillable_(rows_.count() * rows_.tiles),
          occupied_(fillable_.size()), band_(rows_), step_(step) {
        read(fillable, fillable_);
        read(occupied, occupied_);
        for (size_t i = 0; i < fillable_.size(); ++i) {
            n_fillable_ += popcount(fillable_[i]);
            n_cells_ += popcount(occupied_[i]);
        }
        find_front();
    }

    Counts advance(const double* W, bool per_site, double W_ref) override {
        W_ = W, W_per_site_ = per_site, W_ref_ = W_ref;
        Counts counts;
        if (n_open() > 0) {
            int64_t reach = first_reach();
            for (bool whole = false;; whole = reach > longest() || too_flat_) {
                too_flat_ = false;
                try {
                    counts = step_within(reach, whole);
                    break;
                } catch (const TooNarrow&) {
                    if (whole) throw InvariantFault("the whole lattice was called too narrow for a step of the automaton");
                    reach = 2 * reach;
                }
            }
        }
        step_ += 1;
        return counts;
    }

    void occupancy(uint8_t* out) const override {
        for (int64_t n = 0; n < rows_.n_lines(); ++n) {
            const uint32_t* row = occupied_.data() + rows_.row_of_line(n) * rows_.tiles;
            for (int64_t tile = 1; tile < rows_.tiles - 1; ++tile)
                *out++ = static_cast<uint8_t>(row[tile] >> kPlaces * rows_.line_of_tile(n));
        }
    }

    int64_t n_cells() const override { return n_cells_; }
    int64_t n_open() const override { return n_fillable_ - n_cells_; }
    int64_t step() const override { return step_; }
    Work work() const override {
        Work work = work_;
        work.stored_tiles = band_.size(), work.active_tiles = static_cast<int64_t>(band_.active.size());
        work.bytes = band_.bytes();
        for (const auto* v : {&fillable_, &occupied_, &cells_, &fill_, &free_, &zone_[0], &zone_[1], &layer_bits_,
                              &scratch_, &above_, &equal_, &stamp_})
            work.bytes += static_cast<int64_t>(4 * v->capacity());
        for (const auto* v : {&density_[0], &density_[1], &own_, &cost_, &distance_})
            work.bytes += static_cast<int64_t>(2 * v->capacity());
        return work;
    }

   private:
    // ---------------------------------------------------------------- the lattice

    // A byte of a line of sites is a line of a tile.
    void read(const uint8_t* in, std::vector<uint32_t>& bits) const {
        for (int64_t n = 0; n < rows_.n_lines(); ++n) {
            uint32_t* row = bits.data() + rows_.row_of_line(n) * rows_.tiles;
            for (int64_t tile = 1; tile < rows_.tiles - 1; ++tile) row[tile] |= uint32_t{*in++} << kPlaces * rows_.line_of_tile(n);
        }
    }

    // Hops beyond the front that a step works on: the densities that change, and the layer, should the front not move by more
    // than two hops. Where it does, that is noticed.
    int64_t first_reach() const {
        const int64_t zone = rules_.level_set ? std::max(rules_.layer_sites, rules_.substeps) : rules_.layer_sites;
        return std::max(core_reach() + 1, zone + 3);
    }

    int64_t core_reach() const { return (rules_.level_set ? 2 : 1) * rules_.substeps + 1; }

    int64_t longest() const { return std::max({rows_.across[0], rows_.across[1], rows_.width}); }

    uint32_t free_word(int64_t word) const { return fillable_[word] & ~occupied_[word]; }

    // Tiles with a free site that do not lie in the midst of free ones: a few too many, for the first step only.
    void find_front() {
        front_.clear();
        for (int64_t row = 0; row < rows_.count(); ++row) {
            if (rows_.on_frame(row)) continue;
            for (int64_t word = row * rows_.tiles + 1; word < (row + 1) * rows_.tiles - 1; ++word) {
                if (!free_word(word)) continue;
                uint32_t all = ~0u;
                for (int k = 0; k < G::rows; ++k)
                    for (int right = -1; right <= 1; ++right) all &= free_word(word + rows_.stride(k) * rows_.tiles + right);
                if (~all) front_.push_back({word, 0, kPlaces - 1});
            }
        }
    }

    static void note_front(int64_t word, uint32_t edge, std::vector<Front>& front) {
        if (!edge) return;
        const uint32_t places = (edge | edge >> 8 | edge >> 16 | edge >> 24) & 0xFF;
        front.push_back({word, __builtin_ctz(places), 31 - __builtin_clz(places)});
    }

    // ---------------------------------------------------------------- one step

    Counts step_within(int64_t reach, bool whole) {
        is_whole_ = whole;
        band_.build(front_, reach, core_reach(), whole, pool_);
        load();
        Counts counts;
        counts.edge = divide_at_edge();
        move();
        find_layer(rules_.layer_sites);
        work_.layer_cells = count_bits(layer_, layer_bits());
        const std::vector<Site> parents = divide_in_layer(counts.clamped);
        if (!parents.empty()) {
            const int64_t before = n_occupied();
            rules_.level_set ? level_set(parents) : route(parents);
            counts.layer = n_occupied() - before;
            counts.dropped = static_cast<int64_t>(parents.size()) - counts.layer;
        }
        write_back(counts);
        return counts;
    }

    // Sites of the band, in tiles: cells, sites that can be filled, free sites.
    void load() {
        const size_t n = band_.size();
        cells_.resize(n + 2), fill_.resize(n + 2), free_.resize(n + 2), scratch_.resize(n + 2);
        ranges(n, [&](int, size_t first, size_t last) {
            for (size_t id = first; id < last; ++id) {
                const int64_t word = band_.word[id];
                cells()[id] = occupied_[word], fill()[id] = fillable_[word];
                free()[id] = fill()[id] & ~cells()[id];
            }
        });
    }

    uint32_t* cells() { return cells_.data() + 1; }
    uint32_t* fill() { return fill_.data() + 1; }
    uint32_t* free() { return free_.data() + 1; }

    int64_t n_occupied() { return count_bits(band_.active, cells()); }

    int64_t count_bits(const std::vector<int32_t>& ids, const uint32_t* bits) const {
        return kernels_.count_bits(Ids{ids.data(), ids.size()}, bits);
    }

    Draw random(Phase phase) const {
        return {band_.first_site.data(), {lines_[0], lines_[1], lines_[2], lines_[3]}, static_cast<uint32_t>(step_), phase,
                {key_[0], key_[1]}};
    }

    uint64_t number(Site site) const {
        return band_.first_site[site >> 5] + lines_[(site & 31) / kPlaces] + site % kPlaces;
    }

    // All neighbours of a site, in the order of the specification.
    struct Around {
        Site site[G::directions];
        const Site* begin() const { return site; }
        const Site* end() const { return site + G::directions; }
    };

    Around around(Site site) const {
        const int32_t id = site >> 5;
        if (!band_.is_active[id]) throw TooNarrow();
        int32_t tile[G::rows];
        for (int k = 0; k < G::rows; ++k) tile[k] = band_.beside(k, id);
        Around out;
        for (int k = 0; k < G::directions; ++k) {
            const Move& move = moves_[site & 31][k];
            out.site[k] = static_cast<Site>((tile[move.row] + move.right) * kLanes + move.lane);
        }
        return out;
    }

    // Where a direction leads from a lane: row offset, tiles to the right, lane there.
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

    static bool has(const uint32_t* bits, Site site) { return bits[site >> 5] >> (site & 31) & 1; }

    void settle_at(Site site) {
        cells()[site >> 5] |= 1u << (site & 31);
        free()[site >> 5] &= ~(1u << (site & 31));
    }

    // Share out 0 .. n - 1: job(piece number, first, last).
    template <class Job>
    void ranges(size_t n, Job&& job) {
        const size_t most = pool_.threads() == 1 ? 1 : most_pieces();
        const int used = static_cast<int>(std::max<size_t>(1, std::min(most, n / kTilesPerPiece)));
        pool_.each(used, [&](int i) { job(i, n * i / used, n * (i + 1) / used); });
    }

    // Share out a list of tiles: job(piece number, ids).
    template <class Job>
    void pieces(const std::vector<int32_t>& ids, Job&& job) {
        ranges(ids.size(), [&](int i, size_t first, size_t last) { job(i, Ids{ids.data() + first, last - first}); });
    }

    // What each piece finds among these tiles, one after the other: find(id, list).
    template <class T, class Find>
    void collect(const std::vector<int32_t>& ids, std::vector<T>& all, Find&& find) {
        std::vector<std::vector<T>> parts(most_pieces());
        pieces(ids, [&](int i, Ids some) {
            for (size_t k = 0; k < some.count; ++k) find(some.first[k], parts[i]);
        });
        all.clear();
        for (const auto& part : parts) all.insert(all.end(), part.begin(), part.end());
    }

    int most_pieces() const { return 4 * pool_.threads(); }

    // ---------------------------------------------------------------- edge division

    int64_t divide_at_edge() {
        std::vector<std::vector<Site>> targets(most_pieces());
        const uint64_t limit = threshold(rules_.p_edge);
        if (limit > 0) pieces(band_.core, [&](int i, Ids ids) { edge_targets(ids, limit, targets[i]); });
        int64_t n = 0;
        work_.edge_cells = count_bits(band_.core, scratch());
        for (const auto& part : targets)
            for (Site site : part)
                if (!has(cells(), site)) settle_at(site), ++n;
        return n;
    }

    void edge_targets(Ids ids, uint64_t limit, std::vector<Site>& targets) {
        by_.touching(ids, band_.beside(), cells(), free(), scratch());
        std::vector<uint64_t> numbers;
        std::vector<std::pair<Site, uint32_t>> sites;  // and its free neighbours, one bit for each direction
        for (size_t i = 0; i < ids.count; ++i)
            for (uint32_t left = scratch()[ids.first[i]]; left; left &= left - 1) {
                const Site site = static_cast<Site>(ids.first[i]) * kLanes + __builtin_ctz(left);
                uint32_t directions = 0, bit = 1;
                for (Site other : around(site)) directions |= has(free(), other) ? bit : 0, bit <<= 1;
                if (popcount(directions) < rules_.min_free) continue;
                sites.emplace_back(site, directions);
                numbers.push_back(number(site));
            }
        std::vector<uint32_t> words(4 * numbers.size());
        kernels_.philox(numbers.data(), numbers.size(), static_cast<uint32_t>(step_), kEdgeDivision, key_, words.data());
        for (size_t i = 0; i < sites.size(); ++i) {
            if (words[4 * i] >= limit) continue;
            uint32_t directions = sites[i].second;
            for (uint32_t skip = below(words[4 * i + 1], popcount(directions)); skip; --skip) directions &= directions - 1;
            targets.push_back(around(sites[i].first).site[__builtin_ctz(directions)]);
        }
    }

    // ---------------------------------------------------------------- motility

    void move() {
        if (rules_.substeps == 0) return;
        const int64_t count = count_bits(band_.core, cells());
        if (count == 0) return;
        const uint16_t* u = diffuse();
        const auto [level, above] = level_of(u, count);
        if (!is_whole_ && !(0 < level && level < G::bulk)) {
            too_flat_ = true;
            throw TooNarrow();
        }
        keep_level(u, level, count - above);
    }

    // Integer density after all sub-steps, in the core of the band and right beside it.
    const uint16_t* diffuse() {
        const size_t n = kLanes * (band_.size() + 2);
        density_[0].resize(n), density_[1].resize(n);
        uint16_t* u[2] = {density_[0].data() + kLanes, density_[1].data() + kLanes};
        pieces(band_.rim, [&](int, Ids ids) {
            kernels_.expand(ids, cells(), G::bulk, u[0]);
            kernels_.expand(ids, cells(), G::bulk, u[1]);
        });
        find_plain();
        auto sub_step = [&](int64_t i, Ids ids) {
            const uint16_t* own = own_.data() + kLanes;
            if (i == 0)
                by_.start(ids, band_.beside(), plain_.data(), own, fill(), cells(), u[1]);
            else
                by_.diffuse(ids, band_.beside(), plain_.data(), own, fill(), u[i & 1], u[(i + 1) & 1]);
        };
        if (pool_.threads() == 1)
            in_waves(sub_step);
        else
            for (int64_t i = 0; i < rules_.substeps; ++i) pieces(band_.core, [&](int, Ids ids) { sub_step(i, ids); });
        return u[rules_.substeps & 1];
    }

    // All sub-steps while the planes they need are in the cache: plane p does sub-step i when plane p + 1 has done i - 1.
    template <class SubStep>
    void in_waves(SubStep&& sub_step) {
        const std::vector<size_t> cuts = slabs(band_.core, kTilesPerWave);
        const int64_t n = static_cast<int64_t>(cuts.size()) - 1;
        for (int64_t wave = 0; wave < n + rules_.substeps - 1; ++wave)
            for (int64_t i = std::max<int64_t>(0, wave - n + 1); i <= std::min(wave, rules_.substeps - 1); ++i) {
                const size_t first = cuts[wave - i], last = cuts[wave - i + 1];
                sub_step(i, Ids{band_.core.data() + first, last - first});
            }
    }

    // Blocks around which every site can be filled need no weights of their own.
    void find_plain() {
        plain_.resize(band_.size());
        std::vector<uint8_t> all(most_pieces(), 1);
        pieces(band_.core, [&](int i, Ids ids) {
            for (size_t n = 0; n < ids.count; ++n) {
                uint32_t full = ~0u;
                for (int k = 0; k < G::rows; ++k) {
                    const uint32_t* here = fill() + band_.beside(k, ids.first[n]);
                    full &= here[-1] & here[0] & here[1];
                }
                plain_[ids.first[n]] = full == ~0u;
                all[i] &= full == ~0u;
            }
        });
        if (std::all_of(all.begin(), all.end(), [](uint8_t a) { return a != 0; })) return;
        own_.resize(kLanes * (band_.size() + 2));
        pieces(band_.core, [&](int, Ids ids) {
            by_.weigh(ids, band_.beside(), plain_.data(), fill(), own_.data() + kLanes);
        });
    }

    // The level U0 that `count` fillable sites of the core reach, and how many lie above it: by bisection.
    std::pair<uint16_t, int64_t> level_of(const uint16_t* u, int64_t count) {
        mixed_.resize(band_.core.size());
        int64_t n_bulk = 0;
        mixed_.resize(kernels_.mixed(Ids{band_.core.data(), band_.core.size()}, u, G::bulk, mixed_.data(), &n_bulk));
        work_.mixed_sites = kLanes * static_cast<int64_t>(mixed_.size());
        auto from = [&](uint32_t level) {
            std::vector<int64_t> parts(most_pieces(), 0);
            pieces(mixed_, [&](int i, Ids ids) { parts[i] = kernels_.count_from(ids, u, static_cast<uint16_t>(level)); });
            return std::accumulate(parts.begin(), parts.end(), kLanes * n_bulk);
        };
        uint32_t low = 0, high = G::bulk + 1;  // from(low) >= count > from(high)
        int64_t above = 0;
        while (high - low > 1) {
            const uint32_t middle = (low + high) / 2;
            const int64_t reached = from(middle);
            if (reached >= count)
                low = middle;
            else
                high = middle, above = reached;
        }
        return {static_cast<uint16_t>(low), above};
    }

    // The same from a histogram.
    static std::pair<uint16_t, int64_t> level_of(const std::vector<uint32_t>& histogram, int64_t count) {
        int64_t above = 0;
        for (size_t level = histogram.size(); level-- > 0;) {
            if (above + histogram[level] >= count) return {static_cast<uint16_t>(level), above};
            above += histogram[level];
        }
        throw InvariantFault("the automaton looked for more cells than there are sites");
    }

    // Cells sit where U > level, and at `wanted` of the sites at the level.
    void keep_level(const uint16_t* u, uint16_t level, int64_t wanted) {
        above_.resize(band_.size()), equal_.resize(band_.size());
        pieces(band_.core, [&](int, Ids ids) { kernels_.compare(ids, u, level, above_.data(), equal_.data()); });
        words_.clear();
        for (int32_t id : band_.core) {
            cells()[id] = above_[id] & fill()[id];
            free()[id] = fill()[id] & ~cells()[id];
            for (uint32_t left = equal_[id] & fill()[id]; left; left &= left - 1)
                add_word(static_cast<Site>(id) * kLanes + __builtin_ctz(left));
        }
        for (Site site : first_of(kMotilityTie, wanted)) settle_at(site);
    }

    void add_word(Site site) { words_.add(site, number(site)); }

    // The `wanted` sites in words_ with the least (word, number).
    std::vector<Site> first_of(Phase phase, int64_t wanted) {
        std::vector<Site> first;
        if (wanted >= static_cast<int64_t>(words_.size())) {
            for (size_t i = 0; i < words_.size(); ++i) first.push_back(words_.site(i));
            return first;
        }
        words_.draw(kernels_, step_, phase, key_);
        std::vector<std::tuple<uint32_t, uint64_t, Site>> order(words_.size());
        for (size_t i = 0; i < order.size(); ++i) order[i] = {words_.word(i), number(words_.site(i)), words_.site(i)};
        std::nth_element(order.begin(), order.begin() + wanted, order.end());
        for (int64_t i = 0; i < wanted; ++i) first.push_back(std::get<2>(order[i]));
        return first;
    }

    // ---------------------------------------------------------------- layer division

    // Sites within some hops of a free one, whatever lies between.
    void find_zone(int64_t hops) {
        zone_[0] = free_, zone_[1] = free_;
        for (int64_t i = 0; i < hops; ++i) {
            pieces(band_.active, [&](int, Ids ids) {
                by_.dilate(ids, band_.beside(), zone_[0].data() + 1, zone_[1].data() + 1);
            });
            std::swap(zone_[0], zone_[1]);
        }
        for (int32_t id : band_.outer)  // what would spread from here to tiles that are not active
            require_inside(id, zone_[0][id + 1] & ~free()[id]);
    }

    // All neighbours of these sites of a tile lie in active tiles, or beyond the lattice.
    void require_inside(int32_t id, uint32_t sites) const {
        for (; sites; sites &= sites - 1)
            for (const Move& move : moves_[__builtin_ctz(sites)])
                if (leads_out(band_.beside(move.row, id) + move.right)) throw TooNarrow();
    }

    bool leads_out(int32_t id) const { return !band_.is_active[id] && !band_.is_frame[id]; }

    void find_layer(int64_t hops) {
        find_zone(hops);
        layer_bits_.assign(band_.size() + 2, 0);
        collect(band_.active, layer_, [&](int32_t id, std::vector<int32_t>& found) {
            if (const uint32_t bits = zone_[0][id + 1] & cells()[id]) {
                found.push_back(id);
                layer_bits()[id] = bits;
            }
        });
    }

    uint32_t* layer_bits() { return layer_bits_.data() + 1; }
    uint32_t* scratch() { return scratch_.data() + 1; }

    std::vector<Site> divide_in_layer(int64_t& n_clamped) {
        std::vector<Site> parents;
        n_clamped = 0;
        if (rules_.p_layer == 0.0 || layer_.empty()) return parents;
        if (W_per_site_) return divide_by_site(n_clamped);
        const uint64_t limit = limit_at(*W_, n_clamped, count_bits(layer_, layer_bits()));
        if (limit == 0) return parents;
        pieces(layer_, [&](int, Ids ids) { kernels_.draw(ids, random(kLayerDivision), layer_bits(), limit, scratch()); });
        collect(layer_, parents, [&](int32_t id, std::vector<Site>& found) { add_sites(id, scratch()[id], found); });
        return parents;
    }

    static void add_sites(int32_t id, uint32_t bits, std::vector<Site>& sites) {
        for (; bits; bits &= bits - 1) sites.push_back(static_cast<Site>(id) * kLanes + __builtin_ctz(bits));
    }

    std::vector<Site> divide_by_site(int64_t& n_clamped) {
        std::vector<Site> parents;
        words_.clear();
        for (int32_t id : layer_)
            for (uint32_t left = layer_bits()[id]; left; left &= left - 1)
                add_word(static_cast<Site>(id) * kLanes + __builtin_ctz(left));
        words_.draw(kernels_, step_, kLayerDivision, key_);
        for (size_t i = 0; i < words_.size(); ++i)
            if (words_.word(i) < limit_at(W_[number(words_.site(i))], n_clamped, 1)) parents.push_back(words_.site(i));
        return parents;
    }

    // The operations and their order are those of the twin, so that the bits are.
    uint64_t limit_at(double W, int64_t& n_clamped, int64_t n_sites) const {
        const double p = rules_.p_layer * (1.0 + rules_.feedback * W / W_ref_);
        if (p > 1.0) n_clamped += n_sites;
        return threshold(std::min(std::max(p, 0.0), 1.0));
    }

    // ---------------------------------------------------------------- redistribution along paths

    void route(const std::vector<Site>& parents) {
        open_paths();
        relax_layer();
        std::vector<Site> tokens(parents);
        ranges(tokens.size(), [&](int, size_t first, size_t last) {
            for (size_t i = first; i < last; ++i) tokens[i] = distance()[tokens[i]] < kFar ? descend(tokens[i]) : kNowhere;
        });
        tokens.erase(std::remove(tokens.begin(), tokens.end(), kNowhere), tokens.end());
        pieces(layer_, [&](int, Ids ids) { clear(ids, distance()); });
        for (tokens = land(tokens); !tokens.empty(); tokens = land(tokens)) tokens = walk(tokens);
    }

    uint16_t* cost() { return cost_.data() + kLanes; }
    uint16_t* distance() { return distance_.data() + kLanes; }

    // Costs of the layer, prices of the empty sites beside it.
    void open_paths() {
        const size_t n = kLanes * (band_.size() + 2);
        cost_.resize(n), distance_.resize(n), stamp_.resize(n, 0);
        ranges(band_.size(), [&](int, size_t first, size_t last) {
            std::fill(cost() + kLanes * first, cost() + kLanes * last, kFar);
            std::fill(distance() + kLanes * first, distance() + kLanes * last, kFar);
        });
        pieces(layer_, [&](int, Ids ids) {
            kernels_.random_values(ids, random(kPathCost), layer_bits(), kHopCost, rules_.path_noise + 1, cost());
        });
        pieces(band_.active, [&](int, Ids ids) { by_.touching(ids, band_.beside(), free(), layer_bits(), scratch()); });
        collect(band_.active, shore_, [&](int32_t id, std::vector<int32_t>& found) {
            if (scratch()[id]) found.push_back(id);
        });
        work_.shore_sites = count_bits(shore_, scratch());
        pieces(shore_, [&](int, Ids ids) {
            kernels_.random_values(ids, random(kSettle), free(), kNoPath, kUnit, cost());
            by_.price(ids, band_.beside(), free(), scratch(), kUnit, cost(), distance());
        });
    }

    static void clear(Ids ids, uint16_t* values) {
        for (size_t i = 0; i < ids.count; ++i) std::fill_n(values + kLanes * size_t(ids.first[i]), kLanes, kFar);
    }

    static constexpr Site kNowhere = ~Site{0};
    static constexpr uint16_t kUnit = kSettleCost / G::directions;

    // The fewer cells beside an empty site, the dearer it is to settle there.
    void price(Site site) {
        if (cost()[site] == kFar) cost()[site] = static_cast<uint16_t>(kNoPath + below(word_at(site, kSettle), kUnit));
        uint32_t n_free = 0;
        for (Site other : around(site)) n_free += has(free(), other);
        distance()[site] = static_cast<uint16_t>(kUnit * n_free + cost()[site] - kNoPath);
    }

    uint32_t word_at(Site site, Phase phase) const {
        uint32_t words[4];
        const uint64_t group = number(site) >> 2;
        philox_block(static_cast<uint32_t>(group), static_cast<uint32_t>(group >> 32), static_cast<uint32_t>(step_), phase,
                     key_[0], key_[1], words);
        return words[number(site) & 3];
    }

    // Solve d = cost + least neighbour in the layer. Pieces are slabs of the first axis, so that every other one can be
    // worked on at once without reading what another writes; the solution is unique, whatever the order.
    void relax_layer() {
        dirty_.assign(band_.size() + 2, 0);
        for (int32_t id : layer_) dirty_[id + 1] = 1;
        const size_t size = std::max<size_t>(layer_.size() / (4 * pool_.threads()), kTilesPerPiece);
        const std::vector<size_t> cuts = slabs(layer_, pool_.threads() == 1 ? layer_.size() : size);
        const int n = static_cast<int>(cuts.size()) - 1;
        for (bool changed = true; changed;) {
            std::vector<uint8_t> moved(n, 0);
            for (int parity = 0; parity < 2; ++parity)
                pool_.each((n + 1 - parity) / 2, [&](int i) {
                    const int slab = 2 * i + parity;
                    const Ids ids{layer_.data() + cuts[slab], cuts[slab + 1] - cuts[slab]};
                    moved[slab] = by_.relax(ids, band_.beside(), cost(), distance(), dirty_.data() + 1);
                });
            changed = n > 1 && std::any_of(moved.begin(), moved.end(), [](uint8_t m) { return m != 0; });
        }
    }

    // Cut a list of tiles between planes of the first axis, into parts of at least `size` tiles.
    std::vector<size_t> slabs(const std::vector<int32_t>& ids, size_t size) const {
        std::vector<size_t> cuts{0};
        for (size_t i = 1; i < ids.size(); ++i)
            if (i - cuts.back() >= size && plane(ids[i]) > plane(ids[i - 1])) cuts.push_back(i);
        cuts.push_back(ids.size());
        return cuts;
    }

    int64_t plane(int32_t id) const { return band_.word[id] / rows_.tiles / rows_.inner; }

    // Walk to the neighbour of least distance, the first among equals, until the site is free.
    Site descend(Site site) {
        while (!has(free(), site)) {
            const Around others = around(site);
            Site best = others.site[0];
            for (Site other : others)
                if (distance()[other] < distance()[best]) best = other;
            site = best;
        }
        return site;
    }

    // One token of each site stays there; returns the others.
    std::vector<Site> land(std::vector<Site>& tokens) {
        std::sort(tokens.begin(), tokens.end());
        std::vector<Site> rest;
        for (size_t i = 0; i < tokens.size(); ++i) {
            if (i > 0 && tokens[i] == tokens[i - 1]) {
                rest.push_back(tokens[i]);
                continue;
            }
            const Site site = tokens[i];
            settle_at(site);
            cost()[site] = static_cast<uint16_t>(kHopCost + below(word_at(site, kPathCost), rules_.path_noise + 1));
            distance()[site] = kFar;
        }
        return rest;
    }

    // Move tokens to free sites, those without a path are dropped. The field is solved near the tokens only: a path that
    // leaves `reach` hops costs at least 64 (reach + 1), so smaller distances are exact; for the others it is doubled.
    std::vector<Site> walk(std::vector<Site> tokens) {
        std::vector<Site> done;
        for (int64_t reach = 2; !tokens.empty(); reach *= 2) {
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
                for (Site other : around(near_[ring]))
                    if (cost()[other] < kNoPath) add(other);
            }
        }
        return ring == near_.size();
    }

    void solve_near() {
        for (Site site : near_)
            for (Site other : around(site))
                if (has(free(), other)) price(other);
        for (bool changed = true; changed;) {
            changed = false;
            for (size_t i = near_.size(); i-- > 0;) {
                const Site site = near_[i];
                uint32_t best = kFar;
                for (Site other : around(site)) best = std::min<uint32_t>(best, distance()[other]);
                best += cost()[site];
                if (best < distance()[site]) distance()[site] = static_cast<uint16_t>(best), changed = true;
            }
        }
    }

    uint32_t* stamp() { return stamp_.data() + kLanes; }

    // ---------------------------------------------------------------- redistribution by level set

    // Diffuse, then keep the new number of cells in each connected piece of the sites around the wound.
    void level_set(const std::vector<Site>& parents) {
        find_zone(std::max(rules_.layer_sites, rules_.substeps));
        find_pieces();
        for (Site site : parents) ++wounds_[run_at(site).wound].n_new;
        const uint16_t* u = diffuse();
        for (const Run& run : runs_)
            if (Wound& wound = wounds_[run.wound]; wound.n_new) tally(run, u, wound);
        for (Wound& wound : wounds_) {
            if (!wound.n_new) continue;
            const int64_t wanted = std::min(wound.n_cells + wound.n_new, wound.n_sites);
            const auto [level, above] = level_of(wound.histogram, wanted);
            wound.level = level, wound.wanted = wanted - above;
            if (level == 0 && wound.n_far > 0) {
                too_flat_ = true;
                throw TooNarrow();
            }
        }
        for (const Run& run : runs_)
            if (Wound& wound = wounds_[run.wound]; wound.n_new) keep_above(run, u, wound);
        for (Wound& wound : wounds_) {
            words_.clear();
            for (Site site : wound.ties) add_word(site);
            for (Site site : first_of(kRedistributionTie, wound.wanted)) settle_at(site);
        }
    }

    // Neighbouring sites of one line, first .. last - 1, that belong to a piece.
    struct Run {
        int64_t line, first, last;
        int32_t wound;
    };

    struct Wound {
        int64_t n_new = 0, n_cells = 0, n_sites = 0, n_far = 0, wanted = 0;
        uint16_t level = 0;
        std::vector<uint32_t> histogram;
        std::vector<Site> ties;
    };

    // Tiles outside the band hold free sites only, or none.
    void find_pieces() {
        slot_.assign(occupied_.size(), -1);
        for (int32_t id : band_.active) slot_[band_.word[id]] = id;
        runs_.clear(), first_run_.clear();
        for (int64_t line = 0; line < rows_.n_lines(); ++line) {
            first_run_.push_back(static_cast<int32_t>(runs_.size()));
            add_runs(line);
        }
        first_run_.push_back(static_cast<int32_t>(runs_.size()));
        join_runs();
    }

    void add_runs(int64_t line) {
        for (int64_t tile = 1; tile < rows_.tiles - 1; ++tile) {
            const int64_t word = rows_.row_of_line(line) * rows_.tiles + tile;
            const int32_t id = slot_[word];
            const uint32_t bits = id < 0 ? free_word(word) : zone_[0][id + 1] & fill()[id];
            uint32_t places = bits >> kPlaces * rows_.line_of_tile(line) & 0xFF;
            for (; places; places &= places - 1) {
                const int64_t at = (tile - 1) * kPlaces + __builtin_ctz(places);
                const bool goes_on = static_cast<int32_t>(runs_.size()) > first_run_[line] && runs_.back().last == at;
                if (goes_on)
                    ++runs_.back().last;
                else
                    runs_.push_back({line, at, at + 1, 0});
            }
        }
    }

    void join_runs() {
        std::vector<int32_t> parent(runs_.size());
        for (size_t i = 0; i < parent.size(); ++i) parent[i] = static_cast<int32_t>(i);
        auto root = [&](int32_t i) {
            while (parent[i] != i) i = parent[i] = parent[parent[i]];
            return i;
        };
        for (size_t i = 0; i < runs_.size(); ++i)
            for (const Direction& d : G::neighbour) {
                const int64_t line = runs_[i].line, second = line % rows_.across[1] + d.second;
                const int64_t other = line + d.first * rows_.across[1] + d.second;
                if (other < 0 || other >= line || second < 0 || second >= rows_.across[1]) continue;
                for (int32_t j = first_run_[other]; j < first_run_[other + 1]; ++j)
                    if (runs_[j].first < runs_[i].last + d.last && runs_[j].last > runs_[i].first + d.last)
                        parent[root(static_cast<int32_t>(i))] = root(j);
            }
        wounds_.clear();
        std::vector<int32_t> name(runs_.size(), -1);
        for (size_t i = 0; i < runs_.size(); ++i) {
            int32_t& here = name[root(static_cast<int32_t>(i))];
            if (here < 0) here = static_cast<int32_t>(wounds_.size()), wounds_.emplace_back();
            runs_[i].wound = here;
            wounds_[here].n_sites += runs_[i].last - runs_[i].first;
        }
    }

    const Run& run_at(Site site) const {
        const int64_t line = number(site) / rows_.width, at = number(site) % rows_.width;
        const auto end = runs_.begin() + first_run_[line + 1];
        return *std::find_if(runs_.begin() + first_run_[line], end, [at](const Run& run) { return at < run.last; });
    }

    // Call job(site) for every site of a run that lies in an active tile; returns how many do not.
    template <class Job>
    int64_t each_site(const Run& run, Job&& job) {
        int64_t n_far = 0;
        const int64_t row = rows_.row_of_line(run.line) * rows_.tiles;
        for (int64_t at = run.first; at < run.last; ++at) {
            const int32_t id = slot_[row + at / kPlaces + 1];
            if (id < 0)
                ++n_far;
            else
                job(static_cast<Site>(id * kLanes + rows_.line_of_tile(run.line) * kPlaces + at % kPlaces));
        }
        return n_far;
    }

    void tally(const Run& run, const uint16_t* u, Wound& wound) {
        wound.histogram.resize(size_t{G::bulk} + 1, 0);
        const int64_t n_far = each_site(run, [&](Site site) {
            wound.n_cells += has(cells(), site);
            ++wound.histogram[density(u, site)];
        });
        wound.n_far += n_far, wound.histogram[0] += static_cast<uint32_t>(n_far);
    }

    void keep_above(const Run& run, const uint16_t* u, Wound& wound) {
        each_site(run, [&](Site site) {
            const uint16_t reached = density(u, site);
            cells()[site >> 5] &= ~(1u << (site & 31)), free()[site >> 5] |= 1u << (site & 31);
            if (reached > wound.level) settle_at(site);
            if (reached == wound.level) wound.ties.push_back(site);
        });
    }

    // Beyond the core of the band it is that of undisturbed sites.
    uint16_t density(const uint16_t* u, Site site) {
        if (band_.is_core_or_rim[site >> 5]) return u[site];
        return has(cells(), site) ? G::bulk : 0;
    }

    // ---------------------------------------------------------------- the end of a step

    void write_back(const Counts& counts) {
        std::vector<int64_t> before(most_pieces(), 0), misplaced(most_pieces(), 0);
        pieces(band_.active, [&](int i, Ids ids) {
            for (size_t k = 0; k < ids.count; ++k) {
                const int32_t id = ids.first[k];
                before[i] += popcount(occupied_[band_.word[id]]);
                misplaced[i] |= cells()[id] & ~fill()[id];
            }
        });
        // tiles that are not active are not looked at again, so nothing may change right beside them
        for (int32_t id : band_.outer) require_inside(id, cells()[id] ^ occupied_[band_.word[id]]);
        const int64_t gained = n_occupied() - std::accumulate(before.begin(), before.end(), int64_t{0});
        const bool is_misplaced = std::any_of(misplaced.begin(), misplaced.end(), [](int64_t m) { return m != 0; });
        if (gained != counts.edge + counts.layer || counts.dropped < 0 || is_misplaced)
            throw InvariantFault("cells were lost or doubled: " + std::to_string(gained) + " more after " +
                                 std::to_string(counts.edge + counts.layer) + " divisions");
        pieces(band_.active, [&](int, Ids ids) { by_.border(ids, band_.beside(), free(), scratch()); });
        collect(band_.active, front_, [&](int32_t id, std::vector<Front>& found) {
            occupied_[band_.word[id]] = cells()[id];
            note_front(band_.word[id], scratch()[id], found);
        });
        n_cells_ += gained;
    }

    Rows<D> rows_;
    Rules rules_;
    uint32_t key_[2];
    const Kernels& kernels_;
    const Kernels::ByDimension& by_;
    Pool pool_;
    std::vector<uint32_t> fillable_, occupied_;
    Band<D> band_;
    std::vector<Front> front_;
    int64_t step_, n_cells_ = 0, n_fillable_ = 0;
    Work work_;
    const Moves moves_ = all_moves();
    const int64_t lines_[kLines] = {rows_.line(0), rows_.line(1), rows_.line(2), rows_.line(3)};

    // of one step; arrays by id have one more entry at either end, for lanes beyond the first and the last block
    bool is_whole_ = false, too_flat_ = false;
    const double* W_ = nullptr;
    bool W_per_site_ = false;
    double W_ref_ = 1.0;
    std::vector<uint32_t> cells_, fill_, free_, zone_[2], layer_bits_, scratch_, above_, equal_;
    std::vector<uint16_t> density_[2], own_, cost_, distance_;
    std::vector<uint8_t> plain_, dirty_;
    std::vector<uint32_t> stamp_;
    uint32_t generation_ = 0;
    std::vector<int32_t> layer_, shore_, mixed_;
    std::vector<Site> near_;
    Words words_;
    std::vector<Run> runs_;
    std::vector<Wound> wounds_;
    std::vector<int32_t> first_run_, slot_;
};

const Kernels& kernels_by_name(const char* name) {
    const std::string wanted = *name ? name : instruction_sets().back();
#ifdef CICATRIX_X86
    if (wanted == "v4") return kernels_v4();
    if (wanted == "v3") return kernels_v3();
    if (wanted == "v2") return kernels_v2();
#endif
    if (wanted == "portable") return kernels_portable();
    throw std::invalid_argument("no such instruction set: " + wanted);
}

}  // namespace

std::vector<const char*> instruction_sets() {
    std::vector<const char*> names = {"portable"};
#ifdef CICATRIX_X86
    __builtin_cpu_init();
    const bool v2 = __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
    const bool v3 = v2 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("fma");
    const bool v4 = v3 && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl") &&
                    __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512cd");
    if (v2) names.push_back("v2");
    if (v3) names.push_back("v3");
    if (v4) names.push_back("v4");
#endif
    return names;
}

std::unique_ptr<AutomatonCore> make_automaton(const std::vector<int64_t>& shape, const uint8_t* fillable,
                                              const uint8_t* occupied, const Rules& rules, int64_t step, int threads,
                                              const char* isa) {
    const Kernels& kernels = kernels_by_name(isa);
    if (shape.size() == 2) return std::make_unique<Core<2>>(shape, fillable, occupied, rules, step, threads, kernels);
    if (shape.size() == 3) return std::make_unique<Core<3>>(shape, fillable, occupied, rules, step, threads, kernels);
    throw std::invalid_argument("a lattice has two or three axes");
}

}  // namespace cicatrix

#include "automaton.hpp"

#include <algorithm>
#include <iterator>
#include <numeric>
#include <string>

#include "kernels.hpp"
#include "level_set.hpp"
#include "motility.hpp"
#include "routing.hpp"
#include "stage.hpp"

namespace cicatrix {
namespace {

template <int D>
class Core final : public AutomatonCore {
    using G = Geometry<D>;

   public:
    Core(const std::vector<int64_t>& shape, const uint8_t* fillable, const uint8_t* occupied, const Rules& rules,
         int64_t step, int threads, int64_t tiles_per_piece, const Kernels& kernels)
        : s_(shape, rules, step, threads, tiles_per_piece, kernels) {
        read(fillable, s_.fillable);
        read(occupied, s_.occupied);
        for (size_t i = 0; i < s_.fillable.size(); ++i) {
            n_fillable_ += popcount(s_.fillable[i]);
            n_cells_ += popcount(s_.occupied[i]);
        }
        s_.find_plain();
        find_front();
    }

    Counts advance(const double* W, bool per_site, double W_ref, Team* team) override {
        W_ = W, W_per_site_ = per_site, W_ref_ = W_ref, s_.team = team;
        Counts counts;
        if (n_open() > 0) {
            int64_t reach = first_reach();
            int parts = parts_of_front();
            for (bool whole = false;;) {
                s_.too_flat = false;
                try {
                    counts = step_within(reach, whole, parts);
                    break;
                } catch (const TooNarrow&) {
                    if (whole && parts == 1) throw InvariantFault("the whole lattice was called too narrow for a step of the automaton");
                    if (s_.too_flat)
                        whole = true, parts = 1;
                    else if (parts > 1)
                        parts = see_further() ? parts : 1;
                    else
                        reach = 2 * reach, whole = reach > longest();
                }
            }
        }
        s_.step += 1;
        return counts;
    }

    void occupancy(uint8_t* out) const override {
        for (int64_t n = 0; n < s_.rows.n_lines(); ++n) {
            const uint32_t* row = s_.occupied.data() + s_.rows.row_of_line(n) * s_.rows.tiles;
            for (int64_t tile = 1; tile < s_.rows.tiles - 1; ++tile)
                *out++ = static_cast<uint8_t>(row[tile] >> kPlaces * s_.rows.line_of_tile(n));
        }
    }

    int64_t n_cells() const override { return n_cells_; }
    int64_t n_open() const override { return n_fillable_ - n_cells_; }
    int64_t step() const override { return s_.step; }
    Work work() const override {
        Work work = s_.work;
        work.stored_tiles = s_.band.size(), work.active_tiles = static_cast<int64_t>(s_.band.active.size());
        work.bytes = s_.bytes() + motility_.bytes() + routing_.bytes();
        return work;
    }

   private:
    // ---------------------------------------------------------------- the lattice

    // Unpack rows of bits into tiles: each byte, eight sites of a row, is one line of a tile.
    void read(const uint8_t* in, std::vector<uint32_t>& bits) const {
        for (int64_t n = 0; n < s_.rows.n_lines(); ++n) {
            uint32_t* row = bits.data() + s_.rows.row_of_line(n) * s_.rows.tiles;
            for (int64_t tile = 1; tile < s_.rows.tiles - 1; ++tile) row[tile] |= uint32_t{*in++} << kPlaces * s_.rows.line_of_tile(n);
        }
    }

    // Initial width of the band in hops from the front: it contains the densities that change, and the layer as long as the
    // front moves by at most two hops. A larger movement is detected (TooNarrow).
    int64_t first_reach() const {
        const int64_t zone = s_.rules.level_set ? std::max(s_.rules.layer_sites, s_.rules.substeps) : s_.rules.layer_sites;
        return std::max(core_reach() + 1, zone + 3);
    }

    int64_t core_reach() const { return (s_.rules.level_set ? 2 : 1) * s_.rules.substeps + 1; }

    int64_t longest() const { return std::max({s_.rows.across[0], s_.rows.across[1], s_.rows.width}); }

    // Find the tiles with a free site that are not surrounded by free tiles; some are superfluous, in the first step only.
    void find_front() {
        front_.clear();
        for (int64_t row = 0; row < s_.rows.count(); ++row) {
            if (s_.rows.on_frame(row)) continue;
            for (int64_t word = row * s_.rows.tiles + 1; word < (row + 1) * s_.rows.tiles - 1; ++word) {
                if (!s_.free_word(word)) continue;
                uint32_t all = ~0u;
                for (int k = 0; k < G::rows; ++k)
                    for (int right = -1; right <= 1; ++right) all &= s_.free_word(word + s_.rows.stride(k) * s_.rows.tiles + right);
                if (~all) front_.push_back({word, (1 << G::height) - 1, 0, kPlaces - 1});
            }
        }
    }

    static void note_front(int64_t word, uint32_t edge, std::vector<Front>& front) {
        if (!edge) return;
        uint8_t first = 0, places = 0;
        for (int line = 0; line < kLines; ++line) {
            const uint8_t here = edge >> kPlaces * line & 0xFF;
            places |= here, first |= (here != 0) << line / G::depth;
        }
        const int low = __builtin_ctz(places), high = 31 - __builtin_clz(places);
        front.push_back({word, first, static_cast<uint8_t>(low), static_cast<uint8_t>(high)});
    }

    // ---------------------------------------------------------------- one step

    Counts step_within(int64_t reach, bool whole, int parts) {
        s_.is_whole = whole, s_.work = Work();
        s_.is_shared = parts > 1, s_.work.ranks = parts;
        build_band(reach, whole, parts);
        s_.load();
        Counts counts;
        counts.edge = divide_at_edge();
        motility_.move();
        s_.share_cells();
        std::vector<Site> parents;
        const std::vector<int64_t> found = s_.sum([&] {
            find_layer(s_.rules.layer_sites);
            s_.work.layer_cells = s_.count_bits(layer_.own_tiles(), layer_.bits());
            int64_t n_clamped = 0;
            parents = divide_in_layer(n_clamped);
            return std::vector<int64_t>{static_cast<int64_t>(parents.size()), n_clamped};
        });
        if (found[0] > 0) counts.layer = s_.rules.level_set ? level_set_.place(parents) : routing_.place(parents);
        write_back(counts);
        counts.dropped = found[0] - counts.layer, counts.clamped = found[1];
        if (counts.dropped < 0) throw InvariantFault("more cells were placed than had divided");
        return counts;
    }

    // ---------------------------------------------------------------- several ranks

    // Number of ranks that share a step: as many as have enough work. Redistribution by level set runs on one rank, because a
    // wound component may be larger than any rank's part.
    int parts_of_front() const {
        if (!s_.team || s_.rules.level_set) return 1;
        const size_t n = kBandOfFront * front_.size() / s_.pool.tiles_per_piece();
        return static_cast<int>(std::clamp<size_t>(n, 1, s_.team->size()));
    }

    // Double the halo for long paths; false if it is at its limit, so that long paths are not the reason for the failure.
    bool see_further() {
        far_sight_ = far_sight_ < kFarthest ? 2 * far_sight_ : 1;
        return far_sight_ > 1;
    }

    // Build the band; for several ranks, divide the front along the Morton curve, anew in every step.
    void build_band(int64_t reach, bool whole, int parts) {
        Share share;
        if (parts > 1) {
            s_.sight = far_sight_ * usual_sight();
            share.core_halo = s_.rules.substeps + kAround;
            share.halo = std::max(share.core_halo, s_.sight + s_.rules.layer_sites + kAround);
            std::vector<uint64_t> places;
            for (const Front& f : front_) places.push_back(s_.rows.place(f.word));
            share.stretch = s_.team->rank() < parts ? stretch_of(places, s_.team->rank(), parts) : Stretch::none();
        }
        s_.band.build(front_, reach, core_reach(), whole, parts > 1 ? &share : nullptr, s_.pool);
    }

    // Number of hops that hardly any path exceeds: a hop costs 64 to 64 + path_noise, and a path takes the cheapest of many.
    int64_t usual_sight() const { return kAround + 2 + s_.rules.layer_sites + s_.rules.layer_sites * s_.rules.path_noise / 128; }

    static constexpr int64_t kAround = 3;         // additional hops for edge division and for the border between tiles
    static constexpr size_t kBandOfFront = 3;     // approximate number of band tiles per tile of the front
    static constexpr int64_t kFarthest = 4;

    // ---------------------------------------------------------------- edge division

    int64_t divide_at_edge() {
        std::vector<std::vector<Site>> targets(s_.most_pieces());
        const uint64_t limit = threshold(s_.rules.p_edge);
        if (limit > 0) s_.pieces(s_.band.core, [&](int i, Ids ids) { edge_targets(ids, limit, targets[i]); });
        int64_t n = 0;
        s_.work.edge_cells = limit > 0 ? s_.count_bits(s_.band.own_core(), s_.scratch()) : 0;
        for (const auto& part : targets)
            for (Site site : part)
                if (!s_.has(s_.cells(), site)) s_.settle_at(site), n += s_.is_own(site);
        return n;
    }

    void edge_targets(Ids ids, uint64_t limit, std::vector<Site>& targets) {
        s_.by.touching(ids, s_.band.beside(), s_.cells(), s_.free(), s_.scratch());
        Site sites[kDraws];
        uint64_t numbers[kDraws];
        uint32_t words[4 * kDraws];
        size_t n = 0;
        auto draw = [&] {
            s_.kernels.philox(numbers, n, static_cast<uint32_t>(s_.step), kEdgeDivision, s_.key, words);
            for (size_t i = 0; i < n; ++i)
                if (words[4 * i] < limit) choose_target(sites[i], words[4 * i + 1], targets);
            n = 0;
        };
        for (size_t i = 0; i < ids.count; ++i)
            for (uint32_t left = s_.scratch()[ids.first[i]]; left; left &= left - 1) {
                sites[n] = static_cast<Site>(ids.first[i]) * kLanes + __builtin_ctz(left);
                numbers[n] = s_.number(sites[n]);
                if (++n == kDraws) draw();
            }
        draw();
    }

    // Add the free neighbour that a random word selects, if there are enough free neighbours.
    void choose_target(Site site, uint32_t word, std::vector<Site>& targets) {
        const auto around = s_.around(site);
        uint32_t directions = 0, bit = 1;  // one bit per direction
        for (Site other : around) directions |= s_.has(s_.free(), other) ? bit : 0, bit <<= 1;
        const int n_free = popcount(directions);
        if (n_free < s_.rules.min_free) return;
        for (uint32_t skip = below(word, n_free); skip; --skip) directions &= directions - 1;
        targets.push_back(around.site[__builtin_ctz(directions)]);
    }

    // ---------------------------------------------------------------- layer division

    void find_layer(int64_t hops) {
        s_.find_zone(hops);
        layer_.padded.assign(s_.band.size() + 2, 0);
        s_.collect(s_.band.active, layer_.tiles, [&](int32_t id, std::vector<int32_t>& found) {
            if (const uint32_t bits = s_.zone[0][id + 1] & s_.cells()[id]) {
                found.push_back(id);
                layer_.bits()[id] = bits;
            }
        });
        layer_.is_shared = s_.is_shared, layer_.own.clear();
        if (s_.is_shared)
            std::copy_if(layer_.tiles.begin(), layer_.tiles.end(), std::back_inserter(layer_.own), [&](int32_t id) { return s_.band.is_own(id); });
    }

    // Return the layer cells owned by this rank that divide.
    std::vector<Site> divide_in_layer(int64_t& n_clamped) {
        std::vector<Site> parents;
        if (s_.rules.p_layer == 0.0 || layer_.tiles.empty()) return parents;
        if (W_per_site_) return divide_by_site(n_clamped);
        const uint64_t limit = limit_at(*W_, n_clamped, s_.work.layer_cells);
        if (limit == 0) return parents;
        s_.pieces(layer_.own_tiles(), [&](int, Ids ids) { s_.kernels.draw(ids, s_.random(kLayerDivision), layer_.bits(), limit, s_.scratch()); });
        s_.collect(layer_.own_tiles(), parents, [&](int32_t id, std::vector<Site>& found) { s_.add_sites(id, s_.scratch()[id], found); });
        return parents;
    }

    std::vector<Site> divide_by_site(int64_t& n_clamped) {
        std::vector<Site> parents;
        s_.words.clear();
        for (int32_t id : layer_.own_tiles()) s_.add_words(id, layer_.bits()[id]);
        s_.words.draw(s_.kernels, s_.step, kLayerDivision, s_.key);
        for (size_t i = 0; i < s_.words.size(); ++i)
            if (s_.words.word(i) < limit_at(W_[s_.number(s_.words.site(i))], n_clamped, 1)) parents.push_back(s_.words.site(i));
        return parents;
    }

    // The operations and their order are those of the NumPy implementation, so that results are bit-identical.
    uint64_t limit_at(double W, int64_t& n_clamped, int64_t n_sites) const {
        const double p = s_.rules.p_layer * (1.0 + s_.rules.feedback * W / W_ref_);
        if (p > 1.0) n_clamped += n_sites;
        return threshold(std::min(std::max(p, 0.0), 1.0));
    }

    // ---------------------------------------------------------------- the end of a step

    // Store the result of the step; the counts are summed over all ranks.
    void write_back(Counts& counts) {
        const std::vector<int64_t> all = s_.sum([&] { return std::vector<int64_t>{counts.edge, counts.layer, gained(), misplaced()}; });
        counts.edge = all[0], counts.layer = all[1];
        if (all[2] != counts.edge + counts.layer || all[3] != 0)
            throw InvariantFault("cells were lost or doubled: " + std::to_string(all[2]) + " more after " +
                                 std::to_string(counts.edge + counts.layer) + " divisions");
        s_.pieces(s_.band.own(), [&](int, Ids ids) { s_.by.border(ids, s_.band.beside(), s_.free(), s_.scratch()); });
        const std::vector<Front> front = s_.together([&] {
            std::vector<Front> mine;
            s_.collect(s_.band.own(), mine, [&](int32_t id, std::vector<Front>& found) {
                note_front(s_.band.word[id], s_.scratch()[id], found);
            });
            return mine;
        });
        keep_cells();
        front_ = front;
        n_cells_ += all[2];
    }

    void keep_cells() {
        if (s_.is_shared)
            for (const auto& change : s_.changes(s_.band.own())) s_.occupied[change.word] = static_cast<uint32_t>(change.cells);
        else
            s_.pieces(s_.band.active, [&](int, Ids ids) {
                for (size_t k = 0; k < ids.count; ++k) s_.occupied[s_.band.word[ids.first[k]]] = s_.cells()[ids.first[k]];
            });
    }

    int64_t gained() {
        std::vector<int64_t> parts(s_.most_pieces(), 0);
        s_.pieces(s_.band.own(), [&](int i, Ids ids) {
            for (size_t k = 0; k < ids.count; ++k)
                parts[i] += popcount(s_.cells()[ids.first[k]]) - popcount(s_.occupied[s_.band.word[ids.first[k]]]);
        });
        // inactive tiles are not examined again, so nothing may change next to them
        for (int32_t id : s_.band.outer) s_.require_inside(id, s_.cells()[id] ^ s_.occupied[s_.band.word[id]]);
        return std::accumulate(parts.begin(), parts.end(), int64_t{0});
    }

    // Count the tiles with a cell at a site that cannot be filled.
    int64_t misplaced() {
        return std::count_if(s_.band.own().begin(), s_.band.own().end(), [&](int32_t id) { return (s_.cells()[id] & ~s_.fill()[id]) != 0; });
    }

    static constexpr size_t kDraws = 256;  // calls of the generator per batch

    Stage<D> s_;
    Layer layer_;
    Motility<D> motility_{s_};
    Routing<D> routing_{s_, layer_};
    LevelSet<D> level_set_{s_, motility_};
    std::vector<Front> front_;
    int64_t far_sight_ = 1;  // factor of the halo, doubled when paths turn out to be longer
    int64_t n_cells_ = 0, n_fillable_ = 0;
    const double* W_ = nullptr;
    bool W_per_site_ = false;
    double W_ref_ = 1.0;
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
                                              int64_t tiles_per_piece, const char* isa) {
    const Kernels& kernels = kernels_by_name(isa);
    if (shape.size() == 2) return std::make_unique<Core<2>>(shape, fillable, occupied, rules, step, threads, tiles_per_piece, kernels);
    if (shape.size() == 3) return std::make_unique<Core<3>>(shape, fillable, occupied, rules, step, threads, tiles_per_piece, kernels);
    throw std::invalid_argument("a lattice has two or three axes");
}

}  // namespace cicatrix

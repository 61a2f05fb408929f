#include "automaton.hpp"

#include <algorithm>
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

    Counts advance(const double* W, bool per_site, double W_ref) override {
        W_ = W, W_per_site_ = per_site, W_ref_ = W_ref;
        Counts counts;
        if (n_open() > 0) {
            int64_t reach = first_reach();
            for (bool whole = false;; whole = reach > longest() || s_.too_flat) {
                s_.too_flat = false;
                try {
                    counts = step_within(reach, whole);
                    break;
                } catch (const TooNarrow&) {
                    if (whole) throw InvariantFault("the whole lattice was called too narrow for a step of the automaton");
                    reach = 2 * reach;
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

    // A byte of a line of sites is a line of a tile.
    void read(const uint8_t* in, std::vector<uint32_t>& bits) const {
        for (int64_t n = 0; n < s_.rows.n_lines(); ++n) {
            uint32_t* row = bits.data() + s_.rows.row_of_line(n) * s_.rows.tiles;
            for (int64_t tile = 1; tile < s_.rows.tiles - 1; ++tile) row[tile] |= uint32_t{*in++} << kPlaces * s_.rows.line_of_tile(n);
        }
    }

    // Hops beyond the front that a step works on: the densities that change, and the layer, should the front not move by more
    // than two hops. Where it does, that is noticed.
    int64_t first_reach() const {
        const int64_t zone = s_.rules.level_set ? std::max(s_.rules.layer_sites, s_.rules.substeps) : s_.rules.layer_sites;
        return std::max(core_reach() + 1, zone + 3);
    }

    int64_t core_reach() const { return (s_.rules.level_set ? 2 : 1) * s_.rules.substeps + 1; }

    int64_t longest() const { return std::max({s_.rows.across[0], s_.rows.across[1], s_.rows.width}); }

    // Tiles with a free site that do not lie in the midst of free ones: a few too many, for the first step only.
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

    Counts step_within(int64_t reach, bool whole) {
        s_.is_whole = whole, s_.work = Work();
        s_.band.build(front_, reach, core_reach(), whole, s_.pool);
        s_.load();
        Counts counts;
        counts.edge = divide_at_edge();
        motility_.move();
        find_layer(s_.rules.layer_sites);
        s_.work.layer_cells = s_.count_bits(layer_.tiles, layer_.bits());
        const std::vector<Site> parents = divide_in_layer(counts.clamped);
        if (!parents.empty()) {
            const int64_t before = s_.n_occupied();
            s_.rules.level_set ? level_set_.place(parents) : routing_.place(parents);
            counts.layer = s_.n_occupied() - before;
            counts.dropped = static_cast<int64_t>(parents.size()) - counts.layer;
        }
        write_back(counts);
        return counts;
    }

    // ---------------------------------------------------------------- edge division

    int64_t divide_at_edge() {
        std::vector<std::vector<Site>> targets(s_.most_pieces());
        const uint64_t limit = threshold(s_.rules.p_edge);
        if (limit > 0) s_.pieces(s_.band.core, [&](int i, Ids ids) { edge_targets(ids, limit, targets[i]); });
        int64_t n = 0;
        s_.work.edge_cells = limit > 0 ? s_.count_bits(s_.band.core, s_.scratch()) : 0;
        for (const auto& part : targets)
            for (Site site : part)
                if (!s_.has(s_.cells(), site)) s_.settle_at(site), ++n;
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

    // The free neighbour that a random word means, if there are enough of them.
    void choose_target(Site site, uint32_t word, std::vector<Site>& targets) {
        const auto around = s_.around(site);
        uint32_t directions = 0, bit = 1;  // one bit for each
        for (Site other : around) directions |= s_.has(s_.free(), other) ? bit : 0, bit <<= 1;
        const int n_free = popcount(directions);
        if (n_free < s_.rules.min_free) return;
        for (uint32_t skip = below(word, n_free); skip; --skip) directions &= directions - 1;
        targets.push_back(around.site[__builtin_ctz(directions)]);
    }

    // ---------------------------------------------------------------- layer division

    void find_layer(int64_t hops) {
        s_.find_zone(hops);
        layer_.bits_.assign(s_.band.size() + 2, 0);
        s_.collect(s_.band.active, layer_.tiles, [&](int32_t id, std::vector<int32_t>& found) {
            if (const uint32_t bits = s_.zone[0][id + 1] & s_.cells()[id]) {
                found.push_back(id);
                layer_.bits()[id] = bits;
            }
        });
    }

    std::vector<Site> divide_in_layer(int64_t& n_clamped) {
        std::vector<Site> parents;
        n_clamped = 0;
        if (s_.rules.p_layer == 0.0 || layer_.tiles.empty()) return parents;
        if (W_per_site_) return divide_by_site(n_clamped);
        const uint64_t limit = limit_at(*W_, n_clamped, s_.count_bits(layer_.tiles, layer_.bits()));
        if (limit == 0) return parents;
        s_.pieces(layer_.tiles, [&](int, Ids ids) { s_.kernels.draw(ids, s_.random(kLayerDivision), layer_.bits(), limit, s_.scratch()); });
        s_.collect(layer_.tiles, parents, [&](int32_t id, std::vector<Site>& found) { s_.add_sites(id, s_.scratch()[id], found); });
        return parents;
    }

    std::vector<Site> divide_by_site(int64_t& n_clamped) {
        std::vector<Site> parents;
        s_.words.clear();
        for (int32_t id : layer_.tiles)
            for (uint32_t left = layer_.bits()[id]; left; left &= left - 1)
                s_.add_word(static_cast<Site>(id) * kLanes + __builtin_ctz(left));
        s_.words.draw(s_.kernels, s_.step, kLayerDivision, s_.key);
        for (size_t i = 0; i < s_.words.size(); ++i)
            if (s_.words.word(i) < limit_at(W_[s_.number(s_.words.site(i))], n_clamped, 1)) parents.push_back(s_.words.site(i));
        return parents;
    }

    // The operations and their order are those of the twin, so that the bits are.
    uint64_t limit_at(double W, int64_t& n_clamped, int64_t n_sites) const {
        const double p = s_.rules.p_layer * (1.0 + s_.rules.feedback * W / W_ref_);
        if (p > 1.0) n_clamped += n_sites;
        return threshold(std::min(std::max(p, 0.0), 1.0));
    }

    // ---------------------------------------------------------------- the end of a step

    void write_back(const Counts& counts) {
        std::vector<int64_t> before(s_.most_pieces(), 0), misplaced(s_.most_pieces(), 0);
        s_.pieces(s_.band.active, [&](int i, Ids ids) {
            for (size_t k = 0; k < ids.count; ++k) {
                const int32_t id = ids.first[k];
                before[i] += popcount(s_.occupied[s_.band.word[id]]);
                misplaced[i] |= s_.cells()[id] & ~s_.fill()[id];
            }
        });
        // tiles that are not active are not looked at again, so nothing may change right beside them
        for (int32_t id : s_.band.outer) s_.require_inside(id, s_.cells()[id] ^ s_.occupied[s_.band.word[id]]);
        const int64_t gained = s_.n_occupied() - std::accumulate(before.begin(), before.end(), int64_t{0});
        const bool is_misplaced = std::any_of(misplaced.begin(), misplaced.end(), [](int64_t m) { return m != 0; });
        if (gained != counts.edge + counts.layer || counts.dropped < 0 || is_misplaced)
            throw InvariantFault("cells were lost or doubled: " + std::to_string(gained) + " more after " +
                                 std::to_string(counts.edge + counts.layer) + " divisions");
        s_.pieces(s_.band.active, [&](int, Ids ids) { s_.by.border(ids, s_.band.beside(), s_.free(), s_.scratch()); });
        s_.collect(s_.band.active, front_, [&](int32_t id, std::vector<Front>& found) {
            s_.occupied[s_.band.word[id]] = s_.cells()[id];
            note_front(s_.band.word[id], s_.scratch()[id], found);
        });
        n_cells_ += gained;
    }

    static constexpr size_t kDraws = 256;  // calls of the generator at once

    Stage<D> s_;
    Layer layer_;
    Motility<D> motility_{s_};
    Routing<D> routing_{s_, layer_};
    LevelSet<D> level_set_{s_, motility_};
    std::vector<Front> front_;
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

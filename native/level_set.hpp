// Redistribution by diffusion and level set, with the number of cells conserved in each wound component.
#pragma once

#include <algorithm>
#include <utility>
#include <vector>

#include "motility.hpp"
#include "stage.hpp"

namespace cicatrix {

template <int D>
class LevelSet {
    using G = Geometry<D>;

   public:
    LevelSet(Stage<D>& stage, Motility<D>& motility) : s_(stage), motility_(motility) {}

    // Diffuse, then threshold each wound component (connected set of sites around a wound) at its new number of cells; return how
    // many cells are new.
    int64_t place(const std::vector<Site>& parents) {
        s_.find_zone(std::max(s_.rules.layer_sites, s_.rules.substeps));
        find_pieces();
        for (Site site : parents) ++wounds_[run_at(site).wound].n_new;
        const uint16_t* u = motility_.diffuse();
        int64_t n_placed = 0;
        for (const Run& run : runs_)
            if (Wound& wound = wounds_[run.wound]; wound.n_new) tally(run, u, wound);
        for (Wound& wound : wounds_) {
            if (!wound.n_new) continue;
            const int64_t wanted = std::min(wound.n_cells + wound.n_new, wound.n_sites);
            n_placed += wanted - wound.n_cells;
            const auto [level, above] = level_in(wound.histogram, wanted);
            wound.level = level, wound.wanted = wanted - above;
            if (level == 0 && wound.n_far > 0) {
                s_.too_flat = true;
                throw TooNarrow();
            }
        }
        for (const Run& run : runs_)
            if (Wound& wound = wounds_[run.wound]; wound.n_new) keep_above(run, u, wound);
        for (Wound& wound : wounds_) {
            s_.words.clear();
            for (Site site : wound.ties) s_.add_word(site);
            s_.settle_first(kRedistributionTie, wound.wanted);
        }
        return n_placed;
    }

   private:
    // Return the level that `count` sites reach, and the number of sites above it.
    static std::pair<uint16_t, int64_t> level_in(const std::vector<uint32_t>& histogram, int64_t count) {
        int64_t above = 0;
        for (size_t level = histogram.size(); level-- > 0;) {
            if (above + histogram[level] >= count) return {static_cast<uint16_t>(level), above};
            above += histogram[level];
        }
        throw InvariantFault("the automaton looked for more cells than there are sites");
    }

    // Consecutive sites of one line, first .. last - 1, that belong to a wound component.
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

    // Find the wound components as runs of sites. Tiles outside the band have either only free sites or none.
    void find_pieces() {
        slot_.assign(s_.occupied.size(), -1);
        for (int32_t id : s_.band.active) slot_[s_.band.word[id]] = id;
        runs_.clear(), first_run_.clear();
        for (int64_t line = 0; line < s_.rows.n_lines(); ++line) {
            first_run_.push_back(static_cast<int32_t>(runs_.size()));
            add_runs(line);
        }
        first_run_.push_back(static_cast<int32_t>(runs_.size()));
        join_runs();
    }

    void add_runs(int64_t line) {
        for (int64_t tile = 1; tile < s_.rows.tiles - 1; ++tile) {
            const int64_t word = s_.rows.row_of_line(line) * s_.rows.tiles + tile;
            const int32_t id = slot_[word];
            const uint32_t bits = id < 0 ? s_.free_word(word) : s_.zone[0][id + 1] & s_.fill()[id];
            uint32_t places = bits >> kPlaces * s_.rows.line_of_tile(line) & 0xFF;
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
                const int64_t line = runs_[i].line, second = line % s_.rows.across[1] + d.second;
                const int64_t other = line + d.first * s_.rows.across[1] + d.second;
                if (other < 0 || other >= line || second < 0 || second >= s_.rows.across[1]) continue;
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
        const int64_t line = s_.number(site) / s_.rows.width, at = s_.number(site) % s_.rows.width;
        const auto end = runs_.begin() + first_run_[line + 1];
        return *std::find_if(runs_.begin() + first_run_[line], end, [at](const Run& run) { return at < run.last; });
    }

    // Call job(site) for every site of a run that lies in an active tile; return the number of the other sites.
    template <class Job>
    int64_t each_site(const Run& run, Job&& job) {
        int64_t n_far = 0;
        const int64_t row = s_.rows.row_of_line(run.line) * s_.rows.tiles;
        for (int64_t at = run.first; at < run.last; ++at) {
            const int32_t id = slot_[row + at / kPlaces + 1];
            if (id < 0)
                ++n_far;
            else
                job(static_cast<Site>(id * kLanes + s_.rows.line_of_tile(run.line) * kPlaces + at % kPlaces));
        }
        return n_far;
    }

    void tally(const Run& run, const uint16_t* u, Wound& wound) {
        wound.histogram.resize(size_t{G::bulk} + 1, 0);
        const int64_t n_far = each_site(run, [&](Site site) {
            wound.n_cells += s_.has(s_.cells(), site);
            ++wound.histogram[density(u, site)];
        });
        wound.n_far += n_far, wound.histogram[0] += static_cast<uint32_t>(n_far);
    }

    void keep_above(const Run& run, const uint16_t* u, Wound& wound) {
        each_site(run, [&](Site site) {
            const uint16_t reached = density(u, site);
            s_.cells()[site >> 5] &= ~(1u << (site & 31)), s_.free()[site >> 5] |= 1u << (site & 31);
            if (reached > wound.level) s_.settle_at(site);
            if (reached == wound.level) wound.ties.push_back(site);
        });
    }

    // Density U of a site; outside the core of the band it is that of an undisturbed site.
    uint16_t density(const uint16_t* u, Site site) {
        if (s_.band.is_core_or_rim[site >> 5]) return u[site];
        return s_.has(s_.cells(), site) ? G::bulk : 0;
    }

    Stage<D>& s_;
    Motility<D>& motility_;
    std::vector<Run> runs_;
    std::vector<Wound> wounds_;
    std::vector<int32_t> first_run_, slot_;
};

}  // namespace cicatrix

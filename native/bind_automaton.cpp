// Python bindings of the automaton.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>

#include "automaton.hpp"

namespace nb = nanobind;
using namespace cicatrix;

namespace {

using Bits = nb::ndarray<const uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Field = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;

// Team implemented by a Python object with rank, size and gather(bytes) -> list of bytes.
class PythonTeam final : public Team {
   public:
    explicit PythonTeam(const nb::object& ranks)
        : gather_(ranks.attr("gather")), rank_(nb::cast<int>(ranks.attr("rank"))), size_(nb::cast<int>(ranks.attr("size"))) {}

    int rank() const override { return rank_; }
    int size() const override { return size_; }
    std::vector<std::string> gather(const std::string& mine) override {
        nb::gil_scoped_acquire hold;
        std::vector<std::string> all;
        for (nb::handle message : nb::cast<nb::list>(gather_(nb::bytes(mine.data(), mine.size())))) {
            const nb::bytes bytes = nb::cast<nb::bytes>(message);
            all.emplace_back(bytes.c_str(), bytes.size());
        }
        return all;
    }

   private:
    nb::object gather_;
    int rank_, size_;
};

struct Automaton {
    std::vector<int64_t> shape;
    std::unique_ptr<AutomatonCore> core;
    std::vector<int64_t> last{};  // counts of the last step, a row of `advance`

    int64_t n_sites() const {
        int64_t n = 1;
        for (int64_t size : shape) n *= size;
        return n;
    }
    size_t n_bytes() const { return static_cast<size_t>(n_sites() / shape.back() * ((shape.back() + 7) / 8)); }
};

void construct(Automaton* self, std::vector<int64_t> shape, Bits fillable, Bits occupied, double p_edge, double p_layer,
               int64_t layer_sites, int64_t motility_substeps, bool level_set, double feedback, int64_t min_free_neighbours,
               uint32_t path_noise, uint64_t seed, int64_t step, int threads, int64_t tiles_per_piece,
               const std::string& isa) {
    if (shape.size() < 2 || shape.size() > 3 || *std::min_element(shape.begin(), shape.end()) < 1)
        throw nb::value_error("a lattice has two or three axes of at least one site");
    new (self) Automaton{std::move(shape), nullptr};
    if (threads < 1 || tiles_per_piece < 1) throw nb::value_error("threads and tiles_per_piece must be at least 1");
    for (const Bits& bits : {fillable, occupied})
        if (bits.size() != self->n_bytes()) throw nb::value_error("the packed rows do not fit the shape");
    const Rules rules{p_edge,     p_layer, feedback, layer_sites, motility_substeps, min_free_neighbours, level_set,
                      path_noise, seed};
    self->core = make_automaton(self->shape, fillable.data(), occupied.data(), rules, step, threads, tiles_per_piece, isa.c_str());
}

nb::object advance(Automaton& self, int64_t n_steps, Field W, double W_ref, nb::object ranks) {
    if (n_steps < 0) throw nb::value_error("n_steps must be at least 0");
    const bool per_site = W.size() != 1;
    if (per_site && static_cast<int64_t>(W.size()) != self.n_sites())
        throw nb::value_error("W must be one number or one for each site");
    auto* counts = new int64_t[5 * n_steps];
    nb::capsule owner(counts, [](void* p) noexcept { delete[] static_cast<int64_t*>(p); });
    const auto team = ranks.is_none() ? nullptr : std::make_unique<PythonTeam>(ranks);
    {
        nb::gil_scoped_release release;
        for (int64_t i = 0; i < n_steps; ++i) {
            const Counts c = self.core->advance(W.data(), per_site, W_ref, team.get());
            self.last = {c.edge, c.layer, c.dropped, c.clamped, self.core->n_cells()};
            std::copy(self.last.begin(), self.last.end(), counts + 5 * i);
        }
    }
    return nb::cast(nb::ndarray<nb::numpy, int64_t, nb::ndim<2>>(counts, {static_cast<size_t>(n_steps), 5}, owner));
}

nb::object occupancy(const Automaton& self) {
    auto* bytes = new uint8_t[self.n_bytes()];
    nb::capsule owner(bytes, [](void* p) noexcept { delete[] static_cast<uint8_t*>(p); });
    self.core->occupancy(bytes);
    return nb::cast(nb::ndarray<nb::numpy, uint8_t, nb::ndim<1>>(bytes, {self.n_bytes()}, owner));
}

}  // namespace

void bind_automaton(nb::module_& m) {
    nb::exception<InvariantFault>(m, "InvariantFault");
    m.def("instruction_sets", [] {
        std::vector<std::string> names;
        for (const char* name : instruction_sets()) names.emplace_back(name);
        return names;
    }, "Return the instruction sets that this machine can run, the fastest last.");
    nb::class_<Automaton>(m, "AutomatonCore",
                          "Cells on a lattice, packed. Bits are passed as rows along the last axis, least significant bit first, "
                          "each row padded to whole bytes.")
        .def("__init__", &construct, nb::arg("shape"), nb::arg("fillable"), nb::arg("occupied"), nb::kw_only(),
             nb::arg("p_edge"), nb::arg("p_layer"), nb::arg("layer_sites"), nb::arg("motility_substeps"),
             nb::arg("level_set"), nb::arg("feedback"), nb::arg("min_free_neighbours"), nb::arg("path_noise"),
             nb::arg("seed"), nb::arg("step"), nb::arg("threads") = 1, nb::arg("tiles_per_piece") = 1024, nb::arg("isa") = "")
        .def("advance", &advance, nb::arg("n_steps"), nb::arg("W"), nb::arg("W_ref"), nb::arg("ranks") = nb::none(),
             "Do steps and return their counts (n_steps, 5) int64: edge divisions, layer divisions, dropped, clamped, cells. "
             "With ranks (rank, size, gather(bytes) -> list of bytes), every rank makes the same call on the same lattice.")
        .def_prop_ro("last", [](const Automaton& a) { return a.last; }, "Counts of the last step, in the order of a row of advance.")
        .def("occupancy", &occupancy, "Return the cells as packed rows (n_bytes,) uint8.")
        .def_prop_ro("n_cells", [](const Automaton& a) { return a.core->n_cells(); })
        .def_prop_ro("n_open", [](const Automaton& a) { return a.core->n_open(); })
        .def_prop_ro("step", [](const Automaton& a) { return a.core->step(); })
        .def_prop_ro(
            "work",
            [](const Automaton& a) {
                const Work w = a.core->work();
                nb::dict out;
                out["ranks"] = w.ranks, out["stored_tiles"] = w.stored_tiles, out["active_tiles"] = w.active_tiles;
                out["mixed_sites"] = w.mixed_sites, out["edge_cells"] = w.edge_cells;
                out["layer_cells"] = w.layer_cells, out["shore_sites"] = w.shore_sites, out["bytes"] = w.bytes;
                return out;
            },
            "Work of the last step (tiles of 32 sites, sites), and the bytes allocated.");
}

// Element matrices into the blocks of a sparse matrix. Twin: core/scatter.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace nb = nanobind;

namespace {

using Data = nb::ndarray<double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Slots = nb::ndarray<const int32_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Matrices = nb::ndarray<const double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

template <size_t B>
void add(double* data, const int32_t* slots, const double* matrices, size_t n, size_t a) {
    const size_t row = 3 * a;
    for (size_t e = 0; e < n; ++e)
        for (size_t i = 0; i < a; ++i)
            for (size_t j = 0; j < a; ++j) {
                const int32_t slot = slots[(e * a + i) * a + j];
                if (slot < 0) continue;
                double* block = data + static_cast<size_t>(slot) * B * B;
                const double* from = matrices + (e * row + 3 * i) * row + 3 * j;
                for (size_t r = 0; r < B; ++r)
                    for (size_t c = 0; c < B; ++c) block[r * B + c] += from[r * row + c];
            }
}

void add_blocks(Data data, Slots slots, Matrices matrices) {
    const size_t n = slots.shape(0), a = slots.shape(1), b = data.shape(1);
    if (slots.shape(2) != a || matrices.shape(0) != n || matrices.shape(1) != 3 * a || matrices.shape(2) != 3 * a)
        throw nb::value_error("slots (n, a, a) and matrices (n, 3 a, 3 a) do not fit together");
    if (data.shape(2) != b || b < 2 || b > 3) throw nb::value_error("data must be (n_blocks, b, b) with b = 2 or 3");
    const int64_t n_blocks = static_cast<int64_t>(data.shape(0));
    for (size_t k = 0; k < n * a * a; ++k)
        if (slots.data()[k] >= n_blocks) throw nb::value_error("a slot lies beyond the data");
    nb::gil_scoped_release release;
    (b == 3 ? add<3> : add<2>)(data.data(), slots.data(), matrices.data(), n, a);
}

}  // namespace

void bind_scatter(nb::module_& m) {
    m.def("add_blocks", &add_blocks, nb::arg("data"), nb::arg("slots"), nb::arg("matrices"),
          "Add element matrices to the blocks of a sparse matrix; the twin core/scatter.py tells the arguments.");
}

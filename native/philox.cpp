// Philox for arrays of counters. NumPy reference implementation: src/cicatrix/core/philox.py, with the same name and arguments,
// bit-identical.
#include "philox.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <vector>

namespace nb = nanobind;

namespace {

using In = nb::ndarray<const uint32_t, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<nb::numpy, uint32_t>;

Out philox4x32(In counter, In key) {
    if (counter.ndim() < 1 || counter.shape(counter.ndim() - 1) != 4 || key.ndim() != 1 || key.shape(0) != 2)
        throw nb::value_error("philox4x32 takes a counter (..., 4) and a key (2,)");
    const size_t n = counter.size();
    auto* out = new uint32_t[n];
    nb::capsule owner(out, [](void* p) noexcept { delete[] static_cast<uint32_t*>(p); });
    const uint32_t* k = key.data();
    for (size_t i = 0; i < n; i += 4) {
        const uint32_t* c = counter.data() + i;
        philox_block(c[0], c[1], c[2], c[3], k[0], k[1], out + i);
    }
    std::vector<size_t> shape(counter.ndim());
    for (size_t axis = 0; axis < shape.size(); ++axis) shape[axis] = counter.shape(axis);
    return Out(out, shape.size(), shape.data(), owner);
}

}  // namespace

void bind_philox(nb::module_& m) {
    m.def("philox4x32", &philox4x32, nb::arg("counter"), nb::arg("key"),
          "Four random words per counter: (..., 4) uint32, (2,) uint32 -> (..., 4) uint32.");
}

// Philox4x32-10 (Salmon et al., SC11, 2011). Twin: src/cicatrix/core/philox.py, same name, same arguments, same bits.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <vector>

namespace nb = nanobind;

namespace {

using In = nb::ndarray<const uint32_t, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<nb::numpy, uint32_t>;

// One block: counter c (4 words) under key (k0, k1) -> 4 words in out.
inline void block(const uint32_t* c, uint32_t k0, uint32_t k1, uint32_t* out) {
    uint32_t c0 = c[0], c1 = c[1], c2 = c[2], c3 = c[3];
    for (int round = 0; round < 10; ++round) {
        const uint64_t p0 = uint64_t{0xD2511F53} * c0;
        const uint64_t p1 = uint64_t{0xCD9E8D57} * c2;
        c0 = static_cast<uint32_t>(p1 >> 32) ^ c1 ^ k0;
        c1 = static_cast<uint32_t>(p1);
        c2 = static_cast<uint32_t>(p0 >> 32) ^ c3 ^ k1;
        c3 = static_cast<uint32_t>(p0);
        k0 += 0x9E3779B9u;
        k1 += 0xBB67AE85u;
    }
    out[0] = c0, out[1] = c1, out[2] = c2, out[3] = c3;
}

Out philox4x32(In counter, In key) {
    if (counter.ndim() < 1 || counter.shape(counter.ndim() - 1) != 4 || key.ndim() != 1 || key.shape(0) != 2)
        throw nb::value_error("philox4x32 takes a counter (..., 4) and a key (2,)");
    const size_t n = counter.size();
    auto* out = new uint32_t[n];
    nb::capsule owner(out, [](void* p) noexcept { delete[] static_cast<uint32_t*>(p); });
    for (size_t i = 0; i < n; i += 4) block(counter.data() + i, key.data()[0], key.data()[1], out + i);
    std::vector<size_t> shape(counter.ndim());
    for (size_t axis = 0; axis < shape.size(); ++axis) shape[axis] = counter.shape(axis);
    return Out(out, shape.size(), shape.data(), owner);
}

}  // namespace

void bind_philox(nb::module_& m) {
    m.def("philox4x32", &philox4x32, nb::arg("counter"), nb::arg("key"),
          "Four random words per counter: (..., 4) uint32, (2,) uint32 -> (..., 4) uint32.");
}

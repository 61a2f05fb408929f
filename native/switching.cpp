// Two-state sites that switch at random. NumPy reference implementation: src/cicatrix/core/switching.py, with the same name and
// arguments, bit-identical.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstring>
#include <memory>

#include "philox.hpp"
#include "pool.hpp"

namespace nb = nanobind;

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define FASTEST __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define FASTEST
#endif

namespace {

using In = nb::ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<nb::numpy, uint8_t, nb::ndim<2>>;
using Limits = nb::ndarray<const uint64_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Key = nb::ndarray<const uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

constexpr size_t kCalls = 32, kWords = 4, kSites = kCalls * kWords;  // per block: generator calls, words per call, sites
constexpr int64_t kBlocksPerPiece = 64;

// Random words of consecutive generator calls, word j of call i at [j][i]; the compiler vectorises the loops over calls.
inline void words_of(uint64_t first, uint32_t step, uint32_t phase, const uint32_t* key, uint32_t (*w)[kCalls]) {
    for (size_t i = 0; i < kCalls; ++i) {
        w[0][i] = static_cast<uint32_t>(first + i);
        w[1][i] = static_cast<uint32_t>((first + i) >> 32);
        w[2][i] = step;
        w[3][i] = phase;
    }
    uint32_t k0 = key[0], k1 = key[1];
    for (int round = 0; round < 10; ++round, k0 += kPhiloxW0, k1 += kPhiloxW1)
        for (size_t i = 0; i < kCalls; ++i) {
            const uint64_t p0 = uint64_t{kPhiloxM0} * w[0][i], p1 = uint64_t{kPhiloxM1} * w[2][i];
            const uint32_t c1 = w[1][i], c3 = w[3][i];
            w[0][i] = static_cast<uint32_t>(p1 >> 32) ^ c1 ^ k0;
            w[1][i] = static_cast<uint32_t>(p1);
            w[2][i] = static_cast<uint32_t>(p0 >> 32) ^ c3 ^ k1;
            w[3][i] = static_cast<uint32_t>(p0);
        }
}

// Advance a block of n sites through all steps; its first site is number 4 * first.
FASTEST void switch_block(const uint8_t* state, size_t n, uint64_t first, const uint64_t* up, const uint64_t* down, size_t stride,
                          size_t steps, uint32_t step, uint32_t phase, const uint32_t* key, uint8_t* out) {
    uint32_t now[kWords][kCalls] = {};  // all ones if a site is up
    for (size_t i = 0; i < n; ++i) now[i % kWords][i / kWords] = state[i] ? ~0u : 0u;
    uint32_t w[kWords][kCalls];
    for (size_t s = 0; s < steps; ++s) {
        words_of(first, step + static_cast<uint32_t>(s), phase, key, w);
        const uint64_t rise = up[s * stride], fall = down[s * stride];
        const uint32_t rises = rise ? ~0u : 0u, falls = fall ? ~0u : 0u;  // word < limit is word <= limit - 1, unless limit = 0
        const uint32_t rise_to = static_cast<uint32_t>(rise - 1), fall_to = static_cast<uint32_t>(fall - 1);
        for (size_t j = 0; j < kWords; ++j)
            for (size_t i = 0; i < kCalls; ++i) {
                const uint32_t is_up = now[j][i];
                const uint32_t last = (fall_to & is_up) | (rise_to & ~is_up), may = (falls & is_up) | (rises & ~is_up);
                now[j][i] = is_up ^ ((w[j][i] <= last ? ~0u : 0u) & may);
            }
    }
    for (size_t i = 0; i < n; ++i) out[i] = now[i % kWords][i / kWords] & 1;
}

Out switch_states(In state, Limits up, Limits down, Key key, uint64_t first_step, uint32_t phase, int threads) {
    const size_t groups = state.shape(0), n = state.shape(1), steps = up.shape(0);
    if (up.shape(1) != groups || down.shape(1) != groups || down.shape(0) != steps || key.shape(0) != 2)
        throw nb::value_error("switch_states takes states (g, n), limits (steps, g) twice and a key (2,)");
    std::unique_ptr<uint8_t[]> out(new uint8_t[groups * n]);
    const size_t calls = (n + kWords - 1) / kWords, blocks = (n + kSites - 1) / kSites;
    {
        nb::gil_scoped_release free;
        cicatrix::Pool pool(threads, kBlocksPerPiece);
        const int pieces = pool.pieces(groups * blocks);
        pool.each(pieces, [&](int piece) {
            const size_t from = groups * blocks * piece / pieces, to = groups * blocks * (piece + 1) / pieces;
            for (size_t b = from; b < to; ++b) {
                const size_t g = b / blocks, at = b % blocks * kSites;
                switch_block(state.data() + g * n + at, std::min(kSites, n - at), g * calls + at / kWords, up.data() + g,
                             down.data() + g, groups, steps, static_cast<uint32_t>(first_step), phase, key.data(),
                             out.get() + g * n + at);
            }
        });
    }
    uint8_t* data = out.release();
    return Out(data, {groups, n}, nb::capsule(data, [](void* p) noexcept { delete[] static_cast<uint8_t*>(p); }));
}

}  // namespace

void bind_switching(nb::module_& m) {
    m.def("switch_states", &switch_states, nb::arg("state"), nb::arg("up"), nb::arg("down"), nb::arg("key"), nb::arg("first_step"),
          nb::arg("phase"), nb::arg("threads") = 1, "States after some steps: see core/switching.py.");
}

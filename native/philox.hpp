// Philox4x32-10 (Salmon et al., SC11, 2011), one block. NumPy reference implementation: src/cicatrix/core/philox.py.
#pragma once

#include <cstdint>

namespace {

constexpr uint32_t kPhiloxM0 = 0xD2511F53u, kPhiloxM1 = 0xCD9E8D57u;
constexpr uint32_t kPhiloxW0 = 0x9E3779B9u, kPhiloxW1 = 0xBB67AE85u;

// Write the four words of counter (c0, c1, c2, c3) under key (k0, k1) to out.
inline void philox_block(uint32_t c0, uint32_t c1, uint32_t c2, uint32_t c3, uint32_t k0, uint32_t k1, uint32_t* out) {
    for (int round = 0; round < 10; ++round) {
        const uint64_t p0 = uint64_t{kPhiloxM0} * c0;
        const uint64_t p1 = uint64_t{kPhiloxM1} * c2;
        c0 = static_cast<uint32_t>(p1 >> 32) ^ c1 ^ k0;
        c1 = static_cast<uint32_t>(p1);
        c2 = static_cast<uint32_t>(p0 >> 32) ^ c3 ^ k1;
        c3 = static_cast<uint32_t>(p0);
        k0 += kPhiloxW0;
        k1 += kPhiloxW1;
    }
    out[0] = c0, out[1] = c1, out[2] = c2, out[3] = c3;
}

}  // namespace

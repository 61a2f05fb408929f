// This file is compiled several times; CICATRIX_ISA names the instruction set. It uses no standard containers, because the linker
// must not merge functions of this file with those compiled for another instruction set.
#include "kernels.hpp"

#include <cstring>
#include <type_traits>
#if defined(__AVX2__) || defined(__SSE2__)
#include <immintrin.h>
#endif

#include "philox.hpp"

// Force inlining: values of a tile stay in registers only if they are not passed to a function call.
#define ALWAYS __attribute__((always_inline))
#define INLINE inline ALWAYS

namespace cicatrix {
namespace {

// 32 lanes are stored in vectors of the machine's width, because the compiler splits wider vectors lane by lane.
#if defined(__AVX512BW__)
constexpr int kWidth = 64;
#elif defined(__AVX2__)
constexpr int kWidth = 32;
#else
constexpr int kWidth = 16;
#endif
constexpr int kParts = 2 * kLanes / kWidth;
typedef uint16_t Part __attribute__((vector_size(kWidth)));

// Copied part by part: copied as an aggregate it would go through memory in pieces of another width, which stalls.
struct U16 {
    Part part[kParts];

    U16() = default;
    template <class... Parts, class = std::enable_if_t<sizeof...(Parts) == kParts && (std::is_same_v<Parts, Part> && ...)>>
    explicit U16(Parts... parts) : part{parts...} {}
    U16(const U16& other) { *this = other; }
    U16& operator=(const U16& other) {
        for (int i = 0; i < kParts; ++i) part[i] = other.part[i];
        return *this;
    }
};

template <class Op>
INLINE U16 each(U16 a, U16 b, Op op) {
    U16 out;
    for (int i = 0; i < kParts; ++i) out.part[i] = op(a.part[i], b.part[i]);
    return out;
}

INLINE U16 operator+(U16 a, U16 b) { return each(a, b, [](Part x, Part y) { return x + y; }); }
INLINE U16 operator-(U16 a, U16 b) { return each(a, b, [](Part x, Part y) { return x - y; }); }
INLINE U16 operator*(U16 a, U16 b) { return each(a, b, [](Part x, Part y) { return x * y; }); }
INLINE U16 operator&(U16 a, U16 b) { return each(a, b, [](Part x, Part y) { return x & y; }); }
INLINE U16 operator|(U16 a, U16 b) { return each(a, b, [](Part x, Part y) { return x | y; }); }
INLINE U16 operator^(U16 a, U16 b) { return each(a, b, [](Part x, Part y) { return x ^ y; }); }
// comparisons give all ones in the lanes where they are true
INLINE U16 operator>(U16 a, U16 b) { return each(a, b, [](Part x, Part y) { return reinterpret_cast<Part>(x > y); }); }
INLINE U16 operator==(U16 a, U16 b) { return each(a, b, [](Part x, Part y) { return reinterpret_cast<Part>(x == y); }); }
INLINE U16 least(U16 a, U16 b) { return each(a, b, [](Part x, Part y) { return x < y ? x : y; }); }

INLINE U16 fill(uint16_t x) {
    U16 out;
    for (Part& part : out.part) part = Part{} + x;
    return out;
}

INLINE U16 operator~(U16 a) { return a ^ fill(0xFFFF); }

template <int n>
INLINE U16 shifted_right(U16 a) {
    for (Part& part : a.part) part >>= n;
    return a;
}

INLINE U16 load(const uint16_t* p) {
    U16 v;  // loaded part by part: a copy of the whole would go through memory
    for (int i = 0; i < kParts; ++i) std::memcpy(&v.part[i], p + i * (kWidth / 2), sizeof(Part));
    return v;
}

INLINE void store(uint16_t* p, U16 v) {
    for (int i = 0; i < kParts; ++i) std::memcpy(p + i * (kWidth / 2), &v.part[i], sizeof(Part));
}

INLINE bool any(U16 v) {
#if defined(__AVX512BW__)
    const __m512i x = reinterpret_cast<__m512i>(v.part[0]);
    return _mm512_test_epi64_mask(x, x) != 0;
#elif defined(__AVX2__)
    const __m256i x = reinterpret_cast<__m256i>(v.part[0] | v.part[1]);
    return !_mm256_testz_si256(x, x);
#else
    Part all = v.part[0];
    for (int i = 1; i < kParts; ++i) all |= v.part[i];
    uint64_t words[kWidth / 8], sum = 0;
    std::memcpy(words, &all, sizeof words);
    for (uint64_t word : words) sum |= word;
    return sum != 0;
#endif
}

// ---- shifts by one site. Each takes a tile and the adjacent tile, and returns the value of every lane's neighbour.

#if defined(__AVX512BW__)
using Wide = __m512i;
INLINE Wide wide(U16 v) { return reinterpret_cast<Wide>(v.part[0]); }
INLINE U16 narrow(Wide v) { return U16(reinterpret_cast<Part>(v)); }
#endif

// Select four of eight lines (0 .. 3 from `a`, 4 .. 7 from `b`): line k of the result is line ik.
template <int i0, int i1, int i2, int i3>
INLINE U16 lines(U16 a, U16 b) {
#if defined(__AVX512BW__)
    const Wide order = _mm512_setr_epi64(2 * i0, 2 * i0 + 1, 2 * i1, 2 * i1 + 1, 2 * i2, 2 * i2 + 1, 2 * i3, 2 * i3 + 1);
    return narrow(_mm512_permutex2var_epi64(wide(a), order, wide(b)));
#elif defined(__AVX2__)
    auto half = [&](int i) { return reinterpret_cast<__m256i>((i < 4 ? a : b).part[i % 4 / 2]); };
    return U16(reinterpret_cast<Part>(_mm256_permute2x128_si256(half(i0), half(i1), i0 % 2 | (2 + i1 % 2) << 4)),
             reinterpret_cast<Part>(_mm256_permute2x128_si256(half(i2), half(i3), i2 % 2 | (2 + i3 % 2) << 4)));
#else
    auto line = [&](int i) { return (i < 4 ? a : b).part[i % 4]; };
    return U16(line(i0), line(i1), line(i2), line(i3));
#endif
}

// Values of the neighbours before and after along the last axis.
INLINE uint32_t before(uint32_t v, uint32_t left) { return (v << 1 & 0xFEFEFEFEu) | (left >> 7 & 0x01010101u); }
INLINE uint32_t after(uint32_t v, uint32_t right) { return (v >> 1 & 0x7F7F7F7Fu) | (right << 7 & 0x80808080u); }

INLINE U16 before(U16 v, U16 left) {
#if defined(__AVX512BW__)
    return narrow(_mm512_alignr_epi8(wide(v), wide(left), 14));
#elif defined(__AVX2__)
    for (int i = 0; i < kParts; ++i)
        v.part[i] = reinterpret_cast<Part>(
            _mm256_alignr_epi8(reinterpret_cast<__m256i>(v.part[i]), reinterpret_cast<__m256i>(left.part[i]), 14));
    return v;
#elif defined(__SSE2__)
    for (int i = 0; i < kParts; ++i)
        v.part[i] = reinterpret_cast<Part>(_mm_or_si128(_mm_slli_si128(reinterpret_cast<__m128i>(v.part[i]), 2),
                                                        _mm_srli_si128(reinterpret_cast<__m128i>(left.part[i]), 14)));
    return v;
#else
    U16 out;
    for (int i = 0; i < kParts; ++i)
        for (int j = 0; j < kPlaces; ++j) out.part[i][j] = j ? v.part[i][j - 1] : left.part[i][kPlaces - 1];
    return out;
#endif
}

INLINE U16 after(U16 v, U16 right) {
#if defined(__AVX512BW__)
    return narrow(_mm512_alignr_epi8(wide(right), wide(v), 2));
#elif defined(__AVX2__)
    for (int i = 0; i < kParts; ++i)
        v.part[i] = reinterpret_cast<Part>(
            _mm256_alignr_epi8(reinterpret_cast<__m256i>(right.part[i]), reinterpret_cast<__m256i>(v.part[i]), 2));
    return v;
#elif defined(__SSE2__)
    for (int i = 0; i < kParts; ++i)
        v.part[i] = reinterpret_cast<Part>(_mm_or_si128(_mm_srli_si128(reinterpret_cast<__m128i>(v.part[i]), 2),
                                                        _mm_slli_si128(reinterpret_cast<__m128i>(right.part[i]), 14)));
    return v;
#else
    U16 out;
    for (int i = 0; i < kParts; ++i)
        for (int j = 0; j < kPlaces; ++j) out.part[i][j] = j < kPlaces - 1 ? v.part[i][j + 1] : right.part[i][0];
    return out;
#endif
}

// Values one site up (+) or down (-) along the first and the second axis; `other` is the tile on that side.
template <int D>
INLINE U16 up_first(U16 v, U16 other) {
    return D == 2 ? lines<1, 2, 3, 4>(v, other) : lines<2, 3, 4, 5>(v, other);
}
template <int D>
INLINE U16 down_first(U16 v, U16 other) {
    return D == 2 ? lines<7, 0, 1, 2>(v, other) : lines<6, 7, 0, 1>(v, other);
}
INLINE U16 up_second(U16 v, U16 other) { return lines<1, 4, 3, 6>(v, other); }
INLINE U16 down_second(U16 v, U16 other) { return lines<5, 0, 7, 2>(v, other); }

template <int D>
INLINE uint32_t up_first(uint32_t v, uint32_t other) {
    constexpr int n = D == 2 ? 8 : 16;
    return v >> n | other << (32 - n);
}
template <int D>
INLINE uint32_t down_first(uint32_t v, uint32_t other) {
    constexpr int n = D == 2 ? 8 : 16;
    return v << n | other >> (32 - n);
}
INLINE uint32_t up_second(uint32_t v, uint32_t other) { return (v >> 8 & 0x00FF00FFu) | (other << 8 & 0xFF00FF00u); }
INLINE uint32_t down_second(uint32_t v, uint32_t other) { return (v << 8 & 0xFF00FF00u) | (other >> 8 & 0x00FF00FFu); }

// Call use(neighbour values of all lanes) for each direction, in the order of docs/theory/automaton.md; at(row, 1) is the tile to
// the right.
template <int D, class At, class Use>
INLINE void each_neighbour(At&& at, Use&& use) {
    const auto here = at(0, 0), left = at(0, -1), right = at(0, 1), above = at(1, 0), below = at(2, 0);
    using T = std::decay_t<decltype(here)>;
    const T back = before(here, left), forth = after(here, right);
    use(up_first<D>(here, above));
    use(down_first<D>(here, below));
    if constexpr (D == 2) {
        use(forth);
        use(back);
        use(up_first<D>(back, before(above, at(1, -1))));
        use(down_first<D>(forth, after(below, at(2, 1))));
    } else {
        const auto beyond = at(3, 0), inside = at(4, 0);
        const T higher = up_second(here, beyond), lower = down_second(here, inside);
        use(higher);
        use(lower);
        use(forth);
        use(back);
        use(up_first<D>(lower, down_second(above, at(5, 0))));
        use(up_first<D>(back, before(above, at(1, -1))));
        use(down_first<D>(higher, up_second(below, at(6, 0))));
        use(up_second(back, before(beyond, at(3, -1))));
        use(down_first<D>(forth, after(below, at(2, 1))));
        use(down_second(forth, after(inside, at(4, 1))));
    }
}

template <int D, class Use>
INLINE void each_neighbour(int32_t id, Beside beside, const uint32_t* bits, Use&& use) {
    each_neighbour<D>([=](int row, int right) ALWAYS { return bits[(row ? beside[row][id] : id) + right]; }, use);
}

// Combine the values of all neighbours by a commutative, associative operation. Values from the same side are combined before
// they are shifted, to save shifts.
template <int D, class At, class Join>
INLINE auto join_neighbours(At&& at, Join&& join) {
    const auto here = at(0, 0), left = at(0, -1), right = at(0, 1), above = at(1, 0), below = at(2, 0);
    using T = std::decay_t<decltype(here)>;
    const T back = before(here, left), forth = after(here, right);
    T up = join(here, back), up_other = join(above, before(above, at(1, -1)));
    T down = join(here, forth), down_other = join(below, after(below, at(2, 1)));
    T all = join(forth, back);
    if constexpr (D == 3) {
        const auto beyond = at(3, 0), inside = at(4, 0);
        const T higher = up_second(here, beyond), lower = down_second(here, inside);
        up = join(up, lower), up_other = join(up_other, down_second(above, at(5, 0)));
        down = join(down, higher), down_other = join(down_other, up_second(below, at(6, 0)));
        all = join(join(all, join(higher, lower)), up_second(back, before(beyond, at(3, -1))));
        all = join(all, down_second(forth, after(inside, at(4, 1))));
    }
    return join(all, join(up_first<D>(up, up_other), down_first<D>(down, down_other)));
}

// The same for the neighbours within the tile itself; `none` is the neutral element of the operation.
template <int D, class Join>
INLINE U16 join_within(U16 here, U16 none, Join&& join) {
    const U16 back = before(here, none), forth = after(here, none);
    U16 up = join(here, back), down = join(here, forth), all = join(forth, back);
    if constexpr (D == 3) {
        const U16 higher = up_second(here, none), lower = down_second(here, none);
        up = join(up, lower), down = join(down, higher);
        all = join(join(all, join(higher, lower)), join(up_second(back, none), down_second(forth, none)));
    }
    return join(all, join(up_first<D>(up, none), down_first<D>(down, none)));
}

template <int D, class Join>
INLINE U16 join_neighbours(int32_t id, Beside beside, const uint16_t* values, Join&& join) {
    return join_neighbours<D>(
        [=](int row, int right) ALWAYS { return load(values + kLanes * size_t((row ? beside[row][id] : id) + right)); },
        join);
}

template <int D, class Join>
INLINE uint32_t join_neighbours(int32_t id, Beside beside, const uint32_t* bits, Join&& join) {
    return join_neighbours<D>([=](int row, int right) ALWAYS { return bits[(row ? beside[row][id] : id) + right]; }, join);
}

// Convert a lane mask (result of a comparison) to 32 bits.
INLINE uint32_t bits_of(U16 mask) {
#if defined(__AVX512BW__)
    return _mm512_movepi16_mask(reinterpret_cast<__m512i>(mask.part[0]));
#elif defined(__AVX2__)
    const __m256i packed = _mm256_packs_epi16(reinterpret_cast<__m256i>(mask.part[0]), reinterpret_cast<__m256i>(mask.part[1]));
    return static_cast<uint32_t>(_mm256_movemask_epi8(_mm256_permute4x64_epi64(packed, 0xD8)));
#elif defined(__SSE2__)
    auto half = [&](int i) {
        const __m128i low = reinterpret_cast<__m128i>(mask.part[i]), high = reinterpret_cast<__m128i>(mask.part[i + 1]);
        return static_cast<uint32_t>(_mm_movemask_epi8(_mm_packs_epi16(low, high)));
    };
    return half(0) | half(2) << 16;
#else
    uint32_t out = 0;
    for (int j = 0; j < kLanes; ++j) out |= static_cast<uint32_t>(mask.part[j / (kWidth / 2)][j % (kWidth / 2)] & 1) << j;
    return out;
#endif
}

// Convert 32 bits to a lane mask: all ones in the lanes whose bit is set.
INLINE U16 lanes_of(uint32_t bits) {
#if defined(__AVX512BW__)
    return U16(reinterpret_cast<Part>(_mm512_movm_epi16(bits)));
#else
    const uint16_t bit[16] = {1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768};
    U16 which;
    for (int i = 0; i < kParts; ++i) std::memcpy(&which.part[i], bit + i * (kWidth / 2) % 16, sizeof(Part));
    U16 both = fill(static_cast<uint16_t>(bits));
    const U16 high = fill(static_cast<uint16_t>(bits >> 16));
    for (int i = kParts / 2; i < kParts; ++i) both.part[i] = high.part[i];
    return (both & which) == which;
#endif
}

// Several generator calls at once, one per 64-bit lane. Only the low half of a lane is used; the upper half is never cleared.
// Lanes are loaded in such an order that unpacking the words leaves the calls in sequence.
#if defined(__AVX512F__)
using Lanes = __m512i;
constexpr int kCalls = 8;
INLINE Lanes load_calls(const uint64_t* p) {
    return _mm512_permutexvar_epi64(_mm512_setr_epi64(0, 4, 1, 5, 2, 6, 3, 7), _mm512_loadu_si512(p));
}
INLINE Lanes plus(Lanes a, uint64_t x) { return _mm512_add_epi64(a, _mm512_set1_epi64(static_cast<long long>(x))); }
INLINE Lanes all(uint32_t x) { return _mm512_set1_epi64(x); }
INLINE Lanes times(Lanes a, Lanes b) { return _mm512_mul_epu32(a, b); }
INLINE Lanes high(Lanes a) { return _mm512_srli_epi64(a, 32); }
INLINE Lanes mix(Lanes a, Lanes b, Lanes c) { return _mm512_ternarylogic_epi64(a, b, c, 0x96); }
INLINE void store_calls(Lanes a, Lanes b, Lanes c, Lanes d, uint32_t* out) {
    const Lanes ab = _mm512_mask_blend_epi32(0xAAAA, a, _mm512_slli_epi64(b, 32));
    const Lanes cd = _mm512_mask_blend_epi32(0xAAAA, c, _mm512_slli_epi64(d, 32));
    _mm512_storeu_si512(out, _mm512_unpacklo_epi64(ab, cd));
    _mm512_storeu_si512(out + 16, _mm512_unpackhi_epi64(ab, cd));
}
#elif defined(__AVX2__)
using Lanes = __m256i;
constexpr int kCalls = 4;
INLINE Lanes load_calls(const uint64_t* p) {
    return _mm256_permute4x64_epi64(_mm256_loadu_si256(reinterpret_cast<const Lanes*>(p)), 0xD8);
}
INLINE Lanes plus(Lanes a, uint64_t x) { return _mm256_add_epi64(a, _mm256_set1_epi64x(static_cast<long long>(x))); }
INLINE Lanes all(uint32_t x) { return _mm256_set1_epi64x(x); }
INLINE Lanes times(Lanes a, Lanes b) { return _mm256_mul_epu32(a, b); }
INLINE Lanes high(Lanes a) { return _mm256_srli_epi64(a, 32); }
INLINE Lanes mix(Lanes a, Lanes b, Lanes c) { return _mm256_xor_si256(_mm256_xor_si256(a, b), c); }
INLINE void store_calls(Lanes a, Lanes b, Lanes c, Lanes d, uint32_t* out) {
    const Lanes ab = _mm256_blend_epi32(a, _mm256_slli_epi64(b, 32), 0xAA);
    const Lanes cd = _mm256_blend_epi32(c, _mm256_slli_epi64(d, 32), 0xAA);
    _mm256_storeu_si256(reinterpret_cast<Lanes*>(out), _mm256_unpacklo_epi64(ab, cd));
    _mm256_storeu_si256(reinterpret_cast<Lanes*>(out + 8), _mm256_unpackhi_epi64(ab, cd));
}
#elif defined(__SSE2__)
using Lanes = __m128i;
constexpr int kCalls = 2;
INLINE Lanes load_calls(const uint64_t* p) { return _mm_loadu_si128(reinterpret_cast<const Lanes*>(p)); }
INLINE Lanes plus(Lanes a, uint64_t x) { return _mm_add_epi64(a, _mm_set1_epi64x(static_cast<long long>(x))); }
INLINE Lanes all(uint32_t x) { return _mm_set1_epi64x(x); }
INLINE Lanes times(Lanes a, Lanes b) { return _mm_mul_epu32(a, b); }
INLINE Lanes high(Lanes a) { return _mm_srli_epi64(a, 32); }
INLINE Lanes mix(Lanes a, Lanes b, Lanes c) { return _mm_xor_si128(_mm_xor_si128(a, b), c); }
INLINE void store_calls(Lanes a, Lanes b, Lanes c, Lanes d, uint32_t* out) {
    const Lanes low = _mm_set1_epi64x(0xFFFFFFFF);
    const Lanes ab = _mm_or_si128(_mm_and_si128(a, low), _mm_slli_epi64(b, 32));
    const Lanes cd = _mm_or_si128(_mm_and_si128(c, low), _mm_slli_epi64(d, 32));
    _mm_storeu_si128(reinterpret_cast<Lanes*>(out), _mm_unpacklo_epi64(ab, cd));
    _mm_storeu_si128(reinterpret_cast<Lanes*>(out + 4), _mm_unpackhi_epi64(ab, cd));
}
#else
using Lanes = uint64_t;
constexpr int kCalls = 1;
INLINE Lanes load_calls(const uint64_t* p) { return *p; }
INLINE Lanes plus(Lanes a, uint64_t x) { return a + x; }
#endif

// Random words of n groups of calls, interleaved to hide the latency of the multiplications.
template <int n>
INLINE void calls(const Lanes* group, uint64_t first, uint32_t step, uint32_t phase, const uint32_t* key, uint32_t* out) {
#if defined(__SSE2__)
    Lanes c0[n], c1[n], c2[n], c3[n];
    for (int i = 0; i < n; ++i) c0[i] = plus(group[i], first), c1[i] = high(c0[i]), c2[i] = all(step), c3[i] = all(phase);
    const Lanes m0 = all(kPhiloxM0), m1 = all(kPhiloxM1);
    uint32_t k0 = key[0], k1 = key[1];
    for (int round = 0; round < 10; ++round, k0 += kPhiloxW0, k1 += kPhiloxW1) {
        const Lanes key0 = all(k0), key1 = all(k1);
        for (int i = 0; i < n; ++i) {
            const Lanes p0 = times(c0[i], m0), p1 = times(c2[i], m1);
            c0[i] = mix(high(p1), c1[i], key0);
            c1[i] = p1;
            c2[i] = mix(high(p0), c3[i], key1);
            c3[i] = p0;
        }
    }
    for (int i = 0; i < n; ++i) store_calls(c0[i], c1[i], c2[i], c3[i], out + 4 * kCalls * i);
#else
    for (int i = 0; i < n; ++i)
        philox_block(static_cast<uint32_t>(group[i] + first), static_cast<uint32_t>((group[i] + first) >> 32), step, phase,
                     key[0], key[1], out + 4 * i);
#endif
}

void philox(const uint64_t* group, size_t n, uint32_t step, uint32_t phase, const uint32_t* key, uint32_t* out) {
    size_t i = 0;
    for (; i + 2 * kCalls <= n; i += 2 * kCalls) {
        const Lanes two[2] = {load_calls(group + i), load_calls(group + i + kCalls)};
        calls<2>(two, 0, step, phase, key, out + 4 * i);
    }
    for (; i < n; ++i)
        philox_block(static_cast<uint32_t>(group[i]), static_cast<uint32_t>(group[i] >> 32), step, phase, key[0], key[1],
                     out + 4 * i);
}

// Random words of a tile's sites, in the order of its lanes. If every line begins with the first of the four sites of a call,
// eight calls give them all; otherwise each line takes three calls, of which some words are not used.
class TileWords {
   public:
    explicit TileWords(const Draw& draw) : draw_(draw) {
        uint64_t group[kTileCalls];
        for (int i = 0; i < kTileCalls; ++i) {
            const int64_t line = draw.line[i / 2];
            lines_aligned_ &= (line & 3) == 0;
            group[i] = static_cast<uint64_t>(line >> 2) + i % 2;
        }
        for (int i = 0; i < kTileCalls; i += kCalls) group_[i / kCalls] = load_calls(group + i);
    }

    // Only the words of the sites in `meant` are needed; calls for other sites may be skipped.
    void get(int32_t id, uint32_t meant, uint32_t* words) const {
        const int64_t first = draw_.first_site[id];
        if (!lines_aligned_ || (first & 3)) return get_unaligned(first, words);
        for (int i = 0; i < kTileCalls; i += kPair * kCalls) {
            const uint32_t here = meant >> 4 * i;
            if (here & of_calls<kPair>)
                calls<kPair>(group_ + i / kCalls, static_cast<uint64_t>(first >> 2), draw_.step, draw_.phase, draw_.key,
                             words + 4 * i);
        }
    }

   private:
    static constexpr int kTileCalls = kLanes / 4, kLineCalls = 3, kPair = kTileCalls > kCalls ? 2 : 1;

    template <int n>
    static constexpr uint32_t of_calls = static_cast<uint32_t>((uint64_t{1} << 4 * n * kCalls) - 1);

    void get_unaligned(int64_t first, uint32_t* words) const {
        constexpr int n = kLines * kLineCalls, most = (n + kCalls - 1) / kCalls * kCalls;
        uint64_t group[most] = {};
        uint32_t buffer[4 * most];
        for (int i = 0; i < n; ++i)
            group[i] = (static_cast<uint64_t>(first + draw_.line[i / kLineCalls]) >> 2) + i % kLineCalls;
        for (int i = 0; i < n; i += kCalls) {
            const Lanes one = load_calls(group + i);
            calls<1>(&one, 0, draw_.step, draw_.phase, draw_.key, buffer + 4 * i);
        }
        for (int i = 0; i < kLines; ++i)
            std::memcpy(words + kPlaces * i, buffer + 4 * kLineCalls * i + ((first + draw_.line[i]) & 3), 4 * kPlaces);
    }

    const Draw& draw_;
    bool lines_aligned_ = true;
    Lanes group_[kTileCalls / kCalls];
};

// Bit j is set if word j is below the bound.
INLINE uint32_t bits_below(const uint32_t* word, uint32_t bound) {
#if defined(__AVX512BW__)
    const __m512i limit = _mm512_set1_epi32(static_cast<int>(bound));
    const uint32_t low = _mm512_cmplt_epu32_mask(_mm512_loadu_si512(word), limit);
    return low | uint32_t{_mm512_cmplt_epu32_mask(_mm512_loadu_si512(word + 16), limit)} << 16;
#else
    uint16_t is_below[kLanes];
    for (int j = 0; j < kLanes; ++j) is_below[j] = word[j] < bound ? 0xFFFF : 0;
    return bits_of(load(is_below));
#endif
}

// floor(word n / 2^32) for 32 words; each word is multiplied in two halves, so that the products fit into 32 bits.
INLINE U16 scaled(const uint32_t* word, uint32_t n) {
#if defined(__AVX512BW__)
    const __m512i factor = _mm512_set1_epi32(static_cast<int>(n));
    __m256i half[2];
    for (int i = 0; i < 2; ++i) {
        const __m512i w = _mm512_loadu_si512(word + 16 * i);
        const __m512i low = _mm512_mullo_epi32(_mm512_and_si512(w, _mm512_set1_epi32(0xFFFF)), factor);
        const __m512i high = _mm512_mullo_epi32(_mm512_srli_epi32(w, 16), factor);
        half[i] = _mm512_cvtepi32_epi16(_mm512_srli_epi32(_mm512_add_epi32(high, _mm512_srli_epi32(low, 16)), 16));
    }
    return U16(reinterpret_cast<Part>(_mm512_inserti64x4(_mm512_castsi256_si512(half[0]), half[1], 1)));
#else
    uint16_t value[kLanes];
    for (int j = 0; j < kLanes; ++j)
        value[j] = static_cast<uint16_t>(((word[j] >> 16) * n + ((word[j] & 0xFFFF) * n >> 16)) >> 16);
    return load(value);
#endif
}

void draw(Ids ids, Draw draw, const uint32_t* mask, uint64_t limit, uint32_t* hit) {
    const TileWords tile_words(draw);
    const bool always = limit > 0xFFFFFFFFu;
    const uint32_t bound = static_cast<uint32_t>(limit);
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        uint32_t word[kLanes] = {};
        tile_words.get(id, mask[id], word);
        hit[id] = (always ? ~0u : bits_below(word, bound)) & mask[id];
    }
}

void random_values(Ids ids, Draw draw, const uint32_t* mask, uint16_t base, uint32_t n, uint16_t* out) {
    const TileWords tile_words(draw);
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        uint32_t word[kLanes] = {};
        tile_words.get(id, mask[id], word);
        const U16 meant = lanes_of(mask[id]), value = scaled(word, n) + fill(base);
        uint16_t* here = out + kLanes * size_t(id);
        store(here, (meant & value) | (~meant & load(here)));
    }
}

void expand(Ids ids, const uint32_t* bits, uint16_t bulk, uint16_t* u) {
    const U16 value = fill(bulk);
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        store(u + kLanes * size_t(id), lanes_of(bits[id]) & value);
    }
}

int64_t sift(Ids ids, const uint16_t* u, uint16_t low, uint16_t high, uint32_t* above, uint32_t* within) {
    const U16 bottom = fill(low), top = fill(high), height = fill(high - low);
    int64_t n_mixed = 0;
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        const U16 v = load(u + kLanes * size_t(id));
        above[id] = bits_of(v > top);
        within[id] = ~bits_of(v - bottom > height);
        n_mixed += any(v ^ fill(u[kLanes * size_t(id)]));
    }
    return n_mixed;
}

INLINE uint32_t popcount(uint32_t x) {
#if defined(__POPCNT__)
    return static_cast<uint32_t>(__builtin_popcount(x));
#else
    x -= x >> 1 & 0x55555555u;
    x = (x & 0x33333333u) + (x >> 2 & 0x33333333u);
    return ((x + (x >> 4)) & 0x0F0F0F0Fu) * 0x01010101u >> 24;
#endif
}

int64_t count_bits(Ids ids, const uint32_t* bits) {
    int64_t sum = 0;
    for (size_t i = 0; i < ids.count; ++i) sum += popcount(bits[ids.first[i]]);
    return sum;
}

template <int D>
void diffuse(Ids ids, Beside beside, const uint8_t* plain, const uint16_t* own, const uint32_t* fillable, const uint16_t* u,
             uint16_t* out) {
    using G = Geometry<D>;
    const U16 half = fill(1 << (G::shift - 1));
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        const U16 here = load(u + kLanes * size_t(id));
        const U16 total = join_neighbours<D>(id, beside, u, [](U16 a, U16 b) ALWAYS { return a + b; });
        U16 next;
        if (plain[id])
            next = shifted_right<G::shift>(total + here * fill(G::own) + half);
        else
            next = shifted_right<G::shift>(total + here * load(own + kLanes * size_t(id)) + half) & lanes_of(fillable[id]);
        store(out + kLanes * size_t(id), next);
    }
}

template <int D>
void start(Ids ids, Beside beside, const uint8_t* plain, const uint16_t* own, const uint32_t* fillable, const uint32_t* bits,
           uint16_t* out) {
    using G = Geometry<D>;
    const U16 half = fill(1 << (G::shift - 1));
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        U16 n = fill(0);
        each_neighbour<D>(id, beside, bits, [&](uint32_t seen) ALWAYS { n = n - lanes_of(seen); });
        const U16 weight = plain[id] ? fill(G::own) : load(own + kLanes * size_t(id));
        n = n + (lanes_of(bits[id]) & weight);
        const U16 next = shifted_right<G::shift>(n * fill(G::bulk) + half);
        store(out + kLanes * size_t(id), plain[id] ? next : next & lanes_of(fillable[id]));
    }
}

template <int D>
void weigh(Ids ids, Beside beside, const uint8_t* plain, const uint32_t* fillable, uint16_t* own) {
    using G = Geometry<D>;
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        if (plain[id]) continue;
        U16 weight = fill(G::own);
        each_neighbour<D>(id, beside, fillable, [&](uint32_t seen) ALWAYS { weight = weight - lanes_of(~seen); });
        store(own + kLanes * size_t(id), weight);
    }
}

INLINE uint32_t either(uint32_t a, uint32_t b) { return a | b; }
INLINE uint32_t both(uint32_t a, uint32_t b) { return a & b; }

template <int D>
void touching(Ids ids, Beside beside, const uint32_t* mask, const uint32_t* bits, uint32_t* out) {
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        out[id] = mask[id] ? mask[id] & join_neighbours<D>(id, beside, bits, either) : 0;
    }
}

template <int D>
void border(Ids ids, Beside beside, const uint32_t* bits, uint32_t* out) {
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        out[id] = bits[id] ? bits[id] & ~join_neighbours<D>(id, beside, bits, both) : 0;
    }
}

template <int D>
void price(Ids ids, Beside beside, const uint32_t* bits, const uint32_t* mask, uint16_t unit, const uint16_t* extra,
           uint16_t* d) {
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        U16 n_near = fill(0);
        each_neighbour<D>(id, beside, bits, [&](uint32_t seen) ALWAYS { n_near = n_near - lanes_of(seen); });
        const U16 is_meant = lanes_of(mask[id]);
        uint16_t* here = d + kLanes * size_t(id);
        const U16 value = n_near * fill(unit) + load(extra + kLanes * size_t(id)) - fill(kNoPath);
        store(here, (is_meant & value) | (~is_meant & load(here)));
    }
}

template <int D>
void dilate(Ids ids, Beside beside, const uint32_t* bits, uint32_t* out) {
    for (size_t i = 0; i < ids.count; ++i) {
        const int32_t id = ids.first[i];
        out[id] = bits[id] == ~0u ? ~0u : bits[id] | join_neighbours<D>(id, beside, bits, either);
    }
}

template <int D>
bool relax_tile(int32_t id, Beside beside, const uint16_t* cost, uint16_t* d, uint8_t* dirty) {
    uint16_t* at = d + kLanes * size_t(id);
    const U16 own = load(cost + kLanes * size_t(id)), most = ~own, first = load(at);  // larger d than `most` saturate: no path
    U16 around[Geometry<D>::rows][3];  // adjacent tiles, loaded once
    for (int k = 0; k < Geometry<D>::rows; ++k)
        for (int right = -1; right <= 1; ++right)
            around[k][right + 1] = load(d + kLanes * size_t((k ? beside[k][id] : id) + right));
    const U16 far = fill(kFar);
    const U16 outside = join_neighbours<D>(
        [&](int row, int right) ALWAYS { return row || right ? around[row][right + 1] : far; }, least);
    U16 here = first;
    while (true) {  // iterate within the tile to convergence
        const U16 inside = join_within<D>(here, far, least);
        const U16 next = least(here, least(least(inside, outside), most) + own);
        if (!any(next ^ here)) break;
        here = next;
    }
    dirty[id] = 0;
    if (!any(here ^ first)) return false;
    store(at, here);
    static constexpr Seen<D> seen;
    const uint32_t changed = ~bits_of(here == first);
    for (int k = 0; k < Geometry<D>::rows; ++k)
        for (int right = -1; right <= 1; ++right)
            if (changed & seen.by[k][right + 1]) dirty[(k ? beside[k][id] : id) + right] = 1;
    return true;
}

template <int D>
bool relax(Ids ids, Beside beside, const uint16_t* cost, uint16_t* d, uint8_t* dirty) {
    bool ever = false;
    for (bool changed = true, down = true; changed; down = !down) {
        changed = false;
        for (size_t i = 0; i < ids.count; ++i) {
            const int32_t id = ids.first[down ? i : ids.count - 1 - i];
            if (dirty[id]) changed |= relax_tile<D>(id, beside, cost, d, dirty);
        }
        ever |= changed;
    }
    return ever;
}

template <int D>
constexpr Kernels::ByDimension by_dimension() {
    return {start<D>, diffuse<D>, weigh<D>, touching<D>, border<D>, price<D>, dilate<D>, relax<D>};
}

}  // namespace

#define CICATRIX_JOIN(a, b) a##b
#define CICATRIX_NAME(isa) CICATRIX_JOIN(kernels_, isa)
#define CICATRIX_STRING(x) #x
#define CICATRIX_QUOTED(x) CICATRIX_STRING(x)

const Kernels& CICATRIX_NAME(CICATRIX_ISA)() {
    static constexpr Kernels table = {CICATRIX_QUOTED(CICATRIX_ISA), philox, draw, random_values, count_bits, expand, sift,
                                      {by_dimension<2>(), by_dimension<3>()}};
    return table;
}

}  // namespace cicatrix

// Assembly of element matrices into the blocks of a sparse matrix. NumPy reference implementation: core/scatter.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>

namespace nb = nanobind;

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define INLINE inline __attribute__((always_inline))
#define FASTEST __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define INLINE inline
#define FASTEST
#endif

namespace {

using Data = nb::ndarray<double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Numbers = nb::ndarray<const int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Slots = nb::ndarray<const int32_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
template <int N>
using Array = nb::ndarray<const double, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

// Add one element matrix to the blocks. Rows (i, r) of the matrix are row_length apart; columns (j, c) have the strides j_step
// and c_step.
template <size_t B>
INLINE void scatter(double* data, const int32_t* slots, const double* matrix, size_t a, size_t row_length, size_t j_step,
                    size_t c_step) {
    for (size_t i = 0; i < a; ++i)
        for (size_t j = 0; j < a; ++j) {
            const int32_t slot = slots[i * a + j];
            if (slot < 0) continue;
            double* block = data + static_cast<size_t>(slot) * B * B;
            const double* from = matrix + 3 * i * row_length + j * j_step;
            for (size_t r = 0; r < B; ++r)
                for (size_t c = 0; c < B; ++c) block[r * B + c] += from[r * row_length + c * c_step];
        }
}

// Matrix of one element with rows (a, i) and columns (k, b): the sum over quadrature points of B A B, plus the sum of outer
// products of columns and rows.
template <size_t N, size_t D>
struct Contraction {
    static constexpr size_t length = 3 * N;
    double matrix[length * length];

    INLINE void add_point(const double* slope, const double* A) {
        double along[D][N];
        for (size_t b = 0; b < N; ++b)
            for (size_t L = 0; L < D; ++L) along[L][b] = slope[b * D + L];
        for (size_t i = 0; i < 3; ++i) {
            double T[D][length];
            for (size_t J = 0; J < D; ++J)
                for (size_t k = 0; k < 3; ++k) {
                    const double* row = A + ((i * D + J) * 3 + k) * D;
                    double* t = T[J] + k * N;
                    for (size_t b = 0; b < N; ++b) t[b] = row[0] * along[0][b];
                    for (size_t L = 1; L < D; ++L)
                        for (size_t b = 0; b < N; ++b) t[b] += row[L] * along[L][b];
                }
            for (size_t n = 0; n < N; ++n) {
                double* K = matrix + (3 * n + i) * length;
                for (size_t J = 0; J < D; ++J)
                    for (size_t m = 0; m < length; ++m) K[m] += slope[n * D + J] * T[J][m];
            }
        }
    }

    INLINE void add_outer(const double* column, const double* row) {
        double ordered[length];
        for (size_t b = 0; b < N; ++b)
            for (size_t k = 0; k < 3; ++k) ordered[k * N + b] = row[3 * b + k];
        for (size_t n = 0; n < length; ++n) {
            double* K = matrix + n * length;
            for (size_t m = 0; m < length; ++m) K[m] += column[n] * ordered[m];
        }
    }
};

template <size_t N, size_t D>
INLINE void contract_all(double* data, const int32_t* slots, const double* slopes, const double* A, const double* columns,
                         const double* rows, size_t n, size_t n_points, size_t n_outer, size_t b) {
    Contraction<N, D> element;
    for (size_t e = 0; e < n; ++e) {
        std::fill(element.matrix, element.matrix + 9 * N * N, 0.0);
        for (size_t q = 0; q < n_points; ++q)
            element.add_point(slopes + (e * n_points + q) * N * D, A + (e * n_points + q) * 9 * D * D);
        for (size_t o = 0; o < n_outer; ++o)
            element.add_outer(columns + (e * n_outer + o) * 3 * N, rows + (e * n_outer + o) * 3 * N);
        (b == 3 ? scatter<3> : scatter<2>)(data, slots + e * N * N, element.matrix, N, 3 * N, 1, N);
    }
}

FASTEST void contract_solid(double* data, const int32_t* slots, const double* slopes, const double* A, const double* columns,
                            const double* rows, size_t n, size_t n_points, size_t n_outer, size_t b) {
    contract_all<10, 3>(data, slots, slopes, A, columns, rows, n, n_points, n_outer, b);
}

FASTEST void contract_section(double* data, const int32_t* slots, const double* slopes, const double* A, const double* columns,
                              const double* rows, size_t n, size_t n_points, size_t n_outer, size_t b) {
    contract_all<7, 2>(data, slots, slopes, A, columns, rows, n, n_points, n_outer, b);
}

FASTEST void contract_sheet(double* data, const int32_t* slots, const double* slopes, const double* A, const double* columns,
                            const double* rows, size_t n, size_t n_points, size_t n_outer, size_t b) {
    contract_all<4, 2>(data, slots, slopes, A, columns, rows, n, n_points, n_outer, b);
}

// Replace each block (i, j) of a matrix in block compressed row format by left_i block right_j.
template <size_t B>
INLINE void turn_all(double* data, const int32_t* starts, const int32_t* columns, const double* left, const double* right,
                     size_t n) {
    for (size_t i = 0; i < n; ++i) {
        const double* L = left + i * B * B;
        for (int32_t k = starts[i]; k < starts[i + 1]; ++k) {
            double* block = data + static_cast<size_t>(k) * B * B;
            const double* R = right + static_cast<size_t>(columns[k]) * B * B;
            double half[B][B];
            for (size_t r = 0; r < B; ++r)
                for (size_t c = 0; c < B; ++c) {
                    half[r][c] = L[r * B] * block[c];
                    for (size_t m = 1; m < B; ++m) half[r][c] += L[r * B + m] * block[m * B + c];
                }
            for (size_t r = 0; r < B; ++r)
                for (size_t c = 0; c < B; ++c) {
                    double sum = half[r][0] * R[c];
                    for (size_t m = 1; m < B; ++m) sum += half[r][m] * R[m * B + c];
                    block[r * B + c] = sum;
                }
        }
    }
}

void check(const Data& data, const Slots& slots) {
    const size_t b = data.shape(1);
    if (data.shape(2) != b || b < 2 || b > 3) throw nb::value_error("data must be (n_blocks, b, b) with b = 2 or 3");
    if (slots.shape(1) != slots.shape(2)) throw nb::value_error("slots must be (n, a, a)");
    const int32_t* end = slots.data() + slots.size();
    if (slots.size() && *std::max_element(slots.data(), end) >= static_cast<int64_t>(data.shape(0)))
        throw nb::value_error("a slot lies beyond the data");
}

void add_blocks(Data data, Slots slots, Array<3> matrices) {
    check(data, slots);
    const size_t n = slots.shape(0), a = slots.shape(1), b = data.shape(1);
    if (matrices.shape(0) != n || matrices.shape(1) != 3 * a || matrices.shape(2) != 3 * a)
        throw nb::value_error("slots (n, a, a) and matrices (n, 3 a, 3 a) do not fit together");
    nb::gil_scoped_release release;
    for (size_t e = 0; e < n; ++e)
        (b == 3 ? scatter<3> : scatter<2>)(data.data(), slots.data() + e * a * a, matrices.data() + e * 9 * a * a, a, 3 * a, 3,
                                           1);
}

void add_contracted(Data data, Slots slots, Array<4> slopes, Array<6> A, Array<3> columns, Array<3> rows) {
    check(data, slots);
    const size_t n = slots.shape(0), a = slots.shape(1), d = slopes.shape(3), q = slopes.shape(1), o = rows.shape(1);
    if (!((a == 10 && d == 3) || (a == 7 && d == 2) || (a == 4 && d == 2)))
        throw nb::value_error("elements have 10 nodes and 3 axes, or 7 or 4 nodes and 2 axes");
    if (slopes.shape(0) != n || slopes.shape(2) != a || A.size() != n * q * 9 * d * d || columns.size() != n * o * 3 * a ||
        rows.size() != columns.size())
        throw nb::value_error("the arrays do not fit together");
    nb::gil_scoped_release release;
    (a == 10 ? contract_solid : a == 7 ? contract_section : contract_sheet)(
        data.data(), slots.data(), slopes.data(), A.data(), columns.data(), rows.data(), n, q, o, data.shape(1));
}

void turn_blocks(Data data, Numbers starts, Numbers columns, Array<3> left, Array<3> right) {
    const size_t b = data.shape(1), n = left.shape(0);
    if (data.shape(2) != b || b < 1 || b > 3) throw nb::value_error("data must be (n_blocks, b, b) with b = 1, 2 or 3");
    for (const Array<3>* side : {&left, &right})
        if (side->shape(0) != n || side->shape(1) != b || side->shape(2) != b)
            throw nb::value_error("left and right must be (n, b, b), b as of the data");
    if (starts.size() != n + 1 || columns.size() != data.shape(0) || starts.data()[0] != 0 ||
        starts.data()[n] != static_cast<int64_t>(columns.size()) || !std::is_sorted(starts.data(), starts.data() + n + 1))
        throw nb::value_error("rows must begin at ascending places from 0 to the number of blocks");
    for (size_t k = 0; k < columns.size(); ++k)
        if (columns.data()[k] < 0 || static_cast<size_t>(columns.data()[k]) >= n) throw nb::value_error("a column lies beyond the matrix");
    nb::gil_scoped_release release;
    (b == 3 ? turn_all<3> : b == 2 ? turn_all<2> : turn_all<1>)(data.data(), starts.data(), columns.data(), left.data(),
                                                                right.data(), n);
}

}  // namespace

void bind_scatter(nb::module_& m) {
    m.def("add_blocks", &add_blocks, nb::arg("data"), nb::arg("slots"), nb::arg("matrices"),
          "Add element matrices to the blocks of a sparse matrix; the reference implementation core/scatter.py documents the arguments.");
    m.def("add_contracted", &add_contracted, nb::arg("data"), nb::arg("slots"), nb::arg("slopes"), nb::arg("A"),
          nb::arg("columns"), nb::arg("rows"), "Contract element matrices and add them; the reference implementation core/scatter.py documents the arguments.");
    m.def("turn_blocks", &turn_blocks, nb::arg("data"), nb::arg("starts"), nb::arg("columns"), nb::arg("left"), nb::arg("right"),
          "Multiply blocks from both sides; the reference implementation core/scatter.py documents the arguments.");
}

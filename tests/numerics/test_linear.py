"""Linear solves compared with dense ones: every kind of matrix, reuse of a factor, and when it is replaced."""

from functools import partial

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import block_diag

from cicatrix.core import scatter
from cicatrix.core.native import add_blocks, add_contracted, turn_blocks
from cicatrix.mechanics.pattern import Pattern
from cicatrix.numerics import factors, linear
from cicatrix.numerics.linear import LinearSolver, conjugate_gradients, gmres
from cicatrix.numerics.workers import in_order

N_NODES = 40


@pytest.fixture(params=["mkl", "scipy"])
def library(request, monkeypatch):
    if request.param == "mkl" and factors.MKL is None:
        pytest.skip("MKL is not installed")
    monkeypatch.setenv("CICATRIX_LINEAR_SOLVER", request.param)
    return request.param


def matrix_of(b, shift=0.0, skew=0.0, seed=0):
    """Return a chain of springs between near nodes with random blocks: symmetric positive definite for shift = skew = 0."""
    rng = np.random.default_rng(seed)
    elements = np.arange(N_NODES - 3)[:, None] + np.arange(4)
    A = rng.standard_normal((len(elements), 12, 12))
    stiffness = A @ A.transpose(0, 2, 1) + skew * A
    pattern = Pattern([elements], np.arange(2, N_NODES), N_NODES, b)
    data = pattern.zeros()
    pattern.add(data, 0, 0, stiffness)
    return pattern.matrix(data, np.full(pattern.n_dofs, -shift))


def right_side(matrix):
    return np.random.default_rng(5).standard_normal(matrix.shape[0])


@pytest.mark.parametrize("b", [2, 3])
def test_pattern_sums_what_a_dense_loop_sums(b):
    """Entries of three elements with common nodes, one node left out and a diagonal added agree with a plain loop."""
    elements, nodes = np.array([[0, 1, 2], [2, 3, 1], [4, 0, 3]]), np.array([0, 1, 3, 4])
    matrices = np.random.default_rng(1).standard_normal((3, 9, 9))
    pattern = Pattern([elements, elements[:0]], nodes, 5, b)
    data = pattern.zeros()
    pattern.add(data, 0, 1, matrices[1:])
    pattern.add(data, 0, 0, matrices[:1])
    expected = np.diag(np.arange(1.0, 4 * b + 1))
    for element, K in zip(elements, matrices):
        for i, one in enumerate(element):
            for j, other in enumerate(element):
                if one != 2 and other != 2:
                    r, c = b * np.flatnonzero(nodes == one)[0], b * np.flatnonzero(nodes == other)[0]
                    expected[r : r + b, c : c + b] += K[3 * i : 3 * i + b, 3 * j : 3 * j + b]
    np.testing.assert_allclose(pattern.matrix(data, np.arange(1.0, 4 * b + 1)).toarray(), expected, atol=1e-14)


@pytest.mark.parametrize("b", [2, 3])
def test_compiled_scatter_is_its_reference(b):
    rng = np.random.default_rng(2)
    slots = rng.integers(-1, 50, (30, 6, 6)).astype(np.int32)
    matrices = rng.standard_normal((30, 18, 18))
    start = rng.standard_normal((50, b, b))
    fast, slow = start.copy(), start.copy()
    add_blocks(fast, slots, matrices)
    scatter.add_blocks(slow, slots, matrices)
    assert (fast == slow).all()


@pytest.mark.parametrize(("a", "d", "b"), [(10, 3, 3), (7, 2, 3), (7, 2, 2)])
def test_compiled_contraction_is_its_reference(a, d, b):
    """Compare with the reference version, for tetrahedra and triangles; that is tested against derivatives of the forces."""
    rng = np.random.default_rng(3)
    slots = rng.integers(-1, 40, (9, a, a)).astype(np.int32)
    slopes, A = rng.standard_normal((9, 4, a, d)), rng.standard_normal((9, 4, 3, d, 3, d))
    columns, rows = rng.standard_normal((9, 8, 3 * a)), rng.standard_normal((9, 8, 3 * a))
    fast, slow = np.ones((40, b, b)), np.ones((40, b, b))
    add_contracted(fast, slots, slopes, A, columns, rows)
    scatter.add_contracted(slow, slots, slopes, A, columns, rows)
    np.testing.assert_allclose(fast, slow, rtol=0, atol=1e-12 * np.abs(slow).max())


@pytest.mark.parametrize("b", [1, 2, 3])
def test_blocks_are_multiplied_from_both_sides(b):
    """Compiled and NumPy versions of R K L agree with dense matrices, for block-diagonal R and L."""
    rng = np.random.default_rng(4)
    matrix = sp.random_array((12, 12), density=0.3, rng=rng).tocsr()
    data = rng.standard_normal((matrix.nnz, b, b))
    left, right = rng.standard_normal((2, 12, b, b))
    K = sp.bsr_array((data, matrix.indices, matrix.indptr), shape=(12 * b, 12 * b)).toarray()
    expected = block_diag(*left) @ K @ block_diag(*right)
    places = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
    for turn in (turn_blocks, partial(scatter.turn_blocks, chunk=7)):
        turned = data.copy()
        turn(turned, *places, left, right)
        found = sp.bsr_array((turned, matrix.indices, matrix.indptr), shape=K.shape).toarray()
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("shift", "skew"), [(0.0, 0.0), (30.0, 0.0), (0.0, 0.3)], ids=["definite", "indefinite", "general"]
)
@pytest.mark.parametrize("b", [2, 3])
def test_solution_is_that_of_a_dense_solver(library, b, shift, skew):
    matrix = matrix_of(b, shift, skew)
    eigenvalues = np.linalg.eigvals(matrix.toarray()).real
    assert (eigenvalues.min() < 0) == (shift > 0)
    rhs, solver = right_side(matrix), LinearSolver()
    x = solver.solve(matrix, rhs, 1e-12, (lambda: matrix_of(b)) if skew else None)
    np.testing.assert_allclose(x, np.linalg.solve(matrix.toarray(), rhs), rtol=0, atol=1e-9 * np.abs(x).max())
    # with a single-precision factor GMRES may need a restart; the factor of the symmetric part is that of another matrix
    assert solver.n_steps <= (8 if shift == skew == 0.0 else 30)
    if skew == 0.0 and (
        library == "mkl" or shift == 0.0
    ):  # SuperLU gives no signs of eigenvalues for an indefinite matrix
        assert solver.is_definite(matrix) == (shift == 0.0)


def test_a_factor_is_kept_for_matrices_that_are_near(library):
    """After a change of 2 percent no factorisation is needed, and the new system is solved to its tolerance."""
    matrix, solver = matrix_of(3), LinearSolver()
    rhs = right_side(matrix)
    solver.solve(matrix, rhs, 1e-10)
    near = matrix.copy()
    near.data = near.data * (1.0 + 0.02 * np.cos(np.arange(len(near.data))))[:, None, None]
    near = sp.bsr_array(0.5 * (near + near.T), blocksize=(3, 3))
    near.sort_indices()
    x = solver.solve(near, rhs, 1e-10)
    assert solver.n_factorizations == 1
    assert np.linalg.norm(near @ x - rhs) <= 2e-10 * np.linalg.norm(rhs)


def test_negative_curvature_makes_a_factor_give_way(library):
    """With the factor of a definite matrix, an indefinite one is detected, both in a solve and by the search for curvature."""
    matrix, other = matrix_of(3), matrix_of(3, shift=30.0)
    solver, rhs = LinearSolver(), right_side(matrix_of(3))
    solver.solve(matrix, rhs, 1e-10)
    assert solver.is_definite(matrix)
    assert not solver.is_definite(other)
    x = solver.solve(other, rhs, 1e-10)
    assert np.linalg.norm(other @ x - rhs) <= 1e-9 * np.linalg.norm(rhs)
    assert solver.n_factorizations > 1


@pytest.mark.skipif(factors.MKL is None, reason="SuperLU counts no signs")
def test_signs_are_those_of_the_matrix_that_is_asked_about():
    """The reused factor belongs to another matrix: barely indefinite, then barely definite, and back."""
    lowest = np.linalg.eigvalsh(matrix_of(3).toarray())[0]
    indefinite, definite = matrix_of(3, lowest + 0.05), matrix_of(3, lowest - 0.05)
    solver, rhs = LinearSolver(), right_side(definite)
    solver.solve(indefinite, rhs, 1e-10)
    assert [solver.is_definite(matrix) for matrix in (indefinite, definite, indefinite)] == [False, True, False]


def test_multigrid_solves_what_is_too_large_for_superlu(monkeypatch):
    """A chain that gives three levels of aggregation; the result does not depend on the global random generator."""
    monkeypatch.setenv("CICATRIX_LINEAR_SOLVER", "pyamg")
    elements = np.arange(3000)[:, None] + np.arange(4)
    A = np.random.default_rng(0).standard_normal((len(elements), 12, 12))
    pattern = Pattern([elements], np.arange(3003), 3003)
    data = pattern.zeros()
    pattern.add(data, 0, 0, A @ A.transpose(0, 2, 1))
    matrix = pattern.matrix(data, np.zeros(pattern.n_dofs))
    rhs, found = right_side(matrix), []
    for _ in range(2):
        solver = LinearSolver()
        found.append(solver.solve(matrix, rhs, 1e-8))
        assert isinstance(solver._factor, factors.Multigrid)
        np.random.random()  # noqa: NPY002
    assert (found[0] == found[1]).all()
    assert np.linalg.norm(matrix @ found[0] - rhs) <= 2e-8 * np.linalg.norm(rhs)


def test_conjugate_gradients_end_in_as_many_steps_as_there_are_eigenvalues():
    """Three distinct eigenvalues need three iterations (theory)."""
    d = np.repeat([1.0, 3.0, 10.0], 20)
    matrix = sp.bsr_array(np.diag(d))
    x, steps = conjugate_gradients(matrix, np.ones(60), lambda r: r.copy(), 1e-12, 10)
    assert steps == 3
    np.testing.assert_allclose(x, 1 / d, rtol=1e-12)


@pytest.mark.parametrize("method", [conjugate_gradients, gmres])
def test_a_crawling_solve_is_given_up(method):
    """A spectrum over six decades without preconditioner gains hardly a digit per iteration."""
    matrix = sp.bsr_array(np.diag(np.geomspace(1.0, 1e6, 300)))
    solve = partial(method, matrix, np.ones(300), lambda r: r.copy(), 1e-6)
    assert solve(240, slowest=10.0) == (None, linear.MIN_JUDGED_ITERATIONS)
    patient, steps = solve(240)
    assert patient is not None or steps >= 240


def test_a_factor_that_crawls_gives_way_to_another():
    """As after surgery, the next matrix is very different."""
    solver, rhs = LinearSolver(), np.ones(300)
    solver.solve(sp.bsr_array(np.eye(300)), rhs, 1e-8)
    matrix = sp.bsr_array(np.diag(np.geomspace(1.0, 1e6, 300)))
    x = solver.solve(matrix, rhs, 1e-8)
    np.testing.assert_allclose(x, 1.0 / matrix.diagonal(), rtol=1e-5)
    assert solver.n_factorizations == 2
    assert solver.n_steps < 30


@pytest.mark.parametrize("threads", ["1", "3"])
def test_workers_answer_in_order_and_not_far_ahead(monkeypatch, threads):
    monkeypatch.setenv("CICATRIX_THREADS", threads)
    begun, answers = [], []
    for answer in in_order(lambda i: begun.append(i) or 2 * i, range(20)):
        answers.append(answer)
        assert len(begun) <= len(answers) + int(threads)
    assert answers == [2 * i for i in range(20)]


@pytest.mark.parametrize("fault", [np.nan, 0.0])
def test_a_matrix_that_cannot_be_factorised_is_refused(library, fault):
    matrix = matrix_of(3)
    matrix.data[:] = fault
    with pytest.raises(FloatingPointError):
        LinearSolver().solve(matrix, right_side(matrix), 1e-8)


@pytest.mark.parametrize(
    ("shift", "skew"), [(0.0, 0.0), (30.0, 0.0), (0.0, 0.3)], ids=["definite", "indefinite", "general"]
)
def test_a_restored_solver_goes_on_to_the_same_bits(library, shift, skew):
    matrix, near = matrix_of(3, shift, skew), matrix_of(3, shift + 0.01, skew)
    symmetric = (lambda: matrix_of(3)) if skew else None
    one, other, rhs = LinearSolver(), LinearSolver(), right_side(matrix_of(3))
    one.solve(matrix, rhs, 1e-10, symmetric)
    other.restore(matrix, {name: array.copy() for name, array in one.state_arrays().items()})
    assert (one.solve(near, rhs, 1e-10, symmetric) == other.solve(near, rhs, 1e-10, symmetric)).all()
    assert other.n_factorizations == 0

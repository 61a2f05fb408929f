"""Tetrahedra: patch test, tangents compared with reference versions, objectivity, orders, locking, load after unload."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import skfem
from skfem.quadrature import get_quadrature

from cicatrix.core.scatter import contracted
from cicatrix.geometry.tetrahedra import boundary, oriented, unmirrored, volumes, with_middles
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics import body as bodies
from cicatrix.mechanics.body import Body, Discretization, deformation_gradients
from cicatrix.mechanics.elements import (
    Bulk,
    fluctuation_fraction,
    linearised,
    linearised_reference,
    tangent,
    tied_force,
    volume_ratio,
)
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.space import SolidSpace, tabulate
from cicatrix.numerics.compiler import COMPILER
from cicatrix.numerics.linear import LinearSolver

pytestmark = pytest.mark.xdist_group("solid")  # measured once

SIDE = 20.0  # mm


def block(n, side=SIDE):
    """Return irregular tetrahedra of a cube: (points, tetrahedra), inner vertices moved by up to 15 % of a cell."""
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0, side, n + 1)] * 3)
    points, inner = mesh.p.T.copy(), mesh.interior_nodes()
    points[inner] += 0.15 * side / n * np.random.default_rng(3).uniform(-1, 1, (inner.size, 3))
    return points, oriented(points, mesh.t.T)


def body_on(points, tetrahedra, law, is_fixed):
    space = SolidSpace(*with_middles(points, tetrahedra))
    shape = space.n_elements, space.table.weight.size
    fixed = np.unique(space.boundary[is_fixed(space.positions[space.boundary]).all(axis=1)])
    discretization = Discretization(space, np.zeros(0, int), fixed)
    ones = np.ones(space.n_elements)
    return Body(discretization, law, np.full(shape, 1e-6), ones, NeoHookean(1.0, 1.0), np.zeros(0))


def everywhere(X):
    return X[..., 0] > -1.0


def below(X):
    return X[..., 2] < 1e-9


@pytest.fixture(scope="module")
def soft():
    return NeoHookean(*moduli_from_young(3.0, 0.49))


@pytest.fixture(scope="module")
def body(soft):
    return body_on(*block(2), soft, everywhere)


@pytest.fixture(scope="module")
def bent(body):
    """Return curved unloaded and loaded shapes."""
    rng = np.random.default_rng(5)
    X = body.discretization.space.positions
    X = X + 0.05 * rng.standard_normal(X.shape)
    return X, X + 0.2 * np.sin(X[:, [1, 2, 0]] / 5.0) + 0.05 * rng.standard_normal(X.shape)


def test_faces_point_outward_and_close():
    """By the divergence theorem the flux of the position through the boundary is three times the volume (by hand 20^3)."""
    points, tetrahedra = block(3)
    faces = boundary(tetrahedra)
    a, b, c = points[faces].transpose(1, 0, 2)
    flux = np.sum(np.cross(b - a, c - a) * (a + b + c)) / 6.0
    assert flux == pytest.approx(3 * SIDE**3)
    assert volumes(points, tetrahedra).sum() == pytest.approx(SIDE**3)
    nodes, quadratic = with_middles(points, tetrahedra)
    np.testing.assert_array_equal(boundary(quadratic)[:, :3], faces)
    middles = boundary(quadratic)[:, 3:]
    np.testing.assert_allclose(nodes[middles], points[faces[:, [[0, 1], [1, 2], [0, 2]]]].mean(axis=2))
    mirrored = points * [1.0, 1.0, -1.0]
    assert (volumes(mirrored, unmirrored(mirrored, quadratic)) > 0).all()
    assert (volumes(mirrored, unmirrored(mirrored, tetrahedra)) > 0).all()


def test_volumes_of_quadrature_points_add_up(body):
    assert body.volumes(body.discretization.space.positions).sum() == pytest.approx(SIDE**3, rel=1e-13)


def test_patch(body):
    """With the border displaced by a constant F, Newton finds x = F X inside, and F at every point."""
    F = np.array([[1.2, 0.3, 0.1], [-0.1, 0.85, 0.0], [0.05, 0.0, 1.1]])
    X = body.discretization.space.positions
    start = X @ F.T
    inner = np.setdiff1d(np.arange(len(X)), body.discretization.fixed_nodes)
    assert inner.size > 20
    start[inner] += 0.05 * np.random.default_rng(1).standard_normal((inner.size, 3))
    x, _ = Equilibrium(1e-8).loaded(body, X, np.zeros(3), start)
    np.testing.assert_allclose(x, X @ F.T, rtol=0, atol=1e-12 * SIDE)
    found = deformation_gradients(body.discretization.space, X, x)
    np.testing.assert_allclose(found, np.broadcast_to(F, found.shape), atol=1e-11)


@pytest.mark.parametrize("unknown", ["loaded", "unloaded"])
def test_stiffness_equals_its_slow_reference(body, bent, unknown):
    """``linearised`` contracts point tangents; ``tangent`` differentiates the element force, which is an independent method."""
    X, x = (positions[body.discretization.space.element_nodes][:6] for positions in bent)
    table, gravity = body.discretization.space.table, np.array([9e3, -4e3, 2e3])
    kept = np.array([1.0, 0.5, 0.0, 0.3, 0.7, 1.0])
    bulk = Bulk(body.law, body.density[:6], np.array([1.0, 0.0, 0.3, 0.6, 0.9, 1.0]), kept)
    J = np.asarray(volume_ratio(X, x, bulk, table))
    if unknown == "loaded":
        fast = contracted(*linearised(X, x, J, bulk, table)[:4])
        slow = jax.jit(
            lambda y: tangent(lambda z: tied_force(X, z, bulk, gravity, table), y), compiler_options=COMPILER
        )(x)
    else:
        fast = contracted(*linearised_reference(X, x, J, bulk, gravity, table)[:4])
        slow = jax.jit(
            lambda Y: tangent(lambda Z: tied_force(Z, x, bulk, gravity, table), Y), compiler_options=COMPILER
        )(X)
    held = bulk.fraction > 0
    np.testing.assert_allclose(np.asarray(fast)[held], np.asarray(slow)[held], rtol=0, atol=1e-10 * np.abs(slow).max())
    assert (np.asarray(fast)[~held] == 0).all()


def test_residual_is_the_derivative_of_the_potential(body, bent, slope):
    X, x = bent
    gravity = np.array([3.0, -10.0, 2.0])
    d = np.random.default_rng(2).standard_normal(x.shape)
    expected = slope(lambda t: body.potential(X, x + t * d, gravity), 1e-3)
    assert np.sum(body.residual(X, x, gravity) * d) == pytest.approx(expected, rel=1e-7)


def test_threads_and_pieces_change_no_bit_of_a_tangent(body, bent, monkeypatch):
    """Elements are linearised in chunks, some of the last ones twice, on one and three threads."""
    X, x = bent
    J, found = body.volume_ratio(X, x), []
    monkeypatch.setattr(bodies, "PIECE", len(J) // 3 + 1)
    for threads in "13":
        monkeypatch.setenv("CICATRIX_THREADS", threads)
        matrix, rates = body.linearised(X, x, J, in_plane=False)
        found.append(matrix.data.tobytes() + rates.force_rate.tobytes() + rates.volume_rate.tobytes())
    assert found[0] == found[1]


def test_turned_bodies_bear_turned_forces(body, bent):
    X, x = bent
    Q = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    Q *= np.linalg.det(Q)
    r = body.residual(X, x, np.zeros(3))
    np.testing.assert_allclose(body.residual(X, x @ Q.T, np.zeros(3)), r @ Q.T, atol=1e-11 * np.abs(r).max())
    assert np.abs(body.residual(X, X @ Q.T, np.zeros(3))).max() < 1e-11 * np.abs(r).max()


@pytest.mark.parametrize("gravity", [(0.0, -9810.0, 0.0), (3000.0, 0.0, 9000.0)])
def test_forward_of_inverse_is_where_it_began(soft, gravity):
    """Unload a soft block on its base and load the result by other equations (slab of 20 mm, rho g L / mu = 0.2)."""
    body = body_on(*block(2), soft, below)
    x, g = body.discretization.space.positions, np.array(gravity)
    solver = Equilibrium(1e-10)
    X, _ = solver.unloaded(body, x, g)
    assert np.abs(X - x).max() > 0.1
    again, _ = solver.loaded(body, X, g)
    np.testing.assert_allclose(again, x, rtol=0, atol=1e-8)


# ---- manufactured finite deformation -----------------------------------------------------------------------------------


PULL = 2.0  # slope of the pressure [kPa/mm], twice the shear modulus over the cube


def shape(law, X):
    """Return x(X) (3,), three shears and then J = 1 + PULL z / kappa, so that the pressure is linear in z."""
    x = X[0] + 0.1 * jnp.sin(2.5 * X[1] + 0.3)
    y = X[1] + 0.1 * jnp.sin(2.5 * X[2])
    z = X[2] + 0.1 * jnp.sin(2.5 * x)
    return jnp.stack([x, y, z + PULL / law.kappa * z**2 / 2.0])


def gradient(law, X):
    return jax.jacfwd(lambda Y: shape(law, Y))(X)


def body_force(law, X):
    """Return -Div P(grad x(X)) (3,), the body force for equilibrium, by differentiating the law twice."""
    return -jnp.einsum("iJJ->i", jax.jacfwd(lambda Y: law.stress(gradient(law, Y)))(X))


SHAPES, GRADIENTS, FORCES = (
    jax.jit(jax.vmap(function, in_axes=(None, 0)), compiler_options=COMPILER)
    for function in (shape, gradient, body_force)
)


def padded(function, law, points):
    """Evaluate (..., 3) points in blocks of one size, so that nothing is compiled twice."""
    size, flat = 1024, points.reshape(-1, 3)
    blocks = np.pad(flat, ((0, -len(flat) % size), (0, 0))).reshape(-1, size, 3)
    values = np.concatenate([np.asarray(function(law, b)) for b in blocks])[: len(flat)]
    return values.reshape(*points.shape[:-1], *values.shape[1:])


def solve(body, law):
    """Solve with Newton from the nodal interpolant, with the body force as nodal loads by a rule of higher degree."""
    space = body.discretization.space
    X, cells = space.positions, space.element_nodes
    table = tabulate(skfem.ElementTetP2(), *get_quadrature(skfem.MeshTet.elem, 5))
    x = padded(SHAPES, law, X)
    points = np.einsum("qa,eai->eqi", table.value, X[cells])
    force = padded(FORCES, law, points)
    weights = table.weight * 6.0 * volumes(X, cells)[:, None]
    load = np.zeros_like(X)
    np.add.at(load, cells, np.einsum("eq,eqi,qa->eai", weights, force, table.value))
    free, _ = body.discretization.solved(False)
    solver = LinearSolver()
    for _ in range(8):
        r = (body.residual(X, x, np.zeros(3)) - load).ravel()[free]
        if np.linalg.norm(r) < 1e-9 * np.linalg.norm(load):
            return x
        matrix, _ = body.linearised(X, x, body.volume_ratio(X, x), in_plane=False)
        x.reshape(-1)[free] -= solver.solve(matrix, r, 1e-10)
    raise AssertionError("no convergence")


def errors(space, law, x):
    """Return the errors of x in L2 and of its gradient (H1), by a rule exact to degree 6."""
    table = tabulate(skfem.ElementTetP2(), *get_quadrature(skfem.MeshTet.elem, 6))
    X = space.positions[space.element_nodes]
    X_map = np.einsum("eai,qab->eqib", X, table.gradient)
    weights = table.weight * np.abs(np.linalg.det(X_map))
    points = np.einsum("qa,eai->eqi", table.value, X)
    exact, F_exact = padded(SHAPES, law, points), padded(GRADIENTS, law, points)
    found = np.einsum("qa,eai->eqi", table.value, x[space.element_nodes])
    F = np.einsum("eai,qab->eqib", x[space.element_nodes], table.gradient) @ np.linalg.inv(X_map)
    e0, e1 = np.sum((found - exact) ** 2, axis=-1), np.sum((F - F_exact) ** 2, axis=(-2, -1))
    return np.sqrt([np.sum(weights * e0), np.sum(weights * e1)])


@pytest.fixture(scope="module")
def measured():
    """Return errors (levels, 2) by Poisson ratio."""
    out = {}
    for nu in (0.3, 0.49, 0.4999):
        law = NeoHookean(*moduli_from_young(3.0, nu))
        bodies = [body_on(*block(n, 1.0), law, everywhere) for n in (3, 6)]
        out[nu] = np.array([errors(body.discretization.space, law, solve(body, law)) for body in bodies])
        print(f"nu = {nu}: errors {out[nu].tolist()}, orders {np.log2(out[nu][0] / out[nu][1]).tolist()}")
    return out


@pytest.mark.parametrize("nu", [0.3, 0.49, 0.4999])
@pytest.mark.parametrize(("norm", "order"), [("L2", 3.0), ("H1", 2.0)])
def test_order(measured, nu, norm, order):
    """The order is that of quadratic displacements, with a pressure that varies in space, at every Poisson ratio."""
    error = measured[nu][:, ("L2", "H1").index(norm)]
    assert np.log2(error[0] / error[1]) == pytest.approx(order, abs=0.3)


def test_no_locking(measured):
    """The error at 0.4999 exceeds that at 0.49 by at most a third."""
    assert (measured[0.4999] < 1.33 * measured[0.49]).all()


def test_the_share_that_is_kept():
    """The fraction is 1 up to a Poisson ratio of 0.499 (bulk over shear modulus 500); beyond, it follows by hand."""
    for nu in (0.3, 0.49, 0.4989):
        assert fluctuation_fraction(NeoHookean(*moduli_from_young(3.0, nu)), (2,)).tolist() == [1.0, 1.0]
    law = NeoHookean(np.array([1.0, 1.0]), np.array([500.0, 5e4]))
    np.testing.assert_allclose(fluctuation_fraction(law, (2,)), [1.0, 0.1], rtol=1e-9)

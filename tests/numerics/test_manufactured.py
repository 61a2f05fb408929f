"""Manufactured finite deformation: measured orders of the P2 element with bubble and linear pressure, and no locking."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse.linalg
import skfem
from skfem.quadrature import get_quadrature

from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.space import tabulate
from cicatrix.numerics.compiler import COMPILER

pytestmark = pytest.mark.xdist_group("manufactured")  # measured once

LEVELS = (8, 16)  # elements along the unit square


def shape(X):
    """Return x(X) (3,), two successive shears: J = 1 exactly, so the same shape serves every compressibility."""
    x = X[0] + 0.12 * jnp.sin(2.5 * X[1] + 0.3)
    y = X[1] + 0.12 * jnp.sin(2.5 * x)
    return jnp.stack([x, y, X[2]])


def body_force(law, X):
    """Return -Div P(grad x(X)) (3,), the body force for equilibrium, by differentiating the law twice."""
    gradient = jax.jacfwd(lambda Y: law.stress(jax.jacfwd(shape)(Y)))(X)
    return -jnp.einsum("iJJ->i", gradient)


SHAPES = jax.jit(jax.vmap(shape))
GRADIENTS = jax.jit(jax.vmap(jax.jacfwd(shape)))
FORCES = jax.jit(jax.vmap(body_force, in_axes=(None, 0)), compiler_options=COMPILER)


def padded(function, points):
    """Evaluate (n, 3) points in blocks of one size, so that nothing is compiled twice."""
    block = 256
    blocks = np.pad(points, ((0, -len(points) % block), (0, 0))).reshape(-1, block, 3)
    return np.concatenate([np.asarray(function(b)) for b in blocks])[: len(points)]


def solve(body, law):
    """Solve with Newton from the nodal interpolant, with the body force as nodal loads by quadrature."""
    space = body.discretization.space
    X, table, cells = space.positions, space.table, space.element_nodes
    x = X.copy()
    nodal = np.unique(cells[:, :6])
    x[nodal] = padded(SHAPES, X[nodal])
    points = np.einsum("qa,eai->eqi", table.value, X[cells])
    force = padded(lambda p: FORCES(law, p), points.reshape(-1, 3)).reshape(points.shape)
    shares = np.einsum("eq,eqi,qa->eai", body.volumes(X), force, table.value)
    load = np.zeros_like(X)
    np.add.at(load, cells, shares)
    free, _ = body.discretization.solved(True)
    norms = []
    for _ in range(8):
        r = (body.residual(X, x, np.zeros(3)) - load).ravel()[free]
        norms.append(np.linalg.norm(r))
        if norms[-1] < 1e-10 * np.linalg.norm(load):
            return x
        matrix, _ = body.linearised(X, x, body.volume_ratio(X, x), in_plane=True)
        x.reshape(-1)[free] -= scipy.sparse.linalg.spsolve(matrix.tocsc(), r)
    raise AssertionError(f"no convergence: {norms}")


def errors(space, x):
    """Return the errors of x in L2 and of its gradient (H1), by a rule exact to degree 8."""
    table = tabulate(skfem.ElementTriP2B(), *get_quadrature(skfem.MeshTri.elem, 8))
    X = space.positions
    X_map = np.einsum("eai,qab->eqib", X[space.element_nodes][..., :2], table.gradient)
    weights = table.weight * np.abs(np.linalg.det(X_map))
    points = np.einsum("qa,eai->eqi", table.value, X[space.element_nodes])
    exact = padded(SHAPES, points.reshape(-1, 3)).reshape(points.shape)
    F_exact = padded(GRADIENTS, points.reshape(-1, 3)).reshape(*points.shape, 3)[..., :2, :2]
    found = np.einsum("qa,eai->eqi", table.value, x[space.element_nodes])
    F = np.einsum("eai,qab->eqib", x[space.element_nodes][..., :2], table.gradient) @ np.linalg.inv(X_map)
    e0, e1 = np.sum((found - exact) ** 2, axis=-1), np.sum((F - F_exact) ** 2, axis=(-2, -1))
    return np.sqrt([np.sum(weights * e0), np.sum(weights * e1)])


@pytest.fixture(scope="module")
def measured(rectangle, body_on):
    """Return errors (levels, 2) by Poisson ratio."""
    out = {}
    meshes = [rectangle(1.0, 1.0, LEVELS[0], LEVELS[0])]
    for _ in LEVELS[1:]:
        meshes.append(meshes[-1].refined())
    for nu in (0.3, 0.499):
        law = NeoHookean(*moduli_from_young(3.0, nu))
        bodies = [body_on(mesh, law, lambda p: p[0] > -1) for mesh in meshes]
        out[nu] = np.array([errors(body.discretization.space, solve(body, law)) for body in bodies])
        print(f"nu = {nu}: errors {out[nu].tolist()}, orders {np.log2(out[nu][:-1] / out[nu][1:]).tolist()}")
    return out


def test_the_shape_keeps_its_volume():
    """Two shears: J = 1 (by hand), strains beyond 25 %."""
    F = padded(GRADIENTS, np.random.default_rng(0).uniform(0, 1, (50, 3)))
    np.testing.assert_allclose(np.linalg.det(F), 1.0, atol=1e-12)
    assert np.abs(F - np.eye(3)).max() > 0.25


@pytest.mark.parametrize("nu", [0.3, 0.499])
@pytest.mark.parametrize(("norm", "order"), [("L2", 3.0), ("H1", 2.0)])
def test_order(measured, nu, norm, order):
    """The order is that of P2 with a stable pressure (theory: Crouzeix & Raviart 1973)."""
    error = measured[nu][:, ("L2", "H1").index(norm)]
    assert np.log2(error[-2] / error[-1]) == pytest.approx(order, abs=0.15)


def test_no_locking(measured):
    """The error at 0.499 is at most twice that at 0.3, on every mesh."""
    assert (measured[0.499] < 2.0 * measured[0.3]).all()

"""The element: patch test, derivatives compared with a reference version and differences, skin and antiplane shear."""

import jax
import numpy as np
import pytest

from cicatrix.core.scatter import contracted
from cicatrix.materials.locking_skin import LockingSkin
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.body import deformation_gradients
from cicatrix.mechanics.elements import (
    Bulk,
    Membrane,
    linearised,
    linearised_reference,
    membrane_energy,
    membrane_force,
    tangent,
    tied_force,
    wrinkling_strain,
)
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.numerics.compiler import COMPILER

SIDE = 10.0


@pytest.fixture(scope="module")
def body(rectangle, body_on):
    """Return a square of nearly incompressible tissue with skin, fixed all around."""
    law = NeoHookean(*moduli_from_young(3.0, 0.499))
    return body_on(rectangle(SIDE, SIDE, 3, 3), law, lambda p: p[0] > -1, density=1.0, skin=5.0, thickness=1.0)


@pytest.fixture(scope="module")
def bent(body):
    """Return reference positions and a smooth finite deformation in all three components, with non-zero bubbles."""
    X = body.discretization.space.positions
    rng = np.random.default_rng(5)
    x = X + 0.02 * rng.standard_normal(X.shape)
    x[:, 0] += 0.6 * np.sin(X[:, 1] / 4)
    x[:, 2] += 0.3 * X[:, 1]
    return X, x


def sheared(X, F):
    x = X @ F.T
    x[:, 2] -= X[:, 2]
    return x


def test_uniform_stress_leaves_inner_nodes_in_balance(body):
    """Patch test in three components: x = F X with constant F is an exact equilibrium."""
    F = np.array([[1.2, 0.3, 0.0], [-0.1, 0.85, 0.0], [0.2, -0.4, 1.0]])
    X = body.discretization.space.positions
    r = body.residual(X, sheared(X, F), np.zeros(3))
    inner = np.ones(len(X), bool)
    inner[body.discretization.fixed_nodes] = False
    assert np.abs(r[inner]).max() < 1e-12 * np.abs(r[~inner]).max()


def test_patch_is_recovered_from_its_border(body):
    """Patch test: with the border displaced by a constant F, Newton finds x = F X inside and the same stress everywhere."""
    F = np.array([[1.2, 0.3, 0.0], [-0.1, 0.85, 0.0], [0.0, 0.0, 1.0]])
    X = body.discretization.space.positions
    exact, start = X @ F.T, X @ F.T
    inner = np.setdiff1d(np.arange(len(X)), body.discretization.fixed_nodes)
    start[inner, :2] += 0.05 * np.random.default_rng(1).standard_normal((inner.size, 2))
    x, _ = Equilibrium(1e-11).loaded(body, X, np.zeros(3), start)
    np.testing.assert_allclose(x, exact, rtol=0, atol=1e-10 * SIDE)
    F_found = deformation_gradients(body.discretization.space, X, x)
    np.testing.assert_allclose(F_found, np.broadcast_to(F, F_found.shape), atol=1e-10)


@pytest.mark.parametrize("unknown", ["loaded", "unloaded"])
def test_stiffness_equals_its_slow_reference(body, bent, unknown):
    """``linearised`` contracts point tangents; ``tangent`` differentiates the element force, which is an independent method."""
    X, x = (positions[body.discretization.space.element_nodes] for positions in bent)
    table = body.discretization.space.table
    fraction = np.ones(len(X))
    fraction[::4] = 0.0, 0.3, 0.6, 0.9, 1.0
    bulk = Bulk(body.law, body.density, fraction, body.fluctuation_fraction)
    J = body.volume_ratio(*bent)
    gravity = np.array([9e3, -4e3, 2e3])
    if unknown == "loaded":
        whole = jax.jit(lambda x: linearised(X, x, J, bulk, table), compiler_options=COMPILER)
        fast = contracted(*whole(x)[:4])
        force, at = (lambda y: tied_force(X, y, bulk, gravity, table)), x
    else:
        whole = jax.jit(lambda Y: linearised_reference(Y, x, J, bulk, gravity, table), compiler_options=COMPILER)
        fast = contracted(*whole(X)[:4])
        force, at = (lambda Y: tied_force(Y, x, bulk, gravity, table)), X
    slow = jax.jit(lambda y: tangent(force, y), compiler_options=COMPILER)(at)
    held = fraction > 0
    np.testing.assert_allclose(np.asarray(fast)[held], np.asarray(slow)[held], rtol=0, atol=1e-10 * np.abs(slow).max())
    assert (np.asarray(fast)[~held] == 0).all()


@pytest.mark.parametrize("unknown", ["loaded", "unloaded"])
def test_matrix_is_the_derivative_of_the_residual(body, bent, unknown, rates_along):
    """The assembled matrix of tissue and skin agrees with fourth-order differences of the residual in random directions."""
    X, x = bent
    gravity = np.array([9e3, -4e3, 2e3])
    if unknown == "loaded":
        matrix, _ = body.linearised(X, x, body.volume_ratio(X, x), in_plane=False)
        assert np.abs(matrix - matrix.T).max() < 1e-12 * np.abs(matrix).max()
    rng = np.random.default_rng(0)
    for _ in range(3):
        found, expected = rates_along(body, X, x, gravity, unknown, rng)
        np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_residual_is_the_derivative_of_the_potential(body, bent, slope):
    """Internal force and weight are the derivative of the potential in a random direction of all nodes."""
    X, x = bent
    gravity = np.array([3.0, -10.0, 2.0])
    d = np.random.default_rng(2).standard_normal(x.shape)
    expected = slope(lambda t: body.potential(X, x + t * d, gravity), 1e-3)
    assert np.sum(body.residual(X, x, gravity) * d) == pytest.approx(expected, rel=1e-7)


# skin ----------------------------------------------------------------------------------------------------------------

MU, THICKNESS, LENGTH, LIMIT = 5.0, 1.5, 4.0, 0.08
STRETCH = np.array([1.0, 1.001, 1.1, 1.6, 0.999, 0.6, 0.3, 1.2, 0.7, 1.05])
SHEAR = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.9, -0.1])


@pytest.fixture(scope="module")
def edges(body):
    """Return parallel straight skin edges, each with a stretch and a shear along the normal."""
    X = np.zeros((len(STRETCH), 3, 3))
    X[:, 1, 0], X[:, 2, 0] = LENGTH, LENGTH / 2
    turned = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    x = X * STRETCH[:, None, None]
    x[..., 2] += SHEAR[:, None] * X[..., 0]
    membrane = Membrane(NeoHookean(MU, 30.0), np.full(len(STRETCH), THICKNESS), np.asarray(LIMIT))
    return X, x @ turned.T, membrane, body.discretization.space.facet_table


def tension_field(prestretch):
    """Return the energy [kPa] of each of the edges by hand, from the singular values of F = [[lam, 0], [shear, 1]].

    Tension along the larger, mu/2 (l1^2 + l2^2 + (l1 l2)^-2 - 3), with l2 at least l1^(-1/2); what is shorter than that costs
    4 mu times the integral of w (1 - exp(-p/w)) from 0 to p, p the logarithm, w the wrinkling strain.
    """
    energies = []
    for stretch, shear in zip(STRETCH, SHEAR, strict=True):
        one, other = prestretch * np.linalg.svd([[stretch, 0.0], [shear, 1.0]], compute_uv=False)
        least = one**-0.5
        p = max(np.log(least / other), 0.0)
        wrinkles = 4 * MU * LIMIT * (p - LIMIT * (1.0 - np.exp(-p / LIMIT)))
        a = max(other, least)
        energies.append(MU / 2 * (one**2 + a**2 + (one * a) ** -2.0 - 3) + wrinkles)
    return np.array(energies)


@pytest.mark.parametrize("prestretch", [1.0, 1.1])
def test_skin_energy_in_closed_form(edges, prestretch):
    X, x, membrane, table = edges
    W = np.asarray(membrane_energy(X, x, membrane._replace(prestretch=prestretch), table)) / (THICKNESS * LENGTH)
    np.testing.assert_allclose(W, tension_field(prestretch), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("shear", [0.0, 0.3, 0.9])
def test_skin_that_locks_has_a_continuous_force_where_a_sheared_edge_becomes_slack(body, shear):
    """The force on an edge that is sheared along the normal has no jump as its length passes through that at rest."""
    X = np.zeros((1, 3, 3))
    X[:, 1, 0], X[:, 2, 0] = LENGTH, LENGTH / 2
    skin = Membrane(LockingSkin(1.3, 43.0), np.full(1, THICKNESS), np.asarray(LIMIT))
    force = forces_of(X, skin, body.discretization.space.facet_table)

    def at(stretch):
        x = stretch * X
        x[..., 2] += shear * X[..., 0]
        return np.asarray(force(x))

    assert np.abs(at(1.0 + 1e-7) - at(1.0 - 1e-7)).max() < 1e-3


def test_wrinkling_strain():
    """Film and tissue of equal stiffness: 3^(2/3) / 4; the film a thousand times stiffer: a hundredth of that. By hand."""
    assert wrinkling_strain(5.0, 5.0) == pytest.approx(0.25 * 3 ** (2 / 3))
    assert wrinkling_strain(5000.0, 5.0) == pytest.approx(0.0025 * 3 ** (2 / 3))


def forces_of(X, membrane, table):
    return jax.jit(lambda y: membrane_force(X, y, membrane, table), compiler_options=COMPILER)


def test_skin_force_and_tangent_are_derivatives(edges):
    """Compare with fourth-order differences, away from the change of curvature at rest."""
    X, x, membrane, table = edges
    d = np.random.default_rng(4).standard_normal(x.shape)
    h = 1e-4
    force = forces_of(X, membrane, table)
    energy = jax.jit(lambda y: membrane_energy(X, y, membrane, table), compiler_options=COMPILER)
    clear = np.array([1, 2, 3, 5, 6, 7, 8])

    def slope(f):
        a, b, c, e = (np.asarray(f(x + k * h * d)) for k in (-2, -1, 1, 2))
        return ((a - 8 * b + 8 * c - e) / (12 * h))[clear]

    f = np.asarray(force(x))
    np.testing.assert_allclose(np.sum(f * d, axis=(1, 2))[clear], slope(energy), rtol=1e-6, atol=1e-7)
    K = np.asarray(
        jax.jit(lambda y: tangent(lambda z: membrane_force(X, z, membrane, table), y), compiler_options=COMPILER)(x)
    )
    along = np.einsum("nij,nj->ni", K, d.reshape(len(d), -1))[clear].reshape(-1, 3, 3)
    np.testing.assert_allclose(along, slope(force), rtol=0, atol=1e-6 * np.abs(along).max())


def test_wrinkled_skin_bears_no_more_than_its_limit(edges):
    """Compressed far beyond the wrinkling strain, the force times the stretch is 4 mu w t and no longer grows."""
    X, x, membrane, table = edges
    force = np.asarray(forces_of(X, membrane, table)(x))
    bound = 4 * MU * LIMIT * THICKNESS
    ends = np.linalg.norm(force[[5, 6], 0], axis=1) * STRETCH[[5, 6]]
    np.testing.assert_allclose(ends, bound, rtol=0.01)
    assert (ends < bound).all()


# gravity along the normal --------------------------------------------------------------------------------------------


def test_antiplane_slab(rectangle, body_on):
    """A slab held at y = 0 and pulled along the normal: w = density g (L y - y^2/2) / mu (exact).

    A neo-Hookean solid is linear in shear; the normal stresses are taken up by a pressure mu shear^2 / 3, so the motion
    in the plane is of the order L mu shear^2 / kappa: 1e-4 of w here.
    """
    mu, kappa = moduli_from_young(3.0, 0.49999)
    slab = body_on(rectangle(SIDE, SIDE, 3, 3), NeoHookean(mu, kappa), lambda p: p[1] < 1e-9, density=1e-6)
    g = 0.5 * mu / (1e-6 * SIDE)  # shear of 0.5 at the clamped side
    X = slab.discretization.space.positions
    x, _ = Equilibrium().loaded(slab, X, np.array([0.0, 0.0, g]))
    y = X[: slab.discretization.space.mesh.nvertices, 1]
    w = 1e-6 * g * (SIDE * y - y**2 / 2) / mu
    moved = x[: len(y)] - X[: len(y)]
    np.testing.assert_allclose(moved[:, 2], w, atol=1e-5 * w.max())
    assert np.abs(moved[:, :2]).max() < 1e-4 * w.max()

"""Skin on solids: closed forms on a flat patch, wrinkling, derivatives, and a thin stiff layer of tetrahedra."""

from functools import partial

import jax
import numpy as np
import pytest
import skfem

from cicatrix.geometry.tetrahedra import oriented, with_middles
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.body import Body, Discretization
from cicatrix.mechanics.elements import (
    Membrane,
    membrane_energy,
    membrane_force,
    meshed_wrinkling_strain,
    tangent,
    wrinkling_strain,
)
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.space import SolidSpace
from cicatrix.numerics.compiler import COMPILER

MU, THICKNESS, LIMIT = 5.0, 1.5, 0.08
FILM_E, FAT_E = 56.0, 3.25  # kPa
CORNERS = np.array([[0.0, 0.0, 0.0], [4.0, 1.0, 0.0], [1.0, 3.0, 0.0]])
FLAT = np.vstack([CORNERS, 0.5 * (CORNERS[[0, 1, 0]] + CORNERS[[1, 2, 2]])])  # middles of 01, 12, 02
AREA = 5.5  # mm^2, by hand: (4 * 3 - 1 * 1) / 2
TABLE = SolidSpace(np.zeros((0, 3)), np.zeros((0, 10), int)).facet_table
TURN = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]


compiled = partial(jax.jit, compiler_options=COMPILER)


def skin(n):
    return Membrane(NeoHookean(MU, 30.0), np.full(n, THICKNESS), np.asarray(LIMIT))


@compiled
def energies(X, x):
    return membrane_energy(X, x, skin(len(X)), TABLE)


@compiled
def forces(X, x):
    return membrane_force(X, x, skin(len(X)), TABLE)


@compiled
def stiffness(X, x):
    return tangent(lambda y: membrane_force(X, y, skin(len(X)), TABLE), x)


@compiled
def reference_stiffness(X, x):
    return tangent(lambda Y: membrane_force(Y, x, skin(len(X)), TABLE), X)


def stretched(pairs):
    """Return flat faces with these principal stretches, on axes oblique to their edges, rotated in space: X, x (n, 6, 3)."""
    c, s = np.cos(0.7), np.sin(0.7)
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    F = np.stack([axes.T @ np.diag([one, other, 1.0]) @ axes for one, other in pairs])
    X = np.broadcast_to(FLAT, (len(pairs), 6, 3)).copy()
    return X, np.einsum("nij,naj->nai", F, X) @ TURN.T, axes @ TURN.T


def pulls(pairs):
    """Return the nominal stresses along the two axes (n, 2) [kPa], from the virial of the forces over the volume."""
    X, x, axes = stretched(pairs)
    f = np.asarray(forces(X, x))
    P = np.einsum("nai,naj->nij", f, X) / (AREA * THICKNESS)
    along = np.array([[np.cos(0.7), np.sin(0.7), 0.0], [-np.sin(0.7), np.cos(0.7), 0.0]])
    return np.einsum("ki,nij,kj->nk", axes[:2], P, along)


def test_a_stretched_sheet_in_closed_form():
    """Incompressible neo-Hookean sheet, by hand: mu (l1 - 1 / (l1^3 l2^2)) along the first axis, and alike along the second."""
    pairs = np.array([[1.3, 1.3], [1.0, 1.0], [1.5, 1.1], [1.0, 1.2], [1.05, 2.0], [1.4, 1.4**-0.5], [1.1, 0.98]])
    one, other = pairs.T
    expected = MU * np.stack([one - one**-3 * other**-2, other - other**-3 * one**-2], axis=1)
    np.testing.assert_allclose(pulls(pairs), expected, rtol=1e-9, atol=1e-8)
    W = np.asarray(energies(*stretched(pairs)[:2])) / (AREA * THICKNESS)
    expected = MU / 2 * (one**2 + other**2 + (one * other) ** -2 - 3)
    np.testing.assert_allclose(W, expected, rtol=1e-9, atol=1e-12)


def test_a_sheet_of_a_section_is_that_of_a_solid():
    """Stretched at constant width, like the skin of a section: mu/2 (l^2 + l^-2 - 2)."""
    lam = np.array([1.001, 1.1, 1.6])
    W = np.asarray(energies(*stretched([(s, 1.0) for s in lam])[:2])) / (AREA * THICKNESS)
    np.testing.assert_allclose(W, MU / 2 * (lam**2 + lam**-2 - 2), rtol=1e-9)


def test_a_wrinkled_sheet_pulls_as_a_string_and_bears_little():
    """Stretched to l and narrower than l^(-1/2): mu (l - l^-2) along, minus half of the compression across, up to 4 mu w.

    By hand: with p = -log(l2) - log(l)/2, l2 P2 = -4 mu w (1 - exp(-p/w)) and l P1 = mu (l^2 - 1/l) + l2 P2 / 2.
    """
    pairs = np.array([[1.3, 0.8], [1.3, 0.5], [1.02, 0.6], [1.0, 0.9]])
    one, other = pairs.T
    push = 4 * MU * LIMIT * (1 - np.exp((np.log(other) + 0.5 * np.log(one)) / LIMIT))
    expected = np.stack([MU * (one - one**-2) - push / 2 / one, -push / other], axis=1)
    np.testing.assert_allclose(pulls(pairs), expected, rtol=1e-7, atol=1e-8)


def test_a_slack_sheet_bears_no_more_than_its_limit():
    """Compressed in both directions: equal Kirchhoff stresses between 0 and 4 mu w, which is reached far from rest."""
    pairs = np.array([[0.999, 0.999], [0.9, 0.9], [0.9, 0.6], [0.5, 0.5]])
    kirchhoff = -pulls(pairs) * pairs / (4 * MU * LIMIT)
    assert (kirchhoff > 0).all()
    assert (kirchhoff < 1.0 + 1e-9).all()
    np.testing.assert_allclose(kirchhoff[3], 1.0, rtol=2e-3)
    np.testing.assert_allclose(kirchhoff[[0, 1, 3], 0], kirchhoff[[0, 1, 3], 1], rtol=1e-6)


STATES = {
    "rest": (1.0, 1.0),
    "taut": (1.3, 1.1),
    "taut alike": (1.2, 1.2),
    "wrinkled": (1.2, 0.7),
    "slack": (0.95, 0.7),
    "slack alike": (0.8, 0.8),
}


@pytest.fixture(scope="module")
def curved():
    """Return curved, slightly uneven faces in each state; flat ones at rest and with equal stretches stay exactly so."""
    X, x, _ = stretched(list(STATES.values()))
    rng = np.random.default_rng(7)
    uneven = [name in ("taut", "wrinkled", "slack") for name in STATES]
    X[uneven] += 0.05 * rng.standard_normal(X[uneven].shape)
    x[uneven] += 0.05 * rng.standard_normal(x[uneven].shape)
    return X, x


def test_force_and_tangents_are_derivatives(curved, slope):
    """Compare energy, force and tangents with fourth-order differences, also at rest and at equal stretches."""
    X, x = curved
    rng = np.random.default_rng(4)
    K, K_reference = np.asarray(stiffness(X, x)), np.asarray(reference_stiffness(X, x))
    np.testing.assert_allclose(K, K.transpose(0, 2, 1), rtol=0, atol=1e-6 * np.abs(K).max())
    for _ in range(3):
        d = rng.standard_normal(x.shape)
        flat = d.reshape(len(d), -1)
        work = np.sum(np.asarray(forces(X, x)) * d, axis=(1, 2))
        np.testing.assert_allclose(work, slope(lambda t: np.asarray(energies(X, x + t * d)), 1e-4), rtol=0, atol=1e-6)  # noqa: B023
        for matrix, dX, dx in ((K, 0, d), (K_reference, d, 0)):
            expected = slope(lambda t: np.asarray(forces(X + t * dX, x + t * dx)), 1e-4).reshape(len(d), -1)  # noqa: B023
            found = np.einsum("nij,nj->ni", matrix, flat)
            atol = 2e-6 * np.abs(expected).max()
            np.testing.assert_allclose(found[1:], expected[1:], rtol=0, atol=atol)
            # third derivatives jump at rest, so differences with steps of 1e-4 are less accurate
            np.testing.assert_allclose(found[0], expected[0], rtol=0, atol=5e-3 * np.abs(expected).max())


def test_turned_skin_is_at_rest():
    X = np.broadcast_to(FLAT, (1, 6, 3)) + 0.1 * np.random.default_rng(2).standard_normal((1, 6, 3))
    assert np.abs(np.asarray(forces(X, X @ TURN.T + [1.0, 2.0, 3.0]))).max() < 1e-11 * MU * THICKNESS


def test_more_stretch_never_pulls_less():
    """Second derivatives by the principal stretches are not negative in any state: differences of the stresses."""
    grid = np.array([(one, other) for one in (0.6, 0.9, 1.05, 1.3) for other in (0.5, 0.8, 0.95, 1.02, 1.4)])
    h = 1e-5
    columns = [(pulls(grid + h * step) - pulls(grid - h * step)) / (2 * h) for step in np.eye(2)]
    least = np.linalg.eigvalsh(np.stack(columns, axis=-1))[:, 0]
    assert least.min() > -1e-6 * MU


def test_only_a_push_makes_a_wrinkled_patch_unstable():
    """Negative eigenvalues of a wrinkled face come only from its compression (second Piola-Kirchhoff, at most 4 mu w / l2^2),
    which moves it out of its plane; without compression, at a wrinkling strain of 1e-6, there are none.
    """
    pairs = np.array([(1.2, 0.7), (1.3, 0.5)])
    X, x, _ = stretched(pairs)
    G = TABLE.gradient @ np.linalg.inv(CORNERS[1:, :2] - CORNERS[0, :2]).T
    laplacian = 2 * AREA * np.einsum("q,qai,qbi->ab", TABLE.weight, G, G)
    for limit in (LIMIT, 1e-6):
        membrane = Membrane(NeoHookean(MU, 30.0), np.full(2, THICKNESS), np.asarray(limit))
        K = np.asarray(compiled(lambda y: tangent(lambda z: membrane_force(X, z, membrane, TABLE), y))(x))  # noqa: B023
        least = np.linalg.eigvalsh(0.5 * (K + K.transpose(0, 2, 1)))[:, 0]
        push = 4 * MU * limit / pairs[:, 1] ** 2
        assert (least >= -1.0001 * push * THICKNESS * np.linalg.eigvalsh(laplacian)[-1]).all()
        assert limit > 1e-3 or (least > -1e-5 * np.abs(K).max()).all()


# on a body ---------------------------------------------------------------------------------------------------------------

HALF, HEIGHT, LAYER = 10.0, 40.0, 0.4  # mm
TISSUE, FILM = moduli_from_young(3.0, 0.49), moduli_from_young(60.0, 0.499)


def column(x_lines, n_up):
    """Return tetrahedra of a column with cells between given lines, two deep, and several along its height."""
    mesh = skfem.MeshTet.init_tensor(np.array(x_lines), np.linspace(0, 20, 3), np.linspace(0, HEIGHT, n_up + 1))
    return SolidSpace(*with_middles(mesh.p.T, oriented(mesh.p.T, mesh.t.T)))


def column_body(space, law, facets, thickness):
    shape = space.n_elements, space.table.weight.size
    base = np.flatnonzero(space.positions[:, 2] < 1e-9)
    return Body(
        Discretization(space, facets, base),
        law,
        np.full(shape, 1e-6),
        np.ones(space.n_elements),
        NeoHookean(*FILM),
        np.full(len(facets), thickness),
        wrinkling_strain=100.0,
    )


def coated_column(n_up):
    """Return a column with skin on two of its sides that does not wrinkle."""
    space = column(np.linspace(-HALF, HALF, 3), n_up)
    sides = np.flatnonzero((np.abs(np.abs(space.positions[space.boundary][..., 0]) - HALF) < 1e-9).all(axis=1))
    return column_body(space, NeoHookean(*TISSUE), sides, LAYER)


@pytest.fixture(scope="module")
def coated():
    return coated_column(4)


@pytest.mark.slow
@pytest.mark.parametrize(("n_up", "within"), [(8, 0.06), (16, 0.03)])
def test_skin_is_a_thin_stiff_layer(n_up, within):
    """Bent by sideways gravity: compare a skin of 0.4 mm with a layer of tetrahedra of 0.4 mm, and with no skin.

    The layer is nearly incompressible and thin, so it is slightly too stiff: by 11, 5 and 2 % with 4, 8 and 16 cells along.
    """
    inner, outer = HALF - LAYER / 2, HALF + LAYER / 2
    space = column([-outer, -inner, 0.0, inner, outer], n_up)
    centre = np.abs(space.positions[space.element_nodes[:, :4], 0].mean(axis=1))
    is_layer = np.repeat((centre > inner)[:, None], space.table.weight.size, axis=1)
    law = NeoHookean(*(np.where(is_layer, film, tissue) for tissue, film in zip(TISSUE, FILM)))
    layered = column_body(space, law, np.zeros(0, int), 0.0)
    with_skin = coated_column(n_up)
    bare = column_body(with_skin.discretization.space, NeoHookean(*TISSUE), np.zeros(0, int), 0.0)
    moved = []
    for body in (with_skin, layered, bare):
        X = body.discretization.space.positions
        x, _ = Equilibrium(1e-6).loaded(body, X, np.array([500.0, 0.0, 0.0]))
        moved.append((x - X)[X[:, 2] > HEIGHT - 1e-9, 0].mean())
    assert moved[0] == pytest.approx(moved[1], rel=within)
    assert moved[2] > 2.0 * moved[0]


@pytest.mark.parametrize("unknown", ["loaded", "unloaded"])
def test_matrix_is_the_derivative_of_the_residual(coated, unknown, rates_along):
    """Compare tissue and skin assembled with differences in a random direction."""
    X = coated.discretization.space.positions
    rng = np.random.default_rng(5)
    x = X + 0.2 * X[:, [1, 1, 2]] * np.stack(
        [0 * X[:, 0], 0 * X[:, 0] + 1, X[:, 0] / HALF], axis=1
    )  # wrinkled, and taut
    x += 0.02 * rng.standard_normal(X.shape)
    found, expected = rates_along(coated, X, x, np.array([9e3, -4e3, 2e3]), unknown, rng)
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_forward_of_inverse_is_where_it_began(coated):
    x, gravity = coated.discretization.space.positions, np.array([1000.0, 0.0, -3000.0])
    solver = Equilibrium(1e-10)
    X, _ = solver.unloaded(coated, x, gravity)
    assert np.abs(X - x).max() > 0.3
    again, _ = solver.loaded(coated, X, gravity)
    np.testing.assert_allclose(again, x, rtol=0, atol=1e-7)


@pytest.mark.parametrize(("share", "thickness", "is_stable"), [(1.0, 1.45, True), (8.0, 1.45, False), (8.0, 0.0, True)])
def test_a_mesh_bears_the_push_that_is_left_to_its_skin(share, thickness, is_stable):
    """Compressed beyond wrinkling, no mode of the mesh buckles; some do under eight times the force, but not without skin."""
    lines = np.linspace(0.0, 16.0, 5)
    mesh = skfem.MeshTet.init_tensor(lines, lines, np.linspace(0.0, 12.0, 4))
    space = SolidSpace(*with_middles(mesh.p.T, oriented(mesh.p.T, mesh.t.T)))
    X = space.positions
    on_top = np.flatnonzero((X[space.boundary, 2] == 12.0).all(axis=1))
    held = np.flatnonzero((X[:, 2] == 0.0) | (np.abs(X[:, :2] - 8.0).max(axis=1) == 8.0))
    shape = (space.n_elements, space.table.weight.size)
    limit = share * meshed_wrinkling_strain(FILM_E, FAT_E, 1.45, 4.0)
    body = Body(
        Discretization(space, on_top, held),
        NeoHookean(*(np.full(shape, m) for m in moduli_from_young(FAT_E, 0.49))),
        np.full(shape, 1e-6),
        np.ones(space.n_elements),
        NeoHookean(*moduli_from_young(FILM_E, 0.49)),
        np.full(len(on_top), thickness),
        limit,
    )
    x = X * (1.0 - 4.0 * limit, 1.0 - 4.0 * limit, (1.0 - 4.0 * limit) ** -2)
    matrix, _ = body.linearised(X, x, body.volume_ratio(X, x), in_plane=False)
    least = np.linalg.eigvalsh(matrix.toarray())[0]
    assert (least > 0) == is_stable


def test_coarse_meshes_and_thin_films_keep_their_own_wrinkling_strain():
    assert meshed_wrinkling_strain(FILM_E, FAT_E, 1.45, 1e3) == wrinkling_strain(FILM_E, FAT_E)


@pytest.mark.parametrize("pair", [(1.3, 1.1), (1.2, 0.7), (0.95, 0.7), (0.9, 0.9)])
def test_prestretch_multiplies_the_stretches_of_a_sheet(pair):
    """A sheet stretched by 1.15 beforehand has the energy of one whose stretches are 1.15 times larger."""
    X, x, _ = stretched([pair])
    _, larger, _ = stretched([(1.15 * pair[0], 1.15 * pair[1])])
    before = skin(1)._replace(prestretch=1.15)
    W = compiled(lambda x, membrane: membrane_energy(X, x, membrane, TABLE))
    assert float(W(x, before)[0]) == pytest.approx(float(W(larger, skin(1))[0]), rel=1e-12)

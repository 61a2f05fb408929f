"""Fascia that slides on the chest wall: blocks and caps on springs in closed form, derivatives, and loading after unloading."""

import numpy as np
import pytest
import skfem

from cicatrix.core.errors import InputError
from cicatrix.geometry.distance import Distance, GridDistance, PlaneDistance, SphereDistance
from cicatrix.geometry.tetrahedra import oriented, with_middles
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.body import Body, Discretization
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.fascia import Fascia
from cicatrix.mechanics.space import SolidSpace, Space

DENSITY, G = 1e-6, 9806.65  # kg/mm^3, mm/s^2
ALONG, NORMAL = 0.02, 30.0  # kPa/mm


def body_on_springs(space, on_wall, wall: Distance, *, E=200.0, nu=0.3, along=ALONG, normal=NORMAL, skin=0.0):
    """Return a body whose boundary facets with all nodes in ``on_wall`` are on springs; nothing else holds it."""
    is_solid = isinstance(space, SolidSpace)
    outer = np.arange(len(space.boundary)) if is_solid else space.mesh.boundary_facets()
    held = on_wall(space.positions[space.facet_nodes(outer)]).all(axis=1)
    skin_facets = outer[~held] if skin else np.zeros(0, int)
    shape = space.n_elements, space.table.weight.size
    law = NeoHookean(*(np.full(shape, modulus) for modulus in moduli_from_young(E, nu)))
    return Body(
        Discretization(space, skin_facets, np.zeros(0, int), wall_facets=outer[held]),
        law,
        np.full(shape, DENSITY),
        np.ones(space.n_elements),
        NeoHookean(max(skin, 1.0), 1.0),
        np.full(len(skin_facets), 1.0),
        wrinkling_strain=0.01,
        skin_prestretch=1.1 if skin else 1.0,
        fascia=Fascia(wall, along, normal),
    )


def block(height, n_axes):
    """Return a block 30 mm wide (and 20 mm deep) on the plane y = 0, 2 (by 2) by 2 cells."""
    if n_axes == 2:
        return Space(skfem.MeshTri.init_tensor(np.linspace(0, 30, 4), np.linspace(0, height, 3)))
    mesh = skfem.MeshTet.init_tensor(np.linspace(0, 30, 4), np.linspace(0, height, 3), np.linspace(0, 20, 3))
    return SolidSpace(*with_middles(mesh.p.T, oriented(mesh.p.T, mesh.t.T)))


FLAT = PlaneDistance(np.zeros(3), np.array([0.0, 1.0, 0.0]))


@pytest.mark.parametrize("n_axes", [2, 3])
def test_a_block_on_a_flat_wall(n_axes):
    """The mean displacement of the wall's side is weight over stiffness: density g h / k_t along it, .. / (k_n + k_t) across.

    By balance of forces, whatever the block's own deformation.
    """
    height, space = 10.0, block(10.0, n_axes)
    body = body_on_springs(space, lambda p: p[..., 1] < 1e-9, FLAT)
    X = space.positions
    weights = np.array([1, 1, 4]) / 6 if n_axes == 2 else np.array([0, 0, 0, 1, 1, 1]) / 3
    nodes = body.discretization.wall_nodes
    for direction, axis, stiffness in (([1, 0, 0], 0, ALONG), ([0, 1, 0], 1, ALONG + NORMAL)):
        gravity = 0.1 * G * np.array(direction, float)
        x, _ = Equilibrium(1e-10).loaded(body, X, gravity)
        moved = np.einsum("fa,a->f", (x - X)[nodes][..., axis], weights)
        assert moved.mean() == pytest.approx(DENSITY * 0.1 * G * height / stiffness, rel=1e-7)  # facets of equal size


def ring(radius, thickness, half_angle, n):
    """Return a sector of a ring around the origin, symmetric about +y, of n cells along and one across."""
    mesh = skfem.MeshTri.init_tensor(np.linspace(-half_angle, half_angle, n + 1), np.array([0.0, thickness]))
    angle, r = mesh.p[0], radius + mesh.p[1]
    return Space(skfem.MeshTri(np.stack([r * np.sin(angle), r * np.cos(angle)]), mesh.t))


def test_a_cap_slides_round_a_circle():
    """A stiff sector of a ring turns about the circle's centre: tan(turn) = W r_c / (k_t R^2 l), W r_c its moment, l its length.

    From the stationary point of k_t/2 (2 R sin(turn/2))^2 l - W r_c sin(turn), the energy of a rigid ring under gravity along x.
    """
    R, thickness, half = 100.0, 4.0, 0.5
    space = ring(R, thickness, half, 24)
    body = body_on_springs(
        space,
        lambda p: np.hypot(p[..., 0], p[..., 1]) < R + 1e-6,
        SphereDistance(np.zeros(3), R, 2),
        E=1e3,
        along=0.0005,
    )
    X = space.positions
    gravity = np.array([0.3 * G, 0.0, 0.0])
    x, _ = Equilibrium(1e-6).loaded(body, X, gravity)
    moment = DENSITY * gravity[0] * 2.0 / 3.0 * ((R + thickness) ** 3 - R**3) * np.sin(half)
    expected = np.arctan(moment / (0.0005 * R**3 * 2 * half))
    corners = np.arange(len(space.mesh.p[0]))
    turned = np.arctan2(x[corners, 0], x[corners, 1]) - np.arctan2(X[corners, 0], X[corners, 1])
    assert expected > 0.2
    np.testing.assert_allclose(turned, expected, rtol=5e-3)
    held = np.unique(body.discretization.wall_nodes)
    assert np.abs(np.hypot(*x[held, :2].T) - np.hypot(*X[held, :2].T)).max() < 0.02 * R * expected


def cap(radius, thickness, half_angle, n):
    """Return a cap of a spherical shell around the origin, about +y, in curved tetrahedra."""
    line = np.linspace(-1.0, 1.0, n + 1)
    mesh = skfem.MeshTet.init_tensor(line, np.array([0.0, 1.0]), line)
    nodes, elements = with_middles(mesh.p.T, oriented(mesh.p.T, mesh.t.T))

    def curved(p):
        square = p[:, [0, 2]]
        disc = square * np.sqrt(1.0 - square[:, ::-1] ** 2 / 2.0)  # a square onto a disc
        r = np.linalg.norm(disc, axis=1)
        angle = half_angle * r
        along = np.where(r > 0, np.sin(angle) / np.maximum(r, 1e-12), half_angle)
        unit = np.stack([disc[:, 0] * along, np.cos(angle), disc[:, 1] * along], axis=1)
        return unit * (radius + thickness * p[:, 1:2])

    return SolidSpace(curved(nodes), elements), nodes[:, 1] < 1e-9


def test_a_cap_slides_round_a_sphere():
    """tan(turn) = W r_c / (k_t I), I the moment of area of the cap about the axis of turning, 2 pi R^4 [...] (closed form)."""
    R, thickness, half, along = 100.0, 4.0, 0.5, 0.0005
    space, inner = cap(R, thickness, half, 6)
    wall = {tuple(p) for p in np.round(space.positions[inner], 9)}
    body = body_on_springs(
        space,
        lambda p: np.array([[tuple(q) in wall for q in np.round(f, 9)] for f in p]),
        SphereDistance(np.zeros(3), R),
        E=1e3,
        along=along,
    )
    X, gravity = space.positions, np.array([0.3 * G, 0.0, 0.0])
    x, _ = Equilibrium(1e-6).loaded(body, X, gravity)
    c = np.cos(half)
    about = R**4 * (2 * np.pi * (1 - c) - np.pi * (2 / 3 - c + c**3 / 3))
    moment = DENSITY * gravity[0] * np.pi / 4 * ((R + thickness) ** 4 - R**4) * np.sin(half) ** 2
    expected = np.arctan(moment / (along * about))
    turned = np.arctan2(x[:, 0], x[:, 1]) - np.arctan2(X[:, 0], X[:, 1])
    assert expected > 0.1
    np.testing.assert_allclose(turned, expected, rtol=1e-2)


@pytest.fixture(scope="module", params=[2, 3])
def bumpy(request):
    """Return a soft body with prestretched skin, on springs along a wall that is a spline."""
    n_axes = request.param
    lines = np.arange(-12.0, 45.0, 3.0)
    at = np.stack(np.meshgrid(*[lines] * n_axes, indexing="ij")[::-1], axis=-1)
    values = at[..., 1] - 0.002 * (at[..., 0] - 15.0) ** 2 - (0.001 * at[..., 2] ** 2 if n_axes == 3 else 0.0)
    wall = GridDistance.through(values, lines[[0] * n_axes], np.full(n_axes, 3.0))
    return body_on_springs(block(10.0, n_axes), lambda p: p[..., 1] < 1e-9, wall, E=3.0, nu=0.4, skin=4.0)


@pytest.mark.parametrize("unknown", ["loaded", "unloaded"])
def test_matrix_is_the_derivative_of_the_residual(bumpy, unknown, rates_along):
    X = bumpy.discretization.space.positions
    rng = np.random.default_rng(5)
    x = X + 0.05 * X[:, [1, 0, 1]] + 0.02 * rng.standard_normal(X.shape)
    in_plane = bumpy.discretization.space.n_axes == 2
    x[:, 2] = np.where(in_plane, 0.0, x[:, 2])
    found, expected = rates_along(bumpy, X, x, np.array([9e3, -4e3, 0.0]), unknown, rng, in_plane=in_plane)
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_the_residual_is_the_derivative_of_the_potential(bumpy, slope):
    X = bumpy.discretization.space.positions
    rng = np.random.default_rng(6)
    d = rng.standard_normal(X.shape)
    x = X + 0.05 * X[:, [1, 0, 1]] + 0.01 * d
    gravity = np.array([9e3, -4e3, 2e3])
    expected = slope(lambda t: bumpy.potential(X, x + t * d, gravity), 1e-4)
    assert float(np.sum(bumpy.residual(X, x, gravity) * d)) == pytest.approx(expected, rel=1e-7)


def test_forward_of_inverse_is_where_it_began(bumpy):
    x, gravity = bumpy.discretization.space.positions, np.array([1500.0, 3000.0, 0.0])
    solver = Equilibrium(1e-10)
    X, _ = solver.unloaded(bumpy, x, gravity)
    assert np.abs(X - x).max() > 0.3
    again, _ = solver.loaded(bumpy, X, gravity)
    np.testing.assert_allclose(again, x, rtol=0, atol=1e-6)


def test_springs_below_zero_are_refused():
    with pytest.raises(InputError, match=r"along the wall must not be negative; got -0\.1 kPa/mm"):
        Fascia(FLAT, np.array([0.2, -0.1]))

"""Solids against closed-form solutions: inflated shells, a twisted cylinder; Cook's membrane; table of docs/verification.md."""

import numpy as np
import pytest
import skfem

from cicatrix.geometry.tetrahedra import oriented, with_middles
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.body import Body, Discretization
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.space import SolidSpace
from cicatrix.mechanics.supports import walls
from cicatrix.numerics.linear import LinearSolver

NU = 0.4999
INNER, OUTER = 10.0, 20.0  # mm
MU, KAPPA = moduli_from_young(3.0, NU)  # kPa


def prisms(triangles, layers):
    """Extrude a plane mesh to tetrahedra: points (n, 2), triangles (m, 3), heights -> points (., 3), tetrahedra (., 4)."""
    points, cells = triangles
    n = len(points)
    low = np.sort(cells, axis=1)
    a, b, c = low.T
    split = (
        np.stack([[a, b, c, c + n], [a, b, b + n, c + n], [a, a + n, b + n, c + n]]).transpose(0, 2, 1).reshape(-1, 4)
    )
    tetrahedra = np.vstack([split + k * n for k in range(len(layers) - 1)])
    nodes = np.vstack([np.column_stack([points, np.full(n, h)]) for h in layers])
    return nodes, oriented(nodes, tetrahedra)


def mapped(points, tetrahedra, where):
    """Return quadratic tetrahedra whose nodes, including midpoints, are mapped and thus curved."""
    nodes, cells = with_middles(points, tetrahedra)
    space = SolidSpace(where(nodes), cells)
    first = space.positions[cells[:, :4]]
    turned = np.linalg.det(first[:, 1:] - first[:, :1]) < 0
    assert turned.all() or not turned.any()
    return SolidSpace(space.positions, cells[:, [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]]) if turned.all() else space


def body_of(space, law, *, fixed=(), sliding=None, pressed=None, pressure=0.0):
    """Return a weightless body; functions of face centres (n, 3) say which faces slide and which are under pressure."""
    centres = space.positions[space.boundary[:, :3]].mean(axis=1)
    faces = [np.flatnonzero(test(centres)) if test else np.zeros(0, int) for test in (sliding, pressed)]
    return Body(
        Discretization(space, faces[1], np.asarray(fixed, int), *walls(space, faces[0])),
        law,
        np.full((space.n_elements, space.table.weight.size), 1e-12),
        np.ones(space.n_elements),
        NeoHookean(1.0, 1.0),
        np.zeros(len(faces[1])),
        pressure=np.full(len(faces[1]), pressure) if pressed else None,
    )


def converged(body, x, load, steps=12):
    """Iterate Newton with a fresh tangent under dead loads (n_nodes, 3) [mN]; return positions and norms of the residual."""
    X, supports = body.discretization.space.positions, body.discretization.supports(False)
    solver, norms = LinearSolver(), []
    for _ in range(steps):
        r = supports.unknowns(body.residual(X, x, np.zeros(3)) - load)
        norms.append(np.linalg.norm(r))
        if norms[-1] < 1e-9 * max(norms):
            break
        matrix, _ = body.linearised(X, x, body.volume_ratio(X, x), in_plane=False)
        x = supports.positions(supports.unknowns(x) - solver.solve(supports.matrix(matrix), r, 1e-12), x)
    return x, np.array(norms)


# ---- inflated shells ------------------------------------------------------------------------------------------------------


def spherical(n):
    """Return an eighth of a thick sphere: the triangle between three poles refined n times, with as many layers."""
    i, j = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]).T
    number = {pair: k for k, pair in enumerate(zip(i, j))}
    up = [[number[a, b], number[a + 1, b], number[a, b + 1]] for a, b in zip(i, j) if a + b < n]
    down = [[number[a + 1, b], number[a + 1, b + 1], number[a, b + 1]] for a, b in zip(i, j) if a + b < n - 1]
    points, tetrahedra = prisms((np.column_stack([i, j]) / n, np.array(up + down)), np.linspace(0, 1, n + 1))

    def where(p):
        poles = np.column_stack([p[:, 0], p[:, 1], 1.0 - p[:, 0] - p[:, 1]])
        return (INNER * (OUTER / INNER) ** p[:, 2] / np.linalg.norm(poles, axis=1))[:, None] * poles

    return mapped(points, tetrahedra, where)


def tubular(n):
    """Return a quarter of a thick tube, n cells across the wall, 5 mm long."""
    mesh = skfem.MeshTet.init_tensor(np.linspace(0, 1, n + 1), np.linspace(0, np.pi / 2, n + 1), np.linspace(0, 5, 2))

    def where(p):
        r = INNER * (OUTER / INNER) ** p[:, 0]
        return np.column_stack([r * np.cos(p[:, 1]), r * np.sin(p[:, 1]), p[:, 2]])

    return mapped(mesh.p.T, oriented(mesh.p.T, mesh.t.T), where)


STRETCH = 1.3  # of the inner radius


def pressure_in(power):
    """Pressure that stretches the inner radius of an incompressible neo-Hookean sphere (power 3) or tube (power 2) so [kPa].

    r^n = R^n + a^n - A^n; integral of hoop minus radial stress over the wall, by hand (sphere: Green & Zerna).
    """
    outer = ((OUTER**power + (STRETCH**power - 1) * INNER**power) ** (1 / power)) / OUTER
    if power == 3:
        return MU * (2 / outer + outer**-4 / 2 - 2 / STRETCH - STRETCH**-4 / 2)
    return MU * (np.log(STRETCH / outer) + (outer**-2 - STRETCH**-2) / 2)


def inflated(shape, n):
    """Return a shell on its symmetry planes under the pressure: body, and distance of nodes from the axis or the centre."""
    space = {"sphere": spherical, "tube": tubular}[shape](n)
    axes = {"sphere": 3, "tube": 2}[shape]

    def radius(p):
        return np.linalg.norm(p[..., :axes], axis=-1)

    def on_plane(p):
        end = (np.abs(p[:, 2] - 5.0) < 1e-9) & (shape == "tube")
        return (np.abs(p) < 1e-9).any(axis=1) | end

    inside = radius(space.positions[space.boundary]).max(axis=1) < INNER + 1e-6
    centres = space.positions[space.boundary[:, :3]].mean(axis=1)
    pressed = {tuple(c) for c in centres[inside]}
    body = body_of(
        space,
        NeoHookean(MU, KAPPA),
        sliding=on_plane,
        pressed=lambda p: np.array([tuple(c) in pressed for c in p]),
        pressure=pressure_in(axes),
    )
    return body, radius


def radius_error(shape, n):
    """Return the relative error of the mean inner radius."""
    body, radius = inflated(shape, n)
    X = body.discretization.space.positions
    x, _ = Equilibrium(1e-8).loaded(body, X, np.zeros(3))
    inner = np.abs(radius(X) - INNER) < 1e-6
    return radius(x)[inner].mean() / (STRETCH * INNER) - 1.0


@pytest.mark.parametrize(("shape", "n", "within"), [("tube", 2, 1e-5), ("sphere", 2, 8e-4), ("sphere", 4, 4e-5)])
def test_inflated_shells(shape, n, within):
    """Compare an inner stretch of 1.3 with the incompressible closed form; the Poisson ratio of the tissue is 0.4999."""
    assert abs(radius_error(shape, n)) < within


@pytest.mark.parametrize("shape", ["tube", "sphere"])
def test_newton_is_quadratic_under_pressure(shape):
    """With fresh tangents, starting at 90 % of the pressure, each relative residual is below the square of the one before."""
    body, _ = inflated(shape, 2)
    X = body.discretization.space.positions
    x, _ = Equilibrium(1e-8).loaded(body.with_pressure_share(0.9), X, np.zeros(3))
    _, norms = converged(body, x, np.zeros_like(X))
    close = norms[norms < 0.1 * norms[0]]
    assert close.size > 1
    assert (close[1:] < close[:-1] ** 2 / norms[0] + 5e-9 * norms[0]).all(), norms


def test_matrix_under_pressure_that_ends_freely(slope):
    """With sliding nodes and pressure on one face only, the matrix is the derivative of the residual and not symmetric."""
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0, 20.0, 3)] * 3)
    space = SolidSpace(*with_middles(mesh.p.T, oriented(mesh.p.T, mesh.t.T)))
    body = body_of(
        space,
        NeoHookean(MU, KAPPA),
        sliding=lambda p: (np.abs(p) < 1e-9).any(axis=1),
        pressed=lambda p: p[:, 2] > 20.0 - 1e-9,
        pressure=1.0,
    )
    rng, supports = np.random.default_rng(0), body.discretization.supports(False)
    X = space.positions
    x = X + supports.positions(0.3 * rng.standard_normal(supports.n_unknowns), np.zeros_like(X))
    d = supports.positions(rng.standard_normal(supports.n_unknowns), np.zeros_like(X))
    assert np.abs(d[np.abs(X) < 1e-9]).max() < 1e-15
    K = supports.matrix(body.linearised(X, x, body.volume_ratio(X, x), in_plane=False)[0])
    expected = slope(lambda t: supports.unknowns(body.residual(X, x + t * d, np.zeros(3))), 1e-4)
    np.testing.assert_allclose(K @ supports.unknowns(d), expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    assert np.abs(K - K.T).max() > 1e-4 * np.abs(K).max()


# ---- torsion --------------------------------------------------------------------------------------------------------------

RADIUS, LENGTH, TWIST = 10.0, 20.0, 0.03  # mm, mm, rad/mm: 0.6 rad from end to end, shear 0.3 at the surface


def rod(n):
    """Return a circular rod: a disc refined n times with 2^n layers; midpoints on the surface lie on it."""
    disc = skfem.MeshTri.init_circle(n)
    points, tetrahedra = prisms((RADIUS * disc.p.T, disc.t.T), np.linspace(0, LENGTH, 2**n + 1))
    nodes, cells = with_middles(points, tetrahedra)
    space = SolidSpace(nodes, cells)
    r = np.linalg.norm(nodes[:, :2], axis=1)
    corners = r[space.boundary[:, :3]]
    outer = np.unique(space.boundary[(corners > RADIUS * (1 - 1e-9)).all(axis=1)])
    nodes[outer, :2] *= (RADIUS / r[outer])[:, None]
    return SolidSpace(nodes, cells)


def twisted(X):
    """Return the exact shape of an incompressible rod: each plane is rotated by TWIST times its height."""
    c, s = np.cos(TWIST * X[:, 2]), np.sin(TWIST * X[:, 2])
    return np.column_stack([c * X[:, 0] - s * X[:, 1], s * X[:, 0] + c * X[:, 1], X[:, 2]])


def torsion(n):
    """Rotate the ends; return moment and normal force relative to the exact ones, and the largest position error [mm]."""
    space = rod(n)
    X = space.positions
    ends = (np.abs(X[:, 2]) < 1e-9) | (np.abs(X[:, 2] - LENGTH) < 1e-9)
    body = body_of(space, NeoHookean(MU, KAPPA), fixed=np.flatnonzero(ends))
    x, _ = Equilibrium(1e-8).loaded(body, X, np.zeros(3), prescribed_positions=twisted(X))
    top = np.abs(X[:, 2] - LENGTH) < 1e-9
    f = body.residual(X, x, np.zeros(3))[top]
    moment = np.sum(x[top, 0] * f[:, 1] - x[top, 1] * f[:, 0])
    return (
        moment / (np.pi / 2 * MU * TWIST * RADIUS**4),
        f[:, 2].sum() / (-np.pi / 4 * MU * TWIST**2 * RADIUS**4),
        np.abs(x - twisted(X)).max(),
    )


@pytest.mark.parametrize(
    ("n", "moment", "force", "error"),
    [
        (1, 0.095, 0.363, 0.29),
        pytest.param(2, 0.0028, 0.0591, 0.017, marks=pytest.mark.slow),
        pytest.param(3, 2.04e-4, 0.00943, 0.0029, marks=pytest.mark.slow),
    ],
)
def test_torsion(n, moment, force, error):
    """Moment pi/2 mu t R^4 and normal force -pi/4 mu t^2 R^4 (Rivlin), and the largest error of position [mm]."""
    found = torsion(n)
    assert found[0] - 1.0 == pytest.approx(moment, rel=0.02)
    assert found[1] - 1.0 == pytest.approx(force, rel=0.02)
    assert found[2] < error


# ---- Cook's membrane ------------------------------------------------------------------------------------------------------


COOK_MU, COOK_KAPPA, COOK_LOAD = 80.1938, 400889.8, 100.0


def cook(n):
    """Return the tapered panel 48 x 44 to 16, 1 thick, between two smooth walls (plane strain), with n cells per side."""
    mesh = skfem.MeshTet.init_tensor(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), np.linspace(0, 1, 2))

    def where(p):
        low, high = 44.0 * p[:, 0], 44.0 + 16.0 * p[:, 0]
        return np.column_stack([48.0 * p[:, 0], low + p[:, 1] * (high - low), p[:, 2]])

    space = mapped(mesh.p.T, oriented(mesh.p.T, mesh.t.T), where)
    X = space.positions
    body = body_of(
        space,
        NeoHookean(COOK_MU, COOK_KAPPA),
        fixed=np.flatnonzero(X[:, 0] < 1e-9),
        sliding=lambda p: (np.abs(p[:, 2]) < 1e-9) | (np.abs(p[:, 2] - 1.0) < 1e-9),
    )
    end = space.boundary[(np.abs(X[space.boundary][..., 0] - 48.0) < 1e-9).all(axis=1)]
    area = 0.5 * np.linalg.norm(np.cross(X[end[:, 1]] - X[end[:, 0]], X[end[:, 2]] - X[end[:, 0]]), axis=1)
    load = np.zeros_like(X)
    np.add.at(
        load[:, 1], end[:, 3:], (COOK_LOAD / 16.0 * area / 3.0)[:, None]
    )  # load on a flat P2 face: a third on each midpoint
    corner = np.flatnonzero((np.abs(X - [48.0, 60.0, 0.0]) < 1e-9).all(axis=1))[0]
    return body, load, corner


def cook_linear(n):
    """Return the vertical displacement of the upper corner in linear elasticity."""
    body, load, corner = cook(n)
    X = body.discretization.space.positions
    x, _ = converged(body, X, 1e-6 * load, steps=3)
    return 1e6 * (x - X)[corner, 1]


def cook_large(n):
    """Return the displacement of the upper corner and the last residual norms; load steps avoid singular tangents."""
    body, load, corner = cook(n)
    X = x = body.discretization.space.positions
    for share in np.arange(1, 17) / 16.0:
        x, norms = converged(body, x, share * load)
    return (x - X)[corner, 1], norms


RISES = {2: (4.659, 4.192), 4: (6.758, 5.881), 8: (7.559, 6.533)}


@pytest.mark.parametrize("n", [2, pytest.param(4, marks=pytest.mark.slow), pytest.param(8, marks=pytest.mark.slow)])
def test_cook(n):
    """Compare with values of this code, so that the table stays correct; linear elasticity and large displacements."""
    assert cook_linear(n) == pytest.approx(RISES[n][0], abs=1e-3)
    rise, norms = cook_large(n)
    assert rise == pytest.approx(RISES[n][1], abs=1e-3)
    assert norms[-1] < 1e-7 * norms.max()

"""Equilibrium under gravity: unloading and loading, limits, fallbacks when Newton fails, open elements."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from cicatrix.core.errors import ConvergenceError
from cicatrix.materials.growth import NaturalConfiguration
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.elements import meshed_wrinkling_strain
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.problem import Problem
from cicatrix.mechanics.unloading import Unloading
from cicatrix.numerics.linear import LinearSolver
from cicatrix.numerics.newton import NewtonReport, newton

WIDTH, HEIGHT = 30.0, 20.0
DENSITY = 1e-6  # kg/mm^3
G = 9806.65  # mm/s^2
MU, KAPPA = moduli_from_young(1.0, 0.49)
PRONE, SIDEWAYS = np.array([0.0, G, 0.0]), np.array([G, 0.0, 0.0])


@pytest.fixture(scope="module")
def mesh(rectangle):
    return rectangle(WIDTH, HEIGHT, 4, 3)


@pytest.fixture(scope="module")
def block(mesh, body_on):
    """Return soft tissue with skin, fixed at y = 0: density g L / mu = 0.6. The skin pushes no more than the mesh bears."""
    body = body_on(mesh, NeoHookean(MU, KAPPA), lambda p: p[1] < 1e-9, density=DENSITY, skin=5.0, thickness=1.0)
    return replace(body, wrinkling_strain=meshed_wrinkling_strain(15.0, 1.0, 1.0, HEIGHT / 3))


@pytest.fixture(scope="module")
def loaded(block):
    return Equilibrium().loaded(block, block.discretization.space.positions, PRONE)


@pytest.mark.parametrize(("gravity", "softness"), [(PRONE, 1.0), (SIDEWAYS, 1.0), (PRONE, 3.0)])
def test_unloaded_then_loaded_is_the_image(block, gravity, softness):
    """Loading the unloaded shape gives the imaged shape to 1e-8 mm, also hanging with density g L / mu = 1.7."""
    image = block.discretization.space.positions
    solver = Equilibrium(1e-10)
    X, _ = solver.unloaded(block, image, softness * gravity)
    assert np.abs(X - image).max() > 0.3
    back, _ = solver.loaded(block, X, softness * gravity)
    np.testing.assert_allclose(back, image, rtol=0, atol=1e-8)


def test_ways_of_unloading_agree(block):
    """The load ramp, a stiffer body that is softened, and a start from a softer body find the same unloaded shape."""
    image, solver = block.discretization.space.positions, Equilibrium(1e-10)
    X, report = solver.unloaded(block, image, PRONE)
    ways = Unloading(block, image, PRONE, solver._newton, NewtonReport())
    np.testing.assert_allclose(ways.by_softening(), X, rtol=0, atol=1e-8)
    softer, _ = solver.unloaded(block, image, 1.5 * PRONE)
    again, nearby = solver.unloaded(block, image, PRONE, softer)
    np.testing.assert_allclose(again, X, rtol=0, atol=1e-8)
    assert nearby.load_steps == 0 < report.load_steps  # without a ramp


def test_newton_is_quadratic(block):
    """Near the solution each residual is at most a constant times the square of the one before (theory)."""
    X = block.discretization.space.positions
    solver, norms = LinearSolver(), []
    problem = Problem(block, X, X, PRONE, PRONE)

    def residual(values):
        r = problem.free_part(block.residual(X, problem.positions(values), PRONE))
        norms.append(np.linalg.norm(r) / problem.weight)
        return r

    def step(values, r):
        x = problem.positions(values)
        matrix, _ = block.linearised(X, x, block.volume_ratio(X, x), in_plane=True)
        return solver.solve(matrix, -r, 1e-12)

    x, _ = Equilibrium(1e-4).loaded(block, X, PRONE)
    x = x + 1e-2 * np.sin(X)
    x[block.discretization.fixed_nodes] = X[block.discretization.fixed_nodes]
    start = problem.unknowns(x)
    newton(residual, step, start, tolerance=1e-11 * problem.weight, report=NewtonReport(), max_iterations=20)
    small = [n for n in norms if n < 1e-2]
    pairs = [(a, b) for a, b in pairwise(small) if b > 1e-11]
    assert pairs
    assert all(b < 100 * a**2 + 1e-11 for a, b in pairs), norms


def test_downhill_finds_the_same_shape(block, loaded):
    """Damped minimisation of the potential and Newton agree where both converge."""
    X = block.discretization.space.positions
    report = NewtonReport()
    x = Equilibrium(1e-9)._minimise(Problem(block, X, X, PRONE, PRONE), report)
    np.testing.assert_allclose(x, loaded[0], rtol=0, atol=1e-6)
    assert block.potential(X, x, PRONE) < block.potential(X, X, PRONE)


@pytest.mark.parametrize(("library", "method"), [("scipy", "SuperLU"), ("pyamg", "Multigrid")])
def test_linear_solvers_agree(block, loaded, monkeypatch, library, method):
    monkeypatch.setenv("CICATRIX_LINEAR_SOLVER", library)
    X = block.discretization.space.positions
    solver = Equilibrium()
    x, _ = solver.loaded(block, X, PRONE)
    assert type(solver._linear[True]._factor).__name__ == method
    assert solver.factorizations > 0
    np.testing.assert_allclose(x, loaded[0], rtol=0, atol=1e-8)  # as close as the residual tolerance of 1e-8 allows


def test_weak_gravity_is_linear(block):
    """Half the gravity gives half the displacement, to second order."""
    X = block.discretization.space.positions
    solver = Equilibrium()
    u1, u2, u4 = (solver.loaded(block, X, s * SIDEWAYS)[0] - X for s in (0.01, 0.02, 0.04))
    gap2, gap4 = np.abs(u2 - 2 * u1).max(), np.abs(u4 - 2 * u2).max()
    assert gap2 < 0.02 * np.abs(u2).max()
    assert gap4 < 6 * gap2 + 1e-7


def test_nothing_moves_without_gravity(block):
    X = block.discretization.space.positions
    x, report = Equilibrium().loaded(block, X, np.zeros(3))
    assert (x == X).all()
    assert report.iterations == 0


def test_weight_is_carried_by_the_wall(block, loaded):
    """Forces on the fixed nodes sum to the weight, density g area (balance of forces, by hand)."""
    X = block.discretization.space.positions
    x, _ = loaded
    inside = block.residual(X, x, PRONE)[block.discretization.fixed_nodes].sum(axis=0)
    np.testing.assert_allclose(inside, -DENSITY * PRONE * WIDTH * HEIGHT, atol=1e-6 * DENSITY * G * WIDTH * HEIGHT)


def test_a_nearby_start_gives_the_same(block, loaded):
    X = block.discretization.space.positions
    near = loaded[0] + 0.01 * np.sin(X)
    near[block.discretization.fixed_nodes] = X[block.discretization.fixed_nodes]
    near[:, 2] = 0.0
    x, report = Equilibrium().loaded(block, X, PRONE, near)
    np.testing.assert_allclose(x, loaded[0], rtol=0, atol=1e-6)
    assert report.iterations <= 6


def test_a_start_far_out_of_balance_gives_the_same(block):
    """An initial guess that is the equilibrium shape under the opposite load leads to the same answer as none."""
    X, solver = block.discretization.space.positions, Equilibrium()
    far, _ = solver.loaded(block, X, 4.0 * SIDEWAYS)
    x, _ = solver.loaded(block, X, -4.0 * SIDEWAYS, far)
    np.testing.assert_allclose(x[:, 1], solver.loaded(block, X, -4.0 * SIDEWAYS)[0][:, 1], rtol=0, atol=1e-5)


def test_tissue_laid_down_squeezed_is_at_rest_there(mesh, body_on):
    """Tissue laid down at 0.6 of its reference volume is stress-free there, so the initial guess is the solution."""
    squeezed = np.diag([0.75, 0.8, 1.0])
    law = NaturalConfiguration(NeoHookean(MU, KAPPA), squeezed)
    body = body_on(mesh, law, lambda p: p[1] < 1e-9, density=DENSITY)
    X = body.discretization.space.positions
    x, report = Equilibrium().loaded(body, X, 1e-3 * PRONE, X @ squeezed)
    np.testing.assert_allclose(x, X @ squeezed, rtol=0, atol=0.02)
    assert report.iterations <= 5


def test_hopeless_load_is_reported(block):
    """A thousand times the gravity towards the wall gives an error that lists what was tried, not a wrong shape."""
    with pytest.raises(ConvergenceError) as error:
        Equilibrium().loaded(block, block.discretization.space.positions, -1e6 * PRONE)
    tried = error.value.history
    assert len(tried) == len(set(tried)) > 1
    assert any("residual norms [mN]" in line for line in tried)


# open elements -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def holed(mesh, body_on):
    """Return the block with a hole of open elements."""
    centre = mesh.p[:, mesh.t].mean(axis=1)
    is_open = np.abs(centre[0] - WIDTH / 2) < WIDTH / 5
    is_open &= np.abs(centre[1] - HEIGHT / 2) < HEIGHT / 5
    assert 0 < is_open.sum() < 12
    law = NeoHookean(MU, KAPPA)
    fraction = np.where(is_open, 0.0, 1.0)
    return body_on(mesh, law, lambda p: p[1] < 1e-9, density=DENSITY, fraction=fraction, skin=5.0, thickness=1.0)


def test_an_open_element_is_as_good_as_none(mesh, body_on, holed):
    """Compare with a mesh without these elements, with skin only where the whole block has it."""
    kept = np.flatnonzero(holed.fraction > 0)
    without = mesh.restrict(kept)
    law = NeoHookean(MU, KAPPA)
    cut = body_on(without, law, lambda p: p[1] < 1e-9, density=DENSITY, skin=5.0, thickness=1.0)
    middle = without.p[:, without.facets[:, cut.discretization.skin_facets]].mean(axis=1)
    inner = (middle[0] > 1e-9) & (middle[0] < WIDTH - 1e-9) & (middle[1] > 1e-9) & (middle[1] < HEIGHT - 1e-9)
    cut.skin_thickness[inner] = 0.0
    solver = Equilibrium(1e-10)
    x, _ = solver.loaded(holed, holed.discretization.space.positions, PRONE)
    y, _ = Equilibrium(1e-10).loaded(cut, cut.discretization.space.positions, PRONE)
    element = holed.discretization.space.element_nodes[kept][:, :3], cut.discretization.space.element_nodes[:, :3]
    np.testing.assert_allclose(
        np.sort(x[element[0]].mean(axis=1), axis=0), np.sort(y[element[1]].mean(axis=1), axis=0), rtol=0, atol=1e-9
    )


def test_nan_in_the_hole_stays_there(holed):
    """Positions of nodes without tissue do not change forces and energies of the tissue, even if they are NaN."""
    X = holed.discretization.space.positions
    x, _ = Equilibrium().loaded(holed, X, PRONE)
    lost = np.where(holed.active_nodes[:, None], x, np.nan)
    assert np.isnan(lost).any()
    r = holed.residual(X, lost, PRONE)
    np.testing.assert_allclose(r, holed.residual(X, x, PRONE), rtol=0, atol=1e-12)
    assert (holed.energy_density(X, lost)[holed.fraction == 0] == 0).all()
    assert holed.strain_energy(X, lost) == pytest.approx(holed.strain_energy(X, x), rel=1e-12)


# a column that buckles -----------------------------------------------------------------------------------------------


def test_a_column_falls_to_a_stable_shape(rectangle, body_on):
    """A column under three times its buckling weight (q L^3 = 7.84 E I, Greenhill 1881) and some wind falls over.

    Whatever path the solver takes, the shape it returns is in equilibrium, stable, and lower in potential energy.
    """
    width, height, E = 4.0, 40.0, 10.0
    column = body_on(rectangle(width, height, 1, 12), NeoHookean(*moduli_from_young(E, 0.45)), lambda p: p[1] < 1e-9)
    stiffness = E / (1 - 0.45**2) * width**3 / 12
    g = 3 * 7.84 * stiffness / (DENSITY * width * height**3)
    X = column.discretization.space.positions
    gravity = np.array([0.1 * g, -g, 0.0])
    x, _ = Equilibrium().loaded(column, X, gravity)
    matrix, _ = column.linearised(X, x, column.volume_ratio(X, x), in_plane=True)
    assert np.linalg.eigvalsh(matrix.toarray())[0] > 0  # stable
    assert np.abs(x - X)[:, 0].max() > 0.5 * height
    assert column.potential(X, x, gravity) < column.potential(X, X, gravity) - 1.0
    weight = DENSITY * width * height * g
    free = np.setdiff1d(np.arange(len(X)), column.discretization.fixed_nodes)
    assert np.abs(column.residual(X, x, gravity)[free, :2]).max() < 1e-6 * weight


def test_a_column_without_wind_leaves_its_saddle(rectangle, body_on):
    """The upright column is an unstable equilibrium at three times Greenhill's weight; the solution found is stable."""
    width, height, E = 4.0, 60.0, 10.0
    column = body_on(rectangle(width, height, 1, 12), NeoHookean(*moduli_from_young(E, 0.45)), lambda p: p[1] < 1e-9)
    modulus = E / (1 - 0.45**2)
    g = 3.0 * 7.837 * modulus * width**3 / 12 / height**3 / (column.density.flat[0] * width)
    X, gravity = column.discretization.space.positions, np.array([0.0, -g, 0.0])
    x, _ = Equilibrium().loaded(column, X, gravity)
    matrix, _ = column.linearised(X, x, column.volume_ratio(X, x), in_plane=True)
    assert np.linalg.eigvalsh(matrix.toarray())[0] > 0.0
    assert np.abs(x - X)[:, 0].max() > 5.0


def test_an_image_that_is_no_stable_equilibrium_is_told(rectangle, body_on):
    """A column upright in the image at three times Greenhill's weight: a shape is found with a warning."""
    width, height, E = 4.0, 60.0, 10.0
    column = body_on(rectangle(width, height, 1, 12), NeoHookean(*moduli_from_young(E, 0.45)), lambda p: p[1] < 1e-9)
    modulus = E / (1 - 0.45**2)
    g = 7.837 * modulus * width**3 / 12 / height**3 / (column.density.flat[0] * width)
    image = column.discretization.space.positions
    for share, is_stable in ((0.5, True), (3.0, False)):
        _, report = Equilibrium().unloaded(column, image, np.array([0.0, -share * g, 0.0]))
        assert report.is_stable == is_stable

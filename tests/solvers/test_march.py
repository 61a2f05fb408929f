"""Laws with history in bodies: a homogeneous cube agrees with a material point, in 2-D and 3-D, and resumes to the same bits."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from maxwell_fibre import MaxwellFibre

from cicatrix.cases import laws
from cicatrix.core.units import acceleration_mm_s2
from cicatrix.materials.active import ActiveFibres, Contraction
from cicatrix.materials.compose import Sum
from cicatrix.materials.constituent import Constituent
from cicatrix.materials.exponential import Exponential
from cicatrix.materials.fibres import FibreDistribution, FibreViscosity
from cicatrix.materials.growing import AreaGrowth, FibreGrowth, Growing, VolumeGrowth
from cicatrix.materials.holzapfel import HolzapfelGasserOgden
from cicatrix.materials.homogenised import Homogenised
from cicatrix.materials.ligaments import Ligaments
from cicatrix.materials.locking_skin import LockingSkin
from cicatrix.materials.may_newman import MayNewman
from cicatrix.materials.mixture import ConstrainedMixture
from cicatrix.materials.mooney_rivlin import MooneyRivlin
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.materials.ogden import Ogden
from cicatrix.materials.orientation import VonMises
from cicatrix.materials.viscoelastic import Viscoelastic
from cicatrix.materials.waviness import Uniform
from cicatrix.mechanics.body_integration import Load, initial_state, integrate
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.solids import solid_body
from cicatrix.numerics.compiler import COMPILER

pytestmark = pytest.mark.xdist_group("march")  # compiled once

GROUND = NeoHookean(2.0, 100.0)
ORIENTATION = VonMises(2.0, 0.5, 8)
LAWS = {
    "viscoelastic": Viscoelastic(GROUND, (0.5,), (2.0,)),
    "viscous fibres": Sum(
        (GROUND, FibreDistribution(3.0, ORIENTATION, Uniform(1.0, 1.3), FibreViscosity(0.5, 2.0, 3)))
    ),
    "growing": Growing(GROUND, FibreGrowth(5.0, None, ORIENTATION)),
}
COLLAGEN = Constituent(HolzapfelGasserOgden(0.0, 2.0, 0.5), 0.4, lifetime=20.0, prestretch=1.05)
ELASTIN = Constituent(NeoHookean(5.0), 0.6)
OTHERS = {  # with those above, one of every type that a case file may name
    "neo-hookean": GROUND,
    "exponential": Exponential(2.0, 5.0, 100.0),
    "locking-skin": LockingSkin(2.0, 30.0, 8.0, 1.05, 0.03, 100.0),
    "ligaments": Sum((GROUND, Ligaments(0.02, 100.0, 1.05, 0.03, (1.0, 0.5, 0.0)))),
    "mooney-rivlin": MooneyRivlin(1.0, 0.5, 100.0),
    "ogden": Ogden(2.0, 4.0, 100.0),
    "holzapfel-gasser-ogden": HolzapfelGasserOgden(2.0, 1.5, 0.5, 0.1, 0.5, 100.0),
    "may-newman": Sum((GROUND, MayNewman(0.5, 0.1, 0.2, 0.3, 0.0))),
    "active-fibres": Sum((GROUND, ActiveFibres(0.3, ORIENTATION))),
    "contraction": Sum((GROUND, Contraction(0.2))),
    "area growth": Growing(GROUND, AreaGrowth(5.0)),
    "volume growth": Growing(GROUND, VolumeGrowth(5.0)),
    "growth by stress": Growing(GROUND, VolumeGrowth(50.0, 20.0)),
    "mixture": ConstrainedMixture((ELASTIN, COLLAGEN), 100.0),
    "homogenised mixture": ConstrainedMixture((ELASTIN, COLLAGEN), 100.0, Homogenised()),
}
GRAVITY = acceleration_mm_s2(np.array([0.0, -9.81, 0.0]))
TIMES = (0.0, 1.0, 3.0)
step = jax.jit(lambda law, F, state, dt: law.response(F, state, dt), compiler_options=COMPILER)


def cube(law, is_fixed):
    """Return a 10 mm cube of eight corners, a centre node and twelve tetrahedra: (body, its own nodes)."""
    corner = 10.0 * np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    points = np.vstack([corner, [[4.0, 5.5, 5.2]]])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    cells = np.array([(*t, 8) for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    turned = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) < 0
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    n = len(cells)
    body = solid_body(points, cells, is_fixed(points), np.ones(n), np.full(n, 0.3), np.full(n, 1e-6))
    return replace(body, law=law)


def path(k):
    """Return the deformation gradient of the whole cube at each time."""
    return np.eye(3) + k * np.array([[0.08, 0.05, 0.0], [0.0, -0.03, 0.02], [0.0, 0.0, -0.02]])


def is_a_point(body, law, F_of):
    """With an affine motion of the fixed nodes the others follow; history and stress agree with those of a point."""
    X = body.discretization.space.positions
    loads = [Load(t, np.zeros(3), prescribed_positions=X @ F_of(k).T) for k, t in enumerate(TIMES, 1)]
    state, before = law.initial_state(()), 0.0
    for k, reached in enumerate(integrate(body, X, loads, initial_state(body, X), Equilibrium(1e-12)), 1):
        answer = step(law, F_of(k), state, reached.time - before)
        np.testing.assert_allclose(reached.x, X @ F_of(k).T, atol=1e-10)
        state, before = answer.state, reached.time
        for found, expected in zip(jax.tree.leaves(reached.state), jax.tree.leaves(state), strict=True):
            np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-10)
        P = law.stress(body.law_gradient(X, reached.x), reached.state)
        np.testing.assert_allclose(P, np.broadcast_to(answer.P, P.shape), atol=1e-10 * np.abs(answer.P).max())


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) for name in ("viscous fibres", "growing", "viscoelastic")]
)
def test_a_homogeneous_cube_is_a_material_point(name):
    is_a_point(cube(LAWS[name], lambda points: np.arange(len(points)) < 8), LAWS[name], path)


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_a_cube_of_any_law_is_a_material_point(name):
    is_a_point(cube(OTHERS[name], lambda points: np.arange(len(points)) < 8), OTHERS[name], path)


def test_no_law_is_missing_in_bodies():
    def within(law):
        yield type(law)
        for part in (
            *getattr(law, "parts", ()),
            *(getattr(law, name) for name in ("law", "growth") if hasattr(law, name)),
        ):
            yield from within(part)

    tested = {kind for law in (LAWS | OTHERS).values() for kind in within(law)}
    assert tested >= {*laws.LAWS.values(), *laws.GROWTHS.values()}


def in_plane(k):
    """Return F of a section, which does not change length along its normal."""
    return np.eye(3) + k * np.array([[0.08, 0.05, 0.0], [0.0, -0.03, 0.0], [0.0, 0.0, 0.0]])


@pytest.mark.slow
def test_a_homogeneous_section_is_a_material_point(rectangle, body_on):
    law, side = LAWS["viscous fibres"], 10.0
    border = lambda p: (np.abs(p[:2] - side / 2) > side / 2 - 1e-9).any(axis=0)  # noqa: E731
    is_a_point(body_on(rectangle(side, side, 2, 2), law, border, density=1e-6), law, in_plane)


@pytest.mark.slow
def test_viscous_tissue_sags_on_and_stops_at_its_law():
    """Stiffer at first by its viscous branch, finally as soft as the elastic law; meanwhile it dissipates energy."""
    law = LAWS["viscoelastic"]
    body = cube(law, lambda points: points[:, 1] > 9.9)
    body = replace(body, density=2e-5 * np.ones_like(body.density))
    X = body.discretization.space.positions
    solver = Equilibrium(1e-10)
    loads = [Load(t, GRAVITY) for t in (0.0, 0.5, 2.0, 1e8)]
    states = list(integrate(body, X, loads, initial_state(body, X), solver))
    sag = [np.linalg.norm(m.x - X, axis=1).max() for m in states]
    assert sag == sorted(sag)
    elastic, _ = solver.loaded(replace(body, law=law.law), X, GRAVITY)
    np.testing.assert_allclose(states[-1].x, elastic, atol=1e-7)
    heat = [m.heat for m in states]
    assert heat == sorted(heat)
    assert heat[-1] > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["growing", "viscous fibres"])
def test_newton_converges_fast_under_gravity(name):
    """With the consistent tangent, steps of any length need few iterations, symmetric or not."""
    body = cube(LAWS[name], lambda points: points[:, 1] > 9.9)
    body = replace(body, density=2e-5 * np.ones_like(body.density))
    X = body.discretization.space.positions
    loads = [Load(t, GRAVITY) for t in (0.0, 1.0, 3.0)]
    _, *states = integrate(body, X, loads, initial_state(body, X), Equilibrium(1e-9))
    assert all(reached.report.iterations <= 8 for reached in states)


@pytest.mark.parametrize(
    "law",
    [
        pytest.param(LAWS["growing"], id="growing", marks=pytest.mark.slow),  # compiles four times as long
        pytest.param(Sum((GROUND, MaxwellFibre(5.0, 2.0))), id="viscous"),
    ],
)
def test_it_goes_on_from_a_moment_to_the_same_bits(law):
    """A solver for a tangent that is not symmetric, as of growing tissue, is restored to the bit in test_linear.py too."""
    body = cube(law, lambda points: points[:, 1] > 9.9)
    body = replace(body, density=2e-5 * np.ones_like(body.density))
    X = body.discretization.space.positions
    loads = [Load(t, GRAVITY) for t in (0.0, 1.0, 3.0)]
    solver = Equilibrium(1e-9)
    one = list(integrate(body, X, loads[:2], initial_state(body, X), solver))
    kept = solver.state_arrays()
    (straight,) = integrate(body, X, loads[2:], one[-1], solver)
    other = Equilibrium(1e-9)
    other.restore(body.discretization, kept)
    (again,) = integrate(body, X, loads[2:], one[-1], other)
    assert (again.x == straight.x).all()

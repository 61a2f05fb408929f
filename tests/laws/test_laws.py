"""The same checks for every law: derivatives, objectivity, symmetry, rest, parameter arrays, and one energy by hand."""

import importlib
import inspect
import pkgutil
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
import pytest
from numpy_laws import ELASTIC, VISCOUS
from quick import compiled

import cicatrix.materials
from cicatrix.core.errors import InputError
from cicatrix.materials.active import ActiveFibres, Contraction
from cicatrix.materials.compose import Sum
from cicatrix.materials.constituent import Constituent
from cicatrix.materials.exponential import Exponential
from cicatrix.materials.fibres import FibreDistribution, FibreViscosity
from cicatrix.materials.growing import AreaGrowth, FibreGrowth, Growing, Growth, VolumeGrowth
from cicatrix.materials.growth import NaturalConfiguration
from cicatrix.materials.holzapfel import HolzapfelGasserOgden
from cicatrix.materials.incremental import IncrementalMaterial
from cicatrix.materials.ligaments import Ligaments
from cicatrix.materials.locking_skin import LockingSkin
from cicatrix.materials.material import EnergyMaterial, Material
from cicatrix.materials.may_newman import MayNewman
from cicatrix.materials.mixture import ConstrainedMixture
from cicatrix.materials.mooney_rivlin import MooneyRivlin
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.materials.ogden import Ogden
from cicatrix.materials.orientation import Single, VonMises
from cicatrix.materials.piecewise import PiecewiseMaterial
from cicatrix.materials.scar import Scar
from cicatrix.materials.viscoelastic import Viscoelastic
from cicatrix.materials.waviness import Beta, Triangular, Uniform

GROWN = np.array([[1.2, 0.1, 0.0], [-0.05, 0.9, 0.2], [0.0, 0.1, 1.1]])
SHEARED = np.array([[1.0, 0.3, 0.0], [0.0, 1.0, 0.0], [0.1, 0.0, 0.8]])
TISSUE = NeoHookean(2.0, 30.0)


class Case(NamedTuple):
    """A law, its properties, and an energy derived by hand."""

    law: Material
    energy: float
    """Energy Psi(F) of material in its initial state, by hand [kPa]."""
    F: np.ndarray
    natural: np.ndarray = np.eye(3)
    """Natural configuration (3, 3), relative to which the material symmetries hold."""
    at_rest: bool = True
    """Whether the stress vanishes at F = natural."""
    symmetries: tuple = ()
    """Orthogonal tensors under which the law is invariant, relative to its natural configuration; () means all (isotropic)."""
    has_potential: bool = True
    """Whether steps derive from a potential, so that the tangent is symmetric."""
    step: float = 1e-3
    """Step of finite differences; short where fibres become slack and the stress has kinks."""


SIMPLE_SHEAR = np.eye(3) + 0.5 * np.outer([1, 0, 0], [0, 1, 0])  # I1 = 3 + 0.5^2, J = 1
PULL = np.diag([2.0, 2.0**-0.5, 2.0**-0.5])  # I1 = 4 + 1, I2 = 4 + 1/4, J = 1
IN_PLANE = -np.diag(
    [1.0, 1.0, -1.0]
)  # acts on C like a reflection: symmetry of fibres in the plane of the first two axes
ACROSS = -np.diag([1.0, -1.0, 1.0])  # symmetry of families on both sides of the first axis
AT_30 = -np.array([[0.5, 3**0.5 / 2, 0], [3**0.5 / 2, -0.5, 0], [0, 0, 1]])  # the reflection about 30 degrees
ALONG = Single(0.0)
TINY = 1e-6
CASES = {
    # mu/2 (I1 - 3) = 2/2 * 0.25
    "NeoHookean": Case(TISSUE, 0.25, SIMPLE_SHEAR),
    # mu/(2b) (exp(b (I1 - 3)) - 1) = 2/(2 * 2) (exp(2 * 0.25) - 1)
    "Exponential": Case(Exponential(2.0, 2.0, 30.0), 0.5 * np.expm1(0.5), SIMPLE_SHEAR),
    # mu/2 * 2 and one stretch beyond 1.2 +- 0.2: mu_2 (G(1.0) - G(0.6)) / 0.4, G(x) = (exp(y) - 1 - y - y^2/2) / d^2, y = d x
    "LockingSkin": Case(
        LockingSkin(2.0, 1.5, 2.5, 1.2, 0.2, 30.0),
        2.0 + 1.5 / 0.4 * (np.expm1(2.5) - 2.5 - 3.125 - np.expm1(1.5) + 1.5 + 1.125) / 6.25,
        PULL,
        step=TINY,
    ),
    # c10 (I1 - 3) + c01 (I2 - 3), both 3.25 in simple shear: 1.5 * 0.25
    "MooneyRivlin": Case(MooneyRivlin(1.0, 0.5, 30.0), 0.375, SIMPLE_SHEAR),
    # 2 mu / alpha^2 (2^4 + 2 * 2^-2 - 3) = 4/16 * 13.5
    "Ogden": Case(Ogden(2.0, 4.0, 30.0), 3.375, PULL),
    # mu/2 * 2 + k1 / (2 k2) * 2 (exp(k2 E^2) - 1), E = 0.1 * 2 + 0.7 (4 cos^2 + 1/2 sin^2 - 1), of 30 degrees: 1.6875 -> 1.69375
    "HolzapfelGasserOgden": Case(
        HolzapfelGasserOgden(2.0, 1.5, 0.5, 0.1, np.pi / 6, 30.0),
        2.0 + 1.5 / 0.5 * np.expm1(0.5 * (0.2 + 0.7 * 2.125) ** 2),
        PULL,
        symmetries=(IN_PLANE, ACROSS),
    ),
    # c0 (exp(c1 2^2 + c2 1^4) - 1)
    "MayNewman": Case(MayNewman(0.5, 0.1, 0.2, 0.0, 30.0), 0.5 * np.expm1(0.6), PULL, symmetries=(IN_PLANE, ACROSS)),
    # straight fibres along the pull: mu_f / 2 (2^2 + 2/2 - 3)
    "FibreDistribution": Case(FibreDistribution(2.0, ALONG), 2.0, PULL, symmetries=(IN_PLANE, ACROSS), step=TINY),
    # straight at 1 to 1.4, so all straight: mu_f / 2 (4 M_-2 + M_1 - 3), M_-2 = 1 / 1.4, M_1 = 1.2
    "fibres of uniform waviness": Case(
        FibreDistribution(2.0, ALONG, Uniform(1.0, 1.4)), 4 / 1.4 - 1.8, PULL, symmetries=(IN_PLANE, ACROSS), step=TINY
    ),
    # M_-2 of the triangle: 4 / 0.4^2 (ln 1.2 - 1 + 1/1.2 + 1.4/1.2 - 1 - ln(1.4/1.2)), M_1 = 1.2
    "fibres of triangular waviness": Case(
        FibreDistribution(2.0, ALONG, Triangular(1.0, 1.4)),
        4 * 25 * (np.log(1.2) + 1 / 1.2 - 1 + 1.4 / 1.2 - 1 - np.log(1.4 / 1.2)) - 1.8,
        PULL,
        symmetries=(IN_PLANE, ACROSS),
        step=TINY,
    ),
    # p = 2, q = 1: rho = 2 (w - 1) / 0.4^2; M_-2 = 12.5 (ln 1.4 + 1/1.4 - 1), M_1 = 1 + 0.4 * 2/3
    "fibres of beta waviness": Case(
        FibreDistribution(2.0, ALONG, Beta(1.0, 1.4, 2.0, 1.0)),
        4 * 12.5 * (np.log(1.4) + 1 / 1.4 - 1) + 1 + 0.8 / 3 - 3,
        PULL,
        symmetries=(IN_PLANE, ACROSS),
        step=TINY,
    ),
    # straight at 1 to 1.1: 2 % of mu_f / 2 (4 / (1.0 * 1.1) + 2 * 1.05 / 2 - 3)
    "Ligaments": Case(
        Ligaments(0.02, 100.0, 1.05, 0.05), 4 / 1.1 - 1.95, PULL, symmetries=(IN_PLANE, ACROSS), step=TINY
    ),
    # all fibres of a plane stretched by 2: as before, and the branch adds half of it
    "viscous fibres": Case(
        FibreDistribution(2.0, VonMises(2.0, np.pi / 6, 8), Uniform(1.0, 1.4), FibreViscosity(0.5, 10.0, 12)),
        1.5 * (4 / 1.4 - 1.8),
        np.diag([2.0, 2.0, 0.25]),
        symmetries=(IN_PLANE, AT_30),
        step=TINY,
    ),
    # shape changes alone: (1 + 0.5 + 0.2) * 0.25
    "Viscoelastic": Case(Viscoelastic(TISSUE, (0.5, 0.2), (1.0, 10.0)), 1.7 * 0.25, SIMPLE_SHEAR),
    # no growth yet: 0.25 + 0
    "Growing": Case(
        Growing(TISSUE, FibreGrowth(10.0, None, VonMises(2.0, np.pi / 6, 8))),
        0.25,
        SIMPLE_SHEAR,
        symmetries=(IN_PLANE, AT_30),
        has_potential=False,
    ),
    "growing by area": Case(
        Growing(TISSUE, AreaGrowth(10.0)), 0.25, SIMPLE_SHEAR, symmetries=(IN_PLANE, ACROSS), has_potential=False
    ),
    "growing by stress": Case(
        Growing(TISSUE, AreaGrowth(10.0, 3.0)), 0.25, SIMPLE_SHEAR, symmetries=(IN_PLANE, ACROSS), has_potential=False
    ),
    "growing along stressed fibres": Case(
        Growing(TISSUE, FibreGrowth(10.0, 3.0, VonMises(2.0, np.pi / 6, 8))),
        0.25,
        SIMPLE_SHEAR,
        symmetries=(IN_PLANE, AT_30),
        has_potential=False,
    ),
    # volume growth has a potential in its own volume but not with J_g Psi: see the tangent
    "growing by volume": Case(Growing(TISSUE, VolumeGrowth(10.0)), 0.25, SIMPLE_SHEAR, has_potential=False),
    # T/2 (I1 - 3) = 0.4/2 * 0.25
    "Contraction": Case(Contraction(0.4), 0.05, SIMPLE_SHEAR, at_rest=False),
    # T ln 2
    "ActiveFibres": Case(
        ActiveFibres(0.4, ALONG), 0.4 * np.log(2.0), PULL, at_rest=False, symmetries=(IN_PLANE, ACROSS)
    ),
    # phi k_0 2 + phi k_f / (2 k_2) (exp(k_2 E^2) - 1), E = 0.2 * 5 + 0.4 * 4 - 1
    "Scar": Case(
        Scar(np.eye(3), np.diag([0.6, 0.2, 0.2]), 1.0, 2.0, 0.5, 30.0, 0.8, 0.0),
        1.6 + 1.6 * np.expm1(0.5 * 1.6**2),
        PULL,
        symmetries=(IN_PLANE, ACROSS),
        step=TINY,
    ),
    # old tissue in simple shear, and active tension of 30 kPa in one fibre direction: 0.25 + 30 ln C_11, C_11 = 1
    "PiecewiseMaterial": Case(
        PiecewiseMaterial.of(
            TISSUE,
            Scar(np.eye(3), np.diag([0.0, 1.0, 0.0]), 1.0, 2.0, 0.5, 30.0, 0.8, 30.0),
            np.eye(3),
            np.array(False),
        ),
        0.25 + 30.0 * np.log(1.25),
        SIMPLE_SHEAR,
        at_rest=False,
        symmetries=(ACROSS,),
        step=TINY,
    ),
    # 0.25 of the first and 3/2 * 0.25 of the second
    "Sum": Case(Sum((TISSUE, NeoHookean(3.0, 5.0))), 0.625, SIMPLE_SHEAR),
    # F_e = F F_n^-1 = I / 2, pure volume: J_e = 1/8, det F_n kappa/2 (J_e - 1)^2 = 8 * 15 * (7/8)^2
    "NaturalConfiguration": Case(NaturalConfiguration(TISSUE, 2 * np.eye(3)), 91.875, np.eye(3), 2 * np.eye(3)),
    # the law of a lumpectomy; at F = 2 F_n, F_e = 2 I: J_e = 8, I1 = 12,
    # det F_n (30/2 * 7^2 + 0.4/2 * 9) = 736.8 det F_n
    "lumpectomy": Case(
        NaturalConfiguration(Sum((TISSUE, Contraction(0.4))), GROWN),
        736.8 * np.linalg.det(GROWN),
        2 * GROWN,
        GROWN,
        at_rest=False,
    ),
    # deposited without prestretch, at constant volume: 0.6 * 2/2 * 0.25 + 0.3 * 4/2 * 0.25
    "ConstrainedMixture": Case(
        ConstrainedMixture((Constituent(NeoHookean(2.0), 0.6), Constituent(NeoHookean(4.0), 0.3)), kappa=20.0),
        0.3,
        SIMPLE_SHEAR,
    ),
    # NumPy behind a callback, mu/2 (I1 - 3) as above
    "ExternalMaterial": Case(ELASTIC, 0.25, SIMPLE_SHEAR),
    # mu/2 * 2, and a branch of 3 kPa stretched by ln 2
    "viscous ExternalMaterial": Case(VISCOUS, 2.0 + 1.5 * np.log(2.0) ** 2, PULL, symmetries=(IN_PLANE, ACROSS)),
    # natural states multiply: F_e = F B^-1 A^-1, so the body rests at F = A B
    "natural state of a natural state": Case(
        NaturalConfiguration(NaturalConfiguration(TISSUE, GROWN), SHEARED), 0.0, GROWN @ SHEARED, GROWN @ SHEARED
    ),
    # both parts swollen by 2 in length, one of them in two steps; at F = 2 I only Contraction has energy:
    # 0.4/2 * (12 - 3)
    "sum of sums": Case(
        Sum(
            (
                Sum((NaturalConfiguration(TISSUE, 2 * np.eye(3)), Contraction(0.4))),
                NaturalConfiguration(NaturalConfiguration(NeoHookean(1.0, 4.0), 4 * np.eye(3)), 0.5 * np.eye(3)),
            )
        ),
        1.8,
        2 * np.eye(3),
        2 * np.eye(3),
        at_rest=False,
    ),
}
rng = np.random.default_rng(7)
F = np.eye(3) + 0.3 * rng.uniform(-1, 1, (5, 3, 3))
EARLIER = np.eye(3) + 0.2 * rng.uniform(-1, 1, (5, 3, 3))
DT = 2.0  # s
Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
Q *= np.sign(np.linalg.det(Q))


SLOW = ("growing by area", "growing by stress", "growing along stressed fibres", "growing by volume", "sum of sums")
SLOW += ("natural state of a natural state", "fibres of triangular waviness")


def one_worker(name):
    """Compile each law once."""
    return pytest.param(name, marks=[pytest.mark.xdist_group(name), *[pytest.mark.slow] * (name in SLOW)])


@pytest.fixture(params=map(one_worker, CASES), scope="module")
def case(request):
    return CASES[request.param]


STEP = compiled(lambda law, F, state: law.response(F, state, DT))
STRESS = compiled(lambda law, F, state: law.stress(F, state))
ENERGY = compiled(lambda law, F, state: law.energy(F, state))
DISSIPATED = compiled(lambda law, F, before, after: law.dissipated(F, before, after, DT))


class Compiled:
    """Compiled functions of F of a law, at a state with history and at the initial state."""

    def __init__(self, law):
        self.step, self.stress, self.energy = partial(STEP, law), partial(STRESS, law), partial(ENERGY, law)
        self.dissipated = partial(DISSIPATED, law)
        self.initial = law.initial_state((5,))
        self.before = self.step(EARLIER, self.initial).state
        self.answer = self.step(F, self.before)


@pytest.fixture(scope="module")
def law(case):
    return Compiled(case.law)


def differences(function, F, step):
    """Return sixth-order central differences by each component of F; the error is ~ step^6 plus round-off / step."""
    out = []
    for direction in np.eye(9).reshape(9, 3, 3):
        values = [np.asarray(function(F + k * step * direction)) for k in (-3, -2, -1, 1, 2, 3)]
        out.append(sum(w * v for w, v in zip((-1, 9, -45, 45, -9, 1), values)) / (60 * step))
    return np.moveaxis(np.array(out), 0, -1).reshape(*np.shape(values[0]), 3, 3)


def close(a, b, tolerance):
    scale = max(np.abs(b).max(), 1e-300)
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * scale)


def test_stress_is_the_derivative_of_energy(case, law):
    """The derivative is at fixed history."""
    close(law.stress(F, law.before), differences(lambda F: law.energy(F, law.before), F, case.step), 1e-7)


def test_tangent_is_the_derivative_of_stress(case, law):
    """The tangent includes the step of the history."""
    close(law.answer.A, differences(lambda F: law.step(F, law.before).P, F, case.step), 1e-7)


def test_response_and_stress_agree(law):
    close(law.stress(F, law.answer.state), law.answer.P, 1e-13)


def test_tangent_has_major_symmetry(case, law):
    """Second derivatives of a potential commute; growth has no potential."""
    skew = np.abs(np.einsum("nijkl->nklij", law.answer.A) - law.answer.A).max() / np.abs(law.answer.A).max()
    assert (skew < 1e-12) == case.has_potential


def test_objective(law):
    """A rotation of the body changes neither energy nor history, and rotates the stress."""
    turned = law.step(Q @ F, law.before)
    close(law.energy(Q @ F, law.before), law.energy(F, law.before), 1e-12)
    close(turned.P, Q @ np.asarray(law.answer.P), 1e-12)
    for new, old in zip(jax.tree.leaves(turned.state), jax.tree.leaves(law.answer.state), strict=True):
        close(new, old, 1e-12)


def test_cauchy_stress_is_symmetric(law):
    cauchy = np.asarray(law.answer.P) @ F.swapaxes(1, 2)
    close(cauchy, cauchy.swapaxes(1, 2), 1e-12)


def test_material_symmetry(case, law):
    """A symmetry of the material applied before the natural state: Psi(F F_n^-1 Q F_n) = Psi(F), also after a step."""
    for turn in case.symmetries or (Q,):
        turn = np.linalg.inv(case.natural) @ turn @ case.natural
        for state in (law.initial, law.step(EARLIER, law.initial).state):
            again = law.initial if state is law.initial else law.step(EARLIER @ turn, law.initial).state
            close(law.energy(F @ turn, again), law.energy(F, state), 1e-12)


def test_anisotropic_where_it_is_said(case, law):
    if case.symmetries:
        skew = np.abs(law.energy(F @ Q, law.initial) - law.energy(F, law.initial)).max()
        grown = law.step(F @ Q, law.initial).P
        assert skew > 1e-3 or np.abs(np.asarray(grown) - np.asarray(law.step(F, law.initial).P) @ Q).max() > 1e-3


def everywhere(F0):
    """Repeat F to the shape that is compiled already."""
    return np.broadcast_to(F0, F.shape)


def test_free_of_stress_at_rest(case, law):
    at_rest = np.abs(np.asarray(law.stress(everywhere(case.natural), law.initial))).max()
    assert (at_rest < 1e-12) == case.at_rest


def test_energy_is_least_at_rest(case, law):
    if case.at_rest:
        assert np.abs(law.energy(everywhere(case.natural), law.initial)).max() < 1e-12
        assert (np.asarray(law.energy(F, law.initial)) >= -1e-14).all()  # round-off


def test_number_by_hand(case, law):
    assert float(law.energy(everywhere(case.F), law.initial)[0]) == pytest.approx(case.energy, rel=1e-12, abs=1e-12)


def test_nothing_is_won_on_random_histories(law):
    """The dissipation of a step is never negative."""
    draw, state = np.random.default_rng(3), law.initial
    for _ in range(30):
        shape = np.eye(3) + 0.3 * draw.uniform(-1, 1, (5, 3, 3))
        after = law.step(shape, state).state
        assert (np.asarray(law.dissipated(shape, state, after)) >= 0).all()
        state = after


def test_input_is_untouched(case, law):
    given, leaves = F.copy(), [np.copy(leaf) for leaf in jax.tree.leaves((case.law, law.before))]
    law.step(given, law.before)
    assert (given == F).all()
    assert all(
        (a == b).all() for a, b in zip(leaves, map(np.asarray, jax.tree.leaves((case.law, law.before))), strict=True)
    )


def test_parameters_may_be_one_number_per_point(case, law):
    """A law with arrays, the first point as in the case and the others softer, equals two separate laws."""
    softer = jax.tree.map(lambda leaf: 0.9 * leaf, case.law)
    mixed = jax.tree.map(lambda a, b: np.stack([a, b, b, b, b]), case.law, softer)
    P = np.asarray(STEP(mixed, F, law.initial).P)
    close(P[:1], np.asarray(law.step(F, law.initial).P)[:1], 1e-13)
    close(P[1:], np.asarray(STEP(softer, F, law.initial).P)[1:], 1e-12)
    assert np.abs(P[1:] - np.asarray(law.step(F, law.initial).P)[1:]).max() > 1e-3


def laws_within(law):
    yield type(law)
    for part in (*getattr(law, "parts", ()), *([law.law] if hasattr(law, "law") else [])):
        yield from laws_within(part)


def materials():
    """All classes of the package that provide what mechanics asks of a law."""
    for module in pkgutil.iter_modules(cicatrix.materials.__path__, "cicatrix.materials."):
        for _, kind in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            if kind.__module__ == module.name and issubclass(kind, Material):
                yield kind


def test_no_law_is_missing():
    # the stress of an IncrementalMaterial is that of a step, not its energy's derivative: tests/solvers/test_march.py
    known = {*materials()} - {Material, EnergyMaterial, IncrementalMaterial}
    tested = {kind for case in CASES.values() for kind in laws_within(case.law)}
    assert {kind.__name__ for kind in known} == {kind.__name__ for kind in tested}


def test_every_law_provides_what_mechanics_asks():
    assert all(isinstance(case.law, Material) for case in CASES.values())
    assert issubclass(IncrementalMaterial, Material)
    assert not issubclass(Growth, Material)


def test_contraction_pulls_with_its_tension():
    """By hand, P = T F is the derivative of T/2 tr F^T F."""
    close(Contraction(0.4).stress(F), 0.4 * F, 1e-14)


def test_pure_volume_change():
    """F = 1.1 I: I1_bar = 3, so Psi = kappa/2 (1.331 - 1)^2 and P = kappa (J - 1) J^(2/3) I, by hand."""
    assert float(TISSUE.energy(1.1 * np.eye(3))) == pytest.approx(15 * 0.331**2, rel=1e-12)
    close(TISSUE.stress(1.1 * np.eye(3)), 30 * 0.331 * 1.21 * np.eye(3), 1e-12)


TANGENT = compiled(lambda mu, kappa, F: NeoHookean(mu, kappa).response(F).A)


@pytest.mark.parametrize(("E", "nu"), [(3.0, 0.3), (3.25, 0.495), (56.0, 0.0)])
def test_small_strain_is_linear_elasticity(E, nu):
    """At F = I the tangent is the isotropic one; uniaxial stress then gives back E and nu (Hooke)."""
    mu, kappa = moduli_from_young(E, nu)
    A = np.asarray(TANGENT(np.array([mu]), np.array([kappa]), np.eye(3)[None]))[0]
    I = np.eye(3)
    deviatoric = np.einsum("ik,jl->ijkl", I, I) + np.einsum("il,jk->ijkl", I, I)
    close(A, (kappa - 2 * mu / 3) * np.einsum("ij,kl->ijkl", I, I) + mu * deviatoric, 1e-12)
    normal = np.einsum("iijj->ij", A)
    strain = np.linalg.solve(normal, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(strain, [1 / E, -nu / E, -nu / E], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("value", [-1.0, np.nan, np.array([1.0, -0.5]), np.array([np.nan, 1.0])], ids=str)
@pytest.mark.parametrize(
    ("law", "field"),
    [(NeoHookean, "mu"), (NeoHookean, "kappa"), (Contraction, "tension")],
)
def test_a_value_out_of_range_is_named(law, field, value):
    others = {"mu": 1.0, "kappa": 1.0} if law is NeoHookean else {}
    with pytest.raises(InputError, match=rf"{law.__name__}\.{field} .* \[0, inf\] kPa; got"):
        law(**others | {field: value})

"""Every law against the same list: derivatives, objectivity, symmetry, rest, parameter arrays, one number by hand."""

import importlib
import pkgutil
from typing import NamedTuple

import jax
import numpy as np
import pytest

import cicatrix.materials
from cicatrix.core.errors import InputError
from cicatrix.materials.active import Contraction
from cicatrix.materials.compose import Sum
from cicatrix.materials.constituent import Constituent
from cicatrix.materials.growth import NaturalConfiguration
from cicatrix.materials.material import EnergyMaterial
from cicatrix.materials.mixture import ConstrainedMixture
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.body import COMPILER

GROWN = np.array([[1.2, 0.1, 0.0], [-0.05, 0.9, 0.2], [0.0, 0.1, 1.1]])
SHEARED = np.array([[1.0, 0.3, 0.0], [0.0, 1.0, 0.0], [0.1, 0.0, 0.8]])
TISSUE = NeoHookean(2.0, 30.0)


class Case(NamedTuple):
    """A law, where it is isotropic and free of stress, and a number derived by hand."""

    law: EnergyMaterial
    natural: np.ndarray
    """Natural configuration about which the law is isotropic (3, 3)."""
    at_rest: bool
    """Whether the stress vanishes at F = natural."""
    F: np.ndarray
    energy: float
    """Psi(F) by hand [kPa]."""


SIMPLE_SHEAR = np.eye(3) + 0.5 * np.outer([1, 0, 0], [0, 1, 0])  # I1 = 3 + 0.5^2, J = 1
CASES = {
    # mu/2 (I1 - 3) = 2/2 * 0.25
    "NeoHookean": Case(TISSUE, np.eye(3), True, SIMPLE_SHEAR, 0.25),
    # T/2 (I1 - 3) = 0.4/2 * 0.25
    "Contraction": Case(Contraction(0.4), np.eye(3), False, SIMPLE_SHEAR, 0.05),
    # 0.25 of the first and 3/2 * 0.25 of the second
    "Sum": Case(Sum((TISSUE, NeoHookean(3.0, 5.0))), np.eye(3), True, SIMPLE_SHEAR, 0.625),
    # F_e = F F_n^-1 = I / 2, pure volume: J_e = 1/8, det F_n kappa/2 (J_e - 1)^2 = 8 * 15 * (7/8)^2
    "NaturalConfiguration": Case(NaturalConfiguration(TISSUE, 2 * np.eye(3)), 2 * np.eye(3), True, np.eye(3), 91.875),
    # the law of a lumpectomy; at F = 2 F_n, F_e = 2 I: J_e = 8, I1 = 12,
    # det F_n (30/2 * 7^2 + 0.4/2 * 9) = 736.8 det F_n
    "lumpectomy": Case(
        NaturalConfiguration(Sum((TISSUE, Contraction(0.4))), GROWN),
        GROWN,
        False,
        2 * GROWN,
        736.8 * np.linalg.det(GROWN),
    ),
    # laid down without prestretch, volume kept: 0.6 * 2/2 * 0.25 + 0.3 * 4/2 * 0.25
    "ConstrainedMixture": Case(
        ConstrainedMixture((Constituent(NeoHookean(2.0), 0.6), Constituent(NeoHookean(4.0), 0.3)), kappa=20.0),
        np.eye(3),
        True,
        SIMPLE_SHEAR,
        0.3,
    ),
    # natural states multiply: F_e = F B^-1 A^-1, so the body rests at F = A B
    "natural state of a natural state": Case(
        NaturalConfiguration(NaturalConfiguration(TISSUE, GROWN), SHEARED), GROWN @ SHEARED, True, GROWN @ SHEARED, 0.0
    ),
    # both parts swollen by 2 in length, one of them by two steps; at F = 2 I nothing is strained but Contraction:
    # 0.4/2 * (12 - 3)
    "sum of sums": Case(
        Sum(
            (
                Sum((NaturalConfiguration(TISSUE, 2 * np.eye(3)), Contraction(0.4))),
                NaturalConfiguration(NaturalConfiguration(NeoHookean(1.0, 4.0), 4 * np.eye(3)), 0.5 * np.eye(3)),
            )
        ),
        2 * np.eye(3),
        False,
        2 * np.eye(3),
        1.8,
    ),
}
rng = np.random.default_rng(7)
F = np.eye(3) + 0.3 * rng.uniform(-1, 1, (5, 3, 3))
Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
Q *= np.sign(np.linalg.det(Q))


def compiled(function):
    return jax.jit(function, compiler_options=COMPILER)


@pytest.fixture(params=CASES, scope="module")
def case(request):
    return CASES[request.param]


@pytest.fixture(scope="module")
def energy(case):
    return compiled(lambda F: case.law.energy(F))


@pytest.fixture(scope="module")
def stress(case):
    return compiled(lambda F: case.law.stress(F))


@pytest.fixture(scope="module")
def answer(case):
    return compiled(lambda F: case.law.response(F, case.law.initial_state(F.shape[:-2]), 0.1))(F)


def differences(function, F, step=1e-3):
    """Sixth-order central differences by each component of F: error ~ step^6 and rounding / step."""
    out = []
    for direction in np.eye(9).reshape(9, 3, 3):
        values = [np.asarray(function(F + k * step * direction)) for k in (-3, -2, -1, 1, 2, 3)]
        out.append(sum(w * v for w, v in zip((-1, 9, -45, 45, -9, 1), values)) / (60 * step))
    return np.moveaxis(np.array(out), 0, -1).reshape(*np.shape(values[0]), 3, 3)


def close(a, b, tolerance):
    scale = np.abs(b).max()
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * scale)


def test_stress_is_the_derivative_of_energy(energy, answer):
    close(answer.P, differences(energy, F), 1e-7)


def test_tangent_is_the_derivative_of_stress(stress, answer):
    close(answer.A, differences(stress, F), 1e-7)


def test_response_and_stress_agree(stress, answer):
    close(stress(F), answer.P, 1e-14)


def test_tangent_has_major_symmetry(answer):
    """Second derivatives of an energy commute."""
    close(np.einsum("nijkl->nklij", answer.A), answer.A, 1e-13)


def test_objective(energy, stress, answer):
    close(energy(Q @ F), energy(F), 1e-12)
    close(stress(Q @ F), Q @ np.asarray(answer.P), 1e-12)


def test_cauchy_stress_is_symmetric(answer):
    cauchy = np.asarray(answer.P) @ F.swapaxes(1, 2)
    close(cauchy, cauchy.swapaxes(1, 2), 1e-12)


def test_isotropic_about_the_natural_state(case, energy):
    """A rotation before the natural state is not felt: Psi(F F_n^-1 Q F_n) = Psi(F)."""
    turned = F @ np.linalg.inv(case.natural) @ Q @ case.natural
    close(energy(turned), energy(F), 1e-12)


def everywhere(F0):
    """The shape that is compiled already."""
    return np.broadcast_to(F0, F.shape)


def test_free_of_stress_at_rest(case, stress):
    at_rest = np.abs(np.asarray(stress(everywhere(case.natural)))).max()
    assert (at_rest < 1e-12) == case.at_rest


def test_energy_is_least_at_rest(case, energy):
    if case.at_rest:
        assert np.abs(energy(everywhere(case.natural))).max() < 1e-12
        assert (np.asarray(energy(F)) > 0).all()


def test_number_by_hand(case, energy):
    assert float(energy(everywhere(case.F))[0]) == pytest.approx(case.energy, rel=1e-12, abs=1e-12)


def test_input_is_untouched(case, stress):
    given, leaves = F.copy(), [np.copy(leaf) for leaf in jax.tree.leaves(case.law)]
    state = case.law.initial_state((5,))
    compiled(lambda F: case.law.advance(F, state, 0.1))(given)
    stress(given)
    assert (given == F).all()
    assert all((a == b).all() for a, b in zip(leaves, map(np.asarray, jax.tree.leaves(case.law)), strict=True))
    assert jax.tree.all(jax.tree.map(np.array_equal, state, case.law.initial_state((5,))))


def test_parameters_may_be_one_number_per_point(case, stress):
    """A law with arrays, the first point as in the case and the others softer, is two laws."""
    softer = jax.tree.map(lambda leaf: 0.8 * np.asarray(leaf), case.law)
    mixed = jax.tree.map(lambda a, b: np.stack([a, b, b, b, b]), case.law, softer)
    alike = jax.tree.map(lambda b: np.stack([b] * 5), softer)
    of_law = compiled(lambda law, F: law.stress(F))
    P = np.asarray(of_law(mixed, F))
    close(P[:1], np.asarray(stress(F))[:1], 1e-13)
    close(P[1:], np.asarray(of_law(alike, F))[1:], 1e-13)
    assert np.abs(P[1] - np.asarray(stress(F))[1]).max() > 1e-3


def laws_within(law):
    yield type(law)
    for part in (*getattr(law, "parts", ()), *([law.law] if hasattr(law, "law") else [])):
        yield from laws_within(part)


def test_no_law_is_missing():
    for module in pkgutil.iter_modules(cicatrix.materials.__path__, "cicatrix.materials."):
        importlib.import_module(module.name)
    known, waiting = set(), [EnergyMaterial]
    while waiting:
        waiting += (subclasses := waiting.pop().__subclasses__())
        known |= {
            c for c in subclasses if c.__module__.startswith("cicatrix.") and c.energy is not EnergyMaterial.energy
        }
    tested = {kind for case in CASES.values() for kind in laws_within(case.law)}
    assert {kind.__name__ for kind in known} == {kind.__name__ for kind in tested}


def test_contraction_pulls_with_its_tension():
    """P = T F: by hand, the derivative of T/2 tr F^T F."""
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

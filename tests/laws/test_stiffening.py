"""Laws that stiffen with stretch, by closed forms: exponential tissue, skin that locks, ligaments that become straight."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick import compiled

from cicatrix.core.errors import InputError
from cicatrix.materials.exponential import CAP, Exponential, capped_expm1, growth_rates, growth_ratio
from cicatrix.materials.ligaments import Ligaments
from cicatrix.materials.locking_skin import LockingSkin
from cicatrix.materials.material import EnergyMaterial
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.mechanics.elements import Membrane, film_modulus, membrane_force, sheet, tangent
from cicatrix.mechanics.space import SolidSpace

F = np.eye(3) + 0.3 * np.random.default_rng(7).uniform(-1, 1, (6, 3, 3))
FAR = np.diag([30.0, 0.2, 0.2])  # an exponent of 1800 at b = 2
SKIN = LockingSkin(1.3, 40.0, 8.0, 1.2, 0.1)
TABLE = SolidSpace(np.zeros((0, 3)), np.zeros((0, 10), int)).facet_table
CORNERS = np.array([[0.0, 0.0, 0.0], [4.0, 1.0, 0.0], [1.0, 3.0, 0.0]])
FACE = np.vstack([CORNERS, 0.5 * (CORNERS[[0, 1, 0]] + CORNERS[[1, 2, 2]])])[None]

FACE_SKIN = Membrane(SKIN, np.ones(1), np.asarray(0.05))

FACE_FORCE = compiled(lambda x: membrane_force(FACE, x, FACE_SKIN, TABLE))
FACE_TANGENT = compiled(lambda x: tangent(lambda y: membrane_force(FACE, y, FACE_SKIN, TABLE), x))
RESPONSE = compiled(lambda law, F: law.response(F))
TWIN = compiled(lambda law, F: EnergyMaterial.response(law, F))
ENERGY = compiled(lambda law, F: law.energy(F))
THREE = compiled(
    lambda q: (growth_ratio(q), *(jax.vmap(f)(q) for f in (jax.grad(growth_ratio), jax.grad(jax.grad(growth_ratio)))))
)


def test_exponential_by_hand_agrees_with_its_derivatives():
    """At points with and without stiffening, and beyond the cap."""
    law = Exponential(np.full(7, 2.0), np.array([0.0, 1e-12, 0.5, 2.0, 10.0, 0.0, 2.0]), np.full(7, 30.0))
    points = np.concatenate([F, FAR[None]])
    by_hand, twin = RESPONSE(law, points), TWIN(law, points)
    for one, other in ((by_hand.P, twin.P), (by_hand.A, twin.A)):
        for a, b in zip(np.asarray(one), np.asarray(other), strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-13 * np.abs(b).max())


@pytest.mark.parametrize("b", [0.0, np.zeros(6)], ids=["a number", "per point"])
def test_without_stiffening_it_is_neo_hookean(b):
    mu = np.linspace(0.05, 2.0, 6)
    old, new = NeoHookean(mu, 10.0), Exponential(mu, b, 10.0)
    for one, other in zip(
        (*RESPONSE(new, F)[:2], ENERGY(new, F)), (*RESPONSE(old, F)[:2], ENERGY(old, F)), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-15 * np.abs(other).max())


def test_growth_ratio_and_its_derivatives_are_exact():
    """(e^q - 1) / q is the integral of e^(q s) over s in [0, 1], its derivatives those of s^n e^(q s): by Gauss's rule."""
    at, weight = np.polynomial.legendre.leggauss(24)
    s, weight = 0.5 * (at + 1.0), 0.5 * weight
    q = np.array([-0.5, -1e-3, 0.0, 1e-300, 1e-8, 0.1, 0.3 - 1e-12, 0.3, 0.3 + 1e-12, 2.0, 11.9])
    for n, found in enumerate(THREE(q)):
        exact = (weight * s**n * np.exp(q[:, None] * s)).sum(axis=1)
        np.testing.assert_allclose(found, exact, rtol=2e-13)


def test_beyond_the_cap_two_derivatives_are_continuous_and_positive():
    q = np.array([0.0, 5.0, CAP - 1e-9, CAP + 1e-9, 30.0, 1e6])
    slope, curvature = compiled(
        lambda q: (jax.vmap(jax.grad(capped_expm1))(q), jax.vmap(jax.grad(jax.grad(capped_expm1)))(q))
    )(q)
    for found, stated in zip((slope, curvature), growth_rates(jnp.asarray(q)), strict=True):
        np.testing.assert_allclose(found, stated, rtol=1e-14)
        assert (np.asarray(found) > 0.0).all()
    for values in (capped_expm1(jnp.asarray(q)), slope, curvature):
        assert float(values[2]) == pytest.approx(float(values[3]), rel=1e-8)
    # by hand: e^12 (1 + 18 + 18^2 / 2) - 1
    assert float(capped_expm1(jnp.asarray(30.0))) == pytest.approx(181.0 * np.exp(12.0) - 1.0, rel=1e-14)


def test_far_off_nothing_overflows_and_the_tangent_stays_definite():
    """Convex along any shear of an isochoric shape: H = a x n with a . F^-T n = 0 leaves the volume alone."""
    law = Exponential(0.1, 2.0, 10.0)
    far = np.diag([1e4, 1e-2, 1e-2])
    P, A, _ = RESPONSE(law, np.stack([FAR, far]))
    assert np.isfinite(np.asarray(P)).all()
    assert np.isfinite(np.asarray(A)).all()
    for tensor in np.asarray(A):
        H = np.stack([np.outer(a, n) for a in np.eye(3) for n in np.eye(3) if a @ n == 0.0])
        assert (np.einsum("nij,ijkl,nkl->n", H, tensor, H) > 0.0).all()


@compiled
def film_derivatives(stretches):
    """Return the gradient (2,) and the Hessian (2, 2) of a film's energy by its principal stretches (2,) [kPa]."""

    def energy(both):
        return SKIN.energy(sheet(both[0], both[1]))

    return jax.grad(energy)(stretches), jax.hessian(energy)(stretches)


@pytest.mark.parametrize("one", [1.0, 1.1, 1.2, 1.3, 1.5, 3.5])
@pytest.mark.parametrize("other", [1.0, 1.3])
def test_locking_film_by_hand(one, other):
    """By hand, J = 1: dPsi/dl1 = mu (l1 - 1/(l1^3 l2^2)) + mean of g', and its derivatives; also at equal stretches, at rest,
    and beyond the cap, which is at a stretch of 1.2 + 12/8 less the spread. The mean is by Gauss's rule.
    """
    mu, stiff, d = 1.3, 40.0, 8.0

    def mean(function, a):
        low, high = 1.1, min(max(a, 1.1), 1.3)  # fibres that lock at less than a
        breaks = np.unique(np.clip([low, a - CAP / d, high], low, high))
        at, weight = np.polynomial.legendre.leggauss(20)
        pieces = [(0.5 * (q - p), 0.5 * (p + q)) for p, q in pairwise(breaks)]
        return sum(half * (weight * function(d * (a - middle - half * at))).sum() for half, middle in pieces) / 0.2

    def tension(q):
        return np.where(q < CAP, np.expm1(q), np.exp(CAP) * (1 + q - CAP) - 1)

    def rate(q):
        return np.exp(np.minimum(q, CAP))

    def slope(a, b):
        return mu * (a - a**-3 * b**-2) + stiff * mean(tension, a)

    def bend(a, b):
        return mu * (1 + 3 * a**-4 * b**-2) + stiff * d * mean(rate, a)

    gradient, hessian = film_derivatives(np.array([one, other]))
    mixed = 2 * mu * one**-3 * other**-3
    np.testing.assert_allclose(
        gradient, [slope(one, other), slope(other, one)], rtol=1e-10, atol=1e-12 + 1e-14 * gradient.max()
    )
    np.testing.assert_allclose(
        hessian, [[bend(one, other), mixed], [mixed, bend(other, one)]], rtol=1e-9, atol=1e-14 * hessian.max()
    )


def test_modulus_at_rest_of_a_locking_film_is_that_of_its_soft_part():
    assert float(compiled(film_modulus)(SKIN)) == pytest.approx(4 * 1.3, rel=1e-12)


@pytest.mark.parametrize("stretch", [(1.05, 1.05), (1.35, 1.35), (1.4, 1.05), (0.9, 0.9)], ids=str)
def test_tangent_of_a_face_of_locking_skin(stretch):
    """The tangent against central differences of the force, at equal and unequal stretches, locked, soft and slack."""
    x, step = FACE * np.array([*stretch, 1.0]), 1e-5
    found = np.asarray(FACE_TANGENT(x))[0]
    columns = [
        np.asarray(FACE_FORCE(x + step * d) - FACE_FORCE(x - step * d)).ravel() / (2 * step)
        for d in np.eye(18).reshape(18, 1, 6, 3)
    ]
    np.testing.assert_allclose(found, np.array(columns).T, rtol=0, atol=2e-6 * np.abs(found).max())


def test_ligaments_pull_only_when_straight():
    """By hand, straight at 1.2 to 1.3: P = phi mu_f (l / (1.2 1.3) - 1.25 / l^2) along the fibre, and none at all up to 1.2."""
    law = Ligaments(0.01, 100.0, 1.25, 0.05, (0.0, 0.0, 2.0))
    stretched = np.stack([np.diag([1.0, 1.0, x]) for x in (0.8, 1.0, 1.2 - 1e-9, 1.5)])
    P, A = (np.asarray(tensor) for tensor in RESPONSE(law, stretched)[:2])
    np.testing.assert_allclose(P[:3], 0.0, atol=1e-14)
    np.testing.assert_allclose(A[:3], 0.0, atol=1e-7)
    np.testing.assert_allclose(P[3], np.diag([0.0, 0.0, 1.5 / 1.56 - 1.25 / 2.25]), atol=1e-14)


def test_ligaments_may_have_a_direction_per_point():
    turns = np.linalg.qr(np.random.default_rng(1).standard_normal((6, 3, 3)))[0]
    many = Ligaments(0.02, 100.0, 1.1, 0.05, tuple(3.0 * turns[:, :, 0].T))
    stretched = F @ np.diag([1.6, 1.5, 1.4])
    one_by_one = [
        RESPONSE(Ligaments(0.02, 100.0, 1.1, 0.05, tuple(t[:, 0])), f) for t, f in zip(turns, stretched, strict=True)
    ]
    found = RESPONSE(many, stretched)
    np.testing.assert_allclose(found.P, [one.P for one in one_by_one], atol=1e-13)
    np.testing.assert_allclose(found.A, [one.A for one in one_by_one], atol=1e-12)
    assert np.abs(found.P).max() > 0.1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Ligaments(0.01, -1.0), r"Ligaments\.stiffness \(mu_f\) must lie in \[0, inf\] kPa; got -1"),
        (lambda: Exponential(1.0, -1.0), r"Exponential\.b \(b\) must lie in \[0, 100\]; got -1"),
        (lambda: LockingSkin(1.0, 1.0, 8.0, 0.9), r"LockingSkin\.locking_stretch .* \[1, 10\]; got 0\.9"),
        (lambda: Ligaments(0.1), r"Ligaments\.share \(phi\) must lie in \[0, 0\.02\]; got 0\.1"),
        (lambda: Ligaments(0.01, 1.0, 1.2, 0.05, (0.0, 0.0, 0.0)), "components of a direction must not all be 0"),
        (lambda: Ligaments(0.01, 1.0, 1.2, 0.05, (1.0, 0.0)), "a direction must have three components; got 2"),
    ],
)
def test_bad_values_are_one_sentence(make, words):
    with pytest.raises(InputError, match=words):
        make()

"""The stretch tensor of a deformation compared with SciPy's polar decomposition."""

import jax
import numpy as np
import pytest
import scipy.linalg

from cicatrix.numerics.polar import right_stretch

rng = np.random.default_rng(5)
GENERAL = np.eye(3) + 0.4 * rng.uniform(-1, 1, (20, 3, 3))
ANGLE = 0.7
TURN = np.array([[np.cos(ANGLE), -np.sin(ANGLE), 0], [np.sin(ANGLE), np.cos(ANGLE), 0], [0, 0, 1]])


@pytest.mark.parametrize(
    "F",
    [*GENERAL[:6], np.eye(3), 2 * TURN, TURN @ np.diag([1.5, 1.5, 0.4]), TURN @ np.diag([30.0, 0.2, 0.2])],
    ids=lambda F: f"det {np.linalg.det(F):.2g}",
)
def test_stretch_of_the_polar_decomposition(F):
    expected = scipy.linalg.polar(F)[1]
    np.testing.assert_allclose(right_stretch(F), expected, rtol=0, atol=2e-14 * np.linalg.norm(F))


def test_derivative_holds_where_stretches_coincide():
    """At F = I, dU = sym dF, by hand."""
    dF = rng.uniform(-1, 1, (3, 3))
    dU = jax.jvp(right_stretch, (np.eye(3),), (dF,))[1]
    np.testing.assert_allclose(dU, 0.5 * (dF + dF.T), atol=1e-14)


def test_derivative():
    """Compare with sixth-order differences in one direction."""
    dF, step = rng.uniform(-1, 1, (3, 3)), 1e-2
    shifted = {k: np.asarray(right_stretch(GENERAL + k * step * dF)) for k in (-3, -2, -1, 1, 2, 3)}
    slope = sum(w * shifted[k] for k, w in zip(shifted, (-1, 9, -45, 45, -9, 1))) / (60 * step)
    dU = jax.jvp(right_stretch, (GENERAL,), (np.broadcast_to(dF, GENERAL.shape),))[1]
    np.testing.assert_allclose(dU, slope, atol=1e-8)

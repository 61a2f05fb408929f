"""Backward differences with variable steps: exact for parabolas, second order, with an error estimate."""

import numpy as np
import pytest

from cicatrix.numerics.bdf import LONGEST_RISE, formula, next_step


def test_equal_steps_are_the_textbook():
    """The coefficients are 4/3 and -1/3, with 2/3; the error is 2/11 of the distance to the extrapolated parabola."""
    used = formula(0.5, [0.0, 0.5, 1.0])
    np.testing.assert_allclose(used.start, [4 / 3, -1 / 3], rtol=1e-14)
    assert used.share == pytest.approx(2 / 3, rel=1e-14)
    np.testing.assert_allclose(used.guess, [3.0, -3.0, 1.0], rtol=1e-14)
    assert used.error == pytest.approx(2 / 11, rel=1e-14)


@pytest.mark.parametrize("ages", [[0.0, 0.3, 1.1], [0.0, 0.7, 0.9]])
def test_parabolas_are_followed_exactly_and_cubics_by_their_told_error(ages):
    h = 0.4
    used = formula(h, ages)
    for power in (0, 1, 2, 3):
        past = [(-age) ** power if power else 1.0 for age in ages]
        slope = power * h ** (power - 1) if power else 0.0
        found = np.dot(used.start, past[:2]) + used.share * h * slope
        guess = np.dot(used.guess, past)
        if power < 3:
            assert found == pytest.approx(h**power, abs=1e-14)
            assert guess == pytest.approx(h**power, abs=1e-14)
        else:
            assert abs(found - h**3) == pytest.approx(used.error * abs(found - guess), rel=1e-12)


def test_a_damped_step_is_implicit_euler_and_tells_its_error_of_a_parabola():
    used = formula(0.4, [0.0, 0.3, 0.8], damped=True)
    assert (used.start, used.share, used.order) == ((1.0,), 1.0, 1)
    found = 0.4 * 2 * 0.4  # of y = t^2 from t = 0
    guess = np.dot(used.guess, [0.0, 0.09])
    assert found - 0.16 == pytest.approx(used.error * (found - guess), rel=1e-12)


def test_second_order_over_uneven_steps():
    """For y' = -y^2, halving all steps divides the error by four."""

    def error(n):
        t = np.concatenate([[0.0], np.cumsum(np.tile([1.0, 1.7, 0.8], n))])
        t *= 2.0 / t[-1]
        y, exact = [1.0 / (1.0 + s) for s in t[:2]], 1.0 / (1.0 + t)
        for k in range(2, len(t)):
            used = formula(t[k] - t[k - 1], [t[k - 1] - t[k - 1 - j] for j in range(min(k, 3))])
            start, dt = np.dot(used.start, y[::-1][:2]), used.share * (t[k] - t[k - 1])
            y.append((-1.0 + np.sqrt(1.0 + 4.0 * dt * start)) / (2.0 * dt))
        return abs(y[-1] - exact[-1])

    order = np.log2(error(20) / error(40))
    assert 1.9 < order < 2.2


def test_steps_rise_and_fall_within_limits():
    assert next_step(1.0, 0.0, 2) == LONGEST_RISE == next_step(1.0, 1e-12, 2)
    assert next_step(1.0, 1e12, 2) == pytest.approx(0.2)
    assert next_step(2.0, 8.0, 2) == pytest.approx(2.0 * 0.85 / 2.0)

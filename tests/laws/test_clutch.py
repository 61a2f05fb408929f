"""Motor-clutch model: balance of forces, stall, free flow, and clutches on a rigid substrate in closed form."""

import numpy as np
import pytest
from scipy.special import exp1

from cicatrix.biology.bond import Bell
from cicatrix.biology.clutch import ClutchSubstrate, MotorClutch, elastic_substrate
from cicatrix.core.errors import InputError

KT = 4.28317e-3
BOND = Bell(0.3, 0.1)
CHAN_ODDE = MotorClutch(
    BOND, stiffness=5000.0, reach=KT / 2.0, motors=50, motor_force=2.0, velocity=0.12
)  # 2 pN e-fold


def led(model, substrate, cells, n, dt, steps, closed=0, seed=1):
    now = model.start(cells, n, closed)
    for step in range(steps):
        now = model.advance(substrate, now, dt, seed, step)
        yield now


def test_forces_balance_at_every_step():
    substrate = ClutchSubstrate(np.array([1e3, 50.0]), np.array([0.0, 500.0]), np.array([1.0, 800.0]))
    largest = np.zeros(2)
    for now in led(CHAN_ODDE, substrate, 2, 50, 0.01, 600):
        pull = 5000.0 * np.where(now.bound, now.end - now.displacement[:, None], 0.0).sum(axis=1)
        np.testing.assert_allclose(CHAN_ODDE.force(substrate, now), pull, atol=1e-9)
        largest = np.maximum(largest, pull)
    assert ((largest > 5.0) & (largest < 100.0)).all()  # never above the stall force of the motors


@pytest.mark.parametrize("dt", [0.01, 10.0])
def test_bonds_that_hold_stall_the_motors(dt):
    """At stall, n_m F_m = 100 pN, the flow is 0, and x_s = 100 / k_s, for any length of step."""
    held = MotorClutch(Bell(0.3, 1e-12), 5000.0, 0.0, 50, 2.0, 0.12)
    *_, now = led(held, elastic_substrate(np.array([1000.0])), 1, 20, dt, 1500, closed=20)
    assert now.bound.all()
    assert float(now.displacement[0]) == pytest.approx(0.1, rel=1e-6)
    assert float(held.flow(elastic_substrate(np.array([1000.0])), now)[0]) == pytest.approx(0.0, abs=1e-7)


def test_without_bonds_actin_flows_freely():
    loose = MotorClutch(Bell(1e-12, 0.1), 5000.0, KT / 2.0, 50, 2.0, 0.12)
    *_, now = led(loose, elastic_substrate(np.array([1000.0])), 1, 20, 0.01, 50)
    assert not now.bound.any()
    assert float(loose.flow(elastic_substrate(np.array([1000.0])), now)[0]) == 0.12


def test_strong_motors_on_rigid_ground():
    """Independent clutches, k_off = k0 exp(k_c v a / F_b) at age a: each has e^A E_1(A) F_b / (k_c v), A = k0 F_b / (k_c v)."""
    model = MotorClutch(BOND, 100.0, KT / 2.0, 1e12, 2.0, 0.12)
    per_second = 100.0 * 0.12 / 2.0
    A = 0.1 / per_second
    held = np.exp(A) * exp1(A) / per_second
    mean = 0.3 * held / (1 + 0.3 * held)
    late = [now.bound.mean() for now in led(model, elastic_substrate(np.full(10, 1e12)), 10, 400, 0.01, 2000)][
        1000::200
    ]
    sigma = np.sqrt(mean * (1 - mean) / (4000 * len(late)))
    assert abs(np.mean(late) - mean) < 4 * sigma + 0.3 * 0.01 * mean  # and the step's own error


def test_stiffness_that_carries_most():
    """Chan & Odde: load and fail on soft substrates, frictional slippage on stiff ones; the flow is slowest in between."""
    k = np.array([10.0, 1e3, 1e5])
    substrate = elastic_substrate(np.repeat(k, 4))
    flow = [CHAN_ODDE.flow(substrate, now) for now in led(CHAN_ODDE, substrate, 12, 50, 0.01, 1500)]
    mean = np.mean(flow[300:], axis=0).reshape(3, 4).mean(axis=1)
    assert mean[1] < mean[2] < 0.12


def test_draws_belong_to_seed_and_step():
    substrate = elastic_substrate(np.array([1e3]))
    first, again, other = ([*led(CHAN_ODDE, substrate, 1, 50, 0.01, 300, seed=s)][-1] for s in (1, 1, 2))
    np.testing.assert_array_equal(first.end, again.end)
    assert (first.bound != other.bound).any()


def test_soft_as_nothing_is_refused():
    with pytest.raises(InputError, match="must be positive; got 0"):
        elastic_substrate(np.array([1.0, 0.0]))

"""The benchmark of cells: adhesion at many substrates, single bonds at random, and what SciPy takes for the same.

Seconds are those of the processor on one core. Signalling networks are measured in ``bench_networks``.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator

import jax
import numpy as np
from scipy.integrate import solve_ivp

from ..biology.adhesion import Adhesion
from ..biology.bond import Bell
from ..biology.contraction import Feedback
from ..biology.sampling import exact, monte_carlo
from ..biology.substrate import Column, ExponentialFibre, LinearSubstrate
from ..materials.chunked import chunked
from .measurement import Measurement, best_of, printed_on_one_core

MANY = 1_000_000  # substrates in one call
SIZE = 1000  # at a time; divides MANY
FEW = 100  # loops of SciPy
BONDS, STEPS = 1_000_000, 200
HORIZON = 1000.0  # s: many times what the bonds take
BELL = Bell(0.01, 0.012)
CELL = Feedback(100.0, 0.5, 2e4, 4e3)
COLLAGEN = Column(ExponentialFibre(0.004 * 17.599164683e6, 20.818113705), 0.017, 0.1)
SUBSTRATES = {"spring": LinearSubstrate(5e4), "collagen fibre": COLLAGEN}


def cells() -> Iterator[Measurement]:
    """Adhesion, in a process of its own that has one core."""
    return printed_on_one_core("-m", __name__)


def measured() -> Iterator[Measurement]:
    """Steady states with feedback, their derivative, single bonds in fixed steps and at exact times, and a loop of SciPy's."""
    for name, made in SUBSTRATES.items():
        yield _steady(name, Adhesion(BELL, made, CELL, 400.0))
    for row in (_derivative, _scipy, _stepped, _generator, _exact):
        yield row()


def _steady(name: str, law: Adhesion) -> Measurement:
    ready = jax.jit(lambda law, stretch: chunked(lambda s: law.anchored(s).traction, stretch, SIZE))
    ns = _ns_per_point(ready, law)
    return Measurement(f"steady state, {name}", ns, "ns", f"a point of {MANY:g}, with feedback; aim 2000")


def _derivative() -> Measurement:
    law = Adhesion(BELL, COLLAGEN, CELL, 400.0)

    def slope(stretch: jax.Array) -> jax.Array:
        return jax.jvp(lambda s: law.anchored(s).traction, (stretch,), (jax.numpy.ones_like(stretch),))[1]

    ready = jax.jit(lambda _, stretch: chunked(slope, stretch, SIZE))
    return Measurement(
        "its derivative by stretch, collagen fibre", _ns_per_point(ready, law), "ns", f"a point of {MANY:g}"
    )


def _ns_per_point(ready: Callable, law: Adhesion) -> float:
    stretch = jax.device_put(np.linspace(1.0, 1.15, MANY))
    jax.block_until_ready(ready(law, stretch))
    return 1e9 * best_of(lambda: jax.block_until_ready(ready(law, stretch)), 3, time.process_time) / MANY


def _scipy() -> Measurement:
    """The mean field led to its steady state point by point, rates given."""
    at = Adhesion(BELL, COLLAGEN, CELL, 400.0).anchored(np.linspace(1.0, 1.15, FEW))
    rates = np.asarray(at.k_off).tolist()

    def loop() -> None:
        for k_off in rates:
            solve_ivp(lambda t, phi, k=k_off: 0.01 * (1.0 - phi) - k * phi, (0.0, HORIZON), [0.0], method="LSODA")

    seconds = best_of(loop, 3, time.process_time)
    return Measurement(
        "SciPy's solve_ivp to the steady state", 1e9 * seconds / FEW, "ns", "a point, the rate given; LSODA"
    )


def _stepped() -> Measurement:
    chance = np.full((STEPS, 1), 1e-3)
    bound = np.zeros((1, BONDS), np.uint8)
    seconds = best_of(lambda: monte_carlo(bound, chance, chance, 1, 0), 3, time.process_time)
    return Measurement("Monte Carlo", BONDS * STEPS / seconds * 1e-6, "M/s", "bond updates, one thread; aim 100")


def _generator() -> Measurement:
    """What NumPy takes for as many random words alone."""
    words = np.random.Generator(np.random.Philox(1))
    seconds = best_of(lambda: words.integers(0, 2**32, BONDS, np.uint32), 5, time.process_time)
    return Measurement("NumPy's Philox alone", BONDS / seconds * 1e-6, "M/s", "words of 32 bits, no bonds")


def _exact() -> Measurement:
    bound, rate = np.zeros((1, BONDS // 10), np.uint8), np.array([0.01])
    seconds = best_of(lambda: exact(bound, (0.0, HORIZON), rate, rate, None, 1, 1), 2, time.process_time)
    return Measurement("exact times", 0.01 * HORIZON * bound.size / seconds * 1e-6, "M/s", "events, NumPy")


if __name__ == "__main__":
    for row in measured():
        print(json.dumps(row), flush=True)

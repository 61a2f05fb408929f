"""Benchmark of cell adhesion: steady states on many substrates, stochastic bonds, and SciPy's solver for the same equation.

All times are CPU seconds on one core. :mod:`.networks` measures signalling networks.
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

N_POINTS = 1_000_000  # substrates in one call
CHUNK_SIZE = 1000  # substrates per chunk; divides N_POINTS
N_SCIPY = 100  # substrates in the loop over SciPy's solver
BONDS, STEPS = 1_000_000, 200
HORIZON = 1000.0  # s: many times the relaxation time of the bonds
BELL = Bell(0.01, 0.012)
CELL = Feedback(100.0, 0.5, 2e4, 4e3)
COLLAGEN = Column(ExponentialFibre(0.004 * 17.599164683e6, 20.818113705), 0.017, 0.1)
SUBSTRATES = {"spring": LinearSubstrate(5e4), "collagen fibre": COLLAGEN}


def cells() -> Iterator[Measurement]:
    """Run the adhesion benchmark in a separate process pinned to one core; yield its measurements."""
    return printed_on_one_core("-m", __name__)


def measured() -> Iterator[Measurement]:
    """Measure steady states with feedback, their derivative, stochastic bonds in fixed steps and at exact times, and SciPy."""
    for name, made in SUBSTRATES.items():
        yield _steady(name, Adhesion(BELL, made, CELL, 400.0))
    for row in (_derivative, _scipy, _stepped, _generator, _exact):
        yield row()


def _steady(name: str, law: Adhesion) -> Measurement:
    ready = jax.jit(lambda law, stretch: chunked(lambda s: law.steady_state(s).traction, stretch, CHUNK_SIZE))
    ns = _ns_per_point(ready, law)
    return Measurement(f"steady state, {name}", ns, "ns", f"per point, {N_POINTS:g} points, with feedback; aim 2000")


def _derivative() -> Measurement:
    law = Adhesion(BELL, COLLAGEN, CELL, 400.0)

    def slope(stretch: jax.Array) -> jax.Array:
        return jax.jvp(lambda s: law.steady_state(s).traction, (stretch,), (jax.numpy.ones_like(stretch),))[1]

    ready = jax.jit(lambda _, stretch: chunked(slope, stretch, CHUNK_SIZE))
    return Measurement(
        "its derivative by stretch, collagen fibre", _ns_per_point(ready, law), "ns", f"per point, {N_POINTS:g} points"
    )


def _ns_per_point(ready: Callable, law: Adhesion) -> float:
    stretch = jax.device_put(np.linspace(1.0, 1.15, N_POINTS))
    jax.block_until_ready(ready(law, stretch))
    return 1e9 * best_of(lambda: jax.block_until_ready(ready(law, stretch)), 3, time.process_time) / N_POINTS


def _scipy() -> Measurement:
    """Measure SciPy: integrate the mean-field bond equation to its steady state, one substrate at a time, with given rates."""
    at = Adhesion(BELL, COLLAGEN, CELL, 400.0).steady_state(np.linspace(1.0, 1.15, N_SCIPY))
    rates = np.asarray(at.k_off).tolist()

    def loop() -> None:
        for k_off in rates:
            solve_ivp(lambda t, phi, k=k_off: 0.01 * (1.0 - phi) - k * phi, (0.0, HORIZON), [0.0], method="LSODA")

    seconds = best_of(loop, 3, time.process_time)
    return Measurement(
        "SciPy's solve_ivp to the steady state", 1e9 * seconds / N_SCIPY, "ns", "per point, the rate given; LSODA"
    )


def _stepped() -> Measurement:
    chance = np.full((STEPS, 1), 1e-3)
    bound = np.zeros((1, BONDS), np.uint8)
    seconds = best_of(lambda: monte_carlo(bound, chance, chance, 1, 0), 3, time.process_time)
    return Measurement("Monte Carlo", BONDS * STEPS / seconds * 1e-6, "M/s", "bond updates, one thread; aim 100")


def _generator() -> Measurement:
    """Measure NumPy's random generator alone, for as many random words as the bonds need."""
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

"""Benchmark of signalling: a network of 100 species with many parameter sets, compared with SciPy and libroadrunner.

All times are CPU seconds on one core, so that other load on the machine changes them little.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.integrate import solve_ivp

from ..biology.network import HillNetwork
from ..biology.rules import Rule, RuleFactor
from ..biology.wiring import Wiring
from ..numerics.ode import Accuracy, integrate_ode
from .measurement import Measurement, best_of, printed_on_one_core

N_SPECIES, N_INPUTS, N_SETS = 100, 5, 10_000
BATCH_SIZE = 250  # parameter sets integrated with common time steps; divides N_SETS
SCIPY_SETS, RUNNER_SETS = 20, 20
POINTS = 1_000_000
DURATION = 24.0 * 3600.0  # s
ACCURACY = Accuracy(1e-5, 1e-8, "explicit")
HOUR = 3600.0
START = 0.1  # initial activity of every species


class Sets(NamedTuple):
    """Parameter sets of one network; the reactions are the same in all sets."""

    tau: np.ndarray
    """Time constants (n, n_species) [s]."""
    weight: np.ndarray
    """Reaction weights (n, n_reactions) [1]."""
    ec50: np.ndarray
    """Half-maximal activities (n, n_reactions) [1]."""


def networks() -> Iterator[Measurement]:
    """Measure CPU times for a network of 100 species, in a separate process pinned to one core."""
    return printed_on_one_core("-m", __name__)


def measured() -> Iterator[Measurement]:
    """Measure cicatrix, SciPy and libroadrunner in this process."""
    law, sets = network(), parameter_sets(network(), N_SETS)
    n_edges = len(law.wiring.edges[0])
    yield _ceiling(n_edges)
    yield _rate(n_edges)
    ours, row = _ours(law, sets, n_edges)
    yield row
    yield _scipy(law, sets, ours)
    yield _runner(law, sets, ours)


def network() -> HillNetwork:
    """Return a random network of 100 species, each driven by one or two reactions.

    A reaction has one or two source species; a fifth of the links inhibit.
    """
    rng = np.random.Generator(np.random.Philox(1))
    names = [f"s{i}" for i in range(N_SPECIES)]
    rules = [Rule((), name) for name in names[:N_INPUTS]]
    for name in names[N_INPUTS:]:
        for _ in range(rng.integers(1, 3)):
            chosen = rng.choice(names, rng.integers(1, 3), replace=False)
            rules.append(Rule(tuple(RuleFactor(str(one), bool(rng.random() < 0.2)) for one in chosen), name))
    m = len(rules)
    weight = np.where([rule.is_input for rule in rules], 0.5, 1.0)
    tau = HOUR * np.where(rng.random(N_SPECIES) < 0.5, 0.1, 10.0)
    wiring = Wiring(tuple(names), tuple(f"r{i}" for i in range(m)), tuple(rules))
    return HillNetwork(wiring, np.ones(N_SPECIES), tau, weight, np.full(m, 1.4), np.full(m, 0.55))


def parameter_sets(law: HillNetwork, n: int) -> Sets:
    """Draw n parameter sets: time constants vary by up to 30 %, weights and EC50 are reduced by up to 30 %."""
    rng = np.random.Generator(np.random.Philox(2))
    return Sets(
        law.tau * rng.uniform(0.7, 1.3, (n, law.tau.size)),
        law.weight * rng.uniform(0.7, 1.0, (n, law.weight.size)),
        law.ec50 * rng.uniform(0.7, 1.0, (n, law.ec50.size)),
    )


def _with(law: HillNetwork, sets: Sets) -> HillNetwork:
    return HillNetwork(law.wiring, law.y_max, sets.tau, sets.weight, law.n, sets.ec50)


def _ours(law: HillNetwork, sets: Sets, n_edges: int) -> tuple[np.ndarray, Measurement]:
    """Integrate the network for all parameter sets in one compiled call, in batches of :data:`BATCH_SIZE`."""
    times = jnp.array([0.0, DURATION])

    def some(part: Sets) -> tuple[Array, Array]:
        start = jnp.full((BATCH_SIZE, N_SPECIES), START)
        done = integrate_ode(lambda bound, y, t: bound.rate(y), _with(law, part).under(), start, times, ACCURACY)
        return done.y[-1], done.n_steps

    def every(sets: Sets) -> tuple[Array, Array]:
        return jax.lax.map(some, Sets(*(one.reshape(-1, BATCH_SIZE, one.shape[-1]) for one in sets)))

    begin = time.perf_counter()
    ready = jax.jit(every).lower(sets).compile()
    compiling = time.perf_counter() - begin
    begin = time.process_time()
    y, n_steps = jax.block_until_ready(ready(sets))
    seconds = time.process_time() - begin
    steps = f"about {int(np.mean(n_steps))} explicit steps"
    note = f"{N_SPECIES} species, {n_edges} links, 24 h in {steps}; compiled in {compiling:.1f} s"
    return np.asarray(y).reshape(N_SETS, -1), Measurement("10^4 parameter sets, one call", seconds, "s", note)


def _rate(n_edges: int) -> Measurement:
    """Measure one evaluation of the rate law at many points, as in the continuum model."""
    law, n = network(), POINTS // N_SPECIES
    y = jax.device_put(np.random.Generator(np.random.Philox(3)).random((n, N_SPECIES)))
    rate = jax.jit(lambda y: law.rate(y))
    jax.block_until_ready(rate(y))
    seconds = best_of(lambda: jax.block_until_ready(rate(y)), 3, time.process_time)
    return Measurement("rate per point and link", 1e9 * seconds / n / n_edges, "ns", f"{n:g} points of {n_edges} links")


def _ceiling(n_edges: int) -> Measurement:
    """Measure the cost of one power, exp(n log x), which every link needs."""
    x = jax.device_put(np.random.Generator(np.random.Philox(4)).random((n_edges, BATCH_SIZE)))
    power = jax.jit(lambda x: jnp.exp(1.4 * jnp.log(x)))
    jax.block_until_ready(power(x))
    seconds = best_of(lambda: [jax.block_until_ready(power(x)) for _ in range(20)], 5, time.process_time) / 20
    return Measurement("a power alone", 1e9 * seconds / x.size, "ns", "ceiling of a link: exp(n log x)")


def _scipy(law: HillNetwork, sets: Sets, ours: np.ndarray) -> Measurement:
    """Measure SciPy's LSODA solver in a loop over parameter sets, with the rate law in NumPy."""
    worst, begin = 0.0, time.process_time()
    for k in range(SCIPY_SETS):
        rate = numpy_rate(law, Sets(*(one[k] for one in sets)))
        y = solve_ivp(
            rate, (0.0, DURATION), np.full(N_SPECIES, START), "LSODA", rtol=ACCURACY.relative, atol=ACCURACY.absolute
        )
        worst = max(worst, float(np.abs(y.y[:, -1] - ours[k]).max()))
    seconds = (time.process_time() - begin) * N_SETS / SCIPY_SETS
    note = f"peer: LSODA in a loop, extrapolated from {SCIPY_SETS} sets; final states differ by {worst:.1e}"
    return Measurement("SciPy solve_ivp", seconds, "s", note)


def numpy_rate(law: HillNetwork, one: Sets):
    """Return the function dy/dt (n_species,) [1/s] of one parameter set in plain NumPy, from the published equations."""
    species, reaction, is_negated = law.wiring.edges
    half = one.ec50**law.n
    B = (half - 1.0) / (2.0 * half - 1.0)
    lost = np.bincount(reaction, minlength=len(half)).clip(1) - 1  # m - 1

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        x = np.maximum(y[species], 0.0) ** law.n[reaction]
        act = one.weight[reaction] * B[reaction] * x / (B[reaction] - 1.0 + x)
        factors = np.append(np.where(is_negated, 1.0 - act, act), 1.0)[law.wiring.factors_of]
        is_input = law.wiring.factors_of[:, 0] == len(species)
        flow = np.where(is_input, one.weight, factors.prod(axis=1) / one.weight**lost)
        return (law.y_max * (1.0 - np.append(1.0 - flow, 1.0)[law.wiring.reactions_into].prod(axis=1)) - y) / one.tau

    return rate


def _runner(law: HillNetwork, sets: Sets, ours: np.ndarray) -> Measurement:
    """Measure libroadrunner (CVODE, compiled) on the same network in SBML, if it is installed."""
    name = "libroadrunner"
    try:
        import libsbml  # pyright: ignore[reportMissingImports]
        import roadrunner  # pyright: ignore[reportMissingImports]
    except ImportError:
        return Measurement(name, float("nan"), "s", "not installed: pip install libroadrunner python-libsbml")
    runner = roadrunner.RoadRunner(sbml_text(law, libsbml))
    runner.integrator.relative_tolerance = ACCURACY.relative
    # a vector, because a scalar tolerance is multiplied by the state and can become 0 (sys-bio/roadrunner issues 1300, 1349)
    runner.integrator.setValue("absolute_tolerance", [ACCURACY.absolute] * len(law.species))
    worst, spent = 0.0, []
    for k in range(RUNNER_SETS):
        runner.reset()
        for word, values in zip(("tau", "w", "E"), sets):
            for i, value in enumerate(values[k]):
                runner.setValue(f"{word}_{i}", float(value))
        begin = time.process_time()
        try:
            runner.simulate(0.0, DURATION, 2)
        except RuntimeError:
            continue  # CVODE fails on some sets; the note gives the number of sets that it finished
        spent.append(time.process_time() - begin)
        worst = max(worst, float(np.abs(np.array([runner[one] for one in law.species]) - ours[k]).max()))
    note = f"peer: CVODE in a loop, extrapolated from the {len(spent)} of {RUNNER_SETS} sets that it finished"
    seconds = float(np.mean(spent)) * N_SETS if spent else float("nan")
    return Measurement(
        name, seconds, "s", f"{note}; time to set parameters not counted; final states differ by {worst:.1e}"
    )


def sbml_text(law: HillNetwork, libsbml) -> str:
    """Return the network as an SBML document, with a rate rule per species and a parameter per time constant, weight and EC50."""
    document = libsbml.SBMLDocument(3, 1)
    model = document.createModel()
    values = {f"tau_{i}": v for i, v in enumerate(law.tau)} | dict.fromkeys(law.species, START)
    values |= {f"w_{i}": v for i, v in enumerate(law.weight)} | {f"E_{i}": v for i, v in enumerate(law.ec50)}
    for name, value in values.items():
        one = model.createParameter()
        one.setId(name)
        one.setValue(float(value))
        one.setConstant(name not in law.species)
    into: dict[str, list[str]] = {name: [] for name in law.species}
    for r, rule in enumerate(law.wiring.rules):
        into[rule.target].append(_formula(r, rule, float(law.n[r])))
    for i, name in enumerate(law.species):
        rule = model.createRateRule()
        rule.setVariable(name)
        off = " * ".join(f"(1 - {flow})" for flow in into[name]) or "1"
        rule.setMath(libsbml.parseL3Formula(f"((1 - {off}) - {name}) / tau_{i}"))
    return libsbml.writeSBMLToString(document)


def _formula(r: int, rule: Rule, n: float) -> str:
    """Return the flow of a reaction as an SBML formula: the product of its m Hill functions over w^(m-1)."""
    if rule.is_input:
        return f"w_{r}"
    half = f"E_{r}^{n}"
    parts = []
    for factor in rule.factors:
        x = f"piecewise({factor.species}, {factor.species} > 0, 0)^{n}"
        act = f"w_{r} * (1 - {half}) * {x} / ({half} + (1 - 2 * {half}) * {x})"
        parts.append(f"(1 - {act})" if factor.is_negated else f"({act})")
    return f"({' * '.join(parts)} / w_{r}^{len(parts) - 1})"


if __name__ == "__main__":
    for row in measured():
        print(json.dumps(row), flush=True)

"""Benchmark of the automaton: compares the compiled kernel with its NumPy version, a dense stencil, hardware limits and Mesa."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache

import numpy as np

from ..core import native
from ..core.errors import InputError
from ..geometry.hexgrid import Lattice
from ..healing.automaton import NativeCore
from ..healing.reference import ReferenceCore
from ..healing.rules import AutomatonRules
from .measurement import Measurement, best_of

RULES = AutomatonRules(p_edge=0.2, p_layer=0.02, layer_sites=8, motility_substeps=8)
DISCS = ((1000, 300), (3200, 960), (10_000, 3000))  # sites along an axis, radius in sites
BALLS = ((160, 50), (450, 150))
W = np.zeros(1)


def automaton() -> Iterator[Measurement]:
    """Measure the automaton's time per step [ms] and time to closure [s], and the same for other programs and hardware limits.

    Raises
    ------
    InputError
        If the compiled module is missing or switched off.
    """
    if not native.is_native:
        raise InputError("the compiled module is missing or off (CICATRIX_NATIVE = 0), so there is no speed to measure")
    yield from _ceilings()
    for n, radius in DISCS:
        yield from _size((n, n), radius)
    for n, radius in BALLS:
        yield from _size((n, n, n), radius, close=radius <= 50)
    yield from _peers()


def compiled(shape: tuple[int, ...], radius_sites: float, threads: int = 1, isa: str = "") -> NativeCore:
    """Return the compiled automaton before its first step, on a lattice of given shape with an open disc or ball."""
    lattice, occupancy = _fresh(shape, radius_sites)
    fillable = np.broadcast_to(np.ones(shape[-1], bool), shape)
    return NativeCore(lattice, fillable, occupancy, RULES, 1, 0, threads=threads, isa=isa)


def _fresh(shape: tuple[int, ...], radius_sites: float) -> tuple[Lattice, np.ndarray]:
    lattice = Lattice(shape, 1.0, (0.0,) * len(shape))
    return lattice, ~lattice.near_middle(radius_sites)


def ms_per_cycle(core: NativeCore, n_steps: int) -> float:
    """Return the mean time per step [ms], measured after two warm-up steps."""
    core.advance(2, W, 1.0)
    start = time.perf_counter()
    core.advance(n_steps, W, 1.0)
    return 1e3 * (time.perf_counter() - start) / n_steps


def _size(shape: tuple[int, ...], radius: int, close: bool = True) -> list[Measurement]:
    """Measure one lattice: time per step with one and two threads, memory, lower bound of the time, and time to closure."""
    name = f"{np.prod(shape, dtype=float):.3g} sites, radius {radius}"
    n_steps = 30 if len(shape) == 2 else 3
    core = compiled(shape, radius)
    one = ms_per_cycle(core, n_steps)
    two = ms_per_cycle(compiled(shape, radius, threads=2), n_steps)
    rows = [
        Measurement(name, one, "ms", "per cycle of the fresh wound, 1 thread"),
        Measurement(name, two, "ms", f"per cycle, 2 threads: {one / two:.2f} times as fast"),
        Measurement(name, core.work["bytes"] * 1e-6, "MB", "allocated by the automaton"),
        Measurement(
            name,
            floor_ms(core.work),
            "ms",
            "lower bound: random words at the generator's speed, densities read and written once",
        ),
    ]
    if shape == (DISCS[1][0],) * 2:
        for isa in native.instruction_sets()[:-1]:
            rows.append(
                Measurement(name, ms_per_cycle(compiled(shape, radius, isa=isa), 10), "ms", f"per cycle, {isa}")
            )
    if close:
        rows.append(Measurement(name, seconds_to_closure(compiled(shape, radius)), "s", "to closure, 1 thread"))
    return rows


def seconds_to_closure(core: NativeCore) -> float:
    """Run the automaton until no site is open; return the computing time [s]."""
    start = time.perf_counter()
    while core.n_open:
        core.advance(1, W, 1.0)
    return time.perf_counter() - start


def floor_ms(work: dict[str, int]) -> float:
    """Return a lower bound on the time of a step [ms].

    The bound is the time to draw the random words and to read and write the densities once. A call of the generator gives
    four words; for cells that need one word, four share a call.
    """
    calls = work["edge_cells"] + (2 * work["layer_cells"] + work["shore_sites"]) / 4
    return 1e3 * (calls * _seconds_per_call() + 4 * work["mixed_sites"] / _triad_bytes_per_second())


@cache
def _seconds_per_call(n: int = 1 << 18) -> float:
    """Return the time per call of the compiled random generator in a large batch [s]."""
    counter = np.zeros((n, 4), np.uint32)
    counter[:, 0] = np.arange(n)
    key = np.zeros(2, np.uint32)
    return best_of(lambda: native.philox4x32(counter, key), 3) / n


@cache
def _triad_bytes_per_second(n: int = 20_000_000) -> float:
    """Measure the memory bandwidth [bytes/s] with a = b + c on arrays larger than the caches."""
    a, b, c = np.empty(n), np.ones(n), np.ones(n)
    return 3 * 8 * n / best_of(lambda: np.add(b, c, out=a), 5)


def _ceilings() -> Iterator[Measurement]:
    yield Measurement("memory, a = b + c", _triad_bytes_per_second() * 1e-9, "GB/s", "ceiling")
    yield Measurement("random words", 4e-6 / _seconds_per_call(), "M/s", "ceiling; called through NumPy arrays")


def _peers() -> Iterator[Measurement]:
    n, radius = DISCS[1]
    one = ms_per_cycle(compiled((n, n), radius), 10)
    reference = _reference_ms(n, radius)
    yield Measurement(
        "NumPy reference implementation, 1.02e+07 sites",
        reference,
        "ms",
        f"per cycle: the compiled automaton is {reference / one:.0f} times as fast",
    )
    dense = _dense_ms(n)
    yield Measurement(
        "dense stencil (XLA), same lattice", dense, "ms", "8 sub-steps of the diffusion only, on every site"
    )
    mesa = _mesa_seconds(100, 30)
    if mesa is None:
        yield Measurement("Mesa", float("nan"), "s", "not installed: pip install mesa")
        return
    edge = _edge_only_seconds(100, 30)
    note = f"10 steps of edge division only; the automaton needs 1/{mesa / edge:.0f} of this for 10 full steps"
    yield Measurement("Mesa, 1e+04 sites, radius 30", mesa, "s", note)


def _reference_ms(n: int, radius: int) -> float:
    lattice, occupancy = _fresh((n, n), radius)
    reference = ReferenceCore(lattice, np.ones((n, n), bool), occupancy, RULES, 1, 0)
    start = time.perf_counter()
    reference.advance(2, W, 1.0)
    return 1e3 * (time.perf_counter() - start) / 2


def _dense_ms(n: int) -> float:
    """Return the time of one step's diffusion sub-steps on the whole lattice, compiled by XLA [ms].

    The lattice is periodic here, which does not change the cost.
    """
    import jax
    import jax.numpy as jnp

    offsets = Lattice((1, 1), 1.0, (0.0, 0.0)).neighbours.tolist()

    @jax.jit
    def sub_steps(u: jax.Array) -> jax.Array:
        for _ in range(RULES.motility_substeps):
            around = sum(jnp.roll(u, (-i, -j), (0, 1)) for i, j in offsets)
            u = (2 * u + around + 4) >> 3
        return u

    u = jnp.zeros((n, n), jnp.uint16)
    sub_steps(u).block_until_ready()
    return 1e3 * best_of(lambda: sub_steps(u).block_until_ready(), 3)


def _edge_only_seconds(n: int, radius: int) -> float:
    """Return the time of ten full steps of the compiled automaton on the lattice used for Mesa [s]."""
    core = compiled((n, n), radius)
    start = time.perf_counter()
    core.advance(10, W, 1.0)
    return time.perf_counter() - start


def _mesa_seconds(n: int, radius: int) -> float | None:
    """Return the time [s] of ten steps of a Mesa model of edge division; None if Mesa is not installed.

    Cells next to empty sites of a hexagonal grid divide into one of them with probability ``p_edge``.
    """
    try:
        import mesa  # pyright: ignore[reportMissingImports]
        from mesa.discrete_space import CellAgent, HexGrid  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None

    class MesaModel(mesa.Model):
        def __init__(self) -> None:
            super().__init__(seed=1)
            self.grid = HexGrid((n, n), capacity=1, random=self.random)
            for cell in self.grid.all_cells:
                x, y = cell.coordinate
                if (x - n / 2) ** 2 + (y - n / 2) ** 2 >= radius**2:
                    MesaCell(self).cell = cell

        def step(self) -> None:
            self.agents.do("divide")

    class MesaCell(CellAgent):
        def divide(self) -> None:
            free = [cell for cell in self.cell.neighborhood.cells if cell.is_empty]
            if free and self.random.random() < RULES.p_edge:
                MesaCell(self.model).cell = self.random.choice(free)

    model = MesaModel()
    start = time.perf_counter()
    for _ in range(10):
        model.step()
    return time.perf_counter() - start

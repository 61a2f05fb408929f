"""Benchmark of material laws: time per point for stress and consistent tangent, compared with NumPy and jaxmat.

All times are CPU seconds on one core, so that other load on the machine changes them little.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator

import jax
import numpy as np
from jax import Array

from ..materials.active import ActiveFibres, Contraction
from ..materials.chunked import chunked
from ..materials.constituent import Constituent
from ..materials.exponential import Exponential
from ..materials.external import Answer, ExternalMaterial
from ..materials.fibres import FibreDistribution, FibreViscosity
from ..materials.growing import AreaGrowth, FibreGrowth, Growing
from ..materials.holzapfel import HolzapfelGasserOgden
from ..materials.ligaments import Ligaments
from ..materials.locking_skin import LockingSkin
from ..materials.material import EnergyMaterial, Material
from ..materials.may_newman import MayNewman
from ..materials.mixture import ConstrainedMixture
from ..materials.mooney_rivlin import MooneyRivlin
from ..materials.neo_hookean import NeoHookean
from ..materials.ogden import Ogden
from ..materials.orientation import VonMises
from ..materials.viscoelastic import Viscoelastic
from ..materials.waviness import Uniform
from ..numerics.compiler import COMPILER
from .measurement import Measurement, best_of, printed_on_one_core

N_CHEAP, N_COSTLY = 1_000_000, 100_000  # number of points for a cheap law and for a costly one
CHUNK_SIZE = 1000  # points per chunk; divides both
DT = 1.0  # s: time step of laws with history
STRAIN = 0.1  # amplitude of the random deformation gradients
MU, KAPPA = 2.0, 20.0  # kPa
NOTES = {
    "neo-hookean": "aim 1000",
    "fibre-distribution": "40 directions, uniform waviness; aim 5000",
    "viscous fibres": "40 directions by 6 of waviness: 240 branches",
    "growth along fibres": "40 directions",
}


def measured_laws() -> dict[str, tuple[EnergyMaterial, int]]:
    """Return the measured laws by name, each with its number of points: laws of case files, then some with viscosity or growth.

    The laws are created here and not at import, because some constructors run JAX code, which starts JAX's backend.
    """
    tissue, plane, wavy = NeoHookean(MU, KAPPA), VonMises(2.0), Uniform(1.0, 1.4)
    fibres = FibreDistribution(5.0, plane, wavy)
    return {
        "neo-hookean": (tissue, N_CHEAP),
        "exponential": (Exponential(MU, 2.0, KAPPA), N_CHEAP),
        "mooney-rivlin": (MooneyRivlin(1.0, 0.5, KAPPA), N_CHEAP),
        "ogden": (Ogden(MU, 4.0, KAPPA), N_COSTLY),
        "locking-skin": (LockingSkin(MU, 43.0, 8.0, 1.05, kappa=KAPPA), N_COSTLY),
        "holzapfel-gasser-ogden": (HolzapfelGasserOgden(MU, 1.5, 0.5, 0.1, np.pi / 6, KAPPA), N_CHEAP),
        "may-newman": (MayNewman(0.5, 0.1, 0.2, 0.0, KAPPA), N_CHEAP),
        "fibre-distribution": (fibres, N_CHEAP),
        "ligaments": (Ligaments(0.01, 40.0, 1.05), N_CHEAP),
        "active-fibres": (ActiveFibres(0.4, plane), N_CHEAP),
        "contraction": (Contraction(0.4), N_CHEAP),
        "constrained-mixture": (
            ConstrainedMixture(
                (Constituent(NeoHookean(2.0), 0.6), Constituent(NeoHookean(4.0), 0.3, 1e4)), kappa=KAPPA
            ),
            N_COSTLY,
        ),
        "viscous fibres": (FibreDistribution(5.0, plane, wavy, FibreViscosity(0.5, 10.0)), N_COSTLY // 10),
        "Prony, two branches": (Viscoelastic(tissue, (0.5, 0.2), (1.0, 10.0)), N_COSTLY),
        "growth of an area": (Growing(tissue, AreaGrowth(3600.0)), N_COSTLY),
        "growth along fibres": (Growing(tissue, FibreGrowth(3600.0, None, plane)), N_COSTLY),
    }


def laws() -> Iterator[Measurement]:
    """Measure the time per point [ns] for stress P and tangent of every law, in a separate process pinned to one core."""
    return printed_on_one_core("-m", __name__)


def measured() -> Iterator[Measurement]:
    """Measure all laws, NumPy and jaxmat in this process."""
    yield Measurement("P and tangent written out", _write_ns(), "ns", "ceiling: writing 720 bytes per point")
    for name, (law, n) in measured_laws().items():
        yield _row(name, law, n)
    F = gradients(N_COSTLY)
    yield Measurement(
        "NumPy neo-Hookean",
        1e9 * best_of(lambda: _in_numpy(F), 3, time.process_time) / N_COSTLY,
        "ns",
        f"closed form; {N_COSTLY:g}",
    )
    yield _row("the same as an ExternalMaterial", ExternalMaterial(_outside), N_COSTLY)
    yield _jaxmat(F)


def gradients(n: int) -> np.ndarray:
    """Return n random deformation gradients near the identity: (n, 3, 3) [1]."""
    return np.eye(3) + STRAIN * np.random.Generator(np.random.Philox(1)).uniform(-1.0, 1.0, (n, 3, 3))


def closed_form(F: np.ndarray, mu: float = MU, kappa: float = KAPPA) -> tuple[np.ndarray, np.ndarray]:
    """Return P and dP/dF of the neo-Hookean law in closed form, in NumPy: F (n, 3, 3) -> (n, 3, 3), (n, 3, 3, 3, 3) [kPa]."""
    J, H = np.linalg.det(F)[:, None, None], np.linalg.inv(F).swapaxes(1, 2)
    I1, j = (F * F).sum(axis=(1, 2))[:, None, None], J ** (-2.0 / 3.0)
    P = mu * j * (F - I1 / 3.0 * H) + kappa * (J - 1.0) * J * H
    H_i, FH = H[:, :, :, None, None], F[:, :, :, None, None] * H[:, None, None]
    both = H_i * H[:, None, None]
    crossed = H[:, :, None, None, :] * H.swapaxes(1, 2)[:, None, :, :, None]
    j, I1, J = j[..., None, None], I1[..., None, None], J[..., None, None]
    unit = np.eye(3)[:, None, :, None] * np.eye(3)[None, :, None, :]
    shape = unit - 2.0 / 3.0 * (FH + H_i * F[:, None, None]) + I1 * (2.0 / 9.0 * both + crossed / 3.0)
    return P, mu * j * shape + kappa * J * ((2.0 * J - 1.0) * both - (J - 1.0) * crossed)


def _outside(F: np.ndarray, state: np.ndarray, dt: float) -> Answer:
    """Evaluate ``closed_form`` with the interface of an external material's ``respond`` function, without the energy."""
    return Answer(np.zeros(len(F)), *closed_form(F))


def _row(name: str, law: Material, n: int) -> Measurement:
    F, state = jax.device_put(gradients(n)), law.initial_state((n,))
    ns, compiling = _timed(
        lambda law, F, state: chunked(lambda p: law.response(*p, DT), (F, state), CHUNK_SIZE), law, F, state
    )
    note = NOTES.get(name, "")
    return Measurement(
        name, ns / n, "ns", f"{note + '; ' if note else ''}{n:g} points; compiled once in {compiling:.1f} s"
    )


def _timed(work: Callable, *arguments) -> tuple[float, float]:
    """Compile a function; return the time of one call [ns] and the time to compile it [s]."""
    start = time.perf_counter()
    ready = jax.jit(work).lower(*arguments).compile(COMPILER)
    compiling = time.perf_counter() - start
    return 1e9 * best_of(lambda: jax.block_until_ready(ready(*arguments)), 2, time.process_time), compiling


def _in_numpy(F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    P, A = np.empty_like(F), np.empty((*F.shape, 3, 3))
    for start in range(0, len(F), CHUNK_SIZE):
        here = slice(start, start + CHUNK_SIZE)
        P[here], A[here] = closed_form(F[here])
    return P, A


def _write_ns() -> float:
    answers = np.empty((N_COSTLY, 90))
    return 1e9 * best_of(lambda: answers.fill(1.0), 5, time.process_time) / N_COSTLY


def _jaxmat(F: np.ndarray) -> Measurement:
    """Measure the neo-Hookean law of jaxmat with the derivatives that jaxmat computes.

    jaxmat is under LGPL 3, so it is not a dependency of cicatrix; only this benchmark uses it, if it is installed.
    """
    name = "jaxmat, neo-Hookean"
    try:
        from jaxmat.materials import hyperelasticity as theirs  # pyright: ignore[reportMissingImports]
        from jaxmat.tensors import Tensor2  # pyright: ignore[reportMissingImports]
    except ImportError:
        return Measurement(name, float("nan"), "ns", "not installed: pip install jaxmat (LGPL 3)")
    law = theirs.CompressibleNeoHookean(MU, KAPPA, theirs.SquaredVolumetric())

    def one(f: Array) -> tuple[Array, Array]:
        def stress(g: Array) -> tuple[Array, Array]:
            P = law.PK1(Tensor2(tensor=g)).tensor
            return P, P

        A, P = jax.jacfwd(stress, has_aux=True)(f)
        return P, A

    ns, compiling = _timed(lambda F: chunked(jax.vmap(one), F, CHUNK_SIZE), jax.device_put(F))
    return Measurement(
        name, ns / len(F), "ns", f"its energy, jacfwd, vmap; {len(F):g} points; {compiling:.1f} s to compile"
    )


if __name__ == "__main__":
    for row in measured():
        print(json.dumps(row), flush=True)

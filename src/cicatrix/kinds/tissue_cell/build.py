"""From a case of kind "tissue-cell" to its chain, its start and its loading."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...biology.adhesion import Adhesion, anchored
from ...biology.chain import Chain, Felt
from ...biology.moreo import Moreo
from ...biology.network import HillNetwork
from ...biology.signals import NetworkSignal, Signal, StrainSignal, TractionSignal
from ...cases.adhesion_laws import adhesion_of
from ...cases.laws import law_of
from ...cases.signals import NetworkSignalTable, TractionTable
from ...core.errors import InputError
from ...core.units import seconds_from_hours
from ...materials.material import EnergyMaterial
from ...numerics.compiler import COMPILER
from ...numerics.ode import Accuracy, Course, course
from .case import TissueCellCase

NEXT = 1e-3  # of the elastic stretch: as near to its end as a solver comes
CHUNK = 10  # rows between two of which the solver starts anew, so that a run can be stopped there


class Model(NamedTuple):
    """A chain and what it is led by."""

    chain: Chain
    law: EnergyMaterial
    start: np.ndarray
    """(n_states,)."""
    times: np.ndarray
    """Of the rows (n_rows + 1,) [s]."""
    corners: np.ndarray
    """(n, 2): time [s] and stretch [1]."""
    notes: tuple[str, ...]

    def stretch(self, time: np.ndarray) -> np.ndarray:
        """Lambda (...) [1] at times (...) [s]."""
        return np.interp(time, *self.corners.T)


def model_of(case: TissueCellCase, network: tuple[HillNetwork, np.ndarray] | None) -> Model:
    """Put the parts together; a network comes with its start (n_species,).

    Raises
    ------
    InputError
        If feedback or substrate do not hold at a stretch of the loading, or the network has no such input or output.
    """
    stretches = case.loading.stretch
    substrate = case.substrate.model_copy(update={"stretch": tuple(sorted({1.0, *stretches}))})
    law = law_of(case)
    adhesion, notes = adhesion_of(case.bond, substrate, case.cell, law, stretches="loading.stretch")
    chain = Chain(adhesion, _signal(case, network), case.turnover.build(), case.growth_density)
    first, scale = case.start, case.scale
    rho = 1.0 if first.rho_per_mm3 is None else first.rho_per_mm3 / scale.rho_phys_per_mm3
    own = [1.0, rho, first.c_g_per_mm3 / scale.c_max_g_per_mm3, first.m_f, first.bound_fraction]
    start = np.concatenate([own, network[1] if network else []])
    corners = np.column_stack([seconds_from_hours(np.array(case.loading.time_h)), stretches])
    times = np.linspace(corners[0, 0], corners[-1, 0], case.loading.n_rows + 1)
    return Model(chain, law, start, times, corners, (*notes, *_at_rest(case, adhesion)))


def _at_rest(case: TissueCellCase, adhesion: Adhesion) -> list[str]:
    """Say so if cells feel tissue that is not stretched."""
    threshold, pulled = getattr(case.signal, "threshold_kPa", np.inf), float(anchored(adhesion, 1.0).traction)
    if pulled <= threshold:
        return []
    so = ": it grows until it is compressed" if isinstance(case.signal, TractionTable) else ""
    return [
        f"Cells feel tissue that is not stretched{so}; they pull with {pulled:.4g} kPa there, above signal.threshold_kPa = "
        f"{threshold:g}."
    ]


def _signal(case: TissueCellCase, network: tuple[HillNetwork, np.ndarray] | None) -> Signal:
    table = case.signal
    if isinstance(table, TractionTable):
        return TractionSignal(table.K_kPa, table.threshold_kPa)
    if isinstance(table, NetworkSignalTable):
        if network is None:
            raise InputError("signal.species and signal.reactions must be read first")
        traction = TractionSignal(table.K_kPa, table.threshold_kPa)
        try:
            return NetworkSignal(network[0], traction, table.input, table.output)
        except InputError as error:
            raise InputError(f"signal.{error}") from None
    cell = Moreo(table.K_pass_kPa, table.K_act_kPa, table.p_max_kPa, table.theta_1, table.theta_2)
    return StrainSignal(cell, table.K_kPa)


@eqx.filter_jit
def follow(chain: Chain, corners: Array, start: Array, times: Array, accuracy: Accuracy) -> Course:
    """Lead states (n_states,) through times (n_times,) [s] under stretches between corners (n, 2); differentiable."""

    def rate(led: tuple[Chain, Array], y: Array, t: Array) -> Array:
        chain, corners = led
        return chain.rate(y, jnp.interp(t, corners[:, 0], corners[:, 1]))

    return course(rate, (chain, corners), start, times, accuracy)


def accuracy_of(case: TissueCellCase) -> Accuracy:
    """How exactly to follow it: bonds are followed in seconds, tissue in weeks, so the method is the implicit one."""
    return Accuracy(case.solver.relative_tolerance, case.solver.absolute_tolerance, "implicit", case.solver.max_steps)


def felt(model: Model, y: np.ndarray, time: np.ndarray) -> Felt:
    """What cells feel in states (n, n_states) at times (n,) [s]: arrays (n,)."""
    return Felt(*map(np.asarray, _felt(model.chain, y, model.stretch(time))))


def is_borne(model: Model, elastic: float) -> bool:
    """Whether cells pull with a finite force, and bonds open at a finite rate, at an elastic stretch [1] and next to it."""
    at = anchored(model.chain.adhesion, elastic * np.array([1.0 - NEXT, 1.0, 1.0 + NEXT]))
    return bool(np.isfinite(at.force).all() and np.isfinite(at.k_off).all())


def passive_stress(law: EnergyMaterial, elastic: np.ndarray) -> np.ndarray:
    """Cauchy stress along x [kPa] of incompressible tissue under equal elastic stretches (n,) [1] in the plane."""
    return np.asarray(_passive(law, elastic))


_felt = jax.jit(lambda chain, y, stretch: chain.felt(y, stretch), compiler_options=COMPILER)


@jax.jit
def _passive(law: EnergyMaterial, elastic: Array) -> Array:
    thin = elastic**-2
    F = jax.vmap(jnp.diag)(jnp.stack([elastic, elastic, thin], axis=-1))
    P = law.stress(F, law.initial_state(elastic.shape))
    return P[:, 0, 0] * elastic - P[:, 2, 2] * thin

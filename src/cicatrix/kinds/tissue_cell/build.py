"""Build the model of a case of kind "tissue-cell": bonds, cells and growth, with initial state and loading."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...biology.adhesion import Adhesion, steady_state
from ...biology.mechanobiology import MechanicalStimulus, MechanobiologyModel
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
from ...numerics.ode import Accuracy, Solution, integrate_ode
from .case import TissueCellCase

NEXT = 1e-3  # relative change of the elastic stretch, on either side of a state, at which the adhesion must have a solution
CHUNK = 10  # rows after which the solver restarts, so that a run can be resumed there


class TissueCellModel(NamedTuple):
    """Model of growing tissue with its initial state and its loading."""

    mechanobiology: MechanobiologyModel
    law: EnergyMaterial
    start: np.ndarray
    """Initial state (n_states,)."""
    times: np.ndarray
    """Times of the rows (n_rows + 1,) [s]."""
    corners: np.ndarray
    """Loading (n, 2): time [s] and stretch [1], linear between."""
    notes: tuple[str, ...]

    def stretch(self, time: np.ndarray) -> np.ndarray:
        """Return the stretch lambda (...) [1] at times (...) [s]."""
        return np.interp(time, *self.corners.T)


def model_of(case: TissueCellCase, network: tuple[HillNetwork, np.ndarray] | None) -> TissueCellModel:
    """Build the model of a case; ``network`` is a network and its initial activities (n_species,).

    Raises
    ------
    InputError
        If feedback or substrate are not defined at a stretch of the loading, or the network lacks the input or output named.
    """
    stretches = case.loading.stretch
    substrate = case.substrate.model_copy(update={"stretch": tuple(sorted({1.0, *stretches}))})
    law = law_of(case)
    adhesion, notes = adhesion_of(case.bond, substrate, case.cell, law, stretches="loading.stretch")
    mechanobiology = MechanobiologyModel(adhesion, _signal(case, network), case.turnover.build(), case.growth_density)
    first, scale = case.start, case.scale
    rho = 1.0 if first.rho_per_mm3 is None else first.rho_per_mm3 / scale.rho_phys_per_mm3
    own = [1.0, rho, first.c_g_per_mm3 / scale.c_max_g_per_mm3, first.m_f, first.bound_fraction]
    start = np.concatenate([own, network[1] if network else []])
    corners = np.column_stack([seconds_from_hours(np.array(case.loading.time_h)), stretches])
    times = np.linspace(corners[0, 0], corners[-1, 0], case.loading.n_rows + 1)
    return TissueCellModel(mechanobiology, law, start, times, corners, (*notes, *_at_rest(case, adhesion)))


def _at_rest(case: TissueCellCase, adhesion: Adhesion) -> list[str]:
    """Return a note if the traction of cells in unstretched tissue exceeds the threshold of their signal."""
    threshold, pulled = getattr(case.signal, "threshold_kPa", np.inf), float(steady_state(adhesion, 1.0).traction)
    if pulled <= threshold:
        return []
    so = ": it grows until it is compressed" if isinstance(case.signal, TractionTable) else ""
    return [
        f"Cells sense tissue that is not stretched{so}; their traction there is {pulled:.4g} kPa, above "
        f"signal.threshold_kPa = {threshold:g}."
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
def integrate(
    mechanobiology: MechanobiologyModel, corners: Array, start: Array, times: Array, accuracy: Accuracy
) -> Solution:
    """Integrate the state (n_states,) over times (n_times,) [s] under a stretch linear between corners (n, 2); differentiable."""

    def rate(parameters: tuple[MechanobiologyModel, Array], y: Array, t: Array) -> Array:
        mechanobiology, corners = parameters
        return mechanobiology.rate(y, jnp.interp(t, corners[:, 0], corners[:, 1]))

    return integrate_ode(rate, (mechanobiology, corners), start, times, accuracy)


def accuracy_of(case: TissueCellCase) -> Accuracy:
    """Return the tolerances of time integration; it is implicit, as bonds change in seconds and tissue in weeks."""
    return Accuracy(case.solver.relative_tolerance, case.solver.absolute_tolerance, "implicit", case.solver.max_steps)


def stimulus(model: TissueCellModel, y: np.ndarray, time: np.ndarray) -> MechanicalStimulus:
    """Compute elastic stretch, bond force, traction and signal in states (n, n_states) at times (n,) [s]: arrays (n,)."""
    return MechanicalStimulus(*map(np.asarray, _stimulus(model.mechanobiology, y, model.stretch(time))))


def adhesion_is_finite(model: TissueCellModel, elastic: float) -> bool:
    """Return whether the bonds' force and rate of opening are finite at an elastic stretch [1] and 0.1 % to either side."""
    at = steady_state(model.mechanobiology.adhesion, elastic * np.array([1.0 - NEXT, 1.0, 1.0 + NEXT]))
    return bool(np.isfinite(at.force).all() and np.isfinite(at.k_off).all())


def passive_stress(law: EnergyMaterial, elastic: np.ndarray) -> np.ndarray:
    """Return the Cauchy stress along x (n,) [kPa] of incompressible tissue under equal elastic stretches (n,) in the plane."""
    return np.asarray(_passive(law, elastic))


_stimulus = jax.jit(lambda mechanobiology, y, stretch: mechanobiology.stimulus(y, stretch), compiler_options=COMPILER)


@jax.jit
def _passive(law: EnergyMaterial, elastic: Array) -> Array:
    thin = elastic**-2
    F = jax.vmap(jnp.diag)(jnp.stack([elastic, elastic, thin], axis=-1))
    P = law.stress(F, law.initial_state(elastic.shape))
    return P[:, 0, 0] * elastic - P[:, 2, 2] * thin

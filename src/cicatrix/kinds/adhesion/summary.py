"""Outcome of a case of kind "adhesion": each number with its unit and a note."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from ...biology.adhesion import Adhesion, AdhesionState, steady_state
from ...biology.cluster import critical_load, shared
from ...biology.contraction import ConstantForce
from ...cases.adhesion_laws import is_viscoelastic
from .bonds import MeanFieldBonds, steps_of_rows
from .build import clutch_substrate
from .case import AdhesionCase

OutcomeEntry = tuple[Any, str, str]


def summary(case: AdhesionCase, law: Adhesion, history: Mapping[str, np.ndarray]) -> dict[str, OutcomeEntry]:
    """Return value, unit and note of each outcome by name; lists are in the order of ``substrate.stretch``."""
    if case.cell.clutch is not None:
        return _clutched(case, law, history)
    stretch = np.array(case.substrate.stretch)
    at = steady_state(law, stretch, case.method.duration_s)
    when = (
        f"at rates after {case.method.duration_s:g} s, as the substrate creeps"
        if is_viscoelastic(case.substrate)
        else "per stretch"
    )
    outcome: dict[str, OutcomeEntry] = {
        "stretch": (stretch.tolist(), "1", "of the substrate before the cell pulls"),
        "steady_bound_fraction": (_list(at.steady), "1", f"k_on / (k_on + k_off), {when}"),
        "steady_traction_kPa": (_list(at.traction), "kPa", f"f phi rho_i, {when}"),
        "force_pN": (_list(at.force), "pN", f"of one bond, {when}"),
        "stiffness_pN_um": (_list(at.stiffness), "pN/um", f"effective one of the substrate, {when}"),
        "energy_pN_um": (_list(at.energy), "pN um", f"energy at a bond ({case.bond.energy}), {when}"),
        "k_off_per_s": (_list(at.k_off), "1/s", when),
        "mean_steady_bound_fraction": (float(np.mean(at.steady)), "1", "over the stretches"),
    }
    if len(stretch) > 1:
        outcome |= _over_stretches(at.steady, at.traction)
    if case.cluster is not None:
        outcome |= _cluster(case, law, at)
    if case.method.type != "ode":
        outcome |= _sampled(case, law, at, history)
    return outcome


def mean_course(case: AdhesionCase, law: Adhesion) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean-field solution of Eq. (24) for a case of single bonds: times (r,) [s], bound fraction (r, s) [1]."""
    mean = MeanFieldBonds(case, law)
    bound = [mean.start()]
    for row in range(1, len(mean.times)):
        bound.append(mean.advance(bound[-1], row))
    return mean.times, np.array(bound)


def _clutched(case: AdhesionCase, law: Adhesion, history: Mapping[str, np.ndarray]) -> dict[str, OutcomeEntry]:
    """Return means over the second half of the rows, as the model of motors and clutches has no closed-form steady state."""
    stretch = np.array(case.substrate.stretch)
    late = {
        name: values.reshape(-1, len(stretch))[len(values) // len(stretch) // 2 :] for name, values in history.items()
    }
    bound, traction = late["bound_fraction"].mean(axis=0), late["traction_kPa"].mean(axis=0)
    total, flow = late["cell_force_pN"].mean(axis=0), late["flow_um_per_s"].mean(axis=0)
    substrate, when = clutch_substrate(law, stretch), "mean over cells and the second half of the rows"
    outcome: dict[str, OutcomeEntry] = {
        "stretch": (stretch.tolist(), "1", "of the substrate before the cell pulls"),
        "steady_bound_fraction": (_list(bound), "1", when),
        "steady_traction_kPa": (_list(traction), "kPa", when),
        "force_pN": (_list(late["force_pN"].mean(axis=0)), "pN", f"of one closed clutch, {when}"),
        "cell_force_pN": (_list(total), "pN", f"of all clutches, {when}"),
        "flow_um_per_s": (_list(flow), "um/s", f"of actin, {when}"),
        "stiffness_pN_um": (_list(substrate.long + substrate.added), "pN/um", "initial stiffness of the substrate"),
        "mean_steady_bound_fraction": (float(np.mean(bound)), "1", "over the stretches"),
    }
    return outcome | (_over_stretches(bound, traction) if len(stretch) > 1 else {})


def _cluster(case: AdhesionCase, law: Adhesion, at: AdhesionState) -> dict[str, OutcomeEntry]:
    """Compute mean lifetime and critical force of bonds that share their load, each with its own piece of substrate."""
    asked, stretch = case.cluster, np.array(case.substrate.stretch)[:, None]

    def k_off(force: Array) -> Array:
        sharing = Adhesion(law.bond, law.substrate, ConstantForce(force), law.density, law.energy)
        return steady_state(sharing, stretch + jnp.zeros_like(force), case.method.duration_s).k_off

    k_on = np.full(len(stretch), float(law.bond.k_on))
    lifetime = np.asarray(shared(asked.bonds, at.force, k_off, k_on, asked.rebinding))
    words = "with rebinding" if asked.rebinding else "without rebinding"
    note = f"mean time until all {asked.bonds} bonds are open, {words}; per stretch; null where it overflows"
    outcome: dict[str, OutcomeEntry] = {
        "cluster_lifetime_s": (_list(lifetime), "s", note),
        "shortest_cluster_lifetime_s": (float(lifetime.min()), "s", f"of {asked.bonds} bonds, over the stretches"),
    }
    if asked.rebinding:
        critical = critical_load(asked.bonds, k_off, k_on)
        note = f"largest force on {asked.bonds} bonds at which their mean number has a steady state; per stretch"
        outcome["critical_force_pN"] = (_list(critical), "pN", note)
        least = f"smallest over the stretches, of {asked.bonds} bonds; the cell pulls at them with up to "
        outcome["least_critical_force_pN"] = (
            float(critical.min()),
            "pN",
            f"{least}{asked.bonds * float(np.max(at.force)):.4g} pN",
        )
    return outcome


def _over_stretches(bound: Any, traction: Any) -> dict[str, OutcomeEntry]:
    spread = float(np.ptp(bound) / np.mean(bound)) if np.max(bound) > 0.0 else float("nan")
    ratio = float(np.max(traction) / np.min(traction)) if np.min(traction) > 0.0 else float("nan")
    return {
        "bound_fraction_spread": (spread, "1", "(largest - smallest) / mean of the steady bound fractions"),
        "traction_ratio": (ratio, "1", "largest / smallest steady traction"),
    }


def _sampled(
    case: AdhesionCase, law: Adhesion, at: AdhesionState, history: Mapping[str, np.ndarray]
) -> dict[str, OutcomeEntry]:
    """Return the outcomes of a case whose bonds are simulated one by one.

    They are the bound fraction averaged over cells and the second half of the history's rows, the number of bonds and, if the
    time step is fixed, the number of steps and the steady state of that scheme.
    """
    n = len(case.substrate.stretch)
    bound = history["bound_fraction"].reshape(-1, n)
    late = bound[len(bound) // 2 :]
    outcome: dict[str, OutcomeEntry] = {
        "sampled_bound_fraction": (late.mean(axis=0).tolist(), "1", "mean over cells and the second half of the rows"),
        "bonds": (
            (case.method.n_integrins or 0) * case.n_cells * n,
            "1",
            f"{case.n_cells} cells on each of {n} stretches",
        ),
    }
    if case.method.dt_s is not None:
        on, off = law.step_probabilities(case.method.dt_s, at.k_off)
        outcome["step_fixed_point"] = (_list(on / (on + off)), "1", "P_on / (P_on + P_off)")
        outcome["steps"] = (int(steps_of_rows(case)[-1]), "1", f"of {case.method.dt_s:g} s")
    return outcome


def _list(values: Any) -> list[float]:
    return np.asarray(values).tolist()

"""The numbers asked for of a case of kind "adhesion": each a value, its unit and a note."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from ...biology.adhesion import Adhesion, Anchorage, anchored
from ...biology.cluster import critical_load, shared
from ...biology.contraction import ConstantForce
from ...cases.adhesion_laws import is_viscoelastic
from .bonds import MeanField, steps_of_rows
from .build import ground_under
from .case import AdhesionCase

Told = tuple[Any, str, str]


def summary(case: AdhesionCase, law: Adhesion, history: Mapping[str, np.ndarray]) -> dict[str, Told]:
    """Value, unit and note by name; lists are in the order of ``substrate.stretch``."""
    if case.cell.clutch is not None:
        return _clutched(case, law, history)
    stretch = np.array(case.substrate.stretch)
    at = anchored(law, stretch, case.method.duration_s)
    when = (
        f"at rates of {case.method.duration_s:g} s, for the substrate yields"
        if is_viscoelastic(case.substrate)
        else "per stretch"
    )
    told: dict[str, Told] = {
        "stretch": (stretch.tolist(), "1", "of the substrate before the cell pulls"),
        "steady_bound_fraction": (_list(at.steady), "1", f"k_on / (k_on + k_off), {when}"),
        "steady_traction_kPa": (_list(at.traction), "kPa", f"f phi rho_i, {when}"),
        "force_pN": (_list(at.force), "pN", f"of one bond, {when}"),
        "stiffness_pN_um": (_list(at.stiffness), "pN/um", f"that the cell feels, {when}"),
        "energy_pN_um": (_list(at.energy), "pN um", f"at a bond, {case.bond.energy}, {when}"),
        "k_off_per_s": (_list(at.k_off), "1/s", when),
        "mean_steady_bound_fraction": (float(np.mean(at.steady)), "1", "over the stretches"),
    }
    if len(stretch) > 1:
        told |= _over_stretches(at.steady, at.traction)
    if case.cluster is not None:
        told |= _cluster(case, law, at)
    if case.method.type != "ode":
        told |= _sampled(case, law, at, history)
    return told


def mean_course(case: AdhesionCase, law: Adhesion) -> tuple[np.ndarray, np.ndarray]:
    """What Eq. (24) says for the times of a case that samples: times (r,) [s], bound fraction (r, s) [1]."""
    mean = MeanField(case, law)
    bound = [mean.start()]
    for row in range(1, len(mean.times)):
        bound.append(mean.onward(bound[-1], row))
    return mean.times, np.array(bound)


def _clutched(case: AdhesionCase, law: Adhesion, history: Mapping[str, np.ndarray]) -> dict[str, Told]:
    """Means of the second half of the rows: motors and clutches have no closed form."""
    stretch = np.array(case.substrate.stretch)
    late = {
        name: values.reshape(-1, len(stretch))[len(values) // len(stretch) // 2 :] for name, values in history.items()
    }
    bound, traction = late["bound_fraction"].mean(axis=0), late["traction_kPa"].mean(axis=0)
    total, flow = late["cell_force_pN"].mean(axis=0), late["flow_um_per_s"].mean(axis=0)
    ground, when = ground_under(law, stretch), "mean over cells and the second half of the rows"
    told: dict[str, Told] = {
        "stretch": (stretch.tolist(), "1", "of the substrate before the cell pulls"),
        "steady_bound_fraction": (_list(bound), "1", when),
        "steady_traction_kPa": (_list(traction), "kPa", when),
        "force_pN": (_list(late["force_pN"].mean(axis=0)), "pN", f"of one closed clutch, {when}"),
        "cell_force_pN": (_list(total), "pN", f"of all clutches, {when}"),
        "flow_um_per_s": (_list(flow), "um/s", f"of actin, {when}"),
        "stiffness_pN_um": (_list(ground.long + ground.added), "pN/um", "of the substrate at first"),
        "mean_steady_bound_fraction": (float(np.mean(bound)), "1", "over the stretches"),
    }
    return told | (_over_stretches(bound, traction) if len(stretch) > 1 else {})


def _cluster(case: AdhesionCase, law: Adhesion, at: Anchorage) -> dict[str, Told]:
    """How long bonds that share their load hold, each with its own piece of substrate."""
    asked, stretch = case.cluster, np.array(case.substrate.stretch)[:, None]

    def k_off(force: Array) -> Array:
        sharing = Adhesion(law.bond, law.substrate, ConstantForce(force), law.density, law.energy)
        return anchored(sharing, stretch + jnp.zeros_like(force), case.method.duration_s).k_off

    k_on = np.full(len(stretch), float(law.bond.k_on))
    lifetime = np.asarray(shared(asked.bonds, at.force, k_off, k_on, asked.rebinding))
    words = "closing again" if asked.rebinding else "none of which closes again"
    note = f"mean until all of {asked.bonds} bonds, {words}, are open; per stretch; null where it is beyond numbers"
    told: dict[str, Told] = {
        "cluster_lifetime_s": (_list(lifetime), "s", note),
        "shortest_cluster_lifetime_s": (float(lifetime.min()), "s", f"of {asked.bonds} bonds, over the stretches"),
    }
    if asked.rebinding:
        critical = critical_load(asked.bonds, k_off, k_on)
        note = f"on {asked.bonds} bonds, beyond which their mean number does not hold; per stretch"
        told["critical_force_pN"] = (_list(critical), "pN", note)
        least = f"that {asked.bonds} bonds hold in the mean, over the stretches; asked of them: up to "
        told["least_critical_force_pN"] = (
            float(critical.min()),
            "pN",
            f"{least}{asked.bonds * float(np.max(at.force)):.4g} pN",
        )
    return told


def _over_stretches(bound: Any, traction: Any) -> dict[str, Told]:
    spread = float(np.ptp(bound) / np.mean(bound)) if np.max(bound) > 0.0 else float("nan")
    ratio = float(np.max(traction) / np.min(traction)) if np.min(traction) > 0.0 else float("nan")
    return {
        "bound_fraction_spread": (spread, "1", "largest less smallest steady one, over their mean"),
        "traction_ratio": (ratio, "1", "largest over smallest steady one"),
    }


def _sampled(case: AdhesionCase, law: Adhesion, at: Anchorage, history: Mapping[str, np.ndarray]) -> dict[str, Told]:
    """What the samples came to in the second half of the rows, and the fixed point that steps have."""
    n = len(case.substrate.stretch)
    bound = history["bound_fraction"].reshape(-1, n)
    late = bound[len(bound) // 2 :]
    told: dict[str, Told] = {
        "sampled_bound_fraction": (late.mean(axis=0).tolist(), "1", "mean over cells and the second half of the rows"),
        "bonds": (
            (case.method.n_integrins or 0) * case.n_cells * n,
            "1",
            f"{case.n_cells} cells on each of {n} stretches",
        ),
    }
    if case.method.dt_s is not None:
        on, off = law.chances(case.method.dt_s, at.k_off)
        told["step_fixed_point"] = (_list(on / (on + off)), "1", "P_on / (P_on + P_off)")
        told["steps"] = (int(steps_of_rows(case)[-1]), "1", f"of {case.method.dt_s:g} s")
    return told


def _list(values: Any) -> list[float]:
    return np.asarray(values).tolist()

"""The numbers asked for of a case of kind "adhesion": each a value, its unit and a note."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..biology.adhesion import Adhesion, Anchorage, anchored
from .adhesion import yields
from .adhesion_case import AdhesionCase
from .adhesion_follow import MeanField, Sampled

Told = tuple[Any, str, str]


def summary(case: AdhesionCase, law: Adhesion, history: Mapping[str, np.ndarray]) -> dict[str, Told]:
    """Value, unit and note by name; lists are in the order of ``substrate.stretch``."""
    stretch = np.array(case.substrate.stretch)
    at = anchored(law, stretch, case.method.duration_s)
    when = f"at rates of {case.method.duration_s:g} s, for the substrate yields" if yields(case) else "per stretch"
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
        told |= _over_stretches(at)
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


def _over_stretches(at: Anchorage) -> dict[str, Told]:
    spread = float(np.ptp(at.steady) / np.mean(at.steady))
    ratio = float(np.max(at.traction) / np.min(at.traction)) if np.min(at.traction) > 0.0 else float("nan")
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
        "bonds": (case.method.n_integrins * case.n_cells * n, "1", f"{case.n_cells} cells on each of {n} stretches"),
    }
    if case.method.dt_s is not None:
        on, off = law.chances(case.method.dt_s, at.k_off)
        told["step_fixed_point"] = (_list(on / (on + off)), "1", "P_on / (P_on + P_off)")
        told["steps"] = (int(Sampled(case, law)._steps[-1]), "1", f"of {case.method.dt_s:g} s")
    return told


def _list(values: Any) -> list[float]:
    return np.asarray(values).tolist()

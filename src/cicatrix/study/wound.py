"""From a case of kind "wound" to its body, its laws and where it is looked at."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..biology.moreo import Moreo
from ..biology.network import HillNetwork
from ..biology.sensing import Sensing
from ..biology.signals import LogisticSignal, NetworkSignal, StrainSignal, TractionSignal, Unfelt
from ..biology.turnover import Turnover
from ..core.errors import InputError
from ..core.units import inner_per_typed, seconds_from_hours
from ..healing.fields import Course, Tolerance, Wound, WoundState
from ..healing.scarring import CollagenGrowth, Contracture, Local, Reorientation, Scarring
from ..healing.transport import Mobility, Transport
from .adhesion import adhesion_of
from .adhesion_case import AdhesionCase, MethodTable
from .wound_body import Place, WoundBody, breast_with_cavity, sheet_with_wound
from .wound_case import AdhesionTable, LogisticTable, MoreoTable, NetworkTable, NoneTable, WoundCase

RESOLVED = 2.0  # elements along sqrt(D/r), below which a front is not resolved


class WoundModel(NamedTuple):
    """A wound and where it is looked at."""

    solver: Wound
    body: WoundBody
    fields: np.ndarray
    """Cells and cytokine at first (n, 2)."""
    local: Local
    notes: tuple[str, ...]

    def start(self, first_step: float) -> Course:
        """The fresh wound; a first step [s]."""
        return self.solver.start(self.fields, self.local, first_step)


def model_of(case: WoundCase, network: tuple[HillNetwork, np.ndarray] | None = None) -> WoundModel:
    """Put the parts together; a network comes with its start (n_species,).

    Raises
    ------
    InputError
        If the adhesion does not hold at rest, or the network has no such input or output.
    """
    body = sheet_with_wound(case.elements or 40) if case.is_sheet else breast_with_cavity(case.elements or 16)
    scarring, sensed = scarring_of(case, network)
    space, X = body.frame.space, body.X
    transport = Transport(space, X, body.held)
    tolerance = case.solver.time_tolerance
    iteration = case.solver.iteration_tolerance or min(0.1 * tolerance, 1e-5)
    solver = Wound(
        *(body.empty_body(), X, np.zeros(3), scarring, mobility_of(case), transport),
        Tolerance(tolerance, iteration),
        case.coupling == "two-way",
    )
    fields, local = _at_first(case, body, transport, sensed)
    return WoundModel(solver, body, fields, local, _fronts(case, transport))


def scarring_of(case: WoundCase, network: tuple[HillNetwork, np.ndarray] | None = None) -> tuple[Scarring, np.ndarray]:
    """What happens at a point, and the states (n_states,) of what cells feel at first."""
    v = case.values
    sensing, sensed = sensing_of(case, network)
    turns = "tau_omega" in v
    law = Scarring(
        turnover_of(case),
        sensing,
        CollagenGrowth(v["growth_density"])
        if "growth_density" in v
        else Contracture(v["tau_P"], v["band_low"], v["band_high"]),
        Reorientation(v["tau_omega"], v["tau_kappa"], v["gamma_kappa"]) if turns else None,
        **{name: v[key] * KPA_PER_MPA for name, key in STIFFNESSES.items()},
        k_2=v["k2"],
        K_t=v["K_t"],
        K_t_c=v["K_t_c"],
        is_sheet=case.is_sheet,
    )
    return law, sensed


def turnover_of(case: WoundCase) -> Turnover:
    """Cells, cytokine and collagen."""
    v = case.values
    per_s = {name: v[key] / seconds_from_hours(1.0) for name, key in RATES.items()}
    return Turnover(**per_s, **{name: v[key] for name, key in RATIOS.items()})


KPA_PER_MPA = inner_per_typed("MPa", "kPa")
STIFFNESSES = {"k_0": "k0_MPa", "k_f": "kf_MPa", "k_v": "kv_MPa", "t_rho": "t_rho_MPa", "t_rho_c": "t_rho_c_MPa"}
RATES = {
    "p_f": "p_phi_per_h",
    "p_f_c": "p_phi_c_per_h",
    "p_f_t": "p_phi_H_per_h",
    "d_f": "d_phi_per_h",
    "d_f_rho_c": "d_phi_rho_c_per_h",
    "p_rho": "p_rho_per_h",
    "p_rho_c": "p_rho_c_per_h",
    "p_rho_t": "p_rho_H_per_h",
    "d_rho": "d_rho_per_h",
    "x_rho": "x_rho_per_h",
    "p_c": "p_c_rho_per_h",
    "p_c_t": "p_c_H_per_h",
    "d_c": "d_c_per_h",
    "x_c": "x_c_per_h",
}
RATIOS = {"K_f_c": "K_phi_c", "K_f_rho": "K_phi_rho", "K_rho_c": "K_rho_c", "K_rho_rho": "K_rho_rho", "K_c_c": "K_c_c"}


def mobility_of(case: WoundCase) -> Mobility:
    """How cells and cytokine move."""
    keys = {"D_rho": "D_rho", "D_c": "D_c", "D_rho_c": "D_rho_c", "D_rho_phi": "D_rho_phi"}
    return Mobility(**{name: case.values[f"{key}_mm2_per_h"] / seconds_from_hours(1.0) for name, key in keys.items()})


def sensing_of(case: WoundCase, network: tuple[HillNetwork, np.ndarray] | None) -> tuple[Sensing, np.ndarray]:
    """What cells feel, and its states (n_states,) at first."""
    table, v = case.mechanosensing, case.values
    if isinstance(table, NoneTable):
        return Sensing(Unfelt()), np.zeros(0)
    if isinstance(table, LogisticTable):
        return Sensing(LogisticSignal(v["theta_ref"], v["gamma"], v["H_least"])), np.zeros(0)
    if isinstance(table, MoreoTable):
        cell = Moreo(table.K_pass_kPa, table.K_act_kPa, table.p_max_kPa, table.theta_1, table.theta_2)
        return Sensing(StrainSignal(cell, table.K_kPa)), np.zeros(0)
    assert isinstance(table, AdhesionTable)
    substrate = table.substrate.model_copy(update={"stretch": (1.0,)})
    by_itself = AdhesionCase(bond=table.bond, substrate=substrate, cell=table.cell, method=MethodTable(duration_s=1.0))
    adhesion, _ = adhesion_of(by_itself)
    bound = np.asarray(adhesion.anchored(np.ones(1)).steady)
    traction = TractionSignal(table.K_kPa, table.threshold_kPa)
    if not isinstance(table, NetworkTable):
        return Sensing(traction, adhesion), bound
    if network is None:
        raise InputError("mechanosensing.species and mechanosensing.reactions must be read first")
    signal = NetworkSignal(network[0], traction, table.input, table.output)
    return Sensing(signal, adhesion), np.concatenate([bound, network[1]])


def _at_first(case: WoundCase, body: WoundBody, transport: Transport, sensed: np.ndarray) -> tuple[np.ndarray, Local]:
    """Cells and cytokine at carriers, and local states, of the fresh wound: healthy tissue blended into it."""
    v, space = case.values, body.frame.space
    healthy = body.healthy(body.X[transport.carriers])
    fields = np.stack([v["rho_wound"] + (1.0 - v["rho_wound"]) * healthy, v["c_wound"] * (1.0 - healthy)], axis=-1)
    points = np.einsum("qa,eai->eqi", space.corner_table.value, body.X[space.corners])
    phi = v["phi_wound"] + (1.0 - v["phi_wound"]) * body.healthy(points.reshape(-1, 3)).reshape(points.shape[:2])
    d = space.n_axes
    axes = np.broadcast_to(np.eye(3), (*phi.shape, 3, 3)).copy()
    return fields, Local(
        phi,
        np.ones((*phi.shape, d)),
        np.full(phi.shape, v["kappa"]),
        axes,
        np.broadcast_to(sensed, (*phi.shape, len(sensed))).copy(),
    )


def _fronts(case: WoundCase, transport: Transport) -> tuple[str, ...]:
    """Warn where a front of cells would be thinner than elements can show."""
    v = case.values
    rate = v["p_rho_per_h"] + v["p_rho_c_per_h"]
    if not v["D_rho_mm2_per_h"] or not rate:
        return ()
    width = np.sqrt(v["D_rho_mm2_per_h"] / rate)
    edge = float(np.median(transport.volumes) ** (1.0 / transport.space.n_axes))
    if edge * RESOLVED <= width:
        return ()
    return (
        f"warning: a front of cells is about sqrt(D_rho/r) = {width:.2g} mm wide, elements have {edge:.2g} mm; "
        f"{RESOLVED:g} elements or more in a front follow its speed well, so take more elements",
    )


class Numbers(NamedTuple):
    """What a row of the history tells of the wound."""

    size: float
    """Area or volume of the material that was wound at first, as it is now [mm^2, mm^3]."""
    at: dict[str, dict[str, float]]
    """rho, c, phi and lamP_area (or volume) at "centre" and "edge"."""
    cells: float
    """In the whole body, in those of healthy tissue times its volume [mm^2, mm^3]."""


def numbers_of(model: WoundModel, state: WoundState) -> Numbers:
    """Measure a state."""
    transport, local = model.solver.transport, state.local
    to_corners = np.linalg.pinv(
        transport.space.corner_table.value
    ).T  # within each element: what points hold may jump between
    of = {
        "rho": state.fields[transport.cells, 0],
        "c": state.fields[transport.cells, 1],
        "phi": local.phi @ to_corners,
        "lamP": np.prod(local.stretch, axis=-1) @ to_corners,
    }
    places: dict[str, Place] = {"centre": model.body.centre, "edge": model.body.edge}
    at = {where: {name: place.mean(corners) for name, corners in of.items()} for where, place in places.items()}
    return Numbers(model.body.size(state.x), at, transport.total(state.fields[:, 0]))

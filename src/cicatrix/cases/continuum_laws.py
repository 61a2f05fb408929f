"""Build the continuum healing model from the tables of a case: local laws, mobility and mechanosensing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from ..biology.moreo import Moreo
from ..biology.network import RateLaw
from ..biology.sensing import Sensing
from ..biology.signals import LogisticSignal, NetworkSignal, NoMechanosensing, StrainSignal, TractionSignal
from ..biology.turnover import Turnover
from ..core.errors import InputError
from ..core.units import seconds_from_hours, unit_factor
from ..files.networks import read_network
from ..healing.scarring import CollagenGrowth, Contracture, Local, Reorientation, Scarring
from ..healing.transport import Mobility, Transport
from .adhesion_laws import adhesion_of
from .continuum import AdhesionTable, LogisticTable, NetworkSensingTable, NoneTable
from .signals import MoreoTable

RESOLVED = 2.0  # smallest number of elements along sqrt(D/r) with which a front is resolved
Network = tuple[RateLaw, np.ndarray]  # rate law, and initial activities (n_species,)


class ContinuumSettings(Protocol):
    """Interface of a case whose tissue heals by the continuum model."""

    @property
    def values(self) -> Mapping[str, float]:
        """Parameters, by their keys in case files."""
        ...

    @property
    def mechanosensing(self) -> object:
        """Table of the mechanical signal that cells sense."""
        ...

    @property
    def is_sheet(self) -> bool:
        """Whether the body is a sheet (normal to the third axis), not a solid."""
        ...


def scarring_of(case: ContinuumSettings, network: Network | None = None) -> tuple[Scarring, np.ndarray]:
    """Build the law of healing at a material point, and the initial mechanosensing states (n_states,).

    Raises
    ------
    InputError
        If the adhesion is not defined on an unstretched substrate, or the network lacks the input or output that is named.
    """
    v = case.values
    sensing, signal_state = sensing_of(case, network)
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
        T_0=v.get("T_0_MPa", 0.0) * KPA_PER_MPA,
        is_sheet=case.is_sheet,
    )
    return law, signal_state


def turnover_of(case: ContinuumSettings) -> Turnover:
    """Build the turnover law of cells, cytokine and collagen."""
    v = case.values
    per_s = {name: v[key] / seconds_from_hours(1.0) for name, key in RATES.items()}
    return Turnover(**per_s, **{name: v[key] for name, key in RATIOS.items()})


KPA_PER_MPA = unit_factor("MPa", "kPa")
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


def mobility_of(case: ContinuumSettings) -> Mobility:
    """Build the law of diffusion, chemotaxis and haptotaxis."""
    keys = {"D_rho": "D_rho", "D_c": "D_c", "D_rho_c": "D_rho_c", "D_rho_phi": "D_rho_phi"}
    return Mobility(**{name: case.values[f"{key}_mm2_per_h"] / seconds_from_hours(1.0) for name, key in keys.items()})


def sensing_of(case: ContinuumSettings, network: Network | None) -> tuple[Sensing, np.ndarray]:
    """Build the mechanosensing law, and its initial states (n_states,)."""
    table, v = case.mechanosensing, case.values
    if isinstance(table, NoneTable):
        return Sensing(NoMechanosensing()), np.zeros(0)
    if isinstance(table, LogisticTable):
        return Sensing(LogisticSignal(v["theta_ref"], v["gamma"], v["H_least"])), np.zeros(0)
    if isinstance(table, MoreoTable):
        cell = Moreo(table.K_pass_kPa, table.K_act_kPa, table.p_max_kPa, table.theta_1, table.theta_2)
        return Sensing(StrainSignal(cell, table.K_kPa)), np.zeros(0)
    assert isinstance(table, AdhesionTable)
    substrate = table.substrate.model_copy(update={"stretch": (1.0,)})
    adhesion, _ = adhesion_of(table.bond, substrate, table.cell)
    bound = np.asarray(adhesion.steady_state(np.ones(1)).steady)
    traction = TractionSignal(table.K_kPa, table.threshold_kPa)
    if not isinstance(table, NetworkSensingTable):
        return Sensing(traction, adhesion), bound
    if network is None:
        raise InputError("mechanosensing.species and mechanosensing.reactions must be read first")
    signal = NetworkSignal(network[0], traction, table.input, table.output)
    return Sensing(signal, adhesion), np.concatenate([bound, network[1]])


def local_of(phi: np.ndarray, kappa: float, signal_state: np.ndarray, d: int) -> Local:
    """Build the local states of tissue without permanent stretch.

    The states follow from collagen (n_elements, n_qp), fibre dispersion, mechanosensing states and the number of axes ``d``.
    """
    return Local(
        phi,
        np.ones((*phi.shape, d)),
        np.full(phi.shape, kappa),
        np.broadcast_to(np.eye(3), (*phi.shape, 3, 3)).copy(),
        np.broadcast_to(signal_state, (*phi.shape, len(signal_state))).copy(),
    )


def front_resolution_warning(
    case: ContinuumSettings, transport: Transport, near: np.ndarray | None = None
) -> tuple[str, ...]:
    """Return a warning if elements are too coarse for a front of cells, in the body or at the vertex nodes ``near`` (bool)."""
    v = case.values
    rate = v["p_rho_per_h"] + v["p_rho_c_per_h"]
    if not v["D_rho_mm2_per_h"] or not rate:
        return ()
    width = np.sqrt(v["D_rho_mm2_per_h"] / rate)
    volumes = transport.volumes if near is None else transport.volumes[near]
    edge = float(np.median(volumes) ** (1.0 / transport.space.n_axes))
    if edge * RESOLVED <= width:
        return ()
    return (
        f"warning: a front of cells is about sqrt(D_rho/r) = {width:.2g} mm wide, elements have {edge:.2g} mm; "
        f"its speed is accurate with {RESOLVED:g} or more elements across its width, so take more elements",
    )


def network_of(table: object) -> Network | None:
    """Read the signalling network of mechanosensing, and its initial activities; None if the signal uses no network."""
    if not isinstance(table, NetworkSensingTable):
        return None
    model = read_network(table.species, table.reactions, table.inhibition)
    return model.law, model.start

"""Tables of the signal that cells derive from their traction or strain, and of turnover."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ..biology.turnover import Turnover
from .bounds import NotNegative, Number, Positive
from .laws import one_of, table_of
from .table import Table


class TractionTable(Table):
    """Signal from the traction at the adhesions, with saturation: :class:`..biology.signals.TractionSignal`.

    If the threshold is below the traction in unstretched tissue, tissue at rest grows until it is compressed.
    """

    type: Literal["traction"]
    K_kPa: Positive = 1.0  # traction beyond the threshold at which the signal is one half
    threshold_kPa: NotNegative = 0.0  # traction up to which there is no signal


class MoreoTable(Table):
    """Signal from the stress of a cell at the strain of the tissue around it: :class:`..biology.signals.StrainSignal`."""

    type: Literal["moreo"]
    K_pass_kPa: NotNegative  # passive stiffness of the cell
    K_act_kPa: Positive  # stiffness of its contractile machinery
    p_max_kPa: NotNegative  # largest stress of the contractile machinery
    theta_1: Number  # lower end of the strains at which it contracts
    theta_2: Number  # upper end of the strains at which it contracts
    K_kPa: Positive = 1.0  # stress at which the signal is one half


class NetworkSignalTable(Table):
    """Signal from a signalling network that the traction drives: :class:`..biology.signals.NetworkSignal`."""

    type: Literal["network"]
    species: Path  # CSV file of species: id, y_init, y_max, tau_h
    reactions: Path  # CSV file of reactions: id, rule, weight, n, ec50
    inhibition: Literal["complement", "weighted"] = "complement"  # NOT is 1 - activity, or weight - activity
    input: str  # input of the network that is set to the saturated traction
    output: str  # species whose activity is the signal
    K_kPa: Positive = 1.0  # traction beyond the threshold at which the input is one half
    threshold_kPa: NotNegative = 0.0  # traction up to which the input is 0


TurnoverTable = table_of(Turnover)


AnySignal = one_of({"traction": TractionTable, "moreo": MoreoTable, "network": NetworkSignalTable})

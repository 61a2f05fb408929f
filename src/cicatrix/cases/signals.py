"""Tables of the signal that cells derive from their traction or strain, and of turnover."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ..biology.turnover import Turnover
from .bounds import NotNegative, Number, Positive
from .laws import one_of, table_of
from .table import Table


class TractionTable(Table):
    """The traction at the adhesions, which saturates: :class:`..biology.signals.TractionSignal`."""

    type: Literal["traction"]
    K_kPa: Positive = 1.0
    threshold_kPa: NotNegative = 0.0  # below the traction at rest, tissue that is not stretched grows into compression


class MoreoTable(Table):
    """The stress of a cell at the strain about it: :class:`..biology.signals.StrainSignal`."""

    type: Literal["moreo"]
    K_pass_kPa: NotNegative
    K_act_kPa: Positive
    p_max_kPa: NotNegative
    theta_1: Number
    theta_2: Number
    K_kPa: Positive = 1.0


class NetworkSignalTable(Table):
    """A network that the traction drives: :class:`..biology.signals.NetworkSignal`."""

    type: Literal["network"]
    species: Path
    reactions: Path
    inhibition: Literal["complement", "weighted"] = "complement"
    input: str  # driven by the traction, saturated as above
    output: str  # whose activity is the signal
    K_kPa: Positive = 1.0
    threshold_kPa: NotNegative = 0.0


TurnoverTable = table_of(Turnover)


AnySignal = one_of({"traction": TractionTable, "moreo": MoreoTable, "network": NetworkSignalTable})

"""The cellular automaton in a lumpectomy: its rules from the case."""

from __future__ import annotations

from collections.abc import Callable

from ...coupling.automaton_healing import AutomatonHealing
from ...coupling.cavity import Cavity
from ...coupling.deposition import Deposition
from ...coupling.ruler import Ruler
from ...healing.automaton import Automaton
from .body import BreastModel
from .case import LumpectomyCase


def automaton_healing(
    case: LumpectomyCase,
    model: BreastModel,
    cavity: Cavity,
    ruler: Ruler,
    report: Callable[[str], None] | None = None,
) -> AutomatonHealing:
    """Build the automaton on the lattice ``ruler``; ``model``, ``cavity`` and ``report`` are not used.

    Raises
    ------
    InputError
        If the cavity fills the lattice, or the rates of the case give no valid rules at the lattice pitch.
    """
    automaton = Automaton(ruler.lattice, ruler.fillable, ruler.open0, case.rules(), case.run.seed)
    deposition = Deposition(case.healing.deposition == "loaded", case.healing.deposition_prestretch)
    return AutomatonHealing(cavity, ruler, automaton, deposition, case.days_per_step)

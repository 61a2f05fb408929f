"""The equations that an SBML model stands for: what each of its quantities is at every time, as expressions."""

from __future__ import annotations

from typing import NamedTuple

from ..biology.expressions import Expression, names_in


class Event(NamedTuple):
    """A change of quantities at the instant at which a condition becomes true (SBML Level 3 Version 2, section 4.12)."""

    trigger: Expression
    assignments: dict[str, Expression]
    delay: Expression | None = None
    priority: Expression | None = None
    starts_true: bool = True
    """Whether the condition counts as true before the first instant, so that it does not fire there."""
    is_persistent: bool = True
    """Whether it is executed after its delay even if the condition has become false."""
    at_trigger: bool = True
    """Whether the new values are those at the instant of the trigger, not at that of the execution."""


class Equations(NamedTuple):
    """A model as equations; a species is a concentration or an amount, as in the model's formulas.

    In a compartment that varies, the amount of a species of reactions is a quantity of its own, named by :func:`amount_of`.
    """

    rates: dict[str, Expression]
    """Quantities that a differential equation determines: their rate."""
    assigned: dict[str, Expression]
    """Quantities that a formula determines at all times; reactions are among them, and stand for their rates."""
    given: dict[str, Expression]
    """Values of all others, and initial values of ``rates``."""
    initial: dict[str, Expression]
    """Initial assignments; they replace ``given``."""
    events: tuple[Event, ...]
    volumes: dict[str, str]
    """Compartment of every species whose name stands for its concentration."""
    columns: tuple[str, ...]
    """All species, and the parameters, compartments and stoichiometries that may change."""
    features: tuple[str, ...]
    """What the model has beyond the rate laws that a tissue can carry."""
    notes: tuple[str, ...]

    @property
    def changing(self) -> set[str]:
        """Names whose values change in time."""
        return {*self.rates, *self.assigned} | {one for event in self.events for one in event.assignments}

    def constants(self) -> list[str]:
        """Return the names of the constants, in the order of the model."""
        return [one for one in self.given if one not in self.changing]

    def derived(self, free: set[str]) -> dict[str, Expression]:
        """Return the constants that initial assignments compute from other constants; those in ``free`` are independent."""
        constants = set(self.constants())
        candidates = {one: self.initial[one] for one in self.constants() if one in self.initial and one not in free}
        candidates = {one: rule for one, rule in candidates.items() if names_in(rule)}
        while True:
            kept = {one: rule for one, rule in candidates.items() if names_in(rule) <= constants}
            if len(kept) == len(candidates):
                return kept
            constants -= candidates.keys() - kept.keys()
            candidates = kept


def amount_of(species: str) -> str:
    """Return the name of the amount of a species; no id of SBML holds a space."""
    return f"amount of {species}"

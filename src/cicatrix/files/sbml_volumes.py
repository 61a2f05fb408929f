"""Species in compartments of variable size: when their concentrations and when their amounts are quantities of their own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ..biology.expressions import Expression, name, names_in, needed, number
from ..core.errors import InputError
from .sbml_equations import Event, amount_of
from .sbml_math import RATE


class Volumes(NamedTuple):
    """The quantities of a model, which this class completes; all of them are changed in place.

    A concentration S of the amount A in a volume V follows S' = (A' - S V') / V where V has a rate; elsewhere A is a quantity
    of its own, which jumps of V leave as it is, and S = A / V.
    """

    rates: dict[str, Expression]
    assigned: dict[str, Expression]
    initial: dict[str, Expression]
    given: dict[str, Expression]
    volumes: dict[str, str]
    """Compartment of every species whose name stands for its concentration."""
    varying: set[str]
    """Compartments whose size changes."""
    jumping: set[str]
    """Those of them whose size jumps."""
    by_events: set[str]
    """Quantities that events set."""

    def complete(self, sums: dict[str, Expression], events: Sequence[Event]) -> tuple[Event, ...]:
        """Enter the rates of amounts that reactions give, and of all that follows a volume; return the events on amounts."""
        ruled = dict(self.rates)
        self.rates.clear()
        self.rates.update(self._rate_of_reactions(of, rate, ruled) for of, rate in sums.items())
        self.rates.update(ruled)
        self._follow_jumps()
        smooth = [one for one in self._unruled() if not self._is_split(self.volumes[one])]
        self.rates.update({one: self._diluted(one, number(0.0), ruled) for one in smooth})
        held = self._held_amounts()
        for one in held:
            self._hold_amount(one)
        return tuple(self._on_amounts(event, held) for event in events)

    def _rate_of_reactions(self, of: str, rate: Expression, ruled: dict[str, Expression]) -> tuple[str, Expression]:
        """Return the quantity of a species that an equation determines, and its rate from that of the amount."""
        volume = self.volumes.get(of)
        if volume is None:
            return of, rate
        return (amount_of(of), rate) if self._is_split(volume) else (of, self._diluted(of, rate, ruled))

    def _is_split(self, volume: str) -> bool:
        """Return whether amounts in a compartment are quantities of their own, since its size is not smooth or has no rate."""
        return volume in self.jumping or volume in self.varying & self.assigned.keys()

    def _diluted(self, of: str, rate: Expression, ruled: dict[str, Expression]) -> Expression:
        """Return the rate of a concentration from that of the amount: (A' - S V') / V."""
        volume = self.volumes[of]
        if volume in ruled:
            rate = ("minus", rate, ("times", name(of), ruled[volume]))
        return ("divide", rate, name(volume))

    def _follow_jumps(self) -> None:
        """Turn rate rules of concentrations into rates of amounts, which stay where a volume jumps: A' = V S' + S V'."""
        for one, volume in self.volumes.items():
            if one not in self.rates or not self._is_split(volume):
                continue
            if volume in self.jumping:
                spread = ("times", name(one), self.rates.get(volume, number(0.0)))
                self.rates[amount_of(one)] = ("plus", ("times", name(volume), self.rates.pop(one)), spread)
            elif needed([volume], self.assigned) & self.by_events:
                raise InputError(
                    f'species "{one}" has a rate rule, and events change what the size of its compartment "{volume}" depends on'
                )

    def _unruled(self) -> list[str]:
        """Return the species whose concentration changes with their compartment, since nothing determines it otherwise."""
        fixed = {*self.rates, *self.assigned}
        return [one for one, volume in self.volumes.items() if volume in self.varying and one not in fixed]

    def _held_amounts(self) -> list[str]:
        """Return those of them whose amount is a quantity of its own."""
        return [one for one in self._unruled() if self._is_split(self.volumes[one])]

    def _hold_amount(self, species: str) -> None:
        """Make the amount of a species a quantity, and its concentration the quotient of amount and volume."""
        volume, amount = name(self.volumes[species]), amount_of(species)
        start = self.initial.pop(species, None) or self.given[species]
        self.given.pop(species, None)
        self.given[amount] = ("times", start, volume)
        self.assigned[species] = ("divide", name(amount), volume)

    def _on_amounts(self, event: Event, held: Sequence[str]) -> Event:
        """Let an event that sets a concentration in a varying compartment set the amount, with the volume after the event."""
        after: dict[str, Expression] = {}
        for variable, value in event.assignments.items():
            if variable not in held:
                after[variable] = value
                continue
            volume = self.volumes[variable]
            if event.delay and event.at_trigger:
                raise InputError(
                    f'a delayed event sets the concentration "{variable}", in "{volume}" that jumps, to a value of the past; '
                    "set useValuesFromTriggerTime to false"
                )
            if volume in self.assigned and names_in(self.assigned[volume]) & event.assignments.keys():
                raise InputError(
                    f'an event sets the concentration "{variable}" and, at once, what the size of "{volume}" depends on'
                )
            after[amount_of(variable)] = ("times", value, event.assignments.get(volume, name(volume)))
        return event._replace(assignments=after)

    def add_rates_of(self, asked: Iterable[str]) -> None:
        """Enter the rates of change that formulas ask for by rateOf."""
        left = sorted(asked)
        while left:
            one = left.pop()
            self.assigned[one] = self._rate_of(one.removeprefix(RATE))
            more = {other for other in names_in(self.assigned[one]) if other.startswith(RATE)}
            left += sorted(more - self.assigned.keys())

    def _rate_of(self, of: str) -> Expression:
        if of in self.rates:
            return self.rates[of]
        amount, volume = amount_of(of), self.volumes.get(of, "")
        if of in self.assigned and self.assigned[of] == ("divide", name(amount), name(volume)):
            spread = ("times", name(of), name(RATE + volume))
            return ("divide", ("minus", self.rates.get(amount, number(0.0)), spread), name(volume))
        if of in self.assigned:
            raise InputError(f'rateOf asks for the rate of "{of}", which a rule computes; its rate is not known')
        return number(0.0)

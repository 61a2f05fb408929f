"""The equations that an SBML model stands for: what each of its quantities is at every time, as expressions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from ..biology.expressions import TIME, Expression, name, names_in, needed, number
from ..biology.rules import unknown_species
from ..core.errors import InputError
from .sbml_algebra import solved
from .sbml_math import RATE, expression_of


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
        while True:
            kept = {one: rule for one, rule in candidates.items() if names_in(rule) and names_in(rule) <= constants}
            if len(kept) == len(candidates):
                return kept
            constants -= candidates.keys() - kept.keys()
            candidates = kept


def amount_of(species: str) -> str:
    """Return the name of the amount of a species; no id of SBML holds a space."""
    return f"amount of {species}"


def equations_of(model: Any, varying: set[str]) -> Equations:
    """Return the equations of a model that is flat, valid and without functions.

    Parameters
    ----------
    model : libsbml.Model
        The model.
    varying : set of str
        Compartments whose size changes from outside.

    Raises
    ------
    InputError
        If the model is outside of what can be simulated; the message has no file's name.
    """
    return _Translation(model, varying).equations()


class _Translation:
    """Translation of one model, in the order of its sections."""

    def __init__(self, model: Any, varying: set[str]) -> None:
        self.model, self.notes = model, []
        self.parts = [
            *model.getListOfCompartments(),
            *model.getListOfSpecies(),
            *model.getListOfParameters(),
            *(one for _, one, _ in self._references() if one.isSetId()),
        ]
        self.species = {one.getId(): one for one in model.getListOfSpecies()}
        self._refuse_odd_compartments()
        rules = [(one, self._math(one, "a rule")) for one in model.getListOfRules()]
        self.rates = {one.getVariable(): math for one, math in rules if one.isRate() and math}
        self.assigned = {one.getVariable(): math for one, math in rules if one.isAssignment() and math}
        self.algebraic = [math for one, math in rules if one.isAlgebraic() and math]
        symbols = [
            (one.getSymbol(), self._math(one, "an initial assignment")) for one in model.getListOfInitialAssignments()
        ]
        self.initial = {symbol: math for symbol, math in symbols if math}
        self.events = [self._event(one) for one in model.getListOfEvents() if one.isSetTrigger()]
        self.events = [one for one in self.events if one is not None]
        self.by_events = {one for event in self.events for one in event.assignments}
        for reaction in model.getListOfReactions():
            self._add_law(reaction)
        self.assigned |= solved(self.algebraic, self._undetermined(), self.assigned)
        changed = {*self.rates, *self.assigned, *self.by_events, *varying}
        self.varying = {one.getId() for one in model.getListOfCompartments() if one.getId() in changed}
        self.jumping = self.varying & {*self.by_events, *varying}
        self.volumes = {one.getId(): one.getCompartment() for one in self.species.values() if self._is_dense(one)}

    def equations(self) -> Equations:
        """Return the equations."""
        features = tuple(dict.fromkeys(self._features()))
        given = {one.getId(): self._given(one) for one in self.parts}
        missing = [
            one for one in given if given[one] is None and not {one} & (self.initial.keys() | self.assigned.keys())
        ]
        if missing:
            raise InputError(f'"{missing[0]}" has no initial value')
        columns = tuple(one.getId() for one in self.parts if self._is_shown(one))
        known = {*given, *self.assigned, TIME}
        self._refuse_unknown(known)
        found = {one: rule or self.initial[one] for one, rule in given.items() if one not in self.assigned}
        self._add_reactions()
        self._follow_jumps()
        self.rates |= {
            one: self._diluted(one, number(0.0)) for one in self._unruled() if not self._is_split(self.volumes[one])
        }
        self.events = [self._on_amounts(event) for event in self.events]
        for one in self._held_amounts():
            self._hold_amount(one, found)
        self._add_rates_of()
        return Equations(
            self.rates,
            self.assigned,
            found,
            self.initial,
            tuple(self.events),
            self.volumes,
            columns,
            features,
            tuple(self.notes),
        )

    def _references(self) -> Iterator[tuple[Any, Any, float]]:
        """Yield reaction, species reference and sign."""
        for reaction in self.model.getListOfReactions():
            for sign, side in ((-1.0, reaction.getListOfReactants()), (1.0, reaction.getListOfProducts())):
                for one in side:
                    yield reaction, one, sign

    def _math(self, owner: Any, what: str) -> Expression | None:
        """Return a formula; None, and a note, where it is empty, as Level 3 Version 2 allows."""
        if owner.isSetMath():
            return expression_of(owner.getMath())
        self.notes.append(f"{what[0].upper()}{what[1:]} without a formula has no effect.")
        return None

    def _refuse_odd_compartments(self) -> None:
        for one in self.model.getListOfCompartments():
            if one.isSetSize() and one.getSize() < 0.0:
                raise InputError(f'compartment "{one.getId()}" has the size {one.getSize():g}; it must be above 0')
            if not one.isSetSize() and one.getSpatialDimensionsAsDouble() > 0.0:
                fixed = {rule.getVariable() for rule in self.model.getListOfRules() if rule.isAssignment()}
                fixed |= {rule.getSymbol() for rule in self.model.getListOfInitialAssignments()}
                if one.getId() not in fixed:
                    self.notes.append(f'Compartment "{one.getId()}" has no size; 1 is taken.')

    def _event(self, event: Any) -> Event | None:
        trigger = self._math(event.getTrigger(), "an event's trigger")
        pairs = [
            (one.getVariable(), self._math(one, "an event's assignment")) for one in event.getListOfEventAssignments()
        ]
        delay, priority = (
            self._math(one, f"an event's {word}") if one is not None else None
            for one, word in ((event.getDelay(), "delay"), (event.getPriority(), "priority"))
        )
        of = event.getTrigger()
        if trigger is None:
            return None
        return Event(
            trigger,
            {variable: math for variable, math in pairs if math},
            delay,
            priority,
            of.getInitialValue() if of.isSetInitialValue() else True,
            of.getPersistent() if of.isSetPersistent() else True,
            event.getUseValuesFromTriggerTime(),
        )

    def _add_law(self, reaction: Any) -> None:
        """Enter the rate of a reaction, as a value of its own."""
        if reaction.isSetFast() and reaction.getFast():
            raise InputError(
                f'reaction "{reaction.getId()}" is fast, at equilibrium at all times; neither cicatrix nor libroadrunner can '
                "keep it there: set fast to false if its rate may be followed"
            )
        if not reaction.isSetKineticLaw():
            raise InputError(f'reaction "{reaction.getId()}" has no kinetic law')
        law = self._math(reaction.getKineticLaw(), f'the kinetic law of "{reaction.getId()}"')
        self.assigned[reaction.getId()] = number(0.0) if law is None else law

    def _undetermined(self) -> list[str]:
        """Return the quantities that only an algebraic rule can determine."""
        moved = {
            one.getSpecies() for _, one, _ in self._references() if not self._is_held(self.species[one.getSpecies()])
        }
        fixed = {*self.rates, *self.assigned, *self.by_events, *moved}
        return [one.getId() for one in self.parts if not one.getConstant() and one.getId() not in fixed]

    @staticmethod
    def _is_held(species: Any) -> bool:
        """Return whether reactions do not change a species."""
        return species.getBoundaryCondition() or species.getConstant()

    def _is_dense(self, species: Any) -> bool:
        """Return whether the name of a species stands for a concentration, not for an amount."""
        compartment = self.model.getCompartment(species.getCompartment())
        if species.getHasOnlySubstanceUnits() or compartment.getSpatialDimensionsAsDouble() == 0.0:
            return False
        if (
            compartment.isSetSize()
            and compartment.getSize() == 0.0
            and compartment.getId() not in self.initial | self.assigned
        ):
            raise InputError(
                f'species "{species.getId()}" is a concentration in compartment "{compartment.getId()}" of size 0; '
                "give the compartment a size above 0"
            )
        return True

    def _features(self) -> Iterator[str]:
        """Yield what the model has beyond the rate laws that a tissue can carry, in words."""
        if self.events:
            yield "events"
        if self.algebraic:
            yield "algebraic rules"
        if self.varying:
            yield "compartments of variable size"
        if self.model.isSetConversionFactor() or any(one.isSetConversionFactor() for one in self.species.values()):
            yield "conversion factors"
        if any(one.startswith(RATE) for rule in self._formulas() for one in names_in(rule)):
            yield "rateOf"
        for _, one, _ in self._references():
            if one.isSetStoichiometryMath() or self._is_variable(one):
                yield "computed stoichiometries"
        moved = any(not self._is_held(self.species[one.getSpecies()]) for _, one, _ in self._references())
        if not self.rates and not moved:
            yield "no differential equation"

    def _is_variable(self, reference: Any) -> bool:
        changed = {*self.rates, *self.assigned, *self.initial, *self.by_events}
        return reference.isSetId() and reference.getId() in changed

    def _formulas(self) -> Iterator[Expression]:
        yield from (*self.rates.values(), *self.assigned.values(), *self.initial.values(), *self.algebraic)
        for event in self.events:
            yield from (event.trigger, *event.assignments.values())
            yield from (one for one in (event.delay, event.priority) if one is not None)

    def _is_shown(self, one: Any) -> bool:
        changed = {*self.rates, *self.assigned, *self.by_events}
        if one.getElementName() == "speciesReference":
            return one.getId() in changed | self.initial.keys()
        return one.getElementName() == "species" or one.getId() in changed or self._may_change(one)

    def _may_change(self, one: Any) -> bool:
        """Return whether a model declares that a quantity may change; Level 1 has no such declaration."""
        return one.getLevel() > 1 and not one.getConstant()

    def _given(self, one: Any) -> Expression | None:
        """Return the value that the attributes of a quantity state; None if there is none."""
        kind = one.getElementName()
        if kind == "compartment":
            return number(one.getSize() if one.isSetSize() else 1.0)
        if kind == "parameter":
            return number(one.getValue()) if one.isSetValue() else None
        if kind == "speciesReference":
            return number(one.getStoichiometry() if one.isSetStoichiometry() else 1.0)
        volume, is_dense = name(one.getCompartment()), one.getId() in self.volumes
        if one.isSetInitialAmount():
            amount = number(one.getInitialAmount())
            return ("divide", amount, volume) if is_dense else amount
        if one.isSetInitialConcentration():
            density = number(one.getInitialConcentration())
            return density if is_dense else ("times", density, volume)
        return None

    def _refuse_unknown(self, known: set[str]) -> None:
        reactions = {one.getId() for one in self.model.getListOfReactions()}
        rules = {**self.initial, **self.rates, **self.assigned}
        asked = [(f'reaction "{of}"' if of in reactions else f'the rule of "{of}"', rule) for of, rule in rules.items()]
        whole = {*names_in(("plus", *self._formulas()))}
        asked += [("a rule, an event or an assignment", name(one)) for one in sorted(whole)]
        for words, rule in asked:
            for one in sorted(names_in(rule) - known - {RATE + other for other in known}):
                raise InputError(f"{words} {unknown_species(one.removeprefix(RATE), known - {TIME}, 'id')}")

    def _add_reactions(self) -> None:
        """Enter the rate of every species that reactions change."""
        sums: dict[str, list[Expression]] = {}
        for reaction, one, sign in self._references():
            species = self.species[one.getSpecies()]
            if not self._is_held(species):
                rate = ("times", self._stoichiometry(one, sign), name(reaction.getId()))
                factor = species.getConversionFactor() or self.model.getConversionFactor()
                sums.setdefault(species.getId(), []).append(("times", rate, name(factor)) if factor else rate)
        self.rates = dict(self._rate_of_reactions(of, ("plus", *terms)) for of, terms in sums.items()) | self.rates

    def _rate_of_reactions(self, of: str, rate: Expression) -> tuple[str, Expression]:
        """Return the quantity of a species that an equation determines, and its rate from that of the amount."""
        volume = self.volumes.get(of)
        if volume is None:
            return of, rate
        return (amount_of(of), rate) if self._is_split(volume) else (of, self._diluted(of, rate))

    def _is_split(self, volume: str) -> bool:
        """Return whether amounts in a compartment are quantities of their own, since its size is not smooth or has no rate."""
        return volume in self.jumping or (volume in self.varying and volume not in self.rates)

    def _diluted(self, of: str, rate: Expression) -> Expression:
        """Return the rate of a concentration from that of the amount: (A' - S V') / V."""
        volume = self.volumes[of]
        if volume in self.rates:
            rate = ("minus", rate, ("times", name(of), self.rates[volume]))
        return ("divide", rate, name(volume))

    def _stoichiometry(self, reference: Any, sign: float) -> Expression:
        if reference.isSetStoichiometryMath() and reference.getStoichiometryMath().isSetMath():
            return ("times", number(sign), expression_of(reference.getStoichiometryMath().getMath()))
        if self._is_variable(reference):
            return ("times", number(sign), name(reference.getId()))
        return number(sign * (reference.getStoichiometry() if reference.isSetStoichiometry() else 1.0))

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

    def _hold_amount(self, species: str, given: dict[str, Expression]) -> None:
        """Make the amount of a species a quantity, and its concentration the quotient of amount and volume."""
        volume, amount = name(self.volumes[species]), amount_of(species)
        start = self.initial.pop(species, None) or given.pop(species)
        given.pop(species, None)
        given[amount] = ("times", start, volume)
        self.assigned[species] = ("divide", name(amount), volume)

    def _on_amounts(self, event: Event) -> Event:
        """Let an event that sets a concentration in a varying compartment set the amount, with the volume after the event."""
        after: dict[str, Expression] = {}
        held = self._held_amounts()
        for variable, value in event.assignments.items():
            if variable not in held:
                after[variable] = value
                continue
            volume = self.volumes[variable]
            if volume in self.assigned and names_in(self.assigned[volume]) & event.assignments.keys():
                raise InputError(
                    f'an event sets the concentration "{variable}" and, at once, what the size of "{volume}" depends on'
                )
            after[amount_of(variable)] = ("times", value, event.assignments.get(volume, name(volume)))
        return event._replace(assignments=after)

    def _add_rates_of(self) -> None:
        """Enter the rates of change that formulas ask for by rateOf."""
        asked = {one for rule in self._formulas() for one in names_in(rule) if one.startswith(RATE)}
        while asked:
            one = asked.pop()
            rule = self._rate_of(one.removeprefix(RATE))
            self.assigned[one] = rule
            asked |= {other for other in names_in(rule) if other.startswith(RATE) and other not in self.assigned}

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

"""Translation of an SBML model, as libsbml holds it, to equations."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from ..biology.expressions import TIME, Expression, name, names_in, number
from ..biology.rules import unknown_species
from ..core.errors import InputError
from .sbml_algebra import solved
from .sbml_equations import Equations, Event
from .sbml_math import RATE, expression_of
from .sbml_volumes import Volumes


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
        changed = {*self.rates, *self._changing_formulas(), *self.by_events, *varying}
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
        sums = self._sums()
        self._refuse_unknown({*given, *self.assigned, TIME}, sums)
        found = {one: rule or self.initial[one] for one, rule in given.items() if one not in self.assigned}
        asked = {one for rule in self._formulas() for one in names_in(rule) if one.startswith(RATE)}
        volumes = Volumes(
            self.rates, self.assigned, self.initial, found, self.volumes, self.varying, self.jumping, self.by_events
        )
        events = volumes.complete(sums, self.events)
        volumes.add_rates_of(asked)
        return Equations(
            self.rates,
            self.assigned,
            found,
            self.initial,
            events,
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
        for one in self.species.values():
            if self.model.getCompartment(one.getCompartment()) is None:
                words = f'"{one.getCompartment()}", which the model has not' if one.getCompartment() else "none"
                raise InputError(f'species "{one.getId()}" must be in a compartment of the model; it is in {words}')
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

    def _changing_formulas(self) -> set[str]:
        """Return the quantities whose formulas depend on the time or on anything that changes."""
        moved = {one.getSpecies() for _, one, _ in self._references()}
        changing = {TIME, *self.rates, *self.by_events, *moved}
        while True:
            more = {one for one, rule in self.assigned.items() if names_in(rule) & changing} - changing
            if not more:
                return changing & self.assigned.keys()
            changing |= more

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

    def _refuse_unknown(self, known: set[str], sums: dict[str, Expression]) -> None:
        reactions = {one.getId() for one in self.model.getListOfReactions()}
        rules = {**self.initial, **self.rates, **self.assigned}
        asked = [(f'reaction "{of}"' if of in reactions else f'the rule of "{of}"', rule) for of, rule in rules.items()]
        whole = names_in(("plus", *self._formulas(), *sums.values()))
        asked += [("a rule, an event or an assignment", name(one)) for one in sorted(whole)]
        for words, rule in asked:
            for one in sorted(names_in(rule) - known - {RATE + other for other in known}):
                raise InputError(f"{words} {unknown_species(one.removeprefix(RATE), known - {TIME}, 'id')}")

    def _sums(self) -> dict[str, Expression]:
        """Return the rate of the amount of every species that reactions change."""
        sums: dict[str, list[Expression]] = {}
        for reaction, one, sign in self._references():
            species = self.species[one.getSpecies()]
            if not self._is_held(species):
                rate = ("times", self._stoichiometry(one, sign), name(reaction.getId()))
                factor = species.getConversionFactor() or self.model.getConversionFactor()
                sums.setdefault(species.getId(), []).append(("times", rate, name(factor)) if factor else rate)
        return {of: ("plus", *terms) for of, terms in sums.items()}

    def _stoichiometry(self, reference: Any, sign: float) -> Expression:
        if reference.isSetStoichiometryMath() and reference.getStoichiometryMath().isSetMath():
            return ("times", number(sign), expression_of(reference.getStoichiometryMath().getMath()))
        if self._is_variable(reference):
            return ("times", number(sign), name(reference.getId()))
        of = reference.getStoichiometry() if reference.isSetStoichiometry() else 1.0
        return number(sign * of / reference.getDenominator())  # Level 1 has fractions

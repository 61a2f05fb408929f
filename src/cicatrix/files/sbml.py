"""Reading of reaction networks from SBML: libsbml checks them and expands functions; the result is :class:`.Kinetics`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..biology.kinetics import CONSTANTS, FUNCTIONS, TIME, Expression, Kinetics, evaluate, names_in
from ..biology.network_model import NetworkModel
from ..biology.rules import unknown_species
from ..core.errors import InputError
from ..core.units import unit_factor
from .text import text_of

MISSING = "needs python-libsbml to read SBML: pip install 'cicatrix[sbml]'"
CONVERSIONS = ("expandFunctionDefinitions", "promoteLocalParameters")
WORDS = {  # type of a libsbml node, without the prefix AST_ -> word of Kinetics
    "PLUS": "plus",
    "MINUS": "minus",
    "TIMES": "times",
    "DIVIDE": "divide",
    "POWER": "power",
    "FUNCTION_POWER": "power",
    "FUNCTION_ROOT": "root",
    "FUNCTION_LOG": "log",
    "FUNCTION_LN": "ln",
    **{f"FUNCTION_{name.upper()}": name for name in FUNCTIONS},
    **{f"LOGICAL_{name.upper()}": name for name in ("and", "or", "xor", "not")},
    **{f"RELATIONAL_{name.upper()}": name for name in ("eq", "neq", "lt", "leq", "gt", "geq")},
}
VALUES = {"CONSTANT_PI": "pi", "CONSTANT_E": "exponentiale", "CONSTANT_TRUE": "true", "CONSTANT_FALSE": "false"}


def read_sbml(path: Path, time_unit: str = "s") -> NetworkModel:
    """Read a model of SBML Level 1, 2 or 3.

    Parameters
    ----------
    path : Path
        The file.
    time_unit : str
        Unit of time of the model: "s", "min", "h" or "d".

    Raises
    ------
    InputError
        If libsbml is not installed, the file is not valid, or the model uses features that are not supported; they are named.
    """
    try:
        import libsbml  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(MISSING) from None
    document = libsbml.readSBMLFromString(_text(path))
    _refuse_faulty(path, document, libsbml)
    unsupported = list(dict.fromkeys(_unsupported(document, libsbml)))
    if unsupported:
        raise InputError(f"{path} uses {', '.join(unsupported)}, which cicatrix does not support")
    for conversion in CONVERSIONS:
        properties = libsbml.ConversionProperties()
        properties.addOption(conversion, True)
        if document.convert(properties) != libsbml.LIBSBML_OPERATION_SUCCESS:
            raise InputError(f"{path}: libsbml could not convert it ({conversion})")
    return _Reader(path, document.getModel(), libsbml).model(unit_factor(time_unit, "s"))


def _text(path: Path) -> str:
    text = text_of(path)
    if not text.strip():
        raise InputError(f"{path} is empty")
    if not re.search(r"<(\w+:)?sbml\b", text):
        raise InputError(f"{path} is not an SBML file: there is no <sbml> in it")
    return text


def _refuse_faulty(path: Path, document: Any, libsbml: Any) -> None:
    document.checkInternalConsistency()
    for k in range(document.getNumErrors()):
        error = document.getError(k)
        if error.getSeverity() >= libsbml.LIBSBML_SEV_ERROR:
            words = " ".join(error.getMessage().split())
            raise InputError(f"{path}: line {error.getLine()}: not valid SBML: {words[:300]}")
    if document.getModel() is None:
        raise InputError(f"{path}: contains no SBML model")


def _unsupported(document: Any, libsbml: Any) -> Iterator[str]:
    """Yield the features of a model that Kinetics cannot represent, in words."""
    model = document.getModel()
    for k in range(document.getNumPlugins()):
        name = document.getPlugin(k).getPackageName()
        if name not in ("layout", "render", "groups", "annot", "l3v2extendedmath"):
            yield f'the package "{name}"'
    if model.getNumEvents():
        yield "events"
    if any(rule.isAlgebraic() for rule in model.getListOfRules()):
        yield "algebraic rules"
    if any(reaction.isSetFast() and reaction.getFast() for reaction in model.getListOfReactions()):
        yield "fast reactions"
    if model.isSetConversionFactor() or any(one.isSetConversionFactor() for one in model.getListOfSpecies()):
        yield "conversion factors"
    changed = {rule.getVariable() for rule in model.getListOfRules()}
    if any(one.getId() in changed for one in model.getListOfCompartments()):
        yield "compartments of variable size"
    changed |= {one.getSymbol() for one in model.getListOfInitialAssignments()}
    for reaction in model.getListOfReactions():
        for one in (*reaction.getListOfReactants(), *reaction.getListOfProducts()):
            if one.isSetStoichiometryMath() or (one.isSetId() and one.getId() in changed):
                yield "computed stoichiometries"
    for math in _all_math(model):
        yield from _unsupported_in(math, libsbml)


def _all_math(model: Any) -> Iterator[Any]:
    owners = [*model.getListOfRules(), *model.getListOfInitialAssignments(), *model.getListOfFunctionDefinitions()]
    owners += [one.getKineticLaw() for one in model.getListOfReactions() if one.isSetKineticLaw()]
    for owner in owners:
        if owner.isSetMath():
            yield owner.getMath()


def _unsupported_in(node: Any, libsbml: Any) -> Iterator[str]:
    names = {libsbml.AST_FUNCTION_DELAY: "delays", getattr(libsbml, "AST_FUNCTION_RATE_OF", -1): "rateOf"}
    if node.getType() in names:
        yield names[node.getType()]
    for k in range(node.getNumChildren()):
        yield from _unsupported_in(node.getChild(k), libsbml)


class _Reader:
    """Converter of one SBML model to :class:`.Kinetics`."""

    def __init__(self, path: Path, model: Any, libsbml: Any):
        self.path, self.source = path, model
        types = {getattr(libsbml, name): name[4:] for name in dir(libsbml) if name.startswith("AST_")}
        self.word_of: Callable[[int], str] = types.__getitem__
        self.volume = {one.getId(): one.getCompartment() for one in model.getListOfSpecies() if self._is_dense(one)}
        rules = [(one.getVariable(), one.isRate(), self._math(one)) for one in model.getListOfRules()]
        self.rate_rules = {name: rule for name, is_rate, rule in rules if is_rate}
        self.assigned = {name: rule for name, is_rate, rule in rules if not is_rate}
        self.assigned |= {
            one.getId(): self._math(one.getKineticLaw()) for one in model.getListOfReactions() if one.isSetKineticLaw()
        }
        self.initial = {one.getSymbol(): self._math(one) for one in model.getListOfInitialAssignments()}

    def model(self, seconds: float) -> NetworkModel:
        """Separate states from constants, evaluate their initial values, and build the model."""
        self._refuse_without_law()
        rates = self._reactions() | self.rate_rules
        if not rates:
            raise InputError(f"{self.path}: nothing changes in this model: it has no reaction and no rate rule")
        everything = [
            *self.source.getListOfCompartments(),
            *self.source.getListOfSpecies(),
            *self.source.getListOfParameters(),
        ]
        constants = [one.getId() for one in everything if one.getId() not in rates and one.getId() not in self.assigned]
        self._refuse_unknown({*constants, *rates, *self.assigned})
        order = self._ordered({**self.assigned}, {*constants, *rates, TIME})
        given = self._start({one.getId(): self._given(one) for one in everything}, [*constants, *rates])
        values = np.array([given[name] for name in constants])
        law = Kinetics(tuple(rates), tuple(constants), values, order, tuple(rates.values()), seconds)
        start = np.array([given[name] for name in rates])
        high = np.where(start > 0.0, 2.0 * start, 1.0)
        computed = [one.getId() for one in self.source.getListOfSpecies() if one.getId() in self.assigned]
        notes = [f'Species "{name}" is computed by a rule and has no column of its own.' for name in computed]
        return NetworkModel(law, start, values, high, None, False, tuple(notes))

    def _refuse_without_law(self) -> None:
        for reaction in self.source.getListOfReactions():
            if not reaction.isSetKineticLaw():
                raise InputError(f'{self.path}: reaction "{reaction.getId()}" has no kinetic law')

    def _refuse_unknown(self, known: set[str]) -> None:
        reactions = {one.getId() for one in self.source.getListOfReactions()}
        for name, rule in (self.assigned | self.rate_rules).items():
            for one in sorted(names_in(rule) - known - {TIME}):
                kind = "reaction" if name in reactions else "the rule of"
                raise InputError(f'{self.path}: {kind} "{name}" {unknown_species(one, known, "id")}')

    def _reactions(self) -> dict[str, Expression]:
        """Return the rate of change of each species that takes part in reactions, as an expression by name."""
        parts: dict[str, list[Expression]] = {}
        changing = {
            one.getId()
            for one in self.source.getListOfSpecies()
            if not (one.getBoundaryCondition() or one.getConstant())
        }
        for reaction in self.source.getListOfReactions():
            for sign, side in ((-1.0, reaction.getListOfReactants()), (1.0, reaction.getListOfProducts())):
                for one in side:
                    if one.getSpecies() in changing and reaction.getId() in self.assigned:
                        n = one.getStoichiometry() if one.isSetStoichiometry() else 1.0
                        part = ("times", ("number", sign * n), ("name", reaction.getId()))
                        parts.setdefault(one.getSpecies(), []).append(part)
        return {name: self._per_volume(name, ("plus", *sum_of)) for name, sum_of in parts.items()}

    def _per_volume(self, name: str, rate: Expression) -> Expression:
        return ("divide", rate, ("name", self.volume[name])) if name in self.volume else rate

    def _is_dense(self, species: Any) -> bool:
        """Return whether the symbol of a species stands for a concentration, not for an amount."""
        compartment = self.source.getCompartment(species.getCompartment())
        return not species.getHasOnlySubstanceUnits() and compartment.getSpatialDimensionsAsDouble() > 0.0

    def _given(self, one: Any) -> Expression | None:
        """Return the initial value from the attributes of an SBML compartment, parameter or species; None if there is none."""
        if one.getElementName() == "compartment":
            return ("number", one.getSize()) if one.isSetSize() else ("number", 1.0)
        if one.getElementName() == "parameter":
            return ("number", one.getValue()) if one.isSetValue() else None
        volume = ("name", one.getCompartment())
        is_dense = one.getId() in self.volume
        if one.isSetInitialAmount():
            amount = ("number", one.getInitialAmount())
            return ("divide", amount, volume) if is_dense else amount
        if one.isSetInitialConcentration():
            density = ("number", one.getInitialConcentration())
            return density if is_dense else ("times", density, volume)
        return None

    def _start(self, given: dict[str, Expression | None], asked: list[str]) -> dict[str, float]:
        """Evaluate the symbols in ``asked``, and all symbols on which they depend, at time 0: name -> value."""
        rules = {name: rule for name, rule in (given | self.initial | self.assigned).items() if rule is not None}
        needed, found = self._closure(rules, asked), {TIME: 0.0}
        for name, rule in self._ordered({name: rules[name] for name in needed}, {TIME}):
            found[name] = float(np.asarray(evaluate(rule, found)))
            if not np.isfinite(found[name]):
                raise InputError(f'{self.path}: "{name}" starts at {found[name]}, which is not a finite number')
        return found

    def _closure(self, rules: dict[str, Expression], asked: list[str]) -> set[str]:
        needed, left = set(), list(asked)
        while left:
            name = left.pop()
            if name not in rules:
                raise InputError(f'{self.path}: "{name}" has no initial value')
            if name not in needed:
                needed.add(name)
                left += names_in(rules[name]) - {TIME}
        return needed

    def _ordered(self, rules: dict[str, Expression], known: set[str]) -> tuple[tuple[str, Expression], ...]:
        """Sort rules so that each depends only on those before it."""
        order, known, left = [], set(known), dict(rules)
        while left:
            ready = [name for name, rule in left.items() if names_in(rule) <= known]
            if not ready:
                raise InputError(f"{self.path}: the rules of {', '.join(sorted(left))} depend on each other")
            order += [(name, left.pop(name)) for name in ready]
            known |= set(ready)
        return tuple(order)

    def _math(self, owner: Any) -> Expression:
        if not owner.isSetMath():
            raise InputError(f"{self.path}: a rule, an assignment or a kinetic law has no formula")
        return self._expression(owner.getMath())

    def _expression(self, node: Any) -> Expression:
        """Convert a formula from libsbml's nodes to an expression of Kinetics."""
        word = self.word_of(node.getType())
        if node.isNumber():
            return ("number", float(node.getValue()))
        if word == "NAME_TIME":
            return (TIME,)
        if word == "NAME_AVOGADRO":
            return ("number", CONSTANTS["avogadro"])
        if word in VALUES:
            return ("number", CONSTANTS[VALUES[word]])
        if word == "NAME":
            return ("name", node.getName())
        if word not in WORDS:
            name = node.getName() or word.lower()
            raise InputError(f'{self.path}: uses the function "{name}", which cicatrix does not support')
        return (WORDS[word], *(self._expression(node.getChild(k)) for k in range(node.getNumChildren())))

"""Formulas of SBML: from libsbml's nodes to expressions, and from expressions to MathML."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from ..biology.expressions import BOOLEAN, CONSTANTS, FUNCTIONS, RECIPROCALS, TIME, Expression, name, number
from ..core.errors import InputError
from .sbml_document import libsbml_module

RATE = "rateOf "  # before the name of a quantity: its rate of change; no id of SBML holds a space
WORDS = {  # type of a libsbml node, without the prefix AST_ -> word of an expression
    "PLUS": "plus",
    "MINUS": "minus",
    "TIMES": "times",
    "DIVIDE": "divide",
    "POWER": "power",
    "FUNCTION_POWER": "power",
    "FUNCTION_ROOT": "root",
    "FUNCTION_LOG": "log",
    "FUNCTION_LN": "ln",
    **{f"FUNCTION_{word.upper()}": word for word in FUNCTIONS},
    **{f"LOGICAL_{word.upper()}": word for word in ("and", "or", "xor", "not", "implies")},
    **{f"RELATIONAL_{word.upper()}": word for word in ("eq", "neq", "lt", "leq", "gt", "geq")},
}
PAIRS = ("divide", "power", "root", "log", "quotient", "rem", "implies", "neq")
LISTS = {
    "plus": 0,
    "times": 0,
    "and": 0,
    "or": 0,
    "xor": 0,
    "min": 1,
    "max": 1,
    "piecewise": 1,
}  # least number of arguments
LISTS |= {"eq": 2, "lt": 2, "leq": 2, "gt": 2, "geq": 2}
VALUES = {"CONSTANT_PI": "pi", "CONSTANT_E": "exponentiale", "CONSTANT_TRUE": "true", "CONSTANT_FALSE": "false"}


@cache
def _types() -> dict[int, str]:
    libsbml = libsbml_module()
    return {getattr(libsbml, word): word[4:] for word in dir(libsbml) if word.startswith("AST_")}


def expression_of(node: Any) -> Expression:
    """Convert a formula from libsbml's nodes to an expression.

    Raises
    ------
    InputError
        If it holds a delay or a function that is not known; the message has no file's name.
    """
    word = _types()[node.getType()]
    if node.isNumber():
        return number(node.getValue())
    if word == "NAME_TIME":
        return (TIME,)
    if word == "NAME_AVOGADRO":
        return number(CONSTANTS["avogadro"])
    if word in VALUES:
        return ("number", CONSTANTS[VALUES[word]])
    if word == "NAME":
        return name(node.getName())
    if word == "FUNCTION_RATE_OF":
        return name(RATE + node.getChild(0).getName())
    if word == "FUNCTION_DELAY":
        raise InputError("uses delays (values of the past), which neither cicatrix nor libroadrunner can integrate")
    if word not in WORDS:
        raise InputError(f'uses the function "{node.getName() or word.lower()}", which cicatrix does not support')
    return _joined(WORDS[word], [expression_of(one) for one in _operands(WORDS[word], node)])


def _operands(word: str, node: Any) -> list[Any]:
    """Return the arguments of a function; those of the long sum or product that libsbml nests in its first argument, at once."""
    backwards: list[Any] = []
    while True:
        parts = [node.getChild(k) for k in range(_arguments(word, node))]
        is_longer = word in ("plus", "times") and len(parts) > 1 and parts[0].getType() == node.getType()
        backwards += reversed(parts[1:] if is_longer else parts)
        if not is_longer:
            return backwards[::-1]
        node = parts[0]


def _arguments(word: str, node: Any) -> int:
    """Return how many arguments a function has; refuse a number that it cannot have."""
    found = node.getNumChildren()
    least, most = (2, 2) if word in PAIRS else (1, 2 if word == "minus" else 1)
    if not (LISTS[word] <= found if word in LISTS else least <= found <= most):
        raise InputError(f"gives <{word}/> {found} arguments, which is not what this function takes")
    return found


def _joined(word: str, parts: list[Expression]) -> Expression:
    """Return a function of its arguments; a sum of a sum is one sum, so that long ones are not deep."""
    if word in ("plus", "times") and parts and parts[0][0] == word:
        return (*parts[0], *parts[1:])
    if word == "minus" and len(parts) == 1 and parts[0][0] == "number":
        return number(-parts[0][1])
    return (word, *parts)


def is_boolean(expression: Expression) -> bool:
    """Return whether an expression is true or false, not a number."""
    word, *parts = expression
    if word == "piecewise":
        return is_boolean(parts[0])
    return word in BOOLEAN or (word == "number" and isinstance(parts[0], bool))


def mathml(expression: Expression, ids: Mapping[str, str], boolean: bool = False) -> str:
    """Write an expression as MathML where a number (or a truth value, if ``boolean``) is due; ``ids`` renames its names."""
    if is_boolean(expression) != boolean:
        return _converted(expression, ids, boolean)
    word, *parts = expression
    if word == "number":
        return _number(parts[0])
    if word == "name":
        return f"<ci>{ids[parts[0]]}</ci>"
    if word == TIME:
        return '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/time">t</csymbol>'
    if word == "piecewise":
        return _pieces(parts, ids, boolean)
    if (plain := _plain(word, parts)) is not None:
        return mathml(plain, ids)
    of_truth = word in ("and", "or", "xor", "not", "implies") or (word in ("eq", "neq") and all(map(is_boolean, parts)))
    inside = [mathml(part, ids, of_truth) for part in parts]
    if word in ("root", "log"):
        inside[0] = f"<degree>{inside[0]}</degree>" if word == "root" else f"<logbase>{inside[0]}</logbase>"
    return f"<apply><{word}/>{''.join(inside)}</apply>"


def _plain(word: str, parts: list[Expression]) -> Expression | None:
    """Return secant, cosecant and cotangent, and their inverses, by cosine, sine and tangent; None for other functions."""
    if word in RECIPROCALS:
        return ("divide", number(1.0), (RECIPROCALS[word], *parts))
    if word.startswith("arc") and word[3:] in RECIPROCALS:
        return (f"arc{RECIPROCALS[word[3:]]}", ("divide", number(1.0), *parts))
    return None


def _converted(expression: Expression, ids: Mapping[str, str], boolean: bool) -> str:
    """Write a number where a truth value is due, or the other way round: 0 is false, true is 1."""
    inside = mathml(expression, ids, not boolean)
    if boolean:
        return f"<apply><neq/>{inside}<cn>0</cn></apply>"
    return f"<piecewise><piece><cn>1</cn>{inside}</piece><otherwise><cn>0</cn></otherwise></piecewise>"


def _pieces(parts: list[Expression], ids: Mapping[str, str], boolean: bool) -> str:
    pieces = [
        f"<piece>{mathml(value, ids, boolean)}{mathml(condition, ids, True)}</piece>"
        for value, condition in zip(parts[0::2], parts[1::2])
    ]
    rest = f"<otherwise>{mathml(parts[-1], ids, boolean)}</otherwise>" if len(parts) % 2 else ""
    return f"<piecewise>{''.join(pieces)}{rest}</piecewise>"


def _number(value: float | bool) -> str:
    if isinstance(value, bool):
        return f"<{str(value).lower()}/>"
    words = {"inf": "<infinity/>", "-inf": "<apply><minus/><infinity/></apply>", "nan": "<notanumber/>"}
    mantissa, _, exponent = f"{value:.17g}".partition("e")
    if str(value) in words:
        return words[str(value)]
    return f'<cn type="e-notation">{mantissa}<sep/>{int(exponent)}</cn>' if exponent else f"<cn>{mantissa}</cn>"

"""Reading of an SBML document by libsbml: checked, flattened, its functions and local parameters expanded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from ..core.errors import InputError
from .sbml_text import sbml_text

MISSING = "needs python-libsbml to read SBML: pip install 'cicatrix[sbml]'"
HARMLESS = (
    "layout",
    "render",
    "groups",
    "annot",
    "l3v2extendedmath",
    "comp",
)  # packages that change no number, or are expanded
TOLERATED = (  # numbers of rules of SBML
    10215,  # formulas name known ids only: the translation says which one does not, and the nearest
    21121,  # a rate names its species as reactants, products or modifiers: many files omit modifiers, and no number depends on it
)
LARGEST = 1_000_000  # terms of all formulas after functions are expanded


def libsbml_module() -> ModuleType:
    """Return libsbml.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import libsbml  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(MISSING) from None
    return libsbml


def read_document(path: Path) -> Any:
    """Return the document in a file, valid by libsbml's consistency checks, flat, without functions and local parameters.

    Raises
    ------
    InputError
        If libsbml is not installed, or the file is no SBML, breaks one of SBML's rules, or cannot be flattened.
    """
    libsbml = libsbml_module()
    document = libsbml.readSBMLFromString(sbml_text(path))
    document.setLocationURI(f"file:{path.absolute()}")  # files that it refers to are searched beside it
    _refuse_faulty(path, document, libsbml)
    _refuse_packages(path, document)
    if document.getPlugin("comp") is not None:
        _flatten(path, document, libsbml)
    _refuse_exploding(path, document.getModel(), libsbml)
    for conversion in ("expandFunctionDefinitions", "promoteLocalParameters"):
        _convert(path, document, libsbml, conversion)
    return document


def _refuse_faulty(path: Path, document: Any, libsbml: ModuleType) -> None:
    """Refuse the first error of SBML's validation rules; those on units, style and ontology terms change no number."""
    for unasked in ("UNITS_CONSISTENCY", "MODELING_PRACTICE", "SBO_CONSISTENCY"):
        document.setConsistencyChecks(getattr(libsbml, f"LIBSBML_CAT_{unasked}"), False)
    if not document.getNumErrors(libsbml.LIBSBML_SEV_ERROR) and not document.getNumErrors(libsbml.LIBSBML_SEV_FATAL):
        document.checkConsistency()
    for k in range(document.getNumErrors()):
        error = document.getError(k)
        is_fault = error.getSeverity() in (libsbml.LIBSBML_SEV_ERROR, libsbml.LIBSBML_SEV_FATAL)
        if is_fault and error.getErrorId() not in TOLERATED:
            words = " ".join(error.getMessage().split())
            raise InputError(f"{path}: line {error.getLine()}: not valid SBML: {_short(words)}")
    if document.getModel() is None:
        raise InputError(f"{path}: contains no SBML model")


def _short(words: str) -> str:
    """Return the end of libsbml's message, which names the element, after the first words of the rule it breaks."""
    rule, marked, instance = words.partition(" Reference: ")
    return (
        f"{rule[:200]}{'...' if len(rule) > 200 else ''} {instance.partition(' The ')[2][:200]}"
        if marked
        else words[:300]
    )


def _refuse_packages(path: Path, document: Any) -> None:
    names = [document.getPlugin(k).getPackageName() for k in range(document.getNumPlugins())]
    for name in names:
        if name not in HARMLESS and document.getPackageRequired(name):
            raise InputError(f'{path} uses the package "{name}", which cicatrix does not support')
    for k in range(document.getNumUnknownPackages()):
        if document.getPackageRequired(document.getUnknownPackageURI(k)):
            raise InputError(
                f'{path} uses the package "{document.getUnknownPackageURI(k)}", which cicatrix does not support'
            )


def _flatten(path: Path, document: Any, libsbml: ModuleType) -> None:
    """Replace submodels by their content."""
    properties = libsbml.ConversionProperties()
    properties.addOption("flatten comp", True)
    properties.addOption("performValidation", False)
    properties.addOption("basePath", str(path.parent))
    properties.addOption("abortIfUnflattenable", "requiredOnly")
    if document.convert(properties) != libsbml.LIBSBML_OPERATION_SUCCESS:
        raise InputError(
            f"{path}: libsbml could not put its submodels together; flatten the model (package comp) first"
        )


def _convert(path: Path, document: Any, libsbml: ModuleType, conversion: str) -> None:
    properties = libsbml.ConversionProperties()
    properties.addOption(conversion, True)
    if document.convert(properties) != libsbml.LIBSBML_OPERATION_SUCCESS:
        raise InputError(f"{path}: libsbml could not convert it ({conversion})")


def _refuse_exploding(path: Path, model: Any, libsbml: ModuleType) -> None:
    """Refuse functions of functions that would expand beyond memory or to formulas too deep to evaluate."""
    sizes: dict[str, int] = {}
    for one in model.getListOfFunctionDefinitions():
        if one.isSetMath():
            sizes[one.getId()] = _size(one.getMath(), sizes, libsbml)
    total = sum(_size(math, sizes, libsbml) for math in formulas(model))
    if max(total, *sizes.values(), 0) > LARGEST:
        raise InputError(f"{path}: its functions expand to more than {LARGEST} terms; simplify them")


def _size(node: Any, sizes: dict[str, int], libsbml: ModuleType) -> int:
    size, left = 0, [node]
    while left:  # not by recursion: libsbml nests a long sum as deep as it has terms
        one = left.pop()
        size += sizes.get(one.getName(), 1) if one.getType() == libsbml.AST_FUNCTION else 1
        left += [one.getChild(k) for k in range(one.getNumChildren())]
    return min(size, 10 * LARGEST)


def formulas(model: Any) -> Iterator[Any]:
    """Yield every formula of a model that determines a value, as a node of libsbml."""
    owners = [*model.getListOfRules(), *model.getListOfInitialAssignments()]
    owners += [one.getKineticLaw() for one in model.getListOfReactions() if one.isSetKineticLaw()]
    for event in model.getListOfEvents():
        owners += [one for one in (event.getTrigger(), event.getDelay(), event.getPriority()) if one is not None]
        owners += [*event.getListOfEventAssignments()]
    for reaction in model.getListOfReactions():
        for one in (*reaction.getListOfReactants(), *reaction.getListOfProducts()):
            owners += [one.getStoichiometryMath()] if one.isSetStoichiometryMath() else []
    yield from (owner.getMath() for owner in owners if owner.isSetMath())

"""Kinds of case by name; the code of a kind is loaded when a case of it is first read or run.

A new kind is a folder beside this file, named after the kind, and a line in :data:`KINDS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from importlib import import_module, resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from ..cases.reading import kind_of, read_tables
from ..cases.table import Case
from ..core.errors import InputError


class Entry(NamedTuple):
    """Names in the package of a kind: its case type in ``case.py``, its simulation in ``run.py``."""

    case: str
    simulation: str


KINDS = {
    "lumpectomy": Entry("LumpectomyCase", "LumpectomyRun"),
    "automaton": Entry("AutomatonCase", "AutomatonRun"),
    "equilibrium": Entry("EquilibriumCase", "EquilibriumRun"),
    "material-point": Entry("PointCase", "MaterialPoint"),
    "adhesion": Entry("AdhesionCase", "AdhesionRun"),
    "signalling": Entry("SignallingCase", "SignallingRun"),
    "tissue-cell": Entry("TissueCellCase", "TissueCellRun"),
    "wound": Entry("WoundCase", "WoundRun"),
}


def case_type(kind: str) -> type[Case]:
    """Return the type of a kind's cases."""
    return getattr(_module(kind, "case"), KINDS[kind].case)


def load_case(
    path: str | Path, overrides: Sequence[str] = (), spare: Mapping[str, Mapping[str, Any]] | None = None
) -> Any:
    """Read and check a case file.

    Parameters
    ----------
    path : str or Path
        The TOML file; paths in it are relative to it, or start with ``data:``.
    overrides : sequence of str
        ``key.path=value`` each, as after ``--set``.
    spare : mapping, optional
        Keys by table, which are added to the table where the file gives none of them.

    Returns
    -------
    Case
        The case, of the type of its kind (such as ``LumpectomyCase``), its paths absolute.

    Raises
    ------
    InputError
        If the case is invalid; the message states the first fault and how many more there are.
    """
    case, faults = _examined(Path(path), overrides, spare or {})
    if case is None:
        more = f" (and {len(faults) - 1} more: cicatrix check {path} lists them)" if len(faults) > 1 else ""
        raise InputError(f"{path}: {faults[0]}{more}")
    return case


def case_from(tables: Mapping[str, Any], folder: str | Path = ".") -> Any:
    """Check a case given as nested tables, as a TOML file would hold them.

    Parameters
    ----------
    tables : mapping
        ``kind`` and the tables of that kind.
    folder : str or Path
        Folder that relative paths start from.

    Raises
    ------
    InputError
        If a value is not valid; the message lists every fault.
    """
    case, faults = case_type(kind_of(tables, KINDS)).checked(tables, Path(folder))
    if case is None:
        raise InputError("; ".join(faults))
    return case


def demo_case() -> Any:
    """Return the case that ``cicatrix demo`` runs."""
    with resources.as_file(resources.files("cicatrix.kinds.lumpectomy") / "demo.toml") as path:
        return load_case(path)


def check_case(path: str | Path, overrides: Sequence[str] = ()) -> list[str]:
    """Return every fault of a case file and of the files that it names, one sentence each; an empty list if there is none."""
    return examine(path, overrides)[0]


def examine(path: str | Path, overrides: Sequence[str] = ()) -> tuple[list[str], list[str]]:
    """Return every fault of a case file and of the files that it names, and notes on them, one sentence each.

    Files are opened as a run opens them, by the functions ``PARTS`` of the kind's ``check.py``, each under the key that has to
    be given for it; a large image is opened as far as its header.
    """
    case, faults = _examined(Path(path), overrides)
    if case is None or not case.files:
        return faults, []
    notes: list[str] = []
    for key, part in _module(case.kind, "check").PARTS.items():
        if _is_given(case, key):
            try:
                notes += part(case) or ()
            except InputError as error:
                faults.append(" ".join(str(error).split()))
    return faults, notes


def simulation_type(kind: str) -> Any:
    """Return the simulation of a kind: see :class:`..runs.kind.Simulation`."""
    return getattr(_module(kind, "run"), KINDS[kind].simulation)


def _examined(
    path: Path, overrides: Sequence[str], spare: Mapping[str, Mapping[str, Any]] = MappingProxyType({})
) -> tuple[Any, list[str]]:
    try:
        tables = read_tables(path, overrides)
        kind = case_type(kind_of(tables, KINDS))
    except InputError as error:
        return None, [str(error)]
    for name, keys in spare.items():
        table = tables.setdefault(name, {}) if name in kind.model_fields else None
        if isinstance(table, dict) and not table.keys() & keys.keys():
            table |= keys
    return kind.checked(tables, path.parent)


def _is_given(case: Any, key: str) -> bool:
    return reduce(lambda table, name: getattr(table, name, None), key.split("."), case) is not None


def _module(kind: str, name: str) -> Any:
    return import_module(f".{kind.replace('-', '_')}.{name}", __package__)

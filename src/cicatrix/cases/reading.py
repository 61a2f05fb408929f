"""Reading of case files: from TOML to a checked case; every fault is reported in a sentence that names its key."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from .nested import copied, files_in, names_of, put
from .sentences import either, shown
from .table import Case


def apply_overrides(raw: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Return the tables with ``key.path=value`` settings applied; a value that is not valid TOML is used as a string.

    Parameters
    ----------
    raw : mapping
        Tables as read from TOML; not changed.
    overrides : sequence of str
        Settings, such as ``run.seed=3``, or ``law.0.mu_kPa=2`` for the first table of a list; later ones win.

    Raises
    ------
    InputError
        If a setting has no ``=``, or a key before the last one in its path is not a table.
    """
    tables = copied(raw)
    for setting in overrides:
        key, equals, text = setting.partition("=")
        names = names_of(key)
        if not equals or not all(names):
            raise InputError(f"--set {setting}: must read key.path=value, such as run.seed=3")
        put(tables, names, _toml_value(text.strip()), f"--set {setting}")
    return tables


def read_tables(path: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Read a TOML file and apply ``key.path=value`` settings to its tables.

    Raises
    ------
    InputError
        If it cannot be read or is not valid TOML; the caller puts the file's name before the message.
    """
    return apply_overrides(_read_toml(path), overrides)


def kind_of(tables: Mapping[str, Any], known: Iterable[str]) -> str:
    """Return the kind of a case from its tables.

    Raises
    ------
    InputError
        If the tables name no kind, or one that is not among ``known``.
    """
    kind, known = tables.get("kind"), list(known)
    if kind is None:
        raise InputError(f"kind is missing; a case file starts with kind = {either(known)}")
    if not isinstance(kind, str) or kind not in known:
        raise InputError(f"kind must be {either(known)}; got {shown(kind)}")
    return kind


def case_table(case: Case) -> dict[str, Any]:
    """Return a case as nested tables of plain values for the manifest; a file is named without its folder.

    Folder names can identify a patient, and the manifest identifies the content of a file by its hash.
    """
    table = case.model_dump(mode="python")
    for within, key in files_in(table, case.files).values():
        if isinstance(within[key], Path):
            within[key] = within[key].name
    return json.loads(json.dumps(table))


def input_files(case: Case) -> dict[str, Path]:
    """Return the files and folders that a case reads, by key."""
    found = files_in(case.model_dump(mode="python"), case.files)
    return {name: within[key] for name, (within, key) in found.items() if isinstance(within[key], Path)}


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not valid TOML: {error}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"is not a text file in UTF-8 (byte {error.start})") from None
    except IsADirectoryError:
        raise InputError("is a folder; a case file is needed") from None
    except FileNotFoundError:
        raise InputError("there is no such case file") from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}") from None


def _toml_value(text: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return parsed["value"] if len(parsed) == 1 else text

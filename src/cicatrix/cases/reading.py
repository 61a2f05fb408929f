"""Reading of case files: from TOML to a checked case; every fault is reported in a sentence that names its key."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..files.bare_names import bare_name
from ..files.text import text_of
from .nested import copied, files_in, names_of, put
from .paths import BACKSLASH
from .sentences import either, shown
from .table import Case

LARGEST = 10_000_000  # bytes of a case file
HINTS = (  # pattern of a line that TOML refuses, and what would be right
    (r'"[^"]*\\', BACKSLASH),
    (r"=\s*[+-]?[0-9]+,[0-9]+\s*(#|$)", "a number has a decimal point, not a comma"),
    (r"=\s*(True|False)\b", "truth values are true and false"),
    ("[\u00a0\u2007\u202f\u200b\ufeff]", "it has a space that only looks like one, U+{:04X}: type it anew"),
    ("[\u201c\u201d\u201e\u2018\u2019]", "quotes must be straight: \" or '"),
)


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
        If a setting has no ``=``, a key before the last one in its path is not a table, or the tables are not :func:`.copied`.
    """
    tables = copied(raw)
    for setting in overrides:
        key, equals, text = setting.partition("=")
        names = names_of(key)
        if not equals or not all(names):
            raise InputError(f"--set {setting}: must read key.path=value, such as run.seed=3")
        put(tables, names, _toml_value(text.strip(), setting), f"--set {setting}")
    return copied(tables)


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
    """Return a case as nested tables of plain values for the manifest; of a file it says only what it is.

    Names of files and folders can identify a patient, and the manifest identifies the content of a file by its hash.
    """
    table = case.model_dump(mode="python")
    for within, key in files_in(table, case.files).values():
        if isinstance(within[key], Path):
            within[key] = bare_name(within[key])
    return json.loads(json.dumps(table))


def input_files(case: Case) -> dict[str, Path]:
    """Return the files and folders that a case reads, by key."""
    found = files_in(case.model_dump(mode="python"), case.files)
    return {name: within[key] for name, (within, key) in found.items() if isinstance(within[key], Path)}


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        text = text_of(path, LARGEST)
    except InputError as error:
        raise InputError(str(error).removeprefix(str(path)).lstrip(": ")) from None
    try:
        return _parsed(text)
    except tomllib.TOMLDecodeError as error:
        words = re.sub(r"\('[^()]*\)", _header, str(error))  # ('a', 'b') is how it writes the table [a.b]
        raise InputError(f"is not valid TOML: {words}{_hint(text, words)}") from None


def _parsed(text: str) -> dict[str, Any]:
    """Return TOML as tables; raise its own error, or an InputError where Python gives up."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise InputError("is not a case: tables or lists nest too deep") from None
    except ValueError:  # Python reads whole numbers of a few thousand digits at most
        raise InputError("is not valid TOML: a whole number has more than 64 bits") from None


def _toml_value(text: str, setting: str) -> Any:
    try:
        parsed = _parsed(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    except InputError as error:
        raise InputError(f"--set {setting}: {error}") from None
    return parsed["value"] if len(parsed) == 1 else text


def _header(names: re.Match[str]) -> str:
    return f"[{'.'.join(re.findall('[^(), ]+', names[0].replace(chr(39), '')))}]"


def _hint(text: str, message: str) -> str:
    """Return what is likely meant on the line that an error names."""
    place = re.search(r"line ([0-9]+)", message)
    line = text.split("\n")[int(place[1]) - 1] if place else ""
    found = ((re.search(pattern, line), words) for pattern, words in HINTS)
    return next((f"; {words.format(ord(match[0][0]))}" for match, words in found if match), "")

"""Case files: TOML in, a checked case out; every fault is told in a sentence that names its key."""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import ValidationError

from ..core.errors import InputError
from .bounds import FAULT, OUT_OF_RANGE
from .paths import input_path
from .table import Case, Table, tag_of

C = TypeVar("C", bound=Case)

TYPE_WORDS = {
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be a text",
    "path_type": "must be a text that names a file",
    "tuple_type": "must be a list",
    "model_type": "must be a table",
}


def apply_overrides(raw: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Return the tables with ``key.path=value`` settings applied; a value that is no TOML is taken as a text.

    Parameters
    ----------
    raw : mapping
        Tables as read from TOML; not changed.
    overrides : sequence of str
        Settings, such as ``run.seed=3``, or ``law.0.mu_kPa=2`` for the first table of a list; later ones win.

    Raises
    ------
    InputError
        If a setting has no ``=``, or leads through a key that is no table.
    """
    tables = _copy(raw)
    for setting in overrides:
        key, equals, text = setting.partition("=")
        names = [part.strip() for part in re.sub(r"\[(\d+)\]", r".\1", key).split(".")]
        if not equals or not all(names):
            raise InputError(f"--set {setting}: must read key.path=value, such as run.seed=3")
        _put(tables, names, _toml_value(text.strip()), setting)
    return tables


def read_tables(path: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Read a TOML file and apply ``key.path=value`` settings to its tables.

    Raises
    ------
    InputError
        If it cannot be read or is no TOML; the sentence lacks its subject, the file.
    """
    return apply_overrides(_read_toml(path), overrides)


def kind_of(tables: Mapping[str, Any], known: Iterable[str]) -> str:
    """Return the kind that the tables of a case name, one of those known.

    Raises
    ------
    InputError
        If they name none, or another one.
    """
    kind, known = tables.get("kind"), list(known)
    if kind is None:
        raise InputError(f"kind is missing; a case file starts with kind = {_either(known)}")
    if not isinstance(kind, str) or kind not in known:
        raise InputError(f"kind must be {_either(known)}; got {_show(kind)}")
    return kind


def checked(tables: Mapping[str, Any], kind: type[C], folder: Path) -> tuple[C | None, list[str]]:
    """Turn the tables of a case into a case, its paths resolved against a folder; None with its faults, a sentence each."""
    located, faults = _locate(_copy(tables), kind.files, folder)
    try:
        case = kind.model_validate(located)
    except ValidationError as error:
        return None, [_sentence(item, kind) for item in error.errors(include_url=False)] + faults
    return (None if faults else case), faults


def case_table(case: Case) -> dict[str, Any]:
    """Return a case as nested tables of plain values for the manifest; a file is named without its folder.

    Folder names can identify a patient, and they say nothing about content: the manifest's hashes do.
    """
    table = case.model_dump(mode="python")
    for within, key in _files_in(table, case.files).values():
        if isinstance(within[key], Path):
            within[key] = within[key].name
    return json.loads(json.dumps(table))


def input_files(case: Case) -> dict[str, Path]:
    """Return the files and folders that a case reads, by key."""
    found = _files_in(case.model_dump(mode="python"), case.files)
    return {name: within[key] for name, (within, key) in found.items() if isinstance(within[key], Path)}


def _files_in(tables: dict[str, Any], names: Sequence[str]) -> dict[str, tuple[dict[str, Any], str]]:
    """Table and key of the values that name files, as far as they are there, by their dotted names."""
    out = {}
    for name in names:
        *path, key = name.split(".")
        within: Any = tables
        for part in path:
            within = within.get(part) if isinstance(within, dict) else None
        if isinstance(within, dict) and key in within:
            out[name] = within, key
    return out


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


def _locate(raw: dict[str, Any], files: Sequence[str], folder: Path) -> tuple[dict[str, Any], list[str]]:
    """Resolve the paths of a case; a file that is not there is a fault."""
    faults = []
    for name, (table, key) in _files_in(raw, files).items():
        if isinstance(table[key], str):
            try:
                table[key] = input_path(table[key], folder)
            except InputError as error:
                table[key] = Path(table[key])  # one fault is enough
                faults.append(f"{name} {error}")
    return raw, faults


def _sentence(error: Mapping[str, Any], kind: type[Table]) -> str:
    """Put one validation error into words: which key, what would be right, what was found."""
    loc, name, value = error["loc"], error["type"], error["input"]
    context = error.get("ctx", {})
    key = _dotted(loc)
    if name == "union_tag_invalid":
        return _unknown_type(key, value, context["expected_tags"])
    if name == FAULT:
        return f"{_dotted((*loc, context['key']))} {context['sentence']}"
    if name == "extra_forbidden":
        return _unknown_key(loc, kind)
    if name == "missing":
        return f"{key} is missing"
    if name == "tuple_type" and isinstance(value, Mapping):
        return f"{key} must be a list of tables: write [[{key}]]; got [{key}]"
    if name == OUT_OF_RANGE:
        words = context["words"]
    elif name == "literal_error":
        words = "must be " + context["expected"].replace("'", '"')
    else:
        words = TYPE_WORDS.get(name, "is not understood")
    return f"{key} {words}; got {_show(value)}"


def _unknown_type(key: str, value: Any, tags: str) -> str:
    """Say which types there are where a table names none of them."""
    if not isinstance(value, Mapping):
        return f"{key} must be a table; got {_show(value)}"
    known = [tag.strip("'<>") for tag in tags.split(", ") if tag.strip("'<>")]
    found = f"got {_show(value['type'])}" if "type" in value else "it is missing"
    near = difflib.get_close_matches(str(value.get("type")).lower(), known, n=1)
    hint = f', did you mean "{near[0]}"?' if near else ""
    return f"{key}.type must be {_either(known)}; {found}{hint}"


def _unknown_key(loc: Sequence[str | int], kind: type[Table]) -> str:
    """Name the nearest known key: first in the same table, then the same name in another one."""
    key, known = _dotted(loc), _known_keys(kind)
    prefix = _dotted(loc[:-1])
    siblings = list(dict.fromkeys(name for table in _tables_at(loc[:-1], kind) for name in table.model_fields))
    leaf, start = str(loc[-1]), f"{prefix}." if prefix else ""
    by_leaf = {name.lower(): name for name in siblings}
    without_unit = [name for name in by_leaf if name.startswith(f"{leaf.lower()}_")]
    near = without_unit[:1] or difflib.get_close_matches(leaf.lower(), by_leaf, n=1)
    if near:
        return f"{key} is not a known key; did you mean {start}{by_leaf[near[0]]}?"
    elsewhere = [name for name in known if name.rpartition(".")[2] == leaf]
    if elsewhere:
        return f"{key} is not a known key; did you mean {' or '.join(elsewhere)}?"
    where = f"[{prefix}]" if prefix else "the file"
    return f"{key} is not a known key; known in {where}: {', '.join(siblings)}"


def _known_keys(table: type[Table], prefix: str = "") -> list[str]:
    """Dotted keys of a table and those below it; of lists of tables, which may hold their like, the name alone."""
    names: list[str] = []
    for name, field in table.model_fields.items():
        names.append(prefix + name)
        for candidate in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(candidate, type) and issubclass(candidate, Table):
                names += _known_keys(candidate, f"{prefix}{name}.")
    return names


def _tables_at(loc: Sequence[str | int], kind: type[Table]) -> list[type[Table]]:
    """The types that the table at a place may have; one where the place has the tag of its type."""
    found: list[type[Table]] = [kind]
    for part in loc:
        if isinstance(part, str) and part.startswith("<"):
            found = [table for table in found if part == tag_of(*get_args(table.model_fields["type"].annotation))]
        elif isinstance(part, str):
            fields = [table.model_fields[part] for table in found if part in table.model_fields]
            found = [table for field in fields for table in _tables_in(field.annotation)]
    return found


def _tables_in(annotation: Any) -> list[type[Table]]:
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return [annotation]
    return [table for part in get_args(annotation) for table in _tables_in(part)]


def _dotted(loc: Sequence[str | int]) -> str:
    """A place as it is written; the tags of types in it are not."""
    parts = [part for part in loc if not str(part).startswith("<")]
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).lstrip(".")


def _show(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_show(item) for item in value)}]"
    return str(value)


def _either(names: Iterable[str]) -> str:
    *some, last = (f'"{name}"' for name in names)
    return f"{', '.join(some)} or {last}" if some else last


def _toml_value(text: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return parsed["value"] if len(parsed) == 1 else text


def _copy(value: Any) -> Any:
    """Copy nested tables and lists, so that the copy may be changed."""
    if isinstance(value, Mapping):
        return {key: _copy(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_copy(item) for item in value]
    return value


def _put(tables: dict[str, Any], names: list[str], value: Any, setting: str) -> None:
    for depth, name in enumerate(names[:-1]):
        if name in tables and isinstance(tables[name], list):
            return _put_in_list(tables[name], names[depth:], value, setting)
        tables = tables.setdefault(name, {})
        if not isinstance(tables, dict):
            raise InputError(f"--set {setting}: {'.'.join(names[: depth + 1])} is not a table")
    tables[names[-1]] = value
    return None


def _put_in_list(items: list[Any], names: list[str], value: Any, setting: str) -> None:
    """Go on in a list: ``names`` are its own name, a number from 0, and what is below."""
    name, number, *below = names
    if not number.isdecimal() or int(number) >= len(items):
        raise InputError(f"--set {setting}: {name} is a list; name one of 0 to {len(items) - 1}, such as {name}.0")
    if not below:
        items[int(number)] = value
    elif isinstance(items[int(number)], dict):
        _put(items[int(number)], below, value, setting)
    else:
        raise InputError(f"--set {setting}: {name}.{number} is not a table")

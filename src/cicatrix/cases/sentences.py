"""Describe the faults of a case in sentences: the key, the values allowed, the value found; for an unknown key, a similar one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from .bounds import FAULT, OUT_OF_RANGE

TYPE_WORDS = {
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be a text",
    "path_type": "must be a text that names a file",
    "tuple_type": "must be a list",
    "dict_type": "must be a table",
    "model_type": "must be a table",
}


def sentences_of(error: ValidationError, kind: type[BaseModel]) -> list[str]:
    """Return the faults that the validation of a table of this type found, one sentence each."""
    return [_sentence(item, kind) for item in error.errors(include_url=False)]


def tag_of(name: str) -> str:
    """Mark the name of a law, which pydantic puts between the keys in the location of an error."""
    return f"<{name}>"


def _sentence(error: Mapping[str, Any], kind: type[BaseModel]) -> str:
    """Describe one validation error in a sentence: the key, the values allowed and the value found."""
    loc, name, value = error["loc"], error["type"], error["input"]
    context = error.get("ctx", {})
    key = dotted(loc)
    if name == "union_tag_invalid":
        return _unknown_type(key, value, context["expected_tags"])
    if name == FAULT:
        return f"{dotted((*loc, context['key']))} {context['sentence']}"
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
    return f"{key} {words}; got {shown(value)}"


def _unknown_type(key: str, value: Any, tags: str) -> str:
    """Return a sentence for a value that is not a table, or a table without a known type; known types are listed."""
    if not isinstance(value, Mapping):
        return f"{key} must be a table; got {shown(value)}"
    known = [tag.strip("'<>") for tag in tags.split(", ") if tag.strip("'<>")]
    found = f"got {shown(value['type'])}" if "type" in value else "it is missing"
    near = difflib.get_close_matches(str(value.get("type")).lower(), known, n=1)
    hint = f', did you mean "{near[0]}"?' if near else ""
    return f"{key}.type must be {either(known)}; {found}{hint}"


def _unknown_key(loc: Sequence[str | int], kind: type[BaseModel]) -> str:
    """Return a sentence for an unknown key, with the most similar key of its table, or else the same name in another table."""
    key, known = dotted(loc), known_keys(kind)
    prefix = dotted(loc[:-1])
    siblings = list(dict.fromkeys(name for table in _tables_at(loc[:-1], kind) for name in table.model_fields))
    leaf, start = str(loc[-1]), f"{prefix}." if prefix else ""
    by_leaf = {name.lower(): name for name in siblings}
    without_unit = [name for name in by_leaf if name.startswith(f"{leaf.lower()}_")]
    near = without_unit[:1] or difflib.get_close_matches(leaf.lower(), by_leaf, n=1)
    if near:
        return f"{key} is not a known key; did you mean {start}{by_leaf[near[0]]}?"
    elsewhere = [name for name in known if name.rpartition(".")[2] == leaf]
    if leaf in elsewhere and (tag := _tag_at(loc[:-1])):
        return f"{key}: {tag} takes no {leaf}; use [{leaf}]"
    if elsewhere:
        return f"{key} is not a known key; did you mean {' or '.join(elsewhere)}?"
    where = f"[{prefix}]" if prefix else "the file"
    return f"{key} is not a known key; known in {where}: {', '.join(siblings)}"


def known_keys(table: type[BaseModel], prefix: str = "") -> list[str]:
    """Return the dotted keys of a table and its subtables; a list of tables, which may contain its own type, has one key."""
    names: list[str] = []
    for name, field in table.model_fields.items():
        names.append(prefix + name)
        for candidate in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(candidate, type) and issubclass(candidate, BaseModel):
                names += known_keys(candidate, f"{prefix}{name}.{'<name>.' if _is_by_name(field) else ''}")
    return names


def _tables_at(loc: Sequence[str | int], kind: type[BaseModel]) -> list[type[BaseModel]]:
    """Return the types that the table at a location may have; a single one if the location contains the tag of its type."""
    found: list[type[BaseModel]] = [kind]
    is_by_name = False
    for part in loc:
        if is_by_name:  # a name that the user chose
            is_by_name = False
        elif isinstance(part, str) and part.startswith("<"):
            found = [table for table in found if part == tag_of(*get_args(table.model_fields["type"].annotation))]
        elif isinstance(part, str):
            fields = [table.model_fields[part] for table in found if part in table.model_fields]
            found = [table for field in fields for table in _tables_in(field.annotation)]
            is_by_name = any(_is_by_name(field) for field in fields)
    return found


def _tag_at(loc: Sequence[str | int]) -> str:
    """Return the name of the law, or of another of several types, whose table is at a location; empty if it is no such table."""
    return str(loc[-1]).strip("<>") if loc and str(loc[-1]).startswith("<") else ""


def _is_by_name(field: FieldInfo) -> bool:
    """Return whether a key is a table of tables by names that the user chooses."""
    return get_origin(field.annotation) is dict


def _tables_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for part in get_args(annotation) for table in _tables_in(part)]


def dotted(loc: Sequence[str | int]) -> str:
    """Return the key as the user writes it, without the tags of types that pydantic adds."""
    parts = [part for part in loc if not str(part).startswith("<")]
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).lstrip(".")


def shown(value: Any) -> str:
    """Return a value as it is written in a case file; a table is shown as the words "a table"."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(shown(item) for item in value)}]"
    return str(value)


def either(names: Iterable[str]) -> str:
    """Join names to a text such as ``"a", "b" or "c"``."""
    *some, last = (f'"{name}"' for name in names)
    return f"{', '.join(some)} or {last}" if some else last

"""Writing of plain tables as TOML; keys whose value is None are left out."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any


def toml_text(tables: Mapping[str, Any]) -> str:
    """Return nested tables of numbers, texts and lists as TOML; tables of the first level, and lists of them, get headers."""
    said = {key: value for key, value in tables.items() if value is not None}
    heads = {key: value for key, value in said.items() if isinstance(value, Mapping) or _is_tables(value)}
    blocks = ["\n".join(_lines({key: value for key, value in said.items() if key not in heads}))]
    for key, value in heads.items():
        head, several = (f"[{key}]", [value]) if isinstance(value, Mapping) else (f"[[{key}]]", value)
        blocks += ["\n".join([head, *_lines(table)]) for table in several]
    return "\n\n".join(block for block in blocks if block) + "\n"


def _is_tables(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) > 0 and all(isinstance(item, Mapping) for item in value)


def _lines(table: Mapping[str, Any]) -> list[str]:
    return [f"{_key(key)} = {_value(value)}" for key, value in table.items() if value is not None]


def _key(key: str) -> str:
    """Return a key as it is written: in quotes, unless it has only letters, digits, - and _."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_lines(value)) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return str(value).lower() if isinstance(value, bool) else repr(value)

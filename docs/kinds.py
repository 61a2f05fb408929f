"""Write the tables of keys and the examples into docs/kinds/, one page per kind of case, from the types of the cases.

`python docs/kinds.py` rewrites what stands between ``<!-- keys -->`` and ``<!-- /keys -->`` and between ``<!-- example FILE -->``
and ``<!-- /example -->``; the rest of a page is written by hand. A test fails if a page is out of date.

The meaning of a key is the comment beside its field, or above it; a table's is the docstring of its type.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import io
import re
import sys
import tokenize
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ForwardRef, Literal, NamedTuple, Union, get_args, get_origin

from gallery import default_of, meanings_of, prose_of
from pydantic import AfterValidator, BeforeValidator
from pydantic.fields import FieldInfo

from cicatrix.cases.bounds import Rule
from cicatrix.cases.continuum import VALUES, ParametersTable
from cicatrix.cases.laws import LawTable, key_of
from cicatrix.cases.table import Table
from cicatrix.kinds.lumpectomy.continuum import continuum_values
from cicatrix.kinds.registry import KINDS, case_type, demo_case

DOCS = Path(__file__).parent
# units that names of keys end with
UNITS = ("mm", "um", "h", "s", "kPa", "MPa", "pN", "um2", "mm2", "mm3", "m3", "s2", "kg", "m", "g", "deg", "weeks")
QUOTIENTS = {"kg m3": "kg/m3", "m s2": "m/s2", "pN um": "pN/um", "pN s um": "pN s/um"}  # written without "per"
OWN_UNITS = {"kT_pN_um": "pN um", "hours_per_step": "h", "days_per_cycle": "days", "W": "kPa", "W_ref": "kPa"}
OF_LOADING = ("x", "y", "z")  # keys of kind = "material-point" that are stretches or stresses
WORDS = {float: "number", int: "whole number", bool: "`true` or `false`", str: "text", Path: "file"}
CONTINUUM_DEFAULTS = (
    "Two numbers are those of `circular-wound` and of `breast-cavity`; a lumpectomy has those of `breast-cavity`, "
    "with stiffness and tractions that follow from the tissue of the case (here the default tissue)."
)
HEAD = "| key | type | unit | default | range | meaning |\n|---|---|---|---|---|---|\n"


class Row(NamedTuple):
    """A key: what may be its value, and what it means."""

    key: str
    type: str
    unit: str
    default: str
    range: str
    meaning: str


class Section(NamedTuple):
    """A table of a case file with its keys."""

    path: str
    """Dotted name of the table; empty for the keys at the top of the file."""
    title: str
    text: str
    rows: list[Row]


class Value(NamedTuple):
    """What a type of a field allows."""

    type: str
    rules: tuple[str, ...] = ()
    """Conditions on the value, such as "above 0"."""
    tables: tuple[type[Table], ...] = ()
    """Tables that it may be."""
    is_list: bool = False


# ---- what a type allows


def value_of(annotation: Any) -> Value:
    """Return what an annotation allows."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _restricted(value_of(parts[0]), parts[1:])
    if origin in (Union, types.UnionType):
        return _either([value_of(part) for part in parts if _inner(part) is not type(None)])
    if origin is Literal:
        return Value(WORDS[type(parts[0])], (_or([_shown(part) for part in parts]),))
    if origin is tuple:
        each = value_of(parts[0])
        rules = tuple(f"each {rule}" for rule in each.rules)
        return Value(f"list of {_plural(each.type)}", rules, each.tables, is_list=True)
    if origin is dict:
        each = value_of(parts[1])
        return Value(f"table: a {each.type} for each name", tuple(f"each {rule}" for rule in each.rules), each.tables)
    if isinstance(annotation, ForwardRef) or issubclass(annotation, Table):
        return Value("table", (), () if isinstance(annotation, ForwardRef) else (annotation,))
    return Value(WORDS[annotation])


def _inner(annotation: Any) -> Any:
    return get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation


def _restricted(value: Value, metadata: tuple[Any, ...]) -> Value:
    """Add the conditions that validators put on a value; a validator before it accepts a plain value too."""
    rules = [one.func.words for one in metadata if isinstance(one, AfterValidator) and isinstance(one.func, Rule)]
    words = [rule.removeprefix("must be ").removeprefix("must ") for rule in rules if "finite" not in rule]
    if any(isinstance(one, BeforeValidator) for one in metadata):
        alone = _singular(value.type.removeprefix("list of ")) if value.is_list else "number"
        value = value._replace(type=f"{alone} or {value.type}" if "number or" not in value.type else value.type)
    return value._replace(rules=tuple(dict.fromkeys([*value.rules, *words])))


def _either(values: list[Value]) -> Value:
    tables = tuple(table for value in values for table in value.tables)
    rules = tuple(dict.fromkeys(rule for value in values for rule in value.rules))
    return Value(_or(list(dict.fromkeys(value.type for value in values))), rules, tables, values[0].is_list)


def _or(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _plural(words: str) -> str:
    if words.startswith("list of "):
        return words.replace("list", "lists", 1)
    return words if "`" in words else f"{words}s"


def _singular(words: str) -> str:
    return words.removesuffix("s")


# ---- one row


def row_of(table: type[Table], key: str, field: FieldInfo, meaning: str, kind: str) -> Row:
    """Return the row of a key."""
    value = value_of(Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation)
    if not meaning and key == "type" and field.is_required():
        meaning = "chooses this table"
    if not meaning and len(value.tables) == 1:
        meaning = _first_sentence(value.tables[0])
    if value.tables and all(issubclass(one, LawTable) and "type" in one.model_fields for one in value.tables):
        meaning += " ([laws](../laws.md))"
    default = "required" if key == "kind" else _default(table, key, field, kind)
    return Row(key, value.type, _unit(key, value.type), default, _range(value), meaning)


def _range(value: Value) -> str:
    """Return the conditions on a value in few words."""
    words = "; ".join(value.rules) or ("any" if "number" in value.type and not value.tables else "")
    words = re.sub(r"at least (\S+) and at most (\S+)", r"\1 to \2", words)
    words = words.replace("9.22337e+18", "2^63").replace("a list of 3 numbers", "3 numbers")
    words = re.sub(r"1e\+0(\d)\b", lambda found: str(10 ** int(found[1])), words)
    return words.replace("e-0", "e-")


def _unit(key: str, kind: str) -> str:
    """Return the unit that the name of a key ends with; 1 for a number without one."""
    if "number" not in kind or kind.startswith("table"):
        return ""
    if key in OF_LOADING:
        return "1 or kPa"
    if key in OWN_UNITS:
        return OWN_UNITS[key]
    words: list[str] = []
    for word in reversed(key.split("_")):
        if word not in UNITS and (word != "per" or not words):
            break
        words.insert(0, word)
    above, _, below = " ".join(words).partition("per")
    above = QUOTIENTS.get(above.strip(), above.strip())
    unit = f"{above or 1}/{below.strip()}" if below else above or "1"
    return re.sub(r"([a-z])([23])\b", r"\1^\2", unit)


def _default(table: type[Table], key: str, field: FieldInfo, kind: str) -> str:
    if table is ParametersTable:
        return _continuum_default(key, kind)
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if isinstance(value, Table):
        is_one_of_several = len(value_of(field.annotation).tables) > 1
        return f'`type = "{type_of(type(value))}"`' if is_one_of_several else "its defaults"
    return "left out" if value is None or value == () or value == {} else _shown(value)


def _continuum_default(key: str, kind: str) -> str:
    """Return a value of the continuum model: that of a lumpectomy, or those of the two reference wounds."""
    sets = [continuum_values(demo_case()).values] if kind == "lumpectomy" else list(VALUES.values())
    found = list(dict.fromkeys(f"{values[key]:.5g}" for values in sets if key in values))
    return "; ".join(found) or "left out"


def _shown(value: Any) -> str:
    """Return a value as it is written in a case file."""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    if isinstance(value, tuple):
        return "`[" + ", ".join(_shown(item).strip("`") for item in value) + "]`"
    return f"{value:.6g}".replace("e-0", "e-") if isinstance(value, float) else str(value)


def _first_sentence(table: type[Table]) -> str:
    """Return the first sentence about a table as the meaning of a key, without the link to a class."""
    text = " ".join(text_of(table).partition("\n\n")[0].split())
    first = re.sub(r"[:;,] (see )?\[`.*", "", re.split(r"(?<=[^A-Z0-9])\. ", text)[0]).rstrip(".:")
    return first[:1].lower() + first[1:] if not first[1:2].isupper() else first


def text_of(table: type[Table]) -> str:
    """Return what the docstring of a table says, as Markdown; names of classes lead to their files."""
    text = re.sub(r":class:`\.*(\w+)\.(\w+)\.(\w+)`", r"[`\3`](../../src/cicatrix/\1/\2.py)", table.__doc__ or "")
    text = prose_of(text).strip()
    if table is ParametersTable:
        text += " " + CONTINUUM_DEFAULTS
    return text


# ---- comments


def comments_of(table: type[Table]) -> dict[str, str]:
    """Return the meaning of each key: the comment beside its field, or the lines of comment right above it."""
    found: dict[str, str] = {}
    for one in reversed(table.__mro__):
        if issubclass(one, LawTable) and one is not LawTable and "made" in vars(one):
            words = meanings_of(one.made)
            found |= {key_of(f): _clause(words.get(f.name, "")) for f in dataclasses.fields(one.made)}
        elif issubclass(one, Table):
            try:
                found |= _comments_in(inspect.cleandoc("\n" + inspect.getsource(one)))
            except (OSError, TypeError):
                continue  # made by pydantic.create_model
    return {key: words.replace("|", r"\|") for key, words in found.items()}


def _comments_in(source: str) -> dict[str, str]:
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    by_line = {token.start[0]: _plain(token.string) for token in tokens if token.type == tokenize.COMMENT}
    lines = source.splitlines()
    (body,) = ast.parse(source).body
    assert isinstance(body, ast.ClassDef)
    found = {}
    for node in body.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            first = node.lineno
            while lines[first - 2].lstrip().startswith("#"):
                first -= 1
            last = node.end_lineno or node.lineno
            found[node.target.id] = " ".join(filter(None, (by_line.get(n, "") for n in range(first, last + 1))))
    return found


def _clause(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:].rstrip(".")


def _plain(comment: str) -> str:
    return re.sub(r"^(pyright: ignore\[\w+\]|noqa\S*)( - )?", "", comment.lstrip("# ")).strip()


# ---- the keys of a kind


def sections_of(kind: str) -> list[Section]:
    """Return every table of a kind's case files, in the order of the case type."""
    return _unique(_sections(case_type(kind), "", "", kind))


def _sections(table: type[Table], path: str, title: str, kind: str) -> Iterator[Section]:
    rows = _rows(table, table.model_fields, kind)
    if issubclass(table, LawTable):
        rows = [row._replace(default=_law_default(table, row.key)) for row in rows]
    yield Section(path, title, text_of(table), rows)
    for key, field in table.model_fields.items():
        yield from _below(field, f"{path}.{key}".strip("."), kind)


def _rows(table: type[Table], fields: dict[str, FieldInfo], kind: str) -> list[Row]:
    """Return the rows of some keys of a table; the one that chooses the table comes first."""
    meanings = comments_of(table)
    order = sorted(fields, key=lambda key: key != "type")
    return [row_of(table, key, fields[key], meanings.get(key, ""), kind) for key in order]


def _own_fields(column: type[Table]) -> dict[str, FieldInfo]:
    """Return the keys of a table that are not parameters of its law."""
    law = next(base for base in column.__mro__ if "made" in vars(base))
    return {key: field for key, field in column.model_fields.items() if key not in law.model_fields}


def _law_default(table: type[LawTable], key: str) -> str:
    return next(default_of(f) for f in dataclasses.fields(table.made) if key_of(f) == key)


def _below(field: FieldInfo, path: str, kind: str) -> Iterator[Section]:
    """Yield the sections of the tables that a key may be; laws have a page of their own."""
    value = value_of(field.annotation)
    path += ".<name>" if value.type.startswith("table:") else ""
    name = f"`[[{path}]]`" if value.is_list else f"`[{path}]`"
    if len(value.tables) == 1:
        yield from _sections(value.tables[0], path, name, kind)
        return
    laws = [table for table in value.tables if issubclass(table, LawTable)]
    for table in value.tables:
        if table not in laws:
            yield from _sections(table, path, f'{name} with `type = "{type_of(table)}"`', kind)
    if laws and len(laws) < len(value.tables):
        names = _or([f"`{type_of(law)}`" for law in laws])
        text = f"One of the [laws](../laws.md), {names}, with the keys that it has there and these:"
        rows = _rows(laws[0], _own_fields(laws[0]), kind)
        yield Section(path, f"{name} with the `type` of a law", text, rows)


def type_of(table: type[Table]) -> str:
    """Return the ``type`` that chooses a table."""
    (name,) = get_args(table.model_fields["type"].annotation)
    return name


def _unique(sections: Iterator[Section]) -> list[Section]:
    """Leave out tables that stand there already, under another type of the table above."""
    found: dict[tuple, Section] = {}
    for section in sections:
        found.setdefault((section.title, tuple(section.rows)), section)
    return list(found.values())


# ---- pages


def keys_text(kind: str) -> str:
    """Return the tables of all keys of a kind, as Markdown."""
    return "\n".join(_section_text(section) for section in sections_of(kind))


def _section_text(section: Section) -> str:
    heading = f"### {section.title}\n\n{section.text}\n\n" if section.path else ""
    rows = "".join(f"| `{row.key}` | " + " | ".join(row[1:]) + " |\n" for row in section.rows)
    return f"{heading}{HEAD}{rows}"


def updated(kind: str, text: str) -> str:
    """Return a page with its tables of keys and its examples written anew."""
    keys = f"<!-- keys -->\n\n{keys_text(kind)}\n<!-- /keys -->"
    text = re.sub(r"<!-- keys -->.*?<!-- /keys -->", lambda _: keys, text, flags=re.S)
    return re.sub(r"<!-- example (\S+) -->.*?<!-- /example -->", lambda found: _example(found[1]), text, flags=re.S)


def _example(name: str) -> str:
    code = (DOCS.parent / name).read_text(encoding="utf-8").rstrip()
    return f"<!-- example {name} -->\n```toml\n{code}\n```\n<!-- /example -->"


def page_of(kind: str) -> Path:
    """Return the path of a kind's page."""
    return DOCS / "kinds" / f"{kind}.md"


def main() -> int:
    """Write the generated parts of every page."""
    for kind in KINDS:
        path = page_of(kind)
        path.write_text(updated(kind, path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

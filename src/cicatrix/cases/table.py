"""Tables of case files: their base class, unions distinguished by ``type``, and the case itself."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, Union

from pydantic import BaseModel, ConfigDict, Discriminator, Tag, ValidationError

from ..core.errors import InputError
from .nested import copied, locate, names_of, put
from .sentences import sentences_of, shown, tag_of

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)

LINES, COLUMNS = 15, 100  # largest size of the text that represents a case in a terminal


class TableType(ModelMetaclass):
    """Metaclass of the tables, so that ``SomeTable(key=value, ...)`` reports faults in the sentences of ``cicatrix check``."""

    if not TYPE_CHECKING:  # a type checker reads the keys from the fields

        def __call__(cls, **keys: Any) -> Any:  # noqa: N805
            """Make a table; paths of files are relative to the working folder.

            Raises
            ------
            InputError
                If a value is not valid; the message lists every fault.
            """
            keys = copied(keys)
            faults = locate(keys, cls.files, Path())
            try:
                table = super().__call__(**keys)
            except ValidationError as error:
                raise InputError("; ".join(sentences_of(error, cls) + faults)) from None
            if faults:
                raise InputError("; ".join(faults))
            return table


class Table(BaseModel, metaclass=TableType):
    """A table of a case file: immutable, without unknown keys, and checked whenever it is made or changed."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    files: ClassVar[tuple[str, ...]] = ()
    """Dotted keys whose values name files or folders that are read."""

    @classmethod
    def checked(cls, tables: Mapping[str, Any], folder: Path) -> tuple[Self | None, list[str]]:
        """Validate nested tables, with paths relative to ``folder``.

        Return the table (None if invalid) and a list of its faults.
        """
        tables = copied(tables)
        missing = locate(tables, cls.files, folder)
        return cls._validated(tables, missing)

    @classmethod
    def _validated(cls, tables: Mapping[str, Any], missing: list[str]) -> tuple[Self | None, list[str]]:
        """Make the table from nested tables; ``missing`` has a sentence for each file that does not exist."""
        try:
            table = cls.model_validate(tables)
        except ValidationError as error:
            return None, sentences_of(error, cls) + missing
        return (None if missing else table), missing

    def changed(self, changes: Mapping[str, Any]) -> Self:
        """Return the table with other values at some of its keys; the whole is checked again.

        Parameters
        ----------
        changes : mapping
            Values by dotted key, as after ``--set``: ``{"rules.p_edge": 0.3, "law.0.mu_kPa": 2.0}``. None removes the key, so
            that its default applies again. Paths are relative to the working folder.

        Raises
        ------
        InputError
            If a value is not valid; the message lists every fault.
        """
        tables = copied(self.model_dump(exclude_unset=True))
        for key, value in changes.items():
            put(tables, names_of(key), copied(value), key)
        touched = [name for name in self.files if any(f"{name}.".startswith(f"{key}.") for key in changes)]
        table, faults = self._validated(tables, locate(tables, touched, Path()))
        if table is None:
            raise InputError("; ".join(faults))
        return table

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values of the table's own keys; the copy is checked.

        Raises
        ------
        InputError
            If a value is not valid; the message lists every fault.
        """
        if not update:
            return super().model_copy(deep=deep)
        given = {name: getattr(self, name) for name in type(self).model_fields if name in self.model_fields_set}
        return type(self)(**{**given, **update})

    def unchecked(self, **values: Any) -> Self:
        """Return a copy with values that are not checked, such as numbers traced by JAX."""
        return super().model_copy(update=values)

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse to change the table.

        Raises
        ------
        AttributeError
            Always.
        """
        raise AttributeError(f'a case does not change; take case.changed({{"...{name}": {value!r}}}), a new one')


class Case(Table):
    """A whole case file; each kind of case derives its own type from this one."""

    kind: str

    @property
    def seed(self) -> int:
        """Seed of the random numbers; 0 if the case uses none."""
        return 0

    def sources(self) -> dict[str, str]:
        """Return where default numbers come from, by dotted key, for the manifest of a run."""
        return {}

    def __repr__(self) -> str:
        """Return the kind, and the keys whose values are not the defaults, as ``--set`` would set them."""
        lines = [f"{type(self).__name__}: defaults but for" if self._own() else f"{type(self).__name__}: defaults"]
        lines += [f"  {key} = {value}" for key, value in self._own().items()]
        if len(lines) > LINES:
            lines[LINES - 1 :] = [f"  and {len(lines) - LINES + 1} more keys"]
        return "\n".join(line if len(line) <= COLUMNS else f"{line[: COLUMNS - 4]} ..." for line in lines)

    def __str__(self) -> str:
        """Return the same as :func:`repr`."""
        return repr(self)

    def _repr_html_(self) -> str:
        """Return HTML for notebooks: a table of the keys whose values are not the defaults."""
        rows = "".join(
            f"<tr><td>{html.escape(key)}</td><td>{html.escape(v)}</td></tr>" for key, v in self._own().items()
        )
        return f"<p><b>{html.escape(type(self).__name__)}</b></p><table>{rows}</table>"

    def _own(self) -> dict[str, str]:
        return {key: shown(value) for key, value in _differences(self) if key != "kind"}


def one_of(tables: Mapping[str, type[Table]]) -> Any:
    """Make the type annotation of a table that is one of several, distinguished by ``type``."""

    def named(value: Any) -> str:
        return tag_of(str(value.get("type") if isinstance(value, Mapping) else getattr(value, "type", None)))

    tagged = [Annotated[table, Tag(tag_of(name))] for name, table in tables.items()]
    nothing = Annotated[None, Tag("")]  # a union needs at least two members
    return Annotated[Union[*tagged, nothing], Discriminator(named)]


def _differences(table: Table, at: str = "") -> Iterator[tuple[str, Any]]:
    """Yield key and value where a table differs from its defaults; keys are dotted and start with ``at``."""
    for name, field in type(table).model_fields.items():
        value, default = getattr(table, name), field.get_default(call_default_factory=True)
        if value != default:
            yield from _leaves(f"{at}{name}", value)


def _leaves(at: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Table):
        yield from _differences(value, f"{at}.")
    elif isinstance(value, tuple) and any(isinstance(item, Table) for item in value):
        for number, item in enumerate(value):
            yield from _leaves(f"{at}.{number}", item)
    else:
        yield at, value

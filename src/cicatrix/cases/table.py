"""Tables of case files: the base class of all of them, unions told apart by ``type``, and the case itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Union

from pydantic import BaseModel, ConfigDict, Discriminator, Tag


class Table(BaseModel):
    """A table of a case file: frozen, and no key but its own."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Case(Table):
    """A whole case file; each kind of case derives its own type from this one."""

    files: ClassVar[tuple[str, ...]] = ()
    """Dotted keys whose values name files or folders that are read."""
    kind: str

    @property
    def seed(self) -> int:
        """Seed of the random numbers; 0 where nothing is drawn."""
        return 0

    def sources(self) -> dict[str, str]:
        """Return where default numbers come from, by dotted key, for the manifest of a run."""
        return {}


def tag_of(name: str) -> str:
    """Mark the name of a law where pydantic puts it between the keys of an error's place."""
    return f"<{name}>"


def one_of(tables: Mapping[str, type[Table]]) -> Any:
    """Annotation of a table that is one of several, told apart by ``type``."""

    def named(value: Any) -> str:
        return tag_of(str(value.get("type") if isinstance(value, Mapping) else getattr(value, "type", None)))

    tagged = [Annotated[table, Tag(tag_of(name))] for name, table in tables.items()]
    nothing = Annotated[None, Tag("")]  # a union has two members at least
    return Annotated[Union[*tagged, nothing], Discriminator(named)]

"""What every table of a case file is."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Table(BaseModel):
    """A table of a case file: frozen, and no key but its own."""

    model_config = ConfigDict(frozen=True, extra="forbid")

"""cicatrix: predict how soft tissue heals after surgery.

``load_case(path)`` reads a case file, ``simulate(case, out=None)`` runs it; every law is importable from its module.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .kinds.registry import load_case
    from .kinds.simulate import simulate

from .core.version import __version__

__all__ = ["__version__", "load_case", "simulate"]

HOMES = {"load_case": "cicatrix.kinds.registry", "simulate": "cicatrix.kinds.simulate"}


def __getattr__(name: str) -> Any:
    """Import the two main functions when they are first asked for, so that one law does not load the whole program."""
    if name in HOMES:
        return getattr(import_module(HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

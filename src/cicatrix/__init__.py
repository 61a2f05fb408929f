"""cicatrix: compute how soft tissue heals after surgery.

``load_case(path)`` reads a case file, ``case_from(tables)`` checks nested tables, ``simulate(case, out=None)`` runs a case,
``open_run(folder)`` reads the results of a run, ``build(case)`` returns a simulation to step. Every law is importable from
its module.
"""

from __future__ import annotations

import difflib
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .core.errors import ConvergenceError, InputError
    from .kinds.registry import case_from, load_case
    from .kinds.simulate import build, simulate
    from .runs.quantity import Quantity
    from .runs.results import Results, open_run

from .core.version import __version__

__all__ = [
    "ConvergenceError",
    "InputError",
    "Quantity",
    "Results",
    "__version__",
    "build",
    "case_from",
    "load_case",
    "open_run",
    "simulate",
]

HOMES = {
    "ConvergenceError": "core.errors",
    "InputError": "core.errors",
    "Quantity": "runs.quantity",
    "Results": "runs.results",
    "build": "kinds.simulate",
    "case_from": "kinds.registry",
    "load_case": "kinds.registry",
    "open_run": "runs.results",
    "simulate": "kinds.simulate",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module at first access, so that one law does not load the whole program.

    Raises
    ------
    AttributeError
        If there is no such public name; the message names the nearest one.
    """
    if name in HOMES:
        return getattr(import_module(f".{HOMES[name]}", __name__), name)
    near = difflib.get_close_matches(name, __all__, n=1)
    hint = f"did you mean {near[0]}?" if near else f"public are {', '.join(__all__)}"
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; {hint}")


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)

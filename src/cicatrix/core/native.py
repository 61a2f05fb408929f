"""Kernels, each in its compiled version or as its NumPy reference implementation with the same arguments.

The compiled version is used if the compiled module is installed, unless the environment variable ``CICATRIX_NATIVE`` is
``0`` when this module is first imported. Both give bitwise identical results, so the choice affects speed only; the
exceptions are ``add_contracted`` and ``turn_blocks``, which sum in a different order.
"""

from __future__ import annotations

import os
from importlib import import_module
from types import ModuleType

from . import philox, scatter, switching
from .errors import InputError

MAX_THREADS = 256


def _compiled() -> ModuleType | None:
    """Return the compiled module, or None if it was not built or is switched off."""
    if os.environ.get("CICATRIX_NATIVE", "1") == "0":
        return None
    try:
        return import_module("cicatrix._native")
    except ImportError:
        return None


_kernels = _compiled()
is_native = _kernels is not None

philox4x32 = _kernels.philox4x32 if _kernels is not None else philox.philox4x32
add_blocks = _kernels.add_blocks if _kernels is not None else scatter.add_blocks
add_contracted = _kernels.add_contracted if _kernels is not None else scatter.add_contracted
turn_blocks = _kernels.turn_blocks if _kernels is not None else scatter.turn_blocks
switch_states = _kernels.switch_states if _kernels is not None else switching.switch_states


class _NoFaultError(Exception):
    """Placeholder for the compiled module's exception; never raised."""


automaton_core = (
    _kernels.AutomatonCore if _kernels is not None else None
)  # reference implementation: healing/reference.py
InvariantFault = _kernels.InvariantFault if _kernels is not None else _NoFaultError


def instruction_sets() -> list[str]:
    """Return the instruction sets for which the kernels are compiled and which this machine supports, the best one last."""
    return _kernels.instruction_sets() if _kernels is not None else []


def threads() -> int:
    """Return the number of threads of the compiled kernels: ``CICATRIX_THREADS``, or 1."""
    text = os.environ.get("CICATRIX_THREADS", "1")
    if not text.isdecimal() or not 1 <= int(text) <= MAX_THREADS:
        raise InputError(f"CICATRIX_THREADS must be a whole number from 1 to {MAX_THREADS}; got {text}")
    return int(text)

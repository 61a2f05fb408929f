"""The one place that chooses between a compiled kernel and its NumPy twin of the same name and arguments.

The kernel is taken where the compiled module is there, unless the environment variable ``CICATRIX_NATIVE`` is ``0``
when this module is first imported. Kernel and twin give the same bits, so the choice changes the time only; but for
``add_contracted`` and ``turn_blocks``, which sum in another order.
"""

from __future__ import annotations

import os
from importlib import import_module
from types import ModuleType

from . import philox, scatter, switching
from .errors import InputError

MOST_THREADS = 256


def _compiled() -> ModuleType | None:
    """Return the compiled module, or None where it was not built or is switched off."""
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
    """Never raised."""


automaton_core = _kernels.AutomatonCore if _kernels is not None else None  # its twin is healing/twin.py
InvariantFault = _kernels.InvariantFault if _kernels is not None else _NoFaultError


def instruction_sets() -> list[str]:
    """Names of the instruction sets the kernels are compiled for and this machine can run, the best one last."""
    return _kernels.instruction_sets() if _kernels is not None else []


def threads() -> int:
    """Threads of the compiled kernels: ``CICATRIX_THREADS``, or 1."""
    text = os.environ.get("CICATRIX_THREADS", "1")
    if not text.isdecimal() or not 1 <= int(text) <= MOST_THREADS:
        raise InputError(f"CICATRIX_THREADS must be a whole number from 1 to {MOST_THREADS}; got {text}")
    return int(text)

"""The one place that chooses between a compiled kernel and its NumPy twin of the same name and arguments.

The kernel is taken where the compiled module is there, unless the environment variable ``CICATRIX_NATIVE`` is ``0``
when this module is first imported. Kernel and twin give the same bits, so the choice changes the time only.
"""

from __future__ import annotations

import os
from importlib import import_module
from types import ModuleType

from . import philox


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
# The automaton's step takes its seat here; its twin is healing/automaton.py.

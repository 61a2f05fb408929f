"""PETSc's C library, as much of it as solving linear systems over several ranks needs, without petsc4py.

petsc4py is compiled for one NumPy and one Python; the library alone (Debian: libpetsc-real3.18) serves them all.
"""

from __future__ import annotations

import atexit
import ctypes
import os
from ctypes import byref, c_char_p, c_int, c_void_p
from ctypes.util import find_library
from functools import cache
from pathlib import Path

import numpy as np

from ..core.errors import InputError, InvariantError
from ..core.ranks import Ranks

NAMES = ("petsc_real", "petsc")  # Debian's name, everyone's
DOUBLE, INSERT, NATURAL_REASONS = 1, 1, 0  # PETSC_DOUBLE, INSERT_VALUES
NO_FACTOR = 92  # PETSC_ERR_MISSING_FACTOR


class PetscError(InvariantError):
    """PETSc refused a call."""


class Petsc:
    """The library, initialised; ``call`` turns its error codes into exceptions."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        library.PetscOptionsSetValue(None, b"-no_signal_handler", b"true")  # Ctrl-C is Python's
        self.call("PetscInitializeNoArguments")
        silent = ctypes.cast(library.PetscIgnoreErrorHandler, c_void_p)
        self.call("PetscPushErrorHandler", silent, None)
        self.int_type = {4: np.int32, 8: np.int64}[self._size("int")]
        if self._type("scalar") != DOUBLE:
            raise InputError("PETSc was built for complex or single-precision numbers: a real, double build is needed")
        self.is_open = True
        atexit.register(self._close)

    def call(self, name: str, *arguments) -> None:
        """Call a function; raises PetscError with PETSc's words where it fails."""
        code = getattr(self._library, name)(*arguments)
        if code:
            text = c_char_p()
            self._library.PetscErrorMessage(code, byref(text), None)
            words = (text.value or b"").decode()
            if code == NO_FACTOR:
                raise InputError(f"PETSc lacks the factorisation that is asked for, MUMPS ({words})")
            raise PetscError(f"PETSc reports error {code} in {name}: {words}")

    def new(self, name: str, *arguments) -> c_void_p:
        """Call a function whose last argument takes the handle that it makes."""
        handle = c_void_p()
        self.call(name, *arguments, byref(handle))
        return handle

    def integer(self, value: int):
        """One PetscInt."""
        return np.ctypeslib.as_ctypes_type(self.int_type)(value)

    def communicator(self, ranks: Ranks) -> c_void_p:
        """All ranks that were started.

        Raises
        ------
        InputError
            If PETSc belongs to another MPI library than the one that connects the ranks.
        """
        comm, size = c_void_p.in_dll(self._library, "PETSC_COMM_WORLD"), c_int()
        self._library.MPI_Comm_size(comm, byref(size))
        if size.value != ranks.size:
            raise InputError(
                f"PETSc's MPI library finds {size.value} ranks where there are {ranks.size}: start them with the mpiexec of that "
                "library (Debian: mpiexec.openmpi)"
            )
        return comm

    def set_options(self, options: dict[str, str | float], prefix: str) -> None:
        """Set options of the objects with a prefix, where PETSC_OPTIONS has not."""
        for name, value in options.items():
            key = f"-{prefix}{name}".encode()
            is_set = c_int()
            self.call("PetscOptionsHasName", None, None, key, byref(is_set))
            if not is_set.value:
                self.call("PetscOptionsSetValue", None, key, str(value).encode())

    def _type(self, name: str) -> int:
        kind, found = c_int(), c_int()
        self.call("PetscDataTypeFromString", name.encode(), byref(kind), byref(found))
        return kind.value if found.value else -1

    def _size(self, name: str) -> int:
        size = ctypes.c_size_t()
        self.call("PetscDataTypeGetSize", self._type(name), byref(size))
        return size.value

    def _close(self) -> None:
        self.is_open = False
        self._library.PetscFinalize()


def _candidates() -> list[str]:
    folders = [Path(os.environ[name]) for name in ("PETSC_DIR",) if name in os.environ]
    folders = [folder / os.environ.get("PETSC_ARCH", "") / "lib" for folder in folders]
    built = [str(file) for folder in folders for name in NAMES for file in sorted(folder.glob(f"lib{name}.so*"))]
    return built + [found for name in NAMES if (found := find_library(name))]


def is_installed() -> bool:
    """Whether the library is on this machine; it is not loaded."""
    return bool(_candidates())


@cache
def petsc() -> Petsc:
    """Load and initialise the library, once in a process.

    Raises
    ------
    InputError
        If it is not there, or is not built for real numbers in double precision.
    """
    reasons = []
    for path in _candidates():
        try:
            library = ctypes.CDLL(path)
        except OSError as error:
            reasons.append(str(error))
            continue
        return Petsc(library)
    why = f" ({'; '.join(reasons)})" if reasons else ""
    raise InputError(
        f"PETSc is not there{why}: apt-get install python3-petsc4py, or set PETSC_DIR to where it was built"
    )

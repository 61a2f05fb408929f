"""Minimal binding of PETSc's C library for linear systems distributed over ranks, without petsc4py.

petsc4py is compiled for one version of NumPy and Python; the C library (Debian: libpetsc-real3.18) works with all of them.
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

NAMES = ("petsc_real", "petsc")  # name in Debian; usual name
DOUBLE, INSERT, NATURAL_REASONS = 1, 1, 0  # PETSC_DOUBLE, INSERT_VALUES
NO_FACTOR = 92  # PETSC_ERR_MISSING_FACTOR


class PetscError(InvariantError):
    """Exception raised if a PETSc function returns an error code."""


class Petsc:
    """Interface to the PETSc library: initialises it, calls its functions, and raises exceptions for their error codes."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        library.PetscOptionsSetValue(None, b"-no_signal_handler", b"true")  # leave Ctrl-C to Python
        self.call("PetscInitializeNoArguments")
        silent = ctypes.cast(library.PetscIgnoreErrorHandler, c_void_p)
        self.call("PetscPushErrorHandler", silent, None)
        self.int_type = {4: np.int32, 8: np.int64}[self._size("int")]
        if self._type("scalar") != DOUBLE:
            raise InputError("PETSc was built for complex or single-precision numbers: a real, double build is needed")
        self.is_open = True
        atexit.register(self._close)

    def call(self, name: str, *arguments) -> None:
        """Call a PETSc function; raises PetscError with PETSc's message if it fails."""
        code = getattr(self._library, name)(*arguments)
        if code:
            text = c_char_p()
            self._library.PetscErrorMessage(code, byref(text), None)
            words = (text.value or b"").decode()
            if code == NO_FACTOR:
                raise InputError(f"PETSc was built without the requested factorisation, MUMPS ({words})")
            raise PetscError(f"PETSc reports error {code} in {name}: {words}")

    def new(self, name: str, *arguments) -> c_void_p:
        """Call a PETSc function that creates an object, and return the handle that it writes to its last argument."""
        handle = c_void_p()
        self.call(name, *arguments, byref(handle))
        return handle

    def integer(self, value: int):
        """Convert an integer to PetscInt."""
        return np.ctypeslib.as_ctypes_type(self.int_type)(value)

    def communicator(self, ranks: Ranks) -> c_void_p:
        """Return PETSc's communicator of all ranks.

        Raises
        ------
        InputError
            If PETSc was built with another MPI library than the one that started the ranks.
        """
        comm, size = c_void_p.in_dll(self._library, "PETSC_COMM_WORLD"), c_int()
        self._library.MPI_Comm_size(comm, byref(size))
        if size.value != ranks.size:
            raise InputError(
                f"PETSc's MPI library finds {size.value} ranks instead of {ranks.size}: start them with the mpiexec of that "
                "library (Debian: mpiexec.openmpi)"
            )
        return comm

    def set_options(self, options: dict[str, str | float], prefix: str) -> None:
        """Set options of the PETSc objects with this prefix, except options already set by PETSC_OPTIONS."""
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
    """Return whether the PETSc library is installed on this machine, without loading it."""
    return bool(_candidates())


@cache
def petsc() -> Petsc:
    """Load and initialise the PETSc library, once per process.

    Raises
    ------
    InputError
        If the library is not installed, or not built for real numbers in double precision.
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
        f"PETSc was not found{why}: apt-get install python3-petsc4py, or set PETSC_DIR to the folder where it was built"
    )

"""MPI ranks: the processes that ``mpiexec`` started for one run, and the communication between them.

mpi4py is loaded only in a process that ``mpiexec`` or ``srun`` started; any other process is a single rank.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, TypeVar

from .errors import InputError

if TYPE_CHECKING:
    import numpy as np

T = TypeVar("T")

OPEN_MPI = "OMPI_COMM_WORLD_SIZE"
SIZES = (OPEN_MPI, "PMI_SIZE")  # number of ranks, set by Open MPI, and by MPICH and its derivatives
PMIX = "PMIX_RANK"  # set by other launchers, without the number of ranks
RANKS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", PMIX)


class Ranks:
    """Group of one rank, and the interface of groups of several ranks (:class:`.mpi_ranks.MpiRanks`)."""

    rank = 0
    size = 1

    @property
    def is_first(self) -> bool:
        """True on the rank that reads and writes the run's folder and prints messages to the user."""
        return self.rank == 0

    def gather(self, mine: bytes) -> list[bytes]:
        """Return the messages of all ranks, in the order of ranks, on every rank (collective)."""
        return [mine]

    def share(self, value: T) -> T:
        """Return the first rank's value on all ranks (collective)."""
        return value

    def sum(self, mine: np.ndarray) -> np.ndarray:
        """Sum arrays of equal shape over the ranks; the result is bitwise identical on all ranks (collective)."""
        return mine

    def agree(self, job: Callable[[], T]) -> T:
        """Run ``job`` on every rank and return its result; if it fails on any rank, raise an error on all ranks (collective).

        Ranks on which it failed raise their own error, all others that of the first such rank.
        """
        return job()

    @contextmanager
    def abort_on_error(self) -> Iterator[None]:
        """Guard a collective section: an exception that is not raised on all ranks aborts all of them (MPI_Abort).

        ConvergenceError and InvariantError do not abort: they depend on values that all ranks have, so all ranks raise them. Nor
        does KeyboardInterrupt, which is raised on all ranks if signals are deferred by ``uninterrupted``.
        """
        yield

    @contextmanager
    def uninterrupted(self) -> Iterator[None]:
        """Defer SIGINT and SIGTERM during collective work; ``is_interrupted`` is True once a signal has arrived."""
        yield

    @property
    def is_interrupted(self) -> bool:
        """True if this rank received a deferred signal and continues until all ranks can stop."""
        return False


def is_first_process() -> bool:
    """Return whether this process is the rank that prints messages, from environment variables, without loading MPI."""
    return all(os.environ.get(name, "0") == "0" for name in RANKS)


@cache
def world() -> Ranks:
    """Return the group of ranks that this process belongs to.

    Raises
    ------
    InputError
        If several ranks were started, and mpi4py is missing or cannot load the MPI library to which ``mpiexec`` belongs.
    """
    sizes = [int(os.environ[name]) for name in SIZES if os.environ.get(name, "").isdecimal()]
    if max(sizes, default=1) == 1 and (sizes or PMIX not in os.environ):
        return Ranks()
    started = f"mpiexec started {max(sizes)} ranks" if sizes else "mpiexec started this process"
    if OPEN_MPI in os.environ:
        _prefer_open_mpi()
    try:
        from mpi4py import MPI

        from .mpi_ranks import MpiRanks
    except (ImportError, RuntimeError) as error:
        raise InputError(f"{started}, but mpi4py cannot be loaded ({error}): pip install 'cicatrix[mpi]'") from None
    comm = MPI.COMM_WORLD
    if sizes and comm.Get_size() != max(sizes):
        raise InputError(
            f"{started}, but mpi4py finds {comm.Get_size()}: mpiexec and mpi4py must belong to the same MPI library"
        )
    return MpiRanks(comm) if comm.Get_size() > 1 else Ranks()


def _prefer_open_mpi() -> None:
    """Make mpi4py load the MPI library of the mpiexec that started this process, even if another one is installed."""
    name = "libmpi.so.40"  # Open MPI 4 and 5
    try:
        ctypes.CDLL(name)
    except OSError:
        return
    os.environ.setdefault("MPI4PY_LIBMPI", name)

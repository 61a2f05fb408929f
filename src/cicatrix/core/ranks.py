"""Ranks: processes that ``mpiexec`` started together to do one run, and what they say to each other.

mpi4py is loaded only in a process that ``mpiexec`` or ``srun`` started; everywhere else there is one rank, alone.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

import numpy as np

from .errors import ConvergenceError, InputError, InvariantError

T = TypeVar("T")

OPEN_MPI = "OMPI_COMM_WORLD_SIZE"
SIZES = (OPEN_MPI, "PMI_SIZE")  # what Open MPI, and MPICH and its kin, tell the processes they start
PMIX = "PMIX_RANK"  # and what other starters do, without the number
RANKS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", PMIX)
FAILED = 3


class Ranks:
    """One rank of one; with more of them ``MpiRanks``."""

    rank = 0
    size = 1

    @property
    def is_first(self) -> bool:
        """Whether this is the rank that reads and writes the run's folder and speaks to the user."""
        return self.rank == 0

    def gather(self, mine: bytes) -> list[bytes]:
        """Give every rank the messages of all, in the order of ranks; all must call it alike."""
        return [mine]

    def share(self, value: T) -> T:
        """Return the first rank's value."""
        return value

    def sum(self, mine: np.ndarray) -> np.ndarray:
        """Sum arrays of one shape over the ranks: the same bits on all of them."""
        return mine

    def agree(self, job: Callable[[], T]) -> T:
        """Do a job; where it failed on one rank it fails on all, with the first one's error."""
        return job()

    @contextmanager
    def all_or_none(self) -> Iterator[None]:
        """Between steps that all do alike: an error that the others cannot know ends the whole run.

        What follows from numbers that all have (ConvergenceError, InvariantError) all raise, and so they do KeyboardInterrupt
        where they are ``uninterrupted``.
        """
        yield

    @contextmanager
    def uninterrupted(self) -> Iterator[None]:
        """Let no signal come between what all ranks do alike; ``is_interrupted`` tells whether one came."""
        yield

    @property
    def is_interrupted(self) -> bool:
        """Whether this rank was asked to stop, and goes on until all can."""
        return False


class MpiRanks(Ranks):
    """Several ranks, over mpi4py."""

    def __init__(self, comm: Any) -> None:
        self._comm, self.rank, self.size = comm, comm.Get_rank(), comm.Get_size()
        self._asked = threading.Event()

    def gather(self, mine: bytes) -> list[bytes]:  # noqa: D102
        return self._comm.allgather(mine)

    def share(self, value: T) -> T:  # noqa: D102
        return self._comm.bcast(value)

    def sum(self, mine: np.ndarray) -> np.ndarray:  # noqa: D102
        mine = np.ascontiguousarray(mine, float)
        out = np.empty_like(mine)
        self._comm.Reduce(mine, out)
        self._comm.Bcast(out)  # not Allreduce, which may round differently on each
        return out

    def agree(self, job: Callable[[], T]) -> T:  # noqa: D102
        done: Any = None
        fault = None
        try:
            done = job()
        except BaseException as own:
            fault = own
        faults = [other for other in self._comm.allgather(fault) if other is not None]
        if faults:
            raise fault or faults[0]
        return done

    @contextmanager
    def all_or_none(self) -> Iterator[None]:  # noqa: D102
        try:
            yield
        except (InvariantError, ConvergenceError, KeyboardInterrupt):  # on all ranks alike
            raise
        except BaseException:
            ended = f"cicatrix: rank {self.rank} failed, so all {self.size} are ended"
            print(
                f"{traceback.format_exc()}{ended}", file=sys.stderr, flush=True
            )  # at once: the launcher may lose what follows
            self._comm.Abort(FAILED)

    @contextmanager
    def uninterrupted(self) -> Iterator[None]:  # noqa: D102
        self._asked.clear()
        if threading.current_thread() is not threading.main_thread():  # where Python delivers no signals
            yield
            return
        kinds = (signal.SIGINT, signal.SIGTERM)
        before = [signal.signal(kind, lambda *_: self._asked.set()) for kind in kinds]
        try:
            yield
        finally:
            for kind, handler in zip(kinds, before):
                signal.signal(kind, handler)

    @property
    def is_interrupted(self) -> bool:  # noqa: D102
        return self._asked.is_set()


def speaks() -> bool:
    """Whether this process is the one of all ranks that tells the user things; known before MPI is loaded."""
    return all(os.environ.get(name, "0") == "0" for name in RANKS)


@cache
def world() -> Ranks:
    """Return the ranks this process belongs to.

    Raises
    ------
    InputError
        If several were started and mpi4py is not there, cannot load an MPI library, or loads another one.
    """
    sizes = [int(os.environ[name]) for name in SIZES if os.environ.get(name, "").isdecimal()]
    if max(sizes, default=1) == 1 and (sizes or PMIX not in os.environ):
        return Ranks()
    started = f"mpiexec started {max(sizes)} ranks" if sizes else "mpiexec started this process"
    if OPEN_MPI in os.environ:
        _prefer_open_mpi()
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        raise InputError(f"{started}, but mpi4py cannot be loaded ({error}): pip install 'cicatrix[mpi]'") from None
    comm = MPI.COMM_WORLD
    if sizes and comm.Get_size() != max(sizes):
        raise InputError(
            f"{started}, but mpi4py finds {comm.Get_size()}: mpiexec and mpi4py must belong to the same MPI library"
        )
    return MpiRanks(comm) if comm.Get_size() > 1 else Ranks()


def _prefer_open_mpi() -> None:
    """Let mpi4py load the library of the mpiexec that started this process, where another one is installed, too."""
    name = "libmpi.so.40"  # of Open MPI 4 and 5
    try:
        ctypes.CDLL(name)
    except OSError:
        return
    os.environ.setdefault("MPI4PY_LIBMPI", name)

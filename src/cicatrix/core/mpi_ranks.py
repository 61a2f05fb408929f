"""MPI communication by mpi4py, an optional dependency; imported by :func:`.ranks.world` in processes that ``mpiexec`` started."""

from __future__ import annotations

import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from .errors import ConvergenceError, InvariantError
from .ranks import Ranks

T = TypeVar("T")

FAILED = 3


class MpiRanks(Ranks):
    """Group of several MPI ranks that communicate by mpi4py."""

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
        self._comm.Bcast(out)  # not Allreduce: its rounding may differ between ranks
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
    def abort_on_error(self) -> Iterator[None]:  # noqa: D102
        try:
            yield
        except (InvariantError, ConvergenceError, KeyboardInterrupt):  # raised on all ranks
            raise
        except BaseException:
            ended = f"cicatrix: rank {self.rank} failed, so all {self.size} ranks are aborted"
            print(
                f"{traceback.format_exc()}{ended}", file=sys.stderr, flush=True
            )  # in a single write: the launcher may lose later output
            self._comm.Abort(FAILED)

    @contextmanager
    def uninterrupted(self) -> Iterator[None]:  # noqa: D102
        self._asked.clear()
        if threading.current_thread() is not threading.main_thread():  # Python delivers signals to the main thread only
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

"""Calls of Python functions from compiled code; exceptions of these functions reach the caller unchanged."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import count

import jax
import numpy as np
from jax import Array
from jax.experimental.buffer_callback import buffer_callback

Function = Callable[..., Sequence[np.ndarray]]

MAX_FAILURES = 64  # largest number of exceptions stored until callers read them; the oldest is dropped first
_failures: OrderedDict[int, BaseException] = OrderedDict()
_numbers = count()
_MARK = re.compile(r"failure (\d+) of a function called back")


def call_back(function: Function, shapes: Sequence[tuple[int, ...]], *arguments: Array) -> list[Array]:
    """Call a NumPy function from compiled code, on the CPU.

    Parameters
    ----------
    function : callable
        Function of arrays that returns arrays. It must be hashable: functions that compare equal share compiled code. It must
        be pure, must not call JAX, and may be called from any thread and from several at once. Under ``jax.vmap`` its arguments
        and results get leading axes, of length 1 where an argument is not mapped.
    shapes : sequence of tuples of int
        Shapes of the results, all in double precision, without the axes that ``jax.vmap`` adds.
    *arguments : arrays
        Arguments of the function, which receives views of JAX's own buffers: it must not modify them, nor refer to them after it
        has returned.

    Notes
    -----
    ``jax.pure_callback`` is not used: it creates JAX arrays inside the callback, so that compiled functions called from two
    threads deadlock with arrays of more than about 1e5 numbers (docs/decisions/0027).
    """
    results = [jax.ShapeDtypeStruct(shape, np.float64) for shape in shapes]
    return buffer_callback(_Filled(function), results, vmap_method="expand_dims")(*arguments)


@contextmanager
def own_exceptions() -> Iterator[None]:
    """Replace the error that JAX raises after an exception in a callback by the original exception.

    JAX computes asynchronously, so the ``with`` block must wait for its results (``jax.block_until_ready``).
    """
    try:
        yield
    except Exception as error:
        failure = _taken(str(error))
        if failure is None:
            raise
        jax.block_until_ready(_success()(np.zeros(1)))
        raise failure from None


@dataclass(frozen=True)
class _Filled:
    """Callback that writes the results of a function into the output buffers of compiled code."""

    function: Function

    def __call__(self, context, results, *arguments) -> None:
        try:
            answers = self.function(*map(np.asarray, arguments))
            for result, answer in zip(map(np.asarray, results), answers, strict=True):
                result[...] = answer
        except BaseException as error:
            raise RuntimeError(f"failure {_stored(error)} of a function called back: {error!r}") from error


def _stored(error: BaseException) -> int:
    number = next(_numbers)
    _failures[number] = error
    while len(_failures) > MAX_FAILURES:
        _failures.popitem(last=False)
    return number


def _taken(message: str) -> BaseException | None:
    """Remove and return the stored exception to which an error message of JAX refers; None if there is none."""
    found = _MARK.search(message)
    return _failures.pop(int(found[1]), None) if found else None


def _same(x: np.ndarray) -> list[np.ndarray]:
    return [x]


@cache
def _success() -> Callable[[np.ndarray], list[Array]]:
    """Return a compiled computation that succeeds.

    It is run after a failure, because JAX prints the error of the last computation when the process ends.
    """
    return jax.jit(lambda x: call_back(_same, [x.shape], x)).lower(np.zeros(1)).compile()

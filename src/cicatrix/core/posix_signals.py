"""Context managers that restore Python's signal handlers after a library has replaced them, or defer signals."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread

TAKEN = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def restored_signals() -> Iterator[None]:
    """Restore Python's handlers of SIGINT and SIGTERM after a block that calls a library which replaces them, such as MMG."""
    before = {number: signal.getsignal(number) for number in TAKEN}
    try:
        yield
    finally:
        if current_thread() is main_thread():
            for number, handler in before.items():
                signal.signal(number, signal.SIG_DFL if handler is None else handler)


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Defer Ctrl-C and SIGTERM to the end of the block, so that they do not interrupt it; no effect outside the main thread."""
    if current_thread() is not main_thread():
        yield
        return
    arrived: list[int] = []
    before = {number: signal.signal(number, lambda number, _: arrived.append(number)) for number in TAKEN}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for number in arrived[:1]:
            signal.raise_signal(number)

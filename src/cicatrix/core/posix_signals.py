"""Signals that a library takes, given back."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread

TAKEN = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def kept_signals() -> Iterator[None]:
    """Let Python hear of Ctrl-C and SIGTERM again after a library that takes them for itself, as MMG does."""
    before = {number: signal.getsignal(number) for number in TAKEN}
    try:
        yield
    finally:
        if current_thread() is main_thread():
            for number, handler in before.items():
                signal.signal(number, signal.SIG_DFL if handler is None else handler)

"""Exceptions whose message is one sentence: what went wrong, where, and what to do instead."""


class CicatrixError(Exception):
    """Base class of errors shown to the user as one sentence; ``exit_code`` is what the command line returns."""

    exit_code = 3


class InputError(CicatrixError):
    """Invalid input (exit code 2): the message says what is wrong, where, and what would be right."""

    exit_code = 2


class ConvergenceError(CicatrixError):
    """A solver did not converge (exit code 3).

    Parameters
    ----------
    message : str
        One sentence: what did not converge, where it stopped, what to try.
    history : list of str
        One line for each attempt of the solver, oldest first.
    """

    def __init__(self, message: str, history: list[str] | None = None):
        super().__init__(message)
        self.history = history or []


class InvariantError(CicatrixError):
    """An invariant is violated (exit code 3), such as the number of cells: an error in the program, not in the input."""


class StorageError(CicatrixError):
    """A file could not be written because the disk gives no room or reports an error (exit code 3)."""

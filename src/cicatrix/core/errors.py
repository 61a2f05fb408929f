"""What can go wrong, in the reader's language: one sentence that says what, where and what would be right."""


class CicatrixError(Exception):
    """Root of all errors that reach a user as a sentence; ``exit_code`` is what the command line returns."""

    exit_code = 3


class InputError(CicatrixError):
    """The input is at fault (exit code 2): the message says what, where, and what would be right."""

    exit_code = 2


class ConvergenceError(CicatrixError):
    """A solver gave up (exit code 3).

    Parameters
    ----------
    message : str
        One sentence: what did not converge, where it stopped, what to try.
    history : list of str
        What was tried, one line each, oldest first.
    """

    def __init__(self, message: str, history: list[str] | None = None):
        super().__init__(message)
        self.history = history or []


class InvariantError(CicatrixError):
    """Something that must hold did not (exit code 3), such as the number of cells: a fault of the program."""

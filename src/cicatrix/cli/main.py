"""Entry point of the command line: run a verb and report how it ended by an exit code and one sentence."""

from __future__ import annotations

import argparse
import atexit
import gc
import io
import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Sequence
from importlib import import_module
from types import FrameType
from typing import NoReturn

from ..core.errors import CicatrixError, ConvergenceError, InputError
from ..core.ranks import is_first_process, world
from ..core.version import __version__
from ..files.atomic import DISK_AT_FAULT, writing_error
from .arguments import build_parser
from .printing import printable

ON_RANKS = ("run",)  # verbs that several MPI ranks can run together

DONE, INPUT_AT_FAULT, FAILED, INTERRUPTED = 0, 2, 3, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments after ``cicatrix``; by default those of the process.

    Returns
    -------
    int
        Exit code: 0 done, 2 error in the input, 3 no convergence, a full disk or an internal error, 130 interrupted.
    """
    if argv is None:
        _settle()
    previous = _listen_to_termination()
    args = argparse.Namespace()
    try:
        args = build_parser().parse_args(argv)
        if args.verb not in ON_RANKS and world().size > 1:
            raise InputError(f"cicatrix {args.verb} runs in one process: start it without mpiexec")
        return import_module(f".{args.verb}", __package__).run(args)  # the module is named after the verb
    except SystemExit as leaving:  # --help and --version
        return leaving.code if isinstance(leaving.code, int) else DONE
    except CicatrixError as error:
        return _report_error(error)
    except KeyboardInterrupt:
        _print_error(f"interrupted{getattr(args, 'after_interruption', '')}")
        return INTERRUPTED
    except BrokenPipeError:  # the program that reads the pipe has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:
        if error.errno not in DISK_AT_FAULT:
            return _report_fault(error)
        return _report_error(writing_error(error.filename2 or error.filename or "a file", error))
    except Exception as error:
        return _report_fault(error)
    finally:
        if previous is not None:
            signal.signal(signal.SIGTERM, previous)


def _settle() -> None:
    """Configure garbage collection, OpenBLAS and the output, for the whole process as it runs nothing but this command.

    Python collects cyclic garbage rarely, and not at exit, because imported modules and JAX traces are needed to the end. Idle
    threads of OpenBLAS sleep; by default they keep a core busy until the next operation. The defaults took a third
    of the processor time of a second run. What the terminal's encoding lacks is written as an escape.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    gc.set_threshold(100_000, 20, 100)
    atexit.register(gc.freeze)
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")  # 2^4 cycles; read when NumPy is imported


def _report_error(error: CicatrixError) -> int:
    if isinstance(error, ConvergenceError):
        for line in error.history:
            print(f"  {printable(line)}", file=sys.stderr)
    _print_error(str(error))
    return error.exit_code


def _report_fault(error: Exception) -> int:
    _print_error(f"internal error ({type(error).__name__}); {_write_traceback()}")
    return FAILED


def _print_error(sentence: str) -> None:
    """Print a sentence to stderr, on one rank only."""
    if is_first_process():
        print(f"cicatrix: {printable(sentence)}", file=sys.stderr)


def _write_traceback() -> str:
    """Write the traceback of the error that is handled to a file, and say where; print it if no file can be written."""
    try:
        handle, path = tempfile.mkstemp(prefix="cicatrix-", suffix="-traceback.txt")
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(f"cicatrix {__version__}\n")
            traceback.print_exc(file=stream)
    except OSError:
        traceback.print_exc()
        return "the traceback is above"
    return f"the traceback is in {path}"


def _listen_to_termination() -> signal.Handlers | int | None:
    """Make SIGTERM end a run like Ctrl-C; return the previous handler, or None outside the main thread."""
    try:
        previous = signal.signal(signal.SIGTERM, _terminate)
    except ValueError:
        return None
    return previous if isinstance(previous, (signal.Handlers, int)) else signal.SIG_DFL


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())

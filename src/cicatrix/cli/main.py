"""The command line: finds the verb, and turns every way to end into an exit code and a sentence."""

from __future__ import annotations

import argparse
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
from ..core.ranks import speaks, world
from ..core.version import __version__

VERBS = (
    "demo",
    "run",
    "check",
    "segment",
    "mesh",
    "fit",
    "report",
    "plan",
    "bench",
)  # modules, in the order of the road
ON_RANKS = ("run",)  # what several ranks can do together

DONE, INPUT_AT_FAULT, FAILED, INTERRUPTED = 0, 2, 3, 130


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise what the user typed wrong."""
        raise InputError(f"{message}; see {self.prog} --help")


def build_parser() -> Parser:
    """Make the parser with every verb."""
    parser = Parser(
        prog="cicatrix",
        description="From a breast image and a planned lumpectomy to the healed shape.",
        epilog="Exit codes: 0 done, 2 the input is at fault, 3 no convergence or a fault inside, 130 interrupted.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"cicatrix {__version__}")
    verbs = parser.add_subparsers(title="verbs", dest="verb", metavar="VERB", required=True)
    for verb in VERBS:  # loaded here, so that an interruption meanwhile is one too
        import_module(f".{verb}", __package__).add_parser(verbs)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb.

    Parameters
    ----------
    argv : sequence of str, optional
        What was typed after ``cicatrix``; the process's own arguments if left out.

    Returns
    -------
    int
        0 done, 2 the input is at fault, 3 no convergence or a fault inside, 130 interrupted.
    """
    previous = _listen_to_termination()
    args = argparse.Namespace()
    try:
        args = build_parser().parse_args(argv)
        if args.verb not in ON_RANKS and world().size > 1:
            raise InputError(f"cicatrix {args.verb} runs in one process: start it without mpiexec")
        return args.run(args)
    except SystemExit as leaving:  # --help and --version
        return leaving.code if isinstance(leaving.code, int) else DONE
    except CicatrixError as error:
        return _tell(error)
    except KeyboardInterrupt:
        _say(f"interrupted{getattr(args, 'after_interruption', '')}")
        return INTERRUPTED
    except BrokenPipeError:  # the reader of a pipe has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        _say(f"a fault inside cicatrix ({type(error).__name__}); what happened is written to {_write_traceback()}")
        return FAILED
    finally:
        if previous is not None:
            signal.signal(signal.SIGTERM, previous)


def _tell(error: CicatrixError) -> int:
    if isinstance(error, ConvergenceError):
        for line in error.history:
            print(f"  {line}", file=sys.stderr)
    _say(" ".join(str(error).split()))
    return error.exit_code


def _say(sentence: str) -> None:
    """Tell the user, once for all ranks."""
    if speaks():
        print(f"cicatrix: {sentence}", file=sys.stderr)


def _write_traceback() -> str:
    handle, path = tempfile.mkstemp(prefix="cicatrix-", suffix="-traceback.txt")
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        stream.write(f"cicatrix {__version__}\n")
        traceback.print_exc(file=stream)
    return path


def _listen_to_termination() -> signal.Handlers | int | None:
    """Let a polite kill end a run as Ctrl-C does; only the main thread may set this."""
    try:
        previous = signal.signal(signal.SIGTERM, _terminate)
    except ValueError:
        return None
    return previous if isinstance(previous, (signal.Handlers, int)) else signal.SIG_DFL


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())

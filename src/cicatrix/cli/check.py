"""``cicatrix check``: validate a case file and the files that it names, and print every fault on its own line."""

from __future__ import annotations

import argparse
import sys

from ..core.errors import InputError
from ..kinds.registry import examine
from .printing import printable


def run(args: argparse.Namespace) -> int:
    """Print every fault to stderr, or say on stdout that there are none; notes follow; return the exit code."""
    faults, notes = examine(args.case, args.set) if args.data is None else _with_data(args)
    for fault in faults:
        print(printable(f"{args.case}: {fault}"), file=sys.stderr)
    if not faults:
        print(printable(f"{args.case}: no fault found"))
    for note in notes:
        print(printable(f"note: {note}"))
    return 2 if faults else 0


def _with_data(args: argparse.Namespace) -> tuple[list[str], list[str]]:
    """Return the first fault of a case with the data that its law is fitted to, and notes on the data."""
    from .fit import measured_for  # with it comes the solver, which a check without data does not need

    try:
        return [], list(measured_for(args.case, args.set, args.data)[1].notes)
    except InputError as error:
        return [str(error).removeprefix(f"{args.case}: ")], []

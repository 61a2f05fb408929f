"""``cicatrix check``: validate a case file and print every fault on its own line."""

from __future__ import annotations

import argparse
import sys

from ..kinds.registry import check_case
from .printing import printable


def run(args: argparse.Namespace) -> int:
    """Print every fault to stderr, or say on stdout that there are none; return the exit code."""
    faults = check_case(args.case, args.set)
    for fault in faults:
        print(printable(f"{args.case}: {fault}"), file=sys.stderr)
    if not faults:
        print(printable(f"{args.case}: no fault found"))
    return 2 if faults else 0

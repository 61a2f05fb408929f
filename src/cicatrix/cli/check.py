"""``cicatrix check``: validate a case file, every fault on a line."""

from __future__ import annotations

import argparse
import sys

from ..kinds.registry import check_case
from .arguments import add_case, add_overrides


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("check", help="validate a case file only: every fault, one line each", allow_abbrev=False)
    add_case(parser)
    add_overrides(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the faults on stderr, or that there are none."""
    faults = check_case(args.case, args.set)
    for fault in faults:
        print(f"{args.case}: {fault}", file=sys.stderr)
    if not faults:
        print(f"{args.case}: no fault found")
    return 2 if faults else 0

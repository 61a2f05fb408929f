"""``cicatrix run``: a case file to a folder of results."""

from __future__ import annotations

import argparse
from pathlib import Path

import cicatrix

from ..core.ranks import world
from ..kinds.registry import load_case
from ..runs.progress import Progress
from .arguments import add_case, add_overrides
from .headline import print_headline
from .progress import make_progress

AFTER_INTERRUPTION = "; the same command with --resume goes on from the last checkpoint"


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("run", help="run a case file", allow_abbrev=False)
    add_case(parser)
    parser.add_argument(
        "--out", metavar="DIR", type=Path, help="the run's folder (default: runs/NAME of the case file)"
    )
    parser.add_argument("--resume", action="store_true", help="go on from the last checkpoint in the run's folder")
    add_overrides(parser)
    parser.set_defaults(run=run, after_interruption=AFTER_INTERRUPTION)


def run(args: argparse.Namespace) -> int:
    """Load the case, run it, print the headline."""
    case = load_case(args.case, args.set)
    is_first = world().is_first
    progress = make_progress() if is_first else Progress()
    try:
        results = cicatrix.simulate(case, args.out or Path("runs") / args.case.stem, args.resume, progress)
    finally:
        progress.close()
    if is_first:
        print_headline(results)
    return 0

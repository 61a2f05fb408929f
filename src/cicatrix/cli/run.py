"""``cicatrix run``: run a case file and write its results to a folder."""

from __future__ import annotations

import argparse
from pathlib import Path

import cicatrix

from ..core.ranks import world
from ..kinds.registry import load_case
from ..runs.progress import Progress
from .headline import print_headline
from .progress import make_progress


def run(args: argparse.Namespace) -> int:
    """Load the case, run it and print its main results."""
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

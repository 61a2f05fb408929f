"""``cicatrix demo``: the main job on the built-in phantom."""

from __future__ import annotations

import argparse
from pathlib import Path

import cicatrix

from ..kinds.registry import demo_case
from .headline import print_headline
from .progress import make_progress

AFTER_INTERRUPTION = "; the last checkpoint is kept, the same command goes on"


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    words = "the main job on the built-in phantom: image to healed shape, 2-D"
    parser = verbs.add_parser("demo", help=words, allow_abbrev=False)
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path("demo"), help="the run's folder (default: demo)"
    )
    parser.set_defaults(run=run, after_interruption=AFTER_INTERRUPTION)


def run(args: argparse.Namespace) -> int:
    """Run the demo case; a demo that was stopped goes on, one that is finished is shown again."""
    progress = make_progress()
    try:
        results = cicatrix.simulate(demo_case(), args.out, True, progress)
    finally:
        progress.close()
    print_headline(results)
    return 0

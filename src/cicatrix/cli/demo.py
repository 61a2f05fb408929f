"""``cicatrix demo``: run a 2-D lumpectomy on the built-in phantom, from image to healed shape."""

from __future__ import annotations

import argparse

import cicatrix

from ..kinds.registry import demo_case
from .headline import print_headline
from .progress import make_progress


def run(args: argparse.Namespace) -> int:
    """Run the demo case: resume it if it was interrupted, print its results again if it is finished."""
    progress = make_progress()
    try:
        results = cicatrix.simulate(demo_case(), args.out, True, progress)
    finally:
        progress.close()
    print_headline(results)
    return 0

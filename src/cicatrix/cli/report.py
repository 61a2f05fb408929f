"""``cicatrix report``: pages about a run, or about several side by side."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..core.errors import InputError


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    words = "pages about a run, finished or not, that open without a network; of several runs, side by side"
    parser = verbs.add_parser("report", help=words, allow_abbrev=False)
    parser.add_argument("runs", metavar="DIR", nargs="+", type=Path, help="folder of a run; several are compared")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, help="where the pages go (default: DIR/report; of several, comparison)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the pages and say where they are."""
    from ..pages.report import write_comparison, write_report

    if len(set(args.runs)) < len(args.runs):
        raise InputError("the same folder is named twice; name each run once")
    if len(args.runs) == 1:
        page = write_report(args.runs[0], args.out, _tell)
    else:
        page = write_comparison(args.runs, args.out or Path("comparison"), _tell)
    size = sum(file.stat().st_size for file in page.parent.rglob("*") if file.is_file())
    print(f"report:  {page} ({size / 1e6:.1f} MB); open it in a browser")
    return 0


def _tell(words: str) -> None:
    print(f"{words} ...", flush=True)

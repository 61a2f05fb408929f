"""``cicatrix report``: write web pages about a run, or about several runs side by side."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..core.errors import InputError
from ..pages.report import write_comparison, write_report


def run(args: argparse.Namespace) -> int:
    """Write the pages and say where they are."""
    if len(set(args.runs)) < len(args.runs):
        raise InputError("the same folder is given twice; give each run once")
    if len(args.runs) == 1:
        page = write_report(args.runs[0], args.out, _print_step)
    else:
        page = write_comparison(args.runs, args.out or Path("comparison"), _print_step)
    size = sum(file.stat().st_size for file in page.parent.rglob("*") if file.is_file())
    print(f"report:  {page} ({size / 1e6:.1f} MB); open it in a browser")
    return 0


def _print_step(words: str) -> None:
    print(f"{words} ...", flush=True)

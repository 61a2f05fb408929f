"""Arguments that more than one verb takes."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_case(parser: argparse.ArgumentParser) -> None:
    """Add the case file."""
    parser.add_argument("case", metavar="CASE.toml", type=Path, help="the case file")


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Add ``--set``, which may be given many times."""
    words = "change one key of the case, such as run.seed=3; may be repeated; paths stay relative to the case file"
    parser.add_argument("--set", metavar="KEY.PATH=VALUE", action="append", default=[], help=words)

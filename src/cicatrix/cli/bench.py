"""``cicatrix bench``: seconds, each with its ceiling or peer measured in the same run."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..bench.benchmarks import BENCHMARKS
from ..bench.measurement import Measurement
from ..core.errors import InputError


def add_parser(verbs: argparse._SubParsersAction) -> None:
    """Add the verb."""
    parser = verbs.add_parser("bench", help="measure speed", allow_abbrev=False)
    parser.add_argument("names", metavar="NAME", nargs="*", help=f"a benchmark: {', '.join(BENCHMARKS)} (default: all)")
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the numbers to a file too")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the benchmarks one after the other and print a line per measurement."""
    names = args.names or list(BENCHMARKS)
    for name in names:
        if name not in BENCHMARKS:
            raise InputError(f"there is no benchmark {name}; known: {', '.join(BENCHMARKS)}")
    measured: dict[str, list[Measurement]] = {}
    for name in names:
        measured[name] = []
        for row in BENCHMARKS[name]():
            measured[name].append(row)
            print(f"{name:<12} {row.what:<36} {row.value:12.6g} {row.unit:<6} {row.note}".rstrip(), flush=True)
    if args.json:
        _write_json(args.json, measured)
    return 0


def _write_json(path: Path, measured: dict[str, list]) -> None:
    table = {name: [row._asdict() for row in rows] for name, rows in measured.items()}
    try:
        path.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"--json {path} cannot be written: {error.strerror}") from None

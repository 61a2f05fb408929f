"""``cicatrix bench``: measure run times, each compared with a hardware limit or another program timed in the same run."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..bench.benchmarks import BENCHMARKS, measurements
from ..bench.measurement import Measurement
from ..core.errors import InputError


def run(args: argparse.Namespace) -> int:
    """Run the benchmarks one after the other and print one line per measurement."""
    names = args.names or list(BENCHMARKS)
    for name in names:
        if name not in BENCHMARKS:
            raise InputError(f"there is no benchmark {name}; known: {', '.join(BENCHMARKS)}")
    measured: dict[str, list[Measurement]] = {}
    for name in names:
        measured[name] = []
        for row in measurements(name):
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

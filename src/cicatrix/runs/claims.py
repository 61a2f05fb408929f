"""Table of a reproduced result with claim, measured value and whether it holds, checked against expected.csv."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path


def print_claims(folder: Path, rows: Sequence[tuple[str, str, bool]]) -> int:
    """Print the rows (claim, measured, holds); return 0 if claims and holds equal those of ``folder/expected.csv``, else 1."""
    with (folder / "expected.csv").open() as file:
        expected = {row["claim"]: row["holds"] for row in csv.DictReader(file)}
    print("claim | measured | holds")
    for claim, measured, holds in rows:
        print(f"{claim} | {measured} | {'yes' if holds else 'no'}")
    return int(expected != {claim: "yes" if holds else "no" for claim, _, holds in rows})

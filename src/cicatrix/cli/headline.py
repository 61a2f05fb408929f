"""Summary that a finished run prints on the terminal: the main numbers and where the files are."""

from __future__ import annotations

from collections.abc import Iterator

from ..pages.run_view import assumption_of
from ..runs.driver import STEPS
from ..runs.quantity import Quantity
from ..runs.results import Results
from .printing import printable


def print_headline(results: Results) -> None:
    """Print how the run ended, the assumption behind the healed shape, the numbers, the time, the pictures and the folder."""
    print(printable(results.status[1]))
    assumption = assumption_of(results.manifest.get("case", {}))
    if assumption:
        print(assumption)
    for line in _numbers(results):
        print(line)
    if STEPS in results.manifest["seconds"]:
        print(f"time:    {results.manifest['seconds'][STEPS]['wall']:.3g} s in steps")
    if results.folder is not None:
        for picture in sorted((results.folder / "figures").glob("*.png")):
            print(printable(f"picture: {picture}"))
        print(printable(f"folder:  {results.folder}"))
        print(printable(f"pages:   cicatrix report {results.folder}"))


def _numbers(results: Results) -> Iterator[str]:
    """Yield one line per outcome that is a number, a text or missing; lists and tables are only in outcome.json."""
    for name, asked in results.outcome.items():
        if asked.value is None or isinstance(asked.value, (int, float, str)):
            yield f"  {name:<32} {_value(asked)}"


def _value(asked: Quantity) -> str:
    if isinstance(asked.value, str):
        return asked.value
    words = "not available" if asked.value is None else f"{asked.value:.4g} {asked.unit}".rstrip()
    return f"{words:<16}  {asked.note}".rstrip()

"""What a finished run tells on the terminal: the main numbers, and where to look."""

from __future__ import annotations

from collections.abc import Iterator

from ..runs.results import Quantity, Results


def print_headline(results: Results) -> None:
    """Print the single numbers of the outcome, the pictures and the folder."""
    print(results.status[1])
    for line in _numbers(results):
        print(line)
    if results.folder is not None:
        for picture in sorted((results.folder / "figures").glob("*.png")):
            print(f"picture: {picture}")
        print(f"folder:  {results.folder}")
        print(f"pages:   cicatrix report {results.folder}")


def _numbers(results: Results) -> Iterator[str]:
    """One line per quantity that is a single number, a text or missing; tables are for outcome.json."""
    for name, asked in results.outcome.items():
        if asked.value is None or isinstance(asked.value, (int, float, str)):
            yield f"  {name:<32} {_value(asked)}"


def _value(asked: Quantity) -> str:
    if isinstance(asked.value, str):
        return asked.value
    words = "not available" if asked.value is None else f"{asked.value:.4g} {asked.unit}".rstrip()
    return f"{words:<16}  {asked.note}".rstrip()

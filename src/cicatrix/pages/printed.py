"""The figures of a run as one PDF, the numbers on its first page."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

from matplotlib import image
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from ..files.atomic import replacing
from .account import Account
from .cosmesis import Line

PAGE_INCHES = (8.27, 11.69)  # A4
WIDTH = 88  # letters in a line of text
FIRST, LEAST = 0.93, 0.05  # of a page's height, where text begins and ends


def write_pdf(path: Path, account: Account, lines: Sequence[Line]) -> None:
    """Write the PDF: sentences, what is missing, then every picture in ``figures/`` on a page of its own."""
    with (
        replacing(path) as half,
        PdfPages(half, metadata={"CreationDate": None, "Producer": None, "Creator": None}) as pdf,
    ):
        for page in _text_pages(account, lines):
            pdf.savefig(page)
        for picture in sorted((account.folder / "figures").glob("*.png")):
            pdf.savefig(_picture_page(picture))


def _text_pages(account: Account, lines: Sequence[Line]) -> list[Figure]:
    state, sentence = account.results.status
    texts = [
        (14, f"cicatrix: {account.name}"),
        (9, f"{account.kind}, {state}. {sentence}"),
        *((9, gap) for gap in account.missing),
        (9, ""),
        *((9, f"{line.name}: {line.value}. {line.sentence} Reference: {line.reference}.") for line in lines),
        *((9, text) for text in ([] if lines else _outcome(account))),
        (9, ""),
        (8, "Research software: not a medical device, no clinical claim."),
    ]
    pages, y = [Figure(figsize=PAGE_INCHES)], FIRST
    for size, text in texts:
        for row in textwrap.wrap(text, int(WIDTH * 9 / size)) or [""]:
            if y < LEAST:
                pages.append(Figure(figsize=PAGE_INCHES))
                y = FIRST
            pages[-1].text(0.08, y, row, fontsize=size, va="top", parse_math=False)
            y -= 0.0018 * size
        y -= 0.006
    return pages


def _outcome(account: Account) -> list[str]:
    """Single numbers of the outcome, for runs without a table of their own."""
    return [
        f"{name}: {asked.value:.6g} {asked.unit}. {asked.note}".strip()
        for name, asked in account.results.outcome.items()
        if isinstance(asked.value, (int, float))
    ]


def _picture_page(path: Path) -> Figure:
    pixels = image.imread(path)
    height, width = pixels.shape[:2]
    page = Figure(figsize=PAGE_INCHES if height > width else PAGE_INCHES[::-1])
    ax = page.add_axes((0.05, 0.05, 0.9, 0.85))
    ax.imshow(pixels, interpolation="none")
    ax.axis("off")
    page.suptitle(path.stem.replace("-", " "), parse_math=False)
    return page

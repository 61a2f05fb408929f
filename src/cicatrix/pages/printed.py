"""PDF of a run: the numbers on its first pages, then its figures."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

from matplotlib import image
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from ..files.atomic import replacing
from .cosmesis import Line
from .run_view import RunView

PAGE_INCHES = (8.27, 11.69)  # A4
WIDTH = 88  # characters per line at 9 points
TOP, BOTTOM = 0.93, 0.05  # top and bottom of the text, as fractions of the page height


def write_pdf(path: Path, view: RunView, lines: Sequence[Line]) -> None:
    """Write the PDF: state and numbers of the run, missing parts, then one page per picture in ``figures/``."""
    with (
        replacing(path) as half,
        PdfPages(half, metadata={"CreationDate": None, "Producer": None, "Creator": None}) as pdf,
    ):
        for page in _text_pages(view, lines):
            pdf.savefig(page)
        for picture in sorted((view.folder / "figures").glob("*.png")):
            pdf.savefig(_picture_page(picture))


def _text_pages(view: RunView, lines: Sequence[Line]) -> list[Figure]:
    state, sentence = view.results.status
    texts = [
        (14, f"cicatrix: {view.name}"),
        (9, f"{view.kind}, {state}. {sentence}"),
        *((9, text) for text in (view.assumption, *view.missing) if text),
        (9, ""),
        *((9, f"{line.name}: {line.value}. {line.sentence} Reference: {line.reference}.") for line in lines),
        *((9, text) for text in ([] if lines else _outcome(view))),
        (9, ""),
        (8, "Research software: not a medical device, no clinical claim."),
    ]
    pages, y = [Figure(figsize=PAGE_INCHES)], TOP
    for size, text in texts:
        for row in textwrap.wrap(text, int(WIDTH * 9 / size)) or [""]:
            if y < BOTTOM:
                pages.append(Figure(figsize=PAGE_INCHES))
                y = TOP
            pages[-1].text(0.08, y, row, fontsize=size, va="top", parse_math=False)
            y -= 0.0018 * size
        y -= 0.006
    return pages


def _outcome(view: RunView) -> list[str]:
    """Return the numbers of the outcome as text, for runs without a table of :mod:`.cosmesis`."""
    return [
        f"{name}: {asked.value:.6g} {asked.unit}. {asked.note}".strip()
        for name, asked in view.results.outcome.items()
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

"""Segments of a segmentation, each with a name, made into one label map by these names."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..core.errors import InputError
from ..geometry.labels import Label

# words for a tissue, after `_plain`; "/" separates them
WORDS = {
    Label.AIR: "air/background/outside/exterior/empty/none",
    Label.FAT: "fat/adipose/fatty/adipose fat/adipose connective",
    Label.GLAND: "gland/glandular/glands/fibroglandular/fgt/parenchyma/dense/mammary gland/glandular parenchyma",
    Label.SKIN: "skin/skin structure/cutis",
    Label.TUMOUR: "tumour/tumor/lesion/mass/cancer/carcinoma/neoplasm/malignant neoplasm/tumour mass/tumor mass",
    Label.CHEST: (
        "chest/chest wall/thorax/thoracic wall/pectoral muscle/pectoral/pectoralis/pectoralis major/"
        "pectoralis major muscle/pectoralis muscle/muscle/muscles/skeletal muscle"
    ),
}
TISSUE_OF = {word: label for label, words in WORDS.items() for word in words.split("/")}
FILLING = re.compile(r"\b(?:tissues?|breasts?|segment|label|mask|of|the|\d+)\b")  # words that do not say which tissue
BY_NAME = {label.name.lower(): label for label in Label}  # how a case names the tissues
FIRST = (Label.TUMOUR, Label.SKIN, Label.GLAND, Label.FAT, Label.CHEST, Label.AIR)  # of segments that overlap
MOST_SHOWN = 6  # names of segments in a sentence
LEAST_SHARE = 0.5  # of a voxel that is in no segment to less than this, nothing is labelled
OVERLAP = 1.25  # sum of shares from which segments overlap; fractions that are rounded may exceed 1 a little


@dataclass(frozen=True, eq=False)
class Segment:
    """One segment of a segmentation.

    Parameters
    ----------
    name : str
        Its name in the file.
    code : str
        Meaning of the coded type that the file gives it; empty if there is none.
    share : (nz, ny, nx) array
        Share of each voxel [1]: 0 and 1, or fractions.
    """

    name: str
    code: str
    share: np.ndarray


def labels_of(segments: Sequence[Segment], given: Mapping[str, str], file: str) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the label of each voxel by the names of the segments, and notes on how they were read.

    A voxel gets the tissue with the largest share in it; of tissues with equal shares, such as segments that overlap,
    the first of tumour, skin, gland, fat, chest and air.

    Parameters
    ----------
    segments : sequence of Segment
        All on one grid.
    given : mapping of str to str
        Tissue of a segment, by its name; these come before the names that are known.
    file : str
        Name of the file, for messages.

    Returns
    -------
    (nz, ny, nx) uint8 array of `Label`, tuple of str

    Raises
    ------
    InputError
        If there is no segment, a name is not known or contradicts its coded type, or ``given`` names a segment that is not there.
    """
    if not segments:
        raise InputError(f"{file}: the segmentation has no segment; a segment for each tissue is needed.")
    check_given(given, [s.name for s in segments], file)
    used = [s for s in segments if s.share.any()]  # a segment without voxels may have any name
    tissues = _tissues(used, given, file)
    values, overlap = _combined(segments[0].share.shape, [s.share for s in used], tissues)
    read = ", ".join(f'"{s.name}" is {t.name.lower()}' for s, t in zip(used, tissues))
    notes = [f"labels by name: {read}"]
    if overlap:
        order = ", ".join(label.name.lower() for label in FIRST)
        notes.append(f"segments overlap in {overlap} voxels; such a voxel gets the first of {order}")
    return values, tuple(notes)


def names_given(texts: Sequence[str]) -> dict[str, str]:
    """Return the tissue of each segment from texts such as "FGT left=gland".

    Raises
    ------
    InputError
        If a text has another form, names no tissue, or a segment is named twice.
    """
    names: dict[str, str] = {}
    for text in texts:
        name, _, tissue = text.rpartition("=")
        if not name or tissue not in BY_NAME or name in names:
            raise InputError(
                f'--label-name: "{text}" must be NAME=TISSUE, each name once, with {_quoted(list(BY_NAME))}.'
            )
        names[name] = tissue
    return names


def check_given(given: Mapping[str, str], names: Sequence[str], file: str) -> None:
    """Refuse tissues that are given for segments (or values) that the file does not have."""
    for name in given:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f'; did you mean "{near[0]}"?' if near else "."
            raise InputError(f'image.label_names: {file} has no segment "{name}" but {_quoted(names)}{hint}')


def _tissues(segments: Sequence[Segment], given: Mapping[str, str], file: str) -> list[Label]:
    """Return the tissues of segments; all those without a known name are told at once."""
    found = [(segment, tissue_of(segment, given, file)) for segment in segments]
    unknown = [segment.name for segment, tissue in found if tissue is None]
    if unknown:
        known = "; ".join(f"{label.name.lower()} ({', '.join(_examples(label))})" for label in Label)
        more = f" and {len(unknown) - MOST_SHOWN} more" if len(unknown) > MOST_SHOWN else ""
        which, has, them, their = (
            ("segment", "has", "it", "its") if len(unknown) == 1 else ("segments", "have", "them", "their")
        )
        raise InputError(
            f"{file}: the {which} {_quoted(unknown[:MOST_SHOWN])}{more} {has} no name of a tissue that is known ({known}); "
            f"rename {them}, or {how_named(unknown[0], their)}"
        )
    return [tissue for _, tissue in found if tissue is not None]


def tissue_of(segment: Segment, given: Mapping[str, str], file: str) -> Label | None:
    """Return the tissue of a segment: as given, or by its name, or else by its coded type; None if none of them is known.

    Raises
    ------
    InputError
        If name and code contradict each other.
    """
    if segment.name in given:
        return BY_NAME[given[segment.name]]
    by_name, by_code = (TISSUE_OF.get(_plain(words)) for words in (segment.name, segment.code))
    if by_name is not None and by_code is not None and by_name != by_code:
        raise InputError(
            f'{file}: the segment "{segment.name}" has the coded type "{segment.code}", which is another tissue; '
            f"{how_named(segment.name)}"
        )
    return by_code if by_name is None else by_name


def how_named(name: str, whose: str = "its") -> str:
    """Return how a user names the tissue of a segment."""
    case, command = f'[image.label_names] "{name}" = "gland"', f'--label-name "{name}=gland"'
    return f"name {whose} tissue, in a case as {case}, in a command as {command}."


def _combined(shape: tuple[int, ...], shares: Sequence[np.ndarray], tissues: Sequence[Label]) -> tuple[np.ndarray, int]:
    """Return the tissue with the largest share of each voxel (nz, ny, nx), and the number of voxels where tissues overlap."""
    best, total = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    values = np.zeros(shape, np.uint8)
    for label in reversed(FIRST):
        parts = [share for share, tissue in zip(shares, tissues) if tissue == label]
        if parts:
            share = np.max(parts, axis=0).astype(np.float32)
            wins = (share > 0) & (share >= best)
            values[wins], best[wins] = label, share[wins]
            total += share
    values[total < LEAST_SHARE] = Label.AIR
    return values, int(np.count_nonzero(total > OVERLAP))


def _plain(name: str) -> str:
    """Return a name in lower case, without signs and the words that do not say which tissue."""
    words = re.sub(r"[\W_]+", " ", name.casefold())
    return " ".join(FILLING.sub(" ", words).split())


def _examples(label: Label) -> Iterator[str]:
    """Return the first other words for a tissue."""
    words = (word for word in WORDS[label].split("/") if word != label.name.lower())
    return (word for _, word in zip(range(3), words))


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)

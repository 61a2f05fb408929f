"""Ways to damage a file, each from a seeded generator of random numbers, so that every damaged file can be made again."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

NUMBER = re.compile(rb"(?<![\w.])[+-]?\d+(\.\d+)?([eE][+-]?\d+)?")
WORDS = (b"nan", b"inf", b"-inf", b"1e999", b"1e308", b"-1e308", b"9" * 400, b"", b"x", b"1_0", b"0x10", b"--3", b"1,5")
NUMBERS = (b"1e308", b"-1e308")  # those of them that are finite numbers
HEAD = 600  # bytes of a binary file in which numbers are written as text, if any
ENDINGS = (".txt", ".npy", ".nii.gz", ".vtu", ".toml", ".dcm", ".zip", ".json", ".msh", ".mha")


class Damage(NamedTuple):
    """A damaged file."""

    content: bytes
    words: str
    n_changed: int = 0
    """Number of values that the damage may turn into others without any reader being able to know."""
    ending: str = ""
    """New ending of the file's name; as it was if empty."""


def empty(content: bytes, rng: np.random.Generator) -> Damage:
    """Leave nothing."""
    return Damage(b"", "emptied")


def truncated(content: bytes, rng: np.random.Generator) -> Damage:
    """Cut the file off."""
    kept = int(rng.integers(1, max(2, len(content))))
    return Damage(content[:kept], f"cut off after {kept} of {len(content)} bytes")


def flipped(content: bytes, rng: np.random.Generator) -> Damage:
    """Flip one to three bits."""
    out, places = bytearray(content), rng.integers(0, len(content), int(rng.integers(1, 4)))
    for place in places.tolist():
        out[place] ^= 1 << int(rng.integers(8))
    return Damage(bytes(out), f"bits flipped at {sorted(places.tolist())}", len(places))


def flipped_in_front(content: bytes, rng: np.random.Generator) -> Damage:
    """Flip a bit among the first 400 bytes, where most formats have their header."""
    front = flipped(content[:400], rng)
    return front._replace(content=front.content + content[400:])


def overwritten(content: bytes, rng: np.random.Generator) -> Damage:
    """Overwrite a block with noise."""
    start, n = int(rng.integers(0, len(content))), int(rng.integers(4, 40))
    noise = rng.integers(0, 256, min(n, len(content) - start), np.uint8).tobytes()
    return Damage(
        content[:start] + noise + content[start + len(noise) :], f"{len(noise)} bytes of noise at {start}", len(noise)
    )


def doubled(content: bytes, rng: np.random.Generator) -> Damage:
    """Write a block twice."""
    start, n = int(rng.integers(0, len(content))), int(rng.integers(10, 400))
    return Damage(content[: start + n] + content[start:], f"{n} bytes from {start} doubled")


def cut_out(content: bytes, rng: np.random.Generator) -> Damage:
    """Leave a block out."""
    start, n = int(rng.integers(0, len(content))), int(rng.integers(5, 200))
    return Damage(content[:start] + content[start + n :], f"{n} bytes from {start} left out")


def number(content: bytes, rng: np.random.Generator) -> Damage:
    """Replace a number by a word that is none, or by one that no quantity has."""
    found = list(NUMBER.finditer(content, 0, HEAD if b"\0" in content else len(content)))
    if not found:
        return flipped(content, rng)
    place, word = found[int(rng.integers(len(found)))], WORDS[int(rng.integers(len(WORDS)))]
    out = content[: place.start()] + word + content[place.end() :]
    n_changed = int(word in NUMBERS)  # one that is no number to every reader may not become another value
    return Damage(out, f"number at byte {place.start()} replaced by {word[:12]!r}", n_changed)


def renamed(content: bytes, rng: np.random.Generator) -> Damage:
    """Give the file another ending."""
    ending = ENDINGS[int(rng.integers(len(ENDINGS)))]
    return Damage(content, f"named {ending}", ending=ending)


DAMAGES: tuple[Callable[[bytes, np.random.Generator], Damage], ...] = (
    *(flipped, truncated, number, flipped_in_front, doubled, cut_out, overwritten, flipped, renamed, empty),
)

"""Write arrays and tables as scripts that a page can load, because a page opened as a file may not fetch data."""

from __future__ import annotations

import base64
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np

from ..files.atomic import write_bytes
from ..runs.results import plain

KINDS = {"f": "f4", "i": "i4", "u": "u1"}


def packed(values: np.ndarray) -> dict[str, Any]:
    """Encode an array of any shape for JSON: 32-bit floats, 32-bit integers or bytes; little-endian, gzipped, base64."""
    kind = KINDS[values.dtype.kind]
    raw = np.ascontiguousarray(values, f"<{kind}").tobytes()
    return {"type": kind, "shape": list(values.shape), "gzip": encoded(gzip.compress(raw, 6, mtime=0))}


def encoded(content: bytes) -> str:
    """Encode bytes as base64."""
    return base64.b64encode(content).decode("ascii")


def write_data(path: Path, letter: str, name: str, content: Any) -> None:
    """Write a script that stores ``content`` in the page under a run's letter and a name.

    The script is ASCII with all other characters escaped, so that text in the content cannot act as code.
    """
    text = json.dumps(plain(content), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    head = json.dumps([letter, name])[1:-1]
    write_bytes(path, f"cicatrixPut({head},{text});\n".encode("ascii"))

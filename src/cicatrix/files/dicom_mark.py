"""How a file is known to be DICOM, without the libraries that read it."""

from __future__ import annotations

FIRST_GROUPS = (b"\x02\x00", b"\x08\x00")  # with which a file without preamble begins


def is_dicom(head: bytes) -> bool:
    """Return whether a file begins as DICOM, with its mark or, without preamble, with its first group."""
    return head[128:132] == b"DICM" or head[:2] in FIRST_GROUPS

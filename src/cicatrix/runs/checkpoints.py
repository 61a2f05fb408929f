"""Checkpoints: named arrays in an npz file, and scalars in a JSON file that also has the hash of the arrays.

``state-000012.npz`` is written first and ``state-000012.json`` last: the JSON makes the pair valid. The previous pair is kept,
so that if the newest one is damaged only the work since the previous one is lost. The bytes depend on the content alone (the
dates inside the npz are fixed), so two runs can be compared file by file.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..files.atomic import TEMPORARY, write_bytes, write_json

ZIP_DATE = (1980, 1, 1, 0, 0, 0)
N_CHECKPOINTS = 2  # number of checkpoints that remain on disk


@dataclass(frozen=True)
class Checkpoint:
    """State from which a run can be resumed.

    Parameters
    ----------
    cycle : int
        Cycle at whose end the checkpoint was written.
    arrays : dict of str to array
        Arrays of the state, bit for bit.
    scalars : dict
        Numbers and texts of the state that JSON can represent; floats are exact.
    notes : tuple of str
        Sentences about newer checkpoints that were damaged and skipped.
    """

    cycle: int
    arrays: dict[str, np.ndarray]
    scalars: dict[str, Any]
    notes: tuple[str, ...] = field(default=())


def save_checkpoint(
    folder: Path, cycle: int, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any] | None = None
) -> None:
    """Write a checkpoint, then remove all older ones except the one before it.

    Parameters
    ----------
    folder : Path
        The checkpoint folder; created if it does not exist.
    cycle : int
        Cycle number, at least 0.
    arrays : mapping of str to array
        Arrays of any shape, and of any dtype except objects.
    scalars : mapping, optional
        Values that JSON can represent, without NaN.
    """
    content = npz_bytes(arrays)
    vouched = {"cycle": cycle, "scalars": dict(scalars or {}), "arrays_sha256": hashlib.sha256(content).hexdigest()}
    stem = _stem(cycle)
    write_bytes(folder / f"{stem}.npz", content)
    write_json(folder / f"{stem}.json", vouched | {"sha256": _digest(vouched)})
    keep_newest(folder, cycle)


def keep_newest(folder: Path, cycle: int) -> None:
    """Remove checkpoints newer than that of ``cycle`` or older than the one before it, and incomplete pairs."""
    stem = _stem(cycle)
    _remove(
        folder,
        [other for other in _stems(folder) if other > stem] + _stems(folder, older_than=stem)[N_CHECKPOINTS - 1 :],
    )


def load_checkpoint(folder: Path) -> Checkpoint | None:
    """Read the newest checkpoint that is not damaged; None if the folder has none at all.

    Raises
    ------
    InputError
        If there are checkpoints and all are damaged.
    """
    notes: list[str] = []
    for stem in _stems(folder):
        try:
            return _read(folder, stem, tuple(notes))
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
            notes.append(f"checkpoint {stem} is damaged ({error}) and was skipped")
    if notes:
        raise InputError(f"{folder}: no checkpoint can be read ({'; '.join(notes)}); start without --resume")
    return None


def npz_bytes(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Return the bytes of an uncompressed npz file, as ``numpy.load`` reads it; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(arrays):
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asanyarray(arrays[name]), allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", ZIP_DATE)
            archive.writestr(info, member.getvalue())
    return buffer.getvalue()


def _read(folder: Path, stem: str, notes: tuple[str, ...]) -> Checkpoint:
    vouched = json.loads((folder / f"{stem}.json").read_text(encoding="utf-8"))
    if vouched.pop("sha256") != _digest(vouched):
        raise ValueError("its scalars do not match their hash")
    content = (folder / f"{stem}.npz").read_bytes()
    if hashlib.sha256(content).hexdigest() != vouched["arrays_sha256"]:
        raise ValueError("its arrays do not match their hash")
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return Checkpoint(vouched["cycle"], arrays, vouched["scalars"], notes)


def _digest(vouched: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(vouched, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _stem(cycle: int) -> str:
    return f"state-{cycle:06d}"


def _stems(folder: Path, older_than: str | None = None) -> list[str]:
    """Return the names of the checkpoints without suffix, newest first."""
    stems = sorted({path.stem for path in folder.glob("state-*.json")}, reverse=True)
    return [stem for stem in stems if older_than is None or stem < older_than]


def _remove(folder: Path, stems: list[str]) -> None:
    for stem in stems:
        (folder / f"{stem}.json").unlink(missing_ok=True)
    vouched = set(_stems(folder))
    for path in [*folder.glob("state-*.npz"), *folder.glob(TEMPORARY + "*")]:
        if path.stem not in vouched:
            path.unlink(missing_ok=True)

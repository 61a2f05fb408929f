"""Checkpoints: named arrays in an npz file, and scalars in a JSON file that also has the hash of the arrays.

``state-000012.npz`` is written first and ``state-000012.json`` last: the JSON makes the pair valid. The previous pair is kept,
so that if the newest one is damaged, or the run's files no longer fit it, only the work since the previous one is lost. The
bytes depend on the content alone (the dates inside the npz are fixed), so two runs can be compared file by file.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..files.atomic import TEMPORARY, write_bytes, write_json
from .folders import remove

ZIP_DATE = (1980, 1, 1, 0, 0, 0)
N_CHECKPOINTS = 2  # number of checkpoints that remain on disk while a run goes on
STEM = re.compile(r"state-(\d{6,})")


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
    files : dict
        What the run's folder held of rows and fields up to this state.
    notes : tuple of str
        Sentences about newer checkpoints that were damaged or do not fit, and were skipped.
    """

    cycle: int
    arrays: dict[str, np.ndarray]
    scalars: dict[str, Any]
    files: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = field(default=())


def save_checkpoint(
    folder: Path,
    cycle: int,
    arrays: Mapping[str, np.ndarray],
    scalars: Mapping[str, Any] | None = None,
    files: Mapping[str, Any] | None = None,
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
    scalars, files : mapping, optional
        Values that JSON can represent, without NaN.

    Raises
    ------
    StorageError, InputError
        If a file cannot be written.
    """
    content = npz_bytes(arrays)
    vouched = {
        "cycle": cycle,
        "scalars": dict(scalars or {}),
        "files": dict(files or {}),
        "arrays_sha256": hashlib.sha256(content).hexdigest(),
    }
    stem = _stem(cycle)
    remove(folder / f"{stem}.json")  # of an earlier state of this cycle: no JSON may stand beside other arrays
    write_bytes(folder / f"{stem}.npz", content)
    write_json(folder / f"{stem}.json", vouched | {"sha256": _digest(vouched)})
    keep_newest(folder, cycle)


def keep_newest(folder: Path, cycle: int, n: int = N_CHECKPOINTS) -> None:
    """Keep the checkpoint of ``cycle`` and the ``n - 1`` before it; remove all others, and incomplete pairs."""
    stems = _stems(folder)
    start = stems.index(_stem(cycle))
    for stem in [*stems[:start], *stems[start + n :]]:
        remove(folder / f"{stem}.json")
    vouched = set(_stems(folder))
    for path in [*folder.glob("state-*.npz"), *folder.glob(TEMPORARY + "*")]:
        if path.stem not in vouched:
            remove(path)


def load_checkpoint(folder: Path, doubt: Callable[[Checkpoint], str] | None = None) -> Checkpoint | None:
    """Read the newest checkpoint that is not damaged; None if the folder has none at all.

    Parameters
    ----------
    folder : Path
        The checkpoint folder.
    doubt : callable, optional
        Says why a checkpoint does not fit the other files of the run; empty if it does.

    Raises
    ------
    InputError
        If there are checkpoints and none can be used, or if a file is in the place of the folder.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file, but must be the folder of checkpoints; start without --resume")
    notes: list[str] = []
    for stem in _stems(folder):
        try:
            checkpoint = _read(folder, stem, tuple(notes))
        except Exception as error:  # whatever the damage, the checkpoint before this one may be whole
            notes.append(f"checkpoint {stem} is damaged ({_reason(error)}) and was skipped")
            continue
        reason = doubt(checkpoint) if doubt else ""
        if not reason:
            return checkpoint
        notes.append(f"checkpoint {stem} was skipped: {reason}")
    if notes:
        raise InputError(
            f"{folder}: no checkpoint can be read that fits the run's files ({'; '.join(notes)}); start without --resume"
        )
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
    if not isinstance(vouched, dict) or "sha256" not in vouched:
        raise ValueError("its JSON is not that of a checkpoint")
    if vouched.pop("sha256") != _digest(vouched):
        raise ValueError("its scalars do not match their hash")
    content = (folder / f"{stem}.npz").read_bytes()
    if hashlib.sha256(content).hexdigest() != vouched["arrays_sha256"]:
        raise ValueError("its arrays do not match their hash")
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return Checkpoint(vouched["cycle"], arrays, vouched["scalars"], vouched["files"], notes)


def _reason(error: Exception) -> str:
    return f"{error.strerror}" if isinstance(error, OSError) else str(error) or type(error).__name__


def _digest(vouched: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(vouched, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _stem(cycle: int) -> str:
    return f"state-{cycle:06d}"


def _stems(folder: Path) -> list[str]:
    """Return the names of the checkpoints without suffix, newest first."""
    found = [STEM.fullmatch(path.stem) for path in folder.glob("state-*.json")]
    return [match[0] for match in sorted(filter(None, found), key=lambda match: int(match[1]), reverse=True)]

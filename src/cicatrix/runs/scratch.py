"""Temporary folders of runs: each is removed when no object refers to it any more."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from pathlib import Path
from typing import Any


class ScratchFolder:
    """A new folder that is removed with the last reference to this object, at the latest when Python exits.

    A copy refers to the same folder. Pickling does not preserve the folder: the object is unpickled as None.

    Attributes
    ----------
    path : Path
        The folder.
    """

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="cicatrix-"))
        weakref.finalize(self, _remove, self.path, os.getpid())

    def __copy__(self) -> ScratchFolder:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> ScratchFolder:
        return self

    def __reduce__(self) -> tuple[type, tuple[()]]:
        return type(None), ()


def _remove(path: Path, maker: int) -> None:
    """Remove the folder, unless this is a process forked from the one that made it."""
    if os.getpid() == maker:
        shutil.rmtree(path, ignore_errors=True)

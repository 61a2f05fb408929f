"""SimpleITK, imported when it is first used, and kept silent."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..core.deferred import Deferred

if TYPE_CHECKING:
    import SimpleITK as sitk  # noqa: N813 - the name its own manual uses
else:
    sitk = Deferred("SimpleITK")  # most runs read no image

__all__ = ["quiet", "sitk"]


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress output that the C++ libraries print to file descriptors 1 and 2."""
    shown = sitk.ProcessObject.GetGlobalWarningDisplay()
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(1), os.dup(2)]
    with tempfile.TemporaryFile() as sink:
        try:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
            yield
        finally:
            for descriptor, copy in enumerate(kept, start=1):
                os.dup2(copy, descriptor)
                os.close(copy)
            sitk.ProcessObject.SetGlobalWarningDisplay(shown)

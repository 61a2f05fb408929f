"""Failing inputs that lie outside the project, where a variable says or in ``../shared``; tests skip where they are absent."""

import os
from pathlib import Path

FAULTS = Path(os.environ.get("CICATRIX_FAULTS", Path(__file__).parents[3] / "shared" / "faults"))

"""Numbers of the healing cycles of a case at which visits take place, and of its last cycle."""

from __future__ import annotations

import numpy as np

from ...core.units import days_from_weeks
from .case import LumpectomyCase


def last_cycle(case: LumpectomyCase) -> int:
    """Return the number of the last cycle that the case allows."""
    return int(np.ceil(days_from_weeks(case.run.max_weeks) / case.coupling.days_per_cycle - 1e-9))


def visit_cycles(case: LumpectomyCase) -> dict[float, int]:
    """Return the cycle nearest to each visit: weeks -> cycle number."""
    return {w: round(days_from_weeks(w) / case.coupling.days_per_cycle) for w in case.outcome.visits_weeks}

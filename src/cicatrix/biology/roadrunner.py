"""Networks with events, delays of events and other features beyond a rate law, integrated by libroadrunner (CVODE)."""

from __future__ import annotations

import os
from importlib.util import find_spec
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..core.deferred import Deferred
from ..core.errors import ConvergenceError, InputError
from ..numerics.ode import Accuracy

if TYPE_CHECKING:
    import roadrunner
else:
    roadrunner = Deferred("roadrunner")

MISSING = "it has features beyond a rate law, and needs libroadrunner: pip install 'cicatrix[sbml]'"
TIGHT = 1e-9  # relative tolerance, if the case asks for none below it
ABSOLUTE = 1e-12  # absolute tolerance, relative to the smallest value of the model
SILENT = (
    "SUNLOGGER_ERROR_FILENAME",
    "SUNLOGGER_WARNING_FILENAME",
)  # where CVODE writes lines of its own; else standard error
DIGITS = 12  # of the times of rows, so that a row at the instant of an event is not by rounding before it
STEPS = 20  # least number of steps between two rows while there are jumps, so that no condition passes unseen


class DelegatedNetwork(NamedTuple):
    """A model that libroadrunner integrates, from time 0 on; it has no rates that could be evaluated at a state."""

    species: tuple[str, ...]
    """Names of the columns of a result (n_species,)."""
    input_names: tuple[str, ...]
    """Constants of the model (n_inputs,)."""
    text: str
    """The model as SBML, with its constants and their changes."""
    ids: tuple[str, ...]
    """Id of each column in the text (n_species,)."""
    has_jumps: bool
    """Whether quantities or rates jump at instants that the integration has to find."""
    seconds: float = 1.0
    """The model's unit of time [s]."""

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of what is part of a result besides the columns: none."""
        return ()

    def course(self, times: np.ndarray, accuracy: Accuracy) -> np.ndarray:
        """Return the columns (n_times, n_species) at ascending times (n_times,) [s], of which the first is 0.

        Source: Somogyi et al., Bioinformatics 31:3315-3321 (2015); Welsh et al., Bioinformatics 39:btac770 (2023).

        Raises
        ------
        InputError
            If libroadrunner refuses the model.
        ConvergenceError
            If it cannot be followed to the last time.
        """
        engine = self._engine(times, accuracy)
        try:
            found = np.array(engine.simulate(times=[float(f"{time:.{DIGITS}g}") for time in times / self.seconds]))
        except RuntimeError as error:
            raise ConvergenceError(
                f"libroadrunner could not follow the model to its end ({_short(error)}); if no quantity grows without bound or "
                "ceases to be a number, raise solver.max_steps",
                [],
            ) from None
        return found[:, 1:]

    def _engine(self, times: np.ndarray, accuracy: Accuracy) -> roadrunner.RoadRunner:
        roadrunner.Logger.disableLogging()
        for key in SILENT:
            os.environ.setdefault(key, os.devnull)
        try:
            engine = roadrunner.RoadRunner(self.text)
        except RuntimeError as error:
            raise InputError(f"libroadrunner cannot simulate the model: {_short(error)}") from None
        engine.timeCourseSelections = ["time", *self.ids]
        integrator = engine.integrator
        integrator.relative_tolerance = min(accuracy.relative, TIGHT)
        scale = [abs(one) for one in engine.model.getGlobalParameterValues() if one and np.isfinite(one)]
        absolute = max(min(float(accuracy.absolute), ABSOLUTE) * min([1.0, *scale]), 1e-100)
        # a vector, because a scalar tolerance is multiplied by the state and can become 0 (sys-bio/roadrunner issues 1300, 1349)
        integrator.absolute_tolerance = [absolute] * engine.model.getNumRateRules()
        integrator.maximum_num_steps = accuracy.max_steps
        if self.has_jumps:
            integrator.maximum_time_step = self.longest_step(times) / self.seconds
        return engine

    @staticmethod
    def longest_step(times: np.ndarray) -> float:
        """Return the longest time step between rows at ``times`` (n_times,) [s] while there are jumps [s]."""
        return float(np.diff(times).min()) / STEPS


def refuse_without_engine() -> None:
    """Refuse to go on if libroadrunner is not installed."""
    if find_spec("roadrunner") is None:
        raise InputError(MISSING)


def _short(error: Exception) -> str:
    return " ".join(str(error).split()).partition(";")[0][:200].rstrip(".")

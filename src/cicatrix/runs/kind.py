"""Interface between a kind of case and the driver: a simulation that can be started, integrated, stored and reported.

A simulation does not depend on folders, clocks or terminals, so a notebook can step it as ``cicatrix run`` does::

    simulation = cicatrix.build(case)
    for state in simulation.march(simulation.start()):
        print(simulation.rows(state))
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np

from ..core.ranks import Ranks
from ..geometry.volume import Volume
from .checkpoints import Checkpoint
from .progress import Progress
from .quantity import Quantity

S = TypeVar("S")
Row = Mapping[str, Any]
Packed = tuple[dict[str, np.ndarray], dict[str, Any]]
Drawing = Callable[[], Any]  # returns a matplotlib Figure


@dataclass(frozen=True)
class Context:
    """Context of a simulation: receiver of its progress, ranks that share it, and checkpoint from which it resumes.

    Parameters
    ----------
    progress : Progress
        Receives the stages of long preparations, and the iterations of long solves.
    ranks : Ranks
        Processes that run the simulation together.
    checkpoint : Checkpoint, optional
        The checkpoint from which the run will resume, for a model that is rebuilt from it instead of from its inputs.
    """

    progress: Progress = field(default_factory=Progress)
    ranks: Ranks = field(default_factory=Ranks)
    checkpoint: Checkpoint | None = None


class Fields(NamedTuple):
    """Content of one VTU file: a mesh with data at an instant; shapes of arrays as in :func:`..files.vtu.write_vtu`."""

    part: str
    number: int
    time_days: float
    points: np.ndarray
    cells: np.ndarray
    point_data: Mapping[str, np.ndarray] = {}
    cell_data: Mapping[str, np.ndarray] = {}
    folder: str = "fields"


class ResultTable(NamedTuple):
    """A table of results: column names and rows of texts and numbers."""

    head: Sequence[str]
    rows: Iterable[Sequence[Any]]


class SurfaceData(NamedTuple):
    """A surface of quadratic triangles: points (n, 3) [mm], faces (m, 6), data at the points (n, ...)."""

    points: np.ndarray
    faces: np.ndarray
    point_data: Mapping[str, np.ndarray]


class End(NamedTuple, Generic[S]):
    """Final state of a simulation, with its history and results, without times of this machine: equal runs are equal."""

    state: S
    history: dict[str, np.ndarray]
    """Columns of history.csv (n_rows,)."""
    analysis: Any = None
    """Value returned by :meth:`Simulation.analyse`."""


class Simulation(ABC, Generic[S]):
    """Simulation of a case, ready to integrate; each kind of case derives its own class.

    The constructor reads the inputs and builds arrays and laws. States are immutable: a state that was yielded stays valid, and
    later states depend, to the bit, only on the model and that state.

    Parameters
    ----------
    case : Case
        What to compute.
    context : Context, optional
        Progress display, ranks and checkpoint; by default one process without display.

    Attributes
    ----------
    notes : list of str
        Sentences for the manifest; the driver moves them there.
    """

    building: ClassVar[str] = "model"
    """Name of the stage in which the constructor runs; empty if the constructor names its own stages."""
    marching: ClassVar[str] = "march"
    """Name of the stage in which the states are computed."""
    on_ranks: ClassVar[bool] = False
    """Whether several MPI ranks can run the simulation together."""

    def __init__(self, case: Any, context: Context | None = None) -> None:
        self.case = case
        self.context = context or Context()
        self.notes: list[str] = []

    def __repr__(self) -> str:
        """Return the kind, and how the simulation is stepped."""
        kind = getattr(self.case, "kind", type(self).__name__)
        return f"<simulation of kind {kind}: for state in s.march(s.start()): s.rows(state)>"

    @classmethod
    def of(cls, case: Any) -> type[Simulation]:
        """Return the class that simulates a case: this class, unless a subclass chooses another by the case's settings."""
        return cls

    @abstractmethod
    def start(self) -> S:
        """Return the initial state of the simulation.

        Raises
        ------
        ConvergenceError
            If the initial state is defined by equations and the solver does not converge.
        """

    @abstractmethod
    def march(self, state: S) -> Iterator[S]:
        """Integrate from a given state, and yield every later state to the end of the case.

        Raises
        ------
        ConvergenceError
            If the solver does not converge in a step; the states yielded before that step are valid.
        """

    @abstractmethod
    def rows(self, state: S) -> Iterable[Row]:
        """Return the rows that a state adds to history.csv; the first column is the number of the row."""

    @abstractmethod
    def pack(self, state: S) -> Packed:
        """Return a state as arrays and JSON scalars, for a checkpoint."""

    @abstractmethod
    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> S:
        """Return the state that ``pack`` stored, and restore the solvers."""

    @abstractmethod
    def done(self, state: S) -> tuple[float | None, str]:
        """Return the fraction of the case that is done, 0 to 1 (None: unknown), and a few words for the progress display."""

    @abstractmethod
    def outcome(self, end: End[S]) -> dict[str, Quantity]:
        """Return the results of a finished simulation: outcome name -> value with unit and note."""

    @abstractmethod
    def sentence(self, end: End[S]) -> str:
        """Return a sentence about what the run computed, for its end."""

    def is_mark(self, state: S) -> bool:
        """Return whether resuming from this state gives bitwise the same results; checkpoints are saved only at such states."""
        return True

    def fields(self, state: S) -> Iterable[Fields]:
        """Return the meshes with data to write as VTU files for a state."""
        return ()

    def analyse(self, state: S) -> Any:
        """Compute results from the last state once; outcome, tables and figures use them."""
        return None

    def last_fields(self, end: End[S]) -> Iterable[Fields]:
        """Return the further meshes with data to write after the last state, from the result of ``analyse``."""
        return ()

    def tables(self, end: End[S]) -> Mapping[str, ResultTable]:
        """Return tables of results, by name."""
        return {}

    def surfaces(self, end: End[S]) -> Mapping[str, SurfaceData]:
        """Return surfaces of a solid, by name."""
        return {}

    def figures(self, end: End[S]) -> Mapping[str, Drawing]:
        """Return the functions that draw the run's figures, by name."""
        return {}

    def first_figures(self) -> Mapping[str, Drawing]:
        """Return the functions that draw the model before it is integrated, by name."""
        return {}

    def volumes(self) -> Mapping[str, Volume]:
        """Return image volumes that the run's folder keeps: ``labels``, ``picture``."""
        return {}

    def found(self) -> Mapping[str, Any]:
        """Return values that the model has determined because the case does not give them, for the manifest."""
        return {}

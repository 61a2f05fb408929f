"""Write the folder of a run, so that an incomplete run never looks finished, and read it back as named arrays.

A run is *finished* when its manifest says so, which is written last. Any other state (``running`` after a
power cut, ``failed``, ``interrupted``) is unfinished: it can be resumed from its last checkpoint or started over.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, TypeVar

import numpy as np

from ..core.errors import ConvergenceError, InputError, StorageError
from ..core.optional import optional
from ..files.atomic import replacing, write_bytes, write_json, writing
from ..files.history import History, read_history, table_text
from ..files.images import write_volume
from ..files.stl import write_stl
from ..files.vtu import TimeStepFile, write_series, write_vtu
from ..geometry.transfer import QUARTERS
from ..geometry.volume import Volume
from . import checkpoints
from .checkpoints import Checkpoint
from .fields import FieldSeries
from .folders import is_new, lock, make, remove, sweep, unlock
from .kind import Fields
from .manifest import MANIFEST, add_seconds, continued, new_manifest, read_manifest
from .progress import Progress
from .quantity import Quantity
from .resuming import (
    SERIES_FOLDERS,
    content_of,
    doubt_of,
    earlier_manifest,
    flaw_of,
    history_of,
    read_outcome,
    refuse_other,
    step_files_of,
)
from .scratch import ScratchFolder
from .summary import html_of, text_of

T = TypeVar("T")
PRODUCTS = (
    "checkpoint",
    "outcome.json",
    "history.csv",
    *SERIES_FOLDERS,
    "surfaces",
    "figures",
    "tables",
    "labels.nii.gz",
    "picture.nii.gz",
    "report",
)


@dataclass(frozen=True, repr=False)
class Results:
    """Results of a run.

    Parameters
    ----------
    history : dict of str to (n_rows,) array
        Columns of history.csv; the unit is in the name.
    outcome : dict of str to Quantity
        Outcomes by name.
    manifest : dict
        The case as run, versions, seed, hashes, seconds per stage.
    folder : Path or None
        Where the files are. Those of a run without a folder of its own are removed with the last object that refers to them:
        these results, their fields, or one of the steps.
    """

    history: dict[str, np.ndarray]
    outcome: dict[str, Quantity]
    manifest: dict[str, Any]
    folder: Path | None = None
    _scratch: ScratchFolder | None = field(default=None, compare=False)

    @property
    def status(self) -> tuple[str, str]:
        """State (running, finished, failed, interrupted) and the sentence that explains it."""
        return self.manifest["status"]["state"], self.manifest["status"]["sentence"]

    @property
    def kind(self) -> str:
        """Kind of the case."""
        return self.manifest["case"].get("kind", "")

    @property
    def is_temporary(self) -> bool:
        """Whether the folder is removed with this object."""
        return self._scratch is not None

    @property
    def fields(self) -> FieldSeries:
        """Meshes with data over time, from ``fields/``: a sequence that reads a file only when its arrays are used."""
        return self._series("fields")

    @property
    def shapes(self) -> FieldSeries:
        """Loaded shapes at the visits of a lumpectomy, from ``shapes/``, one part per patient position; empty for other kinds."""
        return self._series("shapes")

    def _series(self, name: str) -> FieldSeries:
        return FieldSeries(Path(), ()) if self.folder is None else FieldSeries.of(self.folder / name, self._scratch)

    def to_pandas(self, table: Literal["history", "outcome"] = "history") -> Any:
        """Return a table as a pandas DataFrame.

        Parameters
        ----------
        table : {"history", "outcome"}
            The rows of history.csv with their columns; or the outcome with ``value``, ``unit`` and ``note`` by name.

        Raises
        ------
        InputError
            If pandas is not installed, or there is no such table.
        """
        if table not in ("history", "outcome"):
            raise InputError(f'to_pandas: there are the tables "history" and "outcome"; got {table!r}')
        pandas = optional("pandas", "to_pandas")
        if table == "history":
            return pandas.DataFrame(self.history)
        rows = {name: (asked.value, asked.unit, asked.note) for name, asked in self.outcome.items()}
        return pandas.DataFrame(rows.values(), index=list(rows), columns=["value", "unit", "note"], dtype=object)

    def __repr__(self) -> str:
        """Return a summary of at most 15 lines: kind, status, size of the history, main outcomes and folder."""
        return text_of(self)

    def _repr_html_(self) -> str:
        """Return the summary as HTML, for notebooks."""
        return html_of(self)


class RunFolder:
    """Writes a run; use :meth:`open`, then ``with``.

    Leaving the block without an error marks the run finished; an error marks it failed or interrupted, with its
    sentence. If the input was at fault before the first checkpoint, a folder made for the run is removed again.

    Attributes
    ----------
    path : Path
        The folder.
    checkpoint : Checkpoint or None
        Checkpoint from which to resume; None means from the start.
    already_finished : bool
        Whether the same run was finished before; then nothing is computed or written.
    """

    def __init__(self, path: Path, manifest: dict[str, Any], progress: Progress, checkpoint: Checkpoint | None = None):
        self.path = path
        self.checkpoint = checkpoint
        self.already_finished = manifest["status"]["state"] == "finished"
        self._manifest = manifest
        self._progress = progress
        self._earlier_seconds = dict(manifest["seconds"])
        self._sentence = "The run is finished."
        self._last_cycle = checkpoint.cycle if checkpoint else None
        self._made_here = False
        self._lock: int | None = None
        self._history = History(path / "history.csv")
        self._step_files: dict[str, list[TimeStepFile]] = {name: [] for name in SERIES_FOLDERS}

    @classmethod
    def open(
        cls,
        path: str | Path,
        case: Mapping[str, Any],
        *,
        seed: int,
        inputs: Mapping[str, Path] | None = None,
        sources: Mapping[str, str] | None = None,
        resume: bool = False,
        progress: Progress | None = None,
    ) -> RunFolder:
        """Create the folder of a new run, or resume an existing one.

        Parameters
        ----------
        path : str or Path
            The folder; made with its parents.
        case : mapping
            The case as nested tables (:func:`cicatrix.cases.reading.case_table`).
        seed : int
            Seed of the random numbers.
        inputs : mapping of str to Path, optional
            Files and folders read, by key; they are hashed.
        sources : mapping of str to str, optional
            Where laws and defaults come from, by key.
        resume : bool
            Resume from the last checkpoint; the case, the input bytes and the version must be the same. Where there
            is no run yet, start one.
        progress : Progress, optional
            Its seconds per stage go to the manifest.

        Raises
        ------
        InputError
            If the folder holds something else, a finished run (without ``resume``), another case (with it), only
            damaged checkpoints, files that no checkpoint fits, or a run that is still in progress; or if it cannot be made.
        StorageError
            If the disk is full.
        """
        path, manifest = Path(path), new_manifest(case, seed, inputs or {}, sources or {})
        made_here = is_new(path)
        with writing(path):
            old = None if made_here else earlier_manifest(path)
        make(path)
        held = lock(path)
        try:
            sweep(path)
            run = cls._continued(path, old, manifest, resume, progress or Progress())
        except BaseException as error:
            unlock(held)
            raise _with_advice(error) from error.__cause__
        run._lock, run._made_here = held, made_here
        return run

    @classmethod
    def _continued(cls, path: Path, old: dict | None, new: dict, resume: bool, progress: Progress) -> RunFolder:
        is_finished = old is not None and old["status"]["state"] == "finished"
        if old is not None and resume:
            refuse_other(path, old, new)
            flaw = flaw_of(path) if is_finished else ""
            if is_finished and not flaw:
                return cls(path, old, progress)
            checkpoint = checkpoints.load_checkpoint(path / "checkpoint", partial(doubt_of, path))
            if checkpoint is not None:
                return cls._resumed(path, continued(old, new), progress, checkpoint, flaw)
            if is_finished:
                raise InputError(f"{path} holds a finished run of which {flaw}, and no checkpoint; give another --out")
            new["notes"].append("Resumed without a checkpoint: the run began anew.")
        elif is_finished:
            raise InputError(f"{path} holds a finished run; give another --out, or --resume to keep it")
        remove(path / PRODUCTS[0])  # the checkpoint goes before the manifest, so it is never taken for the new case's
        write_json(path / MANIFEST, new)
        for name in PRODUCTS[1:]:
            remove(path / name)
        return cls(path, new, progress)

    @classmethod
    def _resumed(
        cls, path: Path, manifest: dict, progress: Progress, checkpoint: Checkpoint, flaw: str = ""
    ) -> RunFolder:
        found = [f"Resumed although finished, as {flaw}."] if flaw else []
        manifest["notes"] += [*found, *checkpoint.notes, f"Resumed after cycle {checkpoint.cycle}."]
        write_json(path / MANIFEST, manifest)
        run = cls(path, manifest, progress, checkpoint)
        checkpoints.keep_newest(path / "checkpoint", checkpoint.cycle)
        remove(path / "outcome.json")
        run._history = History.continued(path / "history.csv", history_of(checkpoint))
        run._history.cut()
        for name in SERIES_FOLDERS:
            run._keep(name, step_files_of(checkpoint, name))
        return run

    def _keep(self, name: str, step_files: list[TimeStepFile]) -> None:
        """Go on with a series of VTU files, and remove the files after it."""
        kept, folder = {step_file.name for step_file in step_files}, self.path / name
        for later in [file for file in folder.glob("*.vtu") if file.name not in kept]:
            remove(later)
        self._step_files[name] = step_files
        if step_files:
            write_series(folder, step_files)
        else:
            remove(folder)

    def content(self) -> dict[str, Any]:
        """Return what a checkpoint holds about the folder: how far history and series are written."""
        return content_of(self._history.mark(), self._step_files)

    def record(self, row: Mapping[str, Any]) -> None:
        """Append a row to history.csv: its number, then values with units in their names; all rows have the same names."""
        self._history.record(row)

    def write_fields(self, fields: Fields) -> Path:
        """Write ``FOLDER/PART-NUMBER.vtu`` and enter it in the folder's series; the folder is one of :data:`SERIES_FOLDERS`."""
        step_file = TimeStepFile(fields.part, int(fields.number), float(fields.time_days))
        path = self.path / fields.folder / step_file.name
        write_vtu(path, fields.points, fields.cells, fields.point_data, fields.cell_data)
        others = [other for other in self._step_files[fields.folder] if other.name != step_file.name]
        self._step_files[fields.folder] = [*others, step_file]
        write_series(self.path / fields.folder, self._step_files[fields.folder])
        return path

    def write_surface(
        self, name: str, points: np.ndarray, faces: np.ndarray, point_data: Mapping[str, np.ndarray]
    ) -> None:
        """Write ``surfaces/NAME.vtu`` and ``.stl``: P2 triangles (n, 6), seen from outside, point data (n_points, ...)."""
        used, renumbered = np.unique(faces, return_inverse=True)
        faces = renumbered.reshape(faces.shape)
        data = {key: values[used] for key, values in point_data.items()}
        write_vtu(self.path / "surfaces" / f"{name}.vtu", points[used], faces, data)
        write_stl(self.path / "surfaces" / f"{name}.stl", points[used], faces[:, QUARTERS].reshape(-1, 3))

    def save_figure(self, name: str, figure: Any, dpi: int = 150) -> Path:
        """Write a matplotlib figure to ``figures/NAME.png``, whole or not at all; equal figures give equal bytes."""
        path = self.path / "figures" / f"{name}.png"
        with replacing(path) as temporary:
            figure.savefig(temporary, dpi=dpi, format="png", metadata={"Software": None})
        return path

    def write_table(self, name: str, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """Write ``tables/NAME.csv``: column names, then rows of texts and plain numbers; floats read back exactly."""
        write_bytes(self.path / "tables" / f"{name}.csv", table_text(head, rows).encode())

    def save_volume(self, name: str, volume: Volume) -> Path:
        """Write ``NAME.nii.gz``, with voxels and geometry only; names as in :data:`PRODUCTS`."""
        path = self.path / f"{name}.nii.gz"
        with replacing(path) as half:
            write_volume(half, volume)
        return path

    def save_checkpoint(
        self,
        cycle: int,
        arrays: Mapping[str, np.ndarray],
        scalars: Mapping[str, Any] | None = None,
        content: Mapping[str, Any] | None = None,
    ) -> None:
        """Save the state at the end of a cycle; the rows and fields up to it must already be written.

        Parameters
        ----------
        cycle : int
            Number of the cycle.
        arrays, scalars : mapping
            The state.
        content : mapping, optional
            What :meth:`content` returned at the end of that cycle; by default, what it returns now.
        """
        content = content or self.content()
        self._history.sync()
        checkpoints.save_checkpoint(self.path / "checkpoint", cycle, arrays, scalars, content)
        self._last_cycle = cycle
        self._write_manifest()

    def write_outcome(self, outcome: Mapping[str, Quantity]) -> None:
        """Write outcome.json; a value that is not finite becomes null."""
        table = {
            name: {"value": plain(asked.value), "unit": asked.unit, "note": asked.note}
            for name, asked in outcome.items()
        }
        write_json(self.path / "outcome.json", table)

    def history(self) -> dict[str, np.ndarray]:
        """Columns of history.csv as written so far."""
        return read_history(self.path / "history.csv")

    def note(self, sentence: str) -> None:
        """Add a sentence to the manifest's notes, unless it is there already, as after a run is resumed."""
        if sentence not in self._manifest["notes"]:
            self._manifest["notes"].append(sentence)

    def found(self, **values: Any) -> None:
        """Store values that the case did not give and the run has determined, under ``found`` in the manifest."""
        self._manifest["found"] = {**self._manifest.get("found", {}), **plain(values)}
        self._write_manifest()

    def finish(self, sentence: str) -> None:
        """Set the sentence that the manifest gives once the block is left without an error."""
        self._sentence = sentence

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            fault = self._leave(error)
        finally:
            unlock(self._lock)
        try:
            if fault is not None and fault is not error:
                raise fault from error
        finally:
            del fault, error  # their tracebacks refer to this frame

    def _leave(self, error: BaseException | None) -> BaseException | None:
        """Close the files, and return the error to raise: one that the disk causes now, or the given one with advice."""
        try:
            self._history.close()
        except StorageError as late:
            error = error or late
        if isinstance(error, InputError) and self._made_here and self._last_cycle is None:
            shutil.rmtree(self.path, ignore_errors=True)
            return error
        error = _with_advice(error) if error else None
        try:
            if not self.already_finished:
                self._close_with(error)
        except (StorageError, InputError) as late:  # the manifest remains that of a run that has not ended
            error = error or _with_advice(late)
        return error

    def _close_with(self, error: BaseException | None) -> None:
        state = "finished" if error is None else "failed" if isinstance(error, Exception) else "interrupted"
        sentences = {"finished": self._sentence, "failed": str(error), "interrupted": self._interruption()}
        if state == "failed" and not hasattr(error, "exit_code"):
            sentences["failed"] = f"Unexpected {type(error).__name__}: {str(error).partition(chr(10))[0]}"
        if isinstance(error, ConvergenceError):
            for line in error.history:
                self.note(line)
        if state == "finished" and self._last_cycle is not None:
            checkpoints.keep_newest(self.path / "checkpoint", self._last_cycle, 1)
        self._manifest["status"] = {"state": state, "sentence": sentences[state]}
        self._write_manifest()

    def _interruption(self) -> str:
        if self._last_cycle is None:
            return "Interrupted before the first checkpoint; it starts over."
        return f"Interrupted after cycle {self._last_cycle}; it can be resumed from there."

    def _write_manifest(self) -> None:
        self._manifest["seconds"] = add_seconds(self._earlier_seconds, self._progress.seconds)
        write_json(self.path / MANIFEST, self._manifest)


def open_run(folder: str | Path) -> Results:
    """Read the folder of a run, finished or not; an unfinished one has the rows and fields so far, and no outcome.

    Parameters
    ----------
    folder : str or Path
        Folder of the run.

    Raises
    ------
    InputError
        If the folder contains no run, or one of the run's files cannot be read.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder} holds no run: there is no such folder")
    manifest = read_manifest(folder)
    if manifest is None:
        raise InputError(f"{folder} holds no run: it has no {MANIFEST}")
    history = _undamaged(read_history, folder / "history.csv")
    return Results(history, _undamaged(read_outcome, folder / "outcome.json"), manifest, folder)


def _undamaged(read: Callable[[Path], T], path: Path) -> T:
    try:
        return read(path)
    except (ValueError, TypeError, AttributeError, IndexError, OSError, RecursionError):
        raise InputError(f"{path} is damaged: it cannot be read as the {path.stem} of a run") from None


def plain(value: Any) -> Any:
    """Convert numbers, arrays and nested tables to types that JSON can represent; NaN and infinity become None."""
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _with_advice(error: BaseException) -> BaseException:
    return StorageError(f"{error}, then run again with --resume") if isinstance(error, StorageError) else error

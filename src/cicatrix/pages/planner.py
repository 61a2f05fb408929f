"""What the planning page can ask for: its files, measures of a resection, a saved case, a run and its report."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.version import __version__
from ..files.opening import LARGEST_NAME
from ..kinds.lumpectomy.case import MODEL_WORDS
from .job import Job
from .packing import encoded, write_data
from .planning import PlanningTable, ResectionPlan, save_case
from .report import map_stops, write_report
from .slices import nifti, zones
from .writing import copy_assets, write_page

MEASURING = 2  # resections that are measured at the same time
LONGEST_PART = 255  # of a path that Linux opens: bytes between two slashes
PATIENCE_S = 5.0  # time for which a third one waits


class BusyError(Exception):
    """Refusal of an action because others like it are in progress: the same request will do a little later."""


class Planner:
    """Actions and files behind the planning page.

    Parameters
    ----------
    table : PlanningTable
        The segmented breast.
    out : Path
        Folder for cases and runs.
    site : Path
        Folder for the page's own files.
    """

    def __init__(self, table: PlanningTable, out: Path, site: Path):
        self.table, self.out, self.site = table, out, site
        self.job = Job(out)
        self.measuring = threading.BoundedSemaphore(MEASURING)
        self._one_at_a_time = threading.Lock()
        self.actions: dict[str, Callable[[Any], dict[str, Any]]] = {
            "measure": self._measure,
            "save": self._save,
            "start": self._start,
            "stop": self._stop,
            "progress": lambda _: self.job.progress(),
            "report": self._report,
        }
        self._write_site()

    def _write_site(self) -> None:
        copy_assets(self.site / "assets")
        centre = self.table.first_centre()
        plan = ResectionPlan(centre_mm=tuple(centre.tolist()))
        grid = self.table.picture
        volumes = {
            "picture": grid,
            "labels": self.table.labels,
            "zones": zones(grid, centre, plan.radius_mm, plan.margin_mm),
        }
        content = {
            "volumes": {name: encoded(nifti(volume)) for name, volume in volumes.items()},
            "labels": ["air", "fat", "gland", "skin", "tumour", "chest"],
            "centre": centre,
            "radius": plan.radius_mm,
            "margin": plan.margin_mm,
            "grid": {"shape": grid.shape[::-1], "spacing": grid.spacing_mm, "origin": grid.origin_mm},
        }
        write_data(self.site / "data" / "slices.js", "A", "slices", content)
        write_data(self.site / "data" / "maps.js", "A", "maps", map_stops())
        values = {"version": __version__, "assets": "assets", "letter": "A", "plan": plan, "models": MODEL_WORDS}
        values |= {"notes": self.table.notes, "connect": "'self' data: blob:"}
        write_page(self.site / "index.html", "plan.html", values)

    def _measure(self, content: Any) -> dict[str, Any]:
        plan = ResectionPlan.of(content)
        if not self.measuring.acquire(timeout=PATIENCE_S):
            raise BusyError("other resections are being measured; ask again in a second")
        try:
            return self.table.measured(plan)
        finally:
            self.measuring.release()

    def _save(self, content: Any) -> dict[str, Any]:
        with self._one_at_a_time:
            path = save_case(self.table, ResectionPlan.of(content), self.out)
        return {"case": path.name, "text": path.read_text(encoding="utf-8"), "folder": str(self.out)}

    def _start(self, content: Any) -> dict[str, Any]:
        with self._one_at_a_time:
            path = save_case(self.table, ResectionPlan.of(content), self.out)
            if not self.job.start(path):
                raise InputError("a run is in progress; stop it first")
        return {"case": path.name}

    def _stop(self, content: Any) -> dict[str, Any]:
        self.job.stop()
        return self.job.progress()

    def _report(self, content: Any) -> dict[str, Any]:
        """Write the report of the last run, finished or not, and return its address."""
        if self.job.out is None or not self.job.out.is_dir():
            raise InputError("there is no run to report on; start one first")
        with self._one_at_a_time:
            write_report(self.job.out, self.job.out / "report")
        return {"page": f"report/{self.job.out.name}/index.html"}

    def file(self, path: str) -> Path | None:
        """Return the file for a path below the secret; None if there is none or it lies outside the allowed folders."""
        if (
            "\0" in path
            or len(path) > LARGEST_NAME
            or any(len(part.encode()) > LONGEST_PART for part in path.split("/"))
        ):
            return None
        root, rest = self.site, path or "index.html"
        if path.startswith("report/"):
            run, _, rest = path.removeprefix("report/").partition("/")
            if not run.startswith("plan-") or "/" in run or ".." in run:
                return None
            root = self.out / run / "report"
        found = (root / rest).resolve()
        return found if found.is_relative_to(root.resolve()) and found.is_file() else None

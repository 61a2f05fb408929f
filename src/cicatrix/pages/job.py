"""Run of a case in a separate process, which the planning page starts, watches and stops."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..files.history import read_history
from ..runs.manifest import read_manifest

PATIENCE_S = 60.0  # time that a run has to write its last checkpoint
TAIL = 12  # number of last log lines shown on the page


@dataclass
class Job:
    """Process that runs cases, one at a time.

    Parameters
    ----------
    folder : Path
        Folder of the cases and runs.
    """

    folder: Path
    _process: subprocess.Popen[bytes] | None = field(default=None, init=False)
    _case: Path | None = field(default=None, init=False)

    @property
    def is_running(self) -> bool:
        """Whether the process is still running."""
        return self._process is not None and self._process.poll() is None

    @property
    def out(self) -> Path | None:
        """Folder of the run that was started last."""
        return None if self._case is None else self._case.with_suffix("")

    def start(self, case: Path) -> bool:
        """Run a case, or resume it if it was stopped; return False if another run is still in progress."""
        if self.is_running:
            return False
        self._case = case
        command = [sys.executable, "-m", "cicatrix", "run", case.name, "--out", case.stem, "--resume"]
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                command, cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
            )
        return True

    def stop(self) -> None:
        """Interrupt the run like Ctrl-C and wait until it has saved its state."""
        if self._process is None or not self.is_running:
            return
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def progress(self) -> dict[str, Any]:
        """Return the state of the run, a sentence about it, its last log lines, and the closed fraction over days."""
        if self._process is None or self._case is None or self.out is None:
            return {"state": "idle", "sentence": "No run has been started.", "lines": [], "days": [], "closed": []}
        history = read_history(self.out / "history.csv")
        state, sentence = self._state()
        return {
            "case": self._case.name,
            "state": state,
            "sentence": sentence,
            "lines": self._log.read_text(encoding="utf-8", errors="replace").splitlines()[-TAIL:],
            "days": list(map(float, history.get("time_days", []))),
            "closed": list(map(float, history.get("closed_fraction", []))),
        }

    @property
    def _log(self) -> Path:
        assert self._case is not None
        return self._case.with_suffix(".log")

    def _state(self) -> tuple[str, str]:
        assert self._process is not None
        assert self.out is not None
        if self.is_running:
            return "running", "The run is in progress."
        manifest = read_manifest(self.out)
        if manifest is None:  # the case was refused before the run began
            lines = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
            return "failed", lines[-1] if lines else f"The run ended with code {self._process.returncode}."
        state, sentence = manifest["status"]["state"], manifest["status"]["sentence"]
        return ("interrupted", "The run was ended from outside.") if state == "running" else (state, sentence)

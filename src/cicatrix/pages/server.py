"""Server of the planning page: it listens on this machine only, under a secret path, and refuses other origins.

It serves one browser on the loopback address, so the server of the standard library is enough. Its security rests on
which requests it answers: docs/decisions/0024.
"""

from __future__ import annotations

import hmac
import json
import mimetypes
import secrets
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from ..core.errors import CicatrixError, InputError
from ..core.version import __version__
from .job import Job
from .packing import encoded, write_data
from .planning import PlanningTable, ResectionPlan, save_case
from .report import map_stops, write_report
from .slices import nifti, zones
from .writing import copy_assets, write_page

HOST = "127.0.0.1"
MAX_BYTES = 100_000  # size limit of a request
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


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
        values = {"version": __version__, "assets": "assets", "letter": "A", "plan": plan, "notes": self.table.notes}
        write_page(self.site / "index.html", "plan.html", {**values, "connect": "'self' data: blob:"})

    def _measure(self, content: Any) -> dict[str, Any]:
        return self.table.measured(ResectionPlan.of(content))

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
        root, rest = self.site, path or "index.html"
        if path.startswith("report/"):
            run, _, rest = path.removeprefix("report/").partition("/")
            if not run.startswith("plan-") or "/" in run or ".." in run:
                return None
            root = self.out / run / "report"
        found = (root / rest).resolve()
        return found if found.is_relative_to(root.resolve()) and found.is_file() else None


class PlanServer(ThreadingHTTPServer):
    """HTTP server that gives access to a planner under a secret path."""

    daemon_threads = True

    def __init__(self, planner: Planner, port: int = 0):
        self.planner, self.token = planner, secrets.token_urlsafe(24)
        super().__init__((HOST, port), Handler)

    @property
    def address(self) -> str:
        """Address of the page, including the secret."""
        return f"http://{HOST}:{self.server_port}/{self.token}/"

    @property
    def hosts(self) -> set[str]:
        """Values of the Host header that are accepted; another name could be another site's domain that resolves here."""
        return {f"{HOST}:{self.server_port}", f"localhost:{self.server_port}"}


class Handler(BaseHTTPRequestHandler):
    """Handler of one request."""

    server: PlanServer
    server_version = "cicatrix"
    sys_version = ""
    timeout = 30

    def do_GET(self) -> None:
        """Send a file of the page or of a report."""
        path = self._admitted()
        if path is None:
            return
        found = self.server.planner.file(path)
        if found is None:
            self._send_json(HTTPStatus.NOT_FOUND, {"error": "there is no such page"})
            return
        kind = mimetypes.guess_type(found.name)[0] or "application/octet-stream"
        self._send(HTTPStatus.OK, found.read_bytes(), kind)

    def do_POST(self) -> None:
        """Perform the action that the page requests."""
        path = self._admitted()
        if path is None:
            return
        action = self.server.planner.actions.get(path)
        if action is None:
            self._send_json(HTTPStatus.NOT_FOUND, {"error": "there is no action of this name"})
            return
        try:
            self._send_json(HTTPStatus.OK, action(self._content()))
        except CicatrixError as error:
            self._send_json(HTTPStatus.UNPROCESSABLE_ENTITY, {"error": str(error)})
        except Exception as error:
            self._send_json(HTTPStatus.INTERNAL_SERVER_ERROR, {"error": f"internal error ({type(error).__name__})"})
            raise

    def _admitted(self) -> str | None:
        """Return the path below the secret; if the request is not allowed, refuse it and return None."""
        parts = urlsplit(self.path)
        token, _, rest = unquote(parts.path).removeprefix("/").partition("/")
        origin, site = self.headers.get("Origin"), self.headers.get("Sec-Fetch-Site", "none")
        known = {f"http://{host}" for host in self.server.hosts}
        is_ours = self.headers.get("Host") in self.server.hosts and (origin is None or origin in known)
        if not (
            is_ours
            and site in ("none", "same-origin")
            and hmac.compare_digest(token.encode(), self.server.token.encode())
        ):
            self._send_json(HTTPStatus.FORBIDDEN, {"error": "only the browser tab that opened this page may use it"})
            return None
        return rest

    def _content(self) -> Any:
        if self.headers.get_content_type() != "application/json":
            raise InputError("a request must be JSON")
        length = self.headers.get("Content-Length", "0")
        if not length.isdecimal() or int(length) > MAX_BYTES:
            raise InputError(f"a request must be shorter than {MAX_BYTES} bytes")
        try:
            return json.loads(self.rfile.read(int(length)) or b"{}")
        except ValueError:
            raise InputError("a request must be JSON") from None

    def _send_json(self, status: HTTPStatus, content: dict[str, Any]) -> None:
        self._send(status, json.dumps(content, allow_nan=False).encode(), "application/json")

    def _send(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing, because the address contains the secret."""

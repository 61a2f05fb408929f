"""The planning page's server: this machine alone, one secret path, no request from another origin.

It speaks to one browser on the loopback address, so the standard library's server is enough; what it must get right is
whom it answers: docs/decisions/0024.
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
from .planning import PlanningTable, Wish, save_case
from .report import map_stops, write_report
from .slices import nifti, zones
from .writing import copy_assets, write_page

HOST = "127.0.0.1"
MOST_BYTES = 100_000  # of a request
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Planner:
    """What the page can ask for.

    Parameters
    ----------
    table : PlanningTable
        The segmented breast.
    out : Path
        Where cases and runs go.
    site : Path
        Folder that the page's files are written to.
    """

    def __init__(self, table: PlanningTable, out: Path, site: Path):
        self.table, self.out, self.site = table, out, site
        self.job = Job(out)
        self._one_at_a_time = threading.Lock()
        self.acts: dict[str, Callable[[Any], dict[str, Any]]] = {
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
        wish = Wish(centre_mm=tuple(centre.tolist()))
        grid = self.table.picture
        volumes = {
            "picture": grid,
            "labels": self.table.labels,
            "zones": zones(grid, centre, wish.radius_mm, wish.margin_mm),
        }
        content = {
            "volumes": {name: encoded(nifti(volume)) for name, volume in volumes.items()},
            "labels": ["air", "fat", "gland", "skin", "tumour", "chest"],
            "centre": centre,
            "radius": wish.radius_mm,
            "margin": wish.margin_mm,
            "grid": {"shape": grid.shape[::-1], "spacing": grid.spacing_mm, "origin": grid.origin_mm},
        }
        write_data(self.site / "data" / "slices.js", "A", "slices", content)
        write_data(self.site / "data" / "maps.js", "A", "maps", map_stops())
        values = {"version": __version__, "assets": "assets", "letter": "A", "wish": wish, "notes": self.table.notes}
        write_page(self.site / "index.html", "plan.html", {**values, "connect": "'self' data: blob:"})

    def _measure(self, content: Any) -> dict[str, Any]:
        return self.table.measured(Wish.of(content))

    def _save(self, content: Any) -> dict[str, Any]:
        with self._one_at_a_time:
            path = save_case(self.table, Wish.of(content), self.out)
        return {"case": path.name, "text": path.read_text(encoding="utf-8"), "folder": str(self.out)}

    def _start(self, content: Any) -> dict[str, Any]:
        with self._one_at_a_time:
            path = save_case(self.table, Wish.of(content), self.out)
            if not self.job.start(path):
                raise InputError("a run is going on; stop it first")
        return {"case": path.name}

    def _stop(self, content: Any) -> dict[str, Any]:
        self.job.stop()
        return self.job.progress()

    def _report(self, content: Any) -> dict[str, Any]:
        """Write the report of the last run, as far as it is; where the page finds it."""
        if self.job.out is None or not self.job.out.is_dir():
            raise InputError("there is no run to report on; start one first")
        with self._one_at_a_time:
            write_report(self.job.out, self.job.out / "report")
        return {"page": f"report/{self.job.out.name}/index.html"}

    def file(self, path: str) -> Path | None:
        """The file that a path below the secret means, if there is one."""
        root, rest = self.site, path or "index.html"
        if path.startswith("report/"):
            run, _, rest = path.removeprefix("report/").partition("/")
            if not run.startswith("plan-") or "/" in run or ".." in run:
                return None
            root = self.out / run / "report"
        found = (root / rest).resolve()
        return found if found.is_relative_to(root.resolve()) and found.is_file() else None


class PlanServer(ThreadingHTTPServer):
    """Serves a planner at a secret path."""

    daemon_threads = True

    def __init__(self, planner: Planner, port: int = 0):
        self.planner, self.token = planner, secrets.token_urlsafe(24)
        super().__init__((HOST, port), Handler)

    @property
    def address(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server_port}/{self.token}/"

    @property
    def hosts(self) -> set[str]:
        """What a request may call this server: other names could be another site's that lead here."""
        return {f"{HOST}:{self.server_port}", f"localhost:{self.server_port}"}


class Handler(BaseHTTPRequestHandler):
    """One request."""

    server: PlanServer
    server_version = "cicatrix"
    sys_version = ""
    timeout = 30

    def do_GET(self) -> None:
        """Send a file of the page, or of a report."""
        path = self._admitted()
        if path is None:
            return
        found = self.server.planner.file(path)
        if found is None:
            self._say(HTTPStatus.NOT_FOUND, {"error": "there is no such page"})
            return
        kind = mimetypes.guess_type(found.name)[0] or "application/octet-stream"
        self._send(HTTPStatus.OK, found.read_bytes(), kind)

    def do_POST(self) -> None:
        """Do what the page asks for."""
        path = self._admitted()
        if path is None:
            return
        act = self.server.planner.acts.get(path)
        if act is None:
            self._say(HTTPStatus.NOT_FOUND, {"error": "there is nothing of this name to do"})
            return
        try:
            self._say(HTTPStatus.OK, act(self._content()))
        except CicatrixError as error:
            self._say(HTTPStatus.UNPROCESSABLE_ENTITY, {"error": str(error)})
        except Exception as error:
            self._say(HTTPStatus.INTERNAL_SERVER_ERROR, {"error": f"a fault inside cicatrix ({type(error).__name__})"})
            raise

    def _admitted(self) -> str | None:
        """The path below the secret, or None once the request has been refused."""
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
            self._say(HTTPStatus.FORBIDDEN, {"error": "this page answers its own browser tab alone"})
            return None
        return rest

    def _content(self) -> Any:
        if self.headers.get_content_type() != "application/json":
            raise InputError("a request must be JSON")
        length = self.headers.get("Content-Length", "0")
        if not length.isdecimal() or int(length) > MOST_BYTES:
            raise InputError(f"a request must be shorter than {MOST_BYTES} bytes")
        try:
            return json.loads(self.rfile.read(int(length)) or b"{}")
        except ValueError:
            raise InputError("a request must be JSON") from None

    def _say(self, status: HTTPStatus, content: dict[str, Any]) -> None:
        self._send(status, json.dumps(content, allow_nan=False).encode(), "application/json")

    def _send(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: the address holds the secret."""

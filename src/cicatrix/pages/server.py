"""Server of the planning page: it listens on this machine only, under a secret path, and refuses other origins.

It serves one browser on the loopback address, so the server of the standard library is enough. Its security rests on
which requests it answers: docs/decisions/0024. Whatever is sent to it is answered by a sentence in JSON: it reads no more than
:data:`MAX_BYTES` of it for no longer than :data:`SECONDS`, from no more than :data:`CONNECTIONS` clients at once.
"""

from __future__ import annotations

import hmac
import io
import json
import mimetypes
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

from ..core.errors import CicatrixError
from .planner import BusyError, Planner
from .policy import policy

HOST = "127.0.0.1"
MAX_BYTES = 100_000  # size limit of a request
MAX_TABLES = 100  # lists and tables in a request; the parser takes stack for each level
SECONDS = 15.0  # time in which a request has to arrive
CONNECTIONS = 32  # answered at the same time; a browser opens six
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": policy("'self' data: blob:", files="") + "; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
ALLOWED = {"Allow": "GET, POST"}
SOON = {"Retry-After": "1"}


class Reply(NamedTuple):
    """Answer to a request."""

    status: int
    body: bytes
    kind: str
    """Media type of the body."""
    headers: dict[str, str]


def _said(status: int, content: dict[str, Any], headers: dict[str, str] | None = None) -> Reply:
    return Reply(status, json.dumps(content, allow_nan=False).encode(), "application/json", headers or {})


class RefusedError(Exception):
    """A request that is not answered: a status and a sentence that says why."""

    def __init__(self, status: int, sentence: str, headers: dict[str, str] | None = None):
        super().__init__(sentence)
        self.reply = _said(status, {"error": sentence}, headers)


class PlanServer(ThreadingHTTPServer):
    """HTTP server that gives access to a planner under a secret path."""

    daemon_threads = True
    request_queue_size = CONNECTIONS

    def __init__(self, planner: Planner, port: int = 0):
        self.planner, self.token = planner, secrets.token_urlsafe(24)
        self._places = threading.BoundedSemaphore(CONNECTIONS)
        super().__init__((HOST, port), Handler)

    @property
    def address(self) -> str:
        """Address of the page, including the secret."""
        return f"http://{HOST}:{self.server_port}/{self.token}/"

    @property
    def hosts(self) -> set[str]:
        """Values of the Host header that are accepted; another name could be another site's domain that resolves here."""
        return {f"{HOST}:{self.server_port}", f"localhost:{self.server_port}"}

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, or at once with 503 if all places are taken."""
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            _turn_away(request)
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and give the place free."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say in a line what went wrong in the program; that a client has hung up is none of it."""
        error = sys.exception()
        if error is not None and not isinstance(error, OSError):
            _report(error)


class Handler(BaseHTTPRequestHandler):
    """Handler of one request."""

    server: PlanServer
    server_version = "cicatrix"
    sys_version = ""

    def setup(self) -> None:
        """Let all reading from the client end after :data:`SECONDS`."""
        super().setup()
        self.rfile = io.BufferedReader(_Timed(self.connection, SECONDS))

    def do_GET(self) -> None:
        """Send a file of the page or of a report."""
        self._answer(self._page)

    def do_POST(self) -> None:
        """Perform the action that the page requests."""
        self._answer(self._act)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse what the standard library cannot read as a request, in a sentence; it calls this method."""
        self.request_version = self.protocol_version  # so that the answer has a head
        if code == HTTPStatus.NOT_IMPLEMENTED:
            refusal = RefusedError(HTTPStatus.METHOD_NOT_ALLOWED, "only GET and POST are answered", ALLOWED)
        else:
            refusal = RefusedError(code, f"the request cannot be read ({HTTPStatus(code).phrase})")
        self._send(refusal.reply)

    def _answer(self, reply: Callable[[str], Reply]) -> None:
        """Send what ``reply`` returns for the path below the secret, or the reason why there is no reply."""
        try:
            self._send(reply(self._admitted()))
        except RefusedError as refusal:
            self._send(refusal.reply)
        except TimeoutError:
            self._send(_said(HTTPStatus.REQUEST_TIMEOUT, {"error": f"the request did not arrive in {SECONDS:g} s"}))
        except ConnectionError:
            self.close_connection = True
        except Exception as error:
            _report(error)
            self._send(_said(HTTPStatus.INTERNAL_SERVER_ERROR, {"error": f"internal error ({type(error).__name__})"}))

    def _page(self, path: str) -> Reply:
        found = self.server.planner.file(path)
        if found is None:
            raise RefusedError(HTTPStatus.NOT_FOUND, "there is no such page")
        kind = mimetypes.guess_type(found.name)[0] or "application/octet-stream"
        return Reply(HTTPStatus.OK, found.read_bytes(), kind, {})

    def _act(self, path: str) -> Reply:
        action = self.server.planner.actions.get(path)
        if action is None:
            raise RefusedError(HTTPStatus.NOT_FOUND, "there is no action of this name")
        content = self._content()
        try:
            return _said(HTTPStatus.OK, action(content))
        except BusyError as busy:
            raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, str(busy), SOON) from None
        except CicatrixError as error:
            raise RefusedError(HTTPStatus.UNPROCESSABLE_ENTITY, str(error)) from None

    def _admitted(self) -> str:
        """Return the path below the secret, if the request is allowed."""
        try:
            token, _, rest = unquote(urlsplit(self.path).path).removeprefix("/").partition("/")
        except ValueError:
            raise RefusedError(HTTPStatus.BAD_REQUEST, "the request names no address that can be read") from None
        origin, site = self.headers.get("Origin"), self.headers.get("Sec-Fetch-Site", "none")
        known = {f"http://{host}" for host in self.server.hosts}
        (host, *others) = self.headers.get_all("Host", [""])
        is_ours = host in self.server.hosts and not others and (origin is None or origin in known)
        if not (
            is_ours
            and site in ("none", "same-origin")
            and hmac.compare_digest(token.encode(), self.server.token.encode())
        ):
            raise RefusedError(HTTPStatus.FORBIDDEN, "only the browser tab that opened this page may use it")
        return rest

    def _content(self) -> Any:
        """Read the body of a request, which is JSON of a known and small size."""
        if self.headers.get_content_type() != "application/json":
            raise RefusedError(
                HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a request must be JSON (Content-Type: application/json)"
            )
        body = self._body()
        if body.count(b"[") + body.count(b"{") > MAX_TABLES:
            raise RefusedError(HTTPStatus.BAD_REQUEST, f"a request must hold at most {MAX_TABLES} lists and tables")
        try:
            return json.loads(body or b"{}", parse_constant=_no_number, object_pairs_hook=_without_doubles)
        except ValueError:
            raise RefusedError(
                HTTPStatus.BAD_REQUEST,
                "a request must be JSON, in which all numbers are finite and no name stands twice",
            ) from None

    def _body(self) -> bytes:
        lengths = self.headers.get_all("Content-Length", [])
        if len(lengths) != 1 or "Transfer-Encoding" in self.headers:
            raise RefusedError(
                HTTPStatus.LENGTH_REQUIRED, "a request must say its length once, by Content-Length, in one piece"
            )
        text = lengths[0].strip().lstrip("0") or "0"
        if not (text.isascii() and text.isdecimal()):
            raise RefusedError(HTTPStatus.BAD_REQUEST, "Content-Length must be a whole number of bytes")
        if len(text) > len(str(MAX_BYTES)) or int(text) > MAX_BYTES:
            raise RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a request must be shorter than {MAX_BYTES} bytes")
        body = self.rfile.read(int(text))
        if len(body) < int(text):
            raise RefusedError(HTTPStatus.BAD_REQUEST, f"the request ended after {len(body)} of {text} bytes")
        return body

    def _send(self, reply: Reply) -> None:
        self.connection.settimeout(SECONDS)
        self.send_response(reply.status)
        fixed = {"Content-Type": reply.kind, "Content-Length": str(len(reply.body))}
        for name, value in {**HEADERS, **fixed, **reply.headers}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(reply.body)
        if reply.status >= HTTPStatus.BAD_REQUEST:
            _drain(self.connection)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing, because the address contains the secret."""


class _Timed(io.RawIOBase):
    """Bytes that a client sends, for as long as its time lasts; then TimeoutError."""

    def __init__(self, connection: socket.socket, seconds: float):
        self._connection, self._end = connection, time.monotonic() + seconds

    def readable(self) -> bool:
        """Return True: this is a stream to read from."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read what has arrived, or wait for it."""
        left = self._end - time.monotonic()
        if left <= 0.0:
            raise TimeoutError
        self._connection.settimeout(left)
        return self._connection.recv_into(buffer)


def _drain(connection: socket.socket) -> None:
    """Take a part of what a refused client still sends: closing on unread bytes would reset the connection and lose the reply."""
    try:
        connection.shutdown(socket.SHUT_WR)
        connection.settimeout(0.5)
        for _ in range(16):
            if not connection.recv(1 << 16):
                return
    except OSError:
        return


def _turn_away(connection: socket.socket) -> None:
    reply = RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, "too many requests at once; ask again in a second", SOON).reply
    lines = [f"HTTP/1.0 {reply.status} Service Unavailable", f"Content-Type: {reply.kind}"]
    lines += [f"{name}: {value}" for name, value in {**HEADERS, **reply.headers}.items()]
    try:
        connection.settimeout(0.0)
        connection.send("\r\n".join([*lines, "", ""]).encode() + reply.body)
    except OSError:
        return


def _no_number(word: str) -> Any:
    raise ValueError(word)


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        raise ValueError("a name stands twice")
    return table


def _report(error: BaseException) -> None:
    at = error.__traceback__
    while at is not None and at.tb_next is not None:
        at = at.tb_next
    place = f" at {at.tb_frame.f_code.co_filename}:{at.tb_lineno}" if at is not None else ""
    print(f"cicatrix plan: internal error ({type(error).__name__}: {error}){place}", file=sys.stderr)

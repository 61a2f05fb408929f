"""What the planning server answers to requests that no browser sends, over plain sockets."""

import json
import socket
import threading
import time
from contextlib import closing
from threading import Thread

import pytest

from cicatrix.pages import planner as planner_module
from cicatrix.pages import server as server_module
from cicatrix.pages.planner import Planner
from cicatrix.pages.planning import PlanningTable
from cicatrix.pages.server import CONNECTIONS, MAX_BYTES, PlanServer

from .conftest import CENTRE, grid

DEEP = 90_000


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("planning")
    table = PlanningTable(grid(), grid(), {"phantom": "half-ellipsoid", "side": "left"}, ())
    running = PlanServer(Planner(table, folder / "out", folder / "site"))
    Thread(target=running.serve_forever, daemon=True).start()
    yield running
    running.shutdown()
    running.server_close()


@pytest.fixture(autouse=True)
def _no_word_on_the_console(capfd):
    yield
    said = capfd.readouterr()
    assert said.err == said.out == ""


def received(connection):
    """Return status, headers by lower-case name, and body of an answer."""
    with connection.makefile("rb") as stream:
        whole = stream.read()
    head, _, body = whole.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    headers = dict(line.split(": ", 1) for line in lines)
    return int(first.split()[1]), {name.lower(): value for name, value in headers.items()}, body


def sent(server, *parts, pause=0.0):
    with closing(socket.create_connection(("127.0.0.1", server.server_port), 30)) as connection:
        for part in parts:
            connection.sendall(part)
            time.sleep(pause)
        return received(connection)


def head(server, path="measure", method="POST", **headers):
    named = {"Host": f"127.0.0.1:{server.server_port}", "Content-Type": "application/json"}
    named |= {name.replace("_", "-"): value for name, value in headers.items()}
    lines = [f"{method} /{server.token}/{path} HTTP/1.1", *(f"{key}: {value}" for key, value in named.items()), "", ""]
    return "\r\n".join(lines).encode("latin-1")


def asked(server, body, **headers):
    return sent(server, head(server, Content_Length=len(body), **headers) + body)


def plan(**keys):
    return json.dumps({"centre_mm": CENTRE, **keys}).encode()


def test_a_plan_over_a_plain_socket_is_measured(server):
    status, headers, body = asked(server, plan(radius_mm=8.0))
    assert status == 200
    assert json.loads(body)["removed_ml"] == pytest.approx(2.145, rel=0.02)
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"


def test_the_policy_is_a_header_of_every_answer(server):
    for answer in (
        sent(server, head(server, "", "GET")),
        sent(server, head(server, "nothing", "GET")),
        asked(server, plan()),
        sent(server, b"nonsense\r\n\r\n"),
    ):
        words = answer[1]["content-security-policy"]
        assert {"default-src 'none'", "frame-ancestors 'none'", "base-uri 'none'", "form-action 'none'"} <= set(
            words.split("; ")
        )
        assert "file:" not in words


@pytest.mark.parametrize(
    ("body", "status", "says"),
    [
        (b'{"centre_mm": ' + b"[" * DEEP + b"]" * DEEP + b"}", 413, "shorter"),
        (b'{"centre_mm": ' + b"[" * 40_000 + b"]" * 40_000 + b"}", 400, "at most 100 lists"),
        (b'{"a":' * 16_000 + b"1" + b"}" * 16_000, 400, "at most 100 lists"),
        (b'{"centre_mm": [NaN, 0, 0]}', 400, "all numbers are finite"),
        (b'{"centre_mm": [Infinity, 0, 0]}', 400, "all numbers are finite"),
        (b'{"centre_mm": [20, 22, 24], "centre_mm": [0, 0, 0]}', 400, "no name stands twice"),
        (b'{"centre_mm": [1e999, 0, 0]}', 422, "finite number"),
        (b'{"centre_mm": [1e308, 0, 0]}', 422, "at most 10000 mm"),
        (plan(radius_mm=1e308), 422, "radius_mm must be at most 1000"),
        (plan(margin_mm=1e308), 422, "margin_mm must be at most 1000"),
        (b'{"centre_mm": [' + b"9" * 400 + b", 0, 0]}", 422, "centre_mm"),
        (b'{"centre_mm": [' + b"9" * 5000 + b", 0, 0]}", 400, "must be JSON"),
        (plan(dimension=4), 422, "dimension must be 2 or 3"),
        (plan(model="\0"), 422, "model must be"),
        (b'{"centre_mm": "\\ud800"}', 422, "centre_mm must be a list"),
        (b"\xff\xfe\x00", 400, "must be JSON"),
        (b"", 422, "centre_mm is missing"),
        (b"null", 422, "must be a table"),
        (b'"text"', 422, "must be a table"),
    ],
    ids=range(19),
)
def test_a_body_that_is_no_plan_is_refused_in_a_sentence(server, body, status, says):
    found, headers, words = asked(server, body)
    assert (found, headers["content-type"]) == (status, "application/json")
    assert says in json.loads(words)["error"]


@pytest.mark.parametrize(
    ("headers", "status", "says"),
    [
        ({"Content_Length": "9" * 30}, 413, "shorter"),
        ({"Content_Length": "9" * 6000}, 413, "shorter"),
        ({"Content_Length": MAX_BYTES + 1}, 413, "shorter"),
        ({"Content_Length": "-1"}, 400, "whole number"),
        ({"Content_Length": "1e3"}, 400, "whole number"),
        ({"Content_Length": "\xb2"}, 400, "whole number"),
        ({}, 411, "Content-Length"),
        ({"Transfer_Encoding": "chunked"}, 411, "in one piece"),
        ({"Transfer_Encoding": "chunked", "Content_Length": "5"}, 411, "in one piece"),
        ({"Content_Length": "5\r\nContent-Length: 6"}, 411, "once"),
        ({"Content_Length": "5", "Content_Type": "text/html"}, 415, "must be JSON"),
        ({"Content_Length": "5", "Host": "evil.example"}, 403, "only the browser tab"),
        ({"Content_Length": "5\r\nHost: evil.example"}, 403, "only the browser tab"),
        ({"Content_Length": "5", "X": "y" * 70_000}, 431, "cannot be read"),
    ],
    ids=range(14),
)
def test_a_head_that_is_none_is_refused_in_a_sentence(server, headers, status, says):
    found, _, words = sent(server, head(server, **headers), b"5\r\n{}\r\n")
    assert found == status
    assert says in json.loads(words)["error"]


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("%00", 404),
        ("assets/%00", 404),
        ("a" * 5000, 404),
        ("a/" * 2500, 404),
        ("report/plan-1/%00", 404),
        ("report/plan-" + "1" * 300 + "/x", 404),
        ("%ff%fe", 404),
        ("%e4" * 100, 404),
        ("a" * 70_000, 414),
    ],
    ids=range(9),
)
def test_a_strange_path_is_not_found(server, path, status):
    found, _, words = sent(server, head(server, path, "GET"))
    assert found == status
    assert "error" in json.loads(words)
    assert sent(server, head(server, path, "POST", Content_Length=0))[0] == status


@pytest.mark.parametrize(
    ("line", "status"),
    [
        (b"GET http://[ HTTP/1.1", 400),
        (b"GET //[ HTTP/1.1", 403),
        (b"GET / HTTP/9.9", 505),
        (b"GET / SPDY", 400),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc", 400),
        (b"TRACE / HTTP/1.1", 405),
    ],
)
def test_what_is_no_request_is_refused(server, line, status):
    whole = sent(server, line + b"\r\n\r\n")
    assert whole[0] == status
    assert "error" in json.loads(whole[2])


def _trickle(connection):
    for _ in range(50):
        connection.sendall(b" ")
        time.sleep(0.1)


def test_a_client_that_stops_or_trickles_is_let_go(server, monkeypatch):
    monkeypatch.setattr(server_module, "SECONDS", 0.6)
    assert sent(server, head(server, Content_Length=50) + b"{")[0] == 408
    began = time.monotonic()
    with closing(socket.create_connection(("127.0.0.1", server.server_port), 30)) as connection:
        connection.sendall(head(server, Content_Length=50))
        with pytest.raises(OSError):
            _trickle(connection)
    assert time.monotonic() - began < 4.0


def test_a_body_that_ends_early_is_refused(server):
    with closing(socket.create_connection(("127.0.0.1", server.server_port), 30)) as connection:
        connection.sendall(head(server, Content_Length=50) + b'{"a": 1}')
        connection.shutdown(socket.SHUT_WR)
        status, _, words = received(connection)
    assert status == 400
    assert "ended after 8 of 50 bytes" in json.loads(words)["error"]


def test_a_client_that_hangs_up_is_no_fault(server):
    for part in (b"GET", head(server, Content_Length=50), head(server, "", "GET")):
        with closing(socket.create_connection(("127.0.0.1", server.server_port), 30)) as connection:
            connection.sendall(part)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # reset on closing
    assert asked(server, plan())[0] == 200


def test_two_are_measured_at_once_and_a_third_is_told_to_come_back(server, monkeypatch):
    monkeypatch.setattr(planner_module, "PATIENCE_S", 0.3)
    goes_on, inside, most, lock = threading.Event(), [], [], threading.Lock()

    def slow(self, plan):
        with lock:
            inside.append(1)
            most.append(len(inside))
        goes_on.wait(20)
        with lock:
            inside.pop()
        return {}

    monkeypatch.setattr(PlanningTable, "measured", slow)
    answers = []
    threads = [Thread(target=lambda: answers.append(asked(server, plan()))) for _ in range(6)]
    for thread in threads:
        thread.start()
    end = time.monotonic() + 20
    while len(answers) < 4 and time.monotonic() < end:
        time.sleep(0.02)
    goes_on.set()
    for thread in threads:
        thread.join(20)
    assert sorted(status for status, *_ in answers) == [200, 200, 503, 503, 503, 503]
    assert max(most) == 2
    assert all(headers["retry-after"] == "1" for status, headers, _ in answers if status == 503)


def test_more_connections_than_places_are_turned_away(server):
    held = [socket.create_connection(("127.0.0.1", server.server_port), 30) for _ in range(CONNECTIONS)]
    try:
        time.sleep(0.2)
        status, headers, words = sent(server, b"")
        assert (status, headers["retry-after"]) == (503, "1")
        assert "too many" in json.loads(words)["error"]
    finally:
        for connection in held:
            connection.close()
    end = time.monotonic() + 10
    while time.monotonic() < end and asked(server, plan())[0] != 200:
        time.sleep(0.05)
    assert asked(server, plan())[0] == 200


def test_a_fault_of_the_program_is_a_line_and_no_traceback(server, monkeypatch, capfd):
    monkeypatch.setattr(PlanningTable, "measured", lambda self, plan: 1 / 0)
    status, _, words = asked(server, plan())
    assert (status, json.loads(words)) == (500, {"error": "internal error (ZeroDivisionError)"})
    (line,) = capfd.readouterr().err.splitlines()
    assert "ZeroDivisionError" in line

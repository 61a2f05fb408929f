"""Measures of a resection in closed form, its case file, and which requests the planning server answers."""

import json
import os
import signal
import subprocess
import sys
from contextlib import closing
from http.client import HTTPConnection
from threading import Thread
from typing import get_args

import numpy as np
import pytest

from cicatrix.cli.main import main
from cicatrix.cli.plan import build_table
from cicatrix.core.errors import InputError
from cicatrix.files.images import read_thinned, write_volume
from cicatrix.files.pictures import picture
from cicatrix.geometry.labels import Label
from cicatrix.geometry.volume import Volume
from cicatrix.kinds.lumpectomy.build import MODELS
from cicatrix.kinds.lumpectomy.case import MODEL_WORDS
from cicatrix.kinds.registry import load_case
from cicatrix.pages.planner import Planner
from cicatrix.pages.planning import PlanningTable, ResectionPlan, save_case
from cicatrix.pages.server import MAX_BYTES, PlanServer

from .conftest import CENTRE, grid

BALL = 4.0 / 3.0 * np.pi


@pytest.fixture(scope="module")
def table():
    return PlanningTable(grid(), grid(), {"phantom": "half-ellipsoid", "side": "left"}, ())


@pytest.mark.parametrize("radius", [4.0, 8.0, 13.3])
def test_a_ball_has_its_volume(table, radius):
    found = table.measured(ResectionPlan(centre_mm=CENTRE, radius_mm=radius))
    assert found["removed_ml"] == pytest.approx(BALL * radius**3 / 1000.0, rel=0.02)
    assert found["breast_ml"] == pytest.approx(41.0**3 / 1000.0)  # voxels of 1 mm from 0 to 40
    assert found["percent"] == pytest.approx(100.0 * BALL * radius**3 / 41.0**3, rel=0.02)


def test_what_lies_under_the_skin_stays(table):
    """A ball centred 5.5 mm below the surface at -0.5 mm loses the cap that is less than 3 mm deep, x < 2.5 mm."""
    found = table.measured(ResectionPlan(centre_mm=(5.0, 20.0, 20.0), radius_mm=8.0))
    cap = np.pi * 5.5**2 * (3 * 8.0 - 5.5) / 3.0
    assert found["removed_ml"] == pytest.approx((BALL * 512.0 - cap) / 1000.0, rel=0.03)
    assert found["depth_mm"] == pytest.approx(5.5, abs=0.51)


def test_a_point_beyond_the_breast_is_not_inside_it(table):
    """The surface of the cube lies at -0.5 mm and at 40.5 mm; the image ends at 45.5 mm."""
    for point, away in (((-3.5, 20.0, 20.0), 3.0), ((20.0, 20.0, 90.0), 49.5), ((-78.0, 20.0, 20.0), 77.5)):
        found = table.measured(ResectionPlan(centre_mm=point))
        assert found["depth_mm"] == pytest.approx(-away)
        assert any(f"{away:.1f} mm from it" in words for words in found["warnings"])
    assert table.measured(ResectionPlan(centre_mm=(20.0, 20.0, 900.0), radius_mm=2.0))["removed_ml"] == 0.0


def test_the_models_of_a_plan_are_those_of_a_case():
    named = get_args(ResectionPlan.model_fields["model"].annotation)
    assert set(named) == set(MODELS) == set(MODEL_WORDS)


def test_the_margin_is_that_around_the_tumour(table):
    found = table.measured(ResectionPlan(centre_mm=(22.0, 20.0, 20.0), radius_mm=9.0, margin_mm=3.0))
    assert found["margin_mm"] == pytest.approx(9.0 - 2.0 - 5.0, abs=1.0)  # 2 mm off a tumour of 5 mm, in voxels of 1
    assert any("3 mm are wanted" in words for words in found["warnings"])


@pytest.mark.parametrize(
    ("plan", "says"),
    [
        ({"centre_mm": (1.0, 20.0, 20.0)}, "at least 3 mm inside"),
        ({"centre_mm": (-30.0, 20.0, 20.0)}, "outside the breast that is labelled, 29.5 mm from it"),
        ({"centre_mm": CENTRE, "radius_mm": 25.0}, "largest ball"),
    ],
)
def test_what_cannot_be_run_is_said(table, plan, says):
    assert any(says in words for words in table.measured(ResectionPlan(**plan))["warnings"])


def test_it_starts_at_the_tumour_or_deepest_inside(table):
    assert table.first_centre() == pytest.approx(CENTRE)
    bare = Volume(np.where(grid().values > 0, Label.FAT, Label.AIR), grid().spacing_mm, grid().origin_mm)
    assert PlanningTable(bare, bare, {}, ()).first_centre() == pytest.approx(CENTRE)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_case_says_what_was_wished(table, tmp_path, dimension):
    plan = ResectionPlan(
        centre_mm=(42.004, -80.0, 12.0), radius_mm=9.5, dimension=dimension, model="fields", mode="one-way"
    )
    case = load_case(save_case(table, plan, tmp_path))
    assert (case.dimension, case.healing.model, case.coupling.mode) == (dimension, "fields", "one-way")
    assert (case.resection.centre_mm, case.resection.radius_mm) == ((42.0, -80.0, 12.0), 9.5)


def test_the_image_is_found_from_where_the_case_lies(tmp_path):
    (tmp_path / "images").mkdir()
    write_volume(tmp_path / "images" / "labels.nii.gz", grid())
    write_volume(tmp_path / "images" / "breast.nii.gz", grid())
    made = build_table(tmp_path / "images" / "breast.nii.gz", tmp_path / "images" / "labels.nii.gz")
    path = save_case(made, ResectionPlan(centre_mm=CENTRE), tmp_path / "out")
    assert load_case(path).image.path == (tmp_path / "images" / "breast.nii.gz").resolve()
    assert str(tmp_path) not in path.read_text()


def test_tissues_that_the_user_names_are_in_the_case(tmp_path):
    write_volume(tmp_path / "labels.nii.gz", grid())
    names = {"2": "fat", "4": "tumour"}
    path = save_case(
        build_table(tmp_path / "labels.nii.gz", tmp_path / "labels.nii.gz", names),
        ResectionPlan(centre_mm=CENTRE),
        tmp_path,
    )
    assert load_case(path).image.label_names == names


def test_another_wish_gets_another_file_and_the_same_keeps_its_own(table, tmp_path):
    first, second = ResectionPlan(centre_mm=CENTRE), ResectionPlan(centre_mm=CENTRE, radius_mm=9.0)
    names = [save_case(table, plan, tmp_path).name for plan in (first, second, first)]
    assert names == ["plan-1.toml", "plan-2.toml", "plan-1.toml"]


def test_a_wish_that_makes_no_case_writes_nothing(tmp_path):
    table = PlanningTable(grid(), grid(), {"phantom": "half-ellipsoid", "side": "middle"}, ())
    with pytest.raises(InputError, match=r"^image\.side"):
        save_case(table, ResectionPlan(centre_mm=CENTRE), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "content",
    [
        *({}, [], {"centre_mm": [1, 2]}, {"centre_mm": CENTRE, "more": 1}, {"centre_mm": [0.0, 0.0, 1e308]}),
        *(
            {"centre_mm": CENTRE, "radius_mm": value}
            for value in (-1.0, 0.0, 1e308, float("nan"), float("inf"), 10**400)
        ),
        *({"centre_mm": CENTRE, "model": value} for value in ("automata", None, ["fields"])),
    ],
)
def test_what_is_no_wish_is_refused(content):
    with pytest.raises(InputError):
        ResectionPlan.of(content)


def test_a_series_of_four_gigabytes_is_thinned_and_says_so():
    """The voxels take no memory, because all rows are the same array."""
    huge = Volume(
        np.broadcast_to(np.arange(1400, dtype=np.int16), (1100, 1400, 1400)), (0.3, 0.3, 0.9), (0.0, 0.0, 0.0)
    )
    assert huge.values.size * 2 > 4e9
    thin, words = picture(huge)
    assert thin.values.size <= 6e6
    assert "from 1400x1400x1100 to" in words
    assert thin.position(np.array(thin.shape) - 1) == pytest.approx(huge.position(np.array(huge.shape) - 1), abs=4.0)


def test_a_large_image_is_thinned_while_it_is_read(tmp_path):
    write_volume(tmp_path / "image.nii.gz", grid())
    notes = []
    thin = read_thinned(tmp_path / "image.nii.gz", 51**3 // 8, note=notes.append)
    assert notes == ["The image has 51x51x51 voxels; 26x26x17 of them are used."]
    assert np.array_equal(thin.values, grid().values[::3, ::2, ::2])
    assert (thin.spacing_mm, thin.origin_mm) == ((2.0, 2.0, 3.0), (-5.0, -5.0, -5.0))
    read_thinned(tmp_path / "image.nii.gz", 51**3, note=notes.append)
    assert len(notes) == 1


@pytest.fixture(scope="module")
def server(table, tmp_path_factory):
    folder = tmp_path_factory.mktemp("planning")
    running = PlanServer(Planner(table, folder / "out", folder / "site"))
    Thread(target=running.serve_forever, daemon=True).start()
    yield running
    running.shutdown()
    running.server_close()


def answer(server, path, content=None, *, method=None, host=None, kind="application/json", **headers):
    """Return status, body and headers of an answer; ``path`` is below the secret unless it begins with a slash."""
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    path = path if path.startswith("/") else f"/{server.token}/{path}"
    connection.putrequest(method or ("GET" if content is None else "POST"), path, skip_host=True)
    body = b"" if content is None else content if isinstance(content, bytes) else json.dumps(content).encode()
    named = {"Host": host or f"127.0.0.1:{server.server_port}", "Content-Length": str(len(body)), "Content-Type": kind}
    for name, value in {**named, **{key.replace("_", "-"): value for key, value in headers.items()}}.items():
        connection.putheader(name, value)
    connection.endheaders(body)
    with closing(connection), connection.getresponse() as found:
        return found.status, found.read(), found.headers


def test_its_own_page_is_answered(server):
    status, body, headers = answer(server, "")
    assert status == 200
    assert b"Plan a resection" in body
    assert (headers["X-Frame-Options"], headers["Cache-Control"]) == ("DENY", "no-store")
    own = f"http://127.0.0.1:{server.server_port}"
    assert answer(server, "measure", {"centre_mm": CENTRE}, Origin=own, Sec_Fetch_Site="same-origin")[0] == 200


@pytest.mark.parametrize(
    "strange",
    [
        {"path": "/"},
        {"path": "/index.html"},
        {"path": "/wrong-token/"},
        {"path": "/wrong-token/measure", "content": {"centre_mm": CENTRE}},
        {"path": "measure", "content": {"centre_mm": CENTRE}, "Origin": "http://evil.example"},
        {"path": "measure", "content": {"centre_mm": CENTRE}, "Origin": "null"},
        {"path": "stop", "content": {}, "Origin": "http://127.0.0.1:1"},
        {"path": "", "Sec_Fetch_Site": "cross-site"},
        {"path": "", "host": "evil.example"},
    ],
)
def test_a_wrong_token_or_a_second_origin_is_refused(server, strange):
    status, body, _ = answer(server, **strange)
    assert status == 403
    assert b"only the browser tab" in body


def test_a_form_of_another_site_cannot_speak_to_it(server):
    """Another site may send plain text without permission, but not JSON."""
    status, body, _ = answer(server, "start", b'{"centre_mm": [1, 2, 3]}', kind="text/plain")
    assert status == 415
    assert "must be JSON" in json.loads(body)["error"]


@pytest.mark.parametrize(
    "path",
    [
        "../out/x",
        "assets/../../secret",
        "report/../out",
        "report/plan-1/../../x",
        "report/etc/passwd",
        "%2e%2e/secret",
        "nothing",
    ],
)
def test_no_file_outside_is_served(server, path):
    (server.planner.site.parent / "secret").write_text("secret")
    assert answer(server, path)[0] == 404


@pytest.mark.parametrize(
    ("path", "content", "status", "says"),
    [
        ("measure", b"{", 400, "must be JSON"),
        ("measure", {"centre_mm": "here"}, 422, "centre_mm"),
        ("measure", b" " * (MAX_BYTES + 1), 413, "shorter"),
        ("report", {}, 422, "no run to report on"),
        ("nothing", {}, 404, "no action of this name"),
    ],
    ids=["not JSON", "no number", "too long", "no run", "no action"],
)
def test_faults_are_told_in_a_sentence(server, path, content, status, says):
    found, body, _ = answer(server, path, content)
    assert found == status
    assert says in json.loads(body)["error"]


@pytest.mark.parametrize("method", ["PUT", "HEAD", "OPTIONS", "DELETE", "BREW"])
def test_other_methods_are_not_answered(server, method):
    status, _, headers = answer(server, "", method=method)
    assert (status, headers["Allow"]) == (405, "GET, POST")


def test_progress_before_any_run(server):
    assert json.loads(answer(server, "progress", {})[1])["state"] == "idle"


def test_a_run_that_is_refused_says_why(server):
    """The centre lies outside the breast: the case is valid, and the run reports the fault."""
    plan = {"centre_mm": [-300.0, 0.0, 0.0]}
    assert answer(server, "start", plan)[0] == 200
    server.planner.job._process.wait(120)
    found = json.loads(answer(server, "progress", {})[1])
    assert found["state"] == "failed"
    assert "must lie inside the breast" in found["sentence"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["missing.nii.gz"], "there is no such image"),
        (["--labels", "labels.nii.gz"], "needs an IMAGE"),
        (["--label-name", "FGT=gland"], "needs --labels"),
        (["--label-name", "FGT=bone"], 'must be NAME=TISSUE, each name once, with "air", "fat"'),
        (["--port", "99999", "--no-browser"], "--port"),
    ],
)
def test_bad_arguments_are_refused_in_one_sentence(tmp_path, monkeypatch, capsys, arguments, says):
    monkeypatch.chdir(tmp_path)
    assert main(["plan", *arguments]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert says in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_the_verb_serves_until_it_is_interrupted(tmp_path):
    command = [sys.executable, "-m", "cicatrix", "plan", "--no-browser", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ))
    assert process.stdout is not None
    assert process.stdout.readline().startswith("planning page: http://127.0.0.1:")
    process.send_signal(signal.SIGTERM)  # main treats it like Ctrl-C; a background job of a shell would ignore SIGINT
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "the planning page is closed" in said

"""The command line from the outside: exit codes, one-sentence errors, never a traceback."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cicatrix.cli.main import main

STAND_IN = Path(__file__).parent / "stand_in.py"
PHANTOM = 'kind = "lumpectomy"\n[image]\nphantom = "half-ellipsoid"\n'
INTERRUPTED = "cicatrix: interrupted; to continue from the last checkpoint, run the same command with --resume"


@pytest.fixture
def case(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(PHANTOM, encoding="utf-8")
    return path


def cicatrix(*arguments, cwd, program=("-m", "cicatrix.cli.main"), **environment):
    command = [sys.executable, *map(str, program), *map(str, arguments)]
    env = os.environ | environment | {"TMPDIR": str(cwd)}
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=env, check=False, timeout=120)
    assert "Traceback" not in done.stdout + done.stderr
    return done


def stand_in(*arguments, cwd, **environment):
    return cicatrix(*arguments, cwd=cwd, program=(STAND_IN,), **environment)


def status(folder):
    return json.loads((folder / "manifest.json").read_text())["status"]


def test_help_shows_the_verbs_in_order(tmp_path):
    done = cicatrix("--help", cwd=tmp_path)
    assert done.returncode == 0
    verbs = re.findall(r"^    (\w+)  ", done.stdout, re.MULTILINE)
    road = ["demo", "run", "check", "segment", "mesh", "fit", "report", "plan", "bench"]
    assert verbs == [verb for verb in road if verb in verbs]
    assert {"demo", "run", "check", "bench"} <= set(verbs)


@pytest.mark.parametrize("arguments", [(), ("frob",), ("run",), ("check", "a.toml", "--sett", "x"), ("bench", "none")])
def test_wrong_command_is_one_sentence(arguments, tmp_path):
    done = cicatrix(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert re.fullmatch(r"cicatrix: [^\n]+\n", done.stderr)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("check", "a" * 5000), "a path has at most 4096 bytes, and each name in it 255; got 5000 characters"),
        (("run", "case.toml", "--out", "a" * 300), "argument --out: a path has at most 4096 bytes"),
        (("run", "case.toml", "--out", ""), "argument --out: must name a file or folder"),
        (
            ("check", "a\x1b[31m.toml"),
            r"argument CASE.toml: must name a file or folder, without control characters; got 'a\x1b",
        ),
        (("check", "a\udce9\u202e.toml"), r"a\udce9\u202e.toml: there is no such file"),
        (("check", "case.toml", "--set", "run.a\x07\u202e=1"), r"run.a\x07\u202e is not a known key"),
        (
            ("check", "case.toml", "--set", 'image.path="data\\breast"'),
            r"'data\x08reast', with the control character U+0008",
        ),
        (("mesh", "a.nii", "--out", "b.vtu", "--edge-mm", "1_0"), "argument --edge-mm: '1_0' is not a number"),
        (("mesh", "a.nii", "--out", "b.vtu", "--edge-mm", "nan"), "argument --edge-mm: 'nan' is not a number"),
        (("plan", "--port", "99999"), "argument --port: must be 0 to 65535; got '99999'"),
        (("frob\x1b[31m",), r"invalid choice: 'frob\x1b[31m'"),
    ],
)
def test_strange_arguments_are_escaped_sentences(arguments, words, case, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(list(arguments)) == 2
    said = capsys.readouterr().err
    assert words in said
    assert all(line.isprintable() and len(line) < 600 for line in said.splitlines())


def test_check_sound_case(case, tmp_path):
    done = cicatrix("check", case, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "no fault found" in done.stdout


def test_check_tells_every_fault_on_a_line(case, tmp_path):
    case.write_text(PHANTOM + "[tissue.fat]\nnu = 0.5\nE_kPa = -1.0\n[run]\nsed = 1\n", encoding="utf-8")
    done = cicatrix("check", case, "--set", "healing.p_edge=2", cwd=tmp_path)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 4
    assert all(line.startswith(f"{case}: ") for line in done.stderr.splitlines())


def test_run_with_bad_case_leaves_nothing(case, tmp_path):
    case.write_text(PHANTOM + "[tissue.fat]\nnu = 0.5\n", encoding="utf-8")
    done = cicatrix("run", case, "--out", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == f"cicatrix: {case}: tissue.fat.nu must be at least 0 and below 0.5; got 0.5\n"
    assert not (tmp_path / "out").exists()


def test_run_tells_the_headline(case, tmp_path):
    done = stand_in("run", case, cwd=tmp_path)
    assert done.returncode == 0
    first, second, third = done.stdout.splitlines()[:3]
    assert first == "The cavity closed on day 14."
    assert "keeps the volume of the hole by assumption" in second
    assert "not a prediction of the cosmetic result" in second
    assert third.startswith("  time_to_closure_days")
    assert "by_visit" not in done.stdout
    assert "cycles: 33% cycle 0" in done.stderr  # plain lines: the stream is no terminal
    assert "\x1b" not in done.stderr
    assert status(tmp_path / "runs" / "case")["state"] == "finished"


def test_the_headline_of_loaded_deposition_has_no_assumption(case, tmp_path):
    done = stand_in("run", case, "--set", 'healing.deposition="loaded"', cwd=tmp_path)
    assert done.returncode == 0
    assert "by assumption" not in done.stdout


def test_finished_run_is_kept(case, tmp_path):
    stand_in("run", case, "--out", "out", cwd=tmp_path)
    again = stand_in("run", case, "--out", "out", cwd=tmp_path)
    assert again.returncode == 2
    assert "finished run" in again.stderr
    assert stand_in("run", case, "--out", "out", "--resume", cwd=tmp_path).returncode == 0
    other = stand_in("run", case, "--out", "out", "--resume", "--set", "run.seed=2", cwd=tmp_path)
    assert (other.returncode, "run.seed differ" in other.stderr) == (2, True)


@pytest.mark.parametrize(
    ("end", "code", "last", "state"),
    [
        ("input", 2, "cicatrix: the image holds no breast", "failed"),
        ("convergence", 3, "cicatrix: Newton stopped at load 0.4; try smaller steps.", "failed"),
        ("interrupt", 130, INTERRUPTED, None),
        ("terminate", 130, INTERRUPTED, None),
    ],
)
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_every_bad_end(end, code, last, state, case, tmp_path):
    done = stand_in("run", case, "--out", "out", cwd=tmp_path, END=end)
    assert done.returncode == code
    assert done.stderr.splitlines()[-1] == last
    assert status(tmp_path / "out")["state"] == (state or "interrupted")
    if end == "convergence":
        assert "  load 0.5: residual 1e-2" in done.stderr.splitlines()
    again = stand_in("run", case, "--out", "out", "--resume", cwd=tmp_path)
    assert again.returncode == 0
    assert (tmp_path / "out" / "history.csv").read_text() == "cycle,time_days\n0,0.0\n1,7.0\n2,14.0\n"


def test_fault_inside_points_to_its_traceback(case, tmp_path):
    done = stand_in("run", case, "--out", "out", cwd=tmp_path, END="bug")
    assert done.returncode == 3
    match = re.search(r"cicatrix: internal error \(ZeroDivisionError\).* (\S+)\n$", done.stderr)
    assert match
    assert "ZeroDivisionError: division by zero" in Path(match[1]).read_text()
    assert status(tmp_path / "out")["state"] == "failed"


def test_demo_is_shown_again(tmp_path):
    first, second = (stand_in("demo", cwd=tmp_path) for _ in range(2))
    assert (first.returncode, second.returncode) == (0, 0)
    assert first.stdout == second.stdout
    assert "folder:  demo" in first.stdout


def test_bench_writes_json(tmp_path):
    done = cicatrix("bench", "checkpoint", "--json", "b.json", cwd=tmp_path)
    assert done.returncode == 0
    rows = json.loads((tmp_path / "b.json").read_text())["checkpoint"]
    assert {"what", "value", "unit", "note"} == set(rows[0])
    assert any(row["note"] == "ceiling" for row in rows)

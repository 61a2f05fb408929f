"""``cicatrix fit``: a folder that can be read back, and one-sentence errors for wrong input."""

import json

import numpy as np
import pytest

import cicatrix
from cicatrix.cli.main import main
from cicatrix.files.toml import toml_text

CASE = """kind = "material-point"
[[law]]
type = "neo-hookean"
mu_kPa = 1.0
[loading]
time_h = [0.0, 1.0]
x = [1.0, 1.2]
"""
FREE = ("--free", "law.0.mu_kPa=0.1..20")


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(CASE)
    stretch = np.linspace(1.0, 1.5, 8)
    stress = 5.0 * (stretch**2 - 1 / stretch)  # by hand: uniaxial, incompressible, mu = 5 kPa
    rows = [f"{0.1 * row},{x!r},{s!r}" for row, (x, s) in enumerate(zip(stretch.tolist(), stress.tolist()))]
    (tmp_path / "data.csv").write_text("\n".join(["time_h,lambda_x,sigma_x_kPa", *rows]) + "\n")
    return tmp_path


def test_folder_of_a_fit(files, capsys):
    assert main(["fit", "case.toml", "data.csv", *FREE, "--out", "found"]) == 0
    told = json.loads((files / "found" / "fit.json").read_text())
    assert told["parameters"]["law.0.mu_kPa"]["estimate"] == pytest.approx(5.0, rel=1e-9)
    assert told["n_data"] == 8
    assert cicatrix.load_case(files / "found" / "fitted.toml").law[0].mu_kPa == pytest.approx(5.0)
    residuals = np.genfromtxt(files / "found" / "residuals.csv", delimiter=",", names=True)
    assert np.abs(residuals["residual_sigma_x_kPa"]).max() < 1e-8
    assert (files / "found" / "figures" / "fit.png").stat().st_size > 10_000
    assert "law.0.mu_kPa" in capsys.readouterr().out
    assert main(["fit", "case.toml", "data.csv", *FREE, "--out", "found"]) == 2
    assert "found exists" in capsys.readouterr().err


def test_only_a_material_point_is_fitted(files, capsys):
    (files / "case.toml").write_text('kind = "lumpectomy"\n[image]\nphantom = "half-ellipsoid"\n')
    assert main(["fit", "case.toml", "data.csv", *FREE]) == 2
    assert 'kind must be "material-point" for a fit; got "lumpectomy"' in capsys.readouterr().err


def test_one_key_twice_is_refused(files, capsys):
    assert main(["fit", "case.toml", "data.csv", *FREE, "--free", "law[0].mu_kPa=1..2"]) == 2
    assert "--free law.0.mu_kPa is given twice" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("free", "words"),
    [
        ("law.0.mu=1..2", "law.0.mu is not a parameter of a law that can be fitted; did you mean law.0.mu_kPa?"),
        ("law.0.mu_kPa", "must read KEY=LOW..HIGH"),
        ("law.0.mu_kPa=a..b", "must read KEY=LOW..HIGH"),
        ("law.0.mu_kPa=2..1", "the bounds must ascend"),
        ("law.0.mu_kPa=0..nan", "must read KEY=LOW..HIGH"),
        ("law.0.mu_kPa=1_0..20", "must read KEY=LOW..HIGH"),
        ("law.0.mu_kPa=1..1e999", "must read KEY=LOW..HIGH"),
    ],
)
def test_wrong_wish_is_one_sentence(files, capsys, free, words):
    assert main(["fit", "case.toml", "data.csv", "--free", free]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_h,lambda_x\n0,1\n", "data.csv: column sigma_x_kPa is missing; there are time_h, lambda_x"),
        ("time_h,lambda_x,sigma_x_kPa\n0,1,\n", "no row has a value for each of time_h, lambda_x, sigma_x_kPa"),
        ("time_h,lambda_x,sigma_x_kPa\n0,1\n", "row 2 must have 3 columns"),
        ("time_h,lambda_x,sigma_x_kPa\n0,1,0\n1,1.2,4e12\n", "sigma_x_kPa must be a stress in kPa; got 4e+12 in row 3"),
        ("", "data.csv is empty: it must start with a row of column names, time_h, lambda_x"),
    ],
)
def test_wrong_data_are_one_sentence(files, capsys, text, words):
    (files / "data.csv").write_text(text)
    assert main(["fit", "case.toml", "data.csv", *FREE]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_a_fit_needs_no_loading_but_the_data_s(files, capsys):
    (files / "case.toml").write_text(CASE.partition("[loading]")[0])
    assert main(["fit", "case.toml", "data.csv", *FREE, "--out", "found"]) == 0
    loading = cicatrix.load_case(files / "found" / "fitted.toml").loading
    assert loading.time_h == pytest.approx([0.1 * row for row in range(8)])
    assert loading.x == pytest.approx(np.linspace(1.0, 1.5, 8))
    for text, words in (
        ("time_s,lambda_x,sigma_x_kPa\n0,1,0\n", 'data.csv: column time_h is missing: divide "time_s" by 3600'),
        ("time_h,strain,sigma_x_kPa\n0,1,0\n", 'data.csv: column lambda_x is missing: take 1 + "strain"'),
        ("time_h,lambda_x,sigma_x_kPa\n0,1.1,\n", "data.csv: no row has a value for each of"),
    ):
        (files / "other").mkdir(exist_ok=True)
        (files / "other" / "data.csv").write_text(text)
        assert main(["fit", "case.toml", "other/data.csv", *FREE]) == 2
        assert words in capsys.readouterr().err
    (files / "case.toml").write_text(CASE.partition("time_h")[0] + "x = [1.0, 1.2]\n")
    assert main(["fit", "case.toml", "data.csv", *FREE]) == 2  # x without its times is a fault


def test_a_wrong_unit_fits_nothing(files, capsys):
    rows = [line.split(",") for line in (files / "data.csv").read_text().splitlines()]
    text = "\n".join([",".join(rows[0]), *(f"{t},{x},{float(s) / 1000}" for t, x, s in rows[1:]), ""])
    (files / "data.csv").write_text(text)
    assert main(["fit", "case.toml", "data.csv", *FREE, "--out", "found"]) == 2
    said = capsys.readouterr().err
    assert "nothing was fitted" in said
    assert "check the units" in said
    assert "law.0.mu_kPa is at its lower bound, 0.1" in said
    assert not (files / "found").exists()


def test_no_error_is_printed_where_there_is_none(files, capsys):
    (files / "data.csv").write_text("time_h,lambda_x,sigma_x_kPa\n0,1,0\n1,1.2,3\n")
    assert main(["fit", "case.toml", "data.csv", *FREE]) == 0
    said = capsys.readouterr().out
    assert "(no standard error)" in said
    assert "nan" not in said


def test_toml_reads_back():
    import tomllib

    tables = {
        "kind": "a",
        "law": [{"type": "b", "part": {"x": 1.5, "y": [1, 2]}, "none": None}],
        "run": {"is_on": True},
    }
    again = tomllib.loads(toml_text(tables))
    assert again == {"kind": "a", "law": [{"type": "b", "part": {"x": 1.5, "y": [1, 2]}}], "run": {"is_on": True}}

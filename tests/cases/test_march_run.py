"""Cases of kind "equilibrium" with history-dependent laws: integrated in time, resumed to the same bytes, and what is refused."""

import numpy as np
import pytest
import skfem

import cicatrix
from cicatrix.cli.main import main
from cicatrix.core.errors import InputError
from cicatrix.files.vtu import write_vtu
from cicatrix.geometry.tetrahedra import oriented
from cicatrix.kinds.registry import check_case, load_case

BODY = """
kind = "equilibrium"
[body]
mesh = "body.vtu"
"""
LAW = """
[[law]]
type = "neo-hookean"
mu_kPa = 1.0
kappa_kPa = 50.0
viscous = { beta = 1.0, relaxation_s = 60.0 }
"""
HISTORY = """
[history]
time_h = [0.0, 0.01, 0.5]
share = [0.0, 1.0, 1.0]
steps_per_segment = 2
[loads]
gravity_m_s2 = [0.0, 0.0, -9.81]
"""


@pytest.fixture
def case(tmp_path):
    """Return a case of a cube of 20 mm fixed at its top."""
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0, 20.0, 2)] * 3)
    points, cells = mesh.p.T.copy(), oriented(mesh.p.T, mesh.t.T)
    fixed = {"fixed": (points[:, 2] > 19.9).astype(float)}
    write_vtu(tmp_path / "body.vtu", points, cells, fixed, {"density_kg_m3": np.full(len(cells), 1e3)})

    def written(text):
        (tmp_path / "case.toml").write_text(text)
        return tmp_path / "case.toml"

    return written


@pytest.mark.slow  # compiled three times over
def test_viscous_tissue_creeps(case, tmp_path):
    """Viscous tissue sags at once, creeps under the same load and dissipates;"""
    path = case(BODY + LAW + HISTORY)
    whole = cicatrix.simulate(load_case(path), tmp_path / "whole")
    sag, heat = whole.history["max_displacement_mm"], whole.history["dissipation_uJ"]
    assert (np.diff(sag) > 0).all()
    assert (np.diff(heat) > 0).all()
    np.testing.assert_allclose(whole.history["time_h"], [0.0, 0.005, 0.01, 0.255, 0.5])
    assert len(list((tmp_path / "whole" / "fields").glob("*.vtu"))) == 5


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (BODY + LAW, "history is missing: the response of the law depends on time"),
        (BODY + LAW.replace("kappa_kPa = 50.0", "") + HISTORY, "law must have a bulk modulus in a body"),
        (BODY + '[growth]\ntype = "volume"\ntau_h = 1.0\n', r"growth needs a tissue: give \[\[law\]\]"),
        (
            BODY + LAW + HISTORY.replace("0.01, 0.5", "0.5, 0.5"),
            "history.time_h must be at least two times that ascend",
        ),
        (
            BODY + LAW + HISTORY.replace("[0.0, 1.0, 1.0]", "[0.0, 1.0]"),
            r"history.share must have as many values as time_h \(3\); got 2",
        ),
        (
            BODY + LAW + HISTORY + "[solver]\ninverse = true\n",
            "history is for the forward problem: leave solver.inverse out",
        ),
    ],
)
def test_what_is_refused(case, text, sentence, capsys):
    path = case(text)
    with pytest.raises(InputError, match=sentence):
        load_case(path)
    assert len(check_case(path)) == 1
    assert main(["check", str(path)]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_a_mesh_without_a_tissue_says_so(case, tmp_path):
    path = case(BODY)
    with pytest.raises(InputError, match="cell data `youngs_modulus_kPa` are missing"):
        cicatrix.simulate(load_case(path), tmp_path / "run")

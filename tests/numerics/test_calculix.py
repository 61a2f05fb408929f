"""Compare with CalculiX (Debian: calculix-ccx) on the same tetrahedra, law and gravity, to the digits that it prints."""

import shutil
import subprocess

import numpy as np
import pytest
import skfem

from cicatrix.files.calculix import calculix_deck, calculix_displacements
from cicatrix.geometry.tetrahedra import oriented, used_only
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.solids import solid_body

pytestmark = pytest.mark.skipif(
    shutil.which("ccx") is None, reason="CalculiX is not there: apt-get install calculix-ccx"
)

SEMI_AXES = np.array([65.0, 65.0, 50.0])  # mm
GRAVITY = np.array([0.0, -9810.0, 0.0])  # mm/s^2, sideways
DENSITY = 1e-6  # kg/mm^3


def half_ellipsoid():
    """Return a breast of 256 tetrahedra on its base: (points, tetrahedra, is_fixed)."""
    ball = skfem.MeshTet.init_ball(2)
    upper = ball.t.T[ball.p[2][ball.t].mean(axis=0) > 0]
    points, tetrahedra = used_only(ball.p.T * SEMI_AXES, upper)
    return points, oriented(points, tetrahedra), np.abs(points[:, 2]) < 1e-9


def by_calculix(folder, text, n_nodes):
    (folder / "body.inp").write_text(text)
    done = subprocess.run(["ccx", "body"], cwd=folder, capture_output=True, text=True, timeout=300)
    found = calculix_displacements((folder / "body.dat").read_text(), n_nodes)
    assert len(found) == n_nodes, done.stdout[-2000:]
    return found


@pytest.mark.parametrize("nu", [0.49, 0.499])
def test_displacements_are_those_of_calculix(nu, tmp_path):
    """Quadratic tetrahedra with four points, neo-Hookean (C10 = mu / 2, D1 = 2 / kappa), large displacements, two tissues."""
    points, tetrahedra, is_fixed = half_ellipsoid()
    E = np.where(points[tetrahedra].mean(axis=1)[:, 0] > 0, 3.0, 1.0)
    same = np.ones(len(E))
    body = solid_body(points, tetrahedra, is_fixed, E, nu * same, DENSITY * same)
    X = body.discretization.space.positions
    x, _ = Equilibrium(1e-9).loaded(body, X, GRAVITY)
    expected = by_calculix(tmp_path, calculix_deck(body, GRAVITY), len(X))
    assert np.abs(expected).max() > 10.0
    np.testing.assert_allclose(x - X, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_an_answer_under_part_of_the_load_is_none():
    """CalculiX prints the last increment that it reached, and its output file does not say that it stopped early."""
    part = " displacements (vx,vy,vz) for set ALL and time  0.2500000E+00\n\n 1 1.0 2.0 3.0\n 2 0.0 0.0 4.0\n"
    whole = part + part.replace("0.2500000E+00", "0.1000000E+01").replace("4.0", "5.0")
    assert calculix_displacements(part, 2).shape == calculix_displacements("", 2).shape == (0, 3)
    np.testing.assert_array_equal(calculix_displacements(whole, 2), [[1, 2, 3], [0, 0, 5]])

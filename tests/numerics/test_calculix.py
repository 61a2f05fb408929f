"""The same tetrahedra, law and gravity in CalculiX (Debian: calculix-ccx): displacements to the digits that it prints."""

import shutil
import subprocess

import numpy as np
import pytest
import skfem

from cicatrix.geometry.tetrahedra import oriented, used_only
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.study.equilibrium import solid_body

pytestmark = pytest.mark.skipif(
    shutil.which("ccx") is None, reason="CalculiX is not there: apt-get install calculix-ccx"
)

SEMI_AXES = np.array([65.0, 65.0, 50.0])  # mm
GRAVITY = 9810.0  # mm/s^2, sideways
DENSITY = 1e-6  # kg/mm^3


def half_ellipsoid():
    """A breast of 256 tetrahedra on its base: (points, tetrahedra, is_fixed)."""
    ball = skfem.MeshTet.init_ball(2)
    upper = ball.t.T[ball.p[2][ball.t].mean(axis=0) > 0]
    points, tetrahedra = used_only(ball.p.T * SEMI_AXES, upper)
    return points, oriented(points, tetrahedra), np.abs(points[:, 2]) < 1e-9


def deck(X, elements, fixed, E, nu):
    """Input of CalculiX; numbers have at most 20 characters there."""
    lines = ["*NODE, NSET=ALL", *(f"{i}, {x:.12e}, {y:.12e}, {z:.12e}" for i, (x, y, z) in enumerate(X, 1))]
    kinds = np.unique(E)
    for k, young in enumerate(kinds):
        mu, kappa = young / (2 * (1 + nu)), young / (3 * (1 - 2 * nu))
        lines += [f"*ELEMENT, TYPE=C3D10, ELSET=E{k}"]
        lines += [", ".join(map(str, (i + 1, *elements[i] + 1))) for i in np.flatnonzero(young == E)]
        lines += [f"*MATERIAL, NAME=M{k}", "*HYPERELASTIC, NEO HOOKE", f"{mu / 2:.12e}, {2 / kappa:.12e}"]
        lines += ["*DENSITY", f"{DENSITY:.6e}", f"*SOLID SECTION, ELSET=E{k}, MATERIAL=M{k}"]
    lines += ["*NSET, NSET=HELD", *(f"{i + 1}," for i in fixed), "*BOUNDARY", "HELD, 1, 3"]
    lines += ["*STEP, NLGEOM, INC=1000", "*STATIC", "1., 1.", "*CONTROLS, PARAMETERS=FIELD", "1.e-9, 1.e-9", "*DLOAD"]
    lines += [f"E{k}, GRAV, {GRAVITY}, 0., -1., 0." for k in range(len(kinds))]
    return "\n".join([*lines, "*NODE PRINT, NSET=ALL", "U", "*END STEP", ""])


def by_calculix(folder, text, n_nodes):
    (folder / "body.inp").write_text(text)
    done = subprocess.run(["ccx", "body"], cwd=folder, capture_output=True, text=True, timeout=300)
    rows = [line.split() for line in (folder / "body.dat").read_text().splitlines()]
    numbers = np.array([[float(value) for value in row[1:]] for row in rows if len(row) == 4 and row[0].isdecimal()])
    assert len(numbers) >= n_nodes, done.stdout[-2000:]
    return numbers[-n_nodes:]


@pytest.mark.parametrize("nu", [0.49, 0.499])
def test_displacements_are_those_of_calculix(nu, tmp_path):
    """Quadratic tetrahedra with four points, neo-Hookean (its C10 = mu / 2, D1 = 2 / kappa), large displacements, two tissues."""
    points, tetrahedra, is_fixed = half_ellipsoid()
    E = np.where(points[tetrahedra].mean(axis=1)[:, 0] > 0, 3.0, 1.0)
    same = np.ones(len(E))
    body = solid_body(points, tetrahedra, is_fixed, E, nu * same, DENSITY * same)
    X = body.frame.space.positions
    x, _ = Equilibrium(1e-9).loaded(body, X, np.array([0.0, -GRAVITY, 0.0]))
    expected = by_calculix(tmp_path, deck(X, body.frame.space.element_nodes, body.frame.fixed_nodes, E, nu), len(X))
    assert np.abs(expected).max() > 10.0
    np.testing.assert_allclose(x - X, expected, rtol=0, atol=1e-6 * np.abs(expected).max())

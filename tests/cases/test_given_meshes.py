"""Shapes of bodies on meshes that others wrote: groups in a case file, places far away, supports of quadratic meshes."""

import itertools

import meshio
import numpy as np
import pytest
import skfem

import cicatrix
from cicatrix.cli.main import main
from cicatrix.core.errors import InputError
from cicatrix.geometry.tetrahedra import oriented, with_middles
from cicatrix.kinds.registry import check_case, load_case
from cicatrix.kinds.wound.body import meshed_wound

TISSUE = {"youngs_modulus_kPa": 10.0, "poisson_ratio": 0.45, "density_kg_m3": 1000.0}
AWAY = np.array([1e6, -1e6, 2e5])


def beam():
    """Return a cantilever of 40 x 10 x 10 mm."""
    mesh = skfem.MeshTet.init_tensor(*(np.linspace(0.0, length, n) for length, n in ((40.0, 5), (10.0, 2), (10.0, 2))))
    points = np.ascontiguousarray(mesh.p.T)
    return points, oriented(points, mesh.t.T)


def bar():
    """Return a cantilever of 40 x 10 x 10 mm in three cubes of six tetrahedra around their diagonals."""
    points = (
        np.array([(i, j, k) for k in range(2) for j in range(2) for i in range(4)], float) / [3, 1, 1] * [40, 10, 10]
    )
    cells = []
    for i in range(3):
        corner = [i + a + 4 * b + 8 * c for c in (0, 1) for b in (0, 1) for a in (0, 1)]
        for one, two, _ in itertools.permutations((1, 2, 4)):
            cells.append([corner[0], corner[one], corner[one + two], corner[7]])
    return points, oriented(points, np.array(cells))


def write(path, points, cells, fixed=None, **tissue):
    fixed = points[:, 0] == 0.0 if fixed is None else fixed
    kind = {4: "tetra", 10: "tetra10"}[cells.shape[1]]
    data = {name: [np.full(len(cells), value)] for name, value in (TISSUE | tissue).items()}
    meshio.Mesh(points, [(kind, cells)], point_data={"fixed": fixed.astype(float)}, cell_data=data).write(path)


def case_of(folder, mesh, body="", rest=""):
    (folder / "case.toml").write_text(f'kind = "equilibrium"\n[body]\nmesh = "{mesh}"\n{body}\n{rest}')
    return folder / "case.toml"


def moved(case, folder):
    """Return the displacement of the nodes, and the written mesh."""
    cicatrix.simulate(load_case(case), folder)
    mesh = meshio.read(next((folder / "fields").glob("*.vtu")))
    return mesh.point_data["displacement"], mesh


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Return the displacement of the cantilever under its weight."""
    folder = tmp_path_factory.mktemp("plain")
    write(folder / "a.vtu", *beam())
    return moved(case_of(folder, "a.vtu"), folder / "run")[0]


def test_a_mesh_far_from_the_origin(plain, tmp_path):
    points, cells = beam()
    write(tmp_path / "a.vtu", points + AWAY, cells, points[:, 0] == 0.0)
    case = load_case(case_of(tmp_path, "a.vtu"))
    run = cicatrix.simulate(case, tmp_path / "run")
    mesh = meshio.read(tmp_path / "run" / "fields" / "body-0000.vtu")
    np.testing.assert_allclose(mesh.point_data["displacement"], plain, atol=1e-6)
    np.testing.assert_array_equal(mesh.points, points + AWAY)
    assert run.outcome["volume_ml"].value == pytest.approx(4.0)
    assert "is solved about (1000020, -999995, 200005) mm" in (tmp_path / "run" / "manifest.json").read_text()


def test_a_wound_far_from_the_origin():
    points, cells = beam()
    is_wound = np.arange(len(cells)) < 9
    near, far = (meshed_wound(points + shift, cells, points[:, 0] == 0.0, is_wound) for shift in (np.zeros(3), AWAY))
    np.testing.assert_array_equal(near.origin, np.zeros(3))
    np.testing.assert_allclose(far.given(far.X), near.X + AWAY, atol=1e-9)
    assert np.abs(far.X).max() <= 21.0
    assert far.size(far.X) == pytest.approx(near.size(near.X), rel=1e-9)


def test_only_the_corners_of_a_quadratic_mesh_are_fixed(plain, tmp_path):
    n = len(beam()[0])
    points, cells = with_middles(*beam())
    write(tmp_path / "a.vtu", points, cells, (points[:, 0] == 0.0) & (np.arange(len(points)) < n))
    found, _ = moved(case_of(tmp_path, "a.vtu"), tmp_path / "run")
    np.testing.assert_allclose(found[:n], plain, atol=1e-9)
    assert (
        "5 midside nodes on the surface lie between two fixed corners"
        in (tmp_path / "run" / "manifest.json").read_text()
    )


def deck():
    points, cells = beam()
    rows = [", ".join(map(str, (k, *row))) for k, row in enumerate(points.tolist(), 1)]
    elements = [", ".join(map(str, (k, *(row + 1)))) for k, row in enumerate(cells, 1)]
    sets = {"CHEST": points[:, 0] == 0.0, "TIP": points[:, 0] == 40.0}
    named = [
        line for name, marked in sets.items() for line in (f"*NSET, NSET={name}", *map(str, np.flatnonzero(marked) + 1))
    ]
    return "\n".join(["*NODE", *rows, "*ELEMENT, TYPE=C3D4, ELSET=FAT", *elements, *named])


FAT = "materials.FAT = { E_kPa = 10.0, nu = 0.45, density_kg_m3 = 1000.0 }"


def test_supports_and_tissue_by_group(plain, tmp_path):
    (tmp_path / "a.inp").write_text(deck())
    case = case_of(tmp_path, "a.inp", f'fixed = "CHEST"\n{FAT}')
    assert check_case(case) == []
    np.testing.assert_array_equal(moved(case, tmp_path / "run")[0], plain)


def test_a_displacement_by_group(tmp_path):
    """A bar without weight is stretched by a tenth; by symmetry its section at the middle moves by half of it."""
    (tmp_path / "a.inp").write_text(deck())
    tissue = "materials.FAT = { E_kPa = 10.0, nu = 0.0, density_kg_m3 = 1000.0 }"
    body = f'fixed = "CHEST"\ndisplacement_mm.TIP = [4.0, 0.0, 0.0]\n{tissue}'
    case = case_of(tmp_path, "a.inp", body, "[loads]\ngravity_m_s2 = [0.0, 0.0, 0.0]")
    found, mesh = moved(case, tmp_path / "run")
    np.testing.assert_array_equal(found[mesh.points[:, 0] == 40.0], 4 * [[4.0, 0.0, 0.0]])
    assert found[mesh.points[:, 0] == 20.0, 0] == pytest.approx(2.0, abs=0.05)


def test_what_is_doubted_is_told_before_it_is_solved(tmp_path, capsys):
    write(tmp_path / "a.vtu", *beam(), density_kg_m3=1.0)
    assert main(["run", str(case_of(tmp_path, "a.vtu")), "--out", str(tmp_path / "run")]) == 0
    said = capsys.readouterr().err
    assert (
        "The density is 1 kg/m^3 in 24 tetrahedra; tissue has 500 to 2000: is it in g/cm^3?"
        in said[: said.index("solve")]
    )


@pytest.mark.parametrize(
    ("body", "rest", "sentence"),
    [
        (FAT, "", r'a.inp: .*`fixed` .* are missing; .*the file has the groups "FAT", "CHEST", "TIP"'),
        (f'fixed = "CHEST"\npressurised = "TIPP"\n{FAT}', "", 'body.pressurised names "TIPP", .*did you mean "TIP"'),
        (
            f'fixed = "CHEST"\n{FAT}',
            "[loads]\npressure_kPa = 1.0",
            "pressure_kPa = 1 acts on no face: .*body.pressurised",
        ),
        (
            'fixed = "CHEST"\nmaterials.FAT = { e_kPa = 10.0 }',
            "",
            r"FAT.e_kPa is not a known key; did you mean .*FAT.E_kPa\?",
        ),
        ('fixed = "CHEST"\nmaterials.FAT = { nu = 0.5 }', "", "body.materials.FAT.nu must be at least 0 and below 0.5"),
        ('fixed = "CHEST"\nmaterials = 3', "", "body.materials must be a table; got 3"),
        ("fixed = [1]", "", r"body.fixed\[0\] must be a text; got 1"),
    ],
)
def test_check_tells_what_run_would(body, rest, sentence, tmp_path):
    (tmp_path / "a.inp").write_text(deck())
    case = case_of(tmp_path, "a.inp", body, rest)
    (fault,) = check_case(case)
    with pytest.raises(InputError, match=sentence) as error:
        cicatrix.simulate(load_case(case))
    assert fault in str(error.value)


def test_smaller_steps_of_the_load_come_through_where_larger_ones_do_not(tmp_path):
    """Nearly incompressible tissue: Newton and the minimisation fail; the shape is that for the ratio beside, to 1e-3."""
    points, cells = bar()
    found = {}
    for nu in (0.4995, 0.4999):
        write(tmp_path / "a.vtu", points, cells, youngs_modulus_kPa=5.0, poisson_ratio=nu)
        result = cicatrix.simulate(load_case(case_of(tmp_path, "a.vtu")), tmp_path / f"{nu}")
        found[nu] = result.outcome["max_displacement_mm"].value
    assert "in smaller steps" in (tmp_path / "0.4999" / "manifest.json").read_text()
    assert found[0.4999] == pytest.approx(found[0.4995], rel=1e-3)

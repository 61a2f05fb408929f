"""Cases of kind "equilibrium": loaded and unloaded shapes of a user's mesh, and what is refused."""

import meshio
import numpy as np
import pytest
import skfem

import cicatrix
from cicatrix.cli.main import main
from cicatrix.core.errors import InputError
from cicatrix.geometry.tetrahedra import oriented, with_middles
from cicatrix.kinds.registry import load_case

CASE = """
kind = "equilibrium"
[body]
mesh = "body.vtu"
[loads]
gravity_m_s2 = [0.0, -9.81, 0.0]
"""


def cube(n=2, side=20.0):
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0, side, n + 1)] * 3)
    return mesh.p.T.copy(), oriented(mesh.p.T, mesh.t.T)


def write(folder, points, tetrahedra, *, without=(), name="body.vtu", **changed):
    """Write a soft cube fixed at z = 0; ``changed`` replaces data."""
    n = len(tetrahedra)
    point_data = {"fixed": changed.pop("fixed", (points[:, 2] < 1e-9).astype(float))}
    cell_data = {
        "youngs_modulus_kPa": np.full(n, 3.0),
        "poisson_ratio": np.full(n, 0.49),
        "density_kg_m3": np.full(n, 1e3),
    }
    cell_data |= changed
    kind = {4: "tetra", 10: "tetra10"}[tetrahedra.shape[1]]
    mesh = meshio.Mesh(
        points,
        [(kind, tetrahedra)],
        point_data={key: value for key, value in point_data.items() if key not in without},
        cell_data={key: [value] for key, value in cell_data.items() if key not in without},
    )
    mesh.write(folder / name)
    (folder / "case.toml").write_text(CASE)
    return folder / "case.toml"


def displacement(folder):
    (path,) = (folder / "fields").glob("*.vtu")
    return meshio.read(path)


def test_down_and_back_up_again(tmp_path):
    """Load a cube, write it, read it as the loaded shape and unload it: the result is the initial cube, on the user's nodes."""
    points, tetrahedra = cube()
    points, tetrahedra = points[::-1].copy(), len(points) - 1 - tetrahedra  # numbered in another order
    case = load_case(write(tmp_path, points, tetrahedra))
    down = cicatrix.simulate(case, tmp_path / "down")
    mesh = displacement(tmp_path / "down")
    np.testing.assert_allclose(mesh.points, points)
    np.testing.assert_array_equal(mesh.cells[0].data, tetrahedra)
    moved = mesh.point_data["displacement"]
    assert (moved[points[:, 2] < 1e-9] == 0).all()
    assert down.outcome["max_displacement_mm"].value == pytest.approx(np.linalg.norm(moved, axis=1).max())
    assert 0.1 < down.outcome["max_displacement_mm"].value < 10.0
    assert down.outcome["mass_g"].value == pytest.approx(8.0)
    assert down.outcome["newton_iterations"].value == len(down.history["iteration"])
    assert down.history["residual_mN"][-1] < 1e-8 * 8e-3 * 9810
    assert (tmp_path / "down" / "figures" / "shape.png").stat().st_size > 10_000

    quadratic = with_middles(points, tetrahedra)
    case = load_case(write(tmp_path, *quadratic), ["solver.inverse=true", "loads.gravity_m_s2=[0.0, 9.81, 0.0]"])
    up = cicatrix.simulate(case, tmp_path / "up")
    assert up.outcome["n_dofs"].value == down.outcome["n_dofs"].value
    unloaded = quadratic[0] + displacement(tmp_path / "up").point_data["displacement"]
    again = write(tmp_path, unloaded, quadratic[1], fixed=(quadratic[0][:, 2] < 1e-9).astype(float))
    cicatrix.simulate(load_case(again, ["loads.gravity_m_s2=[0.0, 9.81, 0.0]"]), tmp_path / "again")
    loaded = unloaded + displacement(tmp_path / "again").point_data["displacement"]
    np.testing.assert_allclose(loaded, quadratic[0], atol=1e-8)


def test_units_of_the_mesh(tmp_path):
    """The same body in metres gives the same result; a body in an unlikely unit gives a warning."""
    points, tetrahedra = cube()
    in_mm = cicatrix.simulate(load_case(write(tmp_path, points, tetrahedra)))
    in_m = cicatrix.simulate(load_case(write(tmp_path, 1e-3 * points, tetrahedra), ["body.mesh_unit=m"]))
    assert in_m.outcome["max_displacement_mm"].value == pytest.approx(in_mm.outcome["max_displacement_mm"].value)
    assert in_mm.outcome["largest_extent_mm"].note == ""
    small = cicatrix.simulate(load_case(write(tmp_path, 1e-3 * points, tetrahedra)))
    assert "mesh_unit" in small.outcome["largest_extent_mm"].note


def damaged(fault):
    """Return (points, tetrahedra, data) with one fault."""
    points, tetrahedra = cube()
    n = len(tetrahedra)
    if fault == "inverted":
        tetrahedra[5] = tetrahedra[5][[0, 2, 1, 3]]
    if fault == "twice":
        tetrahedra = np.vstack([tetrahedra, tetrahedra[7][[1, 2, 0, 3]]])
    if fault == "unused":
        points = np.vstack([points, [[1.0, 2.0, 3.0]]])
    if fault == "nan":
        points[3, 1] = np.nan
    if fault == "pieces":
        points, tetrahedra = np.vstack([points, points + 50.0]), np.vstack([tetrahedra, tetrahedra + len(points)])
    if fault == "pinched":  # a second cube on one corner of the first
        more = points + np.ptp(points, axis=0)
        points, tetrahedra = np.vstack([points, more]), np.vstack([tetrahedra, tetrahedra + len(points)])
        points, number = np.unique(points.round(6), axis=0, return_inverse=True)
        tetrahedra = number.ravel()[tetrahedra]
    if fault in ("swapped", "folded"):
        points, tetrahedra = with_middles(points, tetrahedra)
        if fault == "swapped":
            tetrahedra[5, 8:] = tetrahedra[5, :7:-1]
        else:
            points[tetrahedra[5, 4:7]] += 0.45 * (points[tetrahedra[5, 3]] - points[tetrahedra[5, :3]].mean(axis=0))
    if fault == "edge":  # two tetrahedra that share an edge only
        points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float)
        tetrahedra = np.array([[0, 2, 3, 1], [0, 4, 5, 1]])
    data = {
        "not fixed": {"fixed": np.zeros(len(points))},
        "two fixed": {"fixed": (np.arange(len(points)) < 2).astype(float)},
        "half fixed": {"fixed": np.full(len(points), 0.5)},
        "nu": {"poisson_ratio": np.full(n, 0.5)},
        "E": {"youngs_modulus_kPa": np.where(np.arange(n) == 4, -1.0, 1.0)},
        "E nan": {"youngs_modulus_kPa": np.where(np.arange(n) == 4, np.nan, 1.0)},
        "density": {"density_kg_m3": np.full(n, -1.0)},
    }
    return points, tetrahedra, data.get(fault, {})


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (
            "inverted",
            r"1 tetrahedra are inverted or flat, the first is number 5 at \(.*\) mm: all must have positive volume",
        ),
        ("twice", "1 tetrahedra occur more than once, the first is number 7"),
        ("unused", "1 nodes belong to no tetrahedron, the first is node 27"),
        ("nan", "node 3 has a coordinate that is not a number"),
        ("pieces", "the body falls into 2 pieces"),
        ("pinched", "the body falls into 2 pieces"),
        (
            "swapped",
            "1 tetrahedra have a midside node that lies nearer to the midpoint of another edge, the first is number 5",
        ),
        ("folded", r"\d+ tetrahedra (are folded by|have) .*(middle|midside) node"),
        ("two fixed", "the supports let the body translate or rotate: mark three"),
        ("edge", "the surface meets itself along an edge"),
        ("not fixed", "no node is fixed"),
        ("half fixed", "`fixed` must be 0 or 1"),
        ("nu", "poisson_ratio must be at least 0 and below 0.5; got 0.5 at cell 0"),
        ("E", "youngs_modulus_kPa must be above 0; got -1 at cell 4"),
        ("E nan", "youngs_modulus_kPa must be a finite number; got nan at cell 4"),
        ("density", "density_kg_m3 must be above 0; got -1"),
    ],
)
def test_faults_of_a_mesh_are_told(fault, sentence, tmp_path):
    points, tetrahedra, data = damaged(fault)
    case = load_case(write(tmp_path, points, tetrahedra, **data))
    with pytest.raises(InputError, match=f"body.vtu: .*{sentence}"):
        cicatrix.simulate(case, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["fixed", "youngs_modulus_kPa", "poisson_ratio", "density_kg_m3"])
def test_missing_data_are_named(name, tmp_path):
    case = load_case(write(tmp_path, *cube(), without=(name,)))
    with pytest.raises(InputError, match=f"data `{name}` .*missing"):
        cicatrix.simulate(case)


def test_a_file_that_is_no_mesh_is_told(tmp_path, capsys):
    (tmp_path / "case.toml").write_text(CASE)
    (tmp_path / "body.vtu").write_text("this is no mesh")
    assert main(["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "run")]) == 2
    assert "body.vtu cannot be read as a mesh" in capsys.readouterr().err
    meshio.Mesh(np.eye(3), [("triangle", [[0, 1, 2]])]).write(tmp_path / "body.vtu")
    assert main(["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "run")]) == 2
    assert "must be tetrahedra of 4 nodes, or of 10; the file has triangle" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_mesh_in_an_unlikely_unit_is_told_before_it_is_solved(tmp_path, capsys):
    points, tetrahedra = cube()
    write(tmp_path, 1e-3 * points, tetrahedra)
    assert main(["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "run")]) == 0
    said = capsys.readouterr().err
    assert "mm across: is body.mesh_unit right?" in said[: said.index("solve")]


def test_a_body_that_fails_in_the_wrong_unit_is_doubted(tmp_path):
    """A cube of 20 m collapses under its weight, and the error says which unit was assumed."""
    points, tetrahedra = cube()
    case = load_case(write(tmp_path, points, tetrahedra), ["body.mesh_unit=m"])
    with pytest.raises(
        cicatrix.core.errors.ConvergenceError, match=r"The mesh is 20000 mm across: is body\.mesh_unit right"
    ):
        cicatrix.simulate(case, tmp_path / "run")


def test_a_body_too_soft_for_its_weight_fails_with_its_history(tmp_path):
    points, tetrahedra = cube()
    case = load_case(write(tmp_path, points, tetrahedra, youngs_modulus_kPa=np.full(len(tetrahedra), 0.002)))
    with pytest.raises(cicatrix.core.errors.ConvergenceError) as caught:
        cicatrix.simulate(case, tmp_path / "run")
    assert caught.value.history
    assert "mesh_unit" not in str(caught.value)
    assert '"failed"' in (tmp_path / "run" / "manifest.json").read_text()


# ---- supports and pressure ----------------------------------------------------------------------------------------------


def write_supported(folder, case="", **point_data):
    """Write the cube without weight, with the given point data."""
    points, tetrahedra = cube()
    n = len(tetrahedra)
    data = {"fixed": np.zeros(len(points))} | {name: np.asarray(values, float) for name, values in point_data.items()}
    cells = {"youngs_modulus_kPa": 3.0, "poisson_ratio": 0.4, "density_kg_m3": 1e-3}
    mesh = meshio.Mesh(
        points,
        [("tetra", tetrahedra)],
        point_data=data,
        cell_data={name: [np.full(n, value)] for name, value in cells.items()},
    )
    mesh.write(folder / "body.vtu")
    (folder / "case.toml").write_text(CASE + "pressure_kPa = 0.0\n" + case)
    return folder / "case.toml"


def base_and_top(points):
    return points[:, 2] < 1e-9, points[:, 2] > 20.0 - 1e-9


def test_a_pulled_and_sheared_cube(tmp_path):
    """Patch test: the surface has an affine displacement, and the only inner node follows; gravity is 1e-6 of the stiffness."""
    points, _ = cube()
    outer = (np.abs(points - 10.0) > 10.0 - 1e-9).any(axis=1)
    shift = points @ np.array([[0.1, 0.0, 0.0], [0.2, -0.05, 0.0], [0.1, 0.3, 0.4]])
    case = load_case(
        write_supported(tmp_path, fixed=outer, prescribed_displacement=np.where(outer[:, None], shift, 0.0))
    )
    cicatrix.simulate(case, tmp_path / "run")
    np.testing.assert_allclose(displacement(tmp_path / "run").point_data["displacement"], shift, atol=1e-4)


def test_a_cube_in_a_corner_is_pressed(tmp_path):
    """Uniaxial compression between three frictionless walls with pressure on top; Cauchy stress -p along, 0 across, by hand."""
    points, _ = cube()
    walls = (np.abs(points) < 1e-9).any(axis=1)
    _, top = base_and_top(points)
    case = load_case(
        write_supported(tmp_path, sliding=walls, pressurised=top),
        ["loads.pressure_kPa=1.0", "loads.gravity_m_s2=[0.0, 0.0, 0.0]"],
    )
    cicatrix.simulate(case, tmp_path / "run")
    moved = displacement(tmp_path / "run").point_data["displacement"]
    stretch = 1.0 + moved[(points == 20.0).all(axis=1)][0] / 20.0
    np.testing.assert_allclose(moved, points * (stretch - 1.0), atol=1e-6)
    a, length = stretch[0], stretch[2]
    mu, kappa = 3.0 / 2.8, 3.0 / 0.6
    J = a * a * length
    # Cauchy stress of mu/2 (J^(-2/3) I1 - 3) + kappa/2 (J - 1)^2: along and across, by hand
    mean = kappa * (J - 1.0)
    along = mu * J ** (-5 / 3) * 2 / 3 * (length**2 - a**2) + mean
    across = mu * J ** (-5 / 3) / 3 * (a**2 - length**2) + mean
    assert stretch[1] == pytest.approx(a, rel=1e-7)
    assert along == pytest.approx(-1.0, rel=1e-6)
    assert across == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("data", "settings", "sentence"),
    [
        (
            {"prescribed_displacement": np.full((27, 2), 0.0)},
            [],
            "`prescribed_displacement` must have three components",
        ),
        ({"prescribed_displacement": np.full((27, 3), np.nan)}, [], "must be finite numbers; node 0"),
        ({"prescribed_displacement": np.ones((27, 3))}, [], "move 18 nodes that are not fixed, the first is node"),
        ({"sliding": np.full(27, 2.0)}, [], "`sliding` must be 0 or 1"),
        ({"sliding": np.arange(27) == 0}, [], "`sliding` mark 1 nodes that are on no boundary face"),
        ({"pressurised": np.full(27, np.nan)}, [], "`pressurised` have no value at 27 nodes"),
        ({"pressurised": np.arange(27) == 13}, [], "`pressurised` mark 1 nodes that are on no boundary face"),
        ({}, ["loads.pressure_kPa=1.0"], "loads.pressure_kPa = 1 acts on no face"),
        ({"fixed": np.zeros(27), "sliding": "base"}, [], "sliding nodes alone let the body translate or rotate"),
        ({"prescribed_displacement": "base"}, ["solver.inverse=true"], "must be 0 where solver.inverse = true"),
    ],
)
def test_faults_of_supports_are_told(data, settings, sentence, tmp_path):
    points, _ = cube()
    base = base_and_top(points)[0]
    at_base = {"sliding": base, "prescribed_displacement": base[:, None] * np.ones(3)}
    data = {"fixed": base} | {name: at_base[name] if isinstance(v, str) else v for name, v in data.items()}
    with pytest.raises(InputError, match=f"body.vtu: .*{sentence}"):
        cicatrix.simulate(load_case(write_supported(tmp_path, **data), settings), tmp_path / "run")

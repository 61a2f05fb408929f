"""VTU files and their series are read back as they were written."""

from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from cicatrix.files.vtu import TimeStepFile, read_series, write_series, write_vtu

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
MIDDLES = np.array([[0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])


@pytest.mark.parametrize("n", [3, 6])
@pytest.mark.parametrize("dimension", [2, 3])
def test_vtu_round_trip(tmp_path, n, dimension):
    points = np.vstack((CORNERS, MIDDLES))[:n]
    points = np.pad(points, ((0, 0), (0, dimension - 2)), constant_values=0.25)
    path = tmp_path / "fields" / "body-0000.vtu"
    write_vtu(path, points, np.arange(n)[None], {"displacement": points, "fixed": points[:, 0] == 0}, {"W_kPa": [0.1]})
    mesh = meshio.read(path)
    np.testing.assert_array_equal(mesh.points[:, :dimension], points)
    assert mesh.cells[0].type == ("triangle" if n == 3 else "triangle6")
    assert mesh.point_data["displacement"].shape == (n, 3)
    assert mesh.cell_data["W_kPa"][0] == [0.1]
    first = path.read_bytes()
    write_vtu(path, points, np.arange(n)[None], {"displacement": points, "fixed": points[:, 0] == 0}, {"W_kPa": [0.1]})
    assert path.read_bytes() == first
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_bad_triangles(tmp_path):
    with pytest.raises(ValueError, match="cells must be"):
        write_vtu(tmp_path / "a.vtu", CORNERS, np.zeros((1, 5), int))
    assert not list(tmp_path.iterdir())


def test_series_round_trip(tmp_path):
    step_files = [TimeStepFile("body", 0, 0.0), TimeStepFile("wound", 0, 0.0), TimeStepFile("body", 1, 7.1)]
    write_series(tmp_path, step_files)
    root = ElementTree.parse(tmp_path / "series.pvd").getroot()
    assert (root.tag, root.get("type")) == ("VTKFile", "Collection")
    rows = list(root.iter("DataSet"))
    assert [row.get("file") for row in rows] == ["body-0000.vtu", "wound-0000.vtu", "body-0001.vtu"]
    assert [float(row.get("timestep", "nan")) for row in rows] == [0.0, 0.0, 7.1]
    assert [row.get("part") for row in rows] == ["0", "1", "0"]
    assert read_series(tmp_path) == step_files

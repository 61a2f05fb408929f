"""Folders of runs written through the program's own interface, small enough for all numbers to be known."""

import shutil

import numpy as np
import pytest
import skfem

from cicatrix.files.pictures import picture
from cicatrix.geometry.labels import Label
from cicatrix.geometry.tetrahedra import oriented
from cicatrix.geometry.volume import Volume
from cicatrix.runs.kind import Fields
from cicatrix.runs.quantity import Quantity
from cicatrix.runs.results import RunFolder

SIDE = 40.0  # mm
CENTRE, RADIUS, MARGIN = (20.0, 20.0, 20.0), 8.0, 3.0
POSITIONS = ("upright", "supine")
MOMENTS = ((0, 0.0), (2, 14.0), (6, 42.0))  # cycle, days


def meshed(dimension, n=10):
    """Return corners (m, 3) [mm] and elements of a square or a cube with sides of 40 mm."""
    line = np.linspace(0.0, SIDE, n + 1)
    mesh = skfem.MeshTri.init_tensor(line, line) if dimension == 2 else skfem.MeshTet.init_tensor(line, line, line)
    points = np.pad(mesh.p.T, ((0, 0), (0, 3 - dimension)))
    return points, mesh.t.T if dimension == 2 else oriented(points, mesh.t.T)


def moved(points, position, cycle):
    """Return points that have sunk by up to (cycle + 1) mm, twice as much upright as supine."""
    sunk = points.copy()
    sunk[:, 1] += (cycle + 1) * (1.0 if position == "upright" else 0.5) * points[:, 0] / SIDE
    return sunk


def grid():
    """Return labels of a cube of gland in air with a tumour of 10 mm; voxels of 1 mm."""
    axis = np.arange(-5, 46, 1.0)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    inside = (np.abs(np.stack([x, y, z]) - SIDE / 2) <= SIDE / 2).all(axis=0)
    labels = np.where(inside, Label.GLAND, Label.AIR).astype(np.uint8)
    labels[(x - 20) ** 2 + (y - 20) ** 2 + (z - 20) ** 2 < 25.0] = Label.TUMOUR
    return Volume(labels, (1.0, 1.0, 1.0), (-5.0, -5.0, -5.0))


def write_run(path, dimension=3, *, finish=True, image=True, text="half-ellipsoid", **coupling):
    """Write the folder of a lumpectomy with two positions, before surgery and at three visits."""
    case = {
        "kind": "lumpectomy",
        "dimension": dimension,
        "image": {"phantom": text, "plane": "axial", "side": "left"},
        "resection": {"centre_mm": None, "radius_mm": RADIUS, "margin_mm": MARGIN},
        "coupling": {"healing_position": "upright", "mode": "two-way", **coupling},
        "outcome": {"positions": list(POSITIONS)},
    }
    points, cells = meshed(dimension)
    middle = points[cells].mean(axis=1)
    cavity = np.linalg.norm(middle[:, :dimension] - np.array(CENTRE)[:dimension], axis=1) < RADIUS
    with RunFolder.open(path, case, seed=1, sources={"tissue.fat.E_kPa": "a source"}) as folder:
        if image is not False:
            shown, note = picture(grid().with_values(grid().values * 40.0) if image is True else image)
            folder.save_volume("labels", grid())
            folder.save_volume("picture", shown)
            if note:
                folder.note(note)
        folder.found(resection_centre_mm=np.array(CENTRE))
        for position in POSITIONS:
            values = {"cavity": cavity.astype(np.int32), "strain_energy_density_kPa": middle[:, 0] / SIDE}
            still = {"displacement": np.zeros_like(points)}
            folder.write_fields(Fields(f"before-{position}", 0, 0.0, points, cells, still, values, "shapes"))
        for cycle, days in MOMENTS:
            share = cycle / 6.0
            for position in POSITIONS:
                x = moved(points, position, cycle)
                values = {
                    "filled_fraction": np.where(cavity, share, 1.0),
                    "cavity": cavity.astype(np.int32),
                    "strain_energy_density_kPa": middle[:, 0] / SIDE,
                }
                sunk = {"displacement": x - points}
                folder.write_fields(Fields(position, cycle, days, x, cells, sunk, values, "shapes"))
            size = ("open_area_mm2", "tissue_area_mm2") if dimension == 2 else ("open_volume_mm3", "tissue_volume_mm3")
            row = {"cycle": cycle, "time_days": days, "closed_fraction": share, size[0]: 2000.0 * (1 - share)}
            folder.record(row | {size[1]: 60000.0 + 2000.0 * share, "newton_iterations": 4 + cycle})
        if finish:
            numbers = {"time_to_closure_days": Quantity(40.0, "days", "a note")}
            for position in POSITIONS:
                numbers[f"{position}.healed.volume_change_percent"] = Quantity(-3.25, "%")
                numbers[f"{position}.healed.nipple_displacement_mm"] = Quantity(4.5, "mm")
            folder.write_outcome(numbers)
        folder.note("something to note")
        folder.finish("The wound closed after 40 days.")
        if not finish:
            raise KeyboardInterrupt
    return path


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """Return the folder of finished runs in 2-D and 3-D and of one that was interrupted."""
    folder = tmp_path_factory.mktemp("runs")
    write_run(folder / "plane", 2)
    write_run(folder / "solid", 3)
    write_run(folder / "other", 3, mode="one-way")
    with pytest.raises(KeyboardInterrupt):
        write_run(folder / "stopped", 3, finish=False)
    return folder


@pytest.fixture
def copy_of(runs, tmp_path):
    """Return a function that copies a run, so that the copy can be damaged."""

    def make(name):
        return shutil.copytree(runs / name, tmp_path / name)

    return make

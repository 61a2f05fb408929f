"""``cicatrix check`` opens the files that a case names: what it passes, a run starts with."""

import struct
import time

import meshio
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 - the name its own manual uses
import skfem

from cicatrix.cli.main import main
from cicatrix.core.errors import InputError
from cicatrix.files.image_headers import image_box
from cicatrix.files.images import write_volume
from cicatrix.geometry.labels import Label
from cicatrix.geometry.tetrahedra import oriented
from cicatrix.geometry.volume import Volume
from cicatrix.kinds.lumpectomy import check as lumpectomy_check
from cicatrix.kinds.registry import KINDS, case_type, check_case, load_case, simulation_type

SPECIES = "id,y_init,y_max,tau_h\nload,0,1,1\ncollagen,0,1,5\n"
REACTIONS = "id,rule,weight,n,ec50\nr1,=> load,0.5,1.4,0.5\nr2,load => collagen,1,1.4,0.5\n"
LUMPECTOMY = 'kind = "lumpectomy"\n[image]\n{image}\n[resection]\ncentre_mm = {centre}\nradius_mm = 8.0\n'
AUTOMATON = """kind = "automaton"
[lattice]
size = [20, 30]
fillable = "fillable.npy"
[wound]
mask = "mask.npy"
[cue]
W = "W.npy"
"""
WOUND = """kind = "wound"
[body]
mesh = "wound.vtu"
[mechanosensing]
type = "network"
species = "species.csv"
reactions = "reactions.csv"
input = "load"
output = "collagen"
bond = { k_on_per_s = 0.01, k_off_per_s = 0.012 }
substrate = { type = "exponential-fibre", k1_MPa = 0.07, k2 = 20.0, area_um2 = 0.017, length_um = 0.1 }
cell = { force_pN = 7.0, integrins_per_um2 = 400.0 }
"""
TISSUE = """kind = "tissue-cell"
bond = { k_on_per_s = 0.01, k_off_per_s = 0.012 }
substrate = { type = "exponential-fibre", k1_MPa = 0.07, k2 = 20.0, area_um2 = 0.017, length_um = 0.1 }
cell = { force_pN = 7.0, integrins_per_um2 = 400.0 }
signal = { type = "network", species = "species.csv", reactions = "reactions.csv", input = "load", output = "collagen" }
loading = { time_h = [0.0, 10.0], stretch = [1.0, 1.1] }
[[law]]
type = "neo-hookean"
mu_kPa = 1.0
"""


def write_mesh(path, **data):
    line = np.linspace(0.0, 20.0, 3)
    mesh = skfem.MeshTet.init_tensor(line, line, line)
    points, tetrahedra = mesh.p.T.copy(), oriented(mesh.p.T, mesh.t.T)
    n = len(tetrahedra)
    is_wound = (np.linalg.norm(points[tetrahedra].mean(axis=1) - 10.0, axis=1) < 7.0).astype(float)
    known = {"wound": is_wound, "youngs_modulus_kPa": np.full(n, 3.0), "poisson_ratio": np.full(n, 0.49)}
    cells = known | {"density_kg_m3": np.full(n, 1e3)} | data
    meshio.Mesh(
        points,
        [("tetra", tetrahedra)],
        point_data={"fixed": (points[:, 2] < 1e-9).astype(float)},
        cell_data={name: [values] for name, values in cells.items() if values is not None},
    ).write(path)


def breast():
    """Return labels of a ball of fat of 30 mm on a chest, in voxels of 2 mm; its centre is at (50, -80, 10) mm."""
    z, y, x = np.meshgrid(*(np.arange(-40.0, 41.0, 2.0),) * 3, indexing="ij")
    labels = np.where((x**2 + y**2 + z**2 < 900.0) & (y < 10.0), Label.FAT, Label.AIR).astype(np.uint8)
    labels[y >= 10.0] = Label.CHEST
    return Volume(labels, (2.0, 2.0, 2.0), (10.0, -120.0, -30.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder of files without a fault, and of some with one."""
    path = tmp_path_factory.mktemp("inputs")
    (path / "species.csv").write_text(SPECIES)
    (path / "reactions.csv").write_text(REACTIONS)
    (path / "unlinked.csv").write_text(REACTIONS.replace("load =>", "loud =>"))
    write_mesh(path / "body.vtu")
    write_mesh(path / "wound.vtu")
    write_mesh(path / "soft.vtu", youngs_modulus_kPa=np.full(48, -3.0))
    write_mesh(path / "whole.vtu", wound=np.zeros(48))
    volume = breast()
    write_volume(path / "labels.nii.gz", volume)
    write_volume(path / "image.nii.gz", volume.with_values(volume.values.astype(np.float32) * 100.0))
    whole = (path / "image.nii.gz").read_bytes()
    (path / "cut.nii.gz").write_bytes(whole[: len(whole) // 2])
    shape = (20, 30)
    np.save(path / "fillable.npy", np.ones(shape, bool))
    np.save(path / "mask.npy", np.arange(600).reshape(shape) % 30 < 5)
    np.save(path / "W.npy", np.zeros(shape))
    np.save(path / "turned.npy", np.zeros(shape[::-1], bool))
    np.save(path / "nan.npy", np.full(shape, np.nan))
    return path


CENTRE = "[50.0, -80.0, 10.0]"
EQUILIBRIUM = 'kind = "equilibrium"\n[body]\nmesh = "body.vtu"\n'
NETWORK = 'kind = "signalling"\n[network]\nspecies = "species.csv"\nreactions = "reactions.csv"\n'
IMAGE = LUMPECTOMY.format(image='path = "image.nii.gz"', centre=CENTRE)
LABELS = LUMPECTOMY.format(image='labels = "labels.nii.gz"', centre=CENTRE)
PHANTOM = LUMPECTOMY.format(image='phantom = "half-ellipsoid"', centre="[78.0, -30.0, 0.0]")


@pytest.mark.parametrize(
    ("text", "settings", "says"),
    [
        (EQUILIBRIUM, [], None),
        (EQUILIBRIUM, ["body.mesh=soft.vtu"], "soft.vtu: cell data youngs_modulus_kPa must be above 0"),
        (EQUILIBRIUM, ["body.mesh=species.csv"], "species.csv"),
        (EQUILIBRIUM, ["loads.pressure_kPa=1.0"], "acts on no face"),
        (WOUND, [], None),
        (WOUND, ["body.mesh=whole.vtu"], "whole.vtu: cell data `wound` must be 1"),
        (WOUND, ["mechanosensing.output=colagen"], "colagen"),
        (TISSUE, [], None),
        (TISSUE, ["signal.input=lode"], "lode"),
        (NETWORK, [], None),
        (NETWORK, ["network.reactions=unlinked.csv"], "loud"),
        (NETWORK, ["network.species=reactions.csv"], "column y_init is missing"),
        (AUTOMATON, [], None),
        (AUTOMATON, ["wound.mask=turned.npy"], "turned.npy holds bool [30, 20]"),
        (AUTOMATON, ["wound.mask=species.csv"], "is not a NumPy file"),
        (AUTOMATON, ["cue.W=nan.npy"], "must be finite at every site"),
        (IMAGE, [], None),
        (IMAGE, ["image.path=cut.nii.gz"], "image.path: the file is cut short or damaged"),
        (IMAGE, ["image.path=species.csv"], "image.path: this is not an image"),
        (
            IMAGE,
            ["resection.centre_mm=[-50.0, -80.0, 10.0]"],
            "resection.centre_mm must lie inside the image, x 9.0 to 91.0",
        ),
        (IMAGE, ["outcome.nipple_mm=[50.0, -300.0, 10.0]"], "outcome.nipple_mm must lie inside the image"),
        (IMAGE, ["image.slice_mm=40.0"], "image.slice_mm lies 30.0 mm from the centre of the resection"),
        (LABELS, [], None),
        (LABELS, ["image.labels=image.nii.gz"], "a label map has only 0 air"),
        (
            LABELS,
            ["resection.centre_mm=[14.0, -80.0, 10.0]"],
            "must lie inside the breast; (14.0, -80.0, 10.0) mm does not",
        ),
        (LABELS, ["resection.centre_mm=[50.0, 80.0, 10.0]"], "must lie inside the image"),
        (PHANTOM, [], None),
        (PHANTOM, ["resection.centre_mm=[-300.0, 0.0, 0.0]"], "must lie inside the image"),
    ],
    ids=lambda value: value.split("\n")[0] or "" if isinstance(value, str) and "kind" in value else None,
)
def test_what_the_files_hold_is_checked(folder, tmp_path, text, settings, says):
    case = folder / "case.toml"
    case.write_text(text)
    faults = check_case(case, settings)
    if says is None:
        assert faults == []
    else:
        assert len(faults) == 1, faults
        assert says in faults[0]


@pytest.mark.parametrize(
    "text", [EQUILIBRIUM, WOUND, NETWORK, AUTOMATON], ids=["equilibrium", "wound", "signalling", "automaton"]
)
def test_a_run_refuses_what_check_refuses(folder, text):
    """The same sentence comes from the simulation of a kind when it is made."""
    broken = {
        "equilibrium": "body.mesh=soft.vtu",
        "wound": "body.mesh=whole.vtu",
        "signalling": "network.reactions=unlinked.csv",
        "automaton": "wound.mask=turned.npy",
    }
    path = folder / "case.toml"
    path.write_text(text)
    kind = load_case(path).kind
    (fault,) = check_case(path, [broken[kind]])
    simulation_type(kind)(load_case(path))
    with pytest.raises(InputError) as refusal:
        simulation_type(kind)(load_case(path, [broken[kind]]))
    assert str(refusal.value) == fault


def test_two_faulty_files_are_two_faults(folder):
    path = folder / "case.toml"
    path.write_text(WOUND)
    assert len(check_case(path, ["body.mesh=whole.vtu", "mechanosensing.reactions=unlinked.csv"])) == 2


def test_every_kind_that_names_files_has_parts_to_check(folder):
    from importlib import import_module

    for kind in KINDS:
        if case_type(kind).files:
            assert import_module(f"cicatrix.kinds.{kind.replace('-', '_')}.check").PARTS


def test_a_large_image_is_opened_as_far_as_its_header(folder, tmp_path, monkeypatch):
    """The limit is set below the size of the file; the voxels of the file are missing, and nobody asks for them."""
    volume = Volume(np.zeros((40, 50, 60), np.uint8), (2.0, 3.0, 4.0), (-10.0, -20.0, -30.0))
    image = sitk.GetImageFromArray(volume.values)
    image.SetSpacing(volume.spacing_mm)
    image.SetOrigin(volume.origin_mm)
    image.SetDirection((-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0))
    sitk.WriteImage(image, str(tmp_path / "large.mha"))
    expected = [[-10 - 59 * 2 - 1, -20 - 49 * 3 - 1.5, -30 - 2], [-10 + 1, -20 + 1.5, -30 + 39 * 4 + 2]]
    assert image_box(tmp_path / "large.mha", print) == pytest.approx(np.array(expected))
    monkeypatch.setattr(lumpectomy_check, "LARGEST", 1000)
    monkeypatch.setattr(lumpectomy_check, "read_image", None)
    path = tmp_path / "case.toml"
    path.write_text(LUMPECTOMY.format(image='path = "large.mha"', centre="[-40.0, -80.0, 10.0]"))
    assert check_case(path) == []
    (fault,) = check_case(path, ["resection.centre_mm=[40.0, -80.0, 10.0]"])
    assert "x -129.0 to -9.0" in fault


def packed(at, form, *values):
    return lambda raw: raw[:at] + struct.pack(form, *values) + raw[at + struct.calcsize(form) :]


@pytest.mark.parametrize(
    ("ending", "spoil", "says"),
    [
        ("nii", packed(252, "<2h", 0, 0), "how the image lies"),  # no codes
        ("nii", packed(292, "<f", 50.0), "places the image twice"),
        ("nii", packed(108, "<f", 0.0), "vox_offset"),
        ("nrrd", lambda raw: raw.replace(b"left-posterior-superior", b"scanner-xyz"), "how the image lies"),
        ("mha", lambda raw: raw.replace(b"TransformMatrix = 1 0 0 0 1 0 0 0 1\n", b""), "how the image lies"),
    ],
)
def test_a_large_image_is_refused_by_the_header_that_a_run_refuses(tmp_path, monkeypatch, ending, spoil, says):
    file = tmp_path / f"large.{ending}"
    sitk.WriteImage(sitk.GetImageFromArray(np.ones((40, 50, 60), np.uint8)), str(file))
    file.write_bytes(spoil(file.read_bytes()))
    path = tmp_path / "case.toml"
    path.write_text(LUMPECTOMY.format(image=f'path = "large.{ending}"', centre="[30.0, 25.0, 10.0]"))
    (small,) = check_case(path)
    monkeypatch.setattr(lumpectomy_check, "LARGEST", 1000)
    assert check_case(path) == [small]
    assert says in small
    if "how" in says:
        assert check_case(path, ['image.axes="LPS"']) == []


def test_the_verb_says_it_in_a_line_each(folder, capsys):
    path = folder / "case.toml"
    path.write_text(EQUILIBRIUM)
    began = time.process_time()
    assert main(["check", str(path)]) == 0
    assert time.process_time() - began < 5.0
    assert main(["check", str(path), "--set", "body.mesh=soft.vtu"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"{path}: soft.vtu: cell data")


def test_measured_data_are_checked_as_a_fit_reads_them(tmp_path, capsys):
    case, data = tmp_path / "case.toml", tmp_path / "data.csv"
    law = '[[law]]\ntype = "neo-hookean"\nmu_kPa = 1.0\n'
    case.write_text('kind = "material-point"\nloading = { time_h = [0.0, 1.0], x = [1.0, 1.2] }\n' + law)
    data.write_text("time_h,lambda_x,sigma_x_kPa\n0,1.0,0.0\n1,1.2,0.6\n")
    assert main(["check", str(case), str(data)]) == 0
    data.write_text("time_h,lambda_x,sigma_x_kPa\n0,1.0,0.0\n1,-1.2,0.6\n")
    assert main(["check", str(case), str(data)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(data) in line
    assert line.count(str(case)) == 1
    case.write_text(law)
    assert main(["check", str(case), str(data)]) == 2
    assert capsys.readouterr().err.count(str(case)) == 1
    case.write_text(EQUILIBRIUM)
    write_mesh(tmp_path / "body.vtu")
    assert main(["check", str(case), str(data)]) == 2
    assert 'must be "material-point" for a fit' in capsys.readouterr().err

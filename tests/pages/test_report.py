"""Contents of reports, for complete and for damaged runs; the numbers follow by hand from the runs of conftest."""

import base64
import csv
import gzip
import json
import re

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813
from matplotlib.figure import Figure

from cicatrix.cli.main import main
from cicatrix.core.errors import InputError
from cicatrix.files.images import read_image
from cicatrix.files.segmentations import read_labels
from cicatrix.pages.bodies import scene, shapes_of
from cicatrix.pages.checks import checks_of
from cicatrix.pages.cosmesis import lines_of
from cicatrix.pages.curves import words
from cicatrix.pages.packing import packed
from cicatrix.pages.report import write_comparison, write_report
from cicatrix.pages.run_view import read_run_view
from cicatrix.pages.slices import EXCISED, MARGIN, zones
from cicatrix.runs.results import RunFolder

from .conftest import CENTRE, MARGIN as MARGIN_MM, RADIUS, SIDE, grid, write_run  # isort: skip

KIND = {"f4": "<f4", "i4": "<i4", "u1": "u1"}


def unpacked(array):
    """Unpack an array like the page does."""
    raw = gzip.decompress(base64.b64decode(array["gzip"]))
    return np.frombuffer(raw, KIND[array["type"]]).reshape(array["shape"])


def content(path):
    """Return letter, name and content of a data script."""
    text = path.read_text(encoding="ascii")
    return json.loads("[" + re.fullmatch(r"cicatrixPut\((.*)\);\n", text, re.S)[1] + "]")


@pytest.mark.parametrize(
    "values", [np.arange(6.0).reshape(2, 3), np.array([[1, -2]]), np.zeros((0, 3), int), np.arange(4, dtype=np.uint8)]
)
def test_arrays_come_out_as_they_went_in(values):
    assert np.array_equal(unpacked(packed(values)), values)


def test_equal_arrays_give_equal_bytes():
    assert packed(np.arange(3.0)) == packed(np.arange(3.0))


@pytest.mark.parametrize(("name", "n_faces"), [("plane", 200), ("solid", 6 * 200)])
def test_bodies_are_those_of_the_run(runs, name, n_faces):
    view = read_run_view(runs / name)
    drawn = scene(shapes_of(view), view)
    assert [(s["position"], s["label"]) for s in drawn["shapes"]] == [
        (position, label)
        for position in ("upright", "supine")
        for label in ("before surgery", "after surgery", "week 2", "healed")
    ]
    first, last = drawn["shapes"][0], drawn["shapes"][-1]
    assert unpacked(first["surfaces"]["whole"]["triangles"]).shape == (n_faces, 3)
    surface = last["surfaces"]["whole"]
    assert unpacked(surface["points"])[:, 1].max() == pytest.approx(
        SIDE + 3.5
    )  # supine, cycle 6: sunk by 3.5 mm at most
    assert unpacked(surface["atPoints"]["displacement"]).max() == pytest.approx(3.5)
    triangles, energy = unpacked(surface["triangles"]), unpacked(surface["inCells"]["strain_energy_density_kPa"])
    middle = unpacked(surface["points"])[triangles].mean(axis=1)[:, 0]
    assert np.abs(energy - middle / SIDE).max() < 0.03  # linear in x; within an element


def test_a_cut_body_shows_the_hole_and_its_walls(runs):
    view = read_run_view(runs / "solid")
    shapes = {(s.position, s.label): s for s in shapes_of(view)}
    drawn = {(s["position"], s["label"]): s for s in scene(shapes_of(view), view)["shapes"]}
    before = shapes["upright", "before surgery"]
    middle = before.points[before.cells[before.cavity]][..., 0].mean()
    areas, volumes = [], []
    for label in ("before surgery", "after surgery"):
        cut = drawn["upright", label]["surfaces"]["cut"]
        corners = unpacked(cut["points"])[unpacked(cut["triangles"])]
        n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert corners[..., 0].max() == pytest.approx(middle, abs=1e-4)
        areas.append(np.linalg.norm(n, axis=1).sum() / 2)
        volumes.append(float(np.sum(corners[:, 0] * n) / 6))  # by the divergence theorem: closed, and outward
    assert volumes[0] == pytest.approx(SIDE**2 * middle, rel=1e-5)
    cavity = tetrahedra_volume(shapes["upright", "after surgery"], shapes["upright", "after surgery"].cavity)
    assert volumes[0] - volumes[1] == pytest.approx(cavity / 2, rel=0.01)  # the plane goes through its middle
    assert areas[1] > areas[0] + RADIUS**2  # the wall of a half ball has twice the area of its disc


def tetrahedra_volume(shape, chosen):
    corners = shape.points[shape.cells[chosen]]
    return np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6


def test_numbers_of_the_table_are_those_of_the_run(runs):
    view = read_run_view(runs / "solid")
    shapes = shapes_of(view)
    lines = {line.name: line for line in lines_of(view, shapes)}
    removed = tetrahedra_volume(shapes[0], shapes[0].cavity)
    assert lines["Volume removed"].value == f"{removed / 1000:.1f} ml"
    assert lines["Share of the breast"].value == f"{100 * removed / SIDE**3:.1f} %"
    assert lines["Cavity closed after"].value == "40 days"
    assert lines["Change of volume, standing"].value == "-3.2 %"
    assert lines["Displacement of the nipple, lying on the back"].sentence == (
        "Healed, lying on the back, the nipple is 4.5 mm from where it was before surgery."
    )


def test_checks_see_what_is_lost_and_what_is_turned(runs, copy_of):
    view = read_run_view(runs / "solid")
    shapes = shapes_of(view)
    assert all(check.holds is not False for check in checks_of(view, shapes))
    shapes[1].points[:, 0] *= -1.0  # a mirror image: every element is inside out
    (turned,) = (c for c in checks_of(view, shapes) if c.name.startswith("inverted elements"))
    assert not turned.holds
    folder = copy_of("solid")
    table = (folder / "history.csv").read_text(encoding="utf-8").replace("2000.0", "9000.0")
    (folder / "history.csv").write_text(table)
    (drift,) = (c for c in checks_of(read_run_view(folder), []) if c.name.startswith("open cavity"))
    assert not drift.holds


def test_zones_are_a_ball_and_its_shell():
    made = zones(grid(), np.array(CENTRE), RADIUS, MARGIN_MM)
    inner, ball = (4 / 3 * np.pi * r**3 for r in (RADIUS - MARGIN_MM, RADIUS))
    assert np.count_nonzero(made.values == EXCISED) == pytest.approx(inner, rel=0.05)
    assert np.count_nonzero(made.values == MARGIN) == pytest.approx(ball - inner, rel=0.05)


def test_slices_hold_the_labels(runs, tmp_path):
    write_report(runs / "solid", tmp_path / "report")
    letter, name, slices = content(tmp_path / "report" / "data" / "slices.js")
    (tmp_path / "labels.nii.gz").write_bytes(base64.b64decode(slices["volumes"]["labels"]))
    assert (letter, name) == ("A", "slices")
    assert np.array_equal(read_labels(tmp_path / "labels.nii.gz").values, grid().values)
    assert slices["centre"] == list(CENTRE)


def test_a_report_is_made_in_the_runs_folder_and_made_again(copy_of, capsys):
    folder = copy_of("plane")
    assert main(["report", str(folder)]) == 0
    first = {p.relative_to(folder): p.read_bytes() for p in sorted((folder / "report").rglob("*")) if p.is_file()}
    assert str(folder / "report" / "index.html") in capsys.readouterr().out
    assert main(["report", str(folder)]) == 0
    again = {p.relative_to(folder): p.read_bytes() for p in sorted((folder / "report").rglob("*")) if p.is_file()}
    assert first == again


def test_the_pdf_has_the_numbers_and_every_figure(copy_of, tmp_path):
    folder = copy_of("solid")
    for name in ("one", "two"):
        figure = Figure()
        figure.subplots().plot([0, 1])
        (folder / "figures").mkdir(exist_ok=True)
        figure.savefig(folder / "figures" / f"{name}.png")
    write_report(folder, tmp_path / "report")
    pdf = (tmp_path / "report" / "figures.pdf").read_bytes()
    assert len(re.findall(rb"/Type /Page\b", pdf)) == 3
    assert (tmp_path / "report" / "figures" / "two.png").read_bytes() == (folder / "figures" / "two.png").read_bytes()


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda f: None, []),
        (lambda f: (f / "outcome.json").unlink(), ["There are no numbers yet"]),
        (lambda f: (f / "outcome.json").write_text("{"), ["outcome.json or history.csv is damaged"]),
        (lambda f: (f / "history.csv").unlink(), ["There is no history yet"]),
        (lambda f: (f / "picture.nii.gz").unlink(), ["picture.nii.gz is missing; the slices show only the labels"]),
        (lambda f: (f / "labels.nii.gz").write_bytes(b"no"), ["The slices show no labels"]),
        (lambda f: (f / "shapes" / "supine-0002.vtu").write_text("<VTKFile"), ["The bodies cannot be read"]),
        (lambda f: (f / "shapes" / "series.pvd").unlink(), ["There are no bodies yet"]),
        (lambda f: newer(f), ["made by cicatrix 99.0", "may not know all"]),
    ],
)
def test_what_is_missing_is_said(copy_of, tmp_path, spoil, says):
    folder = copy_of("solid")
    spoil(folder)
    page = write_report(folder, tmp_path / "report").read_text(encoding="utf-8")
    gaps = re.findall(r'<li class="gap">(.*?)</li>', page)
    assert len(gaps) == bool(says)
    assert all(words in gaps[0] for words in says)
    assert (tmp_path / "report" / "research.html").is_file()


def newer(folder):
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    manifest["program"]["version"] = "99.0"
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_a_run_that_was_stopped_is_shown_as_far_as_it_came(runs, tmp_path):
    page = write_report(runs / "stopped", tmp_path / "report").read_text(encoding="utf-8")
    assert "The run is not finished" in page
    assert "There are no numbers yet" in page
    assert (tmp_path / "report" / "data" / "body.js").is_file()
    labels = [s["label"] for s in content(tmp_path / "report" / "data" / "body.js")[2]["shapes"]]
    assert "healed" not in labels


def test_a_run_of_a_manifest_alone_gives_a_page(tmp_path):
    folder = tmp_path / "bare"
    write_run(tmp_path / "whole", 2, image=False)
    folder.mkdir()
    (folder / "manifest.json").write_bytes((tmp_path / "whole" / "manifest.json").read_bytes())
    page = write_report(folder).read_text(encoding="utf-8")
    assert "There are no bodies yet" in page
    assert "data-body" not in page


@pytest.mark.parametrize(
    ("prepare", "says"),
    [
        (lambda p: None, "does not exist"),
        (lambda p: p.write_text(""), "is a file"),
        (lambda p: p.mkdir(), "holds no run: it has no manifest.json"),
        (lambda p: (p.mkdir(), (p / "manifest.json").write_text("[]")), "is not the manifest of a run"),
    ],
)
def test_a_folder_that_is_no_run_is_refused_in_one_sentence(tmp_path, capsys, prepare, says):
    prepare(tmp_path / "run")
    assert main(["report", str(tmp_path / "run")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert says in lines[0]
    assert not (tmp_path / "run" / "report").exists()


def test_nothing_but_a_report_is_replaced(runs, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="something other than a report"):
        write_report(runs / "plane", tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "thesis.tex").read_text(encoding="utf-8") == "years of work"


def test_a_report_that_fails_leaves_the_old_one(copy_of, monkeypatch):
    folder = copy_of("plane")
    page = write_report(folder)
    before = page.read_bytes()
    monkeypatch.setattr("cicatrix.pages.report.write_pdf", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_report(folder)
    assert page.read_bytes() == before
    assert not list(folder.glob(".partial-*"))


def test_text_of_a_case_is_escaped(tmp_path):
    evil = '"><script>alert(1)</script>'
    folder = write_run(tmp_path / "<b>run<script>", 2, text=evil)
    write_report(folder, tmp_path / "report")
    for page in (tmp_path / "report").glob("*.html"):
        assert "<script>" not in page.read_text(encoding="utf-8")
        assert "<b>run" not in page.read_text(encoding="utf-8")
    assert "&lt;script&gt;" in (tmp_path / "report" / "research.html").read_text(encoding="utf-8")


def test_identifiers_of_dicom_never_appear(tmp_path):
    name = "Doe^Jane-4711"
    (tmp_path / "series").mkdir()
    for k in range(4):
        slice_ = sitk.GetImageFromArray(np.random.default_rng(k).integers(0, 255, (1, 51, 51)).astype(np.int16))
        tags = {
            "0010|0010": name,
            "0010|0020": name,
            "0008|1030": name,
            "0020|000e": "1.2.3",
            "0020|0037": "1\\0\\0\\0\\1\\0",
            "0028|0030": "1\\1",
        }
        for tag, value in (tags | {"0020|0032": f"0\\0\\{2.0 * k}"}).items():
            slice_.SetMetaData(tag, value)
        writer = sitk.ImageFileWriter()
        writer.KeepOriginalImageUIDOn()
        writer.SetFileName(str(tmp_path / "series" / f"{k}.dcm"))
        writer.Execute(slice_)
    assert name.encode() in (tmp_path / "series" / "0.dcm").read_bytes()
    folder = write_run(tmp_path / "run", 2, image=read_image(tmp_path / "series"))
    write_report(folder)
    files = [path for path in folder.rglob("*") if path.is_file()]
    slices = content(folder / "report" / "data" / "slices.js")[2]["volumes"].values()
    volumes = [gzip.decompress(base64.b64decode(volume)) for volume in slices]
    assert len(volumes) == 3
    assert not any(
        part in raw for part in (b"Doe^", b"Jane-4711") for raw in [*volumes, *(path.read_bytes() for path in files)]
    )


@pytest.mark.parametrize(
    ("kind", "deposition", "is_said"),
    [
        ("lumpectomy", None, True),
        ("lumpectomy", "unloaded", True),
        ("lumpectomy", "loaded", False),
        ("wound", None, False),
    ],
)
def test_the_report_says_in_its_first_lines_what_the_healed_shape_assumes(copy_of, tmp_path, kind, deposition, is_said):
    folder = copy_of("plane")
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    manifest["case"] |= {"kind": kind} | ({"healing": {"deposition": deposition}} if deposition else {})
    (folder / "manifest.json").write_text(json.dumps(manifest))
    write_report(folder, tmp_path / "report")
    for name in ("index.html", "research.html"):
        head = (tmp_path / "report" / name).read_text(encoding="utf-8").partition("<section")[0]
        assert ("keeps the volume of the hole by assumption" in head) == is_said
        assert ("not a prediction of the cosmetic result" in head) == is_said


def test_runs_are_compared(runs, tmp_path):
    page = write_comparison([runs / "solid", runs / "other", runs / "stopped"], tmp_path / "side").read_text(
        encoding="utf-8"
    )
    assert re.findall(r'<th scope="row"><code>(.*?)</code></th><td>(.*?)</td><td>(.*?)</td>', page) == [
        ("coupling.mode", "two-way", "one-way")
    ]
    assert all((tmp_path / "side" / letter / "index.html").is_file() for letter in "ABC")
    assert [content(tmp_path / "side" / letter / "data" / "body.js")[0] for letter in "ABC"] == ["A", "B", "C"]
    assert "The run is not finished" in page


def test_too_many_runs_and_the_same_twice_are_refused(runs, tmp_path, capsys):
    many = [str(runs / "solid")] * 2
    assert main(["report", *many, "--out", str(tmp_path / "side")]) == 2
    assert "given twice" in capsys.readouterr().err
    with pytest.raises(InputError, match="8 at most"):
        write_comparison([runs / "solid"] * 9, tmp_path / "side")


def test_files_of_a_report_are_the_runs(runs, tmp_path):
    write_report(runs / "solid", tmp_path / "report")
    with (tmp_path / "report" / "history.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    curves = content(tmp_path / "report" / "data" / "curves.js")[2]
    column = next(c for c in curves["columns"] if c["name"] == "newton_iterations")
    assert column["values"] == [float(row["newton_iterations"]) for row in rows]


@pytest.mark.parametrize(
    ("name", "label", "unit"),
    [
        ("time_days", "time", "days"),
        ("open_area_mm2", "open area", "mm²"),
        ("rho_per_mm3", "rho", "1/mm³"),
        ("n_cells", "n cells", "1"),
        ("c_g_per_mm3", "c", "g/mm³"),
    ],
)
def test_columns_have_words_and_units(name, label, unit):
    assert words(name) == (label, unit)


def test_a_manifest_that_lacks_tables_gives_a_page_all_the_same(copy_of, tmp_path):
    folder = copy_of("solid")
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    manifest["case"] = {"kind": "lumpectomy"}
    for key in ("found", "sources", "seconds", "libraries", "notes", "seed"):
        manifest.pop(key, None)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    page = write_report(folder, tmp_path / "report").read_text(encoding="utf-8")
    assert "does not say where the resection lies" in page


def test_an_open_wound_is_not_called_healed(copy_of, tmp_path):
    folder = copy_of("solid")
    outcome = json.loads((folder / "outcome.json").read_text(encoding="utf-8"))
    outcome["time_to_closure_days"]["value"] = None
    (folder / "outcome.json").write_text(json.dumps(outcome))
    page = write_report(folder, tmp_path / "report").read_text(encoding="utf-8")
    assert "At the last visit, with the cavity still open, standing, the nipple is 4.5 mm" in page
    labels = {s["label"] for s in content(tmp_path / "report" / "data" / "body.js")[2]["shapes"]}
    assert labels == {"before surgery", "after surgery", "week 2", "week 6"}


def test_what_a_killed_report_left_is_swept_when_the_run_goes_on(copy_of):
    folder = copy_of("stopped")
    (folder / ".partial-report" / "data").mkdir(parents=True)
    case = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["case"]
    with RunFolder.open(folder, case, seed=1, resume=True) as run:
        assert not (folder / ".partial-report").exists()
        run.finish("done")

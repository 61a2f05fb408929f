"""Sound inputs of every kind that the program reads, and what reading them gives: the inputs that ``robustness.py`` damages.

A kind has a function that writes its files, one that reads them through the program's own function, and, for text, one that says
what the damaged file says by a plain reading of its own. Values are a flat table: name -> array.
"""

from __future__ import annotations

import contextlib
import csv
import json
import re
import socket
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple
from xml.etree import ElementTree

import meshio
import numpy as np
import SimpleITK as sitk  # noqa: N813 - the name its own manual uses
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, EnhancedMRImageStorage, ExplicitVRLittleEndian

from cicatrix.cases.reading import case_table
from cicatrix.cli.fit import measured_for
from cicatrix.core.errors import InputError
from cicatrix.files.images import read_image
from cicatrix.files.mesh_tissue import Tissue
from cicatrix.files.meshes import ByGroup, read_body
from cicatrix.files.networks import read_network
from cicatrix.files.sbml import read_sbml
from cicatrix.files.segmentations import read_labels
from cicatrix.geometry.labels import Label
from cicatrix.geometry.volume import Volume
from cicatrix.kinds.automaton.build import automaton_of
from cicatrix.kinds.registry import load_case
from cicatrix.kinds.simulate import simulate
from cicatrix.pages.planner import Planner
from cicatrix.pages.planning import PlanningTable
from cicatrix.pages.server import PlanServer
from cicatrix.runs.manifest import flat
from cicatrix.runs.progress import Progress

Values = Mapping[str, Any]
NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")


class Kind(NamedTuple):
    """A kind of input."""

    write: Callable[[Path], list[str]]
    """Writes sound files into a folder and returns the names of those that may be damaged."""
    read: Callable[[Path], Values]
    """Reads the files of a folder through the program; InputError if it refuses them."""
    says: Callable[[Path], Values] | None = None
    """What the files say by another reading; None where there is none."""
    is_text: bool = True


AUTOMATON = """kind = "automaton"
[lattice]
type = "hex"
size = [40, 44]
pitch_um = 10.0
[wound]
radius_um = 90.0
[rules]
p_edge = 0.2
p_layer = 0.05
layer_sites = 6
[run]
seed = 3
max_steps = 400
"""
MASKED = AUTOMATON.replace("radius_um = 90.0", 'mask = "mask.npy"')
POINT = """kind = "material-point"
loading = { time_h = [0.0, 1.0], x = [1.0, 1.2] }
[[law]]
type = "neo-hookean"
mu_kPa = 1.0
"""
MEASURED = "time_h,lambda_x,sigma_x_kPa\n" + "".join(
    f"{0.1 * k:.1f},{1 + 0.02 * k:.2f},{0.061 * k:.3f}\n" for k in range(12)
)
SPECIES = "id,y_init,y_max,tau_h\nload,0.0,1.0,1.5\nSMAD,0.25,1.0,2.5\ncollagen,0.5,0.75,12.0\n"
REACTIONS = """id,rule,weight,n,ec50
r1,=> load,0.5,1.4,0.5
r2,load => SMAD,1.0,1.4,0.5
r3,SMAD & !load => collagen,0.8,1.3,0.45
"""
SBML = """<?xml version="1.0" encoding="UTF-8"?>
<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1">
 <model id="decay" timeUnits="second" substanceUnits="mole" volumeUnits="litre" extentUnits="mole">
  <listOfCompartments>
   <compartment id="c" spatialDimensions="3" size="1" units="litre" constant="true"/>
  </listOfCompartments>
  <listOfSpecies>
   <species id="A" compartment="c" initialConcentration="2.5" hasOnlySubstanceUnits="false" boundaryCondition="false"
    constant="false"/>
   <species id="B" compartment="c" initialConcentration="0.5" hasOnlySubstanceUnits="false" boundaryCondition="false"
    constant="false"/>
  </listOfSpecies>
  <listOfParameters><parameter id="k" value="0.125" constant="true"/></listOfParameters>
  <listOfReactions>
   <reaction id="r" reversible="false" fast="false">
    <listOfReactants><speciesReference species="A" stoichiometry="1" constant="true"/></listOfReactants>
    <listOfProducts><speciesReference species="B" stoichiometry="1" constant="true"/></listOfProducts>
    <kineticLaw><math xmlns="http://www.w3.org/1998/Math/MathML">
     <apply><times/><ci>c</ci><ci>k</ci><ci>A</ci></apply>
    </math></kineticLaw>
   </reaction>
  </listOfReactions>
 </model>
</sbml>
"""


def text_kind(name: str, text: str, read: Callable[[Path], Values], says: Any = None, **others: str) -> Kind:
    """Return a kind of one text file ``name``; ``others`` are files beside it, by name with ``_`` for the dot."""

    def write(folder: Path) -> list[str]:
        for other, content in others.items():
            (folder / other.replace("_", ".")).write_text(content)
        (folder / name).write_text(text)
        return [name]

    return Kind(write, read, says)


def only(folder: Path, stem: str) -> Path:
    """Return the file of a stem in a folder: its extension may have been damaged."""
    return next(path for path in sorted(folder.iterdir()) if path.name.split(".")[0] == stem)


def case_values(folder: Path) -> Values:
    """Read a case; its values by dotted key."""
    return {key: np.array(value) for key, value in flat(case_table(load_case(only(folder, "case"))))}


def case_says(folder: Path) -> Values:
    """Read the keys of a case as TOML has them, over those of the sound case."""
    given = tomllib.loads(only(folder, "case").read_text(encoding="utf-8-sig"))
    sound = dict(flat(case_table(load_case(SOUND / "case" / "case.toml"))))
    named = dict(flat(tomllib.loads(AUTOMATON)))
    left = {key: default for key, default in sound.items() if key not in named}
    return {key: np.array(value) for key, value in {**left, **dict(flat(given))}.items()}


def measured_values(folder: Path) -> Values:
    """Read measured data as a fit does."""
    return measured_for(folder / "case.toml", [], only(folder, "data"))[1].columns


def table(path: Path, names: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
    """Read a CSV table strictly: all rows as long as the first one, numbers as digits and a dot; other cells as text."""
    rows = [row for row in csv.reader(path.read_text(encoding="utf-8-sig").splitlines()) if any(row)]
    if any(len(row) != len(rows[0]) for row in rows) or len(set(rows[0])) != len(rows[0]):
        raise ValueError("no table")
    columns = {name.strip(): [row[k].strip() for row in rows[1:]] for k, name in enumerate(rows[0])}
    return {name: _column(cells) for name, cells in columns.items() if not names or name in names}


def measured_says(folder: Path) -> Values:
    """Read the rows of a table of measured data in which no number is missing; those are left out with a note."""
    columns = table(only(folder, "data"))
    is_whole = np.all([np.isfinite(column) for column in columns.values()], axis=0)
    return {name: column[is_whole] for name, column in columns.items()}


def _column(cells: list[str]) -> np.ndarray:
    if all(NUMBER.fullmatch(cell) for cell in cells if cell):
        return np.array([float(cell) if cell else np.nan for cell in cells])
    return np.array(cells)


def network_values(folder: Path) -> Values:
    """Read a network in two tables."""
    model = read_network(only(folder, "species"), only(folder, "reactions"))
    law: Any = model.law
    hours = np.asarray(law.tau) / 3600.0
    columns = {
        "y_init": model.start,
        "y_max": law.y_max,
        "tau_h": hours,
        "weight": law.weight,
        "n": law.n,
        "ec50": law.ec50,
    }
    return {"id": np.array(law.species), **{name: np.asarray(values) for name, values in columns.items()}}


def network_says(folder: Path) -> Values:
    """Read the numbers of the two tables strictly."""
    species, reactions = (table(only(folder, name)) for name in ("species", "reactions"))
    names = {"y_init", "y_max", "tau_h"}, {"weight", "n", "ec50"}
    picked = {key: species[key] for key in names[0]} | {key: reactions[key] for key in names[1]}
    return {"id": species["id"], **picked}


def sbml_values(folder: Path) -> Values:
    """Read a model in SBML: its initial state and its constants, and its rates there."""
    model = read_sbml(only(folder, "model"))
    found = dict(zip(model.law.species, map(float, model.start)))
    return {**found, **dict(zip(model.law.input_names, map(float, model.inputs)))}


def sbml_says(folder: Path) -> Values:
    """Read the values of species, compartments and parameters as attributes."""
    root = ElementTree.fromstring(only(folder, "model").read_bytes())
    keys = {"species": "initialConcentration", "compartment": "size", "parameter": "value"}
    tagged = ((element.tag.rpartition("}")[2], element) for element in root.iter())
    return {element.attrib["id"]: float(element.attrib[keys[tag]]) for tag, element in tagged if tag in keys}


def bar() -> meshio.Mesh:
    """Return a bar of 24 tetrahedra, fixed at one end."""
    axis = [np.linspace(0.0, length, n) for length, n in ((20.0, 3), (10.0, 2), (10.0, 2))]
    points = np.stack(np.meshgrid(*axis, indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.array([0, 1, 2, 3, 4, 5, 6, 7])
    split = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
    cells = np.vstack([corner[split] + 4 * k for k in range(2)])
    n = len(cells)
    data = {"youngs_modulus_kPa": 3.0, "poisson_ratio": 0.45, "density_kg_m3": 1000.0}
    return meshio.Mesh(
        points,
        [("tetra", cells)],
        point_data={"fixed": (points[:, 0] < 1e-9).astype(float)},
        cell_data={name: [np.full(n, value)] for name, value in data.items()},
    )


def mesh_kind(name: str, **options: Any) -> Kind:
    """Return a kind of mesh file; ``options`` are those of meshio's writer."""

    def write(folder: Path) -> list[str]:
        mesh = bar()
        if name.endswith(".stl"):
            faces = np.unique(
                np.sort(np.vstack([mesh.cells[0].data[:, k] for k in ([0, 1, 2], [1, 2, 3])]), axis=1), axis=0
            )
            mesh = meshio.Mesh(mesh.points, [("triangle", faces)])
        mesh.write(folder / name, **options)
        return [name]

    return Kind(write, mesh_values, mesh_says, is_text=not options.get("binary", False))


def mesh_values(folder: Path) -> Values:
    """Read a body."""
    body = read_body(only(folder, "body"), "mm")
    names = ("points", "tetrahedra", "is_fixed", "E", "nu", "density")
    found = {name: np.asarray(getattr(body, name)) for name in names}
    return found | {"tetrahedra": np.sort(found["tetrahedra"], axis=1)}


def mesh_says(folder: Path) -> Values:
    """Read the mesh by meshio alone."""
    mesh = meshio.read(only(folder, "body"))
    cells = mesh.cell_data
    return {
        "points": mesh.points,
        "tetrahedra": np.sort(mesh.cells_dict["tetra"], axis=1),
        "is_fixed": mesh.point_data["fixed"].ravel() == 1,
        "E": cells["youngs_modulus_kPa"][0].ravel(),
        "nu": cells["poisson_ratio"][0].ravel(),
        "density": cells["density_kg_m3"][0].ravel() * 1e-9,
    }


def write_abaqus(folder: Path) -> list[str]:
    """Write the bar as an input file of Abaqus: a set of nodes that is fixed, and one of elements."""
    sound = bar()
    held, everything = np.flatnonzero(sound.point_data["fixed"]), np.arange(len(sound.cells[0].data))
    mesh = meshio.Mesh(sound.points, sound.cells, point_sets={"CHEST": held}, cell_sets={"FAT": [everything]})
    mesh.write(folder / "body.inp")
    return ["body.inp"]


def abaqus_values(folder: Path) -> Values:
    """Read a body whose support and tissue a case gives by the names of sets."""
    given = ByGroup(fixed=("CHEST",), materials={"FAT": Tissue(3.0, 0.49, 1e3)})
    body = read_body(only(folder, "body"), "mm", None, given)
    return {"points": body.points, "tetrahedra": np.sort(body.tetrahedra, axis=1), "is_fixed": body.is_fixed}


def abaqus_says(folder: Path) -> Values:
    """Read nodes, elements and the fixed set by meshio alone."""
    mesh = meshio.read(only(folder, "body"))
    is_fixed = np.isin(np.arange(len(mesh.points)), mesh.point_sets["CHEST"])
    return {"points": mesh.points, "tetrahedra": np.sort(mesh.cells_dict["tetra"], axis=1), "is_fixed": is_fixed}


def grey() -> np.ndarray:
    """Return an image of a breast-like blob, values 0 to 1000 (12, 14, 16) int16."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in (12, 14, 16)), indexing="ij")
    return (1000.0 * np.clip(1.2 - x**2 - y**2 - z**2, 0.0, 1.0)).astype(np.int16)


def write_image(path: Path, values: np.ndarray, *, compressed: bool) -> None:
    """Write an image of voxels of 12 x 13 x 14 mm by ITK."""
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((12.0, 13.0, 14.0))
    image.SetOrigin((-96.0, -120.0, -80.0))
    sitk.WriteImage(image, str(path), useCompression=compressed)


def image_kind(name: str, *, compressed: bool = False, labels: bool = False) -> Kind:
    """Return a kind of image file."""

    def write(folder: Path) -> list[str]:
        values = np.where(grey() > 300, Label.FAT, Label.AIR).astype(np.uint8) if labels else grey()
        write_image(folder / name, values, compressed=compressed)
        return [name]

    def read(folder: Path) -> Values:
        return volume_values((read_labels if labels else read_image)(only(folder, "image")))

    return Kind(write, read, is_text=False)


def volume_values(volume: Volume) -> Values:
    """Return the voxels and the geometry of a volume."""
    return {"voxels": volume.values, "spacing": np.array(volume.spacing_mm), "origin": np.array(volume.origin_mm)}


def _dicom(storage: str) -> Dataset:
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = storage, "1.2.3.4.5"
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    found = Dataset()
    found.file_meta, found.SOPClassUID = meta, storage
    found.PatientName, found.Modality = "Nobody", "MR"
    found.SeriesInstanceUID, found.StudyInstanceUID = "1.2.3.4", "1.2.3"
    found.SamplesPerPixel, found.PhotometricInterpretation = 1, "MONOCHROME2"
    found.BitsAllocated, found.BitsStored, found.HighBit, found.PixelRepresentation = 16, 16, 15, 1
    return found


def write_slices(folder: Path) -> list[str]:
    """Write a classic DICOM series, a file for each slice."""
    (folder / "series").mkdir()
    for k, values in enumerate(grey()):
        found = _dicom(CTImageStorage)
        found.SOPInstanceUID = found.file_meta.MediaStorageSOPInstanceUID = f"1.2.3.4.{k + 1}"
        found.Rows, found.Columns = values.shape
        found.PixelSpacing, found.SliceThickness = [13.0, 12.0], 14.0
        found.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        found.ImagePositionPatient = [-96, -120, -80 + 14 * k]
        found.RescaleSlope, found.RescaleIntercept = 1, 0
        found.PixelData = values.tobytes()
        found.save_as(folder / "series" / f"k{k:02d}.dcm", enforce_file_format=True)
    return [f"series/k{k:02d}.dcm" for k in (0, 5, 11)]


def write_enhanced(folder: Path) -> list[str]:
    """Write an enhanced DICOM file of all slices."""
    values, found = grey(), _dicom(EnhancedMRImageStorage)
    found.SOPInstanceUID = found.file_meta.MediaStorageSOPInstanceUID
    found.NumberOfFrames, found.Rows, found.Columns = values.shape
    shared, measures, orientation = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing, measures.SliceThickness = [13.0, 12.0], 14.0
    orientation.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [orientation]
    found.SharedFunctionalGroupsSequence = [shared]
    frames = []
    for k in range(len(values)):
        frame, position = Dataset(), Dataset()
        position.ImagePositionPatient = [-96, -120, -80 + 14 * k]
        frame.PlanePositionSequence = [position]
        frames.append(frame)
    found.PerFrameFunctionalGroupsSequence = frames
    found.PixelData = values.tobytes()
    found.save_as(folder / "image.dcm", enforce_file_format=True)
    return ["image.dcm"]


def write_mask(folder: Path) -> list[str]:
    """Write a case with a mask."""
    (folder / "case.toml").write_text(MASKED)
    mask = np.zeros((40, 44), bool)
    mask[15:25, 15:25] = True
    np.save(folder / "mask.npy", mask)
    return ["mask.npy"]


def mask_values(folder: Path) -> Values:
    """Build the automaton of a case with a mask."""
    return {"open": automaton_of(load_case(folder / "case.toml", [f"wound.mask={only(folder, 'mask').name}"])).open0}


def write_stopped(folder: Path) -> list[str]:
    """Write the folder of a run that was stopped half way, with its checkpoints."""
    (folder / "case.toml").write_text(AUTOMATON.replace("p_layer = 0.05", "p_layer = 0.01"))

    class Stop(Progress):
        count = 0

        def update(self, fraction: float | None, words: str = "") -> None:
            self.count += 1
            if self.count > 8:
                raise KeyboardInterrupt

    with contextlib.suppress(KeyboardInterrupt):
        simulate(folder / "case.toml", folder / "run", progress=Stop())
    names = [path.relative_to(folder).as_posix() for path in sorted((folder / "run").rglob("*")) if path.is_file()]
    assert "run/outcome.json" not in names, "the run came to its end"
    return [name for name in names if name.endswith((".json", ".npz", ".csv"))]


def resumed_values(folder: Path) -> Values:
    """Resume the run to its end: its history and its numbers."""
    results = simulate(folder / "case.toml", folder / "run", resume=True)
    numbers = {name: np.array(asked.value) for name, asked in results.outcome.items() if "second" not in name}
    return {**results.history, **numbers}


def write_request(folder: Path) -> list[str]:
    """Write the body of a request to the planning server."""
    keys = {"centre_mm": [20.0, 22.0, 24.0], "radius_mm": 8.0, "margin_mm": 3.0}
    keys |= {"dimension": 2, "model": "automaton", "mode": "one-way"}
    (folder / "request.json").write_text(json.dumps(keys, indent=1))
    return ["request.json"]


def request_values(folder: Path) -> Values:
    """Send the request to a server, which saves it as a case; a refusal in a sentence becomes an InputError."""
    body = only(folder, "request").read_bytes()
    labels = np.zeros((40, 40, 40), np.uint8)
    labels[4:36, 4:36, 4:36] = Label.GLAND
    volume = Volume(labels, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    table = PlanningTable(volume, volume, {"phantom": "half-ellipsoid"}, ())
    server = PlanServer(Planner(table, folder / "out", folder / "site"))
    Thread(target=server.serve_forever, daemon=True).start()
    head = f"POST /{server.token}/save HTTP/1.1\r\nHost: 127.0.0.1:{server.server_port}\r\nContent-Type: application/json\r\n"
    with socket.create_connection(("127.0.0.1", server.server_port), 8) as connection:
        connection.sendall(head.encode() + f"Content-Length: {len(body)}\r\n\r\n".encode() + body)
        answer = b"".join(iter(lambda: connection.recv(1 << 16), b""))
    status, content = int(answer.split()[1]), json.loads(answer.partition(b"\r\n\r\n")[2])
    if 400 <= status < 500:
        raise InputError(content["error"])
    assert status == 200, content
    case = tomllib.loads(content["text"])
    return _plan(
        {**case["resection"], "dimension": case["dimension"], "model": case["healing"]["model"], **case["coupling"]}
    )


def request_says(folder: Path) -> Values:
    """Read the plan as JSON."""
    return _plan(json.loads(only(folder, "request").read_bytes()))


def _plan(keys: dict[str, Any]) -> Values:
    known = {"radius_mm": 12.0, "margin_mm": 5.0, "dimension": 2, "model": "automaton", "mode": "two-way"}
    return {
        name: np.array(value) for name, value in {**known, **keys, "centre_mm": np.round(keys["centre_mm"], 2)}.items()
    }


SOUND = Path("/nonexistent")  # folder of the sound inputs; set by robustness.py
NEVER = ("mesh, STL",)  # a sound file of these has no tetrahedra: it is refused
KINDS: dict[str, Kind] = {
    "case file (TOML)": text_kind("case.toml", AUTOMATON, case_values, case_says),
    "measured data (CSV)": text_kind("data.csv", MEASURED, measured_values, measured_says, case_toml=POINT),
    "network: species (CSV)": text_kind("species.csv", SPECIES, network_values, network_says, reactions_csv=REACTIONS),
    "network: reactions (CSV)": text_kind(
        "reactions.csv", REACTIONS, network_values, network_says, species_csv=SPECIES
    ),
    "SBML": text_kind("model.xml", SBML, sbml_values, sbml_says),
    "mesh, VTU": mesh_kind("body.vtu", binary=True),
    "mesh, VTK": mesh_kind("body.vtk", binary=False),
    "mesh, gmsh 4.1": mesh_kind("body.msh", file_format="gmsh", binary=True),
    "mesh, Abaqus": Kind(write_abaqus, abaqus_values, abaqus_says),
    "mesh, STL": mesh_kind("body.stl"),
    "image, NIfTI": image_kind("image.nii"),
    "image, NIfTI gzipped": image_kind("image.nii.gz", compressed=True),
    "image, NRRD": image_kind("image.nrrd"),
    "image, MetaImage compressed": image_kind("image.mha", compressed=True),
    "image, DICOM series": Kind(write_slices, lambda f: volume_values(read_image(f / "series")), is_text=False),
    "image, DICOM enhanced": Kind(write_enhanced, lambda f: volume_values(read_image(only(f, "image"))), is_text=False),
    "label map": image_kind("image.nii.gz", compressed=True, labels=True),
    "mask (NumPy)": Kind(write_mask, mask_values, is_text=False),
    "run to resume": Kind(write_stopped, resumed_values, is_text=False),
    "request to the planning server": Kind(write_request, request_values, request_says),
}

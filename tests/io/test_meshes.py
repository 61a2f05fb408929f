"""Meshes that people's programs write: formats, groups, pieces, and the sentences on those that cannot be read."""

import base64
import itertools
import re
import struct
import sys
import zlib

import meshio
import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.files.mesh_doubts import doubts_of
from cicatrix.files.mesh_formats import read_mesh
from cicatrix.files.mesh_tissue import Tissue
from cicatrix.files.meshes import ByGroup, read_body, read_wound
from cicatrix.geometry.tetrahedra import boundary, far_origin, oriented, volumes, with_middles

TISSUE = {"youngs_modulus_kPa": 10.0, "poisson_ratio": 0.45, "density_kg_m3": 1000.0}
FAT = {"FAT": Tissue(10.0, 0.45, 1000.0)}


def bar(nx=3):
    """Return a bar of 12 x 5 x 5 mm in tetrahedra (n, 3) [mm], (m, 4)."""
    shape = nx + 1, 2, 2
    points = np.array(list(itertools.product(*map(range, shape))), float) / [nx, 1, 1] * [12.0, 5.0, 5.0]
    number = np.arange(len(points)).reshape(shape)
    cells = []
    for i in range(nx):
        corner = number[i : i + 2].reshape(-1)  # corners of a box, numbered by bits
        for one, two, four in itertools.permutations((1, 2, 4)):
            cells.append([corner[0], corner[one], corner[one + two], corner[one + two + four]])
    return points, oriented(points, np.array(cells))


POINTS, CELLS = bar()
FIXED = (POINTS[:, 0] == 0.0).astype(float)
OUTER = boundary(CELLS)
CHEST = OUTER[(POINTS[OUTER][:, :, 0] == 0.0).all(axis=1)]


def mesh_of(points=POINTS, cells=CELLS, fixed=FIXED, **tissue):
    kind = {4: "tetra", 10: "tetra10"}[cells.shape[1]]
    values = {name: [np.full(len(cells), value)] for name, value in (TISSUE | tissue).items()}
    return meshio.Mesh(points, [(kind, cells)], point_data={"fixed": fixed}, cell_data=values)


# ---- formats


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.vtu", {"binary": False}),
        ("a.vtu", {"compression": None}),
        ("a.VTU", {"compression": "zlib", "file_format": "vtu"}),
        ("a.vtu", {"compression": "lzma"}),
        ("a.vtk", {"binary": False}),
        ("a.vtk", {"binary": True}),
        ("a.msh", {"file_format": "gmsh22", "binary": False}),
        ("a.msh", {"file_format": "gmsh22", "binary": True}),
        ("a.msh", {"file_format": "gmsh", "binary": False}),
        ("a.msh", {"file_format": "gmsh", "binary": True}),
    ],
)
def test_a_format_that_holds_data(name, options, tmp_path):
    """The data are different in every element and node, so that a wrong order is found."""
    E = 1.0 + np.arange(len(CELLS))
    mesh_of(youngs_modulus_kPa=E).write(tmp_path / name, **options)
    body = read_body(tmp_path / name, "mm")
    np.testing.assert_array_equal(body.points, POINTS)
    np.testing.assert_array_equal(body.tetrahedra, CELLS)
    np.testing.assert_array_equal(body.is_fixed, FIXED == 1)
    np.testing.assert_array_equal(body.E, E)
    assert body.notes == ()


def vtu(pieces, appended="raw", order="<", header="I", compressed=False, split=False):
    """Return a VTU file of (points, cells, point data, cell data) with appended arrays, by the specification of the format."""
    blob = b""

    def packed(content):
        if not compressed:
            head, content = struct.pack(order + header, len(content)), content
        else:
            half = len(content) // 2
            blocks = [
                zlib.compress(part) for part in (content[:half], content[half : 2 * half], content[2 * half :]) if part
            ]
            last = len(content) - 2 * half
            sizes = [len(blocks), half, last, *map(len, blocks)]
            head, content = struct.pack(f"{order}{len(sizes)}{header}", *sizes), b"".join(blocks)
        if appended == "raw":
            return head + content
        return (
            base64.b64encode(head) + base64.b64encode(content)
            if split or compressed
            else base64.b64encode(head + content)
        )

    def array(name, values, kind, width=1):
        nonlocal blob
        offset, size = len(blob), {"Float64": "f8", "Int64": "i8", "UInt8": "u1"}[kind]
        blob += packed(np.asarray(values).astype(order + size).tobytes())
        return (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format="appended" offset="{offset}"/>'
        )

    text = ""
    for points, cells, at_points, in_cells in pieces:
        n = cells.shape[1]
        text += f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}"><PointData>'
        text += "".join(array(name, values, "Float64") for name, values in at_points.items()) + "</PointData><CellData>"
        text += "".join(array(name, values, "Float64") for name, values in in_cells.items()) + "</CellData>"
        text += f"<Points>{array('Points', points, 'Float64', 3)}</Points><Cells>"
        text += array("connectivity", cells, "Int64") + array("offsets", n * np.arange(1, len(cells) + 1), "Int64")
        text += array("types", np.full(len(cells), {4: 10, 10: 24}[n]), "UInt8") + "</Cells></Piece>"
    compressor = ' compressor="vtkZLibDataCompressor"' if compressed else ""
    head = (
        f'<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="2.2" '
        f'byte_order="{"Little" if order == "<" else "Big"}Endian" header_type="UInt{8 * struct.calcsize(header)}"{compressor}>'
        f'<UnstructuredGrid>{text}</UnstructuredGrid><AppendedData encoding="{appended}">\n_'
    )
    return head.encode() + blob + b"\n</AppendedData></VTKFile>\n"


def piece(rows, **more):
    """Return some tetrahedra of the bar with the nodes that they use."""
    used, renumbered = np.unique(CELLS[rows], return_inverse=True)
    data = {name: np.full(np.shape(rows), value) for name, value in TISSUE.items()}
    return POINTS[used], renumbered.reshape(-1, 4), {"fixed": FIXED[used]}, data | more


ALL = np.arange(len(CELLS))


@pytest.mark.parametrize("options", [{}, {"order": ">"}, {"header": "Q"}, {"compressed": True}])
@pytest.mark.parametrize("appended", ["raw", "base64", "base64 in two"])
def test_a_vtu_with_appended_data(appended, options, tmp_path):
    encoding, _, split = appended.partition(" ")
    (tmp_path / "a.vtu").write_bytes(vtu([piece(ALL)], encoding, split=bool(split), **options))
    body = read_body(tmp_path / "a.vtu", "mm")
    np.testing.assert_array_equal(body.points, POINTS)
    np.testing.assert_array_equal(body.tetrahedra, CELLS)
    np.testing.assert_array_equal(body.E, np.full(len(CELLS), 10.0))


def check_joined(body, n_pieces):
    volume = np.sort(np.linalg.det(np.diff(body.points[body.tetrahedra], axis=1)))
    np.testing.assert_allclose(volume, np.sort(np.linalg.det(np.diff(POINTS[CELLS], axis=1))))
    assert len(body.points) == len(POINTS)
    assert f"has {n_pieces} pieces: they are joined at" in body.notes[0]


def test_pieces_are_joined(tmp_path):
    (tmp_path / "a.vtu").write_bytes(vtu([piece(ALL[::2]), piece(ALL[1::2])]))
    body = read_body(tmp_path / "a.vtu", "mm")
    check_joined(body, 2)
    by_group = ByGroup(materials={"piece 2": Tissue(3.0, None, None)})
    assert sorted(read_body(tmp_path / "a.vtu", "mm", None, by_group).E) == 9 * [3.0] + 9 * [10.0]


def test_pieces_are_joined_at_nodes_that_rounding_tells_apart(tmp_path):
    half = CELLS[:9], CELLS[9:]
    for number, cells in enumerate(half):
        used, local = np.unique(cells, return_inverse=True)
        name = f"{number}.vtu"
        mesh_of(POINTS[used] + 1e-8 * number, local.reshape(-1, 4), FIXED[used]).write(tmp_path / name)
    sources = '<Piece Source="0.vtu"/><Piece Source="1.vtu"/>'
    grid = f'<VTKFile type="PUnstructuredGrid"><PUnstructuredGrid>{sources}</PUnstructuredGrid></VTKFile>'
    (tmp_path / "a.pvtu").write_text(grid)
    body = read_body(tmp_path / "a.pvtu", "mm")
    assert len(body.points) == len(POINTS)
    assert volumes(body.points, body.tetrahedra).sum() == pytest.approx(300.0)


def test_a_set_beyond_the_file_and_a_body_without_a_free_node_are_told(tmp_path):
    (tmp_path / "a.inp").write_text(abaqus() + "\n*NSET, NSET=REST\n101, 98765\n")
    body = read_body(tmp_path / "a.inp", "mm", by_group=ByGroup(fixed=("FAT",), materials=FAT))
    assert 'The set "REST" names 1 nodes that the file does not have, such as 98765; they are left out.' in body.notes
    assert any(note.startswith("All nodes are fixed") for note in body.notes)


def test_pieces_in_files_of_their_own(tmp_path):
    """Of a cell that two pieces have, the copy is left out."""
    half, rest = ALL[:9], ALL[8:]
    ghost = np.zeros(len(rest))
    ghost[0] = 1
    own = piece(half, vtkGhostType=np.zeros(len(half)))
    (tmp_path / "a_0.vtu").write_bytes(vtu([own]))
    (tmp_path / "a_1.vtu").write_bytes(vtu([piece(rest, vtkGhostType=ghost)]))
    sources = "".join(f'<Piece Source="a_{k}.vtu"/>' for k in range(2))
    (tmp_path / "a.pvtu").write_text(
        f'<VTKFile type="PUnstructuredGrid"><PUnstructuredGrid>{sources}</PUnstructuredGrid></VTKFile>'
    )
    check_joined(read_body(tmp_path / "a.pvtu", "mm"), 2)
    (tmp_path / "a_1.vtu").unlink()
    with pytest.raises(InputError, match=r"a.pvtu cannot be read as a mesh: its piece a_1.vtu: .*no such file"):
        read_body(tmp_path / "a.pvtu", "mm")


def test_pieces_that_contradict_each_other_are_told(tmp_path):
    one, other = piece(ALL[::2]), piece(ALL[1::2])
    other[2]["fixed"] = np.zeros(len(other[0]))
    (tmp_path / "a.vtu").write_bytes(vtu([one, other]))
    assert "Point data `fixed` differ between pieces" in read_body(tmp_path / "a.vtu", "mm").notes[1]


# ---- groups


def numbered(rows, first=1):
    return "\n".join(f"{k} {' '.join(map(str, row))}" for k, row in enumerate(rows, first))


def gmsh_2(surface="CHEST", tags=None):
    """Return the bar as Gmsh writes it: groups by name, nodes with gaps in their numbers and in another order."""
    tags = 10 + 3 * np.arange(len(POINTS))[::-1] if tags is None else tags
    nodes = "\n".join(f"{t} {x} {y} {z}" for t, (x, y, z) in zip(tags, POINTS))
    cells = [(2, 2, 7, 1, *tags[f]) for f in CHEST] + [(4, 2, 2, 1, *tags[c]) for c in CELLS]
    return (
        f'$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 7 "{surface}"\n3 2 "FAT"\n$EndPhysicalNames\n'
        f"$Nodes\n{len(tags)}\n{nodes}\n$EndNodes\n$Elements\n{len(cells)}\n{numbered(cells)}\n$EndElements\n"
    )


def gmsh_4():
    """Return the bar in version 4.1, with groups of entities and the nodes in two blocks."""
    half = len(POINTS) // 2
    nodes = [range(half), range(half, len(POINTS))]
    blocks = "\n".join(
        f"3 1 0 {len(part)}\n"
        + "\n".join(str(k + 1) for k in part)
        + "\n"
        + "\n".join(" ".join(map(str, POINTS[k])) for k in part)
        for part in nodes
    )
    chest, solid = numbered(CHEST + 1), numbered(CELLS + 1, 1 + len(CHEST))
    n = len(CHEST) + len(CELLS)
    return (
        '$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n2 7 "CHEST"\n$EndPhysicalNames\n'
        "$Entities\n1 0 1 1\n9 0 0 0 0\n5 0 0 0 1 1 1 1 7 0\n6 0 0 0 1 1 1 2 2 3 1 -5\n$EndEntities\n"
        f"$Nodes\n2 {len(POINTS)} 1 {len(POINTS)}\n{blocks}\n$EndNodes\n"
        f"$Elements\n2 {n} 1 {n}\n2 5 2 {len(CHEST)}\n{chest}\n3 6 4 {len(CELLS)}\n{solid}\n$EndElements\n"
    )


def gmsh_4_binary():
    """Return the same as bytes."""

    def packed(*numbers):
        """Pack whole numbers with ``i`` as int, ``z`` as size, ``d`` as double: ("iz", 1, 2)."""
        return b"".join(struct.pack("<" + form.replace("z", "Q"), *values) for form, *values in numbers)

    entities = packed(("4z", 1, 0, 1, 1), ("i3dz", 9, 0, 0, 0, 0), ("i6dziz", 5, 0, 0, 0, 1, 1, 1, 1, 7, 0))
    entities += packed(("i6dz2iz2i", 6, 0, 0, 0, 1, 1, 1, 2, 2, 3, 2, -5, 4))
    n = len(CHEST) + len(CELLS)
    nodes = packed(("4z", 1, len(POINTS), 1, len(POINTS)), ("3iz", 3, 6, 0, len(POINTS)))
    nodes += np.arange(1, len(POINTS) + 1, dtype="<u8").tobytes() + POINTS.tobytes()
    elements = packed(("4z", 2, n, 1, n))
    for head, cells, first in (((2, 5, 2), CHEST, 1), ((3, 6, 4), CELLS, 1 + len(CHEST))):
        rows = np.column_stack([first + np.arange(len(cells)), cells + 1]).astype("<u8")
        elements += packed(("3iz", *head, len(cells))) + rows.tobytes()
    sections = {"Entities": entities, "Nodes": nodes, "Elements": elements}
    head = b'$MeshFormat\n4.1 1 8\n\1\0\0\0\n$EndMeshFormat\n$PhysicalNames\n1\n2 7 "CHEST"\n$EndPhysicalNames\n'
    return head + b"".join(f"${name}\n".encode() + body + f"\n$End{name}\n".encode() for name, body in sections.items())


def test_groups_of_binary_files_of_gmsh(tmp_path):
    blocks = {"gmsh:physical": [np.full(len(CHEST), 7), np.full(len(CELLS), 2)]}
    blocks["gmsh:geometrical"] = [np.ones(len(CHEST), int), np.ones(len(CELLS), int)]
    names = {"CHEST": np.array([7, 2]), "FAT": np.array([2, 3])}
    mesh = meshio.Mesh(POINTS, [("triangle", CHEST), ("tetra", CELLS)], cell_data=blocks, field_data=names)
    mesh.write(tmp_path / "2.msh", file_format="gmsh22", binary=True)
    (tmp_path / "4.msh").write_bytes(gmsh_4_binary())
    for name, fat in (("2.msh", "FAT"), ("4.msh", "volume 3")):
        body = read_body(tmp_path / name, "mm", None, ByGroup(fixed=("CHEST",), materials={fat: FAT["FAT"]}))
        np.testing.assert_array_equal(body.is_fixed, FIXED == 1)
        np.testing.assert_array_equal(body.points[body.tetrahedra], POINTS[CELLS])


def abaqus(kind="C3D4"):
    """Return the bar as Abaqus/CAE and Gmsh write it, with sets by number, by span and by name."""
    rows = [f"{k}, {x}, {y}, {z}" for k, (x, y, z) in enumerate(POINTS, 101)]
    cells = [f"{k},  {', '.join(map(str, cell + 101))}" for k, cell in enumerate(CELLS, 1)]
    fixed = np.flatnonzero(FIXED) + 101
    return "\n".join(
        [
            *("** a comment", "*Heading", "*Part, name=PART-1", "*NODE", *rows[:5], "*Node, nset=late", *rows[5:]),
            *(f"*Element, type={kind}, elset=left", *cells[:9], f"*ELEMENT, TYPE={kind},", "ELSET=right", *cells[9:]),
            *("*Elset, elset=FAT", "left, Right", "*Elset, elset=ONE, generate", "1, 9, 2"),
            *(
                "*Nset, nset=CHEST, instance=PART-1-1",
                ", ".join(map(str, fixed[:2])) + ",",
                ", ".join(map(str, fixed[2:])),
            ),
            *(
                "*NSET, NSET=AGAIN",
                "chest",
                "*NSET, NSET=NODES, ELSET=ONE",
                "*END PART",
                "*Material, name=fat",
                "*Elastic",
                "1., 0.3",
            ),
        ]
    )


@pytest.mark.parametrize(
    ("name", "text", "fat"),
    [
        ("a.msh", gmsh_2(), "FAT"),
        ("a.msh", gmsh_4(), "volume 3"),
        ("a.inp", abaqus(), "FAT"),
        ("deck.txt", abaqus(), "FAT"),
    ],
)
def test_groups_by_name(name, text, fat, tmp_path):
    (tmp_path / name).write_text(text)
    by_group = ByGroup(fixed=("CHEST",), materials={fat: FAT["FAT"]})
    body = read_body(tmp_path / name, "mm", None, by_group)
    np.testing.assert_array_equal(body.is_fixed, FIXED == 1)
    np.testing.assert_array_equal(body.points[body.tetrahedra], POINTS[CELLS])
    np.testing.assert_array_equal(body.E, np.full(len(CELLS), 10.0))
    np.testing.assert_allclose(body.density, np.full(len(CELLS), 1e-6))


def test_sets_of_abaqus(tmp_path):
    face = np.flatnonzero(np.isin(CELLS, CHEST[0]).sum(axis=1) == 3)[0]  # the tetrahedron with this face
    outside = int(np.flatnonzero(~np.isin(CELLS[face], CHEST[0]))[0])  # its corner that is not on the face
    side = {3: "S1", 2: "S2", 0: "S3", 1: "S4"}[outside]
    (tmp_path / "part.inp").write_text(abaqus("C3D4H"))
    (tmp_path / "a.inp").write_text(f"*INCLUDE, INPUT=part.inp\n*SURFACE, NAME=Skin\n{face + 1}, {side}\n")
    mesh = read_mesh(tmp_path / "a.inp")
    assert set(mesh.point_sets) == {"late", "CHEST", "AGAIN", "NODES", "Skin"}
    np.testing.assert_array_equal(mesh.point_sets["AGAIN"], np.flatnonzero(FIXED))
    np.testing.assert_array_equal(mesh.point_sets["late"], np.arange(5, len(POINTS)))
    np.testing.assert_array_equal(mesh.point_sets["Skin"], np.sort(CHEST[0]))
    np.testing.assert_array_equal(mesh.point_sets["NODES"], np.unique(CELLS[0:9:2]))
    np.testing.assert_array_equal(mesh.cell_sets["ONE"][0], np.arange(0, 9, 2))
    np.testing.assert_array_equal(mesh.cell_sets["right"][0], np.arange(9, 18))


def test_quadratic_tetrahedra_of_every_program(tmp_path):
    """Gmsh has the last two midside nodes in another order than VTK and Abaqus."""
    points, cells = with_middles(POINTS, CELLS)
    fixed = (points[:, 0] == 0.0).astype(float)
    rows = "\n".join(f"{k}, {x}, {y}, {z}" for k, (x, y, z) in enumerate(points, 1))
    deck = "\n".join(
        f"{k}, {', '.join(map(str, cell[:6] + 1))},\n{', '.join(map(str, cell[6:] + 1))}"
        for k, cell in enumerate(cells, 1)
    )
    chest = "\n".join(str(k + 1) for k in np.flatnonzero(fixed))
    (tmp_path / "a.inp").write_text(
        f"*NODE\n{rows}\n*ELEMENT, TYPE=C3D10M, ELSET=FAT\n{deck}\n*NSET, NSET=CHEST\n{chest}\n"
    )
    elements = numbered([(11, 2, 2, 1, *(cell[[0, 1, 2, 3, 4, 5, 6, 7, 9, 8]] + 1)) for cell in cells])
    (tmp_path / "a.msh").write_text(
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{len(points)}\n{numbered(points)}\n$EndNodes\n"
        f"$Elements\n{len(cells)}\n{elements}\n$EndElements\n"
    )
    mesh_of(points, cells, fixed).write(tmp_path / "a.vtu")
    bodies = [
        read_body(tmp_path / "a.vtu", "mm"),
        read_body(tmp_path / "a.inp", "mm", None, ByGroup(fixed=("CHEST",), materials=FAT)),
        read_body(tmp_path / "a.msh", "mm", None, ByGroup(fixed=("volume 2",), materials={"volume 2": FAT["FAT"]})),
    ]
    for body in bodies:
        np.testing.assert_array_equal(body.tetrahedra, cells)


def test_a_cell_in_two_groups_of_gmsh_is_one_cell(tmp_path):
    """Version 2 repeats an element for each of its groups."""
    tags = np.arange(1, len(POINTS) + 1)
    rows = [(4, 2, 2, 1, *tags[c]) for c in CELLS] + [(4, 2, 3, 1, *tags[c]) for c in CELLS[:5]]
    (tmp_path / "a.msh").write_text(
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{len(tags)}\n{numbered(POINTS)}\n$EndNodes\n"
        f"$Elements\n{len(rows)}\n{numbered(rows)}\n$EndElements\n"
    )
    mesh = read_mesh(tmp_path / "a.msh")
    np.testing.assert_array_equal(mesh.cells[0].data, CELLS)
    np.testing.assert_array_equal(mesh.cell_sets["volume 3"][0], np.arange(5))
    assert len(mesh.cell_sets["volume 2"][0]) == len(CELLS)


def test_data_of_gmsh_belong_to_the_numbers_beside_them(tmp_path):
    """Values in another order than the nodes, and elements of which only some have a value."""
    tags = np.arange(1, len(POINTS) + 1)
    shown = "\n".join(f"{k} {float(k)}" for k in tags[::-1])
    partly = "\n".join(f"{len(CHEST) + k + 1} {k}" for k in range(4))
    text = gmsh_2(tags=tags)
    text += f'$NodeData\n1\n"height"\n1\n0\n3\n0\n1\n{len(tags)}\n{shown}\n$EndNodeData\n'
    text += f'$ElementData\n1\n"stiff"\n1\n0\n3\n0\n1\n4\n{partly}\n$EndElementData\n'
    (tmp_path / "a.msh").write_text(text)
    mesh = read_mesh(tmp_path / "a.msh")
    np.testing.assert_array_equal(mesh.point_data["height"], tags)
    np.testing.assert_array_equal(mesh.cell_data["stiff"][1], [0, 1, 2, 3, *[np.nan] * 14])


@pytest.mark.parametrize(("number", "instead"), [("\n2, ", "\n2_0, "), (", 2", ", 2_0")])
def test_a_number_of_abaqus_has_no_underscore(number, instead, tmp_path):
    """Python reads "2_0" as 20; Abaqus does not."""
    (tmp_path / "a.inp").write_text(abaqus().replace(number, instead, 1))
    with pytest.raises(InputError, match='2_0" is not a number'):
        read_mesh(tmp_path / "a.inp")


def test_references_of_medit(tmp_path):
    mesh = meshio.Mesh(
        POINTS,
        [("triangle", CHEST), ("tetra", CELLS)],
        cell_data={"medit:ref": [np.full(len(CHEST), 4), np.full(len(CELLS), 2)]},
    )
    mesh.write(tmp_path / "a.mesh")
    by_group = ByGroup(fixed=("surface 4",), materials={"volume 2": FAT["FAT"]})
    np.testing.assert_array_equal(read_body(tmp_path / "a.mesh", "mm", None, by_group).is_fixed, FIXED == 1)


@pytest.mark.parametrize(
    ("by_group", "sentence"),
    [
        (
            ByGroup(),
            r'`fixed` .* are missing; name the group .*body.fixed = "NAME": the file has the groups "CHEST", "FAT"',
        ),
        (ByGroup(fixed=("chst",)), 'body.fixed names "chst", but the file has no such group; did you mean "CHEST"'),
        (
            ByGroup(fixed=("x",)),
            'body.fixed names "x", but the file has no such group; the file has the groups "CHEST", "FAT"',
        ),
        (
            ByGroup(fixed=("CHEST",)),
            r'`density_kg_m3` are missing: give density_kg_m3 of groups, .*groups without it: "FAT"',
        ),
        (ByGroup(fixed=("CHEST",), materials={"FAT": Tissue(1.0, None, 1e3)}), "`poisson_ratio` are missing: give nu"),
        (ByGroup(fixed=("CHEST",), materials={"CHEST": FAT["FAT"]}), '"CHEST", a group without tetrahedra; .*"FAT"'),
        (
            ByGroup(fixed=("CHEST",), pressurised=("INNER",), materials=FAT),
            "body.pressurised names .INNER., but the file has no such group",
        ),
        (ByGroup(fixed=("CHEST",), sliding=("FTA",), materials=FAT), 'body.sliding names "FTA", .*did you mean "FAT"'),
        (
            ByGroup(displacement={"FAT": (1.0, 0.0, 0.0), "CHEST": (0.0, 0.0, 0.0)}, materials=FAT),
            'body.displacement_mm: node 0 of "CHEST" is in another group, which moves otherwise',
        ),
    ],
)
def test_faults_of_groups_are_told(by_group, sentence, tmp_path):
    (tmp_path / "a.msh").write_text(gmsh_2())
    with pytest.raises(InputError, match=f"^a.msh: .*{sentence}"):
        read_body(tmp_path / "a.msh", "mm", None, by_group)


def test_groups_that_share_cells_are_refused(tmp_path):
    (tmp_path / "a.inp").write_text(abaqus())
    both = ByGroup(fixed=("CHEST",), materials=FAT | {"left": FAT["FAT"]})
    with pytest.raises(InputError, match='9 tetrahedra are in "FAT" and in "left"; each must be in one group'):
        read_body(tmp_path / "a.inp", "mm", None, both)


def test_groups_go_before_data(tmp_path):
    (tmp_path / "b.msh").write_text(gmsh_2() + node_data("fixed", 1.0 - FIXED))
    body = read_body(tmp_path / "b.msh", "mm", None, ByGroup(fixed=("CHEST",), materials=FAT))
    np.testing.assert_array_equal(body.is_fixed, FIXED == 1)
    assert "body.fixed is used instead of the point data `fixed`" in body.notes[0]


def node_data(name, values):
    tags = 10 + 3 * np.arange(len(POINTS))[::-1]
    rows = "\n".join(f"{tag} {value}" for tag, value in zip(tags, values))
    return f'$NodeData\n1\n"{name}"\n1\n0\n3\n0\n1\n{len(values)}\n{rows}\n$EndNodeData\n'


def test_faces_beside_a_group_are_told(tmp_path):
    """Two faces of a single tetrahedron are in the group; the two others have all their corners in it."""
    points = np.vstack([np.zeros(3), np.eye(3)])
    cells = np.array([[0, 1, 2, 3]])
    tags = np.arange(1, 5)
    faces = boundary(cells)
    rows = [(2, 2, 7, 1, *tags[f]) for f in faces[:2]] + [(4, 2, 2, 1, *tags[cells[0]])]
    (tmp_path / "a.msh").write_text(
        f'$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n2 7 "SKIN"\n$EndPhysicalNames\n$Nodes\n4\n{numbered(points)}\n'
        f"$EndNodes\n$Elements\n3\n{numbered(rows)}\n$EndElements\n"
    )
    tissue = {"volume 2": FAT["FAT"]}
    body = read_body(tmp_path / "a.msh", "mm", None, ByGroup(("SKIN",), pressurised=("SKIN",), materials=tissue))
    assert (
        body.notes[0]
        == "2 boundary faces outside the groups of body.pressurised have all corners in them and count too."
    )
    assert body.notes[1].startswith("All nodes are fixed")
    (tmp_path / "b.msh").write_text(gmsh_2())
    by_group = ByGroup(fixed=("CHEST",), pressurised=("CHEST",), materials=FAT)
    assert read_body(tmp_path / "b.msh", "mm", None, by_group).notes == ()


def test_a_wound_by_group(tmp_path):
    (tmp_path / "a.inp").write_text(abaqus())
    solid, is_wound = read_wound(tmp_path / "a.inp", "mm", ByGroup(fixed=("CHEST",), wound=("left",)))
    np.testing.assert_array_equal(is_wound, np.arange(18) < 9)
    np.testing.assert_array_equal(solid.is_fixed, FIXED == 1)
    with pytest.raises(InputError, match=r'`wound` are missing; name the group of the wound.*"left", "right"'):
        read_wound(tmp_path / "a.inp", "mm", ByGroup(fixed=("CHEST",)))


# ---- supports of quadratic meshes, places far away, doubts


def test_middles_between_fixed_corners_are_fixed(tmp_path):
    points, cells = with_middles(POINTS, CELLS)
    fixed = (points[:, 0] == 0.0).astype(float)
    corners = np.where(np.arange(len(points)) < len(POINTS), fixed, 0.0)
    moved = np.where(corners[:, None] == 1, points @ np.array([[0.0, 0, 0], [0.2, 0, 0], [0, 0, 0.1]]), 0.0)
    mesh = mesh_of(points, cells, corners)
    mesh.point_data["prescribed_displacement"] = moved
    mesh.write(tmp_path / "a.vtu")
    body = read_body(tmp_path / "a.vtu", "mm")
    np.testing.assert_array_equal(body.is_fixed, fixed == 1)
    held = fixed == 1
    expected = (points @ np.array([[0.0, 0, 0], [0.2, 0, 0], [0, 0, 0.1]]))[held]
    np.testing.assert_allclose(body.displacement[held], expected)
    assert body.notes == ("5 midside nodes on the surface lie between two fixed corners and are fixed too.",)
    mesh.point_data["fixed"] = fixed
    mesh.write(tmp_path / "a.vtu")
    body = read_body(tmp_path / "a.vtu", "mm")
    np.testing.assert_allclose(body.displacement[held], expected)
    assert body.notes == ("5 fixed midside nodes without a displacement move with the corners beside them.",)


def test_a_mesh_far_away():
    np.testing.assert_array_equal(far_origin(POINTS), np.zeros(3))
    np.testing.assert_array_equal(far_origin(POINTS + np.array([0.0, 110.0, 0.0])), np.zeros(3))
    np.testing.assert_array_equal(far_origin(POINTS + np.array([1e6, 0.0, 0.0])), [1e6 + 6.0, 2.0, 2.0])


def test_coarse_coordinates_are_told(tmp_path):
    mesh_of((POINTS + np.array([0.0, 5.2e6, 0.0])).astype(np.float32)).write(tmp_path / "a.vtu")
    assert (
        "single precision: this far from the origin they are rounded to 0.5 mm"
        in read_body(tmp_path / "a.vtu", "mm").notes[0]
    )
    mesh_of(POINTS.astype(np.float32)).write(tmp_path / "a.vtu")
    assert read_body(tmp_path / "a.vtu", "mm").notes == ()


@pytest.mark.parametrize(
    ("tissue", "scale", "doubt"),
    [
        ({}, 1.0, ""),
        ({"density_kg_m3": 500.0, "youngs_modulus_kPa": 0.05}, 1.0, ""),
        ({"youngs_modulus_kPa": np.where(ALL == 3, 1e5, 5.0)}, 1.0, ""),
        ({"density_kg_m3": 1.0}, 1.0, r"The density is 1 kg/m\^3 in 18 tetrahedra; .*: is it in g/cm\^3"),
        ({"density_kg_m3": 1e-6}, 1.0, r"is it in kg/mm\^3"),
        ({"density_kg_m3": 1e-9}, 1.0, r"is it in t/mm\^3"),
        ({"density_kg_m3": np.where(ALL == 3, 3000.0, 1e3)}, 1.0, r"3000 kg/m\^3 in 1 tetrahedra; .*is it in kg/m\^3"),
        ({"youngs_modulus_kPa": 1e4}, 1.0, "Young's modulus is 10000 kPa in 18 tetrahedra; .*: is it in Pa"),
        ({"youngs_modulus_kPa": 0.01}, 1.0, "is it in MPa"),
        ({"youngs_modulus_kPa": np.where(ALL == 3, 2e5, 5.0)}, 1.0, "2e.05 kPa in 1 tetrahedra"),
        ({"poisson_ratio": 0.4999}, 1.0, "Poisson's ratio is 0.4999 in 18 tetrahedra: above 0.499"),
        ({"poisson_ratio": 0.499}, 1.0, ""),
        ({}, 0.1, "The mesh is 1.2 mm across: is body.mesh_unit right"),
    ],
)
def test_unlikely_numbers_are_doubted(tissue, scale, doubt, tmp_path):
    mesh_of(scale * POINTS, **tissue).write(tmp_path / "a.vtu")
    doubts = doubts_of(read_body(tmp_path / "a.vtu", "mm"))
    assert len(doubts) == bool(doubt)
    assert re.search(doubt, "".join(doubts))


# ---- what cannot be read


def hexahedra():
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=3)))[[0, 4, 6, 2, 1, 5, 7, 3]] + 20.0
    points = np.vstack([POINTS, corners])
    return meshio.Mesh(points, [("tetra", CELLS), ("hexahedron", len(POINTS) + np.arange(8)[None])])


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        (
            "a.feb",
            b'<?xml version="1.0"?><febio_spec version="4.0"/>',
            "it is a file of FEBio, which is not read; export",
        ),
        ("a.vtu", b"", "it is empty"),
        ("a.vtu.gz", b"\x1f\x8b\x08\x00", "it is compressed by gzip; unpack it first"),
        ("a.vtu", b"this is no mesh", "its XML is damaged"),
        ("a.vtu", b'<VTKFile type="PolyData"><PolyData/></VTKFile>', "it holds PolyData; .* is an UnstructuredGrid"),
        ("a.vtu", b'<VTKFile type="UnstructuredGrid"><UnstructuredGrid/></VTKFile>', "the grid has no <Piece>"),
        ("a.vtu", vtu([piece(ALL)])[:2500], "is damaged: it ends after"),
        ("a.xyz", b"1 2 3", "its content is no format that is known; read are VTU"),
        ("a.msh", gmsh_2().replace("$EndNodes", "").encode(), r"its section \$Nodes has no end"),
        (
            "a.msh",
            gmsh_2().replace("\n1 2 2 7 1 ", "\n1 99 2 7 1 ").encode(),
            "elements of Gmsh's type 99 are not read",
        ),
        ("a.msh", gmsh_2().replace("\n10 12.0 5", "\n10 ten 5").encode(), "its content is damaged, could not convert"),
        ("a.inp", b"*NODE\n1, 0, 0, 0\n", r"it has no \*ELEMENT"),
        ("a.inp", b"*NODE\n1, 0, 0, 0\n*NGEN\n1, 5\n", r"\*NGEN at a.inp:3 is not read; write out every node"),
        ("a.inp", b"*NODE\n1, 0, 0, zero\n", r"\*NODE at a.inp:1 is damaged"),
        ("a.inp", abaqus("CONN3D2").encode(), "elements of type CONN3D2 at a.inp:.* are not read; use C3D4 or C3D10"),
        ("a.inp", abaqus().replace(" 103,", " 999,").encode(), "names node 999, which it does not have"),
        ("a.inp", (abaqus() + "\n" + abaqus()).encode(), "it has several parts, the second at a.inp:"),
        ("a.vtk", b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET CUBE\n", "a.vtk cannot be read as a mesh"),
    ],
)
def test_what_is_no_mesh_is_told(name, content, sentence, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=sentence) as error:
        read_body(tmp_path / name, "mm")
    assert str(error.value).startswith(name)
    assert "\n" not in str(error.value)


def test_surfaces_and_other_cells_are_told(tmp_path):
    meshio.Mesh(POINTS, [("triangle", OUTER)]).write(tmp_path / "a.stl")
    with pytest.raises(
        InputError, match="the file has triangle: it is a surface without a volume: fill it with tetrahedra"
    ):
        read_body(tmp_path / "a.stl", "mm")
    hexahedra().write(tmp_path / "a.vtu")
    with pytest.raises(
        InputError, match=r"has hexahedron, tetra: divide those of type hexahedron \(1\) into tetrahedra"
    ):
        read_body(tmp_path / "a.vtu", "mm")


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (np.repeat(FIXED[:, None], 3, axis=1), "must be one number for each node, 0 or 1; got 3 for each"),
        (255 * FIXED, "must be 0 or 1; got 255 at node 0"),
        (np.where(FIXED > 0.0, 1.0, np.nan), "have no value at 12 nodes, the first is node 4: give each node 0 or 1"),
    ],
)
def test_marks_that_are_no_marks_are_told(values, sentence, tmp_path):
    mesh_of(fixed=values).write(tmp_path / "a.vtu")
    with pytest.raises(InputError, match=sentence):
        read_body(tmp_path / "a.vtu", "mm")


@pytest.mark.parametrize(("name", "package"), [("a.med", "h5py"), ("a.xdmf", "h5py"), ("a.e", "netCDF4")])
def test_a_missing_package_is_named(name, package, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    text = '<Xdmf Version="3.0"><Domain><Grid><Topology TopologyType="Tetrahedron"><DataItem Format="HDF">a.h5:/x</DataItem>'
    (tmp_path / name).write_text(
        text + "</Topology></Grid></Domain></Xdmf>" if name == "a.xdmf" else "\x89HDF", "latin-1"
    )
    with pytest.raises(
        InputError, match=rf"files that end in \{name[1:]} need the package {package}: pip install {package}"
    ):
        read_body(tmp_path / name, "mm")


def test_coordinates_without_end_are_told(tmp_path):
    mesh_of(POINTS * 1e300).write(tmp_path / "a.vtu")
    with pytest.raises(InputError, match=r"coordinate of .* mm: is the unit right"):
        read_body(tmp_path / "a.vtu", "mm")


def test_a_small_file_does_not_unpack_to_gigabytes(tmp_path):
    """A compressed array says that it has 2 GB; one tetrahedron has no such number."""
    huge = base64.b64encode(struct.pack("<4I", 1, 2**31, 2**31, 99)) + base64.b64encode(zlib.compress(bytes(10**6)))
    (tmp_path / "a.vtu").write_text(
        '<VTKFile type="UnstructuredGrid" compressor="vtkZLibDataCompressor"><UnstructuredGrid>'
        '<Piece NumberOfPoints="4" NumberOfCells="1"><Cells><DataArray type="Int64" Name="connectivity" format="binary">'
        f"{huge.decode()}</DataArray></Cells></Piece></UnstructuredGrid></VTKFile>"
    )
    with pytest.raises(
        InputError, match="`connectivity` is damaged: it unpacks to more than the 216 bytes that it can have"
    ):
        read_mesh(tmp_path / "a.vtu")


def files(tmp_path):
    """Write the bar in several formats; return the content of each by name."""
    mesh_of().write(tmp_path / "a.vtu", compression="zlib")
    mesh_of().write(tmp_path / "b.vtk")
    mesh_of().write(tmp_path / "c.msh", file_format="gmsh", binary=True)
    mesh_of().write(tmp_path / "d.msh", file_format="gmsh22", binary=True)
    (tmp_path / "e.msh").write_text(gmsh_2() + node_data("fixed", FIXED))
    (tmp_path / "f.msh").write_text(gmsh_4())
    (tmp_path / "g.inp").write_text(abaqus())
    (tmp_path / "h.vtu").write_bytes(vtu([piece(ALL[::2]), piece(ALL[1::2])], "base64"))
    return {path.name: path.read_bytes() for path in sorted(tmp_path.iterdir())}


def damage(content, rng):
    """Return the content shortened, with other bytes, without a part, with a part many times, or with other numbers."""
    data, (low, high) = bytearray(content), sorted(rng.integers(len(content), size=2))
    how = rng.integers(5)
    if how == 0:
        return bytes(data[:low])
    if how == 1:
        data[low] = rng.integers(256)
        return bytes(data)
    if how == 2:
        return bytes(data[:low] + data[high:])
    if how == 3:
        return bytes(data[:low] + data[low : low + 50] * int(rng.integers(2, 30)) + data[low + 50 :])
    digits = [k for k, byte in enumerate(data[:4000]) if chr(byte).isdigit()]
    place = int(rng.choice(digits))
    data[place : place + 1] = [b"-9", b"99999999", b"0", b"nan", b"1e300", b"x"][rng.integers(6)]
    return bytes(data)


def sentence_of(path, by_group):
    """Return why a mesh is refused; an empty text if it is read."""
    try:
        read_body(path, "mm", None, by_group)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("seed", [0, pytest.param(range(1, 40), marks=pytest.mark.slow)])
def test_a_damaged_file_is_read_or_refused(seed, tmp_path):
    """Nothing but a sentence comes out of a file that was damaged at random."""
    contents = files(tmp_path)
    by_group = ByGroup(fixed=("CHEST",), materials=FAT)
    for number in np.atleast_1d(seed):
        rng = np.random.default_rng(int(number))
        for name, content in contents.items():
            for _ in range(6):
                (tmp_path / name).write_bytes(damage(content, rng))
                said = sentence_of(tmp_path / name, by_group if name[0] in "efg" else None)
                assert said.startswith(name) or not said

"""Every kind of bad input, written as a real file: each gives one sentence that names the key."""

import os
import random
import re
from pathlib import Path

import pytest

from cicatrix.cases.reading import apply_overrides, case_table, input_files
from cicatrix.core.errors import InputError
from cicatrix.kinds.lumpectomy.case import LumpectomyCase
from cicatrix.kinds.registry import check_case, load_case

# The example of the interface page, unchanged.
INTERFACE_EXAMPLE = """\
kind = "lumpectomy"
dimension = 2                        # 2 (plane strain slice) or 3
[image]
path = "breast.nii.gz"               # NIfTI, NRRD, MHA, or a DICOM folder; or phantom = "half-ellipsoid"
weighting = "t1"                     # "t1" (fat bright) or "t1-fatsat"
position = "prone"                   # how she lay: prone | supine | upright
side = "left"                        # left | right
slice_mm = 12.0                      # dimension 2: axial position; left out = through the resection
labels = "labels.nii.gz"             # optional: skip segmentation, use these (0 air 1 fat 2 gland 3 skin 4 tumour)
[tissue.fat]                         # also tissue.gland, tissue.skin; defaults documented with their sources
E_kPa = 3.25
nu = 0.495
density_kg_m3 = 930.0
[resection]
centre_mm = [42.0, -80.0, 12.0]      # image coordinates (LPS); left out = the tumour label's centroid
radius_mm = 12.0
margin_mm = 5.0
[healing]
model = "automaton"                  # or "fields"
deposition = "unloaded"              # or "loaded": new tissue is stress-free where it is laid down
contraction_kPa = 0.0                # scar contraction
pitch_um = 10.0                      # automaton; a coarser pitch keeps the front's speed in mm/day
hours_per_step = 15.0                # at 10 um
p_edge = 0.2                         # p_edge, p_layer, layer_um: defaults calibrated to the clinic's closure times
p_layer = 0.1
layer_um = 400.0
feedback = 1.0                       # F(W) = feedback * W / W_ref, W_ref = mean over the fresh wound edge
[coupling]
mode = "two-way"                     # or "one-way" (F = 0)
days_per_cycle = 7.0                 # one mechanical solve per so many days of healing
healing_position = "upright"
[outcome]
positions = ["upright", "supine"]
visits_weeks = [2, 6, 10, 26]
[run]
seed = 1
max_weeks = 52
"""
PHANTOM = 'kind = "lumpectomy"\n[image]\nphantom = "half-ellipsoid"\n'

KINDS = '"lumpectomy", "automaton", "equilibrium", "material-point", "adhesion", "signalling", "tissue-cell" or "wound"'


@pytest.fixture
def write(tmp_path):
    def _write(text: str) -> Path:
        path = tmp_path / "case.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return _write


def test_interface_example_loads(write, tmp_path):
    for name in ("breast.nii.gz", "labels.nii.gz"):
        (tmp_path / name).touch()
    case = load_case(write(INTERFACE_EXAMPLE))
    assert case.image.path == (tmp_path / "breast.nii.gz").resolve()
    assert case.resection.centre_mm == (42.0, -80.0, 12.0)
    assert case.outcome.visits_weeks == (2.0, 6.0, 10.0, 26.0)
    assert set(input_files(case)) == {"image.path", "image.labels"}
    assert case_table(case)["image"]["path"] == "NIfTI image"  # no names of files or folders in a manifest


def test_case_is_frozen_and_comparable(write):
    first, second = load_case(write(PHANTOM)), load_case(write(PHANTOM))
    assert first == second
    assert isinstance(first, LumpectomyCase)
    with pytest.raises(AttributeError, match="does not change"):
        first.run.seed = 3  # pyright: ignore


FAULTS = {
    "nu at one half": ("[tissue.fat]\nnu = 0.5", "tissue.fat.nu must be at least 0 and below 0.5; got 0.5"),
    "negative nu": ("[tissue.skin]\nnu = -0.1", "tissue.skin.nu must be at least 0 and below 0.5; got -0.1"),
    "negative stiffness": ("[tissue.gland]\nE_kPa = -1.0", "tissue.gland.E_kPa must be above 0; got -1.0"),
    "infinite stiffness": ("[tissue.scar]\nE_kPa = inf", "tissue.scar.E_kPa must be a finite number; got inf"),
    "negative stiffening": (
        "[tissue.fat]\nstiffening = -1.0",
        "tissue.fat.stiffening must be at least 0; got -1.0",
    ),
    "no prestretch": (
        "[tissue.skin]\nprestretch = 0.0",
        "tissue.skin.prestretch must be above 0; got 0.0",
    ),
    "skin that locks before it is stretched": (
        "[tissue.skin]\nlocking_stretch = 0.9",
        "tissue.skin.locking_stretch must be at least 1 and at most 10; got 0.9",
    ),
    "negative steepness": (
        "[tissue.skin]\nsteepness = -8.0",
        "tissue.skin.steepness must be at least 0.01 and at most 200; got -8.0",
    ),
    "negative stiffness of locked skin": (
        "[tissue.skin]\nstiff_kPa = -1.0",
        "tissue.skin.stiff_kPa must be at least 0; got -1.0",
    ),
    "negative distance of skin from skin": (
        "[skin_contact]\ndistance_mm = -0.5",
        "skin_contact.distance_mm must be at least 0; got -0.5",
    ),
    "contact without stiffness": (
        "[skin_contact]\nstiffness_kPa = 0.0",
        "skin_contact.stiffness_kPa must be above 0; got 0.0",
    ),
    "too many ligaments": (
        "[tissue.ligaments]\nshare = 0.05",
        "tissue.ligaments.share must be at most 0.02; got 0.05",
    ),
    "ligaments that are never slack": (
        "[tissue.ligaments]\nslack_stretch = 0.5",
        "tissue.ligaments.slack_stretch must be at least 1 and at most 10; got 0.5",
    ),
    "negative bulk modulus": (
        "[tissue]\nleast_bulk_modulus_kPa = -1.0",
        "tissue.least_bulk_modulus_kPa must be at least 0; got -1.0",
    ),
    "radius zero": ("[resection]\nradius_mm = 0", "resection.radius_mm must be above 0; got 0"),
    "negative margin": ("[resection]\nmargin_mm = -1", "resection.margin_mm must be at least 0; got -1"),
    "flat centre": ("[resection]\ncentre_mm = [1, 2]", "resection.centre_mm must be a list of 3 numbers; got [1, 2]"),
    "unknown mode": ('[coupling]\nmode = "both"', 'coupling.mode must be "one-way" or "two-way"; got "both"'),
    "no days": ("[coupling]\ndays_per_cycle = 0.0", "coupling.days_per_cycle must be above 0; got 0.0"),
    "cycle below a step": (
        "[coupling]\ndays_per_cycle = 0.5",
        "coupling.days_per_cycle must hold at least one automaton step (0.625 days at this pitch); got 0.5",
    ),
    "nan": ("[healing]\npitch_um = nan", "healing.pitch_um must be above 0; got nan"),
    "probability": ("[healing]\np_edge = 1.5", "healing.p_edge must be at least 0 and at most 1; got 1.5"),
    "thin layer": ("[healing]\nlayer_um = 5.0", "healing.layer_um must be at least pitch_um (10); got 5"),
    "a rate of the automaton": (
        '[healing]\nmodel = "fields"\np_edge = 0.1',
        'healing.p_edge belongs to healing.model = "automaton"; leave it out',
    ),
    "a rate of fields": (
        "[healing]\ntime_tolerance = 1e-3",
        'healing.time_tolerance belongs to healing.model = "fields"; leave it out',
    ),
    "a negative diffusivity": (
        '[healing]\nmodel = "fields"\nparameters = { D_rho_mm2_per_h = -1.0 }',
        "healing.parameters.D_rho_mm2_per_h must be at least 0; got -1.0",
    ),
    "fibres too dispersed": (
        '[healing]\nmodel = "fields"\nparameters = { kappa = 0.4 }',
        "healing.parameters.kappa must be at most 0.333333 in 3 dimensions",
    ),
    "an unknown sense": (
        '[healing]\nmodel = "fields"\nmechanosensing = { type = "smell" }',
        'healing.mechanosensing.type must be "none", "logistic", "moreo", "adhesion" or "network"; got "smell"',
    ),
    "visits": ("[outcome]\nvisits_weeks = [6, 2]", "outcome.visits_weeks must ascend; got [6, 2]"),
    "position": (
        '[outcome]\npositions = ["flat"]',
        'outcome.positions[0] must be "prone", "supine", "supine-arms-up", "upright" or "lateral"; got "flat"',
    ),
    "text for number": ('[run]\nmax_weeks = "long"', 'run.max_weeks must be a number; got "long"'),
    "fraction for count": ("[run]\nseed = 1.5", "run.seed must be a whole number; got 1.5"),
    "truth for number": ("[tissue.fat]\nE_kPa = true", "tissue.fat.E_kPa must be a number; got true"),
    "number for table": ("tissue = 3", "tissue must be a table; got 3"),
    "number for list": ("[outcome]\npositions = 3", "outcome.positions must be a list; got 3"),
    "near key": ("[healing]\npitch_mm = 1", "healing.pitch_mm is not a known key; did you mean healing.pitch_um?"),
    "wrong case": ("[tissue.fat]\ne_kpa = 1", "tissue.fat.e_kpa is not a known key; did you mean tissue.fat.E_kPa?"),
    "wrong table": (
        "[healing]\nradius_mm = 1",
        "healing.radius_mm is not a known key; did you mean resection.radius_mm?",
    ),
    "strange key": ("[run]\nxyz = 1", "run.xyz is not a known key; known in [run]: seed, max_weeks"),
    "mesh": (
        "[mesh]\ncavity_edge_mm = 9.0",
        "mesh.cavity_edge_mm must be at most edge_mm (3); got 9",
    ),
    "no position": (
        "[outcome]\npositions = []",
        'outcome.positions must name at least one of "prone", "supine", "supine-arms-up", "upright", "lateral"',
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_one_fault_one_sentence(name, write):
    lines, sentence = FAULTS[name]
    head, rest = ('kind = "lumpectomy"\n' + lines + "\n", "") if not lines.startswith("[") else (PHANTOM, lines)
    image = "" if lines.startswith("[") else '[image]\nphantom = "half-ellipsoid"\n'
    assert check_case(write(head + image + rest)) == [sentence]


SOLID = 'kind = "lumpectomy"\ndimension = 3\n[image]\nphantom = "half-ellipsoid"\n'
SOLID_FAULTS = {
    "plane": ('plane = "axial"\n', "image.plane belongs to dimension = 2, where a section is cut; leave it out"),
    "slice": ("slice_mm = 1\n", "image.slice_mm belongs to dimension = 2, where a section is cut; leave it out"),
    "mesh": ("[mesh]\ncavity_edge_mm = 9.0\n", "mesh.cavity_edge_mm must be at most edge_mm (5); got 9"),
    "pitch": (
        # by hand: 278 pitches across, of which the sheared block takes 1.225 x 1.563 x 1.986 x 278^3 = 8.2e7, and its rims
        "[healing]\npitch_um = 100\n",
        "healing.pitch_um puts 8.3e+07 sites over the cavity, and 3e+07 fit into memory: take at least 150; got 100",
    ),
    "pitch of a hair's thousandth": (
        # more than a lattice can number; the box around the cavity alone, 24 mm and a margin, is 2.67e4 pitches wide
        "[healing]\npitch_um = 1\n",
        "healing.pitch_um puts 1.9e+13 sites over the cavity, and 3e+07 fit into memory: take at least 90; got 1",
    ),
}


def test_a_lattice_of_a_section_fits_into_memory(write):
    """Pitches of 1 um across a cavity of 24 mm are at least 2.4e4^2 = 5.8e8 sites."""
    section = 'kind = "lumpectomy"\n[image]\nphantom = "half-ellipsoid"\n[healing]\n'
    (fault,) = check_case(write(section + "pitch_um = 1\n"))
    assert fault.startswith("healing.pitch_um puts ")
    assert fault.endswith(" sites over the cavity, and 2e+08 fit into memory: take at least 5; got 1")
    assert check_case(write(section + "pitch_um = 1e-300\n")) == ["healing.pitch_um must be at least 0.1; got 1e-300"]
    assert check_case(write(section + "pitch_um = 5\n")) == []


@pytest.mark.parametrize("name", SOLID_FAULTS)
def test_one_fault_of_a_solid_one_sentence(name, write):
    lines, sentence = SOLID_FAULTS[name]
    pitch = "" if "pitch" in lines else "[healing]\npitch_um = 200\n"
    assert check_case(write(SOLID + lines + pitch)) == [sentence]


def test_an_image_is_no_mirror_image(write):
    words = "must be the directions of x, y and z, one each of L or R, A or P, S or I, without mirroring"
    assert check_case(write(PHANTOM + 'axes = "LPI"')) == [f'image.axes {words}; got "LPI"']
    assert check_case(write(PHANTOM + 'axes = "RIA"')) == []


def test_a_solid_has_coarser_elements_by_default(write):
    case = load_case(write(SOLID + "[healing]\npitch_um = 200\n[mesh]\nedge_mm = 6\n"))
    assert (case.mesh.edge_mm, case.mesh.cavity_edge_mm) == (6, 2)
    assert load_case(write(PHANTOM)).mesh.edge_mm == 3


def test_a_trunk_has_no_negative_margin_and_sizes_belong_to_the_phantom(write):
    assert check_case(write(PHANTOM + "[trunk]\nmedial_mm = -1.0"))[0].startswith("trunk.medial_mm must be at least 0")
    wide = PHANTOM.rstrip() + "\nphantom_size_mm = [120.0, 300.0, 110.0]\n"
    assert check_case(write(wide))[0].startswith("image.phantom_size_mm[1] must be at least 30 and at most 250")
    stray = 'kind = "lumpectomy"\n[image]\nlabels = "x.nrrd"\nphantom_size_mm = [120.0, 75.0, 110.0]\n'
    assert check_case(write(stray))[0].startswith("image.phantom_size_mm belongs to image.phantom")


def test_chest_wall_is_a_plane_or_points(write):
    wall = PHANTOM + "[image.chest_wall]\n"
    assert check_case(write(wall + "point_mm = [0, 0, 0]\nnormal = [0, -1, 0]")) == []
    assert check_case(write(wall + "points_mm = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]]")) == []
    assert "at least 4 points" in check_case(write(wall + "points_mm = [[0, 0, 0], [1, 0, 0]]"))[0]
    assert "belong together" in check_case(write(wall + "point_mm = [0, 0, 0]"))[0]
    assert "not be zero" in check_case(write(wall + "point_mm = [0, 0, 0]\nnormal = [0, 0, 0]"))[0]
    assert check_case(write(wall + "points_mm = [[0, 0], [1, 0]]"))[0].startswith("image.chest_wall.points_mm[0] must")


POINT = 'kind = "material-point"\n[[law]]\ntype = "{law}"\nmu_kPa = 1.0\n[law.growth]\ntau_h = 1.0\n'


def test_a_law_that_cannot_grow_is_told_the_table_that_does(write):
    loading = "[loading]\ntime_h = [0, 1]\nx = [1, 1.1]\n"
    words = "law[0].growth: neo-hookean takes no growth; use [growth]"
    assert check_case(write(POINT.format(law="neo-hookean") + loading)) == [words]


def test_image_has_one_origin(write, tmp_path):
    (tmp_path / "a.nii").touch()
    both = check_case(write(PHANTOM + 'path = "a.nii"'))
    assert both == ["image.phantom and path exclude each other: give one of the two"]
    assert "image.path is missing" in check_case(write('kind = "lumpectomy"\n[image]\nside = "left"'))[0]
    assert check_case(write('kind = "lumpectomy"')) == ["image is missing"]


def test_every_fault_is_reported(write):
    text = PHANTOM + "[tissue.fat]\nnu = 0.5\nE_kPa = -1.0\n[run]\nsed = 1\n[healing]\np_edge = 2.0\n"
    assert len(check_case(write(text))) == 4
    with pytest.raises(InputError, match=r"tissue\.fat\.E_kPa .*\(and 3 more: cicatrix check "):
        load_case(write(text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("kind = = 1\nx = 1", "is not valid TOML: .*line 1, column 8"),
        ("[a.b]\n[a.b]", r"is not valid TOML: Cannot declare \[a\.b\] twice \(at line 2"),
        ("\u00a0kind = 1", r"; it has a space that only looks like one, U\+00A0: type it anew"),
        (
            "",
            f"kind is missing; a case file starts with kind = {KINDS}",
        ),
        (
            'kind = "mastectomy"',
            f'kind must be {KINDS}; got "mastectomy"',
        ),
        ("kind = 3", f"kind must be {KINDS}; got 3"),
    ],
)
def test_no_case_at_all(text, words, write):
    with pytest.raises(InputError, match=words):
        load_case(write(text))


def test_unreadable_case_files(tmp_path):
    assert check_case(tmp_path / "none.toml") == ["there is no such file"]
    assert check_case(tmp_path) == ["is a folder; a file is needed"]
    (tmp_path / "binary.toml").write_bytes(b"\x1f\x8b\xff")
    assert "not a text file" in check_case(tmp_path / "binary.toml")[0]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-32"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_case_in_any_unicode_and_with_any_line_ends(encoding, end, tmp_path):
    path = tmp_path / "case.toml"
    path.write_bytes((PHANTOM + "[run] # \N{MICRO SIGN}\nseed = 5\n").replace("\n", end).encode(encoding))
    assert load_case(path).run.seed == 5


STRANGE = {
    "Latin-1": ("# \xe9".encode("latin-1"), "is not a text file in UTF-8 (line 1, byte 2): save it as UTF-8"),
    "a NUL": (b'kind = "a\0"', "is not a text file: line 1 has the control character U+0000"),
    "deep lists": (b"x = " + 3000 * b"[", "is not a case: tables or lists nest too deep"),
    "deep tables": (b"x = " + 3000 * b"{a = " + b"1", "is not a case: tables or lists nest too deep"),
    "deep keys": (b".".join(3000 * [b"a"]) + b" = 1", "a.a.a...: tables and lists may nest 50 deep at most"),
    "a deep list that TOML reads": (b"x = " + 60 * b"[" + 60 * b"]", "x[0][0]...: tables and lists may nest 50 deep"),
    "400 digits": (b"[run]\nseed = " + 400 * b"9", "run.seed must be between -2^63 and 2^63 - 1"),
    "400 digits for a real": (b"[tissue.fat]\nE_kPa = " + 400 * b"9", "tissue.fat.E_kPa must be between -2^63"),
    "400 digits in a list": (b"a = [1, " + 400 * b"9" + b"]", "a[1] must be between"),
    "5000 digits": (b"[run]\nseed = " + 5000 * b"9", "is not valid TOML: a whole number has more than 64 bits"),
    "a backslash": (b'p = "C:\\Users"', "a backslash starts an escape: write '...', or / in a path"),
    "a decimal comma": (b"x = 12,5", "a number has a decimal point, not a comma"),
    "Python's truth": (b"x = True", "truth values are true and false"),
    "curly quotes": ("x = \u201cleft\u201d".encode(), "quotes must be straight"),
}


@pytest.mark.parametrize("name", STRANGE)
def test_a_strange_file_is_a_sentence(name, tmp_path):
    data, words = STRANGE[name]
    (tmp_path / "case.toml").write_bytes(data)
    (fault,) = check_case(tmp_path / "case.toml")
    assert words in fault


def test_a_case_is_a_regular_file(tmp_path):
    for path in (Path("/dev/zero"), tmp_path / "pipe"):
        if path.name == "pipe":
            os.mkfifo(path)
        assert check_case(path) == ["is a device, a pipe or a socket; a file is needed"]


PATHS = {
    "a" * 5000: "image.path cannot be used: .*: the path has [0-9]+ characters; at most 4096 can be opened",
    "a" * 300: "image.path cannot be used: .*cannot be read: File name too long",
    "~nosuchuser/a.nii": "image.path names ~nosuchuser/a.nii, but there is no such user: name the folder in place of ~",
    "/dev/zero": "image.path cannot be used: /dev/zero is a device, a pipe or a socket",
    "data\\\\breast.nii": "image.path names .*, but there is no such file or folder; folders are separated by /",
    "data\\breast.nii": r"image.path names 'data.x08reast.nii', with the control character U\+0008; .* write '...', or /",
    "a\\u0000b": r"image.path names 'a.x00b', with the control character U\+0000",
}


@pytest.mark.parametrize("path", PATHS, ids=range(len(PATHS)))
def test_a_strange_path_is_a_sentence(path, write):
    (fault,) = check_case(write(f'kind = "lumpectomy"\n[image]\npath = "{path}"\n'))
    assert re.match(PATHS[path], fault)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("run.seed=" + 400 * "9", "run.seed must be between -2^63"),
        ("run.seed=" + 5000 * "9", "a whole number has more than 64 bits"),
        ("run.seed=" + 3000 * "[", "tables or lists nest too deep"),
        (".".join(3000 * ["a"]) + "=1", "may nest 50 deep at most"),
    ],
)
def test_a_strange_setting_is_a_sentence(setting, words, write):
    (fault,) = check_case(write(PHANTOM), [setting])
    assert words in fault


def test_whatever_the_bytes_a_case_is_read_or_refused(tmp_path):
    """Seeded mutations of a good case, and settings made of the same: faults in sentences, and no other end."""
    draw, path = random.Random(1), tmp_path / "case.toml"
    (tmp_path / "breast.nii.gz").touch()
    (tmp_path / "labels.nii.gz").touch()
    good, n_sound = INTERFACE_EXAMPLE.encode(), 0
    spice = [
        b"\x00",
        b"\xff",
        b"\xef\xbb\xbf",
        b"[" * 60,
        b"9" * 400,
        b"1e400",
        b"nan",
        b"{a=",
        b"\\u0000",
        b"~x/",
        b".",
        b"=",
    ]
    spice += [
        b"[[",
        b'"',
        b"'" * 3,
        b"true",
        b"-",
        b"\n[law]\n",
        b"\r",
        b"\x1b[31m",
        b"/dev/zero",
        b"#",
        b"[]",
        b"a." * 70,
    ]
    for _ in range(300):
        data = bytearray(good)
        for _ in range(draw.randint(1, 3)):
            at = draw.randrange(len(data))
            data[at : at + draw.randint(0, 4)] = draw.choice(spice)
        path.write_bytes(data)
        part = data[at - 20 : at + 20].decode(errors="replace")
        for settings in ([], [f"{draw.choice(['run.seed', 'image', 'tissue.fat'])}={part}"], [part]):
            words = ""
            try:
                load_case(path, settings)
            except InputError as error:
                words = str(error) or "nothing is said"
            n_sound += not words
            assert words != "nothing is said"
            assert len(words) < 100_000
    assert n_sound > 10


def test_missing_image_is_a_fault_beside_others(write, tmp_path):
    faults = check_case(write('kind = "lumpectomy"\n[image]\npath = "no.nii"\n[run]\nseed = -1\n'))
    assert len(faults) == 2
    assert faults[1] == f"image.path names {tmp_path / 'no.nii'}, but there is no such file or folder"


@pytest.mark.parametrize("path", ["", "data:", " "])
def test_empty_path_is_not_the_folder_of_the_case(path, write):
    faults = check_case(write(f'kind = "lumpectomy"\n[image]\npath = "{path}"\n'))
    assert faults == ["image.path must name a file or folder; got an empty text"]


def test_data_prefix(write, tmp_path, monkeypatch):
    text = 'kind = "lumpectomy"\n[image]\npath = "data:a.nii.gz"\n'
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "a.nii.gz").touch()
    monkeypatch.setenv("CICATRIX_DATA", str(tmp_path / "images"))
    assert load_case(write(text)).image.path == (tmp_path / "images" / "a.nii.gz").resolve()
    monkeypatch.setenv("CICATRIX_DATA", str(tmp_path / "nowhere"))
    assert "which is not a folder" in check_case(write(text))[0]


def test_an_endless_name_of_the_data_folder_is_a_sentence(write, monkeypatch):
    monkeypatch.setenv("CICATRIX_DATA", "a" * 5000)
    (fault,) = check_case(write('kind = "lumpectomy"\n[image]\npath = "data:a.nii.gz"\n'))
    assert "which is not a folder" in fault


def test_data_beside_the_project(tmp_path, monkeypatch):
    monkeypatch.delenv("CICATRIX_DATA", raising=False)
    project, data = tmp_path / "project", tmp_path / "shared" / "data"
    (project / "examples").mkdir(parents=True)
    data.mkdir(parents=True)
    (project / "pyproject.toml").touch()
    (data / "a.nii.gz").touch()
    path = project / "examples" / "case.toml"
    path.write_text('kind = "lumpectomy"\n[image]\npath = "data:a.nii.gz"\n')
    assert load_case(path).image.path == data / "a.nii.gz"


def test_overrides(write):
    settings = ["run.seed=7", "coupling.mode=one-way", "resection.centre_mm=[1.0, 2.0, 3.0]", "run.seed=8"]
    case = load_case(write(PHANTOM), settings)
    assert (case.run.seed, case.coupling.mode, case.resection.centre_mm) == (8, "one-way", (1.0, 2.0, 3.0))
    raw = {"run": {"seed": 1}}
    assert apply_overrides(raw, ["run.seed=2"]) == {"run": {"seed": 2}}
    assert raw == {"run": {"seed": 1}}


@pytest.mark.parametrize("setting", ["run.seed", "=3", "run..seed=3", "run.seed.x=3"])
def test_bad_overrides(setting, write):
    with pytest.raises(InputError, match="--set"):
        load_case(write(PHANTOM + "[run]\nseed = 1\n"), [setting])


def test_override_with_unknown_key_and_injected_table(write):
    assert check_case(write(PHANTOM), ["run.sead=3"]) == ["run.sead is not a known key; did you mean run.seed?"]
    assert len(check_case(write(PHANTOM), ["run.seed=3\nkind = 4"])) == 1


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root reads everything")
def test_forbidden_file(write):
    path = write(PHANTOM)
    path.chmod(0)
    assert "cannot be read" in check_case(path)[0]

"""Cases of kind "automaton": to closure, stopped and resumed, and what is refused."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

import cicatrix
from cicatrix.cli.main import main
from cicatrix.core import native
from cicatrix.core.errors import InputError
from cicatrix.geometry.hexgrid import Lattice
from cicatrix.healing.automaton import NativeCore
from cicatrix.healing.reference import ReferenceCore
from cicatrix.kinds.automaton import run as automaton_run
from cicatrix.kinds.automaton.build import automaton_of
from cicatrix.kinds.automaton.case import LatticeTable
from cicatrix.kinds.registry import check_case, load_case
from cicatrix.runs import driver

DISC = """
kind = "automaton"
[lattice]
size = [120, 150]
[wound]
shape = "disc"
radius_um = 300.0
"""
BALL = """
kind = "automaton"
[lattice]
type = "fcc"
size = [40, 40, 40]
[wound]
shape = "ball"
radius_um = 90.0
"""


@pytest.mark.parametrize("name", ["automaton-disc", "automaton-ball"])
def test_the_examples_close(name):
    path = Path(__file__).parents[2] / "examples" / f"{name}.toml"
    assert cicatrix.simulate(load_case(path)).history["n_open"][-1] == 0


@pytest.mark.parametrize("text", [DISC, BALL])
def test_a_wound_closes_and_every_step_is_told(text, case_file, tmp_path):
    results = cicatrix.simulate(load_case(case_file(text)), tmp_path / "run")
    history, outcome = results.history, results.outcome
    assert list(history) == ["step", "n_cells", "n_open", "closed_fraction", "n_edge_divisions", "n_layer_divisions"]
    np.testing.assert_array_equal(history["step"], np.arange(len(history["step"])))
    np.testing.assert_array_equal(
        np.diff(history["n_cells"]), (history["n_edge_divisions"] + history["n_layer_divisions"])[1:]
    )
    assert history["n_open"][-1] == 0
    assert history["n_open"][-2] > 0
    assert outcome["steps_to_closure"].value == history["step"][-1]
    full = np.packbits(np.ones(outcome["n_sites"].value, bool)).tobytes()
    assert outcome["occupancy_sha256"].value == hashlib.sha256(full).hexdigest()
    assert (tmp_path / "run" / "figures" / "closure.png").stat().st_size > 10_000


def test_the_hash_is_that_of_the_bits_in_c_order(case_file):
    """Interrupt half-way, resume, and compute the same occupancy with the Python API."""
    case = load_case(case_file(DISC), ["run.max_steps=25"])
    automaton = automaton_of(case)
    state = automaton.advance(automaton.initial_state(), n_steps=25)
    results = cicatrix.simulate(case)
    expected = hashlib.sha256(np.packbits(state.occupancy.ravel()).tobytes()).hexdigest()
    assert results.outcome["occupancy_sha256"].value == expected
    assert results.outcome["steps_to_closure"].value is None
    assert "still open after 25 steps" in results.status[1]


@pytest.mark.parametrize("where", ["in the step", "in its state", "before the driver has it"])
def test_an_interruption_between_a_step_and_its_row_loses_nothing(where, case_file, tmp_path, monkeypatch):
    """A signal may arrive at any place between a step and its row; the resumed run is the uninterrupted one."""
    case = load_case(case_file(DISC), ["run.max_steps=40"])
    straight = cicatrix.simulate(case, tmp_path / "straight")
    core = NativeCore if native.is_native else ReferenceCore
    holder, name = {
        "in the step": (core, "advance"),
        "in its state": (automaton_run.AutomatonRun, "_after"),
        "before the driver has it": (driver._Writer, "take"),
    }[where]
    original, calls = getattr(holder, name), []

    def interrupted(*arguments):
        calls.append(1)
        if len(calls) == 25 and where != "in the step":
            raise KeyboardInterrupt
        result = original(*arguments)
        if len(calls) == 25:
            raise KeyboardInterrupt
        return result

    with monkeypatch.context() as patch:
        patch.setattr(holder, name, interrupted)
        with pytest.raises(KeyboardInterrupt):
            cicatrix.simulate(case, tmp_path / "stopped")
    resumed = cicatrix.simulate(case, tmp_path / "stopped", resume=True)
    assert any("Resumed after cycle 25" in note for note in resumed.manifest["notes"])
    assert (tmp_path / "stopped" / "history.csv").read_bytes() == (tmp_path / "straight" / "history.csv").read_bytes()
    assert resumed.outcome["occupancy_sha256"] == straight.outcome["occupancy_sha256"]


def test_masks_and_energies_from_files(case_file, tmp_path):
    lattice = Lattice((30, 40), 0.01, (0.0, 0.0))
    open0 = np.zeros(lattice.shape, bool)
    open0[10:20, 12:30] = True
    fillable = np.ones(lattice.shape, np.uint8)
    fillable[:, 35:] = 0
    for name, array in (("open", open0), ("fillable", fillable), ("W", np.full(lattice.shape, 2.0))):
        np.save(tmp_path / f"{name}.npy", array)
    text = """
kind = "automaton"
[lattice]
size = [30, 40]
fillable = "fillable.npy"
[wound]
mask = "open.npy"
[rules]
feedback = 1.0
[cue]
W = "W.npy"
"""
    path = case_file(text)
    by_file = cicatrix.simulate(load_case(path))
    by_number = cicatrix.simulate(load_case(path, ["cue.W=2.0"]))
    assert by_file.outcome["occupancy_sha256"] == by_number.outcome["occupancy_sha256"]
    assert by_file.history["n_open"][0] == 180
    assert {"wound.mask", "lattice.fillable", "cue.W"} <= set(by_file.manifest["inputs"])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("lattice.size=[0, 10]", "lattice.size[0] must be at least 1"),
        ("lattice.size=[-5, 10]", "lattice.size[0] must be at least 1"),
        ("lattice.size=[64, 64, 64]", "lattice.size must be 2 numbers"),
        ("lattice.type=bcc", 'lattice.type must be "hex" or "fcc"'),
        ("lattice.pitch_um=0", "lattice.pitch_um must be at least 0.001"),
        ("wound.shape=ball", 'wound.shape must be "disc"'),
        ("wound.radius_um=-3", "wound.radius_um must be above 0"),
        ("rules.p_edge=1.2", "rules.p_edge must be at least 0 and at most 1"),
        ("rules.p_layer=nan", "rules.p_layer must be"),
        ("rules.contact_inhibition=13", "rules.contact_inhibition must be at least 1 and at most 12"),
        ("rules.contact_inhibition=9", "rules.contact_inhibition must be at most 6"),
        ("rules.contact_inhibition=0", "rules.contact_inhibition must be at least 1"),
        ("cue.W=nan", "cue.W must be a finite number or the name of a .npy file; got nan"),
        ("lattice.pitch_um=1e-300", "lattice.pitch_um must be at least 0.001"),
        ("cue.W=energies.npy", "cue.W"),
        ("rules.p_edges=0.1", "did you mean rules.p_edge"),
    ],
)
def test_faults_of_a_case_are_told(change, sentence, case_file):
    (fault,) = check_case(case_file(DISC), [change])
    assert sentence in fault


def test_faults_of_arrays_are_told(case_file, tmp_path):
    shape = (120, 150)
    bad = {
        "nan": np.full(shape, np.nan),
        "wrong_shape": np.zeros((3, 3)),
        "open": np.ones(shape, bool),
        "closed": np.zeros(shape, bool),
    }
    for name, array in bad.items():
        np.save(tmp_path / f"{name}.npy", array)
    (tmp_path / "text.npy").write_text("no array")
    masked = DISC.replace('shape = "disc"\nradius_um = 300.0', 'mask = "MASK.npy"')
    for name, sentence in (
        ("open", "leaves no cell"),
        ("closed", "has no site"),
        ("wrong_shape", "must be a mask"),
        ("text", "not a NumPy file"),
    ):
        with pytest.raises(InputError, match=sentence):
            cicatrix.simulate(load_case(case_file(masked.replace("MASK", name))), tmp_path / name)
        assert not (tmp_path / name).exists()
    for name, sentence in (("nan", "finite"), ("wrong_shape", "lattice's shape")):
        with pytest.raises(InputError, match=sentence):
            cicatrix.simulate(load_case(case_file(DISC), [f"cue.W={name}.npy"]))


def test_a_wound_larger_than_the_lattice_is_refused(case_file, tmp_path, capsys):
    path = case_file(DISC)
    assert main(["run", str(path), "--set", "wound.radius_um=9000", "--out", str(tmp_path / "run")]) == 2
    told = capsys.readouterr().err
    assert "larger than the lattice" in told
    assert not (tmp_path / "run").exists()


def test_a_single_row_holds_no_disc(case_file):
    with pytest.raises(InputError, match="single row"):
        cicatrix.simulate(load_case(case_file(DISC), ["lattice.size=[1, 9]"]))


def test_a_lattice_beyond_memory_is_told(case_file, tmp_path, monkeypatch):
    def refuse(*_):
        raise MemoryError

    monkeypatch.setattr(Lattice, "near_middle", refuse)
    with pytest.raises(InputError, match=r"lattice\.size .* memory"):
        cicatrix.simulate(load_case(case_file(DISC)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_the_largest_disc_just_fits():
    """Against the distance of opposite sides of the block, from the inverse of its basis."""
    for kind, size in (("hex", (80, 60)), ("fcc", (30, 20, 25))):
        lattice = Lattice(size, 0.01, (0.0,) * len(size))
        heights = 1.0 / np.linalg.norm(np.linalg.inv(lattice.basis_mm), axis=0)
        largest = 1e3 * np.min((np.array(size) - 1) * heights) / 2
        assert LatticeTable(type=kind, size=size).inradius_um == pytest.approx(largest)

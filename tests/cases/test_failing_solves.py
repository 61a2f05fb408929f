"""Lumpectomies whose equilibrium solves fail: what is left out, what takes its place, and what is said."""

import json

import numpy as np
import pytest
from coarse_lumpectomy import LUMPECTOMY, write_labels
from shared_inputs import FAULTS

import cicatrix
from cicatrix.cases.paths import data_folder
from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.failure import NoEquilibriumError

pytestmark = pytest.mark.xdist_group("failing solves")  # compiled once


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("failing")
    write_labels(folder)
    (folder / "case.toml").write_text(LUMPECTOMY.replace("[3, 40]", "[3]"))
    return cicatrix.load_case(folder / "case.toml")


def failing(monkeypatch, fails):
    """Make ``Equilibrium.loaded`` find nothing where ``fails(body, gravity)``."""
    solve = Equilibrium.loaded

    def loaded(self, body, X, gravity, *args, **kwargs):
        if fails(body, gravity):
            raise NoEquilibriumError("It buckles.", "", [], X, 0.0)
        return solve(self, body, X, gravity, *args, **kwargs)

    monkeypatch.setattr(Equilibrium, "loaded", loaded)


def notes_of(folder):
    return json.loads((folder / "manifest.json").read_text())["notes"]


def test_a_reported_position_that_fails_is_left_out_and_all_else_is_kept(case, monkeypatch, tmp_path):
    """It heals upright; while the cavity is open it has no equilibrium supine: those shapes alone are missing."""
    failing(monkeypatch, lambda body, gravity: gravity[1] > 0 and (body.fraction == 0.0).any())
    results = cicatrix.simulate(case, out=tmp_path / "run")
    left_out = [note for note in notes_of(tmp_path / "run") if note.startswith("Left out")]
    assert left_out[0].startswith("Left out: Fresh, supine: It buckles. Give stiffer tissue ([tissue])")
    assert "supine.fresh.volume_change_percent" not in results.outcome
    assert {"upright.fresh.volume_change_percent", "supine.healed.volume_change_percent"} <= set(results.outcome)
    assert (tmp_path / "run" / "figures" / "outline.png").is_file()


def test_a_position_without_a_shape_before_surgery_is_left_out_wholly(case, monkeypatch, tmp_path):
    failing(monkeypatch, lambda body, gravity: gravity[1] > 0)
    results = cicatrix.simulate(case, out=tmp_path / "run")
    assert any(note.startswith("Left out: Before surgery, supine: It buckles.") for note in notes_of(tmp_path / "run"))
    assert not [name for name in results.outcome if name.startswith("supine")]
    assert results.outcome["volume_change_percent"].note.startswith("upright, healed")


def test_if_no_position_that_is_asked_for_has_a_shape_the_healing_one_is_reported(case, monkeypatch, tmp_path):
    failing(monkeypatch, lambda body, gravity: gravity[1] > 0)
    asked = case.outcome.model_copy(update={"positions": ("supine",)})
    results = cicatrix.simulate(case.model_copy(update={"outcome": asked}), out=tmp_path / "run")
    assert results.outcome["volume_change_percent"].note.startswith("upright, healed")
    assert "upright.healed.volume_change_percent" in results.outcome
    assert any(note.startswith("Left out: Before surgery, supine") for note in notes_of(tmp_path / "run"))


def test_the_healing_position_must_have_an_equilibrium(case, monkeypatch, tmp_path):
    failing(monkeypatch, lambda body, gravity: gravity[1] == 0.0)
    with pytest.raises(ConvergenceError, match=r"Before surgery, upright: It buckles\. Give stiffer tissue"):
        cicatrix.simulate(case, out=tmp_path / "run")


def test_an_empty_cavity_that_collapses_is_filled_with_clot(case, monkeypatch, tmp_path):
    """With clot of 0.01 kPa, the wound closes as an empty one does; a run that is stopped goes on to the same bytes."""
    empty = cicatrix.simulate(case, out=tmp_path / "empty")
    failing(monkeypatch, lambda body, gravity: (body.fraction == 0.0).any())
    full = cicatrix.simulate(case, out=tmp_path / "full")
    assert any("filled with clot and wound fluid of shear modulus 0.01 kPa" in n for n in notes_of(tmp_path / "full"))
    days = [run.outcome["time_to_closure_days"].value for run in (empty, full)]
    assert days[1] == pytest.approx(days[0], rel=0.1)
    drift = [run.outcome["upright.fresh.volume_change_percent"].value for run in (empty, full)]
    assert drift[1] == pytest.approx(drift[0], abs=0.05)

    states = []
    first = cicatrix.build(case)
    for state in first.march(first.start()):
        states.append(state)
        if len(states) == 2:
            break
    second = cicatrix.build(case)
    second.start()
    resumed = second.unpack(*first.pack(states[-1]))
    assert resumed.has_clot
    one, other = (next(iter(run.march(state))) for run, state in ((first, states[-1]), (second, resumed)))
    np.testing.assert_array_equal(one.tissue.x, other.tissue.x)


def test_a_resection_that_keeps_the_skin_says_how_much_is_left(case):
    def notes(centre_mm):
        resection = case.resection.model_copy(update={"centre_mm": centre_mm})
        return cicatrix.build(case.model_copy(update={"resection": resection})).notes

    assert not [note for note in notes((70.0, -38.0, 8.4)) if "not removed" in note]
    (note,) = [note for note in notes((70.0, -64.0, 8.4)) if "not removed" in note]
    assert note.endswith(
        "of the resection is not removed: it lies outside the breast, or within 3 mm of the skin or the chest wall"
    )
    assert int(note.split(" %")[0]) >= 5


RUNS = FAULTS / "runs"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["phantom-20mm-supine", "phantom-sagittal-lower-16mm", "a13-20mm-supine", "a13-medial-lower"]
)
def test_operations_of_clinical_size_come_through(name, tmp_path):
    if not RUNS.is_dir():
        pytest.skip(f"{RUNS} is absent")
    if name.startswith("a13"):
        try:
            data_folder()
        except InputError as error:
            pytest.skip(str(error))
    case = cicatrix.load_case(RUNS / f"{name}.toml")
    results = cicatrix.simulate(case, out=tmp_path / "run")
    assert results.history["closed_fraction"][-1] == 1.0
    home = case.coupling.healing_position
    assert np.isfinite(results.outcome[f"{home}.healed.surface_retraction_max_mm"].value)
    if name.startswith("a13"):
        assert any("of the resection is not removed" in note for note in notes_of(tmp_path / "run"))

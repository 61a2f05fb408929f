"""Running and reading runs from Python: what simulate takes, what results hold, and how they look."""

import copy
import gc
import json
import pickle
from contextlib import suppress
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import cicatrix
from cicatrix import InputError, Quantity, Results, open_run, simulate
from cicatrix.runs.fields import FieldSeries
from cicatrix.runs.kind import Fields
from cicatrix.runs.results import RunFolder

TABLES = {"kind": "automaton", "lattice": {"size": [64, 64]}, "wound": {"radius_um": 120.0}}
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Results of a small run in a folder of its own."""
    return simulate(TABLES, tmp_path_factory.mktemp("runs") / "kept")


@pytest.fixture
def drawn(tmp_path):
    """Folder of an unfinished run with fields of two parts at three times, and shapes."""
    run = RunFolder.open(tmp_path / "drawn", {"kind": "made up"}, seed=1)
    with suppress(KeyboardInterrupt), run:
        for cycle in range(3):
            run.record({"cycle": cycle, "time_days": 0.5 * cycle})
            for part in ("body", "wound"):
                displaced = {"displacement": np.full((3, 2), 0.25 * cycle)}
                cell = {"W_kPa": np.array([1.0 + cycle])}
                run.write_fields(Fields(part, cycle, 0.5 * cycle, CORNERS, np.array([[0, 1, 2]]), displaced, cell))
        run.write_fields(Fields("upright", 2, 1.0, CORNERS + 1.0, np.array([[0, 1, 2]]), folder="shapes"))
        raise KeyboardInterrupt
    return tmp_path / "drawn"


def test_a_case_a_path_and_tables_are_the_same_run(kept, tmp_path, monkeypatch):
    (tmp_path / "case.toml").write_text('kind = "automaton"\n[lattice]\nsize = [64, 64]\n[wound]\nradius_um = 120.0\n')
    monkeypatch.chdir(tmp_path)
    for case in (cicatrix.case_from(TABLES), "case.toml", tmp_path / "case.toml"):
        assert simulate(case).outcome["occupancy_sha256"] == kept.outcome["occupancy_sha256"]
    assert [path.name for path in tmp_path.iterdir()] == ["case.toml"]
    with pytest.raises(TypeError, match="nested tables are needed; got int"):
        simulate(3)  # pyright: ignore
    with pytest.raises(InputError, match="there is no such file"):
        simulate("other.toml")


def test_paths_in_tables_start_from_the_working_folder(tmp_path, monkeypatch):
    np.save(tmp_path / "W.npy", np.zeros((64, 64)))
    with pytest.raises(InputError, match=r"cue\.W names W\.npy, but there is no such file"):
        simulate({**TABLES, "cue": {"W": "W.npy"}})
    monkeypatch.chdir(tmp_path)
    results = simulate({**TABLES, "cue": {"W": "W.npy"}})
    assert results.manifest["inputs"]["cue.W"]["name"] == "NumPy array"


def test_a_run_reads_back_as_it_was(kept):
    again = open_run(kept.folder)
    assert isinstance(again, Results)
    assert again.status == kept.status == ("finished", kept.status[1])
    assert again.kind == "automaton"
    assert again.outcome == kept.outcome
    assert isinstance(again.outcome["n_sites"], Quantity)
    for name, column in kept.history.items():
        np.testing.assert_array_equal(again.history[name], column)
    assert not again.is_temporary


def test_an_unfinished_run_is_read(drawn):
    run = open_run(drawn)
    assert run.status[0] == "interrupted"
    assert run.outcome == {}
    assert run.history["cycle"].tolist() == [0, 1, 2]
    assert len(run.fields) == 6


def test_what_is_no_run_is_a_sentence(tmp_path, drawn):
    with pytest.raises(InputError, match=r"nowhere holds no run: there is no such folder$"):
        open_run(tmp_path / "nowhere")
    (tmp_path / "thesis").mkdir()
    with pytest.raises(InputError, match=r"thesis holds no run: it has no manifest.json$"):
        open_run(tmp_path / "thesis")
    (drawn / "outcome.json").write_text('{"x": 3}')
    with pytest.raises(InputError, match=r"outcome\.json is damaged: it cannot be read as the outcome of a run$"):
        open_run(drawn)
    (drawn / "outcome.json").unlink()
    (drawn / "history.csv").write_text("cycle,time_days\n0\n")
    with pytest.raises(InputError, match=r"history\.csv is damaged: it cannot be read as the history of a run$"):
        open_run(drawn)
    (drawn / "manifest.json").write_text(json.dumps([]))
    with pytest.raises(InputError, match="not the manifest of a run"):
        open_run(drawn)


def test_the_files_of_a_run_without_a_folder_stay_as_long_as_its_results():
    results = simulate(TABLES)
    folder = results.folder
    assert results.is_temporary
    assert (folder / "figures").is_dir()
    fields, copied, deep, other = (
        results.fields,
        copy.copy(results),
        copy.deepcopy(results),
        replace(results, history={}),
    )
    for thing in (results, copied, deep, other):
        assert thing.folder == folder
    del results, copied, deep, other, thing
    gc.collect()
    assert folder.is_dir()  # held by the fields
    del fields
    gc.collect()
    assert not folder.exists()


def test_results_cross_to_another_process_without_their_folder():
    results = simulate(TABLES)
    there = pickle.loads(pickle.dumps(results))
    assert there.outcome == results.outcome
    assert not there.is_temporary
    del there
    gc.collect()
    assert results.folder.is_dir()


def test_fields_are_arrays_with_their_mesh(drawn):
    fields = open_run(drawn).fields
    assert fields.parts == ("body", "wound")
    body = fields.part("body")
    assert body.times_days.tolist() == [0.0, 0.5, 1.0]
    assert [step.number for step in body[1:]] == [1, 2]
    last = body[-1]
    assert (last.part, last.number, last.time_days) == ("body", 2, 1.0)
    np.testing.assert_array_equal(last.points, np.column_stack([CORNERS, np.zeros(3)]))
    np.testing.assert_array_equal(last.cells, [[0, 1, 2]])
    np.testing.assert_array_equal(last.point_data["displacement"], [[0.5, 0.5, 0.0]] * 3)
    np.testing.assert_array_equal(last.cell_data["W_kPa"], [3.0])
    assert repr(fields) == "<6 steps of body, wound, 0 to 1 days>"
    with pytest.raises(InputError, match="muscle is not a part of these fields; they have body, wound"):
        fields.part("muscle")
    with pytest.raises(IndexError):
        fields[6]


def test_shapes_and_no_fields(drawn, kept):
    (shape,) = open_run(drawn).shapes
    assert shape.part == "upright"
    np.testing.assert_array_equal(shape.points[:, :2], CORNERS + 1.0)
    assert shape.point_data == {}
    assert list(kept.fields) == list(kept.shapes) == []
    assert repr(kept.fields) == "<no fields>"
    assert list(replace(kept, folder=None).fields) == []


def test_a_file_that_is_gone_is_a_sentence(drawn):
    step = open_run(drawn).fields[0]
    step.path.unlink()
    with pytest.raises(InputError, match=r"body-0000\.vtu is gone: give simulate a folder"):
        _ = step.points


def test_pyvista(drawn):
    pyvista = pytest.importorskip("pyvista")
    grid = open_run(drawn).fields[-1].to_pyvista()
    assert isinstance(grid, pyvista.UnstructuredGrid)
    assert (grid.n_points, grid.n_cells) == (3, 1)
    assert grid.area == pytest.approx(0.5)
    np.testing.assert_array_equal(grid.point_data["displacement"], [[0.5, 0.5, 0.0]] * 3)


def test_pandas(kept):
    pandas = pytest.importorskip("pandas")
    history, outcome = kept.to_pandas(), kept.to_pandas("outcome")
    assert isinstance(history, pandas.DataFrame)
    assert list(history.columns) == list(kept.history)
    assert history["n_open"].iloc[-1] == 0
    assert outcome.loc["n_sites", "value"] == 64 * 64
    assert outcome.loc["n_sites", "unit"] == "1"


def test_a_missing_package_is_a_sentence(kept, drawn, monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    optional = import_module("cicatrix.core.optional")
    monkeypatch.setattr(optional, "import_module", missing)
    with pytest.raises(InputError, match=r"^to_pandas needs pandas: pip install pandas$"):
        kept.to_pandas()
    with pytest.raises(InputError, match=r"^to_pyvista needs pyvista: pip install pyvista$"):
        open_run(drawn).fields[0].to_pyvista()
    with pytest.raises(InputError, match='there are the tables "history" and "outcome"'):
        kept.to_pandas("notes")  # pyright: ignore


def test_results_fit_a_screen(kept):
    lines = repr(kept).splitlines()
    assert lines[0] == "Results of a run of kind automaton: finished"
    assert lines[1] == kept.status[1]
    assert lines[-1].endswith("kept") or lines[-1].endswith("...")
    assert any(line.startswith("  n_sites ") and line.endswith(" 4096") for line in lines)
    assert "(removed with this object)" in repr(simulate(TABLES))


def test_long_results_fit_a_screen_too():
    numbers = {
        f"{where}number_{n}": Quantity(1.0 / 3.0, "mm", "of words " * 40) for where in ("", "at.") for n in range(20)
    }
    columns = {f"a_long_name_{n}_kPa": np.zeros(3) for n in range(40)}
    status = {"state": "failed", "sentence": "Nothing was found, and nobody knows why. " * 20}
    results = Results(columns, numbers, {"status": status, "case": {"kind": "<b>"}}, None)
    lines = repr(results).splitlines()
    assert len(lines) <= 15
    assert max(map(len, lines)) <= 100
    assert "  and 32 more in .outcome" in lines
    html = results._repr_html_()
    assert "&lt;b&gt;" in html
    assert "<b><b>" not in html
    assert html.count("<tr>") == 8


def test_a_simulation_says_how_it_is_stepped():
    assert (
        repr(cicatrix.build(TABLES)) == "<simulation of kind automaton: for state in s.march(s.start()): s.rows(state)>"
    )


def test_an_empty_series_is_a_sequence(tmp_path):
    empty = FieldSeries.of(tmp_path)
    assert len(empty) == 0
    assert empty.times_days.shape == (0,)

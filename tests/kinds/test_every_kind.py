"""What holds for every kind of case: stopped and resumed to the byte, failures, notes, the manifest, a run without a folder.

A new kind needs an entry in :data:`CASES`, its smallest case with something in every product.
"""

import re
from pathlib import Path

import numpy as np
import pytest
import skfem
from coarse_lumpectomy import LUMPECTOMY, write_labels

import cicatrix
from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.core.ranks import Ranks
from cicatrix.files.vtu import write_vtu
from cicatrix.geometry.tetrahedra import oriented
from cicatrix.kinds.registry import KINDS, simulation_type
from cicatrix.runs import driver
from cicatrix.runs.kind import Simulation
from cicatrix.runs.progress import Progress
from cicatrix.runs.results import open_run
from cicatrix.runs.resuming import flaw_of

EXAMPLES = Path(__file__).parents[2] / "examples"
PAGES = Path(__file__).parents[2] / "docs" / "kinds"
BODY = """
kind = "equilibrium"
[body]
mesh = "body.vtu"
[loads]
gravity_m_s2 = [0.0, 0.0, -9.81]
"""
CASES = {  # text of the case, or an example with settings; moments after which it is stopped, counted in states of the march
    "automaton": (
        '\nkind = "automaton"\n[lattice]\nsize = [96, 96]\n[wound]\nshape = "disc"\nradius_um = 200.0\n',
        (1, 12),
    ),
    "material-point": (
        """
kind = "material-point"
[[law]]
type = "neo-hookean"
mu_kPa = 1.0
[[law]]
type = "fibre-distribution"
mu_f_kPa = 1.0
orientation = { type = "single" }
viscous = { beta = 1.0, relaxation_s = 600.0 }
[loading]
control = "stretch"
plane = "incompressible"
time_h = [0.0, 0.5, 1.0]
x = [1.0, 1.2, 1.2]
steps_per_segment = 5
[solver]
relative_tolerance = 1e-3
""",
        (1, 7),
    ),
    "adhesion": (
        """
kind = "adhesion"
[bond]
k_on_per_s = 0.01
k_off_per_s = 0.012
[substrate]
type = "linear"
stiffness_pN_um = 2e4
stretch = [1.0, 1.1]
[cell]
force_pN = 7.0
[method]
type = "monte-carlo"
n_integrins = 200
n_cells = 4
dt_s = 0.5
duration_s = 100.0
n_rows = 10
""",
        (1, 6),
    ),
    "signalling": (
        """
kind = "signalling"
[network]
species = "species.csv"
reactions = "reactions.csv"
[set]
A = { time_h = [1.0, 2.3], value = [0.8, 0.4] }
[time]
duration_h = 6.0
step_h = 0.5
[steady]
starts = 3
""",
        (1, 2),
    ),
    "tissue-cell": (
        (EXAMPLES / "tissue-cell.toml", ["loading.time_h=[0.0, 24.0, 200.0]", "loading.n_rows=40"]),
        (1, 3),
    ),
    "wound": (
        (
            EXAMPLES / "wound.toml",
            ["elements=8", "duration_h=60.0", "fields_every_h=30.0", "solver.time_tolerance=1e-3"],
        ),
        (1, 14),
    ),
    "equilibrium": (BODY, (1,)),
    "equilibrium with a history": (
        BODY
        + """
[[law]]
type = "neo-hookean"
mu_kPa = 1.0
kappa_kPa = 50.0
viscous = { beta = 1.0, relaxation_s = 60.0 }
[history]
time_h = [0.0, 0.01, 0.5]
share = [0.0, 1.0, 1.0]
steps_per_segment = 2
""",
        (3,),
    ),
    "lumpectomy": (LUMPECTOMY, (2,)),
    "lumpectomy by the continuum model": (
        LUMPECTOMY.replace("p_layer = 0.05", 'model = "fields"').replace("21.0", "30.0"),
        (1,),
    ),
}
SLOW = {"equilibrium with a history", "lumpectomy by the continuum model"}
NAMES = [
    pytest.param(name, marks=[pytest.mark.xdist_group(name), *([pytest.mark.slow] if name in SLOW else [])])
    for name in CASES
]
STATES = [
    pytest.param(name, n, marks=[pytest.mark.xdist_group(name), *([pytest.mark.slow] if name in SLOW else [])])
    for name, (_, moments) in CASES.items()
    for n in moments
]


class Stopper(Progress):
    """Progress that interrupts the run as Ctrl-C does, after a number of states of the march."""

    def __init__(self, stage, after):
        super().__init__()
        self.stage_name, self.left, self.is_marching = stage, after, False

    def begin(self, name):
        self.is_marching |= name == self.stage_name

    def update(self, fraction, words=""):
        if self.is_marching and fraction is not None:
            self.left -= 1
            if self.left == 0:
                raise KeyboardInterrupt


def write_inputs(folder):
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0, 20.0, 2)] * 3)
    points, cells = mesh.p.T.copy(), oriented(mesh.p.T, mesh.t.T)
    n = len(cells)
    elastic = {"youngs_modulus_kPa": np.full(n, 3.0), "poisson_ratio": np.full(n, 0.45)}
    fixed = {"fixed": (points[:, 2] > 19.9).astype(float)}
    write_vtu(folder / "body.vtu", points, cells, fixed, elastic | {"density_kg_m3": np.full(n, 1e3)})
    (folder / "species.csv").write_text("id,y_init,y_max,tau_h\nA,0.2,1,0.5\nB,1,1,1\nC,0,0.5,2\n")
    (folder / "reactions.csv").write_text(
        "id,rule,weight,n,ec50\nin,=> A,0.25,1.4,0.5\nr1,A & !C => B,1,1.4,0.5\nr2,B => C,1,1.4,0.5\n"
    )
    write_labels(folder)


@pytest.fixture(scope="module")
def case_of(tmp_path_factory):
    """Case by its name in the table above."""
    folder = tmp_path_factory.mktemp("cases")
    write_inputs(folder)

    def load(name):
        given, settings = CASES[name][0], []
        if isinstance(given, tuple):
            path, settings = given
        else:
            path = folder / f"{name.replace(' ', '-')}.toml"
            path.write_text(given)
        return cicatrix.load_case(path, settings)

    return load


@pytest.fixture(scope="module")
def whole(case_of, tmp_path_factory):
    """Results of a case that was run from its start to its end in one go."""
    found = {}

    def run(name):
        if name not in found:
            found[name] = cicatrix.simulate(case_of(name), tmp_path_factory.mktemp("runs") / "whole")
        return found[name]

    return run


def products(folder):
    """Every byte that a run leaves, but its manifest, whose seconds differ."""
    files = [f for f in sorted(folder.rglob("*")) if f.is_file() and f.name != "manifest.json"]
    return {str(f.relative_to(folder)): f.read_bytes() for f in files}


def notes_without_resuming(results):
    return [note for note in results.manifest["notes"] if not note.startswith("Resumed")]


def test_every_kind_is_here():
    assert {name.split()[0] for name in CASES} == set(KINDS)


@pytest.mark.parametrize("name", NAMES)
def test_a_run_leaves_what_every_run_leaves(name, whole):
    results = whole(name)
    manifest, folder = results.manifest, results.folder
    assert manifest["status"]["state"] == "finished"
    assert manifest["status"]["sentence"].endswith(".")
    assert not flaw_of(folder)  # the last checkpoint is that of the last row
    assert manifest["case"]["kind"] == name.split()[0]
    assert manifest["inputs"].keys() == {key for key in manifest["inputs"] if manifest["inputs"][key]["sha256"]}
    kind = simulation_type(name.split()[0])
    assert {kind.marching, driver.STEPS, "outcome"} <= manifest["seconds"].keys() or name.endswith("history")
    counts = next(iter(results.history.values()))
    assert (np.diff(counts) >= 0).all()  # rows are in order, none twice but for several stretches
    assert results.outcome
    assert all(isinstance(asked.unit, str) for asked in results.outcome.values())
    figures = list((folder / "figures").glob("*.png"))
    assert figures
    assert all(figure.stat().st_size > 5_000 for figure in figures)
    assert not [note for note in manifest["notes"] if "could not be drawn" in note]


@pytest.mark.parametrize(("name", "after"), STATES)
def test_stopped_and_resumed_is_uninterrupted(name, after, case_of, whole, tmp_path):
    case = case_of(name)
    stage = simulation_type(case.kind).of(case).marching
    with pytest.raises(KeyboardInterrupt):
        cicatrix.simulate(case, tmp_path / "run", progress=Stopper(stage, after))
    stopped = open_run(tmp_path / "run")
    assert stopped.status[0] == "interrupted"
    assert not stopped.outcome
    resumed = cicatrix.simulate(case, tmp_path / "run", resume=True)
    assert any(note.startswith("Resumed") for note in resumed.manifest["notes"])
    assert products(tmp_path / "run") == products(whole(name).folder)
    assert notes_without_resuming(resumed) == notes_without_resuming(whole(name))


@pytest.mark.parametrize("name", NAMES)
def test_a_solve_that_fails_keeps_the_last_good_state(name, case_of, whole, tmp_path):
    case = case_of(name)
    kind = simulation_type(case.kind).of(case)
    march, n = kind.march, CASES[name][1][0]

    def failing(self, state):
        states = march(self, state)
        for _ in range(n):
            yield next(states)
        next(states, None)  # the failed step has changed solvers, but not the states that were yielded
        raise ConvergenceError("No solution was found.", ["what was tried"])

    with pytest.MonkeyPatch.context() as patch:
        if name == "automaton":  # its cells are gone with the next step, so the last checkpoint counts
            patch.setattr(driver, "CHECKPOINT_SECONDS", 0.0)
        patch.setattr(kind, "march", failing)
        with pytest.raises(ConvergenceError):
            cicatrix.simulate(case, tmp_path / "run")
    failed = open_run(tmp_path / "run")
    assert failed.status == ("failed", "No solution was found.")
    assert "what was tried" in failed.manifest["notes"]
    assert list((tmp_path / "run" / "checkpoint").glob("*.json"))
    cicatrix.simulate(case, tmp_path / "run", resume=True)
    assert products(tmp_path / "run") == products(whole(name).folder)


@pytest.mark.parametrize("name", NAMES)
def test_a_case_that_ranks_cannot_share_is_refused_before_it_is_built(name, case_of, tmp_path, monkeypatch):
    class TwoRanks(Ranks):
        size = 2

    case = case_of(name)
    if simulation_type(case.kind).of(case).on_ranks:
        assert name in ("automaton", "equilibrium")
        return
    monkeypatch.setattr("cicatrix.kinds.simulate.world", TwoRanks)
    with pytest.raises(InputError, match="runs in one process: start it without mpiexec"):
        cicatrix.simulate(case, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", NAMES)
def test_a_run_without_a_folder_is_the_same_loop(name, case_of, whole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulation = cicatrix.build(case_of(name))
    assert isinstance(simulation, Simulation)
    state = simulation.start()
    rows = [*simulation.rows(state)]
    for later in simulation.march(state):
        rows += simulation.rows(later)
    history = whole(name).history
    assert list(rows[0]) == list(history)
    for column, values in history.items():
        np.testing.assert_array_equal(np.array([row[column] for row in rows], values.dtype), values, err_msg=column)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", NAMES)
def test_the_march_from_a_state_depends_on_that_state_alone(name, case_of):
    """Integrating twice from one state, with other steps in between, gives the same bits."""
    simulation = cicatrix.build(case_of(name))
    first = simulation.start()
    state = next(simulation.march(first)) if name != "automaton" else first  # its cells move on with the core
    once, again = (simulation.march(state) for _ in range(2))
    rows = [[row for _, later in zip(range(3), states) for row in simulation.rows(later)] for states in (once, again)]
    assert repr(rows[0]) == repr(rows[1])  # which compares NaN too


@pytest.mark.parametrize("name", [pytest.param("automaton", marks=pytest.mark.xdist_group("automaton"))])
def test_a_figure_that_fails_does_not_fail_the_run(name, case_of, whole, tmp_path):
    def broken():
        raise ValueError("no ink")

    case = case_of(name)
    kind = simulation_type(case.kind)
    figures = kind.figures
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kind, "figures", lambda self, end: {"broken": broken, **figures(self, end)})
        results = cicatrix.simulate(case, tmp_path / "run")
    assert results.status[0] == "finished"
    assert "The figure broken could not be drawn: ValueError: no ink" in results.manifest["notes"]
    assert products(tmp_path / "run") == products(whole(name).folder)


@pytest.mark.parametrize("name", NAMES)
def test_the_page_of_the_kind_names_what_comes_out(name, whole):
    """Every column, number and figure stands in docs/kinds, by its name or by one with <placeholders>."""
    results = whole(name)
    page = (PAGES / f"{name.split()[0]}.md").read_text(encoding="utf-8").partition("## What comes out")[2]
    words = re.findall(r"`([^` ]+)`", page)
    named = re.compile("|".join(re.sub(r"<\w+>", r"[^.]+", re.escape(word)) for word in words))
    figures = [figure.stem for figure in (results.folder / "figures").glob("*.png")]
    assert not [out for out in [*results.history, *results.outcome, *figures] if not named.fullmatch(out)]


def test_a_checkpoint_comes_after_the_map_of_its_moment(case_of, tmp_path, monkeypatch):
    """So that a run that is killed at any moment leaves no gap in the maps."""
    save, n_maps, expected = driver.RunFolder.save_checkpoint, [], []

    def saving(self, number, arrays, scalars, content):
        maps = [self.path / "fields" / f"{part}-{n:04d}.vtu" for part, n, _ in content["series"]["fields"]]
        assert all(path.is_file() for path in maps)
        n_maps.append(len(maps))
        hours = self.history()["time_h"][content["history"][0] - 1]
        expected.append(1 + int(hours / 30.0 + 1e-9))  # every 30 h
        save(self, number, arrays, scalars, content)

    monkeypatch.setattr(driver.RunFolder, "save_checkpoint", saving)
    monkeypatch.setattr(driver, "CHECKPOINT_SECONDS", 0.0)
    cicatrix.simulate(case_of("wound"), tmp_path / "run")
    assert n_maps == expected
    assert n_maps[-1] == 3


def test_one_interval_between_checkpoints(case_of, tmp_path, monkeypatch):
    """With an interval of 0 every state is saved; with an endless one the last state alone."""
    saved = []
    save = driver.RunFolder.save_checkpoint
    monkeypatch.setattr(
        driver.RunFolder,
        "save_checkpoint",
        lambda self, number, *more: saved.append(number) or save(self, number, *more),
    )
    monkeypatch.setattr(driver, "CHECKPOINT_SECONDS", np.inf)
    cicatrix.simulate(case_of("adhesion"), tmp_path / "once")
    assert saved == [10]
    saved.clear()
    monkeypatch.setattr(driver, "CHECKPOINT_SECONDS", 0.0)
    cicatrix.simulate(case_of("adhesion"), tmp_path / "always")
    assert saved == list(range(11))

"""The compiled automaton has the bits of its NumPy version: every instruction set, any number of threads, any wound."""

import numpy as np
import pytest

from cicatrix.core import native
from cicatrix.core.errors import InputError
from cicatrix.geometry.hexgrid import Lattice
from cicatrix.healing.automaton import Automaton, AutomatonRules, AutomatonState, NativeCore, pack_rows, unpack_rows
from cicatrix.healing.cue import Cue
from cicatrix.healing.reference import ReferenceCore

pytestmark = pytest.mark.skipif(not native.is_native, reason="the compiled module is not there")

ONE = np.zeros(1), 1.0


def random_case(i, size2=110, size3=34):
    """Return lattices of many blocks: masks, several wounds, wounds at the frame, every rule, both kinds of cue."""
    rng = np.random.default_rng(1000 + i)
    ndim, size = (3, size3) if i % 3 == 2 else (2, size2)
    shape = tuple(int(n) for n in rng.integers(size // 3, size + 1, ndim))
    lattice = Lattice(shape, 0.01, (0.0,) * ndim)
    points = lattice.positions()
    fillable = rng.random(shape) >= rng.choice([0.0, 0.0, 0.02, 0.3])
    if i % 4 == 3:
        fillable &= points[..., 0] > np.quantile(points[..., 0], 0.15)
    open0 = np.zeros(shape, bool)
    for _ in range(rng.integers(1, 4)):
        centre = points.reshape(-1, ndim)[rng.integers(lattice.n_sites)]
        open0 |= np.linalg.norm(points - centre, axis=-1) < 0.01 * rng.uniform(1.0, 0.3 * min(shape))
    n_substeps = int(rng.choice([0, 1, 4, 8]))
    rules = AutomatonRules(
        p_edge=float(rng.choice([0.0, 0.2, 0.7, 1.0])),
        p_layer=float(rng.choice([0.0, 0.02, 0.1, 0.5, 1.0])),
        layer_sites=int(rng.choice([0, 1, 3, 8, 12])),
        motility_substeps=n_substeps,
        redistribution="level-set" if n_substeps and rng.random() < 0.4 else "route",
        feedback=float(rng.choice([0.0, 1.0, -2.0])),
        min_free_neighbours=int(rng.integers(1, 4)),
        path_noise=float(rng.choice([0.0, 0.5, 16.0])),
    )
    cue = Cue(rng.uniform(0, 3, shape), 1.3) if i % 2 else Cue(0.7, 1.3)
    return Automaton(lattice, fillable, open0 & fillable, rules, int(rng.integers(0, 2**63))), cue


def pair(automaton, **kinds):
    """Return the compiled and the NumPy automaton for a fresh wound."""
    occupancy = automaton.initial_state().occupancy
    arguments = (automaton.lattice, automaton.fillable, occupancy, automaton.rules, automaton.seed, 0)
    return NativeCore(*arguments, **kinds), ReferenceCore(*arguments)


def assert_same(core, reference, cue, n_steps):
    for _ in range(n_steps):
        np.testing.assert_array_equal(core.advance(1, *cue), reference.advance(1, *cue))
        np.testing.assert_array_equal(core.occupancy(), reference.occupancy())


@pytest.mark.parametrize("isa", native.instruction_sets())
@pytest.mark.parametrize("i", range(24))
def test_every_instruction_set_gives_the_bits_of_the_reference(i, isa):
    automaton, cue = random_case(i)
    assert_same(*pair(automaton, isa=isa), automaton.checked(cue), 6)


@pytest.mark.parametrize("threads", [2, 3])
@pytest.mark.parametrize("i", range(24))
def test_threads_do_not_change_a_bit(i, threads):
    """Work is divided into single tiles, so that threads share small lattices too."""
    automaton, cue = random_case(i)
    assert_same(*pair(automaton, threads=threads, tiles_per_piece=1), automaton.checked(cue), 6)


@pytest.mark.parametrize("shape", [(700, 900), (90, 90, 90)])
def test_threads_share_out_a_large_front(shape):
    """There are enough blocks for several pieces of work at once; the reference is the result on one thread."""
    lattice = Lattice(shape, 0.01, (0.0,) * len(shape))
    centre = lattice.position(np.array(shape) / 2)
    open0 = np.linalg.norm(lattice.positions() - centre, axis=-1) < 0.01 * 0.35 * min(shape)
    rules = AutomatonRules(p_edge=0.2, p_layer=0.05, layer_sites=6, motility_substeps=6)
    automaton = Automaton(lattice, np.ones(shape, bool), open0, rules, 5)
    cores = [pair(automaton, threads=n)[0] for n in (1, 2, 4)]
    counts = [core.advance(4, *ONE) for core in cores]
    for core, count in zip(cores[1:], counts[1:]):
        np.testing.assert_array_equal(count, counts[0])
        np.testing.assert_array_equal(core.occupancy(), cores[0].occupancy())


@pytest.mark.parametrize("i", range(8))
def test_a_nearly_closed_wound_closes_alike(i):
    """Small holes: compare 12 steps, then run the compiled automaton until nothing is open."""
    rng = np.random.default_rng(i)
    shape = (40, 70) if i % 2 else (12, 14, 40)
    lattice = Lattice(shape, 0.01, (0.0,) * len(shape))
    open0 = rng.random(shape) < 0.02
    rules = AutomatonRules(p_edge=0.3, p_layer=0.05, layer_sites=3, motility_substeps=4)
    automaton = Automaton(lattice, np.ones(shape, bool), open0, rules, i)
    core, reference = pair(automaton)
    assert_same(core, reference, ONE, 12)
    core.advance(300, *ONE)
    assert core.occupancy().all()


@pytest.mark.parametrize("kinds", [{}, {"threads": 3, "tiles_per_piece": 1}])
def test_a_front_that_moves_far_widens_the_band(kinds):
    """p = 1 fills many rings in one step, and very many sub-steps erase a hole: both go beyond the first band."""
    lattice = Lattice((200, 200), 0.01, (0.0, 0.0))
    open0 = np.linalg.norm(lattice.positions() - lattice.position(np.array([100, 100])), axis=-1) < 0.6
    full = AutomatonRules(p_edge=1.0, p_layer=1.0, layer_sites=30, motility_substeps=2)
    assert_same(*pair(Automaton(lattice, np.ones_like(open0), open0, full, 2), **kinds), ONE, 2)
    hole = np.zeros_like(open0)
    hole[80, 90] = True
    smooth = AutomatonRules(p_edge=0.0, p_layer=0.0, layer_sites=0, motility_substeps=300)
    assert_same(*pair(Automaton(lattice, np.ones_like(open0), hole, smooth, 2), **kinds), ONE, 1)


def test_the_last_step_of_a_wound_stays_in_the_band():
    """When edge division fills the last sites, U is bulk everywhere, and the band is wide enough in this step and later."""
    lattice = Lattice((500, 500), 0.01, (0.0, 0.0))
    hole = np.zeros(lattice.shape, bool)
    hole[250:253, 250:253] = True
    rules = AutomatonRules(p_edge=1.0, p_layer=0.1, layer_sites=8, motility_substeps=8)
    core, reference = pair(Automaton(lattice, np.ones_like(hole), hole, rules, 1))
    for _ in range(20):
        assert_same(core, reference, ONE, 1)
        assert core.work["stored_tiles"] < 200
        if not core.n_open:
            break
    assert core.n_open == 0


@pytest.mark.parametrize("kinds", [{}, {"threads": 2, "tiles_per_piece": 1}])
def test_a_pocket_that_no_cell_borders_costs_its_border_only(kinds):
    lattice = Lattice((300, 300), 0.01, (0.0, 0.0))
    fillable, pocket = np.ones(lattice.shape, bool), np.zeros(lattice.shape, bool)
    fillable[100:112, 100:112] = False
    pocket[103:109, 103:109] = True
    fillable |= pocket
    rules = AutomatonRules(p_edge=0.5, p_layer=0.1, layer_sites=6, motility_substeps=8)
    core, reference = pair(Automaton(lattice, fillable, pocket, rules, 1), **kinds)
    assert_same(core, reference, ONE, 3)
    assert core.n_open == 36
    assert core.work["stored_tiles"] < 200


def test_the_compiled_class_refuses_what_it_cannot_hold():
    none = np.zeros(0, np.uint8)
    kinds = {"p_edge": 0.1, "p_layer": 0.1, "layer_sites": 1, "motility_substeps": 1, "level_set": False}
    kinds |= {"feedback": 0.0, "min_free_neighbours": 1, "path_noise": 1, "seed": 1, "step": 0}
    for shape in ([], [0, 10], [10, 0], [4], [2, 2, 2, 2], [-3, 5]):
        with pytest.raises(ValueError, match="axes"):
            native.automaton_core(shape, none, none, **kinds)
    with pytest.raises(ValueError, match="do not fit"):
        native.automaton_core([4, 4], none, none, **kinds)
    core = native.automaton_core([1, 8], np.full(1, 255, np.uint8), np.full(1, 1, np.uint8), **kinds)
    with pytest.raises(ValueError, match="n_steps"):
        core.advance(-1, *ONE)
    with pytest.raises(ValueError, match="threads"):
        native.automaton_core([1, 8], np.zeros(1, np.uint8), np.zeros(1, np.uint8), **kinds, threads=0)


@pytest.mark.parametrize("i", [0, 1, 2, 5])
def test_a_restart_with_other_threads_goes_on_to_the_same_bits(i):
    automaton, cue = random_case(i)
    checked = automaton.checked(cue)
    straight = automaton.core(automaton.initial_state())
    straight.advance(7, *checked)
    first = automaton.core(automaton.initial_state(), threads=2)
    first.advance(3, *checked)
    second = automaton.core(AutomatonState(first.occupancy(), first.step), threads=3, isa="portable")
    second.advance(4, *checked)
    np.testing.assert_array_equal(second.occupancy(), straight.occupancy())
    assert second.step == straight.step == 7


def test_rows_are_packed_and_unpacked():
    mask = np.random.default_rng(0).random((5, 3, 13)) < 0.5
    packed = pack_rows(mask)
    assert packed.size == 5 * 3 * 2
    np.testing.assert_array_equal(unpack_rows(packed, mask.shape), mask)


def test_threads_come_from_the_environment(monkeypatch):
    monkeypatch.setenv("CICATRIX_THREADS", "2")
    assert native.threads() == 2
    for bad in ("0", "many", "-1", "99999999999"):
        monkeypatch.setenv("CICATRIX_THREADS", bad)
        with pytest.raises(InputError, match="CICATRIX_THREADS"):
            native.threads()

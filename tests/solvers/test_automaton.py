"""The automaton: equal to a slow independent version, exact in a window, cells conserved, resuming, limits."""

import itertools

import numpy as np
import pytest
from slow_automaton import SlowStep

from cicatrix.core import native
from cicatrix.core.errors import InputError, InvariantError
from cicatrix.core.random import ONE
from cicatrix.geometry.hexgrid import Lattice
from cicatrix.healing import reference
from cicatrix.healing.automaton import Automaton, AutomatonRules, AutomatonState
from cicatrix.healing.cue import Cue
from cicatrix.healing.motility import BULK, diffuse
from cicatrix.healing.window import Window

RULES = AutomatonRules(p_edge=0.2, p_layer=0.05, layer_sites=4, motility_substeps=4)


@pytest.fixture(params=["compiled", "reference"], autouse=True)
def core(request, monkeypatch):
    """Run every test for the compiled automaton and for its NumPy version."""
    if request.param == "compiled" and not native.is_native:
        pytest.skip("the compiled module is not there")
    monkeypatch.setattr(native, "is_native", request.param == "compiled")
    return request.param


def lattice_of(shape):
    return Lattice(tuple(shape), 0.01, (0.0,) * len(shape))


def discs(shape, centres, radius):
    """Return the sites within a radius [sites] of any of the centres [site indices]."""
    lattice = lattice_of(shape)
    points = lattice.positions()
    gaps = [np.linalg.norm(points - lattice.position(np.array(c)), axis=-1) for c in centres]
    return np.min(gaps, axis=0) < radius * lattice.pitch_mm


def random_case(i, size2=24, size3=9):
    """Return wounds, masks, rules and cues of all kinds from a case number; every third case is 3-D."""
    rng = np.random.default_rng(i)
    ndim, size = (3, size3) if i % 3 == 2 else (2, size2)
    shape = tuple(int(n) for n in rng.integers(size - 3, size + 1, ndim))
    fillable = rng.random(shape) > rng.choice([0.0, 0.1, 0.3])
    fillable &= ~discs(shape, rng.uniform(0, size, (1, ndim)), 0.2 * size)
    centres = rng.uniform(0, size, (rng.integers(1, 4), ndim))
    open0 = discs(shape, centres, rng.uniform(1.0, 0.3 * size)) & fillable
    rules = AutomatonRules(
        p_edge=float(rng.choice([0.0, 0.2, 0.7, 1.0])),
        p_layer=float(rng.choice([0.0, 0.05, 0.3, 1.0])),
        layer_sites=int(rng.integers(0, 5)),
        motility_substeps=int(rng.integers(1, 6)) if i % 5 else (i // 5) % 2,
        redistribution="level-set" if i % 2 and (i % 5 or (i // 5) % 2) else "route",
        feedback=float(rng.choice([0.0, 1.0, -2.0])),
        min_free_neighbours=int(rng.integers(1, 4)),
        path_noise=float(rng.choice([0.0, 0.5, 3.0])),
    )
    cue = Cue(rng.uniform(0, 3, shape), 1.3) if i % 4 else Cue(0.7, 1.3)
    return Automaton(lattice_of(shape), fillable, open0, rules, int(rng.integers(0, 2**63))), cue


@pytest.mark.parametrize("i", range(30))
def test_equals_the_slow_reference(i):
    automaton, cue = random_case(i, size2=13, size3=6)
    state = automaton.initial_state()
    for _ in range(3):
        slow = SlowStep(automaton.fillable, automaton.rules, automaton.seed, state.step, cue.W, cue.W_ref)
        expected = slow.run(state.occupancy)
        state = automaton.advance(state, cue)
        np.testing.assert_array_equal(state.occupancy, expected)


@pytest.mark.parametrize("i", range(40))
def test_cells_are_conserved(i):
    automaton, cue = random_case(i)
    state = automaton.initial_state()
    for _ in range(8):
        new = automaton.advance(state, cue)
        assert new.n_cells == state.n_cells + new.n_edge_divisions + new.n_layer_divisions
        assert new.n_dropped >= 0
        assert not (new.occupancy & ~automaton.fillable).any()
        state = new


@pytest.mark.parametrize("core", ["reference"], indirect=True)
@pytest.mark.parametrize("i", range(24))
def test_window_equals_full_lattice(i, core, monkeypatch):
    automaton, cue = random_case(i)
    in_window = automaton.advance(automaton.initial_state(), cue, 5)
    monkeypatch.setattr(Window, "around", lambda lattice, mask, *_: Window.whole(lattice, mask))
    whole = automaton.advance(automaton.initial_state(), cue, 5)
    np.testing.assert_array_equal(in_window.occupancy, whole.occupancy)


@pytest.mark.parametrize("core", ["reference"], indirect=True)
@pytest.mark.parametrize("redistribution", ["route", "level-set"])
def test_small_window_of_a_large_lattice_equals_full_lattice(redistribution, core, monkeypatch):
    rules = AutomatonRules(p_edge=0.2, p_layer=0.1, layer_sites=5, redistribution=redistribution, feedback=1.0)
    open0 = discs((130, 140), [(60, 70), (75, 60)], 7)
    automaton = Automaton(lattice_of(open0.shape), np.ones_like(open0), open0, rules, 8)
    cue = Cue(np.random.default_rng(0).random(open0.shape), 0.5)
    windows = []
    around = Window.around
    monkeypatch.setattr(Window, "around", lambda *a: windows.append(around(*a)) or windows[-1])
    narrow = automaton.advance(automaton.initial_state(), cue, 6)
    assert windows
    assert not any(w.is_whole for w in windows)
    monkeypatch.setattr(Window, "around", lambda lattice, mask, *_: Window.whole(lattice, mask))
    np.testing.assert_array_equal(narrow.occupancy, automaton.advance(automaton.initial_state(), cue, 6).occupancy)


def test_band_is_widened_when_motility_erases_the_hole():
    """One hole and very many sub-steps: the field is flat again (U0 = bulk), so only the whole lattice gives the exact result."""
    open0 = np.zeros((90, 90), bool)
    open0[45, 45] = True
    rules = AutomatonRules(p_edge=0.0, p_layer=0.0, layer_sites=0, motility_substeps=3000)
    small = Automaton(lattice_of((90, 90)), np.ones_like(open0), open0, rules, 1)
    state = small.advance(small.initial_state())
    assert state.n_cells == open0.size - 1


def test_motility_by_hand():
    """A row of seven sites, the rest masked, cells on the left three, one sub-step.

    U' = (2 U + S6 + 4) >> 3; each site has two neighbours in the row (one at the ends), the others are masked and count
    as its own value, so U' = (6 U + left + right + 4) >> 3. With 8191 = 8 * 1023 + 7:
    sites 0, 1: 8191;  site 2: (7 * 8191 + 4) >> 3 = 57341 >> 3 = 7167;  site 3: (8191 + 4) >> 3 = 1024;  sites 4..6: 0.
    Second sub-step: site 1: (7 * 8191 + 7167 + 4) >> 3 = 64508 >> 3 = 8063;  site 2: (6 * 7167 + 8191 + 1024 + 4) >> 3
    = 52221 >> 3 = 6527;  site 3: (6 * 1024 + 7167 + 4) >> 3 = 13315 >> 3 = 1664;  site 4: (1024 + 4) >> 3 = 128.
    """
    mask = np.zeros((3, 7), bool)
    mask[1] = True
    occupancy = mask & (np.arange(7) < 3)
    window = Window.whole(lattice_of((3, 7)), mask)
    expected = {1: [8191, 8191, 7167, 1024, 0, 0, 0], 2: [8191, 8063, 6527, 1664, 128, 0, 0]}
    for n, row in expected.items():
        u = window.paste(diffuse(window, window.cut(occupancy), n), np.zeros((3, 7), np.uint16))
        assert u[1].tolist() == row
        assert not u[[0, 2]].any()


@pytest.mark.parametrize("ndim", [2, 3])
def test_integers_do_not_overflow(ndim):
    mask = np.ones((6,) * ndim, bool)
    window = Window.whole(lattice_of(mask.shape), mask)
    u = diffuse(window, window.cut(mask), 5)
    assert set(u.tolist()) == {0, BULK[ndim]}


@pytest.mark.parametrize("i", range(6))
def test_restart_goes_on_to_the_same_bits(i):
    automaton, cue = random_case(i)
    straight = automaton.advance(automaton.initial_state(), cue, 9)
    half = automaton.advance(automaton.initial_state(), cue, 4)
    packed = np.packbits(half.occupancy)
    restored = np.unpackbits(packed, count=half.occupancy.size).astype(bool).reshape(half.occupancy.shape)
    restarted = automaton.advance(AutomatonState(restored, 4), cue, 5)
    np.testing.assert_array_equal(restarted.occupancy, straight.occupancy)
    assert restarted.step == straight.step == 9


def test_input_state_is_untouched():
    automaton, cue = random_case(1)
    state = automaton.initial_state()
    copy = state.occupancy.copy()
    automaton.advance(state, cue, 3)
    np.testing.assert_array_equal(state.occupancy, copy)
    assert state.step == 0
    with pytest.raises(ValueError, match="read-only"):
        state.occupancy[0] = True


def test_seeds_differ():
    open0 = discs((60, 60), [(30, 30)], 12)
    runs = [Automaton(lattice_of((60, 60)), np.ones_like(open0), open0, RULES, s) for s in (1, 2, 2**32 + 1)]
    ends = [a.advance(a.initial_state(), n_steps=3).occupancy for a in runs]
    assert not any(np.array_equal(a, b) for a, b in itertools.combinations(ends, 2))


def wound(shape=(60, 60), radius=10, fillable=None, **rules):
    open0 = discs(shape, [np.array(shape) / 2], radius)
    mask = np.ones(shape, bool) if fillable is None else fillable
    kinds = {"p_edge": 0.2, "p_layer": 0.05, "layer_sites": 4, "motility_substeps": 4} | rules
    return Automaton(lattice_of(shape), mask, open0 & mask, AutomatonRules(**kinds), 3)


class TestLimits:
    def test_closed_stays_closed(self):
        shape = (20, 20)
        automaton = Automaton(lattice_of(shape), np.ones(shape, bool), np.zeros(shape, bool), RULES, 1)
        state = automaton.advance(automaton.initial_state(), n_steps=3)
        assert state.n_cells == 400
        assert (state.step, state.n_edge_divisions, state.n_layer_divisions) == (3, 0, 0)

    def test_all_open_is_refused(self):
        with pytest.raises(InputError, match="leaves no cell"):
            wound(radius=1000)

    def test_nothing_divides_at_probability_zero(self):
        automaton = wound(p_edge=0.0, p_layer=0.0)
        state = automaton.advance(automaton.initial_state(), n_steps=5)
        assert state.n_cells == automaton.initial_state().n_cells

    @pytest.mark.parametrize("redistribution", ["route", "level-set"])
    def test_probability_one_closes_in_one_step(self, redistribution):
        automaton = wound(radius=6, p_edge=1.0, p_layer=1.0, layer_sites=12, redistribution=redistribution)
        state = automaton.advance(automaton.initial_state())
        assert state.n_cells == 3600
        assert state.n_dropped > 0  # more daughters than free sites: the surplus is dropped

    def test_edge_division_fills_every_site_at_most_once(self):
        automaton = wound(p_edge=1.0, p_layer=0.0, motility_substeps=0)
        state = automaton.advance(automaton.initial_state())
        window = Window.whole(automaton.lattice, automaton.fillable)
        ring = window.beside(window.cut(automaton.initial_state().occupancy)) & window.cut(automaton.open0)
        assert 0 < state.n_edge_divisions <= ring.sum()

    def test_contact_inhibition(self):
        free = wound(motility_substeps=0, p_layer=0.0, p_edge=1.0, min_free_neighbours=1)
        held = wound(motility_substeps=0, p_layer=0.0, p_edge=1.0, min_free_neighbours=3)
        n = [a.advance(a.initial_state()).n_edge_divisions for a in (free, held)]
        assert n[0] > n[1]

    @pytest.mark.parametrize("shape", [(40, 40), (14, 14, 14)])
    @pytest.mark.parametrize("redistribution", ["route", "level-set"])
    def test_wound_at_the_frame_and_beside_others_closes(self, shape, redistribution):
        n = shape[0]
        centres = [(0,) * len(shape), (n / 2,) * len(shape), (n - 1,) * len(shape)]
        open0 = discs(shape, centres, n / 5)
        kinds = AutomatonRules(
            p_edge=0.4, p_layer=0.05, layer_sites=3, motility_substeps=3, redistribution=redistribution
        )
        automaton = Automaton(lattice_of(shape), np.ones(shape, bool), open0, kinds, 1)
        state = automaton.advance(automaton.initial_state(), n_steps=120)
        assert state.n_cells == open0.size

    def test_single_hole_closes(self):
        open0 = np.zeros((30, 30), bool)
        open0[15, 15] = True
        automaton = Automaton(lattice_of((30, 30)), np.ones_like(open0), open0, RULES, 1)
        assert automaton.advance(automaton.initial_state(), n_steps=60).n_cells == 900

    def test_pocket_without_cells_around_stays_empty(self):
        fillable = np.ones((20, 20), bool)
        fillable[:, 10] = fillable[:, 9] = False  # two columns: no neighbour reaches across
        open0 = fillable & (np.arange(20) > 10)
        automaton = Automaton(lattice_of((20, 20)), fillable, open0, RULES, 1)
        state = automaton.advance(automaton.initial_state(), n_steps=10)
        np.testing.assert_array_equal(state.occupancy, fillable & ~open0)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, np.zeros((3, 3)), np.full((60, 60), np.nan)])
    def test_bad_energy_is_refused(self, bad):
        automaton = wound(feedback=1.0)
        with pytest.raises(InputError, match=r"Cue\.W must"):
            automaton.advance(automaton.initial_state(), Cue(bad))

    def test_a_feedback_that_overflows_is_refused(self):
        automaton = wound(p_layer=0.0, feedback=1e308)
        with pytest.raises(InputError, match="far too large"):
            automaton.advance(automaton.initial_state(), Cue(1e308, 1.0))

    def test_a_state_with_a_cell_where_none_can_be_is_refused(self):
        automaton = wound(fillable=discs((60, 60), [(30, 30)], 25))
        with pytest.raises(InputError, match="not fillable"):
            automaton.advance(AutomatonState(np.ones((60, 60), bool), 0))

    def test_steps_are_not_negative(self):
        with pytest.raises(InputError, match="n_steps"):
            wound().advance(wound().initial_state(), n_steps=-1)

    @pytest.mark.parametrize("w_ref", [0.0, -1.0, np.nan])
    def test_bad_reference_energy_is_refused(self, w_ref):
        with pytest.raises(InputError, match="W_ref"):
            wound().advance(wound().initial_state(), Cue(1.0, w_ref))

    def test_clamping_is_counted(self):
        automaton = wound(p_layer=0.5, feedback=1.0)
        assert automaton.advance(automaton.initial_state(), Cue(0.9, 1.0)).n_clamped == 0
        assert automaton.advance(automaton.initial_state(), Cue(2.0, 1.0)).n_clamped > 0

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("p_edge", -0.1),
            ("p_edge", np.nan),
            ("p_layer", 1.1),
            ("layer_sites", -1),
            ("layer_sites", 1.5),
            ("motility_substeps", -1),
            ("redistribution", "shift"),
            ("feedback", np.inf),
            ("min_free_neighbours", 0),
            ("min_free_neighbours", 7),
            ("path_noise", -1.0),
        ],
    )
    def test_bad_rules_are_refused(self, name, value):
        with pytest.raises(InputError, match=name):
            wound(**{name: value})

    def test_level_set_needs_motility(self):
        with pytest.raises(InputError, match="level-set"):
            wound(redistribution="level-set", motility_substeps=0)

    def test_bad_arrays_are_refused(self):
        ones, none = np.ones((9, 9), bool), np.zeros((9, 9), bool)
        with pytest.raises(InputError, match="open0 must be bool"):
            Automaton(lattice_of((9, 9)), ones, np.zeros((9, 8), bool), RULES, 1)
        with pytest.raises(InputError, match="fillable must be bool"):
            Automaton(lattice_of((9, 9)), ones.astype(float), none, RULES, 1)
        with pytest.raises(InputError, match="never be filled"):
            Automaton(lattice_of((9, 9)), none, ones, RULES, 1)
        with pytest.raises(InputError, match="leaves no cell"):
            Automaton(lattice_of((9, 9)), none, none, RULES, 1)
        with pytest.raises(InputError, match="seed"):
            Automaton(lattice_of((9, 9)), ones, none, RULES, 2 * ONE**2)
        with pytest.raises(InputError, match="the state's lattice"):
            wound().advance(AutomatonState(ones, 0))


def test_lost_cells_are_noticed(monkeypatch):
    monkeypatch.setattr(native, "is_native", False)
    automaton = wound()
    monkeypatch.setattr(reference, "move", lambda window, occupied, *_: (occupied & False, True))
    with pytest.raises(InvariantError, match="lost or doubled"):
        automaton.advance(automaton.initial_state())

"""Closure of wounds: where daughters appear, the speed of the front, its roundness, and the effect of the pitch."""

import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.geometry.hexgrid import Lattice
from cicatrix.healing.automaton import Automaton, AutomatonRules
from cicatrix.healing.cue import Cue
from cicatrix.healing.rates import LAYER_UM, P_LAYER, hours_per_step_at_pitch, rules_at_pitch, straight_front_speed
from cicatrix.outcome import closure


def disc(radius_mm, pitch_mm, rules, seed=1):
    reach = 1.15 * radius_mm + 4 * pitch_mm
    lattice = Lattice.covering((-reach, -reach), (reach, reach), pitch_mm)
    open0 = (lattice.positions() ** 2).sum(axis=-1) < radius_mm**2
    return Automaton(lattice, np.ones(lattice.shape, bool), open0, rules, seed)


def open_measures(automaton, n_steps=10_000):
    """Return the open area [mm2] after every step, until closure or ``n_steps``."""
    state, areas = automaton.initial_state(), []
    while len(areas) <= n_steps:
        areas.append((automaton.open0.size - state.n_cells) * automaton.lattice.site_measure)
        if areas[-1] == 0:
            break
        state = automaton.advance(state)
    return np.array(areas)


def roundness(automaton, state):
    """Return the standard deviation of the radius over 24 sectors relative to its mean; 0 is a circle."""
    points = automaton.lattice.positions()[~state.occupancy]
    points = points - points.mean(axis=0)
    sector = np.floor(np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) * 24).astype(int) % 24
    radius = np.sqrt(np.bincount(sector, minlength=24))  # area of a sector ~ radius^2
    return radius.std() / radius.mean()


def test_front_speeds_up_as_the_wound_shrinks():
    """v = p delta (1 + delta / 2R), delta = 0.3 mm the layer: factor 1.18 at 0.85 mm, 1.5 at 0.3 mm."""
    rules = AutomatonRules(p_edge=0.0, p_layer=0.04, layer_sites=30)
    radius = np.sqrt(open_measures(disc(1.0, 0.01, rules)) / np.pi)
    steps = np.arange(radius.size)
    at = [np.interp(-r, -radius, steps) for r in (0.95, 0.75, 0.4, 0.2)]
    assert 0.2 / (at[3] - at[2]) > 1.15 * 0.2 / (at[1] - at[0])


@pytest.mark.parametrize("seed", range(5))
def test_wound_stays_round_without_feedback(seed):
    automaton = disc(1.2, 0.02, rules_at_pitch(20.0, p_layer=0.02, layer_um=160.0), seed)
    state = automaton.initial_state()
    n_open = np.count_nonzero(automaton.open0)
    while automaton.open0.size - state.n_cells > 0.4 * n_open:
        state = automaton.advance(state)
    assert roundness(automaton, state) < 0.06


@pytest.mark.parametrize("pitch", [75.0, 100.0])
def test_a_ball_stays_round_and_keeps_its_time(pitch):
    """A ball of 3 mm with default rates: radii of gyration within 6 % at a fifth of its volume; time to closure as at 50 um."""
    lattice = Lattice.covering((-4.9,) * 3, (4.9,) * 3, pitch * 1e-3)
    open0 = np.linalg.norm(lattice.positions(), axis=-1) < 3.0
    automaton = Automaton(lattice, np.ones(lattice.shape, bool), open0, rules_at_pitch(pitch, 3), 0)
    state, left = automaton.initial_state(), [1.0]
    while left[-1] > 0.2:
        state = automaton.advance(state)
        left.append((open0.size - state.n_cells) / np.count_nonzero(open0))
    assert closure.roundness(lattice, ~state.occupancy) > 0.94
    steps = np.interp(-0.2, -np.array(left), np.arange(len(left)))
    assert steps * hours_per_step_at_pitch(pitch, n_axes=3) / 24 == pytest.approx(13.16, rel=0.05)


def test_feedback_breaks_the_symmetry():
    automaton = disc(1.2, 0.02, rules_at_pitch(20.0, p_layer=0.02, layer_um=160.0, feedback=1.0))
    x = automaton.lattice.positions()[..., 0]
    state = automaton.advance(automaton.initial_state(), Cue(np.where(x > 0, 2.0, 0.0), 1.0), 40)
    assert automaton.lattice.positions()[~state.occupancy].mean(axis=0)[0] < -0.05


def test_coarser_pitch_keeps_the_closure_time():
    """The same wound with a radius of 1 mm at 10, 20 and 40 um: days to closure and to a quarter of the area."""
    days = {}
    for pitch, n_seeds in ((10.0, 1), (20.0, 3), (40.0, 6)):
        rules = rules_at_pitch(pitch, p_layer=0.02, layer_um=160.0)
        step = hours_per_step_at_pitch(pitch) / 24
        runs = [open_measures(disc(1.0, pitch * 1e-3, rules, seed)) for seed in range(n_seeds)]
        quarter = [np.interp(-0.25 * a[0], -a, np.arange(a.size)) * step for a in runs]
        days[pitch] = np.mean([(a.size - 1) * step for a in runs]), np.mean(quarter)
    for pitch in (20.0, 40.0):
        assert days[pitch] == pytest.approx(days[10.0], rel=0.06)


class TestRates:
    def test_scaling_by_hand(self):
        # 40 um: four times the step, so four times the probability, a quarter of the layer's sites and of the sub-steps
        rules = rules_at_pitch(40.0, p_edge=0.2, p_layer=0.1, layer_um=400.0, motility_substeps=8)
        assert (rules.p_edge, rules.layer_sites, rules.motility_substeps) == (0.2, 10, 2)
        assert rules.p_layer == pytest.approx(0.4)
        assert hours_per_step_at_pitch(40.0, 15.0) == 60.0
        # 0.1 of a layer of 0.4 mm per 15 h
        assert straight_front_speed(0.1, 400.0, 15.0) == pytest.approx(0.064)

    def test_scaling_beyond_50_um_and_in_3d_by_hand(self):
        # 100 um: five cell cycles, not ten; per cycle the edge gains half as many sites
        rules = rules_at_pitch(100.0, p_edge=0.2, p_layer=0.1, layer_um=400.0, motility_substeps=40)
        assert (rules.p_edge, rules.p_layer) == pytest.approx((0.1, 0.5))
        assert (rules.layer_sites, rules.motility_substeps) == (4, 2)
        # a solid: half of 100 um in two cycles' 0.1 x 400 um is 1.25 cycles
        rules = rules_at_pitch(100.0, 3, p_edge=0.2, p_layer=0.1, layer_um=400.0, motility_substeps=160)
        assert (rules.p_edge, rules.p_layer) == pytest.approx((0.025, 0.125))
        assert (rules.layer_sites, rules.motility_substeps) == (4, 2)
        assert hours_per_step_at_pitch(100.0, 15.0, 3, p_layer=0.1, layer_um=400.0) == pytest.approx(18.75)
        assert rules_at_pitch(100.0, 3, layer_um=0.0, p_layer=0.1).p_layer == pytest.approx(0.5)

    def test_defaults_leave_room_for_feedback(self):
        for pitch in (40.0, 50.0):
            assert rules_at_pitch(pitch).p_layer * (1 + 4) < 1
        assert pytest.approx(0.042) == P_LAYER * LAYER_UM * 1e-3

    @pytest.mark.parametrize(
        ("arguments", "word"),
        [
            ({"pitch_um": 0.0}, "pitch_um"),
            ({"pitch_um": np.nan}, "pitch_um"),
            ({"pitch_um": 50.0, "p_layer": 0.3}, "above 1"),
            ({"pitch_um": 50.0, "layer_um": 20.0}, "thinner"),
            ({"pitch_um": 10.0, "p_edge": 1.5}, "p_edge"),
            ({"pitch_um": 10.0, "layer_um": np.nan}, "layer_um"),
            ({"pitch_um": 10.0, "p_layer": np.nan}, "p_layer"),
        ],
    )
    def test_bad_rates_are_refused(self, arguments, word):
        with pytest.raises(InputError, match=word):
            rules_at_pitch(**arguments)

    @pytest.mark.parametrize("hours", [0.0, -1.0, np.nan])
    def test_bad_hours_are_refused(self, hours):
        with pytest.raises(InputError, match="hours_per_step"):
            hours_per_step_at_pitch(10.0, hours)

"""The healing cycle on a small half-disc breast: seeds, no feedback, restart, conservation, symmetry, compilation."""

from dataclasses import replace

import numpy as np
import pytest

from cicatrix.coupling.cycle import WELL_FILLED, run
from cicatrix.coupling.deposition import Deposition
from cicatrix.kinds.lumpectomy.build import equilibrium_of, healing_cycle, plan
from cicatrix.kinds.lumpectomy.case import Coupling, Healing, Image, LumpectomyCase, Mesh, Resection, Run
from cicatrix.mechanics.body import compiled_variants, deformation_gradients
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.outcome import closure

pytestmark = pytest.mark.xdist_group("cycle")  # compiled once

N_CYCLES = 3


def case_of(mode="two-way", feedback=1.0, seed=1, p_layer=0.015, **healing):
    return LumpectomyCase(
        image=Image(labels="not-read.nii"),
        resection=Resection(radius_mm=5.0),
        healing=Healing(pitch_um=200.0, feedback=feedback, p_layer=p_layer, **healing),
        coupling=Coupling(mode=mode, days_per_cycle=12.5),
        mesh=Mesh(edge_mm=8.0, cavity_edge_mm=3.0),
        run=Run(seed=seed),
    )


@pytest.fixture(scope="module")
def planned(half_disc):
    return plan(case_of(), half_disc(20.0))


@pytest.fixture(scope="module")
def shapes(planned):
    """Unloaded shape, and loaded shape in the healing position."""
    X, _ = Equilibrium().unloaded(planned.intact, planned.x_imaged, planned.gravity("prone"))
    return X, Equilibrium().loaded(planned.intact, X, planned.gravity("upright"))[0]


@pytest.fixture(scope="module")
def healed(planned, shapes):
    """Run a case: (cycle, states from the fresh wound on)."""

    def go(**kinds):
        case = case_of(**kinds)
        cycle = healing_cycle(case, planned, *shapes, equilibrium_of(case))
        fresh = cycle.start()
        return cycle, [fresh, *run(cycle, fresh, N_CYCLES)]

    return go


@pytest.fixture(scope="module")
def two_way(healed):
    return healed()


def same(one, other):
    """Bit for bit."""
    return (
        one.cycle == other.cycle
        and one.healing.step == other.healing.step
        and all(
            np.array_equal(a, b)
            for a, b in [
                (one.healing.occupancy, other.healing.occupancy),
                (one.filled, other.filled),
                (one.natural, other.natural),
                (one.x, other.x),
            ]
        )
    )


def test_same_seed_same_run(healed, two_way):
    assert all(same(a, b) for a, b in zip(healed()[1], two_way[1], strict=True))


def test_no_feedback_is_one_way(healed):
    one_way, silent = healed(mode="one-way")[1], healed(feedback=0.0)[1]
    assert all(same(a, b) for a, b in zip(one_way, silent, strict=True))


def test_restart_is_uninterrupted(planned, shapes, two_way):
    """A new process would have a new cycle and a new solver, and the state of the first cycle."""
    case = case_of()
    cycle = healing_cycle(case, planned, *shapes, equilibrium_of(case))
    again = list(run(cycle, two_way[1][1], N_CYCLES))
    assert len(again) == N_CYCLES - 1
    assert all(same(a, b) for a, b in zip(again, two_way[1][2:], strict=True))


def test_nothing_compiles_in_another_run(healed, two_way):
    before = compiled_variants()
    other = healed(seed=3)[1]
    assert compiled_variants() == before
    assert not np.array_equal(other[-1].healing.occupancy, two_way[1][-1].healing.occupancy)


def test_cells_are_neither_lost_nor_doubled(two_way):
    cycle, states = two_way
    total = cycle.sites.count(cycle.automaton.fillable.ravel())
    for state in states:
        n_open = np.count_nonzero(cycle.open_sites(state.healing))
        assert state.healing.n_cells + n_open == np.count_nonzero(cycle.automaton.fillable)
        assert np.sum(total * (1 - state.filled)) == pytest.approx(n_open, abs=1e-9)
    assert (np.diff([s.healing.n_cells for s in states]) > 0).all()


def test_fresh_wound_is_the_disc(two_way):
    """As large as the elements of the cavity, up to sites on its border; those are empty, the others full."""
    cycle, states = two_way
    area = closure.open_size(cycle.automaton.lattice, cycle.open_sites(states[0].healing))
    areas = cycle.intact.volumes(cycle.X)[cycle.cavity].sum()
    assert area == pytest.approx(areas, rel=0.02)
    assert (states[0].filled[cycle.cavity] == 0).all()
    assert (states[0].filled[~cycle.cavity] == 1).all()


def test_feedback_under_gravity_breaks_the_symmetry(healed):
    """Mean over seeds of the asymmetry after the last cycle, strong feedback against none (Garbey et al., Fig. 6)."""
    lost = {}
    for mode in ("one-way", "two-way"):
        lost[mode] = []
        for seed in (1, 2):
            cycle, states = healed(mode=mode, feedback=4.0, seed=seed, p_layer=0.005)
            centre = closure.wound_centre(cycle.automaton.open0)
            lost[mode].append(closure.asymmetry(cycle.open_sites(states[-1].healing), centre))
    print(lost)
    assert np.mean(lost["two-way"]) > 1.5 * np.mean(lost["one-way"])


def test_cells_feel_the_energy_of_the_tissue(two_way):
    """The mean of W over the sites of an element is its weighted mean, as far as sites resolve the element."""
    cycle, states = two_way
    state = states[0]
    W = cycle.energy_at_sites(state)
    body = cycle.body(state)
    exact, areas = body.energy_density(cycle.X, state.x), body.volumes(cycle.X)
    counts = cycle.sites.count(np.ones(W.size, bool))
    sums = np.bincount(cycle.sites.element[cycle.sites.element >= 0], W[cycle.sites.element >= 0], len(counts))
    big = (
        (counts > 30)
        & ~cycle.cavity
        & (cycle.sites.count(cycle.automaton.fillable.ravel()) * 0.0346 > 0.9 * areas.sum(1))
    )
    assert big.sum() > 3
    means = np.sum(exact * areas, axis=1) / areas.sum(axis=1)
    np.testing.assert_allclose((sums / np.maximum(counts, 1))[big], means[big], rtol=0.15)
    assert (W >= 0).all()
    assert state.W_ref == cycle.edge_energy(state) > 0


def test_a_thinly_filled_element_does_not_raise_what_cells_feel(two_way):
    """Cells in elements that are not well filled feel no more than the well-filled tissue does anywhere beside."""
    cycle, states = two_way
    thin_seen = 0
    for state in states[1:]:
        fraction = cycle.body(state).fraction
        W, element = cycle.energy_at_sites(state), cycle.sites.element
        well = np.append(fraction >= WELL_FILLED, False)[element]
        thin = np.append((fraction > 0) & (fraction < WELL_FILLED), False)[element]
        thin_seen += thin.sum()
        assert W[thin].max(initial=0.0) <= W[well].max()
    assert thin_seen > 10


def test_loaded_deposition_is_born_free_of_stress(healed):
    """In an element that was empty the cycle before, new tissue carries no energy in the shape in which it was laid."""
    cycle, states = healed(deposition="loaded", p_layer=0.05)
    old, new = states[-2], states[-1]
    newborn = (old.filled == 0) & (new.filled > 0.05)
    if not newborn.any():
        old, new = states[0], states[1]
        newborn = (old.filled == 0) & (new.filled > 0.05)
    assert newborn.any()
    W = cycle.body(new).energy_density(cycle.X, old.x)[newborn]
    assert np.abs(W).max() < 1e-12
    F = deformation_gradients(cycle.intact.frame.space, cycle.X, old.x)
    np.testing.assert_allclose(new.natural[newborn], F[newborn], atol=5e-3)  # but for the projection of its volume


def test_run_stops_when_closed(two_way):
    cycle, states = two_way
    closed = replace(states[-1], closure_days=5.0)
    assert closed.is_closed
    assert list(run(cycle, closed, 100)) == []


# deposition ----------------------------------------------------------------------------------------------------------

F = np.eye(3) + 0.2 * np.random.default_rng(1).uniform(-1, 1, (3, 4, 3, 3))
OLD = np.broadcast_to(np.eye(3), F.shape)
NONE, HALF, FULL = np.zeros(3), np.full(3, 0.5), np.ones(3)


def test_unloaded_deposition_changes_nothing():
    assert Deposition(False).natural(OLD, NONE, FULL, F) is OLD


def test_loaded_deposition_is_a_mean_by_mass():
    """All new: F. Half new: the mean. A fifth of what is there, new: 4/5 old and 1/5 F. Nothing new, or less: old."""
    laid = Deposition(True)
    np.testing.assert_allclose(laid.natural(OLD, NONE, FULL, F), F, atol=1e-14)
    np.testing.assert_allclose(laid.natural(OLD, HALF, FULL, F), (OLD + F) / 2, atol=1e-14)
    np.testing.assert_allclose(laid.natural(OLD, 0.4 * FULL, HALF, F), 0.8 * OLD + 0.2 * F, atol=1e-14)
    assert (laid.natural(OLD, FULL, FULL, F) == OLD).all()
    assert (laid.natural(OLD, FULL, HALF, F) == OLD).all()


def test_prestretch_is_the_elastic_stretch_at_birth():
    """F_e = F F_n^-1 = G = diag(g, g, g^-2): by hand from F_n = G^-1 F."""
    g = 1.1
    natural = Deposition(True, g).natural(OLD, NONE, FULL, F)
    np.testing.assert_allclose(F @ np.linalg.inv(natural), np.broadcast_to(np.diag([g, g, g**-2]), F.shape), atol=1e-13)

"""The healing cycle with the automaton on a half-disc breast: seeds, feedback, restart, conservation, symmetry, compilation."""

from dataclasses import replace

import numpy as np
import pytest
from coarse_lumpectomy import stiff_tissue

from cicatrix.coupling.cycle import run
from cicatrix.coupling.deposition import Deposition
from cicatrix.coupling.ruler import WELL_FILLED
from cicatrix.kinds.lumpectomy.build import equilibrium_of, healing_cycle
from cicatrix.kinds.lumpectomy.case import (
    CouplingTable,
    HealingTable,
    ImageTable,
    LumpectomyCase,
    LumpectomyRunTable,
    MeshTable,
    ResectionTable,
)
from cicatrix.mechanics.body import compiled_variants, deformation_gradients
from cicatrix.outcome import closure

pytestmark = pytest.mark.xdist_group("cycle")  # compiled once

N_CYCLES = 3


def case_of(mode="two-way", feedback=1.0, seed=1, p_layer=0.015, **healing):
    return LumpectomyCase(
        image=ImageTable(labels="not-read.nii"),
        tissue=stiff_tissue(),
        resection=ResectionTable(radius_mm=5.0),
        healing=HealingTable(pitch_um=200.0, feedback=feedback, p_layer=p_layer, **healing),
        coupling=CouplingTable(mode=mode, days_per_cycle=12.5),
        mesh=MeshTable(edge_mm=8.0, cavity_edge_mm=3.0),
        run=LumpectomyRunTable(seed=seed),
    )


@pytest.fixture(scope="module")
def healed(model, shapes):
    """Run a case; return the cycle and its states from the fresh wound on."""

    def go(**kinds):
        case = case_of(**kinds)
        cycle = healing_cycle(case, model, *shapes, equilibrium_of(case))
        fresh = cycle.start()
        return cycle, [fresh, *run(cycle, fresh, N_CYCLES)]

    return go


@pytest.fixture(scope="module")
def two_way(healed):
    return healed()


def same(one, other):
    """Check that two states are equal bit for bit."""
    return (
        one.cycle == other.cycle
        and one.healing.cells.step == other.healing.cells.step
        and all(
            np.array_equal(a, b)
            for a, b in [
                (one.healing.cells.occupancy, other.healing.cells.occupancy),
                (one.healing.filled, other.healing.filled),
                (one.healing.natural, other.healing.natural),
                (one.x, other.x),
            ]
        )
    )


def test_same_seed_same_run(healed, two_way):
    assert all(same(a, b) for a, b in zip(healed()[1], two_way[1], strict=True))


def test_no_feedback_is_one_way(healed):
    one_way, silent = healed(mode="one-way")[1], healed(feedback=0.0)[1]
    assert all(same(a, b) for a, b in zip(one_way, silent, strict=True))


def test_restart_is_uninterrupted(model, shapes, two_way):
    """Like a new process, restart with a new cycle and a new solver from the state after the first cycle."""
    case = case_of()
    cycle = healing_cycle(case, model, *shapes, equilibrium_of(case))
    again = list(run(cycle, cycle.unpack(*cycle.pack(two_way[1][1])), N_CYCLES))
    assert len(again) == N_CYCLES - 1
    assert all(same(a, b) for a, b in zip(again, two_way[1][2:], strict=True))


def test_nothing_compiles_in_another_run(healed, two_way):
    before = compiled_variants()
    other = healed(seed=3)[1]
    assert compiled_variants() == before
    assert not np.array_equal(other[-1].healing.cells.occupancy, two_way[1][-1].healing.cells.occupancy)


def test_cells_are_neither_lost_nor_doubled(two_way):
    cycle, states = two_way
    total = cycle.ruler.sites.count(cycle.ruler.fillable.ravel())
    for state in states:
        n_open = np.count_nonzero(cycle.open_sites(state))
        assert state.healing.cells.n_cells + n_open == np.count_nonzero(cycle.ruler.fillable)
        assert np.sum(total * (1 - cycle.filled(state))) == pytest.approx(n_open, abs=1e-9)
    assert (np.diff([s.healing.cells.n_cells for s in states]) > 0).all()


def test_fresh_wound_is_the_disc(two_way):
    """The open sites cover the elements of the cavity, except sites on its border; they are empty and all others full."""
    cycle, states = two_way
    area = closure.open_size(cycle.ruler.lattice, cycle.open_sites(states[0]))
    areas = cycle.intact.volumes(cycle.X)[cycle.cavity.elements].sum()
    assert area == pytest.approx(areas, rel=0.02)
    assert (states[0].healing.filled[cycle.cavity.elements] == 0).all()
    assert (states[0].healing.filled[~cycle.cavity.elements] == 1).all()


def test_feedback_under_gravity_breaks_the_symmetry(healed):
    """Mean over seeds of the asymmetry after the last cycle, strong feedback against none (Garbey et al., Fig. 6)."""
    lost = {}
    for mode in ("one-way", "two-way"):
        lost[mode] = []
        for seed in (1, 2):
            cycle, states = healed(mode=mode, feedback=4.0, seed=seed, p_layer=0.005)
            centre = closure.wound_centre(cycle.ruler.open0)
            lost[mode].append(closure.asymmetry(cycle.open_sites(states[-1]), centre))
    print(lost)
    assert np.mean(lost["two-way"]) > 1.5 * np.mean(lost["one-way"])


def test_cells_feel_the_energy_of_the_tissue(two_way):
    """The mean of W over the sites of an element is its weighted mean, as far as the sites resolve the element."""
    cycle, states = two_way
    state = states[0]
    body, sites = cycle.body(state), cycle.ruler.sites
    W = cycle.ruler.energy(body, cycle.X, state.x, cycle.filled(state)).ravel()
    exact, areas = body.energy_density(cycle.X, state.x), body.volumes(cycle.X)
    counts = sites.count(np.ones(W.size, bool))
    sums = np.bincount(sites.element[sites.element >= 0], W[sites.element >= 0], len(counts))
    big = (
        (counts > 30)
        & ~cycle.cavity.elements
        & (sites.count(cycle.ruler.fillable.ravel()) * 0.0346 > 0.9 * areas.sum(1))
    )
    assert big.sum() > 3
    means = np.sum(exact * areas, axis=1) / areas.sum(axis=1)
    np.testing.assert_allclose((sums / np.maximum(counts, 1))[big], means[big], rtol=0.2)
    assert (W >= 0).all()
    assert state.W_ref == cycle.edge_energy(state) > 0


def test_a_thinly_filled_element_does_not_raise_what_cells_feel(two_way):
    """The energy for cells in thinly filled elements is not above that in the well-filled tissue next to them."""
    cycle, states = two_way
    thin_seen = 0
    for state in states[1:]:
        body, element = cycle.body(state), cycle.ruler.sites.element
        fraction = body.fraction
        W = cycle.ruler.energy(body, cycle.X, state.x, cycle.filled(state)).ravel()
        well = np.append(fraction >= WELL_FILLED, False)[element]
        thin = np.append((fraction > 0) & (fraction < WELL_FILLED), False)[element]
        thin_seen += thin.sum()
        assert W[thin].max(initial=0.0) <= W[well].max()
    assert thin_seen > 10


def test_loaded_deposition_is_born_free_of_stress(healed):
    """In an element that was empty before, new tissue has no strain energy in the shape in which it was laid down."""
    cycle, states = healed(deposition="loaded", p_layer=0.05)
    old, new = states[-2], states[-1]
    newborn = (old.healing.filled == 0) & (new.healing.filled > 0.05)
    if not newborn.any():
        old, new = states[0], states[1]
        newborn = (old.healing.filled == 0) & (new.healing.filled > 0.05)
    assert newborn.any()
    W = cycle.body(new).energy_density(cycle.X, old.x)[newborn]
    assert np.abs(W).max() < 1e-12
    F = deformation_gradients(cycle.intact.discretization.space, cycle.X, old.x)
    np.testing.assert_allclose(
        new.healing.natural[newborn], F[newborn], atol=5e-3
    )  # but for the projection of its volume


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
    """All new: F. Half new: the mean. One fifth new: 4/5 old and 1/5 F. Nothing new, or less tissue: old."""
    laid = Deposition(True)
    np.testing.assert_allclose(laid.natural(OLD, NONE, FULL, F), F, atol=1e-14)
    np.testing.assert_allclose(laid.natural(OLD, HALF, FULL, F), (OLD + F) / 2, atol=1e-14)
    np.testing.assert_allclose(laid.natural(OLD, 0.4 * FULL, HALF, F), 0.8 * OLD + 0.2 * F, atol=1e-14)
    assert (laid.natural(OLD, FULL, FULL, F) == OLD).all()
    assert (laid.natural(OLD, FULL, HALF, F) == OLD).all()


def test_prestretch_is_the_elastic_stretch_at_birth():
    """F_e = F F_n^-1 = G = diag(g, g, g^-2), by hand from F_n = G^-1 F."""
    g = 1.1
    natural = Deposition(True, g).natural(OLD, NONE, FULL, F)
    np.testing.assert_allclose(F @ np.linalg.inv(natural), np.broadcast_to(np.diag([g, g, g**-2]), F.shape), atol=1e-13)

"""The continuum model on a small half-disc breast: contents of the cavity, its stiffness and tension, restart, the ruler."""

import numpy as np
import pytest
from coarse_lumpectomy import stiff_tissue

from cicatrix.cases.continuum import ParametersTable
from cicatrix.core.units import seconds_from_days
from cicatrix.coupling.continuum_healing import CLOSED
from cicatrix.coupling.cycle import run
from cicatrix.kinds.lumpectomy.build import breast_model, equilibrium_of, healing_cycle
from cicatrix.kinds.lumpectomy.case import (
    CouplingTable,
    HealingTable,
    ImageTable,
    LumpectomyCase,
    MeshTable,
    OutcomeTable,
    ResectionTable,
)
from cicatrix.mechanics.equilibrium import Equilibrium

pytestmark = pytest.mark.xdist_group("cycle")  # compiled once
CALM = {"t_rho_MPa": 0.0, "t_rho_c_MPa": 0.0}  # no traction of cells
WHOLE = {"phi_wound": 1.0, "rho_wound": 1.0, "c_wound": 0.0}


def case_of(mode="two-way", deposition="unloaded", **parameters):
    return LumpectomyCase(
        image=ImageTable(labels="not-read.nii"),
        resection=ResectionTable(radius_mm=5.0),
        healing=HealingTable(
            model="fields",
            pitch_um=200.0,
            deposition=deposition,
            parameters=ParametersTable(**parameters),
            time_tolerance=1e-2,
        ),
        tissue=stiff_tissue(tumour={"E_kPa": 3.25, "density_kg_m3": 930.0}, scar={"density_kg_m3": 930.0}),
        coupling=CouplingTable(mode=mode, days_per_cycle=3.5),
        mesh=MeshTable(edge_mm=8.0, cavity_edge_mm=3.0),
        outcome=OutcomeTable(visits_weeks=(1.0,)),
    )


@pytest.fixture(scope="module")
def cycle_of(half_disc):
    model = breast_model(case_of(), half_disc(20.0))
    X, _ = Equilibrium().unloaded(model.intact, model.x_imaged, model.gravity("prone"))
    x, _ = Equilibrium().loaded(model.intact, X, model.gravity("upright"))

    def made(**settings):
        case = case_of(**settings)
        return healing_cycle(case, model, X, x, equilibrium_of(case))

    return made


@pytest.fixture(scope="module")
def healed(cycle_of):
    cycle = cycle_of()
    fresh = cycle.start()
    return cycle, [fresh, *run(cycle, fresh, 20)]


def test_it_closes_and_is_followed_to_the_last_visit(healed):
    cycle, states = healed
    shares = [1.0 - np.count_nonzero(cycle.open_sites(s)) / cycle.ruler.open0.sum() for s in states]
    assert shares[0] < 0.03
    assert (np.diff(shares) >= 0.0).all()
    assert shares[-1] == 1.0
    assert states[-1].is_closed
    assert cycle.days(states[-1].cycle - 1) < states[-1].closure_days <= cycle.days(states[-1].cycle)


def test_closure_is_when_the_last_vertex_is_filled(healed):
    cycle, states = healed
    before = next(s for s in reversed(states) if not s.is_closed)
    solver, integration, when = (
        cycle.healing.solver(before.healing),
        before.healing.integration,
        states[-1].closure_days,
    )
    for reached in solver.integrate(integration, seconds_from_days(cycle.days(before.cycle + 1))):
        low, high = (c.now.fields[cycle.healing.cavity_vertices, 0].min() for c in (integration, reached))
        if low < CLOSED <= high:
            assert integration.time < seconds_from_days(when) <= reached.time
        integration = reached


def test_restart_is_uninterrupted(healed):
    """A state from a checkpoint leads to the same bits, from the fresh wound too."""
    cycle, states = healed
    for n in (0, 1):
        new, old = cycle.step(cycle.unpack(*cycle.pack(states[n]))), states[n + 1]
        assert np.array_equal(new.x, old.x)
        assert np.array_equal(new.healing.integration.now.fields, old.healing.integration.now.fields)
        assert np.array_equal(new.healing.occupancy, old.healing.occupancy)


def test_old_tissue_neither_yields_nor_makes_collagen(healed):
    cycle, states = healed
    first, last = states[0].healing.integration.now.local, states[-1].healing.integration.now.local
    np.testing.assert_allclose(last.phi[~cycle.cavity.elements], first.phi[~cycle.cavity.elements], rtol=1e-12)
    np.testing.assert_allclose(last.stretch[~cycle.cavity.elements], 1.0, rtol=1e-12)
    assert (last.phi[cycle.cavity.elements] > first.phi[cycle.cavity.elements]).all()


def test_a_cavity_full_of_scar_hangs_as_the_breast_did(cycle_of):
    """With a scar as stiff as fat and no traction, the sag is within 3 % of that before surgery."""
    cycle = cycle_of(**CALM, **WHOLE, kf_MPa=0.0, k0_MPa=0.5 * 3.25e-3 / (2 * 1.495))
    state = cycle.start()
    sag = np.abs(cycle.x_intact - cycle.X).max()
    assert np.abs(state.x - cycle.x_intact).max() < 0.03 * sag


def test_laid_down_loaded_it_is_free_of_stress(cycle_of):
    """The provisional matrix changes the shape with the open cavity only by its weight, a hundredth of that of tissue."""
    cycle = cycle_of(deposition="loaded", **CALM, phi_wound=1e-6)
    state = cycle.start()
    emptied, _ = cycle.equilibrium.loaded(cycle.opened, cycle.X, cycle.gravity, cycle.x_intact)
    old = np.unique(cycle.intact.discretization.space.element_nodes[~cycle.cavity.elements])
    assert np.abs(state.x - emptied)[old].max() < 1e-5 * np.abs(emptied - cycle.X).max()
    W = cycle.body(state).energy_density(cycle.X, state.x)[cycle.cavity.elements]
    assert W.max() < 1e-5 * state.W_ref


def test_contraction_makes_the_cavity_smaller(cycle_of):
    """Compare traction on and off with everything else equal."""
    ratios = []
    for pull in ({"T_0_MPa": 0.0}, CALM):
        cycle = cycle_of(**pull)
        state = cycle.step(cycle.start())
        ratios.append(cycle.healing.measured(state)["cavity_volume_mean"])
    assert ratios[0] < ratios[1] - 0.005


def test_one_way_cells_have_the_shape_after_surgery(cycle_of):
    """The body that the cells use does not move; the body of the results does."""
    cycle = cycle_of(mode="one-way", T_0_MPa=0.0)
    fresh = cycle.start()
    state = cycle.step(fresh)
    assert np.array_equal(state.healing.integration.now.x, fresh.x)
    assert np.abs(state.x - fresh.x).max() > 1e-3

"""A small half-disc breast that heals by fields: what is laid into the cavity, what it bears and pulls, restart, the ruler."""

from dataclasses import replace

import numpy as np
import pytest

from cicatrix.cases.continuum import ParametersTable
from cicatrix.core.units import seconds_from_days
from cicatrix.coupling.continuum import CLOSED
from cicatrix.coupling.cycle import run
from cicatrix.healing.continuum import course_arrays, course_from, course_scalars
from cicatrix.kinds.lumpectomy.build import equilibrium_of, healing_cycle, plan
from cicatrix.kinds.lumpectomy.case import (
    Coupling,
    Healing,
    Image,
    LumpectomyCase,
    Mesh,
    Outcome,
    Resection,
    Scar,
    Tissue,
    Tumour,
)
from cicatrix.mechanics.equilibrium import Equilibrium

pytestmark = pytest.mark.xdist_group("cycle")  # compiled once
CALM = {"t_rho_MPa": 0.0, "t_rho_c_MPa": 0.0}  # cells do not pull
WHOLE = {"phi_wound": 1.0, "rho_wound": 1.0, "c_wound": 0.0}


def case_of(mode="two-way", deposition="unloaded", **parameters):
    return LumpectomyCase(
        image=Image(labels="not-read.nii"),
        resection=Resection(radius_mm=5.0),
        healing=Healing(
            model="fields",
            pitch_um=200.0,
            deposition=deposition,
            parameters=ParametersTable(**parameters),
            time_tolerance=1e-2,
        ),
        tissue=Tissue(tumour=Tumour(E_kPa=3.25, density_kg_m3=930.0), scar=Scar(density_kg_m3=930.0)),
        coupling=Coupling(mode=mode, days_per_cycle=3.5),
        mesh=Mesh(edge_mm=8.0, cavity_edge_mm=3.0),
        outcome=Outcome(visits_weeks=(1.0,)),
    )


@pytest.fixture(scope="module")
def cycle_of(half_disc):
    planned = plan(case_of(), half_disc(20.0))
    X, _ = Equilibrium().unloaded(planned.intact, planned.x_imaged, planned.gravity("prone"))
    x, _ = Equilibrium().loaded(planned.intact, X, planned.gravity("upright"))

    def made(**settings):
        case = case_of(**settings)
        return healing_cycle(case, planned, X, x, equilibrium_of(case))

    return made


@pytest.fixture(scope="module")
def healed(cycle_of):
    cycle = cycle_of()
    fresh = cycle.start()
    return cycle, [fresh, *run(cycle, fresh, 20)]


def test_it_closes_and_is_followed_to_the_last_visit(healed):
    cycle, states = healed
    shares = [1.0 - np.count_nonzero(cycle.open_sites(s.healing)) / cycle.automaton.open0.sum() for s in states]
    assert shares[0] < 0.03
    assert (np.diff(shares) >= 0.0).all()
    assert shares[-1] == 1.0
    assert states[-1].is_closed
    assert cycle.days(states[-1].cycle - 1) < states[-1].closure_days <= cycle.days(states[-1].cycle)


def test_closure_is_when_the_last_carrier_is_filled(healed):
    cycle, states = healed
    before = next(s for s in reversed(states) if not s.is_closed)
    solver, course, when = cycle.solver(before), before.course, states[-1].closure_days
    for reached in solver.follow(course, seconds_from_days(cycle.days(before.cycle + 1))):
        low, high = (c.now.fields[cycle.beds, 0].min() for c in (course, reached))
        if low < CLOSED <= high:
            assert course.time < seconds_from_days(when) <= reached.time
        course = reached


def test_restart_is_uninterrupted(healed):
    """What a checkpoint holds of a course leads to the same bits."""
    cycle, states = healed
    kept = states[1].course
    again = course_from(course_arrays(kept), course_scalars(kept))
    new, old = cycle.step(replace(states[1], course=again)), states[2]
    assert np.array_equal(new.x, old.x)
    assert np.array_equal(new.course.now.fields, old.course.now.fields)
    assert np.array_equal(new.healing.occupancy, old.healing.occupancy)


def test_old_tissue_neither_yields_nor_makes_collagen(healed):
    cycle, states = healed
    first, last = states[0].course.now.local, states[-1].course.now.local
    np.testing.assert_allclose(last.phi[~cycle.cavity], first.phi[~cycle.cavity], rtol=1e-12)
    np.testing.assert_allclose(last.stretch[~cycle.cavity], 1.0, rtol=1e-12)
    assert (last.phi[cycle.cavity] > first.phi[cycle.cavity]).all()


def test_a_cavity_full_of_scar_hangs_as_the_breast_did(cycle_of):
    """Scar as stiff as fat, no pull: within 3 % of the sag before surgery; the laws differ at large stretch."""
    cycle = cycle_of(**CALM, **WHOLE, kf_MPa=0.0, k0_MPa=0.5 * 3.25e-3 / (2 * 1.495))
    state = cycle.start()
    sag = np.abs(cycle.x_intact - cycle.X).max()
    assert np.abs(state.x - cycle.x_intact).max() < 0.03 * sag


def test_laid_down_loaded_it_is_free_of_stress(cycle_of):
    """The provisional matrix changes the shape with the open cavity by its weight alone, a hundredth of tissue's."""
    cycle = cycle_of(deposition="loaded", **CALM, phi_wound=1e-6)
    state, emptied = cycle.start(), super(type(cycle), cycle).start()
    old = np.unique(cycle.intact.frame.space.element_nodes[~cycle.cavity])
    assert np.abs(state.x - emptied.x)[old].max() < 1e-5 * np.abs(emptied.x - cycle.X).max()
    W = cycle.body(state).energy_density(cycle.X, state.x)[cycle.cavity]
    assert W.max() < 1e-5 * emptied.W_ref


def test_contraction_makes_the_cavity_smaller(cycle_of):
    """Pull on and off; nothing else differs."""
    ratios = []
    for pull in ({"T_0_MPa": 0.0}, CALM):
        cycle = cycle_of(**pull)
        state = cycle.step(cycle.start())
        ratios.append(cycle.measured(state)["cavity_volume_mean"])
    assert ratios[0] < ratios[1] - 0.005


def test_one_way_cells_have_the_shape_after_surgery(cycle_of):
    """Their body does not move; the one that is told does."""
    cycle = cycle_of(mode="one-way", T_0_MPa=0.0)
    fresh = cycle.start()
    state = cycle.step(fresh)
    assert np.array_equal(state.course.now.x, fresh.x)
    assert np.abs(state.x - fresh.x).max() > 1e-3

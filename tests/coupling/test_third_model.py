"""A model of wound healing that the program does not have: one class and one line make it heal a lumpectomy."""

from dataclasses import dataclass
from typing import get_args

import numpy as np
import pytest
from coarse_lumpectomy import stiff_tissue
from scipy.spatial import cKDTree

from cicatrix.coupling.cavity import Cavity
from cicatrix.coupling.cycle import run
from cicatrix.coupling.healing import Advance
from cicatrix.coupling.ruler import Ruler
from cicatrix.kinds.lumpectomy.build import MODELS, equilibrium_of, healing_cycle
from cicatrix.kinds.lumpectomy.case import (
    MODEL_KEYS,
    CouplingTable,
    HealingTable,
    ImageTable,
    LumpectomyCase,
    MeshTable,
    ResectionTable,
)
from cicatrix.kinds.lumpectomy.summary import closing_sentence, closure_numbers, history_row

pytestmark = pytest.mark.xdist_group("cycle")  # compiled once

RADIUS_MM, SPEED, DAYS = 5.0, 0.25, 3.5  # of the cavity; of its wall [mm/day]; per cycle


@dataclass(frozen=True, eq=False)
class ShrinkingWound:
    """The wall moves inward at a constant speed [mm/day]; the state is how far it has come [mm]."""

    cavity: Cavity
    ruler: Ruler
    speed: float
    closes: str = "the cycle in which the walls met"
    notes: tuple[str, ...] = ()

    @property
    def distance(self):
        """From each site to the tissue around the fresh wound [mm]."""
        places, lattice = self.ruler.lattice.positions(), self.ruler.lattice
        tree = cKDTree(places[self.ruler.fresh].reshape(-1, lattice.ndim))
        return tree.query(places.reshape(-1, lattice.ndim))[0].reshape(lattice.shape)

    def fresh(self, x, x_intact):
        return 0.0

    def advance(self, state, until):
        depth, closure_days = self.speed * until, state.closure_days
        if closure_days < 0.0 and not self.ruler.open_sites(self.occupancy(depth)).any():
            closure_days = until
        return Advance(depth, closure_days)

    def is_over(self, state):
        return state.is_closed

    def body(self, depth):
        return self.cavity.body(self.filled(depth), self.cavity.unstrained)

    def occupancy(self, depth):
        return self.ruler.occupancy(self.distance <= depth)

    def filled(self, depth):
        return self.ruler.filled(self.occupancy(depth))

    def shown(self, depth):
        return {}

    def measured(self, state):
        return {"depth_mm": state.healing}

    def pack(self, depth):
        return {}, {"depth_mm": depth}

    def unpack(self, arrays, scalars):
        return scalars["depth_mm"]


@pytest.fixture(scope="module")
def healed(model, shapes):
    """The cycle, and its states from the fresh wound on."""
    case = LumpectomyCase(
        image=ImageTable(labels="not-read.nii"),
        tissue=stiff_tissue(),
        resection=ResectionTable(radius_mm=RADIUS_MM),
        healing=HealingTable(pitch_um=200.0),
        coupling=CouplingTable(days_per_cycle=DAYS),
        mesh=MeshTable(edge_mm=8.0, cavity_edge_mm=3.0),
    )
    case = case.unchecked(healing=case.healing.unchecked(model="shrinking"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(
            MODELS, "shrinking", lambda case, model, cavity, ruler, report: ShrinkingWound(cavity, ruler, SPEED)
        )
        cycle = healing_cycle(case, model, *shapes, equilibrium_of(case))
    fresh = cycle.start()
    return cycle, [fresh, *run(cycle, fresh, 100)]


def test_it_closes_when_the_walls_meet(healed):
    """After radius over speed, 20 days, seen at the end of a cycle of 3.5."""
    cycle, states = healed
    assert states[-1].is_closed
    assert abs(states[-1].closure_days - RADIUS_MM / SPEED) <= DAYS
    assert states[-1].closure_days == cycle.days(states[-1].cycle)


def test_its_history_is_that_of_a_shrinking_disc(healed):
    """The radius of a disc of the open area shrinks with the wall, to the pitch of 0.2 mm."""
    cycle, states = healed
    rows = [history_row(cycle, state) for state in states]
    radius = np.sqrt([row["open_area_mm2"] / np.pi for row in rows])
    depth = np.array([row["depth_mm"] for row in rows])
    assert depth == pytest.approx(SPEED * DAYS * np.arange(len(rows)))
    np.testing.assert_allclose(radius[:-1], radius[0] - depth[:-1], atol=0.4)
    assert rows[-1]["closed_fraction"] == 1.0
    assert rows[-1]["clamped_cells"] == 0
    numbers = closure_numbers(cycle, states[-1], rows)
    assert numbers["time_to_closure_days"].note == "the cycle in which the walls met"
    assert f"{states[-1].closure_days:.1f} days" in closing_sentence(cycle, states[-1])


def test_the_healed_body_has_its_shape_before_surgery(healed):
    """Its new tissue is laid down unloaded; scar is stiffer and heavier than fat: to a twentieth of the sag."""
    cycle, states = healed
    moved = np.abs(states[-1].x - cycle.x_intact).max()
    assert moved < 0.05 * np.abs(cycle.x_intact - cycle.X).max()
    assert np.abs(states[0].x - cycle.x_intact).max() > moved


def test_a_restart_is_uninterrupted(healed):
    """From a state and from its checkpoint, both with a solver that has no factor yet."""
    cycle, states = healed
    runs = []
    for state in (states[2], cycle.unpack(*cycle.pack(states[2]))):
        cycle.equilibrium.reset()
        runs.append(list(run(cycle, state, 100)))
    assert len(runs[0]) == len(states) - 3
    assert all(np.array_equal(one.x, other.x) for one, other in zip(*runs, strict=True))
    assert runs[1][-1].closure_days == states[-1].closure_days


def test_the_table_of_models_and_the_case_name_the_same():
    named = get_args(HealingTable.model_fields["model"].annotation)
    assert set(MODELS) == set(MODEL_KEYS) == set(named)
    assert {key for keys in MODEL_KEYS.values() for key in keys} <= set(HealingTable.model_fields)

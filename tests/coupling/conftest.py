"""A small half-disc breast of fat with a cavity, meshed and unloaded once for all tests that use it."""

import pytest
from coarse_lumpectomy import stiff_tissue

from cicatrix.kinds.lumpectomy.build import breast_model
from cicatrix.kinds.lumpectomy.case import HealingTable, ImageTable, LumpectomyCase, MeshTable, ResectionTable
from cicatrix.mechanics.equilibrium import Equilibrium


@pytest.fixture(scope="session")
def model(half_disc):
    case = LumpectomyCase(
        image=ImageTable(labels="not-read.nii"),
        tissue=stiff_tissue(),
        resection=ResectionTable(radius_mm=5.0),
        healing=HealingTable(pitch_um=200.0),
        mesh=MeshTable(edge_mm=8.0, cavity_edge_mm=3.0),
    )
    return breast_model(case, half_disc(20.0))


@pytest.fixture(scope="session")
def shapes(model):
    """Return the unloaded shape, and the loaded shape in the healing position."""
    X, _ = Equilibrium().unloaded(model.intact, model.x_imaged, model.gravity("prone"))
    return X, Equilibrium().loaded(model.intact, X, model.gravity("upright"))[0]

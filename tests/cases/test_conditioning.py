"""Stiffness of one woman from where her nipple lies supine: a linear body in closed form, and a breast that is found again."""

import numpy as np
import pytest

import cicatrix
from cicatrix.core.errors import InputError
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.lumpectomy.build import breast_model, equilibrium_of
from cicatrix.kinds.lumpectomy.conditioning import NIPPLE_SD_MM, PRIOR_SD, condition, scaled
from cicatrix.kinds.registry import case_from

BREAST = {
    "kind": "lumpectomy",
    "dimension": 2,
    "image": {"phantom": "half-ellipsoid", "voxel_mm": 3.0},
    "healing": {"pitch_um": 400.0, "p_layer": 0.05},
    "coupling": {"days_per_cycle": 21.0, "healing_position": "supine"},
    "mesh": {"edge_mm": 8.0, "cavity_edge_mm": 5.0},
    "outcome": {"positions": ["supine"], "visits_weeks": [3]},
    "solver": {"relative_tolerance": 1e-6},
}


def test_a_linear_body_in_closed_form():
    """The most probable factors of a nipple that moves linearly with their logarithms, by the normal equations."""
    slopes = np.array([[-20.0, -5.0], [-30.0, -2.0], [1.0, -8.0]])
    rest, seen = np.array([10.0, 40.0, 0.0]), np.array([25.0, 60.0, 3.0])
    found = condition(lambda factors: rest + slopes @ np.log(factors), seen)
    precision = slopes.T @ slopes / NIPPLE_SD_MM**2 + np.diag(PRIOR_SD**-2.0)
    expected = np.linalg.solve(precision, slopes.T @ (seen - rest) / NIPPLE_SD_MM**2)
    np.testing.assert_allclose(found.logs, expected, rtol=1e-6)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(precision), rtol=1e-6)
    low, high = found.interval(0)
    assert low < found.factors()[0] < high


def supine_nipple(case):
    """Return the place of the nipple lying supine, LPS [mm]."""
    anatomy, _ = anatomy_of(case)
    model, solver = breast_model(case, anatomy), equilibrium_of(case)
    X, _ = solver.unloaded(model.intact, model.x_imaged, model.gravity("prone"))
    x, _ = solver.loaded(model.intact, X, model.gravity("supine"))
    return model.section.to_patient(model.nipple_position(x))


@pytest.mark.slow
def test_a_breast_is_found_again_from_its_nipple():
    """Tissue of 0.6 times the stiffness, fascia of 1.5 times: the nipple to 3 mm, and both factors within their intervals.

    One point says little about two factors: softer tissue and softer springs move it alike.
    """
    truth = np.array([0.6, 1.5])
    seen = supine_nipple(scaled(case_from(BREAST), truth))
    run = cicatrix.build(case_from(BREAST | {"outcome": BREAST["outcome"] | {"supine_nipple_mm": seen.tolist()}}))
    before = run.start()
    fit = run.conditioned
    assert fit.misfit_mm < 3.0
    for which in (0, 1):
        low, high = fit.interval(which)
        assert low < truth[which] < high
    assert any("stiffness fitted to the nipple" in note for note in run.notes)
    supine = run.model.nipple_position(before.shapes["supine", "before"])
    assert np.linalg.norm(run.model.section.to_patient(supine) - seen) < 3.5


def test_what_cannot_be_fitted_is_refused():
    told = {"supine_nipple_mm": [80.0, 0.0, 0.0]}
    with pytest.raises(InputError, match=r"supine_nipple_mm needs fascia\.slides = true"):
        case_from(BREAST | {"outcome": told, "fascia": {"slides": False}})
    supine = BREAST["image"] | {"position": "supine"}
    with pytest.raises(InputError, match="this one is supine already"):
        case_from(BREAST | {"outcome": told, "image": supine})

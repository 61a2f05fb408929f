"""Check that every law of case files has an example that runs, and that the page of laws is up to date."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import cicatrix
from cicatrix.cases.laws import GROWTHS, LAWS

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples" / "laws").glob("*.toml"))
COLUMNS = "step time_h lambda_x lambda_y lambda_z sigma_x_kPa sigma_y_kPa energy_kPa dissipation_kPa growth_x growth_y "
COLUMNS += "growth_z sigma_z_kPa sigma_xy_kPa shear n_substeps"
COMPILE_LONG = (
    "constrained-mixture",
    "fibre-distribution",  # fibres run in test_papers.py and in test_every_kind.py too
    "ligaments",
    "locking-skin",
    "neo-hookean-area-growth",
    "neo-hookean-viscous",
    "neo-hookean-volume-growth",
)
FEW = ["loading.steps_per_segment=2", "solver.relative_tolerance=0.05"]


@pytest.fixture(scope="module")
def gallery():
    spec = importlib.util.spec_from_file_location("gallery", ROOT / "docs" / "gallery.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_law_has_an_example():
    cases = [cicatrix.load_case(path) for path in EXAMPLES]
    assert {case.law[0].type for case in cases} == set(LAWS)
    assert {case.growth.type for case in cases if case.growth} == set(GROWTHS) - {"fibre"}  # covered by the papers


def each(path):
    return pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (path.stem in COMPILE_LONG))


@pytest.mark.parametrize("path", [each(path) for path in EXAMPLES])
def test_the_example_runs(path, tmp_path):
    history = cicatrix.simulate(cicatrix.load_case(path, FEW), tmp_path / "run").history
    assert list(history) == COLUMNS.split()
    assert all(len(column) == 5 and np.isfinite(column).all() for column in history.values())
    np.testing.assert_allclose(history["lambda_x"], [1.0, 1.15, 1.3, 1.15, 1.0])
    assert history["sigma_x_kPa"][2] > 0.1
    assert (np.diff(history["dissipation_kPa"]) >= 0.0).all()


def test_the_page_is_that_of_the_laws(gallery):
    """If this fails, run python docs/gallery.py."""
    assert (ROOT / "docs" / "laws.md").read_text(encoding="utf-8") == gallery.page()

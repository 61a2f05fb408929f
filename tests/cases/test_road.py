"""A complete lumpectomy run on a coarse case: from a label map, such as one corrected by hand, to the healed shape."""

import json

import numpy as np
import pytest
from coarse_lumpectomy import STIFF_TISSUE, write_labels

import cicatrix
from cicatrix.files.segmentations import read_labels

CASE = f"""
kind = "lumpectomy"
dimension = 2
[image]
labels = "labels.nii.gz"
[healing]
pitch_um = 100.0
[mesh]
edge_mm = 6.0
cavity_edge_mm = 2.0
[outcome]
positions = ["upright"]
visits_weeks = [2]
{STIFF_TISSUE}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("road")
    labels = write_labels(folder)
    (folder / "case.toml").write_text(CASE)
    return cicatrix.simulate(cicatrix.load_case(folder / "case.toml"), out=folder / "run"), labels


def test_a_label_map_heals(run):
    results, _ = run
    assert results.history["closed_fraction"][-1] == 1.0
    assert 20 < results.outcome["time_to_closure_days"].value < 200
    assert "labels imported" in json.loads((results.folder / "manifest.json").read_text())["notes"][0]


def test_what_was_imported_is_what_was_used(run):
    results, labels = run
    np.testing.assert_array_equal(read_labels(results.folder / "labels.nii.gz").values, labels.values)
    first = results.history["open_area_mm2"][0]
    assert first == pytest.approx(np.pi * 12.0**2, rel=0.03)

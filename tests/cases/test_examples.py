"""Run the examples on real images to closure (slow; skipped if the image data is missing)."""

import zipfile
from pathlib import Path

import pytest

import cicatrix
from cicatrix.cases.paths import data_folder
from cicatrix.core.errors import InputError

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("lumpectomy-*.toml"))


@pytest.fixture(scope="module")
def data():
    try:
        return data_folder()
    except InputError as error:
        pytest.skip(f"the image data {error}")


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_wound_closes_on_a_real_image(path, data, tmp_path):
    overrides = []
    if "dicom" in path.stem:
        with zipfile.ZipFile(data / "mimbcd_uta4p1_dicom12.zip") as archive:
            archive.extractall(tmp_path / "series")
        overrides = [f'image.path="{tmp_path / "series"}"']
    case = cicatrix.load_case(path, overrides)
    results = cicatrix.simulate(case, out=tmp_path / "run")
    assert results.history["closed_fraction"][-1] == 1.0
    latest = 150 if case.healing.deposition == "loaded" else 100  # stress-free new tissue gives no feedback
    assert 40 < results.outcome["time_to_closure_days"].value < latest
    most = 20 if path.stem.endswith("-3d") else 10
    assert (results.history["newton_iterations"][1:] < most).all()

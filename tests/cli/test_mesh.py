"""``cicatrix mesh``: its output can be read by cases of kind equilibrium."""

import numpy as np
import pytest

from cicatrix.cli.main import main
from cicatrix.files.images import write_volume
from cicatrix.files.meshes import read_body
from cicatrix.geometry.labels import Label
from cicatrix.geometry.tetrahedra import volumes
from cicatrix.geometry.volume import Volume


@pytest.fixture(scope="module")
def labels(tmp_path_factory):
    """Write labels of half a ball of 30 mm that ends at the last image plane: gland within 12 mm of its centre, fat outside."""
    across, depth = 2.0 * (np.arange(37) - 18), 2.0 * (np.arange(18) - 17.5)
    z, y, x = np.meshgrid(across, depth, across, indexing="ij")
    r = np.sqrt(x**2 + y**2 + z**2)
    values = np.where(r < 12, Label.GLAND, np.where(r < 30, Label.FAT, Label.AIR)).astype(np.uint8)
    path = tmp_path_factory.mktemp("labels") / "labels.nii.gz"
    write_volume(path, Volume(values, (2.0, 2.0, 2.0), (across[0], depth[0], across[0])))
    return path


def test_a_label_map_becomes_a_body(labels, tmp_path, capsys):
    out = tmp_path / "body.vtu"
    assert main(["mesh", str(labels), "--out", str(out), "--edge-mm", "12"]) == 0
    printed = capsys.readouterr().out
    assert "tetrahedra" in printed
    assert "small strain" in printed
    body = read_body(out, "mm")
    volume = volumes(body.points, body.tetrahedra)
    assert volume.sum() == pytest.approx(2 / 3 * np.pi * 30**3, rel=0.02)
    np.testing.assert_allclose(body.points[body.is_fixed, 1], 0.0, atol=1e-6)  # the image's last face
    np.testing.assert_allclose(body.nu, 0.495, atol=1e-6)
    assert ((body.E >= 0.3 - 1e-6) & (body.E <= 0.36 + 1e-6)).all()  # fat and gland of the defaults
    far = np.linalg.norm(body.points[body.tetrahedra].mean(axis=1), axis=1) > 18
    np.testing.assert_allclose(body.E[far], 0.3, rtol=1e-4)  # gland 6 mm away has no share
    mass = 1e-9 * 2 / 3 * np.pi * (1040 * 12**3 + 930 * (30**3 - 12**3))
    assert np.sum(volume * body.density) == pytest.approx(mass, rel=0.02)


@pytest.mark.parametrize(("name", "words"), [("body.stl", "must end in .vtu"), ("there.vtu", "already exists")])
def test_one_sentence(name, words, labels, tmp_path, capsys):
    (tmp_path / "there.vtu").touch()
    assert main(["mesh", str(labels), "--out", str(tmp_path / name)]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(("given", "words"), [("3=skin", 'has no segment "3"'), ("2", "must be NAME=TISSUE")])
def test_tissues_are_named_for_segments_that_are_there(given, words, labels, tmp_path, capsys):
    assert main(["mesh", str(labels), "--out", str(tmp_path / "body.vtu"), "--label-name", given]) == 2
    assert words in capsys.readouterr().err


def test_a_body_that_nothing_holds(tmp_path, capsys):
    values = np.zeros((24, 24, 24), np.uint8)
    values[6:18, 6:18, 6:18] = Label.FAT
    write_volume(tmp_path / "labels.nii.gz", Volume(values, (3.5, 3.5, 3.5), (0.0, 0.0, 0.0)))
    assert main(["mesh", str(tmp_path / "labels.nii.gz"), "--out", str(tmp_path / "body.vtu")]) == 2
    assert "nothing supports it" in capsys.readouterr().err
    assert not (tmp_path / "body.vtu").exists()

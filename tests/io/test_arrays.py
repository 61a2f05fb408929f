"""NumPy files that a case names: one array of numbers or of true and false, or one sentence."""

import io
import os

import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.files.arrays import read_array
from cicatrix.kinds.automaton.build import automaton_of
from cicatrix.kinds.registry import load_case


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6, dtype=">i4").reshape(2, 3),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.array([[True, False]]),
        np.zeros((0, 4)),
        np.float32(3.5),
    ],
    ids=["big-endian", "columns first", "bool", "empty", "one number"],
)
def test_an_array_comes_back_as_it_was_saved(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    found = read_array(tmp_path / "a.npy", "wound.mask")
    np.testing.assert_array_equal(found, array)
    assert found.dtype == np.asarray(array).dtype.newbyteorder("=")


def saved(save, *arrays, **options) -> bytes:
    stream = io.BytesIO()
    save(stream, *arrays, **options)
    return stream.getvalue()


MASK = saved(np.save, np.ones((8, 8), bool))
OBJECTS = np.array([{}, None], object)
FAULTY = {
    "npz": (saved(np.savez, a=np.ones(3)), r"is an archive of arrays \(.npz\)"),
    "pickle": (OBJECTS.dumps(), "is not a NumPy file"),
    "objects": (saved(np.save, OBJECTS, allow_pickle=True), "holds objects or named fields"),
    "fields": (saved(np.save, np.zeros(2, [("a", "f8")])), "holds objects or named fields"),
    "text": (b"1 0 1", "is not a NumPy file"),
    "empty": (b"", "is not a NumPy file"),
    "cut": (MASK[:-1], "asks for 64 bytes and 63 follow"),
    "longer": (MASK + b"x", "asks for 64 bytes and 65 follow"),
    "magic alone": (MASK[:6], "damaged header"),
    "header cut": (MASK[:40], "damaged header"),
    "version": (MASK[:6] + b"\x09" + MASK[7:], "damaged header"),
    "huge": (MASK.replace(b"(8, 8), }" + b" " * 10, b"(9999999999, 8), }" + b" " * 1), "asks for 79999999992 bytes"),
}


@pytest.mark.parametrize("name", FAULTY)
def test_what_is_no_array_is_refused_in_one_sentence(tmp_path, name):
    content, says = FAULTY[name]
    (tmp_path / "mask.npy").write_bytes(content)
    with pytest.raises(InputError, match=says) as caught:
        read_array(tmp_path / "mask.npy", "wound.mask")
    assert str(caught.value).startswith("wound.mask: mask.npy ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["/dev/zero", "pipe.npy", "folder.npy"])
def test_a_mask_is_a_regular_file(tmp_path, case_file, name):
    os.mkfifo(tmp_path / "pipe.npy")
    (tmp_path / "folder.npy").mkdir()
    path = case_file(
        'kind = "automaton"\n[lattice]\ntype = "hex"\nsize = [8, 8]\npitch_um = 10.0\n'
        f'[wound]\nmask = "{name}"\n[run]\nseed = 1\nmax_steps = 2\n'
    )
    with pytest.raises(InputError, match="a file is needed"):
        automaton_of(load_case(path))

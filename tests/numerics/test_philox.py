"""Published results of Random123 (kat_vectors, philox4x32 10); compiled and NumPy versions agree."""

import os
import subprocess
import sys

import numpy as np
import pytest

from cicatrix.core import native, philox
from cicatrix.core.random import ONE, Phase, below, site_words, threshold

PI = [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344], [0xA4093822, 0x299F31D0]
KNOWN = [
    ([0] * 4, [0] * 2, [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
    ([0xFFFFFFFF] * 4, [0xFFFFFFFF] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
    (*PI, [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1]),
]


@pytest.mark.parametrize("implementation", [philox.philox4x32, native.philox4x32], ids=["reference", "chosen"])
@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN, ids=["zeros", "ones", "pi"])
def test_known_answers(implementation, counter, key, expected):
    words = implementation(np.array(counter, np.uint32), np.array(key, np.uint32))
    assert words.dtype == np.uint32
    assert words.tolist() == expected


@pytest.mark.skipif(not native.is_native, reason="the compiled module is absent or switched off")
def test_kernel_equals_reference():
    rng = np.random.default_rng(5)
    key = rng.integers(0, ONE, 2, dtype=np.uint32)
    for shape in [(4,), (1000, 4), (3, 7, 4), (0, 4)]:
        counter = rng.integers(0, ONE, shape, dtype=np.uint32)
        np.testing.assert_array_equal(native.philox4x32(counter, key), philox.philox4x32(counter, key))
    counter = rng.integers(0, ONE, (50, 8), dtype=np.uint32)[:, ::2]  # not contiguous
    np.testing.assert_array_equal(native.philox4x32(counter, key), philox.philox4x32(counter, key))


@pytest.mark.parametrize("implementation", [philox.philox4x32, native.philox4x32], ids=["reference", "chosen"])
@pytest.mark.parametrize(("counter", "key"), [((5,), (2,)), ((3, 4), (3,)), ((4,), (2, 1))])
def test_wrong_shapes_are_refused(implementation, counter, key):
    with pytest.raises(ValueError, match="philox4x32 takes"):
        implementation(np.zeros(counter, np.uint32), np.zeros(key, np.uint32))


def test_reference_can_be_forced():
    code = "import cicatrix.core.native as n, cicatrix.core.philox as p; assert n.philox4x32 is p.philox4x32"
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "CICATRIX_NATIVE": "0"}, check=True)


def test_every_part_of_the_counter_counts():
    site = np.array([0, 1, 2**32, 2**40 + 7])
    draws = [site_words(s, site, t, f) for s in (1, 2, 2**33) for t in (0, 1) for f in Phase]
    flat = np.concatenate(draws).ravel()
    assert np.unique(flat).size == flat.size


def test_thresholds_reach_never_and_always():
    word = np.array([0, 2**32 - 1], np.uint32)
    assert not (word < threshold(0.0)).any()
    assert (word < threshold(1.0)).all()
    assert threshold(0.25) == 2**30


def test_below_is_uniform():
    word = site_words(3, np.arange(60_000), 0, Phase.EDGE_DIVISION)[:, 1]
    counts = np.bincount(below(word, 6), minlength=6)
    assert counts.size == 6
    assert abs(counts - 10_000).max() < 5 * np.sqrt(10_000 * 5 / 6)

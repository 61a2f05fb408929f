"""A quantity is used like its value: a number, or an array; a text, a table or nothing is no number."""

import copy
import math
import pickle

import numpy as np
import pytest

from cicatrix.runs.quantity import Quantity

DEPTH = Quantity(12.25, "mm", "of the dent")
COUNT = Quantity(3, "1")
CURVE = Quantity([1.0, None, 4.0], "kPa")
NOTHING = Quantity(None, "days", "still 3 % open")
TEXT = Quantity("5f3d", "", "bits of the lattice")
TABLE = Quantity({"A": 0.5, "B": 1.0}, "1")


def test_arithmetic_gives_plain_numbers():
    depth = DEPTH
    assert (depth + 1, 1 + depth, depth - 1, 20 - depth) == (13.25, 13.25, 11.25, 7.75)
    assert (2 * depth, depth / 2, 49 / depth, depth**2, depth // 2) == (24.5, 6.125, 4.0, 150.0625, 6.0)
    assert (-depth, +depth, abs(Quantity(-2.0, "mm"))) == (-12.25, 12.25, 2.0)
    assert (2**COUNT, COUNT % 2, 7 % COUNT) == (8, 1, 1)
    assert divmod(COUNT, 2) == (1, 1)
    assert type(DEPTH + 1) is type(2.0 * DEPTH) is float
    assert type(COUNT + 1) is int
    assert (round(DEPTH), round(DEPTH, 1), int(DEPTH), float(DEPTH)) == (12, 12.2, 12, 12.25)
    assert list(range(COUNT)) == [0, 1, 2]
    assert math.sqrt(DEPTH) == 3.5


def test_comparisons():
    assert DEPTH > 3
    assert 13 > DEPTH >= 12.25
    assert DEPTH == 12.25 == DEPTH
    assert DEPTH != 12
    assert max(Quantity(1.0, "mm"), Quantity(2.0, "mm")) == 2.0
    assert pytest.approx(12.25) == DEPTH
    assert pytest.approx(12.5) != DEPTH
    for number in (12.25, np.float64(12.25)):
        assert number == pytest.approx(DEPTH)
    assert pytest.approx([1.0, 2.0]) == Quantity([1.0, 2.0], "mm")
    assert math.isclose(DEPTH, 12.25)
    assert np.isclose(DEPTH, 12.25)
    assert DEPTH
    assert not Quantity(0.0, "mm")
    assert not NOTHING


def test_two_quantities_are_equal_in_all():
    assert Quantity(12.25, "mm", "of the dent") == DEPTH
    assert Quantity(12.25, "mm") != DEPTH
    assert Quantity(12.25, "cm", "of the dent") != DEPTH
    assert Quantity(None, "days", "still 3 % open") == NOTHING
    assert TEXT == "5f3d"
    assert {DEPTH: "found"}[12.25] == "found"  # equal values have equal hashes
    assert pickle.loads(pickle.dumps(DEPTH)) == copy.deepcopy(DEPTH) == DEPTH
    with pytest.raises(AttributeError):
        DEPTH.value = 1.0  # pyright: ignore


def test_units_are_not_added_up():
    assert Quantity(1.0, "mm") + Quantity(2.0, "mm") == 3.0
    assert sum([Quantity(1.0, "mm"), Quantity(2.0, "mm")]) == 3.0
    assert Quantity(6.0, "mm") / Quantity(2.0, "days") == 3.0
    with pytest.raises(TypeError, match="different units"):
        _ = Quantity(1.0, "mm") + Quantity(2.0, "days")
    with pytest.raises(TypeError, match="different units"):
        _ = Quantity(1.0, "mm") < Quantity(2.0, "cm")


def test_numpy_takes_it_for_a_number_or_an_array():
    assert np.sqrt(DEPTH) == 3.5
    assert np.asarray(DEPTH).shape == ()
    assert np.asarray([DEPTH, COUNT], float).tolist() == [12.25, 3.0]
    assert (np.array([1.0, 2.0]) * COUNT).tolist() == [3.0, 6.0]
    assert np.float64(2.0) * DEPTH == DEPTH * np.float64(2.0) == 24.5
    np.testing.assert_array_equal(CURVE + 1, [2.0, np.nan, 5.0])
    np.testing.assert_array_equal(CURVE > 2, [False, False, True])
    assert np.nanmax(CURVE) == 4.0
    assert (len(CURVE), CURVE[-1], CURVE[:1].tolist()) == (3, 4.0, [1.0])
    assert np.asarray(Quantity([1, 2], "1")).dtype.kind == "i"
    assert np.asarray(Quantity(np.eye(2), "1")).shape == (2, 2)


def test_tables_and_texts_are_reached_into():
    assert TABLE["B"] == 1.0
    assert list(TABLE) == ["A", "B"]
    assert TEXT[:2] == "5f"


@pytest.mark.parametrize(
    ("use", "says"),
    [
        (lambda: float(NOTHING), "there is no number: still 3 % open"),
        (lambda: NOTHING + 1, "there is no number: still 3 % open"),
        (lambda: f"{NOTHING:.2f}", "there is no number"),
        (lambda: TEXT + 1, "the value is a text, not a number: 5f3d"),
        (lambda: np.sqrt(TEXT), "the value is a text"),
        (lambda: 2 * TABLE, "the value is a table"),
        (lambda: Quantity([{"a": 1.0}], "1") + 1, "the value is a list"),
        (lambda: Quantity([[1.0], [1.0, 2.0]], "1") + 1, "the value is a list"),
        (lambda: Quantity(["a", "b"], "") > 1, "the value is a list"),
        (lambda: len(DEPTH), "has no length"),
        (lambda: list(DEPTH), "cannot be iterated over"),
        (lambda: range(DEPTH), "cannot be interpreted as an integer"),
    ],
)
def test_what_is_no_number_says_so(use, says):
    with pytest.raises(TypeError, match=says):
        use()


def test_how_it_looks():
    assert repr(DEPTH) == str(DEPTH) == f"{DEPTH}" == "12.25 mm (of the dent)"
    assert f"{DEPTH:.1f}" == "12.2"
    assert f"{TEXT:>6}" == "  5f3d"
    assert repr(COUNT) == "3"
    assert repr(NOTHING) == "not available (still 3 % open)"
    assert repr(CURVE) == "[1, not available, 4] kPa"
    assert repr(TABLE) == "{A: 0.5, B: 1}"
    long = repr(Quantity(np.ones((50, 50)), "mm", "a note\nof two lines " * 20))
    assert len(long) <= 100
    assert "\n" not in long
    assert Quantity("<b>", "", "a & b")._repr_html_() == "&lt;b&gt; (a &amp; b)"

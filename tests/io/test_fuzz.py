"""Damaged inputs of every kind are refused in a sentence or read right; docs/robustness.py tries each in a process of its own."""

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import robustness
from robustness_damage import DAMAGES, Damage
from robustness_inputs import KINDS, NEVER

SCRIPT = Path(robustness.__file__)


def counted(tmp_path, *words):
    """Run the script; return counts by kind, and the wrong ones."""
    path = tmp_path / "counts.json"
    command = [sys.executable, str(SCRIPT), "--json", str(path), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=1200)
    assert path.is_file(), done.stderr
    found = json.loads(path.read_text())
    assert done.returncode == (1 if found["wrong"] else 0)
    return found["counts"], found["wrong"]


def test_forty_damaged_inputs_are_refused_or_read_right(tmp_path):
    counts, wrong = counted(tmp_path, "--number", "40")
    assert sum(sum(one.values()) for one in counts.values()) == 40
    assert set(counts) == set(KINDS)
    assert wrong == []


@pytest.mark.slow
def test_four_hundred_damaged_inputs_are_refused_or_read_right(tmp_path):
    counts, wrong = counted(tmp_path)
    total = Counter()
    for one in counts.values():
        total.update(one)
    assert sum(total.values()) == 400
    assert total["accepted right"] >= 40  # damage that does no harm refuses nothing
    assert wrong == []


@pytest.fixture
def outcome():
    """Return the outcome of reading some values."""
    return lambda **values: robustness.Outcome("accepted", values={name: np.asarray(v) for name, v in values.items()})


@pytest.mark.parametrize(
    ("found", "n_changed", "verdict"),
    [
        ({"x": [1.0, 2.0, 3.0]}, 0, "accepted right"),
        ({"x": [1.0, 2.0, 4.0]}, 1, "accepted right"),
        ({"x": [1.0, 2.0, 4.0]}, 0, "wrong"),
        ({"x": [1.0, 5.0, 4.0]}, 1, "wrong"),
        ({"x": [1.0, 2.0, np.nan]}, 3, "wrong"),
        ({"x": [1.0, 2.0]}, 3, "wrong"),
        ({"y": [1.0, 2.0, 3.0]}, 3, "wrong"),
    ],
)
def test_what_is_accepted_is_judged_by_its_values(outcome, tmp_path, found, n_changed, verdict):
    judged = robustness.judged(
        "image, NRRD", tmp_path, outcome(x=[1.0, 2.0, 3.0]), outcome(**found), Damage(b"", "", n_changed)
    )
    assert judged[0] == verdict


@pytest.mark.parametrize(
    ("state", "words", "verdict"),
    [
        ("refused", "body.vtu: the file is cut short", "refused"),
        ("refused", "body.vtu cannot be read as a mesh: 1", "wrong"),
        ("refused", "", "wrong"),
        ("KeyError", "'Points'", "wrong"),
        ("hang", "no end within 10 s", "wrong"),
    ],
)
def test_what_is_not_accepted_is_judged_by_its_sentence(outcome, tmp_path, state, words, verdict):
    found = robustness.Outcome(state, words)
    assert robustness.judged("image, NRRD", tmp_path, outcome(x=1.0), found, Damage(b"", ""))[0] == verdict


def test_every_damage_can_be_made_again():
    content = b"a = 1.5\n" * 40
    for damage in DAMAGES:
        one, other = (damage(content, np.random.default_rng(7)) for _ in range(2))
        assert one == other
        assert one.content != content or one.ending


def test_the_page_has_a_row_for_every_kind():
    page = SCRIPT.with_suffix(".md").read_text(encoding="utf-8").partition("<!-- /table -->")[0]
    rows = [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| ")][1:]
    assert rows == [*KINDS, "**all**"]
    assert set(NEVER) <= set(KINDS)

"""The semantic cases of the SBML test suite, if a folder of them is at hand; run as a script with a folder, it counts.

Every case is a folder ``00001`` with ``00001-sbml-l3v2.xml`` (or of another level), ``00001-settings.txt`` and
``00001-results.csv``, as in the repository sbmlteam/sbml-test-suite, cases/semantic (LGPL-2.1). A case passes if every number is
within the tolerances of its settings; a model that is refused says why in one sentence.
"""

import csv
import os
import re
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import cicatrix
from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.files.sbml_document import read_document

FOLDER = "CICATRIX_SBML_SUITE"
LEVELS = ("l3v2", "l3v1", "l2v5", "l2v4", "l2v3", "l2v2", "l2v1", "l1v2")


def settings_of(path):
    """Return the settings of a case by name."""
    pairs = (line.split(":", 1) for line in path.read_text().splitlines() if ":" in line)
    return {key.strip(): value.strip() for key, value in pairs}


def names_of(text):
    return [one.strip() for one in text.split(",") if one.strip()]


def simulated(path, settings):
    """Return the columns of a run of our own, with the constants, by name."""
    hours = float(settings["duration"]) / 3600.0
    tables = {
        "kind": "signalling",
        "network": {"sbml": str(path), "time_unit": "s"},
        "time": {"duration_h": hours, "step_h": hours / int(settings["steps"])},
        "sensitivity": {"at": "none"},
        "solver": {"relative_tolerance": 1e-9, "absolute_tolerance": 1e-14},
    }
    run = cicatrix.build(cicatrix.case_from(tables))
    state = run.start()
    rows = [*run.rows(state), *(row for state in run.march(state) for row in run.rows(state))]
    columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    constants = dict(zip(run.model.law.input_names, run.model.inputs))
    return {key: np.full(len(rows), value) for key, value in constants.items()} | columns


def wanted(name, columns, model, settings):
    """Return a variable as the settings ask for it: species as amount or concentration."""
    one = model.getSpecies(name)
    if one is None:
        return columns[name]
    place = model.getCompartment(one.getCompartment())
    is_dense = not one.getHasOnlySubstanceUnits() and place.getSpatialDimensionsAsDouble() > 0
    if is_dense and name in names_of(settings.get("amount", "")):
        return columns[name] * columns[place.getId()]
    if not is_dense and name in names_of(settings.get("concentration", "")):
        return columns[name] / columns[place.getId()]
    return columns[name]


def verdict(folder):
    """Run one case: "passed", "wrong: ..." or "refused: ..."."""
    number = folder.name
    path = next(one for level in LEVELS if (one := folder / f"{number}-sbml-{level}.xml").is_file())
    settings = settings_of(folder / f"{number}-settings.txt")
    with (folder / f"{number}-results.csv").open() as stream:
        head, *rows = [[cell.strip() for cell in row] for row in csv.reader(stream) if row]
    right = {key: np.array(column, float) for key, column in zip(head, zip(*rows))}
    try:
        columns = simulated(path, settings)
    except (InputError, ConvergenceError) as error:
        return f"refused: {re.sub(r'[^ ]*/', '', str(error))}"
    model, absolute, relative = read_document(path).getModel(), float(settings["absolute"]), float(settings["relative"])
    for name in names_of(settings["variables"]):
        found, expected = wanted(name, columns, model, settings), right[name]
        off = ~np.isclose(found, expected, rtol=relative, atol=absolute, equal_nan=True)
        if off.any():
            k = int(np.argmax(off))
            return f"wrong: {name} is {found[k]:g} at row {k}, and should be {expected[k]:g}"
    return "passed"


def counted(root):
    """Run all cases in a folder; return the verdict of each by its number."""
    return {one.name: verdict(one) for one in sorted(root.iterdir()) if (one / f"{one.name}-settings.txt").is_file()}


@pytest.mark.slow
@pytest.mark.skipif(FOLDER not in os.environ, reason=f"{FOLDER} names no folder of semantic cases")
def test_no_case_of_the_suite_is_wrong():
    found = counted(Path(os.environ[FOLDER]))
    assert not {number: words for number, words in found.items() if words.startswith("wrong")}
    assert sum(words == "passed" for words in found.values()) > 0.85 * len(found)


if __name__ == "__main__":
    verdicts = counted(Path(sys.argv[1]))
    for case, said in verdicts.items():
        if said != "passed":
            print(case, said)
    kinds = Counter(re.sub(r'"[^"]*"|\b\d+\b', "...", said) for said in verdicts.values())
    for words, times in kinds.most_common():
        print(f"{times:5d}  {words}")

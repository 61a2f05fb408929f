"""Cases made and changed in Python are checked as those of files are, and say what is wrong in the same sentences."""

from pathlib import Path

import numpy as np
import pytest

from cicatrix import InputError, case_from, load_case
from cicatrix.cases.nested import put
from cicatrix.cases.parameters import replaced
from cicatrix.kinds.automaton.case import AutomatonCase, RulesTable
from cicatrix.kinds.material_point.case import PointCase
from cicatrix.kinds.registry import check_case

EXAMPLES = Path(__file__).parents[2] / "examples"
TABLES = {"kind": "automaton", "lattice": {"size": [64, 64]}, "wound": {"radius_um": 120.0}}
FILE = 'kind = "automaton"\n[lattice]\nsize = [64, 64]\n[wound]\nradius_um = 120.0\n'
CASE = case_from(TABLES)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"rules.p_edge": 1.5}, "rules.p_edge must be at least 0 and at most 1; got 1.5"),
        ({"rules.p_edg": 0.5}, "rules.p_edg is not a known key; did you mean rules.p_edge?"),
        ({"ruls.p_edge": 0.5}, "ruls is not a known key; did you mean rules?"),
        ({"run.seed": 1.5}, "run.seed must be a whole number; got 1.5"),
        ({"kind": "wound"}, 'kind must be "automaton"; got "wound"'),
        ({"wound.radius_um": None}, "wound.radius_um or mask must be given, one of the two"),
        ({"lattice.type": "fcc"}, 'lattice.size must be 3 numbers for type = "fcc"; got [64, 64]'),
        ({"lattice.size.7": 3}, "lattice.size.7: size is a list; name one of 0 to 1, such as size.0"),
        ({"rules.p_edge.low": 0.1}, "rules.p_edge.low: rules.p_edge is not a table"),
    ],
)
def test_a_wrong_change_is_one_sentence(changes, sentence):
    case = CASE.changed({"rules.p_edge": 0.2})
    with pytest.raises(InputError) as error:
        case.changed(changes)
    assert str(error.value) == sentence


def test_a_missing_file_is_named():
    with pytest.raises(InputError, match=r"^cue\.W names W\.npy, but there is no such file or folder$"):
        CASE.changed({"cue.W": "W.npy"})


def test_the_sentences_are_those_of_a_file(case_file):
    faults = check_case(case_file(FILE + "[rules]\np_edge = 2.0\n[runs]\nseed = 1\n"))
    for make in (
        lambda: AutomatonCase(**TABLES, rules={"p_edge": 2.0}, runs={"seed": 1}),  # pyright: ignore
        lambda: case_from({**TABLES, "rules": {"p_edge": 2.0}, "runs": {"seed": 1}}),
        lambda: CASE.changed({"rules.p_edge": 2.0, "runs.seed": 1}),
        lambda: CASE.model_copy(update={"rules": {"p_edge": 2.0}, "runs": {"seed": 1}}),
    ):
        with pytest.raises(InputError) as error:
            make()
        assert str(error.value) == "; ".join(faults)


def test_a_change_is_what_the_file_would_hold(case_file):
    by_file = load_case(case_file(FILE + "[rules]\np_edge = 0.5\nlayer_sites = 4\n"))
    assert CASE.changed({"rules.p_edge": 0.5, "rules.layer_sites": 4}) == by_file
    assert CASE.changed({"rules": {"p_edge": 0.5, "layer_sites": 4}}) == by_file
    assert CASE.model_copy(update={"rules": RulesTable(p_edge=0.5, layer_sites=4)}) == by_file
    assert AutomatonCase(**TABLES, rules=RulesTable(p_edge=0.5, layer_sites=4)) == by_file
    assert by_file.changed({"rules.p_edge": None, "rules.layer_sites": None}) == CASE
    assert CASE.rules.changed({"p_edge": 0.5}).p_edge == 0.5
    assert CASE.rules.p_edge == 0.2  # the first case is what it was


def test_numbers_of_numpy_are_numbers():
    case = CASE.changed({"rules.p_edge": np.float32(0.25), "run.seed": np.arange(3)[2], "lattice.size": np.full(2, 80)})
    assert (case.rules.p_edge, case.run.seed, case.lattice.size) == (0.25, 2, (80, 80))
    assert case_from({**TABLES, "run": {"seed": np.int64(2)}}).seed == 2


@pytest.mark.parametrize(
    "path", [*sorted(EXAMPLES.glob("*/*.toml")), EXAMPLES / "material-point.toml"], ids=lambda p: p.stem
)
def test_changing_nothing_changes_nothing(path):
    case = load_case(path)
    same = case.changed({})
    assert same == case
    assert same.model_fields_set == case.model_fields_set
    lines = repr(case).splitlines()
    assert len(lines) <= 15
    assert max(map(len, lines)) <= 100


def test_parameters_of_laws_are_changed_by_their_place():
    case = load_case(EXAMPLES / "material-point.toml")
    assert isinstance(case, PointCase)
    assert case.changed({"law.0.mu_kPa": 2.5}).law[0].mu_kPa == 2.5
    with pytest.raises(InputError, match=r"law\[0\]\.mu is not a known key; did you mean law\[0\]\.mu_kPa\?"):
        case.changed({"law.0.mu": 2.5})
    assert replaced(case, {"law.0.mu_kPa": -1.0}).law[0].mu_kPa == -1.0  # not checked: it may be traced by JAX


def test_nothing_is_set_in_place():
    with pytest.raises(AttributeError, match=r"does not change; take case\.changed"):
        CASE.rules.p_edge = 0.3


def test_how_a_case_looks():
    case = CASE.changed({"rules.p_edge": 0.5, "lattice.type": "hex"})  # the default
    assert repr(case).splitlines() == [
        "AutomatonCase: defaults but for",
        "  lattice.size = [64, 64]",
        "  wound.radius_um = 120.0",
        "  rules.p_edge = 0.5",
    ]
    assert "<td>rules.p_edge</td><td>0.5</td>" in case._repr_html_()


def test_removing_a_value_that_is_not_there_makes_nothing():
    tables = {"kind": "wound", "law": [{"mu_kPa": 1.0}, {"mu_kPa": 2.0}]}
    put(tables, ["body", "mesh_unit"], None, "changed")
    put(tables, ["law", "0"], None, "changed")
    assert tables == {"kind": "wound", "law": [{"mu_kPa": 2.0}]}

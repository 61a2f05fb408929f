"""The page on Python, docs/python.md: its code runs in order, and prints what the page shows."""

import re
from importlib.util import find_spec
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "python.md"


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Names that the page's code has bound, what it printed, and its folder; code that needs a missing package is left out."""
    folder = tmp_path_factory.mktemp("page")
    names, printed = {}, []
    names["print"] = lambda *values: printed.append(" ".join(map(str, values)))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
            needed = re.match(r"# needs (\w+)", code)
            if needed is None or find_spec(needed[1]):
                exec(compile(code, str(PAGE), "exec"), names)
    plt.close("all")
    return names, "\n".join(printed), folder


def test_it_prints_what_the_page_shows(ran):
    _, printed, _ = ran
    (shown,) = re.findall(r"```text\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    for line in shown.splitlines():
        assert line.strip() == "..." or line in printed
    assert "rules.p_edg is not a known key; did you mean rules.p_edge?" in printed
    assert "rules.p_edge = 0.1" in printed


def test_likelier_division_closes_the_wound_sooner(ran):
    names, _, folder = ran
    assert (np.diff(names["steps"].mean(axis=1)) < 0).all()
    assert (folder / "python-sweep.png").stat().st_size > 10_000
    assert PAGE.with_name("python-sweep.png").is_file()


def test_what_the_run_left_is_what_the_stepped_simulation_has(ran):
    names, _, folder = ran
    assert names["state"].step == np.searchsorted(names["results"].history["closed_fraction"], 0.5, side="right")
    assert names["opened"].folder == Path("my-run")
    assert (folder / "my-run" / "manifest.json").is_file()


def test_the_law_by_hand(ran):
    """Uniaxial strain 1.3: I1_bar = J^(-2/3) (J^2 + 2), half of I1_bar - 3 by mu and of (J - 1)^2 by kappa."""
    names = ran[0]
    J = 1.3
    by_mu, by_kappa = 0.5 * (J ** (-2 / 3) * (J**2 + 2) - 3), 0.5 * (J - 1) ** 2
    assert float(names["slope"].mu) == pytest.approx(by_mu)
    assert float(names["slope"].kappa) == pytest.approx(by_kappa)
    assert float(names["energy"][3]) == pytest.approx(2.0 * by_mu + 50.0 * by_kappa)

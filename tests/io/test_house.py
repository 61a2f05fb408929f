"""Commands of the README that CI uses, versions, what pages say of files and layers, and the public names of the package."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import cicatrix

ROOT = Path(__file__).parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "papers").glob("*/README.md")]


def between(text, marker):
    start, end = f"<!-- {marker} -->", f"<!-- /{marker} -->"
    assert text.count(start) == text.count(end) == 1
    lines = text.partition(start)[2].partition(end)[0].strip().splitlines()
    assert (lines[0], lines[-1]) == ("```bash", "```")
    return lines[1:-1]


def test_readme_has_its_two_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert between(text, "demo-command")[-1].endswith(".venv/bin/pip install . && .venv/bin/cicatrix demo")
    assert "pytest" in between(text, "test-command")[-1]


def test_ci_runs_the_command_of_the_readme():
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "<!-- test-command -->" in script
    assert "pytest -n" not in script  # so that CI and the README cannot differ


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == cicatrix.__version__
    assert f"version: {cicatrix.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_decisions_are_numbered_once():
    numbers = [page.name[:4] for page in (ROOT / "docs" / "decisions").glob("[0-9]*.md")]
    assert numbers
    assert len(set(numbers)) == len(numbers)


def test_every_decision_is_in_the_index():
    index = (ROOT / "docs" / "decisions" / "README.md").read_text(encoding="utf-8")
    assert [p.name for p in (ROOT / "docs" / "decisions").glob("[0-9]*.md") if f"]({p.name})" not in index] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_a_page_lead_to_files(page):
    links = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    assert [to for to in links if not to.startswith("http") and not (page.parent / to).exists()] == []


@pytest.mark.parametrize("page", ["ARCHITECTURE.md", "CONTRIBUTING.md"])
def test_files_that_a_map_names_exist(page):
    """A path is one of the root or of the package; ``package/module.name`` is a name in a module.

    Folders beside the project (``../``) may be missing.
    """
    text = (ROOT / page).read_text(encoding="utf-8")
    paths = re.findall(r"`([\w./-]+/[\w./-]*)`", text) + re.findall(r"(?<= )(\w+/\w+)(?= )", between_fences(text))

    def is_there(path):
        module = re.sub(r"(?<=\w)\.\w+$|$", ".py", path, count=1)
        return any((base / one).exists() for base in (ROOT, ROOT / "src" / "cicatrix") for one in (path, module))

    assert paths
    assert [path for path in paths if not path.startswith("../") and not is_there(path)] == []


def between_fences(text):
    return "\n".join(re.findall(r"```text\n(.+?)```", text, flags=re.S))


def test_the_layers_of_the_architecture_are_those_of_the_contract():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    blocks = [block.strip().splitlines() for block in re.findall(r"```text\n(.+?)```", text, flags=re.S)]
    for contract in contracts:
        assert [layer.replace("cicatrix.", "") for layer in contract["layers"]] in blocks


def test_names_of_the_package():
    assert cicatrix.load_case.__module__ == "cicatrix.kinds.registry"
    assert cicatrix.simulate.__module__ == "cicatrix.kinds.simulate"
    assert cicatrix.open_run.__module__ == "cicatrix.runs.results"
    assert dir(cicatrix) == sorted(cicatrix.__all__)
    assert all(getattr(cicatrix, name) is not None for name in cicatrix.__all__)
    assert set(cicatrix.__all__) == {*cicatrix.HOMES, "__version__"}
    with pytest.raises(AttributeError, match=r"no attribute 'simulat'; did you mean simulate\?"):
        _ = cicatrix.simulat  # pyright: ignore
    with pytest.raises(AttributeError, match="no attribute 'heal'; public are ConvergenceError, InputError"):
        _ = cicatrix.heal  # pyright: ignore


def test_the_package_says_that_it_has_types():
    assert Path(cicatrix.__file__).with_name("py.typed").is_file()


def test_importing_the_package_alone_is_light():
    code = "import sys, cicatrix; print(sorted({'numpy', 'jax', 'pydantic'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def requirements():
    """Return name -> bounds of every library that pyproject.toml asks for, without markers and extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [*project["dependencies"], *(line for lines in project["optional-dependencies"].values() for line in lines)]
    parts = [re.fullmatch(r"([\w.-]+)(?:\[[\w,]+\])?([^;]*)(?:;.*)?", line.strip()) for line in asked]
    return {part[1]: part[2].strip() for part in parts if part[1] != "cicatrix"}


def rows_of(text, marker):
    lines = text.partition(f"<!-- {marker} -->")[2].partition(f"<!-- /{marker} -->")[0].strip().splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_every_library_has_its_line_among_the_licences():
    rows = rows_of((ROOT / "docs" / "licences.md").read_text(encoding="utf-8"), "libraries")
    assert {row[0]: row[1].strip("`") for row in rows} == requirements()
    assert all(len(row) == 5 and all(row) for row in rows)
    bounded = {row[0] for row in rows if "<" in row[1]}
    assert {row[0] for row in rows if not row[4].startswith("none")} == bounded
    assert [row[0] for row in rows if re.search(r"(?<!L)GPL", row[2])] == []


def test_the_versions_of_python_are_named_alike():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = [word.split()[-1] for word in project["classifiers"] if re.search(r"Python :: 3\.\d+$", word)]
    tasks = re.search(r"PYTHONS = \((.*?)\)", (ROOT / "noxfile.py").read_text(encoding="utf-8"))[1]
    assert re.findall(r"[\d.]+", tasks) == named
    assert project["requires-python"] == f">={named[0]}"
    assert f"{', '.join(named[:-1])} and {named[-1]}." in (ROOT / "docs" / "licences.md").read_text(encoding="utf-8")

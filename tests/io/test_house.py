"""The README's commands are found by CI, and a plain checkout holds what it promises."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import cicatrix

ROOT = Path(__file__).parents[2]


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
    assert "pytest -n" not in script  # or the two could drift apart


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == cicatrix.__version__
    assert f"version: {cicatrix.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_decisions_are_numbered_once():
    numbers = [page.name[:4] for page in (ROOT / "docs" / "decisions").glob("[0-9]*.md")]
    assert numbers
    assert len(set(numbers)) == len(numbers)


def test_names_of_the_package():
    assert cicatrix.load_case.__module__ == "cicatrix.kinds.registry"
    assert cicatrix.simulate.__module__ == "cicatrix.kinds.simulate"
    with pytest.raises(AttributeError, match="no attribute 'heal'"):
        _ = cicatrix.heal  # pyright: ignore


def test_importing_the_package_alone_is_light():
    code = "import sys, cicatrix; print(sorted({'numpy', 'jax', 'pydantic'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"

"""What a process imports and starts before it computes, counted in modules and not in seconds."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = ("jax", "equinox", "numpy", "scipy", "skfem", "matplotlib", "SimpleITK", "pydicom", "mmgpy", "meshio", "rich")
DISC = Path(__file__).parents[2] / "examples" / "automaton-disc.toml"

COMMAND = "from cicatrix.cli.main import main; assert main({arguments}) == 0"
EVERY_MODULE = """
import importlib, pkgutil, cicatrix
for module in pkgutil.walk_packages(cicatrix.__path__, "cicatrix."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
from jax._src import xla_bridge
assert not xla_bridge.backends_are_initialized()
"""


def modules_after(code):
    """Names of top-level modules that a process has imported once it has run some code."""
    told = "\nimport json, sys; print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code + told], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize(
    "code",
    [
        "import cicatrix",
        *(
            COMMAND.format(arguments=words)
            for words in (["--help"], ["--version"], ["run", "--help"], ["bench", "--help"])
        ),
        COMMAND.format(arguments=["check", str(DISC)]),
    ],
    ids=["import", "help", "version", "help of a verb", "help of bench", "check"],
)
def test_light_start(code):
    assert not set(HEAVY) & set(modules_after(code))


def test_a_run_of_mechanics_imports_no_image_library():
    found = modules_after("import cicatrix.cli.run, cicatrix.kinds.simulate, cicatrix.kinds.equilibrium.run")
    assert not {"SimpleITK", "pydicom", "mmgpy", "diffrax", "pyamg"} & set(found)
    assert "jax" in found


def test_importing_every_module_starts_no_backend():
    """So that a process may fork after it has imported the package."""
    modules_after(EVERY_MODULE)


def test_a_law_makes_numbers_of_64_bits():
    code = "import cicatrix.materials.neo_hookean, jax.numpy as jnp; assert jnp.zeros(1).dtype == 'float64'"
    modules_after(code)

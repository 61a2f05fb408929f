"""Benchmark of start-up: CPU seconds of complete ``cicatrix`` processes, compared with Python, NumPy and JAX alone."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..core.errors import CicatrixError
from ..core.units import density_kg_m3
from ..files.vtu import write_vtu
from ..materials.neo_hookean import young_from_moduli
from ..numerics.compiler import CACHE_VARIABLE
from .measurement import Measurement
from .mechanics import DENSITY, EDGES_MM, NU, half_ellipsoid

REPEATS = 5  # the shortest time is reported: other load on the machine only adds to it
SIZE = "34k dofs"  # of bench mechanics
AUTOMATON = 'kind = "automaton"\n[wound]\nradius_um = 1200.0\n'
EQUILIBRIUM = 'kind = "equilibrium"\n[body]\nmesh = "body.vtu"\n'
CEILINGS = {"python": "pass", "import numpy": "import numpy", "import jax": "import jax"}


def start() -> Iterator[Measurement]:
    """Measure ``--help``, ``check``, and a first and a repeated run of an equilibrium case with an initially empty cache."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "disc.toml").write_text(AUTOMATON)
        (folder / "body.toml").write_text(EQUILIBRIUM)
        n_unknowns = _write_body(folder / "body.vtu")
        for what, code in CEILINGS.items():
            yield Measurement(what, min(_seconds(folder, "-c", code) for _ in range(REPEATS)), "s", "ceiling, CPU")
        for words in (("--help",), ("check", "disc.toml")):
            least = min(_seconds(folder, "-m", "cicatrix", *words) for _ in range(REPEATS))
            yield Measurement(f"cicatrix {' '.join(words)}", least, "s", "CPU")
        first, *later = [
            _seconds(folder, "-m", "cicatrix", "run", "body.toml", "--out", f"run-{k}") for k in range(REPEATS)
        ]
        note = f"CPU; equilibrium, {n_unknowns} unknowns"
        yield Measurement("cicatrix run, the first", first, "s", f"{note}, nothing compiled before")
        yield Measurement("cicatrix run, a later one", min(later), "s", note)
        without = _seconds(folder, "-m", "cicatrix", "run", "body.toml", "--out", "without", cache="off")
        yield Measurement("cicatrix run, CICATRIX_CACHE=off", without, "s", note)


def _write_body(path: Path) -> int:
    """Write the half-ellipsoid of ``bench mechanics`` as the mesh file of a case; return the number of unknowns."""
    body = half_ellipsoid(EDGES_MM[SIZE])
    space = body.discretization.space
    is_fixed = np.zeros(space.n_nodes, bool)
    is_fixed[body.discretization.fixed_nodes] = True
    E, _ = young_from_moduli(body.law.mu[:, 0], body.law.kappa[:, 0])
    tissue = {
        "youngs_modulus_kPa": np.asarray(E),
        "poisson_ratio": np.full(space.n_elements, NU),
        "density_kg_m3": np.full(space.n_elements, density_kg_m3(DENSITY)),
    }
    write_vtu(path, space.positions, space.element_nodes, {"fixed": is_fixed}, tissue)
    return body.discretization.supports(False).n_unknowns


def _seconds(folder: Path, *arguments: str, cache: str = "cache") -> float:
    """Run a Python process and return its CPU time, user plus system [s]."""
    env = os.environ | {CACHE_VARIABLE: cache if cache == "off" else str(folder / cache)}
    with (folder / "output.txt").open("w") as output:
        child = subprocess.Popen([sys.executable, *arguments], cwd=folder, env=env, stdout=output, stderr=output)
        _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise CicatrixError(f"{' '.join(arguments)} ended with {(folder / 'output.txt').read_text()[-500:]}")
    return usage.ru_utime + usage.ru_stime

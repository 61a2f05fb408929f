"""Compiled code that is kept: where, how much, and that it gives the same bits."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cicatrix.numerics import compiler

SOLVE = """
import sys, jax, numpy as np, skfem
from cicatrix.geometry.tetrahedra import oriented
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.solids import solid_body
mesh = skfem.MeshTet.init_tensor(*[np.linspace(0.0, 20.0, 3)] * 3)
points, n = mesh.p.T.copy(), mesh.nelements
one = np.ones(n)
body = solid_body(points, oriented(points, mesh.t.T), points[:, 2] > 19.9, 3.0 * one, 0.45 * one, 1e-6 * one)
hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.append(name) if name.endswith("cache_hits") else None)
x, _ = Equilibrium().loaded(body, body.discretization.space.positions, np.array([0.0, 0.0, -9810.0]))
np.savez(sys.argv[1], x=x, hits=len(hits))
"""


def solved(tmp_path, name, cache):
    """Run one solve in a process of its own with this cache: positions, compilations that were read, and stderr."""
    out = tmp_path / f"{name}.npz"
    env = os.environ | {compiler.CACHE_VARIABLE: str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", SOLVE, out], capture_output=True, text=True, env=env, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    found = np.load(out)
    return found["x"], int(found["hits"]), done.stderr


@pytest.mark.skipif(compiler.cache_folder() is None, reason="no cache here: an early jaxlib, or CICATRIX_CACHE=off")
def test_what_is_read_back_gives_the_same_bits(tmp_path):
    cache = tmp_path / "cache"
    without, none, _ = solved(tmp_path, "without", "off")
    assert none == 0
    assert not cache.exists()
    first, _, _ = solved(tmp_path, "first", cache)
    for broken in list(cache.rglob("*-cache"))[:1]:  # as a process leaves it that was killed while it wrote
        broken.write_bytes(broken.read_bytes()[:100])
    second, read, said = solved(tmp_path, "second", cache)
    assert read > 0
    assert said == ""
    assert without.tobytes() == first.tobytes() == second.tobytes()


def test_a_folder_that_cannot_be_written_is_done_without(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(compiler.CACHE_VARIABLE, str(tmp_path / "file" / "cache"))
    assert compiler.cache_folder() is None
    _, read, said = solved(tmp_path, "solved", tmp_path / "file" / "cache")
    assert (read, said) == (0, "")


def test_the_folder_follows_the_system_unless_it_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(compiler, "FIRST_JAXLIB", (0,))
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv(compiler.CACHE_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiler.cache_folder().parent == tmp_path / "cicatrix"
    monkeypatch.setenv(compiler.CACHE_VARIABLE, str(tmp_path / "named"))
    assert compiler.cache_folder().parent == tmp_path / "named"
    monkeypatch.setenv(compiler.CACHE_VARIABLE, "off")
    assert compiler.cache_folder() is None


def test_code_of_another_processor_lies_in_another_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(compiler, "FIRST_JAXLIB", (0,))
    monkeypatch.setenv(compiler.CACHE_VARIABLE, str(tmp_path))
    here = compiler.cache_folder()
    monkeypatch.setattr(compiler, "PROCESSOR_KEYS", ())
    assert compiler.cache_folder() != here or not Path("/proc/cpuinfo").exists()


def test_the_oldest_goes_where_there_is_too_much(tmp_path, monkeypatch):
    monkeypatch.setattr(compiler, "MAX_CACHE_BYTES", 1000)
    for age, name in enumerate("abc"):
        file = tmp_path / "jaxlib" / f"{name}-cache"
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(bytes(400))
        os.utime(file, (1e9 - age, 1e9 - age))
    compiler._prune(tmp_path)
    assert [file.name for file in tmp_path.rglob("*-cache")] == ["a-cache"]

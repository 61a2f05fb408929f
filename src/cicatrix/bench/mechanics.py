"""The benchmark of mechanics: a half-ellipsoid breast of three stiffnesses, sideways under gravity, beside CalculiX."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..files.atomic import write_bytes
from ..files.calculix import calculix_deck, calculix_displacements
from ..geometry.labels import Label
from ..geometry.meshing3d import mesh_body
from ..geometry.volume import Volume
from ..materials.neo_hookean import NeoHookean
from ..mechanics.body import Body
from ..mechanics.equilibrium import Equilibrium
from ..mechanics.solids import solid_body
from ..numerics.linear import LinearSolver
from ..runs.checkpoints import npz_bytes
from .measurement import Measurement

SEMI_AXES_MM = np.array([65.0, 65.0, 50.0])
EDGES_MM = {"34k dofs": 11.1, "118k dofs": 6.55, "380k dofs": 4.18}
VOXELS = 8  # per edge, about: the skin is as fine as its voxels
E_KPA, NU, DENSITY = (1.0, 10.0, 60.0), 0.49, 1e-6  # fat, gland, tumour; kg/mm^3
GRAVITY = np.array([0.0, -9810.0, 0.0])  # mm/s^2
PEER_SECONDS = 1200.0  # CalculiX is not waited for longer
PEER_FIRST = 0.25  # of the load: it comes through sooner than when it tries the whole, half or a tenth first
STAGES = {"linearise": (Body, "linearised"), "residual": (Body, "residual"), "factor": (LinearSolver, "factor")}
STIFFER = 1.05  # the second solve: as much as a healing cycle changes


def mechanics() -> Iterator[Measurement]:
    """Seconds per stage, factorisations, Krylov steps, memory: each size in its own process, then CalculiX on the same mesh."""
    with tempfile.TemporaryDirectory() as name:
        for size, edge in EDGES_MM.items():
            folder = Path(name, size.replace(" ", "-"))
            folder.mkdir()
            yield from _size(size, edge, folder)


def half_ellipsoid(edge_mm: float) -> Body:
    """A breast clamped at its back, meshed as patients are: fat, gland within 0.6 of the axes, a tumour of 16 mm."""
    voxel = edge_mm / VOXELS
    half, deep = int(72.0 / voxel), int(54.0 / voxel)
    across = voxel * np.arange(-half, half + 1)
    z, y, x = np.meshgrid(voxel * (np.arange(deep) + 0.5), across, across, indexing="ij")
    inside = ((np.stack([x, y, z], axis=-1) / SEMI_AXES_MM) ** 2).sum(axis=-1) < 1.0
    values = np.where(inside, Label.FAT, Label.AIR).astype(np.uint8)
    labels = Volume(values, (voxel,) * 3, (across[0], across[0], 0.5 * voxel))
    mesh = mesh_body(labels, edge_mm)
    centres = mesh.nodes[mesh.tetrahedra].mean(axis=1)
    E = np.where(np.linalg.norm(centres / SEMI_AXES_MM, axis=1) < 0.6, E_KPA[1], E_KPA[0])
    E[np.linalg.norm(centres - (15.0, 10.0, 25.0), axis=1) < 8.0] = E_KPA[2]
    held = np.zeros(len(mesh.nodes), bool)
    held[mesh.held_nodes] = True
    same = np.ones(len(E))
    return solid_body(mesh.nodes, mesh.tetrahedra, held, E, NU * same, DENSITY * same)


def _size(size: str, edge_mm: float, folder: Path) -> Iterator[Measurement]:
    """Ours in a fresh process, whose memory is then its own, and CalculiX."""
    _, usage = _run([sys.executable, "-m", __spec__.name, str(edge_mm), str(folder)], folder)
    found = np.load(folder / "found.npz")
    for name in found["names"]:
        value, unit, note = found[f"{name}.value"], str(found[f"{name}.unit"]), str(found[f"{name}.note"])
        yield Measurement(f"{size}: {name}", float(value), unit, note)
    yield Measurement(f"{size}: peak memory", usage.ru_maxrss * 1e-6, "GB", "of the process, meshing included")
    if shutil.which("ccx") is None:
        yield Measurement(f"{size}: CalculiX", float("nan"), "s", "not installed: apt-get install calculix-ccx")
        return
    seconds, usage = _run(["ccx", "body"], folder, PEER_SECONDS)
    peer = calculix_displacements((folder / "body.dat").read_text(), len(found["u"]))
    cpu = usage.ru_utime + usage.ru_stime
    if len(peer) < len(found["u"]):
        yield Measurement(f"{size}: CalculiX", cpu, "s", f"CPU, {seconds:.0f} s, and not through to the whole load")
        return
    ratio = cpu / float(found["first solve.value"])
    yield Measurement(f"{size}: CalculiX", cpu, "s", f"CPU; {ratio:.1f} times ours, {usage.ru_maxrss * 1e-6:.2f} GB")
    gap = float(np.abs(peer - found["u"]).max())
    yield Measurement(f"{size}: largest difference from CalculiX", gap, "mm")


def _run(command: list[str], folder: Path, limit: float | None = None) -> tuple[float, Any]:
    """Run to the end or the limit: seconds and what it used; one thread, as ours."""
    start = time.perf_counter()
    with (folder / "output.txt").open("w") as output:
        child = subprocess.Popen(
            command, cwd=folder, stdout=output, stderr=subprocess.STDOUT, env={**os.environ, "OMP_NUM_THREADS": "1"}
        )
        while True:
            pid, status, usage = os.wait4(child.pid, os.WNOHANG)
            if pid:
                break
            if limit is not None and time.perf_counter() - start > limit:
                child.kill()
            time.sleep(0.05)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode and limit is None:
        raise RuntimeError((folder / "output.txt").read_text()[-2000:])
    return time.perf_counter() - start, usage


class _Clock:
    """CPU seconds spent in some methods, and in what is measured around them."""

    def __init__(self) -> None:
        self.spent = dict.fromkeys(STAGES, 0.0)
        for name, (owner, method) in STAGES.items():
            setattr(owner, method, self._timed(name, getattr(owner, method)))

    def _timed(self, name: str, method: Callable) -> Callable:
        def timed(*args, **options):
            start = time.process_time()
            try:
                return method(*args, **options)
            finally:
                self.spent[name] += time.process_time() - start

        return timed


def _measure(edge_mm: float) -> tuple[list[Measurement], np.ndarray, str]:
    """Solve twice: from nothing, and again with tissue that is a little stiffer."""
    start = time.process_time()
    body = half_ellipsoid(edge_mm)
    rows = [Measurement("mesh", time.process_time() - start, "s", f"CPU; {body.frame.space.n_elements} tetrahedra")]
    X = body.frame.space.positions
    start = time.process_time()
    body.residual(X, X, GRAVITY)
    body.linearised(X, X, body.dilation(X, X), in_plane=False)
    rows.append(Measurement("compile", time.process_time() - start, "s", "CPU; kernels and pattern, once"))
    solver, clock = Equilibrium(1e-8), _Clock()
    start = time.process_time()
    x, report = solver.loaded(body, X, GRAVITY)
    first = time.process_time() - start
    n_free = body.frame.solved(False)[0].size
    note = f"CPU; {n_free} free dofs, {report.iterations} Newton iterations to 1e-8, up to {np.abs(x - X).max():.1f} mm"
    rows.append(Measurement("first solve", first, "s", note))
    rows += [Measurement(f"of it, {name}", value, "s", "CPU") for name, value in clock.spent.items()]
    rows.append(Measurement("factorisations", solver.factorizations, "1"))
    rows.append(Measurement("Krylov steps", solver.krylov_steps, "1"))
    law = NeoHookean(STIFFER * body.law.mu, STIFFER * body.law.kappa)
    stiffer = body.with_tissue(law, body.density, body.fraction)
    start, done = time.process_time(), solver.factorizations
    _, report = solver.loaded(stiffer, X, GRAVITY, x)
    second = time.process_time() - start
    anew = solver.factorizations - done
    note = f"CPU; {second / first:.2f} of the first, {report.iterations} iterations, {anew} factorisations"
    rows.append(Measurement(f"second solve, {STIFFER:g} times as stiff", second, "s", note))
    return rows, x - X, calculix_deck(body, GRAVITY, PEER_FIRST)


def main() -> None:
    """Measure one size and leave the numbers, the displacements and CalculiX's input in a folder."""
    edge_mm, folder = float(sys.argv[1]), Path(sys.argv[2])
    rows, u, deck = _measure(edge_mm)
    arrays = {"u": u, "names": np.array([row.what for row in rows])}
    for row in rows:
        arrays |= {f"{row.what}.value": np.array(row.value), f"{row.what}.unit": np.array(row.unit)}
        arrays[f"{row.what}.note"] = np.array(row.note)
    write_bytes(folder / "found.npz", npz_bytes(arrays))
    (folder / "body.inp").write_text(deck)


if __name__ == "__main__":
    main()

"""Benchmark of mechanics, compared with CalculiX: a half-ellipsoid breast with three stiffnesses under sideways gravity."""

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
VOXELS = 8  # approximate number of voxels per element edge; it determines the resolution of the skin
E_KPA, NU, DENSITY = (1.0, 10.0, 60.0), 0.49, 1e-6  # fat, gland, tumour; kg/mm^3
GRAVITY = np.array([0.0, -9810.0, 0.0])  # mm/s^2
PEER_SECONDS = 1200.0  # time limit for CalculiX
PEER_FIRST = 0.25  # CalculiX's first load increment; with it the solve is faster than with 1, 0.5 or 0.1
STAGES = {"linearise": (Body, "linearised"), "residual": (Body, "residual"), "factor": (LinearSolver, "factor")}
STIFFER = 1.05  # stiffness factor of the second solve: about the change in one healing cycle


def mechanics() -> Iterator[Measurement]:
    """Measure time per stage of a solve, factorisations, Krylov iterations and memory, then CalculiX on the same mesh.

    Each mesh size runs in its own process.
    """
    with tempfile.TemporaryDirectory() as name:
        for size, edge in EDGES_MM.items():
            folder = Path(name, size.replace(" ", "-"))
            folder.mkdir()
            yield from _size(size, edge, folder)


def half_ellipsoid(edge_mm: float) -> Body:
    """Return a half-ellipsoid breast clamped at its back, meshed by the method used for patients' images.

    It consists of fat, with gland in the inner ellipsoid (0.6 times the semi-axes) and a tumour of 16 mm diameter.
    """
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
    held[mesh.constrained_nodes] = True
    same = np.ones(len(E))
    return solid_body(mesh.nodes, mesh.tetrahedra, held, E, NU * same, DENSITY * same)


def _size(size: str, edge_mm: float, folder: Path) -> Iterator[Measurement]:
    """Measure the solves on one mesh: cicatrix in a new process (so that its peak memory is known), then CalculiX."""
    _, usage = _run([sys.executable, "-m", __spec__.name, str(edge_mm), str(folder)], folder)
    found = np.load(folder / "found.npz")
    for name in found["names"]:
        value, unit, note = found[f"{name}.value"], str(found[f"{name}.unit"]), str(found[f"{name}.note"])
        yield Measurement(f"{size}: {name}", float(value), unit, note)
    yield Measurement(f"{size}: peak memory", usage.ru_maxrss * 1e-6, "GB", "peak of the process, including meshing")
    if shutil.which("ccx") is None:
        yield Measurement(f"{size}: CalculiX", float("nan"), "s", "not installed: apt-get install calculix-ccx")
        return
    seconds, usage = _run(["ccx", "body"], folder, PEER_SECONDS)
    peer = calculix_displacements((folder / "body.dat").read_text(), len(found["u"]))
    cpu = usage.ru_utime + usage.ru_stime
    if len(peer) < len(found["u"]):
        yield Measurement(f"{size}: CalculiX", cpu, "s", f"CPU, {seconds:.0f} s; it did not reach the full load")
        return
    ratio = cpu / float(found["first solve.value"])
    yield Measurement(
        f"{size}: CalculiX", cpu, "s", f"CPU; {ratio:.1f} times cicatrix, {usage.ru_maxrss * 1e-6:.2f} GB"
    )
    gap = float(np.abs(peer - found["u"]).max())
    yield Measurement(f"{size}: largest difference from CalculiX", gap, "mm")


def _run(command: list[str], folder: Path, limit: float | None = None) -> tuple[float, Any]:
    """Run a command with one OpenMP thread, killed after ``limit`` [s] if given; return its wall time [s] and resource usage."""
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
    """Clock that wraps the methods in :data:`STAGES` and sums the CPU seconds spent in each."""

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
    """Measure two solves: one from the unloaded shape, then one with slightly stiffer tissue from the first solution."""
    start = time.process_time()
    body = half_ellipsoid(edge_mm)
    rows = [
        Measurement("mesh", time.process_time() - start, "s", f"CPU; {body.discretization.space.n_elements} tetrahedra")
    ]
    X = body.discretization.space.positions
    start = time.process_time()
    body.residual(X, X, GRAVITY)
    body.linearised(X, X, body.volume_ratio(X, X), in_plane=False)
    rows.append(Measurement("compile", time.process_time() - start, "s", "CPU; kernels and sparsity pattern, once"))
    solver, clock = Equilibrium(1e-8), _Clock()
    start = time.process_time()
    x, report = solver.loaded(body, X, GRAVITY)
    first = time.process_time() - start
    n_free = body.discretization.solved(False)[0].size
    note = f"CPU; {n_free} free dofs, {report.iterations} Newton iterations to 1e-8, up to {np.abs(x - X).max():.1f} mm"
    rows.append(Measurement("first solve", first, "s", note))
    rows += [Measurement(f"of the first solve, {name}", value, "s", "CPU") for name, value in clock.spent.items()]
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
    """Measure one mesh size; write the numbers, the displacements and the input of CalculiX to a folder."""
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

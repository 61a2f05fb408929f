"""A body with history led through its loads, instant by instant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np

from ...core.errors import ConvergenceError
from ...core.units import acceleration_mm_s2, days_from_seconds, hours_from_seconds, ml_from_mm3
from ...files.meshes import MeshedBody
from ...mechanics.body import Body
from ...mechanics.equilibrium import Equilibrium
from ...mechanics.march import Load, Moment, march, virgin
from ...numerics.compiler import COMPILER
from ...numerics.newton import NewtonReport
from ...runs.progress import Progress
from ...runs.results import Quantity, RunFolder
from .build import instants, moved
from .case import EquilibriumCase
from .figures import march_figure, shape_figure


@dataclass
class March:
    """One run; a checkpoint holds positions, the law's history at every quadrature point, and the kept factors."""

    case: EquilibriumCase
    folder: RunFolder
    progress: Progress
    given: MeshedBody
    body: Body

    def go(self) -> str:
        """Lead the body through its loads; returns the sentence that ends the run."""
        self.X = self.body.frame.space.positions
        self.solver = Equilibrium(self.case.solver.relative_tolerance, lambda words: self.progress.update(None, words))
        assert self.case.history is not None
        self.asked = instants(self.case.history)
        with self.progress.stage("march"):
            number, now = self._kept()
            now = self._march(number, now)
        with self.progress.stage("outcome"):
            return self._tell(now)

    def _march(self, first: int, now: Moment) -> Moment:
        """Write a row and a picture of the body at every instant from a number on."""
        moments = march(self.body, self.X, self._loads(first), now, self.solver)
        try:
            for number, reached in enumerate(moments, first):
                now = reached
                self._record(number, now)
                self._save(number, now)
                self.progress.update((number + 1) / len(self.asked), f"{hours_from_seconds(now.time):.4g} h simulated")
        except ConvergenceError as error:
            raise ConvergenceError(
                f"After {hours_from_seconds(now.time):.6g} h the body could not go on: {error}", error.history
            ) from error
        return now

    def _loads(self, number: int) -> Iterator[Load]:
        gravity = acceleration_mm_s2(np.array(self.case.loads.gravity_m_s2))
        held_at = moved(self.body, self.given.displacement) if self.given.displacement.any() else None
        for time, share in self.asked[number:]:
            at = None if held_at is None else self.X + share * (held_at - self.X)
            yield Load(float(time), share * gravity, float(share), at)

    def _record(self, number: int, now: Moment) -> None:
        assert now.report is not None
        shift = (now.x - self.X)[: len(self.given.points)]
        W = np.asarray(_energy(self.body.law, self.body.law_gradient(self.X, now.x), now.state))
        grown = np.broadcast_to(np.linalg.det(np.asarray(self.body.law.growth_tensor(now.state))), W.shape)
        volumes = self.body.volumes(self.X)
        self.folder.record(
            {
                "step": number,
                "time_h": hours_from_seconds(now.time),
                "share": float(self.asked[number, 1]),
                "max_displacement_mm": float(np.linalg.norm(shift, axis=1).max()),
                "strain_energy_uJ": float(np.sum(W * volumes)),
                "dissipation_uJ": now.heat,
                "volume_ml": ml_from_mm3(float(np.sum(self.body.dilation(self.X, now.x) * volumes))),
                "growth_mean": float(np.sum(grown * volumes) / volumes.sum()),
                "newton_iterations": now.report.iterations,
            }
        )
        cells = {"strain_energy_density_kPa": W.mean(axis=1), "growth": grown.mean(axis=1)}
        points, tetrahedra = self.given.points, self.given.tetrahedra
        self.folder.write_fields(
            "body", number, days_from_seconds(now.time), points, tetrahedra, {"displacement": shift}, cells
        )

    def _save(self, number: int, now: Moment) -> None:
        leaves = {f"leaf.{k}": np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves(now.state))}
        kept = {f"solver.{name}": array for name, array in self.solver.kept().items()}
        self.folder.save_checkpoint(number, {"x": now.x, **leaves, **kept}, {"time": now.time, "heat": now.heat})

    def _kept(self) -> tuple[int, Moment]:
        """The next instant's number, and where the last checkpoint stands."""
        kept, start = self.folder.checkpoint, virgin(self.body, self.X, float(self.asked[0, 0]))
        if kept is None:
            return 0, start
        solver = {k.removeprefix("solver."): array for k, array in kept.arrays.items() if k.startswith("solver.")}
        self.solver.restore(self.body.frame, solver)
        form = jax.tree.structure(start.state)
        state: Any = jax.tree.unflatten(form, [kept.arrays[f"leaf.{k}"] for k in range(form.num_leaves)])
        scalars = kept.scalars
        return kept.cycle + 1, Moment(scalars["time"], kept.arrays["x"], state, scalars["heat"], NewtonReport())

    def _tell(self, now: Moment) -> str:
        history = self.folder.history()
        n = int(history["newton_iterations"].sum())
        units = {"max_displacement_mm": "mm", "strain_energy_uJ": "uJ", "dissipation_uJ": "uJ", "volume_ml": "ml"}
        told = {name: Quantity(float(history[name][-1]), unit, "at the end") for name, unit in units.items()}
        told["growth_mean"] = Quantity(
            float(history["growth_mean"][-1]), "1", "volume of grown tissue over that at first"
        )
        told["newton_iterations"] = Quantity(n, "1")
        told["factorizations"] = Quantity(self.solver.factorizations, "1", "since the run was last started")
        told["n_dofs"] = Quantity(self.body.frame.supports(False).n_unknowns, "1", "degrees of freedom that are free")
        self.folder.write_outcome(told)
        self.folder.save_figure("shape", shape_figure(self.body.frame.space, self.X, now.x, inverse=False))
        self.folder.save_figure("history", march_figure(history))
        return f"The body went through {np.ptp(history['time_h']):.6g} h in {len(self.asked)} steps, {n} Newton iterations."


@partial(jax.jit, compiler_options=COMPILER)
def _energy(law, F, state):
    return law.energy(F, state)

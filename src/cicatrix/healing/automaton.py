"""Cellular automaton of wound healing: cells on a lattice divide, move and close the wound.

Source: Garbey et al., section 3, in integer arithmetic. Each step does edge division, motility, layer division and
redistribution, in this order. Every random number is a function of (seed, site, step, phase), so the occupancy and the
step number determine all later states, bit for bit, on any machine and in any order of evaluation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core import native
from ..core.errors import InputError, InvariantError
from ..core.random import MAX_SEED
from ..core.ranks import Ranks
from ..geometry.hexgrid import Lattice
from .cue import Cue
from .redistribution import path_noise_limit
from .reference import ReferenceCore
from .rules import AutomatonRules

__all__ = ["Automaton", "AutomatonRules", "AutomatonState", "NativeCore"]


@dataclass(frozen=True, eq=False)
class AutomatonState:
    """Occupied sites and step number of the automaton.

    ``occupancy`` and ``step`` suffice to restart; the counts only report the last step.

    Parameters
    ----------
    occupancy : bool array of the lattice's shape, read-only
        Sites occupied by a cell.
    step : int
        Number of steps done.
    n_edge_divisions, n_layer_divisions : int
        Divisions in the last step that placed a daughter cell.
    n_dropped : int
        Layer divisions that did not happen in the last step because no empty site was left or reachable.
    n_clamped : int
        Layer cells whose division probability exceeded 1 in the last step and was set to 1.
    """

    occupancy: np.ndarray
    step: int
    n_edge_divisions: int = 0
    n_layer_divisions: int = 0
    n_dropped: int = 0
    n_clamped: int = 0

    def __post_init__(self):
        self.occupancy.setflags(write=False)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return int(np.count_nonzero(self.occupancy))


@dataclass(frozen=True, eq=False)
class Automaton:
    """Cells on a lattice that divide and move until the wound is closed.

    Parameters
    ----------
    lattice : Lattice
        Lattice of sites; each site holds at most one cell.
    fillable : bool array of the lattice's shape
        Sites that can be occupied by a cell; there is no diffusive flux into other sites and across the boundary of the lattice.
    open0 : bool array of the lattice's shape
        Fillable sites that are empty at the start (the wound); all other fillable sites are occupied.
    rules : AutomatonRules
        Probabilities and other parameters of one step.
    seed : int
        Seed of the random numbers, 0 .. 2^64 - 1.

    Raises
    ------
    InputError
        If the arrays do not fit the lattice, the wound contains a site that cannot be filled, or no cell is left.

    Notes
    -----
    Limiting cases: a closed wound, or one that was never open, does not change (the step is still counted). The wound
    may touch the boundary of the lattice. A pocket of the wound that borders no cell stays empty unless motility fills it.
    """

    lattice: Lattice
    fillable: np.ndarray
    open0: np.ndarray
    rules: AutomatonRules
    seed: int

    def __post_init__(self):
        for name in ("fillable", "open0"):
            array = np.asarray(getattr(self, name))
            if array.dtype != bool or array.shape != self.lattice.shape:
                kind = f"{array.dtype} {array.shape}"
                raise InputError(f"Automaton.{name} must be bool {self.lattice.shape} like the lattice; got {kind}")
        if (self.open0 & ~self.fillable).any():
            raise InputError("Automaton.open0 marks sites that can never be filled: the wound must lie inside fillable")
        if not (self.fillable & ~self.open0).any():
            raise InputError("Automaton.open0 leaves no cell: the wound must be smaller than the fillable lattice")
        n_neighbours = len(self.lattice.neighbours)
        if self.rules.min_free_neighbours > n_neighbours:
            raise InputError(f"AutomatonRules.min_free_neighbours must be at most {n_neighbours} on this lattice")
        if not 0 <= self.seed <= MAX_SEED:
            raise InputError(f"Automaton.seed must lie in 0 .. 2^64 - 1; got {self.seed}")

    def initial_state(self) -> AutomatonState:
        """Return the state at step 0, in which the wound is completely open."""
        return AutomatonState(self.fillable & ~self.open0, 0)

    def advance(self, state: AutomatonState, cue: Cue | None = None, n_steps: int = 1) -> AutomatonState:
        """Return the state after ``n_steps`` steps under a constant cue; the given state is not modified.

        Raises
        ------
        InputError
            If the cue is not finite or does not fit the lattice.
        InvariantError
            If cells were lost or duplicated, which would be a bug in the program.
        """
        if n_steps < 0:
            raise InputError(f"n_steps must be at least 0; got {n_steps}")
        core = self.core(state)
        counts = core.advance(n_steps, *self.checked(cue or Cue()))
        last = counts[-1, :4].tolist() if n_steps else ()
        return AutomatonState(core.occupancy(), core.step, *last)

    def core(
        self, state: AutomatonState, threads: int | None = None, isa: str = "", ranks: Ranks | None = None
    ) -> NativeCore | ReferenceCore:
        """Return the core that advances a state: the compiled one if available, otherwise the NumPy reference implementation.

        Parameters
        ----------
        threads : int, optional
            Number of threads of the compiled core; default: ``CICATRIX_THREADS``, or 1. It does not affect the result.
        isa : str
            Instruction set, one of ``native.instruction_sets()``; "" for the best one of this machine.
        ranks : Ranks, optional
            MPI ranks that share the work of each step, all with the same automaton and state; default: this process
            alone. The reference implementation repeats the whole step on every rank.
        """
        if state.occupancy.shape != self.lattice.shape:
            raise InputError(f"the state's lattice {state.occupancy.shape} is not the automaton's {self.lattice.shape}")
        if (state.occupancy & ~self.fillable).any():
            raise InputError("the state has a cell at a site that is not fillable in this automaton")
        arguments = (self.lattice, self.fillable, state.occupancy, self.rules, self.seed, state.step)
        if not native.is_native:
            return ReferenceCore(*arguments)
        return NativeCore(*arguments, threads=threads or native.threads(), isa=isa, ranks=ranks)

    def checked(self, cue: Cue) -> tuple[np.ndarray, float]:
        """Check a cue and return W as a (1,) or (n_sites,) float64 array, and W_ref.

        Raises
        ------
        InputError
            If the cue is not finite or does not fit the lattice.
        """
        w, shape = np.asarray(cue.W, float), self.lattice.shape
        if w.shape not in ((), shape):
            raise InputError(f"Cue.W must be a number or an array of the lattice's shape {shape}; got {w.shape}")
        if not np.isfinite(w).all():
            raise InputError("Cue.W must be finite at every site; it holds NaN or infinity")
        if not (np.isfinite(cue.W_ref) and cue.W_ref > 0):
            raise InputError(f"Cue.W_ref must be positive (kPa); got {cue.W_ref}")
        with np.errstate(over="ignore"):
            if not np.isfinite(self.rules.feedback * w / cue.W_ref).all():
                raise InputError(
                    "the feedback F = feedback W / W_ref must be finite: feedback or Cue.W is far too large"
                )
        return np.ascontiguousarray(w).reshape(-1), float(cue.W_ref)


class NativeCore:
    """Compiled automaton core with the interface of ``ReferenceCore``."""

    def __init__(
        self,
        lattice: Lattice,
        fillable: np.ndarray,
        occupancy: np.ndarray,
        rules: AutomatonRules,
        seed: int,
        step: int,
        *,
        threads: int = 1,
        tiles_per_piece: int = 1024,
        isa: str = "",
        ranks: Ranks | None = None,
    ) -> None:
        self.shape = lattice.shape
        self._ranks = ranks or Ranks()
        assert native.automaton_core is not None
        self._cells = native.automaton_core(
            list(lattice.shape),
            pack_rows(fillable),
            pack_rows(occupancy),
            p_edge=rules.p_edge,
            p_layer=rules.p_layer,
            layer_sites=rules.layer_sites,
            motility_substeps=rules.motility_substeps,
            level_set=rules.redistribution == "level-set",
            feedback=rules.feedback,
            min_free_neighbours=rules.min_free_neighbours,
            path_noise=path_noise_limit(rules.path_noise),
            seed=seed,
            step=step,
            threads=threads,
            tiles_per_piece=tiles_per_piece,
            isa=isa,
        )

    @property
    def step(self) -> int:
        """Number of steps done."""
        return self._cells.step

    @property
    def last(self) -> list[int]:
        """The five counts of the last step, in the order of the columns that ``advance`` returns; empty before the first step."""
        return self._cells.last

    @property
    def n_open(self) -> int:
        """Number of fillable sites that are still empty."""
        return self._cells.n_open

    @property
    def work(self) -> dict[str, int]:
        """Work of the last step by name (numbers of tiles, sites and ranks) and, under "bytes", the size of the memory in use."""
        return self._cells.work

    @property
    def ranks_of_last_step(self) -> int:
        """Number of ranks that shared the last step; 1 if every rank did the whole step."""
        return self._cells.work["ranks"]

    def occupancy(self) -> np.ndarray:
        """Return the sites occupied by a cell: bool array of the lattice's shape."""
        return unpack_rows(self._cells.occupancy(), self.shape)

    def advance(self, n_steps: int, W: np.ndarray, W_ref: float) -> np.ndarray:
        """Perform steps as ``ReferenceCore.advance`` does; all ranks must call it with the same arguments."""
        team = self._ranks if self._ranks.size > 1 else None
        with self._ranks.abort_on_error():
            try:
                return self._cells.advance(n_steps, W, W_ref, team)
            except native.InvariantFault as error:
                raise InvariantError(f"the automaton at step {self.step}: {error}") from error


def pack_rows(mask: np.ndarray) -> np.ndarray:
    """Pack the rows along the last axis into bits, least significant first, whole bytes per row: bool -> (n_bytes,) uint8."""
    return np.packbits(mask.reshape(-1, mask.shape[-1]), axis=1, bitorder="little").ravel()


def unpack_rows(packed: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Undo ``pack_rows``: (n_bytes,) uint8 -> bool array of the given shape."""
    rows = packed.reshape(int(np.prod(shape[:-1])), -1)
    return np.unpackbits(rows, axis=1, count=shape[-1], bitorder="little").reshape(shape).view(bool)

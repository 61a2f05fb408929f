"""Program for the ranks of test_ranks.py, started by mpiexec; the first rank ends with a line of JSON."""

import hashlib
import json
import os
import signal
import sys
from pathlib import Path

import numpy as np
from test_automaton_core import random_case

import cicatrix
from cicatrix.core.errors import InvariantError
from cicatrix.core.ranks import world
from cicatrix.geometry.hexgrid import Lattice
from cicatrix.healing.automaton import Automaton, AutomatonRules, NativeCore
from cicatrix.healing.cue import Cue
from cicatrix.runs.progress import Progress

N_STEPS = 5
N_LARGE = 4  # at the end of the cases
BESIDE = 678  # a case: edge division fills a site in the last tile of a halo, and motility empties it again
FAR = 268  # a case: daughters settle many hops ahead of the front, in tiles that motility does not change


def large_case(i):
    """Return large fronts: 2-D lattices with masks and more divisions than empty sites, and a ball."""
    shape, radius = [((300, 400), 120), ((260, 300), 100), ((60, 60, 80), 22), ((500, 90), 40)][i]
    lattice = Lattice(shape, 0.01, (0.0,) * len(shape))
    fillable = np.random.default_rng(i).random(shape) >= (0.05 if i == 1 else 0.0)
    open0 = np.linalg.norm(lattice.positions() - lattice.position(np.array(shape) / 2), axis=-1) < 0.01 * radius
    rules = AutomatonRules(
        p_edge=0.2, p_layer=0.3 if i == 1 else 0.03, layer_sites=8 if i < 2 else 3, motility_substeps=4
    )
    return Automaton(lattice, fillable, open0 & fillable, rules, i), Cue(0.5, 1.0)


def smooth_case(i):
    """More sub-steps than the depth of the layer, so densities extend furthest; and a plane step with very many sub-steps."""
    shape, radius, n_substeps, layer = [((260, 300), 90, 16, 0), ((260, 300), 90, 60, 1), ((256, 141), 40, 300, 3)][i]
    lattice = Lattice(shape, 0.01, (0.0,) * len(shape))
    open0 = np.linalg.norm(lattice.positions() - lattice.position(np.array(shape) / 2), axis=-1) < 0.01 * radius
    rules = AutomatonRules(p_edge=0.2, p_layer=0.1, layer_sites=layer, motility_substeps=n_substeps, path_noise=3.0)
    return Automaton(lattice, np.random.default_rng(i).random(shape) > 0.02, open0, rules, i), Cue(0.5, 1.0)


CASES = [
    *(lambda i=i: random_case(i) for i in (*range(24), FAR, BESIDE)),
    *(lambda i=i: large_case(i) for i in range(N_LARGE)),
]


def chosen(of_cases, every):
    """Return every so manieth of the random cases, and the large ones."""
    return of_cases[:-N_LARGE:every] + of_cases[-N_LARGE:]


def core_of(automaton, ranks=None):
    occupancy = automaton.initial_state().occupancy
    return NativeCore(
        automaton.lattice,
        automaton.fillable,
        occupancy,
        automaton.rules,
        automaton.seed,
        0,
        tiles_per_piece=1,
        ranks=ranks,
    )


def digests(ranks=None, every=1):
    """Return for each case a digest of all counts and cells, and how many ranks shared each step."""
    out = []
    for make in chosen(CASES, every):
        automaton, cue = make()
        core, digest, shared = core_of(automaton, ranks), hashlib.sha256(), []
        for _ in range(N_STEPS):
            digest.update(core.advance(1, *automaton.checked(cue)).tobytes())
            digest.update(core.occupancy().tobytes())
            shared.append(core.work["ranks"])
        out.append((digest.hexdigest(), shared))
    return out


def all_digests(every):
    ranks = world()
    mine = digests(ranks, int(every))
    everyone = [json.loads(other) for other in ranks.gather(json.dumps(mine).encode())]
    return {"digests": mine, "alike": all(other == everyone[0] for other in everyone)}


class Signaller(Progress):
    """Progress that sends the first rank the signal of Ctrl-C, when a stage begins or at a step."""

    def __init__(self, moment):
        super().__init__()
        self.moment = moment

    def begin(self, name):
        self._at(name)

    def update(self, fraction, words=""):
        self._at(words)

    def _at(self, words):
        if words == self.moment:
            os.kill(os.getpid(), signal.SIGINT)


def interrupted(path, out, moment):
    try:
        cicatrix.simulate(cicatrix.load_case(path), Path(out), progress=Signaller(moment))
    except KeyboardInterrupt:
        return "interrupted"
    return "finished"


def all_fail(path, out):
    """Run a case in which all ranks raise an InvariantError at step 5."""
    advance = NativeCore.advance

    def losing(self, *arguments):
        if self.step == 5:
            raise InvariantError("cells were lost")
        return advance(self, *arguments)

    NativeCore.advance = losing
    try:
        cicatrix.simulate(cicatrix.load_case(path), Path(out))
    except InvariantError as error:
        return str(error)


class Failing:
    """Ranks of which the last one fails in the middle of a step."""

    def __init__(self):
        self.n, ranks = 0, world()
        self.rank, self.size, self._gather, self.abort_on_error = (
            ranks.rank,
            ranks.size,
            ranks.gather,
            ranks.abort_on_error,
        )

    def gather(self, mine):
        self.n += 1
        if self.n == 9 and self.rank == self.size - 1:
            raise OSError("a fault of one rank")
        return self._gather(mine)


def one_fails():
    automaton, cue = large_case(0)
    core_of(automaton, Failing()).advance(3, *automaton.checked(cue))
    return "never here"


if __name__ == "__main__":
    told = {"digests": all_digests, "interrupted": interrupted, "one-fails": one_fails, "all-fail": all_fail}[
        sys.argv[1]
    ](*sys.argv[2:])
    if world().is_first:
        print(json.dumps(told))

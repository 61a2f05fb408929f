"""What is said about the steady states of a network: outcomes, notes, and the run's last sentence."""

from __future__ import annotations

import numpy as np

from ...biology.network_model import NetworkModel
from ...biology.steady import SteadyStates
from ...core.units import seconds_from_hours
from ...runs.quantity import Quantity

VERDICTS = {True: "yes", False: "no", None: "undecided"}


def verdict_of(found: SteadyStates | None, model: NetworkModel) -> str:
    """Return a sentence on how many stable steady states there are, as far as the starts have settled."""
    if found is None:
        return "Its rates depend on time, so it has no steady states."
    if len(found.balances.growing):
        return f"It has no steady state: {_growing(found, model)}."
    n, lost = len(found.stable), int(np.sum(found.reached < 0))
    words = {0: "No stable steady state was found.", 1: "One stable steady state was found."}
    many = f"{n} stable steady states were found: the initial state decides which one is reached."
    rest = f" {lost} of {len(found.reached)} starts did not reach a steady state." if lost else ""
    open_end = " Whether there are others is undecided." if found.is_bistable is None and n else ""
    return words.get(n, many) + rest + open_end


def notes_of(found: SteadyStates, model: NetworkModel) -> list[str]:
    """Return notes on conserved sums, on skipped starts, and on states whose stability is open."""
    notes = []
    if len(found.balances.growing):
        notes.append(f"No steady state exists: {_growing(found, model)}.")
    if found.n_conserved:
        totals = found.balances.conserved @ model.start
        sums = "; ".join(
            f"{_sum(weights, model)} = {total:g}" for weights, total in zip(found.balances.conserved, totals)
        )
        notes.append(f"The network conserves {sums}: all steady states have these totals.")
    if skipped := int(found.is_skipped.sum()):
        notes.append(
            f"{skipped} of {len(found.reached)} starts of the search for steady states were skipped: rates or their derivatives "
            "are not finite numbers there."
        )
    for number, state in enumerate(found.states, 1):
        if state.growth == 0.0:
            notes.append(
                f"Steady state {number} is neither stable nor unstable to first order: an eigenvalue of its Jacobian is 0, "
                "so a continuum of steady states may pass through it."
            )
    return notes


def outcomes_of(found: SteadyStates, model: NetworkModel, inputs: np.ndarray) -> dict[str, Quantity]:
    """Return the outcomes on steady states under inputs (n_inputs,), with unstable states and starts that reached none."""
    names = model.law.species
    under = ", ".join(f"{name} = {value:g}" for name, value in zip(model.law.input_names, inputs)) or "no inputs"
    listed = [
        {
            "is_stable": state.is_stable,
            "n_starts": state.n_starts,
            "growth_per_h": seconds_from_hours(state.growth),
            "values": dict(zip(names, state.y)),
        }
        for state in found.states
    ]
    sums = ", ".join(_sum(weights, model) for weights in found.balances.conserved) or "none"
    return {
        "n_stable_states": Quantity(len(found.stable), "1", f"from {len(found.reached)} starts under {under}"),
        "is_bistable": Quantity(
            VERDICTS[found.is_bistable],
            "",
            "whether it has several stable states; undecided while starts are unsettled",
        ),
        "state_from_own_start": Quantity(_number(found.reached[0]), "1", "number of the state, from 1"),
        "state_from_end": Quantity(
            _number(found.reached[-1]), "1", "number of the state reached from the end of the course, from 1"
        ),
        "n_unsettled_starts": Quantity(found.n_unsettled, "1", "starts that did not reach a steady state"),
        "n_skipped_starts": Quantity(
            int(found.is_skipped.sum()), "1", "starts at which rates or their derivatives are not finite"
        ),
        "n_conserved": Quantity(found.n_conserved, "1", f"conserved sums: {sums}"),
        "steady_states": Quantity(listed, "1", "stable ones first; growth: largest real part of an eigenvalue"),
    }


def _growing(found: SteadyStates, model: NetworkModel) -> str:
    pace = seconds_from_hours(found.balances.growth[0])
    return f"{_sum(found.balances.growing[0], model)} changes by {pace:g} per h for ever"


def _sum(weights: np.ndarray, model: NetworkModel) -> str:
    """Return a weighted sum of species as text: "X + 2 P"."""
    terms = [(w, name) for w, name in zip(weights, model.law.species) if w]
    text = " ".join(f"{'-' if w < 0 else '+'} {'' if abs(w) == 1.0 else f'{abs(w):.6g} '}{name}" for w, name in terms)
    return text.removeprefix("+ ")


def _number(state: int) -> int | None:
    return int(state) + 1 if state >= 0 else None

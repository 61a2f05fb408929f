"""Who acts on whom in a signalling network, as arrays."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..core.errors import InputError
from .rules import Rule, unknown_species


@dataclass(frozen=True)
class Wiring:
    """Who acts on whom.

    Parameters
    ----------
    species : tuple of str
        Names (n_species,).
    reactions : tuple of str
        Names (n_reactions,).
    rules : tuple of Rule
        One per reaction; reactions with the same target are joined by OR.

    Raises
    ------
    InputError
        If a rule names a species that is not there, a name stands twice, or a species has two inputs.
    """

    species: tuple[str, ...]
    reactions: tuple[str, ...]
    rules: tuple[Rule, ...]

    def __post_init__(self) -> None:
        for what, names in (("species", self.species), ("reaction", self.reactions), ("input", self.input_names)):
            twice = [name for name, count in Counter(names).items() if count > 1]
            if twice:
                raise InputError(f'{what} "{twice[0]}" stands twice')
        for name, rule in zip(self.reactions, self.rules, strict=True):
            for one in (*(factor.species for factor in rule.factors), rule.target):
                if one not in self._row:
                    raise InputError(f'reaction "{name}" {unknown_species(one, self.species)}')

    @cached_property
    def _row(self) -> dict[str, int]:
        return {name: number for number, name in enumerate(self.species)}

    @cached_property
    def input_reactions(self) -> np.ndarray:
        """Reactions ``=> X`` (n_inputs,)."""
        return np.array([r for r, rule in enumerate(self.rules) if rule.is_input], int)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Their targets (n_inputs,)."""
        return tuple(rule.target for rule in self.rules if rule.is_input)

    @cached_property
    def edges(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Species, reaction and negation of every factor of every rule, negated ones last: (n_edges,) each."""
        rows = [
            (self._row[factor.species], r, factor.is_negated)
            for r, rule in enumerate(self.rules)
            for factor in rule.factors
        ]
        rows.sort(key=lambda row: row[2])
        species, reaction, is_negated = zip(*rows) if rows else ((), (), ())
        return np.array(species, int), np.array(reaction, int), np.array(is_negated, bool)

    @cached_property
    def factors_of(self) -> np.ndarray:
        """Edges of every reaction (n_reactions, most), filled up with ``n_edges``."""
        return _padded(self.edges[1], len(self.rules))

    @cached_property
    def reactions_into(self) -> np.ndarray:
        """Reactions of every target (n_species, most), filled up with ``n_reactions``."""
        return _padded(np.array([self._row[rule.target] for rule in self.rules], int), len(self.species))

    @cached_property
    def n_negated(self) -> np.ndarray:
        """Factors with ``!`` of every reaction (n_reactions,)."""
        return np.array([sum(factor.is_negated for factor in rule.factors) for rule in self.rules], int)

    @cached_property
    def undriven(self) -> tuple[str, ...]:
        """Species that no reaction acts on: they decay to 0."""
        targets = {rule.target for rule in self.rules}
        return tuple(name for name in self.species if name not in targets)


def _padded(group: np.ndarray, n_groups: int) -> np.ndarray:
    """Members of every group (n_groups, most at least 1), filled up with the number of members."""
    members = [np.flatnonzero(group == number) for number in range(n_groups)]
    table = np.full((n_groups, max([1, *map(len, members)])), len(group))
    for row, found in zip(table, members):
        row[: len(found)] = found
    return table

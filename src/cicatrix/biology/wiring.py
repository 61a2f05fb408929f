"""Connections of a signalling network as index arrays."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..core.errors import InputError
from .rules import Rule, unknown_species


@dataclass(frozen=True)
class Wiring:
    """Species and reactions of a signalling network, and their connections.

    Parameters
    ----------
    species : tuple of str
        Names of the species (n_species,).
    reactions : tuple of str
        Names of the reactions (n_reactions,).
    rules : tuple of Rule
        Rule of each reaction; reactions with the same target are joined by OR.

    Raises
    ------
    InputError
        If a rule names an unknown species, a name is listed twice, or a species has two inputs.
    """

    species: tuple[str, ...]
    reactions: tuple[str, ...]
    rules: tuple[Rule, ...]

    def __post_init__(self) -> None:
        for what, names in (("species", self.species), ("reaction", self.reactions), ("input", self.input_names)):
            twice = [name for name, count in Counter(names).items() if count > 1]
            if twice:
                raise InputError(f'{what} "{twice[0]}" is listed twice')
        for name, rule in zip(self.reactions, self.rules, strict=True):
            for one in (*(factor.species for factor in rule.factors), rule.target):
                if one not in self._row:
                    raise InputError(f'reaction "{name}" {unknown_species(one, self.species)}')

    @cached_property
    def _row(self) -> dict[str, int]:
        return {name: number for number, name in enumerate(self.species)}

    @cached_property
    def input_reactions(self) -> np.ndarray:
        """Indices of the reactions ``=> X`` (n_inputs,)."""
        return np.array([r for r, rule in enumerate(self.rules) if rule.is_input], int)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the species X with a reaction ``=> X`` (n_inputs,)."""
        return tuple(rule.target for rule in self.rules if rule.is_input)

    @cached_property
    def edges(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Species, reaction and negation of every edge (a factor in a rule), negated edges last: three arrays (n_edges,)."""
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
        """Indices of the edges of each reaction (n_reactions, most), padded with ``n_edges``."""
        return _padded(self.edges[1], len(self.rules))

    @cached_property
    def reactions_into(self) -> np.ndarray:
        """Indices of the reactions that act on each species (n_species, most), padded with ``n_reactions``."""
        return _padded(np.array([self._row[rule.target] for rule in self.rules], int), len(self.species))

    @cached_property
    def n_negated(self) -> np.ndarray:
        """Number of negated factors (``!``) of each reaction (n_reactions,)."""
        return np.array([sum(factor.is_negated for factor in rule.factors) for rule in self.rules], int)

    @cached_property
    def repeated(self) -> tuple[tuple[str, str, Rule], ...]:
        """Pairs of reactions with the same factors and the same target, each with the rule: the later one often is a mistake."""
        first: dict[tuple[frozenset, str], str] = {}
        pairs = []
        for name, rule in zip(self.reactions, self.rules):
            key = (frozenset(rule.factors), rule.target)
            if key in first:
                pairs.append((first[key], name, rule))
            first.setdefault(key, name)
        return tuple(pairs)

    @cached_property
    def undriven(self) -> tuple[str, ...]:
        """Species that no reaction acts on: they decay to 0."""
        targets = {rule.target for rule in self.rules}
        return tuple(name for name in self.species if name not in targets)


def _padded(group: np.ndarray, n_groups: int) -> np.ndarray:
    """Return the indices of every group's members, from the group number of each member (n,): (n_groups, most), padded with n."""
    members = [np.flatnonzero(group == number) for number in range(n_groups)]
    table = np.full((n_groups, max([1, *map(len, members)])), len(group))
    for row, found in zip(table, members):
        row[: len(found)] = found
    return table

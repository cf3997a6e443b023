# SPDX-License-Identifier: Apache-2.0
"""The legs of a trip as one game: each drawn on its own, against one ambusher at one place.

The mean loss of an ambush at a site is the sum of its losses over the legs, so everything here is
linear over legs: their edges are numbered one after the other, M in all, and a row of sites has the
edges of all legs. A trip without stops is one leg.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_matrix, hstack

from ..arrays import BoolArray, FloatArray, IndexArray
from ..errors import BudgetInfeasible
from .budget import Budget
from .discs import ExposedEdges
from .game import Game


@dataclass(frozen=True, eq=False)
class Legs:
    """The games of a trip's legs, which have the same sites, and their length budgets.

    ``budgets`` are in the same order; a limit may differ from leg to leg.
    """

    games: tuple[Game, ...]
    budgets: tuple[Budget, ...]

    @property
    def reach(self) -> float:
        """Distance from a drawn route within which an ambush hits [m]; 0: at nodes only."""
        return self.games[0].reach

    @property
    def no_reentry(self) -> bool:
        """Return whether simple routes enter a site's reach at most once, so entries are hits."""
        return self.games[0].no_reentry

    @property
    def loss(self) -> FloatArray:
        """The losses (S,) at the sites."""
        game = self.games[0]
        return game.loss[game.sites]

    @property
    def site_points(self) -> FloatArray:
        """Positions (S, 2) of the sites [m]."""
        game = self.games[0]
        return game.network.points[game.sites]

    @cached_property
    def first(self) -> IndexArray:
        """The number (legs + 1,) of each leg's first edge; the last is M."""
        return np.cumsum([0, *(len(game.playable) for game in self.games)])

    @property
    def edge_count(self) -> int:
        """Number of edges of all legs, M."""
        return int(self.first[-1])

    @cached_property
    def entering(self) -> csr_matrix:
        """(S, M) of 0 and 1: the edges by which each leg's routes enter each site's reach."""
        if len(self.games) == 1:
            return self.games[0].entering
        return csr_matrix(hstack([game.entering for game in self.games]))

    def split(self, of_edges: FloatArray) -> list[FloatArray]:
        """Numbers (M,) of the edges, leg by leg."""
        return np.split(of_edges, self.first[1:-1])

    def rows_by_leg(self, rows: csr_matrix) -> list[csr_matrix]:
        """Rows (K, M), leg by leg."""
        if len(self.games) == 1:
            return [rows]
        columns = rows.tocsc()
        return [csr_matrix(columns[:, begin:end])
                for begin, end in zip(self.first[:-1], self.first[1:], strict=True)]

    def with_sites(self, points: FloatArray, loss: FloatArray, entering: csr_matrix) -> Legs:
        """The legs with more sites (K,): see ``Game.with_sites``; ``entering`` has rows (K, M)."""
        if not len(loss):
            return self
        rows = self.rows_by_leg(entering)
        return self._with_games([game.with_sites(points, loss, own)
                                 for game, own in zip(self.games, rows, strict=True)])

    def avoiding(self, entering: csr_matrix) -> Legs | None:
        """The legs on edges that enter no disc of the rows (K, M).

        None if a leg has no route there, or none within its budget.
        """
        games = [game.avoiding(own)
                 for game, own in zip(self.games, self.rows_by_leg(entering), strict=True)]
        with contextlib.suppress(BudgetInfeasible):
            return self._with_games([game for game in games if game]) if all(games) else None
        return None

    def _with_games(self, games: Sequence[Game]) -> Legs:
        budgets = tuple(replace(budget, game=game)
                        for budget, game in zip(self.budgets, games, strict=True))
        return Legs(tuple(games), budgets)


def exposed_legs(games: Sequence[Game],
                 used: BoolArray | None = None) -> ExposedLegs | ExposedEdges:
    """The parts of all legs' edges, by default the playable ones, outside the secured area.

    ``used`` (M,) marks other edges.
    """
    if used is None:
        used = np.concatenate([game.playable for game in games])
    if len(games) == 1:
        return games[0].exposed(np.flatnonzero(used))
    return ExposedLegs(games, used)


class ExposedLegs:
    """The exposed parts of all legs' edges; each edge of the ground is looked at once."""

    def __init__(self, games: Sequence[Game], used: BoolArray) -> None:
        networks = [game.network for game in games]
        # A convoy that has moved on has another source: its place is looked at as another node.
        points, node = np.unique(np.concatenate([each.points for each in networks]), axis=0,
                                 return_inverse=True)
        first = np.cumsum([0, *(len(each.points) for each in networks)])
        at = [node.ravel()[begin:end] for begin, end in pairwise(first.tolist())]
        edges = np.concatenate([own[each.edges] for own, each in zip(at, networks, strict=True)])
        ground, edge = np.unique(edges @ (len(points), 1), return_inverse=True)
        self._edge = edge.ravel()
        begins = np.array([own[each.source] for own, each in zip(at, networks, strict=True)])
        secured = games[0].secured.shrink(games[0].options.tube)
        self._ground = ExposedEdges(points, np.stack(np.divmod(ground, len(points)), axis=1),
                                    secured, begins, np.unique(self._edge[used]))

    def entering(self, centres: FloatArray, reach: float) -> csr_matrix:
        """(K, M) of 0 and 1: the edges by which routes enter the discs of radius ``reach`` [m]."""
        return csr_matrix(self._ground.entering(centres, reach)[:, self._edge])

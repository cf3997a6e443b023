# SPDX-License-Identifier: Apache-2.0
"""The legs of a trip as one game: drawn independently, against one ambusher at one place.

The mean loss that an ambush at a site causes is the sum over the legs. So the edges of all legs are
numbered one after the other, M in all, and a site's row covers them all. A trip without stops has
one leg.
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
    """Games of a trip's legs, which have the same sites, with a length budget for each."""

    games: tuple[Game, ...]
    budgets: tuple[Budget, ...]

    @property
    def reach(self) -> float:
        """Distance from a drawn route within which an ambush hits [m]; 0: at nodes only."""
        return self.games[0].reach

    @property
    def no_reentry(self) -> bool:
        """Return whether simple routes enter a reach at most once, so that entries are hits."""
        return self.games[0].no_reentry

    @property
    def loss(self) -> FloatArray:
        """Losses (S,) at the sites."""
        game = self.games[0]
        return game.loss[game.sites]

    @property
    def site_points(self) -> FloatArray:
        """Positions (S, 2) of the sites [m]."""
        game = self.games[0]
        return game.network.points[game.sites]

    @cached_property
    def first(self) -> IndexArray:
        """Number (legs + 1,) of each leg's first edge; the last is M."""
        return np.cumsum([0, *(len(game.playable) for game in self.games)])

    @property
    def edge_count(self) -> int:
        """Number of edges of all legs, M."""
        return int(self.first[-1])

    @cached_property
    def entering(self) -> csr_matrix:
        """Rows (S, M) of 0 and 1: the edges by which each leg's routes enter each site's reach."""
        if len(self.games) == 1:
            return self.games[0].entering
        return csr_matrix(hstack([game.entering for game in self.games]))

    def split(self, values: FloatArray) -> list[FloatArray]:
        """Split values (M,) of the edges by leg."""
        return np.split(values, self.first[1:-1])

    def rows_by_leg(self, rows: csr_matrix) -> list[csr_matrix]:
        """Split rows (K, M) by leg."""
        if len(self.games) == 1:
            return [rows]
        columns = rows.tocsc()
        return [csr_matrix(columns[:, begin:end])
                for begin, end in zip(self.first[:-1], self.first[1:], strict=True)]

    def with_sites(self, points: FloatArray, loss: FloatArray, entering: csr_matrix) -> Legs:
        """Return the legs with sites (K,) added, as ``Game.with_sites``; rows are (K, M)."""
        if not len(loss):
            return self
        rows = self.rows_by_leg(entering)
        return self._with_games([game.with_sites(points, loss, leg_rows)
                                 for game, leg_rows in zip(self.games, rows, strict=True)])

    def avoiding(self, entering: csr_matrix) -> Legs | None:
        """Return the legs without edges that enter discs, rows (K, M).

        None if a leg then has no route, or none within its budget.
        """
        games = [game.avoiding(leg_rows)
                 for game, leg_rows in zip(self.games, self.rows_by_leg(entering), strict=True)]
        with contextlib.suppress(BudgetInfeasible):
            return self._with_games([game for game in games if game]) if all(games) else None
        return None

    def _with_games(self, games: Sequence[Game]) -> Legs:
        budgets = tuple(replace(budget, game=game)
                        for budget, game in zip(self.budgets, games, strict=True))
        return Legs(tuple(games), budgets)


def exposed_legs(games: Sequence[Game],
                 used: BoolArray | None = None) -> ExposedLegs | ExposedEdges:
    """Find the exposed parts of the edges of all legs that ``used`` (M,) marks.

    By default, these are the playable ones.
    """
    if used is None:
        used = np.concatenate([game.playable for game in games])
    if len(games) == 1:
        return games[0].exposed(np.flatnonzero(used))
    return ExposedLegs(games, used)


class ExposedLegs:
    """The exposed parts of all legs' edges; an edge that several legs have is treated once."""

    def __init__(self, games: Sequence[Game], used: BoolArray) -> None:
        networks = [game.network for game in games]
        # Nodes are identified by their positions: a convoy that has moved on has another source.
        points, node = np.unique(np.concatenate([each.points for each in networks]), axis=0,
                                 return_inverse=True)
        first = np.cumsum([0, *(len(each.points) for each in networks)])
        nodes = [node.ravel()[begin:end] for begin, end in pairwise(first.tolist())]
        edges = np.concatenate([leg_nodes[each.edges]
                                for leg_nodes, each in zip(nodes, networks, strict=True)])
        ground, edge = np.unique(edges @ (len(points), 1), return_inverse=True)
        self._edge = edge.ravel()
        sources = np.array([leg_nodes[each.source]
                            for leg_nodes, each in zip(nodes, networks, strict=True)])
        secured = games[0].secured.shrink(games[0].options.tube)
        self._ground = ExposedEdges(points, np.stack(np.divmod(ground, len(points)), axis=1),
                                    secured, sources, np.unique(self._edge[used]))

    def entering(self, centres: FloatArray, reach: float) -> csr_matrix:
        """Rows (K, M) of 0 and 1, as ``ExposedEdges.entering``."""
        return csr_matrix(self._ground.entering(centres, reach)[:, self._edge])

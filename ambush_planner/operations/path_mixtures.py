# SPDX-License-Identifier: Apache-2.0
"""Mixtures of given paths: their value, and the best shares.

The paths of a leg are laid out as a network on which they share no nodes but start and goal. A
mixture of them is a strategy on this network, so hits, sites and cells are treated as for any
strategy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from scipy.sparse import csr_matrix, vstack

from ..arrays import BoolArray, FloatArray, IndexArray, frozen_array
from ..errors import InvalidOption, TimeLimit
from ..game.ambusher import Ambusher
from ..game.budget import Budget
from ..game.distribution.chain import chain_of_legs
from ..game.game import GameOptions, make_games
from ..game.legs import Legs, exposed_legs
from ..game.strategy import TripStrategy, make_strategies
from ..maps.risk_map import RiskMap
from ..network.hiding_places import with_places
from ..network.network import Network
from ..planning.cell_losses import CellLosses, CellSearch
from ..planning.plan import Plan
from .best_shares import SharesLP

# Maximum relative gap between the value of the best shares and that of the linear program.
MAX_GAP = 1e-3


@dataclass(frozen=True, eq=False)
class PathMixture:
    """A mixture of given paths with ``shares`` (K,).

    ``value`` is the largest mean loss that an ambush at one place outside the secured area causes,
    ``worst_xy`` (2,) that place [m], and ``hit`` (K,) marks the paths that it hits.
    """

    shares: FloatArray
    value: float
    worst_xy: FloatArray
    hit: BoolArray


class PathMixtures:
    """Mixtures of K paths (L, 2 or 3), x and y [m] first, each of a leg of a plan.

    Shares (K,) sum to 1 on each leg. An ambush hits a path that comes within its reach outside the
    secured area, at most once per leg. The robot's tracking error adds to the reach, but no tube:
    the given paths are driven.

    Raises InvalidOption if the plan's game has no reach.
    """

    def __init__(self, risk_map: RiskMap, plan: Plan, paths: Sequence[FloatArray],
                 leg: IndexArray) -> None:
        solved = plan.trip.game
        options = solved.options
        check_judged(options)
        self._networks, self._uses = _networks_of(plan, paths, leg)
        self._plan, self._leg = plan, leg
        self._games = make_games(self._networks, replace(
            options, tube=plan.options.drive.tracking_error,
            secured_radius=options.secured_distance))
        self._first = np.cumsum([0, *(len(each.edges) for each in self._networks)])
        self._cells = CellLosses(risk_map, options.ambush_in_obstacles)
        self._exposed = exposed_legs(self._games)
        self._points, self._loss = np.zeros((0, 2)), np.zeros(0)
        self._hit = csr_matrix((0, len(paths)))
        points = solved.network.points[solved.sites]
        self._add_sites(points, solved.loss[solved.sites])

    def judge(self, shares: FloatArray) -> PathMixture:
        """Compute the value of the mixture with given shares (K,)."""
        threshold = float((self._loss * (self._hit @ shares)).max(initial=0.0))
        used = self._uses @ shares
        # The search covers only paths that have a share: a best mixture needs few of many.
        search = CellSearch(self._cells, self._games, used > 0.0)
        found = search.worst(chain_of_legs(self._networks, used, self._first), threshold)
        self._add_sites(found.points, found.alpha)
        losses = self._loss * (self._hit @ shares)
        worst = int(losses.argmax())
        return PathMixture(frozen_array(shares, np.float64), float(losses[worst]),
                           frozen_array(self._points[worst], np.float64),
                           frozen_array(self._hit[worst].toarray()[0], np.bool_))

    def strategy(self, shares: FloatArray, bounds: FloatArray,
                 costs: FloatArray | None = None) -> TripStrategy:
        """Return the mixture with given shares (K,) as strategies, with the value of ``judge``.

        Their ambusher waits at the worst place; ``bounds`` (legs,) are lower bounds of each leg's
        mean loss. ``costs`` (K,) are the driving times of the paths [s] if the plan has times.
        """
        value, count = self.judge(shares).value, len(self._networks[0].points)
        lengths = np.concatenate([each.lengths for each in self._networks])
        seconds: list[FloatArray | None] = [None] * len(self._networks)
        if costs is not None:
            seconds = list(np.split(lengths * (self._uses @ (costs / (lengths @ self._uses))),
                                    self._first[1:-1]))
        networks = [with_places(replace(each, seconds=times), self._points, self._loss)
                    for each, times in zip(self._networks, seconds, strict=True)]
        games, q = make_games(networks, self._games[0].options), np.zeros(len(networks[0].points))
        q[count + int((self._loss * (self._hit @ shares)).argmax())] = 1.0
        legs = Legs(games, tuple(Budget(game, math.inf, leg.shortest_length)
                                 for game, leg in zip(games, self._plan.legs, strict=True)))
        bounds = bounds * min(1.0, value / max(float(bounds.sum()), np.finfo(float).tiny))
        return make_strategies(legs, self._uses @ shares, [None] * len(games),
                               Ambusher(q, (0.0,) * len(games)), bounds)

    def best(self, costs: FloatArray, deadline: float = math.inf) -> PathMixture:
        """Find the shares of least value up to ``MAX_GAP``; each leg's mean cost is at most 1.

        ``costs`` (K,) are those of the paths. At the ``deadline`` (``time.monotonic``), returns the
        incumbent. Raises TimeLimit if there is none, BudgetInfeasible if no mixture is feasible.
        """
        lp = SharesLP(self.losses, costs, self._leg, deadline)
        found: list[PathMixture] = []
        while True:
            try:
                solved = lp.solve()
            except TimeLimit:
                if not found:
                    raise
                break
            found.append(self.judge(solved.of_all(self._leg)))
            if found[-1].value <= solved.value * (1.0 + MAX_GAP):
                break
            lp.losses = self.losses
        return min(found, key=attrgetter('value'))

    @property
    def losses(self) -> csr_matrix:
        """Losses (S, K) of each path at the known sites, to which ``judge`` adds the worst."""
        return self._hit.multiply(self._loss[:, None]).tocsr()

    def _add_sites(self, points: FloatArray, loss: FloatArray) -> None:
        hit = csr_matrix(self._exposed.entering(points, self._games[0].reach) @ self._uses)
        hit.data[:] = 1.0  # however often a path comes back
        self._points = np.concatenate((self._points, points))
        self._loss = np.append(self._loss, loss)
        self._hit = csr_matrix(vstack((self._hit, hit)))


def check_judged(options: GameOptions) -> None:
    """Raise InvalidOption if a game has no reach, by which paths are judged."""
    if options.ambush_radius == 0.0:
        raise InvalidOption('game.ambush_radius (--reach) must be over 0: paths are judged by what '
                            'an ambush reaches')


def _networks_of(plan: Plan, paths: Sequence[FloatArray], leg: IndexArray
                 ) -> tuple[list[Network], csr_matrix]:
    """Lay out the paths of each leg as a network; returns also each path's edges (M, K).

    All networks have the same nodes.
    """
    ends = [(each.network.source, each.network.target) for each in plan.legs]
    known, end = np.unique(ends, return_inverse=True)
    end, lines = end.reshape(-1, 2), [plan.network.points[known]]
    first, edges = len(known), []
    for path, (source, target) in zip(paths, end[leg].tolist(), strict=True):
        line = np.vstack((lines[0][source], path[:, :2], lines[0][target]))
        line = line[np.append(True, (line[1:] != line[:-1]).any(axis=1))]
        if len(line) == 2:  # else another path could have the same edge
            line = np.insert(line, 1, line.mean(axis=0), axis=0)
        lines.append(line[1:-1])
        nodes = [source, *range(first, first + len(line) - 2), target]
        edges.append(np.column_stack((nodes[:-1], nodes[1:])))
        first += len(line) - 2
    points, all_edges = np.concatenate(lines), np.concatenate(edges)
    alpha, number = np.zeros(len(points)), np.repeat(np.arange(len(edges)), list(map(len, edges)))
    networks = [Network(points, alpha, all_edges[leg[number] == k], *leg_ends.tolist())
                for k, leg_ends in enumerate(end)]
    return networks, csr_matrix((np.ones(len(number)), (np.arange(len(number)), number)))

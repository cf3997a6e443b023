# SPDX-License-Identifier: Apache-2.0
"""Mixtures of given paths: their loss against an informed ambusher, and the best shares.

Paths that are driven side by side are a network of their own, on which they share no node but start
and goal. A mixture of them is a strategy on it; hits, sites and cells are those of any strategy.
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
from ..game.distribution.chain import chain_of
from ..game.game import GameOptions, make_game
from ..game.legs import Legs
from ..game.strategy import TripStrategy, make_strategies
from ..maps.risk_map import RiskMap
from ..network.hiding_places import with_places
from ..network.network import Network
from ..planning.cell_losses import CellLosses, CellSearch
from ..planning.plan import Plan
from .best_shares import SharesLP

# Maximum relative gap between the best shares' value and that of the linear program.
MAX_GAP = 1e-3
# Radius of the secured area around a stop if there is none: nobody can wait at the stop [m].
AT_STOP = 1e-6


@dataclass(frozen=True, eq=False)
class PathMixture:
    """Shares (K,) of given paths.

    ``value`` is the mean loss by the worst ambusher who knows the shares, wherever on the ground
    outside the secured area he waits; ``worst_xy`` (2,) is where that is [m], and ``hit`` (K,)
    which paths he hits there.
    """

    shares: FloatArray
    value: float
    worst_xy: FloatArray
    hit: BoolArray


class PathMixtures:
    """All mixtures of paths (L, 2 or 3), x and y [m] first, from start to goal of a plan.

    An ambush of the plan's reach hits a path that passes within it outside the secured area,
    once however often it comes back. The robot's tracking error adds to the reach, but no tube: a
    given path is what is driven.

    Raises InvalidOption if the plan's game has no reach.
    """

    def __init__(self, risk_map: RiskMap, plan: Plan, paths: Sequence[FloatArray]) -> None:
        solved = plan.trip.game
        options = solved.options
        check_judged(options)
        self._network, self._uses = _network_of(plan, paths)
        self._plan = plan
        stops = ((x, y, options.secured_distance or AT_STOP) for x, y in plan.stops_xy)
        self._game = make_game(self._network, replace(
            options, tube=plan.options.drive.tracking_error,
            secured_radius=options.secured_distance,
            held_places=(*options.held_places, *stops)))
        self._cells = CellLosses(risk_map, options.ambush_in_obstacles)
        self._exposed = self._game.exposed()
        self._points, self._loss = np.zeros((0, 2)), np.zeros(0)
        self._hit = csr_matrix((0, len(paths)))
        points = solved.network.points[solved.sites]
        self._add_sites(points, solved.loss[solved.sites])

    def judged(self, shares: FloatArray) -> PathMixture:
        """The mixture with given shares (K,), which add up to 1."""
        least = float((self._loss * (self._hit @ shares)).max(initial=0.0))
        used = self._uses @ shares
        # Only along the paths that have a share: of many paths, a best mixture needs few.
        search = CellSearch(self._cells, (self._game,), used > 0.0)
        found = search.worst(chain_of(self._network, used), least)
        self._add_sites(found.points, found.alpha)
        losses = self._loss * (self._hit @ shares)
        worst = int(losses.argmax())
        return PathMixture(frozen_array(shares, np.float64), float(losses[worst]),
                           frozen_array(self._points[worst], np.float64),
                           frozen_array(self._hit[worst].toarray()[0], np.bool_))

    def strategy(self, shares: FloatArray, bound: float,
                 costs: FloatArray | None = None) -> TripStrategy:
        """The mixture with given shares (K,) as a strategy, which has the value of ``judged``.

        Its ambusher waits at the worst place. ``costs`` (K,) are driving times [s] of the paths, if
        the plan has them.
        """
        value, known = self.judged(shares).value, self._network
        seconds = None
        if costs is not None:
            lengths = known.lengths @ self._uses
            seconds = known.lengths * (self._uses @ (costs / lengths))
        network = with_places(replace(known, seconds=seconds), self._points, self._loss)
        game, q = make_game(network, self._game.options), np.zeros(len(network.points))
        q[len(known.points) + int((self._loss * (self._hit @ shares)).argmax())] = 1.0
        legs = Legs((game,), (Budget(game, math.inf, self._plan.trip.shortest_length),))
        return make_strategies(legs, self._uses @ shares, [None], Ambusher(q, (0.0,)),
                               np.array([min(bound, value)]))

    def best(self, costs: FloatArray, deadline: float = math.inf) -> PathMixture:
        """The shares of least value, up to ``MAX_GAP``.

        The mean of each row of ``costs`` (B, K) is at most 1.
        At the ``deadline`` (``time.monotonic``) it is the best mixture so far. Raises TimeLimit if
        there is none, and BudgetInfeasible if no mixture keeps to the costs.
        """
        lp = SharesLP(self.losses, costs, deadline)
        found: list[PathMixture] = []
        while True:
            try:
                solved = lp.solve()
            except TimeLimit:
                if not found:
                    raise
                break
            found.append(self.judged(solved.of_all(costs.shape[1])))
            if found[-1].value <= solved.value * (1.0 + MAX_GAP):
                break
            lp.losses = self.losses
        return min(found, key=attrgetter('value'))

    @property
    def losses(self) -> csr_matrix:
        """Costs (S, K) of each path at each of the sites so far, which include the worst."""
        return self._hit.multiply(self._loss[:, None]).tocsr()

    def _add_sites(self, points: FloatArray, loss: FloatArray) -> None:
        hit = csr_matrix(self._exposed.entering(points, self._game.reach) @ self._uses)
        hit.data[:] = 1.0  # however often a path comes back
        self._points = np.concatenate((self._points, points))
        self._loss = np.append(self._loss, loss)
        self._hit = csr_matrix(vstack((self._hit, hit)))


def check_judged(options: GameOptions) -> None:
    """Raise InvalidOption if paths cannot be judged in a game."""
    if options.ambush_radius == 0.0:
        raise InvalidOption('game.ambush_radius (--reach) must be over 0: paths are judged by what '
                            'an ambush reaches')


def side_by_side(inner: Sequence[int]) -> tuple[IndexArray, IndexArray]:
    """Lines from node 0 to node 1 over some ``inner`` nodes of each (K,), numbered from 2 on.

    Returns their edges (M, 2), one line after the other, and the line of each edge (M,).
    """
    nodes = np.arange(2, 2 + sum(inner))
    end: IndexArray = np.cumsum(inner)
    edges = np.column_stack((np.insert(nodes, end - np.array(inner), 0), np.insert(nodes, end, 1)))
    return edges, np.repeat(np.arange(len(inner)), np.add(inner, 1))


def _network_of(plan: Plan, paths: Sequence[FloatArray]) -> tuple[Network, csr_matrix]:
    """The network of the paths, and the edges (M, K) that each uses."""
    ends = plan.network.points[[plan.network.source, plan.network.target]]
    lines = []
    for path in paths:
        line = np.vstack((ends[0], path[:, :2], ends[1]))
        line = line[np.append(True, (line[1:] != line[:-1]).any(axis=1))]
        if len(line) == 2:  # its one edge could be another path's, too
            line = np.insert(line, 1, line.mean(axis=0), axis=0)
        lines.append(line[1:-1])
    edges, of = side_by_side(list(map(len, lines)))
    points = np.concatenate((ends, *lines))
    network = Network(points, np.zeros(len(points)), edges, 0, 1)
    return network, csr_matrix((np.ones(len(of)), (np.arange(len(of)), of)))

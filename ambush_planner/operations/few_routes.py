# SPDX-License-Identifier: Apache-2.0
"""A few routes: the best mixture that we can find of at most K paths that are driven.

Which K paths are best is a hard combinatorial problem. Candidates are drawn from the plan's
strategy, which knows where to drive; a linear program on the network chooses some of them, and
these are driven. Among them the search leaves out one after the other, and exchanges one at a time
while the value falls, on a matrix of sites and paths. Each result is judged anywhere on the map,
and places that are worse than known join the matrix (constraint generation).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray, frozen_array
from ..errors import InvalidOption, TimeLimit
from ..game.game import GameOptions
from ..game.route_sampler import route_edges
from ..game.strategy import TripStrategy
from ..planning.few import FewRoutes
from ..planning.plan import Plan, path_lengths
from ..routes.driven_path import driven_paths
from .best_shares import BestShares, SharesLP
from .path_mixtures import PathMixture, PathMixtures, check_judged

# Maximum number of routes; with more, draw from the plan itself.
MAX_ROUTES = 100
# Number of routes drawn to find different ones.
DRAWN = 1000
# Numbers of routes whose values make the curve.
CURVE = (1, 2, 4, 6, 10, 20)
# Drawn routes that are driven, to choose from.
CANDIDATES = 150
# Minimum share of a route.
MIN_SHARE = 1e-9
# Minimum gain of an exchange, as a share of the value.
MIN_GAIN = 2e-3
# How far the value on the map may exceed that at known sites, as a share of the value.
MAX_MISSED = 5e-3
# In each exchange: routes that are tried in addition, and those tried to be left out for them.
JOIN, LEAVE = 4, 3
# Maximum number of rounds of exchanges and judgements on the map.
ROUNDS = 5
# Temperatures of the soft maximum over sites for equal shares, from first to last, as shares of
# the value; and the penalty weight of the budget's overrun, in values.
SMOOTH, OVERRUN = (0.1, 0.03, 0.01), 1e3

_Valued = TypeVar('_Valued', PathMixture, BestShares)


def check_few(game: GameOptions, stops: int) -> None:
    """Raise InvalidOption if trips with this number of stops cannot have few routes in a game."""
    check_judged(game)
    if stops:
        raise InvalidOption('few routes (--routes) are for trips without stops: plan each leg as a '
                            'trip of its own, or leave routes out and draw each leg afresh')


def few_routes(plan: Plan, most: int, rng: np.random.Generator | None = None,
               deadline: float = math.inf) -> FewRoutes:
    """The best mixture that we can find of at most ``most`` routes within the plan's budget.

    ``rng`` draws the candidates, by default from the operating system's entropy. At the
    ``deadline`` (``time.monotonic``) it is the best mixture so far, and the curve has no smaller
    numbers of routes that were not tried.

    Raises InvalidOption if there are fewer different routes, and as ``check_few``; TimeLimit, with
    the plan's strategy, if there is no mixture at the deadline.
    """
    check_few(plan.options.game, len(plan.stops_xy))
    if not plan.strategy.value > 0.0:
        raise InvalidOption('the value is 0: no ambush causes a loss, so one route is as good as '
                            'several')
    routes = _candidates(plan, rng or np.random.default_rng())
    if not 1 <= most <= min(len(routes), MAX_ROUTES):
        raise InvalidOption(f'routes must be from 1 to {min(len(routes), MAX_ROUTES)}: of {DRAWN} '
                            f'drawn routes, {len(routes)} are different; got {most}')
    try:
        routes, costs = _promising(plan, routes, max(CANDIDATES, most), deadline)
        paths = driven_paths(plan.corridors[0], routes, plan.spacing,
                             plan.options.drive.turning_radius)
        if plan.network.seconds is None:
            costs = path_lengths(paths)
        search = _ColumnSearch(PathMixtures(plan.own_map, plan, paths),
                               costs[None] / plan.strategy.length_budget, deadline)
        found = search.best([*(k for k in CURVE if k < most), most])
    except TimeLimit as late:
        raise TimeLimit('the time limit (strategy.time_limit) passed before a mixture of few '
                        'routes was found; allow more time', plan.strategy) from late
    all_shares = found[most].shares
    chosen = np.argsort(-all_shares, kind='stable')[: np.count_nonzero(all_shares)]
    few = tuple(paths[k] for k in chosen)
    shares, spent = (frozen_array(each[chosen], np.float64) for each in (all_shares, costs))
    trip = mixed(plan, few, shares, search.bound, spent)
    curve = {min(size, len(chosen)): each.value for size, each in found.items()}  # no more needed
    curve[len(chosen)] = trip.value
    return FewRoutes(few, shares, trip, len(paths), spent, tuple(curve.items()),
                     tuple((frozen_array(routes[k], np.int64),) for k in chosen))


def mixed(plan: Plan, paths: Sequence[FloatArray], shares: FloatArray, bound: float,
          costs: FloatArray) -> TripStrategy:
    """The strategy of a plan's few paths with their shares and costs (K,), as FewRoutes has it."""
    timed = plan.network.seconds is not None
    return PathMixtures(plan.own_map, plan, paths).strategy(shares, bound,
                                                            costs if timed else None)


def _candidates(plan: Plan, rng: np.random.Generator) -> list[IndexArray]:
    """Different routes among ``DRAWN``."""
    drawn = plan.strategy.sample_routes(DRAWN, rng)
    return list({route.tobytes(): route for route in drawn}.values())


def _promising(plan: Plan, routes: list[IndexArray], most: int,
               deadline: float) -> tuple[list[IndexArray], FloatArray]:
    """Some routes, those of the best mixture on the network first, and their lengths (K,)."""
    game, network, budget = plan.strategy.game, plan.network, plan.strategy.budget
    edges = [route_edges(network, route) for route in routes]
    route = np.repeat(np.arange(len(edges)), list(map(len, edges)))
    uses = csr_matrix((np.ones(len(route)), (np.concatenate(edges), route)),
                      (len(network.edges), len(edges)))
    hit = csr_matrix(game.entering @ uses)
    hit.data[:] = 1.0  # however often a route comes back
    costs = budget.cost @ uses
    losses = hit.multiply(game.loss[game.sites][:, None]).tocsr()
    best = SharesLP(losses, costs[None] / budget.limit, deadline).solve()
    order = np.argsort(-best.shares, kind='stable')[:most]
    return [routes[k] for k in order], costs[order]


class _ColumnSearch:
    """The choice among paths, the columns of a matrix of losses at the sites known so far."""

    def __init__(self, mixtures: PathMixtures, costs: FloatArray,
                 deadline: float) -> None:
        self._mixtures, self._count = mixtures, costs.shape[1]
        self._lp = SharesLP(mixtures.losses.toarray(), costs, deadline)

    def best(self, sizes: Sequence[int]) -> dict[int, PathMixture]:
        """For each number of paths, in rising order, the best mixture found of at most that many.

        When the time is up, only the last number still counts. Raises TimeLimit if there is no
        mixture yet.
        """
        everything = np.arange(self._count)
        self._settled(self._lp.solve(everything), self._solved_again)
        every = self._lp.solve(everything)
        self.bound = every.bound
        self._enough = every.value * (1.0 + MAX_MISSED)
        count = np.count_nonzero(every.shares > MIN_SHARE)
        used = np.argsort(-every.shares, kind='stable')[:count]
        likeliest = self._lp.solve(used[: sizes[-1]])
        nested = self._nested(self._lp.solve(used), likeliest, sizes)
        found: dict[int, PathMixture] = {}
        best: PathMixture | None = None
        for size in sizes:
            if size not in nested or (self._late and size < sizes[-1]):
                continue
            if best is None or best.value > self._enough:
                improved = partial(self._improved, size=size)
                mixture = self._settled(improved(nested[size]), improved)
                best = _better_of([best, mixture]) if best else mixture
            found[size] = best
        return found

    @property
    def _late(self) -> bool:
        return time.monotonic() > self._lp.deadline

    def _settled(self, choice: BestShares,
                 better: Callable[[BestShares], BestShares]) -> PathMixture:
        """The best mixture that choices lead to; worse places on the map join the sites."""
        found: list[PathMixture] = []
        while True:
            found.append(self._mixtures.judged(choice.of_all(self._count, MIN_SHARE)))
            self._lp.losses = self._mixtures.losses.toarray()
            good = found[-1].value <= choice.value * (1.0 + MAX_MISSED)
            if good or self._late or len(found) == ROUNDS:
                return _better_of(found)
            choice = better(choice)

    def _solved_again(self, choice: BestShares) -> BestShares:
        """The same columns, on the sites known now; as they were if the time is up."""
        try:
            return self._lp.solve(choice.columns)
        except TimeLimit:
            return choice

    def _nested(self, choice: BestShares, likeliest: BestShares,
                sizes: Sequence[int]) -> dict[int, BestShares]:
        """Columns for each size: one after the other is left out, that which matters least.

        If the time is up, small sizes are missing, and the last one has at least the ``likeliest``.
        """
        found: dict[int, BestShares] = {}
        try:
            for size in sorted(sizes, reverse=True):
                while len(choice.columns) > size:
                    few = LEAVE if len(choice.columns) <= 2 * size else 1
                    choice = self._without_one(choice, few)
                found[size] = choice
        except TimeLimit:
            found.setdefault(sizes[-1], likeliest)
        return found

    def _improved(self, choice: BestShares, size: int) -> BestShares:
        """Let one column join, and one leave if there are too many, while the value falls.

        From this choice, or one that is good in equal shares (without that, values of 24 mixtures
        rose by 1 % on average, and by up to 8 %).
        """
        choice = self._solved_again(choice)
        with suppress(TimeLimit):
            choice = _better_of([choice, self._lp.solve(self._good_in_equal_shares(size))])
            while choice.value > self._enough and (better := self._better(choice, size)):
                choice = better
        return choice

    def _better(self, choice: BestShares, size: int) -> BestShares | None:
        column_costs = choice.column_costs.copy()
        column_costs[choice.columns] = np.inf
        for column in np.argsort(column_costs)[:JOIN]:
            other = self._lp.solve(np.append(choice.columns, column))
            enough = choice.value * (1.0 - MIN_GAIN)
            if other.value < enough and len(other.columns) > size:
                other = self._without_one(other, LEAVE)
            if other.value < enough:
                return other
        return None

    def _without_one(self, choice: BestShares, few: int) -> BestShares:
        """The best choice without one of the ``few`` columns of smallest shares."""
        return _better_of([self._lp.solve(np.delete(choice.columns, k))
                           for k in np.argsort(choice.shares)[:few]])

    def _good_in_equal_shares(self, size: int) -> IndexArray:
        """``size`` columns that join one by one, and are then exchanged, all in equal shares."""
        columns = np.zeros(0, dtype=np.int64)
        while len(columns) < size:
            columns = np.append(columns, self._smooth(columns, SMOOTH[0]).argmin())
        while True:
            for smooth in SMOOTH:
                columns = self._exchanged_equal(columns, smooth)
            mean = self._lp.losses[:, columns].mean(axis=1)
            if not self._lp.misses(mean, float(mean[self._lp.sites].max())):
                return columns

    def _exchanged_equal(self, chosen: IndexArray, smooth: float) -> IndexArray:
        """Exchange the best pair of columns until none lowers the smooth value."""
        least = math.inf
        while True:
            values = [self._smooth(np.delete(chosen, k), smooth) for k in range(len(chosen))]
            leaves, joins = np.unravel_index(np.argmin(values), np.shape(values))
            if not values[leaves][joins] < least or self._late:
                return chosen
            least = values[leaves][joins]
            chosen = np.append(np.delete(chosen, leaves), joins)

    def _smooth(self, chosen: IndexArray, smooth: float) -> FloatArray:
        """The smooth value (K,) of equal shares if each column joins; inf for those chosen."""
        losses, costs = ((each[:, chosen].sum(axis=1)[:, None] + each) / (len(chosen) + 1)
                         for each in (self._lp.losses[self._lp.sites], self._lp.costs))
        top, smooth = losses.max(axis=0), smooth * self._enough or smooth
        value = top + smooth * np.log(np.exp((losses - top) / smooth).sum(axis=0))
        value += OVERRUN * self._enough * np.maximum(costs - 1.0, 0.0).sum(axis=0)
        value[chosen] = np.inf
        return np.asarray(value)


def _better_of(found: Sequence[_Valued]) -> _Valued:
    """The one of least value; of equal ones, the first."""
    return min(found, key=lambda each: each.value)

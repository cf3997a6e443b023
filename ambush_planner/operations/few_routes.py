# SPDX-License-Identifier: Apache-2.0
"""Few routes: the best mixture that we can find of at most K paths a leg that are driven.

Which K paths are best is a hard combinatorial problem. Candidates are drawn from the plan's
strategies, which know where to drive; a linear program on the networks chooses some of them, and
these are driven. Among them the search leaves out one after the other, and exchanges one at a time
while the value falls, on a matrix of sites and paths. Each result is judged anywhere on the map,
and places that are worse than known join the matrix (constraint generation). The legs of a trip
share the sites, so the paths of all of them are chosen at once.
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
from ..game.route_sampler import route_edges
from ..planning.few import FewRoutes
from ..planning.plan import Plan, corridors_of, path_lengths
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


def few_routes(plan: Plan, most: int, rng: np.random.Generator | None = None,
               deadline: float = math.inf) -> FewRoutes:
    """The best mixture that we can find of at most ``most`` routes a leg within its budget.

    ``rng`` draws the candidates, by default from the operating system's entropy. At the
    ``deadline`` (``time.monotonic``) it is the best mixture so far, and the curve has no smaller
    numbers of routes that were not tried.

    Raises InvalidOption if each leg has fewer different routes, and as ``check_judged``; TimeLimit,
    with the plan's first strategy, if there is no mixture at the deadline.
    """
    check_judged(plan.options.game)
    if not plan.trip.value > 0.0:
        raise InvalidOption('the value is 0: no ambush causes a loss, so one route is as good as '
                            'several')
    rng = rng or np.random.default_rng()
    drawn = [{route.tobytes(): route for route in leg.sample_routes(DRAWN, rng)}
             for leg in plan.legs]
    routes = [route for own in drawn for route in own.values()]
    leg = np.repeat(np.arange(len(drawn)), list(map(len, drawn)))
    count = int(np.bincount(leg).max())
    if not 1 <= most <= min(count, MAX_ROUTES):
        raise InvalidOption(f'routes must be from 1 to {min(count, MAX_ROUTES)}: of {DRAWN} '
                            f'drawn routes, {count} are different; got {most}')
    try:
        routes, leg, costs = _promising(plan, routes, leg, max(CANDIDATES, most), deadline)
        paths = [path for k, corridors in enumerate(corridors_of(plan)) for path in driven_paths(
            corridors, [route for route, own in zip(routes, leg, strict=True) if own == k],
            plan.spacing, plan.options.drive.turning_radius)]
        if plan.network.seconds is None:
            costs = path_lengths(paths)
        search = _ColumnSearch(PathMixtures(plan.own_map, plan, paths, leg),
                               costs / _limits(plan)[leg], leg, deadline)
        found = search.best([*(k for k in CURVE if k < most), most])
    except TimeLimit as late:
        raise TimeLimit('the time limit (strategy.time_limit) passed before a mixture of few '
                        'routes was found; allow more time', plan.legs[0]) from late
    all_shares = found[most].shares
    chosen = np.lexsort((-all_shares, leg))
    chosen = chosen[all_shares[chosen] > 0.0]
    few, own = tuple(paths[k] for k in chosen), frozen_array(leg[chosen], np.int64)
    shares, spent = (frozen_array(each[chosen], np.float64) for each in (all_shares, costs))
    timed = plan.network.seconds is not None
    trip = PathMixtures(plan.own_map, plan, few, own).strategy(shares, search.bounds,
                                                               spent if timed else None)
    enough = int(np.bincount(own).max())
    curve = {min(size, enough): each.value for size, each in found.items()}
    curve[enough] = trip.value
    return FewRoutes(few, own, shares, trip, len(paths), spent, tuple(curve.items()))


def _limits(plan: Plan) -> FloatArray:
    """The length budget (legs,) of each leg."""
    return np.array([leg.length_budget for leg in plan.legs])


def _promising(plan: Plan, routes: list[IndexArray], leg: IndexArray, most: int,
               deadline: float) -> tuple[list[IndexArray], IndexArray, FloatArray]:
    """Some routes of each leg, those of the best mixture on the networks; legs and lengths (K,)."""
    legs = plan.trip.joint
    edges = [route_edges(legs.games[k].network, route) + legs.first[k]
             for k, route in zip(leg.tolist(), routes, strict=True)]
    route = np.repeat(np.arange(len(edges)), list(map(len, edges)))
    uses = csr_matrix((np.ones(len(route)), (np.concatenate(edges), route)),
                      (legs.edge_count, len(edges)))
    hit = csr_matrix(legs.entering @ uses)
    hit.data[:] = 1.0  # however often a route comes back
    costs = np.concatenate([budget.cost for budget in legs.budgets]) @ uses
    losses = hit.multiply(legs.loss[:, None]).tocsr()
    best = SharesLP(losses, costs / _limits(plan)[leg], leg, deadline).solve()
    some = _likeliest(np.lexsort((-best.shares, leg)), leg, most)
    return [routes[k] for k in some], leg[some], costs[some]


def _likeliest(order: IndexArray, leg: IndexArray, most: int) -> IndexArray:
    """The first ``most`` columns of each leg in an order, given the legs (K,) of all columns."""
    return np.concatenate([order[leg[order] == k][:most] for k in range(leg.max() + 1)])


class _ColumnSearch:
    """The choice among paths, the columns of a matrix of losses at the sites known so far."""

    def __init__(self, mixtures: PathMixtures, costs: FloatArray, leg: IndexArray,
                 deadline: float) -> None:
        self._mixtures, self._leg = mixtures, leg
        self._lp = SharesLP(mixtures.losses.toarray(), costs, leg, deadline)

    def best(self, sizes: Sequence[int]) -> dict[int, PathMixture]:
        """For each number of paths a leg, rising, the best mixture found of at most that many.

        When the time is up, only the last number still counts. Raises TimeLimit if there is no
        mixture yet.
        """
        everything = np.arange(len(self._leg))
        self._settled(self._lp.solve(everything), self._solved_again)
        every = self._lp.solve(everything)
        self.bounds = every.bounds
        self._enough = every.value * (1.0 + MAX_MISSED)
        count = np.count_nonzero(every.shares > MIN_SHARE)
        used = np.argsort(-every.shares, kind='stable')[:count]
        likeliest = self._lp.solve(_likeliest(used, self._leg, sizes[-1]))
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
            found.append(self._mixtures.judged(choice.of_all(self._leg, MIN_SHARE)))
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
                while (most := self._counts(choice.columns).max()) > size:
                    choice = self._without_one(choice, size, LEAVE if most <= 2 * size else 1)
                found[size] = choice
        except TimeLimit:
            found.setdefault(sizes[-1], likeliest)
        return found

    def _improved(self, choice: BestShares, size: int) -> BestShares:
        """Let one column join, and one of its leg leave if there are too many, while it helps.

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
        reduced_costs = choice.reduced_costs.copy()
        reduced_costs[choice.columns] = np.inf
        for column in np.argsort(reduced_costs)[:JOIN]:
            other = self._lp.solve(np.append(choice.columns, column))
            enough = choice.value * (1.0 - MIN_GAIN)
            if other.value < enough and self._counts(other.columns).max() > size:
                other = self._without_one(other, size, LEAVE)
            if other.value < enough:
                return other
        return None

    def _counts(self, columns: IndexArray) -> IndexArray:
        """The number (legs,) of each leg's columns."""
        return np.bincount(self._leg[columns], minlength=self._leg[-1] + 1)

    def _without_one(self, choice: BestShares, size: int, few: int) -> BestShares:
        """The best choice without one of the ``few`` columns of smallest shares.

        Of the legs that have more than ``size``.
        """
        too_many = (self._counts(choice.columns) > size)[self._leg[choice.columns]]
        return _better_of([self._lp.solve(np.delete(choice.columns, k))
                           for k in np.lexsort((choice.shares, ~too_many))[:few] if too_many[k]])

    def _good_in_equal_shares(self, size: int) -> IndexArray:
        """``size`` columns a leg that join one by one, and are then exchanged, in equal shares."""
        columns = np.zeros(0, dtype=np.int64)
        wanted = np.minimum(np.bincount(self._leg), size)
        while len(columns) < wanted.sum():
            leg = int((self._counts(columns) / wanted).argmin())
            own, values = self._smooth(columns, SMOOTH[0], leg)
            columns = np.append(columns, own[values.argmin()])
        while True:
            for smooth in SMOOTH:
                columns = self._exchanged_equal(columns, smooth)
            mean = self._lp.losses[:, columns] @ (1.0 / self._counts(columns)[self._leg[columns]])
            if not self._lp.misses(mean, float(mean[self._lp.sites].max())):
                return columns

    def _exchanged_equal(self, chosen: IndexArray, smooth: float) -> IndexArray:
        """Exchange the best pair of columns until none lowers the smooth value."""
        least = math.inf
        while True:
            tried = [self._smooth(np.delete(chosen, k), smooth, int(self._leg[chosen[k]]))
                     for k in range(len(chosen))]
            values = [own.min() for _, own in tried]
            leaves = int(np.argmin(values))
            if not values[leaves] < least or self._late:
                return chosen
            least, (columns, own) = values[leaves], tried[leaves]
            chosen = np.append(np.delete(chosen, leaves), columns[own.argmin()])

    def _smooth(self, chosen: IndexArray, smooth: float, leg: int) -> tuple[IndexArray, FloatArray]:
        """Columns (k,) of a leg, and the smooth value of equal shares if each joins those chosen.

        It is inf for a column that is chosen.
        """
        counts, joining = self._counts(chosen), np.flatnonzero(self._leg == leg)
        counts[leg] += 1
        weights = 1.0 / counts[self._leg[chosen]]
        known = self._lp.losses[self._lp.sites]
        losses = (known[:, chosen] @ weights)[:, None] + known[:, joining] / counts[leg]
        of_all = weights * self._lp.costs[chosen]
        costs = np.bincount(self._leg[chosen], of_all, len(counts))[:, None] + np.where(
            np.arange(len(counts))[:, None] == leg, self._lp.costs[joining] / counts[leg], 0.0)
        top, smooth = losses.max(axis=0), smooth * self._enough or smooth
        value = top + smooth * np.log(np.exp((losses - top) / smooth).sum(axis=0))
        value += OVERRUN * self._enough * np.maximum(costs - 1.0, 0.0).sum(axis=0)
        value[np.isin(joining, chosen)] = np.inf
        return joining, np.asarray(value)


def _better_of(found: Sequence[_Valued]) -> _Valued:
    """The one of least value; of equal ones, the first."""
    return min(found, key=lambda each: each.value)

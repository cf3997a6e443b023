# SPDX-License-Identifier: Apache-2.0
"""Few routes: a good mixture of at most K driven paths a leg.

The choice of the best K paths is a hard combinatorial problem. Candidates are drawn from the plan's
strategies; a linear program on the networks selects some of them, whose driven paths become the
columns of a matrix of losses. A local search then drops columns one by one, and exchanges single
columns while the value falls. Each result is judged on the whole map, and violated sites are added
to the matrix (constraint generation). The legs of a trip share the sites, so the paths of all legs
are chosen together.
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
# Numbers of routes for which the curve has values.
CURVE = (1, 2, 4, 6, 10, 20)
# Maximum number of candidate paths of a leg.
CANDIDATES = 150
# Minimum share of a route.
MIN_SHARE = 1e-9
# Minimum gain of an exchange, as a share of the value.
MIN_GAIN = 2e-3
# Maximum excess of the value on the map over that at known sites, as a share of the latter.
MAX_MISSED = 5e-3
# Numbers of columns that each exchange tries to add, and to drop in return.
JOIN, LEAVE = 4, 3
# Maximum number of rounds of exchanges and judgements on the map.
ROUNDS = 5
# Temperatures of the soft maximum over sites for equal shares, from first to last, as shares of
# the value; and the penalty weight of the budget's overrun, in values.
SMOOTH, OVERRUN = (0.1, 0.03, 0.01), 1e3

_Valued = TypeVar('_Valued', PathMixture, BestShares)


def few_routes(plan: Plan, most: int, rng: np.random.Generator | None = None,
               deadline: float = math.inf) -> FewRoutes:
    """Find a good mixture of at most ``most`` routes a leg within the length budgets.

    ``rng`` draws the candidates, by default from the operating system's entropy. At the
    ``deadline`` (``time.monotonic``), returns the incumbent; its curve then lacks smaller numbers
    of routes. Raises InvalidOption if no leg has that number of different routes, and as
    ``check_judged``; TimeLimit, with the plan's first strategy, if there is no incumbent then.
    """
    check_judged(plan.options.game)
    if not plan.trip.value > 0.0:
        raise InvalidOption('the value is 0: no ambush causes a loss, so one route is as good as '
                            'several')
    rng = rng or np.random.default_rng()
    drawn = [{route.tobytes(): route for route in leg.sample_routes(DRAWN, rng)}
             for leg in plan.legs]
    routes = [route for different in drawn for route in different.values()]
    leg = np.repeat(np.arange(len(drawn)), list(map(len, drawn)))
    count = int(np.bincount(leg).max())
    if not 1 <= most <= min(count, MAX_ROUTES):
        raise InvalidOption(f'routes must be from 1 to {min(count, MAX_ROUTES)}: of {DRAWN} '
                            f'drawn routes, {count} are different; got {most}')
    try:
        routes, leg, costs = _choose_candidates(plan, routes, leg, max(CANDIDATES, most), deadline)
        paths = [path for k, corridors in enumerate(corridors_of(plan)) for path in driven_paths(
            corridors, [route for route, number in zip(routes, leg, strict=True) if number == k],
            plan.spacing, plan.options.drive.turning_radius)]
        if plan.network.seconds is None:
            costs = path_lengths(paths)
        search = _ColumnSearch(PathMixtures(plan.own_map, plan, paths, leg),
                               costs / _limits(plan)[leg], leg, deadline)
        found = search.best([*(k for k in CURVE if k < most), most])
    except TimeLimit as limit:
        raise TimeLimit('the time limit (strategy.time_limit) passed before a mixture of few '
                        'routes was found; allow more time', plan.legs[0]) from limit
    all_shares = found[most].shares
    chosen = np.lexsort((-all_shares, leg))
    chosen = chosen[all_shares[chosen] > 0.0]
    few, few_legs = tuple(paths[k] for k in chosen), frozen_array(leg[chosen], np.int64)
    shares, few_costs = (frozen_array(each[chosen], np.float64) for each in (all_shares, costs))
    timed = plan.network.seconds is not None
    trip = PathMixtures(plan.own_map, plan, few, few_legs).strategy(
        shares, search.bounds, few_costs if timed else None)
    used = int(np.bincount(few_legs).max())
    curve = {min(size, used): each.value for size, each in found.items()}
    curve[used] = trip.value
    return FewRoutes(few, few_legs, shares, trip, len(paths), few_costs, tuple(curve.items()))


def _limits(plan: Plan) -> FloatArray:
    """Length budget (legs,) of each leg."""
    return np.array([leg.length_budget for leg in plan.legs])


def _choose_candidates(plan: Plan, routes: list[IndexArray], leg: IndexArray, count: int,
                       deadline: float) -> tuple[list[IndexArray], IndexArray, FloatArray]:
    """Choose ``count`` routes a leg, first those of the best mixture on the networks.

    Returns the routes, their legs (K,) and their costs (K,).
    """
    legs = plan.trip.joint
    edges = [route_edges(legs.games[k].network, route) + legs.first[k]
             for k, route in zip(leg.tolist(), routes, strict=True)]
    route = np.repeat(np.arange(len(edges)), list(map(len, edges)))
    uses = csr_matrix((np.ones(len(route)), (np.concatenate(edges), route)),
                      (legs.edge_count, len(edges)))
    hit = csr_matrix(legs.entering @ uses)
    hit.data[:] = 1.0  # a site hits a route at most once
    costs = np.concatenate([budget.cost for budget in legs.budgets]) @ uses
    losses = hit.multiply(legs.loss[:, None]).tocsr()
    best = SharesLP(losses, costs / _limits(plan)[leg], leg, deadline).solve()
    chosen = _first_of_legs(np.lexsort((-best.shares, leg)), leg, count)
    return [routes[k] for k in chosen], leg[chosen], costs[chosen]


def _first_of_legs(order: IndexArray, leg: IndexArray, count: int) -> IndexArray:
    """The first ``count`` columns of each leg in an order, given the legs (K,) of all columns."""
    return np.concatenate([order[leg[order] == k][:count] for k in range(leg.max() + 1)])


class _ColumnSearch:
    """Local search among paths, the columns of a matrix of losses at the known sites."""

    def __init__(self, mixtures: PathMixtures, costs: FloatArray, leg: IndexArray,
                 deadline: float) -> None:
        self._mixtures, self._leg = mixtures, leg
        self._lp = SharesLP(mixtures.losses.toarray(), costs, leg, deadline)

    def best(self, sizes: Sequence[int]) -> dict[int, PathMixture]:
        """Find mixtures of at most each number of paths a leg; the numbers rise.

        After the deadline, only the last number is still tried. Raises TimeLimit if there is no
        mixture by then.
        """
        everything = np.arange(len(self._leg))
        self._add_sites(self._lp.solve(everything), self._solve_again)
        relaxed = self._lp.solve(everything)
        self.bounds = relaxed.bounds
        self._target = relaxed.value * (1.0 + MAX_MISSED)
        count = np.count_nonzero(relaxed.shares > MIN_SHARE)
        used = np.argsort(-relaxed.shares, kind='stable')[:count]
        likeliest = self._lp.solve(_first_of_legs(used, self._leg, sizes[-1]))
        nested = self._drop_columns(self._lp.solve(used), likeliest, sizes)
        found: dict[int, PathMixture] = {}
        best: PathMixture | None = None
        for size in sizes:
            if size not in nested or (self._out_of_time and size < sizes[-1]):
                continue
            if best is None or best.value > self._target:
                improve = partial(self._improve, size=size)
                mixture = self._add_sites(improve(nested[size]), improve)
                best = _better_of([best, mixture]) if best else mixture
            found[size] = best
        return found

    @property
    def _out_of_time(self) -> bool:
        return time.monotonic() > self._lp.deadline

    def _add_sites(self, choice: BestShares,
                   improve: Callable[[BestShares], BestShares]) -> PathMixture:
        """Judge a choice on the map, add the sites found, and ``improve`` it, until none is added.

        Returns the best mixture judged.
        """
        judged: list[PathMixture] = []
        while True:
            judged.append(self._mixtures.judge(choice.of_all(self._leg, MIN_SHARE)))
            self._lp.losses = self._mixtures.losses.toarray()
            good = judged[-1].value <= choice.value * (1.0 + MAX_MISSED)
            if good or self._out_of_time or len(judged) == ROUNDS:
                return _better_of(judged)
            choice = improve(choice)

    def _solve_again(self, choice: BestShares) -> BestShares:
        """Find the best shares of the same columns at the sites known now, if time is left."""
        try:
            return self._lp.solve(choice.columns)
        except TimeLimit:
            return choice

    def _drop_columns(self, choice: BestShares, likeliest: BestShares,
                      sizes: Sequence[int]) -> dict[int, BestShares]:
        """Drop the least important column one by one; returns the choice for each size.

        After the deadline, small sizes are missing, and the last one is at least ``likeliest``.
        """
        found: dict[int, BestShares] = {}
        try:
            for size in sorted(sizes, reverse=True):
                while (most := self._counts(choice.columns).max()) > size:
                    choice = self._drop_one(choice, size, LEAVE if most <= 2 * size else 1)
                found[size] = choice
        except TimeLimit:
            found.setdefault(sizes[-1], likeliest)
        return found

    def _improve(self, choice: BestShares, size: int) -> BestShares:
        """Exchange columns of a choice, or of one that is good in equal shares, while it helps.

        Without the latter, values of 24 mixtures rose by 1 % on average, and by up to 8 %.
        """
        choice = self._solve_again(choice)
        with suppress(TimeLimit):
            choice = _better_of([choice, self._lp.solve(self._good_in_equal_shares(size))])
            while choice.value > self._target and (better := self._exchange(choice, size)):
                choice = better
        return choice

    def _exchange(self, choice: BestShares, size: int) -> BestShares | None:
        """Add one column, and drop one if its leg has more than ``size``; None if none gains."""
        reduced_costs = choice.reduced_costs.copy()
        reduced_costs[choice.columns] = np.inf
        for column in np.argsort(reduced_costs)[:JOIN]:
            other = self._lp.solve(np.append(choice.columns, column))
            target = choice.value * (1.0 - MIN_GAIN)
            if other.value < target and self._counts(other.columns).max() > size:
                other = self._drop_one(other, size, LEAVE)
            if other.value < target:
                return other
        return None

    def _counts(self, columns: IndexArray) -> IndexArray:
        """Number (legs,) of each leg's columns."""
        return np.bincount(self._leg[columns], minlength=self._leg[-1] + 1)

    def _drop_one(self, choice: BestShares, size: int, tries: int) -> BestShares:
        """Drop the best of ``tries`` small columns of the legs that have more than ``size``."""
        too_many = (self._counts(choice.columns) > size)[self._leg[choice.columns]]
        return _better_of([self._lp.solve(np.delete(choice.columns, k))
                           for k in np.lexsort((choice.shares, ~too_many))[:tries] if too_many[k]])

    def _good_in_equal_shares(self, size: int) -> IndexArray:
        """Choose ``size`` columns a leg, greedily and then by exchanges, for equal shares."""
        columns = np.zeros(0, dtype=np.int64)
        counts = np.minimum(np.bincount(self._leg), size)
        while len(columns) < counts.sum():
            leg = int((self._counts(columns) / counts).argmin())
            candidates, values = self._smooth_values(columns, SMOOTH[0], leg)
            columns = np.append(columns, candidates[values.argmin()])
        while True:
            for smooth in SMOOTH:
                columns = self._exchange_equal(columns, smooth)
            mean = self._lp.losses[:, columns] @ (1.0 / self._counts(columns)[self._leg[columns]])
            if not self._lp.add_violated(mean, float(mean[self._lp.sites].max())):
                return columns

    def _exchange_equal(self, chosen: IndexArray, smooth: float) -> IndexArray:
        """Exchange the best pair of columns until none lowers the smooth value."""
        least = math.inf
        while True:
            tried = [self._smooth_values(np.delete(chosen, k), smooth, int(self._leg[chosen[k]]))
                     for k in range(len(chosen))]
            best = [values.min() for _, values in tried]
            dropped = int(np.argmin(best))
            if not best[dropped] < least or self._out_of_time:
                return chosen
            least, (candidates, values) = best[dropped], tried[dropped]
            chosen = np.append(np.delete(chosen, dropped), candidates[values.argmin()])

    def _smooth_values(self, chosen: IndexArray, smooth: float,
                       leg: int) -> tuple[IndexArray, FloatArray]:
        """Columns (k,) of a leg, and the smooth value of equal shares if each is added to chosen.

        It is inf for a column that is chosen already.
        """
        counts, added = self._counts(chosen), np.flatnonzero(self._leg == leg)
        counts[leg] += 1
        weights = 1.0 / counts[self._leg[chosen]]
        known = self._lp.losses[self._lp.sites]
        losses = (known[:, chosen] @ weights)[:, None] + known[:, added] / counts[leg]
        chosen_costs = weights * self._lp.costs[chosen]
        costs = np.bincount(self._leg[chosen], chosen_costs, len(counts))[:, None] + np.where(
            np.arange(len(counts))[:, None] == leg, self._lp.costs[added] / counts[leg], 0.0)
        top, smooth = losses.max(axis=0), smooth * self._target or smooth
        value = top + smooth * np.log(np.exp((losses - top) / smooth).sum(axis=0))
        value += OVERRUN * self._target * np.maximum(costs - 1.0, 0.0).sum(axis=0)
        value[np.isin(added, chosen)] = np.inf
        return added, np.asarray(value)


def _better_of(found: Sequence[_Valued]) -> _Valued:
    """Return the one of least value; of equal ones, the first."""
    return min(found, key=lambda each: each.value)

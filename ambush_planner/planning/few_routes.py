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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray, frozen_array
from ..errors import BudgetInfeasible, InvalidOption
from ..game.route_sampler import route_edges
from ..routes.driven_path import driven_paths
from .path_mixtures import PathMixture, PathMixtures, best_shares
from .plan import DRAWN, Plan

# Maximum number of routes; with more, draw from the plan itself.
MAX_ROUTES = 100
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
# Sites with which an LP begins, those that join at once, and its relative precision.
FIRST_SITES, MORE_SITES, PRECISE = 20, 10, 1e-4
# Maximum number of rounds of exchanges and judgements on the map.
ROUNDS = 5
# Temperatures of the soft maximum over sites for equal shares, from first to last, as shares of
# the value; and the penalty weight of a budget's overrun, in values.
SMOOTH, OVERRUN = (0.1, 0.03, 0.01), 1e3


@dataclass(frozen=True, eq=False)
class FewRoutes:
    """A mixture of few routes.

    Attributes
    ----------
    paths : K arrays (L, 3)
        The driven paths, as ``Plan.paths`` has them.
    shares : (K,)
        How likely each is driven; the largest first.
    value : float
        Mean loss by the worst ambusher who knows all of this, anywhere on the map.
    worst_xy : (2,)
        Where that is [m].
    lower_bound : float
        No mixture of the ``candidates`` has a smaller value: paths as they are driven, from which
        these were chosen. The plan's own bound is that of another game, in which convoys may stray
        from their routes by the tube.
    candidates : int
        Their number.
    costs : (K,)
        Lengths [m], or driving times [s] if the network has them.
    curve : ((K, value), ...)
        The value of the best mixture found with at most K routes.
    routes : K arrays
        The nodes of each route in the plan's network.
    """

    paths: tuple[FloatArray, ...]
    shares: FloatArray
    value: float
    worst_xy: FloatArray
    lower_bound: float
    candidates: int
    costs: FloatArray
    curve: tuple[tuple[int, float], ...]
    routes: tuple[IndexArray, ...]

    def draw(self, rng: np.random.Generator) -> int:
        """Draw the index of a departure's route."""
        return int(rng.choice(len(self.paths), p=self.shares))

    def drawn(self, n: int, rng: np.random.Generator) -> list[FloatArray]:
        """Draw the paths of ``n`` departures."""
        return [self.paths[k] for k in rng.choice(len(self.paths), n, p=self.shares)]


def few_routes(plan: Plan, most: int, equal: bool = False,
               rng: np.random.Generator | None = None) -> FewRoutes:
    """The best mixture that we can find of at most ``most`` routes within the plan's budgets.

    With ``equal`` shares there are exactly ``most`` routes. ``rng`` draws the candidates, by
    default from the operating system's entropy.

    Raises InvalidOption if there are fewer different routes, and as PathMixtures; BudgetInfeasible
    if no equal shares are within the budgets.
    """
    assert plan.risk_map is not None
    if not plan.strategy.value > 0.0:
        raise InvalidOption('the value is 0: no ambush causes a loss, so one route is as good as '
                            'several')
    routes = _candidates(plan, rng or np.random.default_rng())
    if not 1 <= most <= min(len(routes), MAX_ROUTES):
        raise InvalidOption(f'routes must be from 1 to {min(len(routes), MAX_ROUTES)}: of {DRAWN} '
                            f'drawn routes, {len(routes)} are different; got {most}')
    routes, costs = _promising(plan, routes, max(CANDIDATES, most))
    paths = driven_paths(plan.corridors, routes, plan.spacing, plan.options.drive.turning_radius)
    if plan.network.seconds is None:
        costs[0] = [np.hypot(*np.diff(path[:, :2], axis=0).T).sum() for path in paths]
    limits = [cost / budget.limit for cost, budget in zip(costs, plan.strategy.budgets, strict=True)
              if budget.binds]
    search = _ColumnSearch(PathMixtures(plan.risk_map, plan, paths),
                     np.reshape(limits, (len(limits), len(paths))), equal)
    sizes = [*(k for k in CURVE if k < most), most]
    found = search.best(sizes)
    shares = found[-1].shares
    chosen = np.argsort(-shares, kind='stable')[: np.count_nonzero(shares)]
    return FewRoutes(tuple(paths[k] for k in chosen), frozen_array(shares[chosen], np.float64),
                     found[-1].value, found[-1].worst_xy, min(search.bound, found[-1].value),
                     len(paths), frozen_array(costs[0][chosen], np.float64),
                     tuple({min(size, len(chosen)): mixture.value  # more do not lower it
                            for size, mixture in zip(sizes, found, strict=True)}.items()),
                     tuple(frozen_array(routes[k], np.int64) for k in chosen))


def _candidates(plan: Plan, rng: np.random.Generator) -> list[IndexArray]:
    """Different routes among ``DRAWN``."""
    drawn = plan.strategy.sample_routes(DRAWN, rng)
    return list({plan.network.places[route].tobytes(): route for route in drawn}.values())


def _promising(plan: Plan, routes: list[IndexArray],
               most: int) -> tuple[list[IndexArray], FloatArray]:
    """Some routes, those of the best mixture on the network first, and their costs (2, K)."""
    game, network, budgets = plan.strategy.game, plan.network, plan.strategy.budgets
    edges = [route_edges(network, route) for route in routes]
    route = np.repeat(np.arange(len(edges)), list(map(len, edges)))
    uses = csr_matrix((np.ones(len(route)), (np.concatenate(edges), route)),
                      (len(network.edges), len(edges)))
    hit = csr_matrix(game.hits @ uses)
    hit.data[:] = 1.0  # however often a route comes back
    costs = np.array([budget.cost @ uses for budget in budgets])
    limits = np.array([[budget.limit] for budget in budgets])
    best = best_shares(hit.multiply(game.loss[game.sites][:, None]).tocsr(), costs / limits)
    order = np.argsort(-best.shares, kind='stable')[:most]
    return [routes[k] for k in order], costs[:, order]


class _Choice(NamedTuple):
    """Some columns (k,), the value of their best mixture, and its shares.

    What column j would add is priced by ``column_costs[j]``: less than the value is a gain. No
    mixture of any columns has a value below ``bound``.
    """

    columns: IndexArray
    value: float
    shares: FloatArray
    column_costs: FloatArray
    bound: float = 0.0


_Valued = TypeVar('_Valued', PathMixture, _Choice)


class _ColumnSearch:
    """The choice among paths, the columns of a matrix of losses at the sites known so far."""

    def __init__(self, mixtures: PathMixtures, costs: FloatArray, equal: bool) -> None:
        self._mixtures, self._costs, self._equal = mixtures, costs, equal
        self._count = costs.shape[1]
        self._losses = mixtures.losses.toarray()
        self._sites = np.argsort(-self._losses.mean(axis=1))[:FIRST_SITES]

    def best(self, sizes: Sequence[int]) -> list[PathMixture]:
        """The best mixtures found of at most each of the numbers of paths, in rising order."""
        everything = np.arange(self._count)
        self._settled(everything, self._solved)
        every = self._solved(everything)
        self.bound = every.bound
        self._enough = every.value * (1.0 + MAX_MISSED)
        nested = self._nested(self._solved(every.columns[every.shares > MIN_SHARE]), sizes)
        choose = self._of_equal_shares if self._equal else self._exchanged
        found: list[PathMixture] = []
        for size in sizes:
            if not found or self._equal or found[-1].value > self._enough:
                mixture = self._settled(nested[size], partial(choose, size=size))
                found.append(mixture if self._equal else _better_of([*found[-1:], mixture]))
            else:
                found.append(found[-1])
        return found

    def _settled(self, columns: IndexArray, choose: Callable[[IndexArray], _Choice]) -> PathMixture:
        """The best mixture that choices lead to; worse places on the map join the sites."""
        found = []
        for _ in range(ROUNDS):
            choice = choose(columns)
            if not math.isfinite(choice.value):
                raise BudgetInfeasible(f'no mixture of {len(choice.columns)} routes was found '
                                       'within the budgets; raise max_detour or max_exposure')
            shares = np.zeros(self._count)
            shares[choice.columns] = np.where(choice.shares > MIN_SHARE, choice.shares, 0.0)
            found.append(self._mixtures.judged(shares / shares.sum()))
            self._losses = self._mixtures.losses.toarray()
            if found[-1].value <= choice.value * (1.0 + MAX_MISSED):
                break
            columns = choice.columns
        return _better_of(found)

    def _nested(self, choice: _Choice, sizes: Sequence[int]) -> dict[int, IndexArray]:
        """Columns for each size: one after the other is left out, that which matters least."""
        found = {}
        for size in sorted(sizes, reverse=True):
            while len(choice.columns) > size:
                few = LEAVE if len(choice.columns) <= 2 * size else 1
                choice = self._without_one(choice, few)
            found[size] = choice.columns
        return found

    def _exchanged(self, columns: IndexArray, size: int) -> _Choice:
        """Let one column join, and one leave if there are too many, while the value falls."""
        equal = self._of_equal_shares(columns[:0], size)
        choice = _better_of([self._solved(columns), self._solved(equal.columns)])
        while choice.value > self._enough and (better := self._better(choice, size)):
            choice = better
        return choice

    def _better(self, choice: _Choice, size: int) -> _Choice | None:
        column_costs = choice.column_costs.copy()
        column_costs[choice.columns] = np.inf
        for column in np.argsort(column_costs)[:JOIN]:
            other = self._solved(np.append(choice.columns, column))
            enough = choice.value * (1.0 - MIN_GAIN)
            if other.value < enough and len(other.columns) > size:
                other = self._without_one(other, LEAVE)
            if other.value < enough:
                return other
        return None

    def _without_one(self, choice: _Choice, few: int) -> _Choice:
        """The best choice without one of the ``few`` columns of smallest shares."""
        return _better_of([self._solved(np.delete(choice.columns, k))
                           for k in np.argsort(choice.shares)[:few]])

    def _solved(self, columns: IndexArray) -> _Choice:
        """The best mixture of the columns, by the LP over the sites that matter."""
        losses, costs = self._losses[:, columns], self._costs[:, columns]
        while True:
            best = best_shares(csr_matrix(losses[self._sites]), costs)
            sites = self._sites
            if not self._misses(losses @ best.shares, best.value):
                break
        column_costs = best.q @ self._losses[sites] + best.prices @ self._costs
        bound = float(column_costs.min() - best.prices.sum()) / max(float(best.q.sum()), 1.0)
        return _Choice(columns, best.value, best.shares, column_costs, max(bound, 0.0))

    def _misses(self, losses: FloatArray, value: float) -> bool:
        """Let some sites join that cause more than a value found without them."""
        worst = np.argsort(-losses)[:MORE_SITES]
        worst = np.setdiff1d(worst[losses[worst] > value * (1.0 + PRECISE)], self._sites)
        self._sites = np.append(self._sites, worst)
        return len(worst) > 0

    def _of_equal_shares(self, columns: IndexArray, size: int) -> _Choice:
        """``size`` columns of equal shares: some join one by one, then they are exchanged."""
        while len(columns) < size:
            columns = np.append(columns, self._smooth(columns, SMOOTH[0]).argmin())
        while True:
            for smooth in SMOOTH:
                columns = self._exchanged_equal(columns, smooth)
            mean = self._losses[:, columns].mean(axis=1)
            if not self._misses(mean, float(mean[self._sites].max())):
                break
        over = (self._costs[:, columns].mean(axis=1) > 1.0 + MIN_SHARE).any()
        return _Choice(columns, math.inf if over else float(mean.max()),
                       np.full(size, 1.0 / size), np.zeros(0))

    def _exchanged_equal(self, chosen: IndexArray, smooth: float) -> IndexArray:
        """Exchange the best pair of columns until none lowers the smooth value."""
        least = math.inf
        while True:
            values = [self._smooth(np.delete(chosen, k), smooth) for k in range(len(chosen))]
            leaves, joins = np.unravel_index(np.argmin(values), np.shape(values))
            if not values[leaves][joins] < least:
                return chosen
            least = values[leaves][joins]
            chosen = np.append(np.delete(chosen, leaves), joins)

    def _smooth(self, chosen: IndexArray, smooth: float) -> FloatArray:
        """The smooth value (K,) of equal shares if each column joins; inf for those chosen."""
        losses, costs = ((each[:, chosen].sum(axis=1)[:, None] + each) / (len(chosen) + 1)
                         for each in (self._losses[self._sites], self._costs))
        top, smooth = losses.max(axis=0), smooth * self._enough or smooth
        value = top + smooth * np.log(np.exp((losses - top) / smooth).sum(axis=0))
        value += OVERRUN * self._enough * np.maximum(costs - 1.0, 0.0).sum(axis=0)
        value[chosen] = np.inf
        return np.asarray(value)


def _better_of(found: Sequence[_Valued]) -> _Valued:
    """The one of least value; of equal ones, the first."""
    return min(found, key=lambda each: each.value)

# SPDX-License-Identifier: Apache-2.0
"""The next place to secure: the one that lowers a plan's value most if nobody can wait around it.

Places are chosen greedily, each given those before it. The ambusher of any solved plan, restricted
to other sites, bounds from below what securing a place can achieve (``bound_if_secured``). So only
the most promising candidates are solved, until no other one can be better by more than the risk
slack, or the time limit passes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ..arrays import sums
from ..errors import InvalidOption, TimeLimit
from ..game.game import SecuredPlace
from ..game.revaluation import bound_if_secured
from ..game.strategy import TripStrategy
from ..game.tolerance import within
from ..maps.risk_map import RiskMap
from ..option_checks import check_at_least, check_whole
from ..planning.cell_losses import thin_out
from ..planning.options import PlanningOptions
from ..planning.solving import Ground, WarmStart
from ..planning.trip import Position, Trip, plan_trip

# Candidates of one step if none are given, and their least distance, as a share of the radius.
MAX_CANDIDATES, MIN_DISTANCE = 16, 0.7
# Share of the time limit for the plan before any place is secured.
FIRST_PLAN = 1.0 / 3.0

_Place = tuple[str, Position]


@dataclass(frozen=True, eq=False)
class Held:
    """One place to secure, with the strategy if it and all places before it are secured.

    ``name`` is that of its candidate, '' if none were given; ``xy`` is its position [m]. With any
    other candidate instead, the value is at least ``others`` (inf: there was none). Of the
    ``candidates``, only ``solved`` had to be solved; bounds rule out the rest.
    """

    name: str
    xy: Position
    strategy: TripStrategy
    others: float
    solved: int
    candidates: int


@dataclass(frozen=True, eq=False)
class Holding:
    """The places to secure, in order, and the strategy ``before`` any of them is secured.

    ``complete`` is false if the time limit passed before bounds ruled out all other candidates.
    """

    before: TripStrategy
    steps: tuple[Held, ...]
    complete: bool = True

    @property
    def strategies(self) -> tuple[TripStrategy, ...]:
        """Strategies with the first 0, 1, 2, ... places secured."""
        return self.before, *(step.strategy for step in self.steps)


def places_to_hold(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                   radius: float, count: int = 5, options: PlanningOptions | None = None, *,
                   stops: Iterable[npt.ArrayLike] = (),
                   candidates: Mapping[str, Position] | None = None,
                   progress: Callable[[int, int], None] = lambda number, left: None) -> Holding:
    """Find up to ``count`` places to secure on a trip, which is given as for ``plan_trip``.

    Nobody can wait within ``radius`` [m] of a secured place, and with a reach nobody who drives
    there is hit. Value and lower bound of each step are those of ``plan_trip`` with these
    ``secured_places``. By default, ``candidates`` [m] are the sites around which site prices are
    highest, and then those of largest mean loss. The search ends early if the value is 0, no
    candidate remains, or the time limit passes; then the last place is the best of those solved.
    Before each game, ``progress`` is called with the number of the place that is sought and the
    number of candidates that may be the best.

    Raises InvalidOption if the radius is below the map's resolution, the count below 1 or a
    candidate off the map, and the errors of ``plan_trip``.
    """
    _check(risk_map, radius, count, candidates or {})
    options, begin = options or PlanningOptions(), time.monotonic()
    limit, stops = options.strategy.time_limit, list(stops)
    end = begin + limit
    first = replace(options, strategy=replace(options.strategy, time_limit=FIRST_PLAN * limit))
    plan = plan_trip(risk_map, start_xy, goal_xy, first, stops=stops)

    networks = Trip(risk_map, start_xy, goal_xy, stops, options).networks(plan.network.refined)

    def ground_with(secured: tuple[SecuredPlace, ...]) -> Ground:
        game = replace(options.game, secured_places=secured)
        return Ground.of(risk_map, replace(options, game=game))

    def solve(secured: tuple[SecuredPlace, ...]) -> TripStrategy:
        return ground_with(secured).solve(networks, end)

    def compare(secured: tuple[SecuredPlace, ...], previous: TripStrategy) -> TripStrategy:
        return ground_with(secured).compare(networks, end, WarmStart.of(previous))

    before = strategy = plan.trip
    steps: list[Held] = []
    complete = True
    while complete and len(steps) < count and strategy.value > 0.0:
        taken = [step.name for step in steps]
        given = None if candidates is None else [
            each for each in candidates.items() if each[0] not in taken]
        if not (places := _order_by_site_price(strategy, given, radius)):
            break
        step, complete = _find_best(places, radius, strategy, options.strategy.tolerance, compare,
                                    solve, end, partial(progress, len(steps) + 1))
        if step:
            steps.append(step)
            strategy = step.strategy
    return Holding(before, tuple(steps), complete)


def _find_best(places: Sequence[_Place], radius: float, before: TripStrategy, tolerance: float,
               compare: Callable[..., TripStrategy], solve: Callable[..., TripStrategy],
               end: float, progress: Callable[[int], None]) -> tuple[Held | None, bool]:
    """Find the place whose securing gives the least value; the first within the tolerance of it.

    ``compare`` finds the value of a place quickly, ``solve`` the strategy of the best one. Also
    returns whether the search ended before ``end`` (``time.monotonic``). If not, the place is the
    best of those compared, or None if none of them lowers the value.
    """
    secured = [(*before.game.options.secured_places, (*xy, radius)) for _, xy in places]
    bounds = np.array([bound_if_secured(before, each) for each in secured])
    values, last = np.full(len(secured), np.inf), before
    strategies: dict[int, TripStrategy] = {}
    with suppress(TimeLimit):
        while remaining := [k for k in np.flatnonzero(np.isinf(values)).tolist()
                            if not within(values.min(), bounds[k], tolerance)]:
            if time.monotonic() >= end:
                break
            progress(len(remaining))
            k = min(remaining, key=lambda each: float(bounds[each]))
            last = strategies[k] = compare(secured[k], last)
            values[k], bounds[k] = last.value, last.lower_bound
            for j in set(remaining) - {k}:
                bounds[j] = max(bounds[j], bound_if_secured(last, secured[j]))
    if remaining and not values.min() <= before.value:
        return None, False
    best = next(k for k, value in enumerate(values) if within(value, values.min(), tolerance))
    strategy = strategies[best]
    if not remaining:
        with suppress(TimeLimit):
            strategy = solve(secured[best])
    others = float(np.delete(bounds, best).min(initial=np.inf))
    return Held(*places[best], strategy, others, len(strategies), len(secured)), not remaining


def _order_by_site_price(strategy: TripStrategy, given: Sequence[_Place] | None,
                         radius: float) -> list[_Place]:
    """Candidates by falling site prices within the radius; by default sites of the strategy.

    A price counts half as much at the radius as at the candidate's position.
    """
    game = strategy.game
    points = game.network.points[game.sites]
    site_prices = (game.loss * strategy.ambusher.q)[game.sites]
    centres = points if given is None else np.reshape([xy for _, xy in given], (-1, 2))
    pairs = cKDTree(centres).sparse_distance_matrix(cKDTree(points), radius, output_type='ndarray')
    near = site_prices[pairs['j']] * (1.0 - 0.5 * (pairs['v'] / radius)**2)
    taken = sums(pairs['i'], near, len(centres))
    if given is not None:
        return [given[k] for k in np.argsort(-taken, kind='stable')]
    most_first = np.lexsort((-game.loss[game.sites] * strategy.hits.sum(axis=0), -taken))
    kept = thin_out(points, most_first, MIN_DISTANCE * radius)[:MAX_CANDIDATES]
    return [('', (x, y)) for x, y in points[kept].tolist()]


def _check(risk_map: RiskMap, radius: float, count: int,
           candidates: Mapping[str, Position]) -> None:
    check_whole('count', count, 1)
    check_at_least('radius (at least a cell of the map)', radius, risk_map.resolution, 'm')
    for name, (x, y) in candidates.items():
        if not risk_map.contains(risk_map.to_map_axes((x, y))):
            (left, low), (right, high) = risk_map.bounds
            raise InvalidOption(
                f'candidate {name!r} at ({x:.6g}, {y:.6g}) is off the map, which spans x '
                f'{left:.6g} to {right:.6g} and y {low:.6g} to {high:.6g} [m]')

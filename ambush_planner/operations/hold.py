# SPDX-License-Identifier: Apache-2.0
"""The next place to hold: the one that lowers a plan's value most if nobody can wait around it.

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
from ..planning.cell_losses import thinned
from ..planning.options import PlanningOptions
from ..planning.solving import Ground, WarmStart
from ..planning.trip import Position, Trip, plan_trip

# Candidates of one step if none are given, and their least distance, as a share of the radius.
MAX_CANDIDATES, APART = 16, 0.7
# Share of the time limit for the plan before any place is held.
PLANNED = 1.0 / 3.0

_Place = tuple[str, Position]


@dataclass(frozen=True, eq=False)
class Held:
    """A place to hold, with the strategy if it and all places before it are held.

    ``name`` is its candidate's, '' if none were given, and ``xy`` its position [m]. With any other
    candidate instead, the value is at least ``others``; inf if there was none. ``solved`` of the
    ``candidates`` were solved; the bounds rule out the others.
    """

    name: str
    xy: Position
    strategy: TripStrategy
    others: float
    solved: int
    candidates: int


@dataclass(frozen=True, eq=False)
class Holding:
    """The places to hold, in their order, and the strategy ``before``, if none of them is held.

    ``complete`` is false if the time was up before the bounds had ruled out all other candidates.
    """

    before: TripStrategy
    steps: tuple[Held, ...]
    complete: bool = True

    @property
    def strategies(self) -> tuple[TripStrategy, ...]:
        """The strategies with 0, 1, 2, ... of the places held."""
        return self.before, *(step.strategy for step in self.steps)


def places_to_hold(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                   radius: float, count: int = 5, options: PlanningOptions | None = None, *,
                   stops: Iterable[npt.ArrayLike] = (),
                   candidates: Mapping[str, Position] | None = None,
                   progress: Callable[[int, int], None] = lambda number, left: None) -> Holding:
    """Find up to ``count`` places to hold on a trip, as ``plan_trip`` takes it.

    Holding a place means that nobody can wait within ``radius`` [m] of it, and with a reach that
    nobody who drives there is hit. Value and lower bound of each step are those of ``plan_trip``
    with these ``held_places``. Candidates are the given ones [m], or the sites around which the
    ambusher causes most, and those that cost most beyond. The search ends early if the value is
    0, no candidate remains, or the time limit of the options is up; then the last place is the best
    of those that were solved. Before each game, ``progress`` is called with the number of the place
    that is sought and how many candidates may be the best.

    Raises InvalidOption if the radius is below the map's resolution, the count below 1 or a
    candidate off the map, and the errors of ``plan_trip``.
    """
    _check(risk_map, radius, count, candidates or {})
    options, begin = options or PlanningOptions(), time.monotonic()
    limit, stops = options.strategy.time_limit, list(stops)
    end = begin + limit
    first = replace(options, strategy=replace(options.strategy, time_limit=PLANNED * limit))
    plan = plan_trip(risk_map, start_xy, goal_xy, first, stops=stops)

    networks = Trip(risk_map, start_xy, goal_xy, stops, options).networks(plan.network.refined)

    def ground_with(held: tuple[SecuredPlace, ...]) -> Ground:
        return Ground.of(risk_map, replace(options, game=replace(options.game, held_places=held)))

    def planned(held: tuple[SecuredPlace, ...]) -> TripStrategy:
        return ground_with(held).solve(networks, end)

    def compared(held: tuple[SecuredPlace, ...], after: TripStrategy) -> TripStrategy:
        return ground_with(held).compare(networks, end, WarmStart.of(after))

    before = strategy = plan.trip
    steps: list[Held] = []
    complete = True
    while complete and len(steps) < count and strategy.value > 0.0:
        taken = [step.name for step in steps]
        given = None if candidates is None else [
            each for each in candidates.items() if each[0] not in taken]
        if not (places := _by_site_price(strategy, given, radius)):
            break
        step, complete = _best_of(places, radius, strategy, options.strategy.tolerance, compared,
                                  planned, end, partial(progress, len(steps) + 1))
        if step:
            steps.append(step)
            strategy = step.strategy
    return Holding(before, tuple(steps), complete)


def _best_of(places: Sequence[_Place], radius: float, before: TripStrategy, tolerance: float,
             compared: Callable[..., TripStrategy], planned: Callable[..., TripStrategy],
             end: float, progress: Callable[[int], None]) -> tuple[Held | None, bool]:
    """The place of least value if it is held, too; of those within the slack of it, the first.

    Places are ``compared`` by their values; the best one is ``planned``.

    Also returns whether it was found before ``end`` (``time.monotonic``); else it is the best of
    those solved by then, None if none of them is better than holding no other place.
    """
    held = [(*before.game.options.held_places, (*xy, radius)) for _, xy in places]
    bounds = np.array([bound_if_secured(before, each) for each in held])
    values, last = np.full(len(held), np.inf), before
    strategies: dict[int, TripStrategy] = {}
    with suppress(TimeLimit):
        while left := [k for k in np.flatnonzero(np.isinf(values)).tolist()
                       if not within(values.min(), bounds[k], tolerance)]:
            if time.monotonic() >= end:
                break
            progress(len(left))
            k = min(left, key=lambda each: float(bounds[each]))
            last = strategies[k] = compared(held[k], last)
            values[k], bounds[k] = last.value, last.lower_bound
            for j in set(left) - {k}:
                bounds[j] = max(bounds[j], bound_if_secured(last, held[j]))
    if left and not values.min() <= before.value:
        return None, False
    best = next(k for k, value in enumerate(values) if within(value, values.min(), tolerance))
    strategy = strategies[best]
    if not left:
        with suppress(TimeLimit):
            strategy = planned(held[best])
    others = float(np.delete(bounds, best).min(initial=np.inf))
    return Held(*places[best], strategy, others, len(strategies), len(held)), not left


def _by_site_price(strategy: TripStrategy, given: Sequence[_Place] | None,
                    radius: float) -> list[_Place]:
    """The candidates, those first that take most from the ambusher; by default some sites.

    What he causes at the radius from a candidate counts half as much as at its position.
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
    kept = thinned(points, most_first, APART * radius)[:MAX_CANDIDATES]
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

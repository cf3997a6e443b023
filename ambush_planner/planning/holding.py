"""What to hold next: the place that lowers a plan's value most if nobody can wait around it.

Places are added one by one, each given those before it. Any ambusher's mixture bounds from below
what holding a place can achieve, by what it causes from elsewhere (``bound_if_held``). So only the
most promising candidates are solved, until no other one can be better by more than the slack; each
solve adds a mixture.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray, sums
from ..errors import InvalidOption
from ..game.game import HeldPlace
from ..game.revaluation import bound_if_held
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from ..network.network import Network
from ..option_checks import check_whole
from .options import PlanningOptions
from .solving import WarmStart, solve_on_network
from .trip import Position, trip_network

# Candidates of one step: around the ambusher's sites a radius apart, between these half a radius
# apart, and at other sites that cost almost as much.
MAX_CLUSTERS, MAX_BETWEEN, MAX_BEYOND = 8, 6, 4
# Least charge within the radius of a candidate, as a share of the largest.
LEAST_CHARGE = 1e-3

_Place = tuple[str, Position]


@dataclass(frozen=True, eq=False)
class Held:
    """A place to hold, with the strategy if it and all places before it are held.

    ``name`` is its candidate's, '' if none were given, and ``xy`` its position [m]. With any other
    candidate instead, the value is at least ``others``; inf if there was none. Of ``candidates``
    so many were ``solved``; the bounds rule out the rest.
    """

    name: str
    xy: Position
    strategy: Strategy
    others: float
    solved: int
    candidates: int


@dataclass(frozen=True, eq=False)
class Holding:
    """The places to hold, in their order, all of one ``radius`` [m].

    ``before`` is the strategy if none of them is held.
    """

    before: Strategy
    radius: float
    steps: tuple[Held, ...]

    @property
    def strategies(self) -> tuple[Strategy, ...]:
        """The strategies with 0, 1, 2, ... of the places held."""
        return self.before, *(step.strategy for step in self.steps)

    @property
    def held_places(self) -> tuple[HeldPlace, ...]:
        """All held ground on the way, as ``GameOptions`` takes it."""
        return self.strategies[-1].game.options.held_places


def places_to_hold(risk_map: RiskMap, start_xy: Position, goal_xy: Position, radius: float,
                   count: int = 5, options: PlanningOptions | None = None, *,
                   stops: Iterable[Position] = (),
                   candidates: Mapping[str, Position] | None = None) -> Holding:
    """Find up to ``count`` places to hold on a trip, as ``plan_trip`` takes it.

    Holding a place means that nobody can wait within ``radius`` [m] of it, and with a reach that
    nobody who drives there is hit. Value and lower bound of each step are those of ``plan_trip``
    with these ``held_places``. Candidates are the given ones [m], or places around the ambusher's
    sites and some beyond. The search ends early if the value is 0 or no candidate remains.

    Raises InvalidOption if the radius is below the map's resolution, the count below 1 or a
    candidate off the map, and the errors of ``plan_trip``.
    """
    _check(risk_map, radius, count, candidates or {})
    options = options or PlanningOptions()
    network = trip_network(risk_map, start_xy, goal_xy, options.network, list(stops), 'given')
    search = _Search(risk_map, network, options, radius)
    before = strategy = search.solved(options.game.held_places)
    steps: list[Held] = []
    while len(steps) < count and strategy.value > 0.0:
        taken = [step.name for step in steps]
        left = None if candidates is None else [
            each for each in candidates.items() if each[0] not in taken]
        if not (found := _by_charge(strategy, left, radius)):
            break
        steps.append(search.best_of(found, strategy))
        strategy = steps[-1].strategy
    return Holding(before, radius, tuple(steps))


class _Search:
    """Solves of one trip with different held places."""

    def __init__(self, risk_map: RiskMap, network: Network, options: PlanningOptions,
                 radius: float) -> None:
        self._map, self._network, self._options = risk_map, network, options
        self._radius = radius

    def solved(self, held: tuple[HeldPlace, ...], after: Strategy | None = None) -> Strategy:
        """The strategy if these places are held, from where another solve ended if given."""
        warm = WarmStart(after.network, after.multipliers) if (
            after and after.multipliers) else None
        game = replace(self._options.game, held_places=held)
        return solve_on_network(self._map, self._network, replace(self._options, game=game), warm)

    def best_of(self, candidates: Sequence[_Place], before: Strategy) -> Held:
        """The candidate of least value; of those within the slack of it, the first."""
        slack = 1.0 + self._options.strategy.risk_slack
        held = [(*before.game.options.held_places, (*xy, self._radius))
                for _, xy in candidates]
        bounds = np.array([bound_if_held(before, each) for each in held])
        values, last = np.full(len(held), np.inf), before
        while True:
            left = np.flatnonzero(np.isinf(values))
            if not len(left) or bounds[left].min() * slack >= values.min():
                break
            k = int(left[bounds[left].argmin()])
            last = self.solved(held[k], last)
            values[k], bounds[k] = last.value, last.lower_bound
            for j in left[(left != k) & (bounds[left] * slack < values.min())]:
                bounds[j] = max(bounds[j], bound_if_held(last, held[j]))
        best = int(np.flatnonzero(values <= values.min() * slack)[0])
        # Without a warm start, which would lead to slightly other numbers than those of plan_trip.
        return Held(*candidates[best], self.solved(held[best]),
                    float(np.delete(bounds, best).min(initial=np.inf)),
                    int(np.isfinite(values).sum()), len(held))


def _by_charge(strategy: Strategy, given: Sequence[_Place] | None, radius: float) -> list[_Place]:
    """The candidates, those first that take most from the ambusher; by default around his sites."""
    game = strategy.game
    points = game.network.points[game.sites]
    charge = game.loss[game.sites] * game.at_sites(strategy.ambush_probability)
    if given is not None:
        centres = np.array([xy for _, xy in given]).reshape(-1, 2)
        taken = _within(centres, points, charge, radius)
        return [given[k] for k in np.argsort(-taken, kind='stable')]
    taken = _within(points, points, charge, radius)
    order = np.argsort(-taken, kind='stable')
    order = order[taken[order] > LEAST_CHARGE * taken.max(initial=0.0)]
    some = _thinned(points, order, [], radius, MAX_CLUSTERS)
    some += _thinned(points, order, some, radius / 2.0, MAX_BETWEEN)
    costs = game.site_losses(strategy.edge_probability)
    some += _thinned(points, np.argsort(-costs, kind='stable'), some, radius, MAX_BEYOND)
    return [('', (x, y)) for x, y in points[some].tolist()]


def _within(centres: FloatArray, points: FloatArray, charge: FloatArray,
            radius: float) -> FloatArray:
    """The charge (K,) within the radius of each centre; half as much counts at its edge."""
    far = radius * math.sqrt(2.0)
    pairs = cKDTree(centres).sparse_distance_matrix(cKDTree(points), radius,
                                                    output_type='ndarray')
    weights = charge[pairs['j']] * (1.0 - (pairs['v'] / far)**2)
    return sums(pairs['i'], weights, len(centres))


def _thinned(points: FloatArray, order: IndexArray, before: Sequence[int], apart: float,
             most: int) -> list[int]:
    """The first ``most`` in ``order`` that are further apart [m] and further from those before."""
    kept: list[int] = []
    for k in order.tolist():
        if len(kept) == most:
            break
        others = points[[*before, *kept]]
        if not len(others) or np.hypot(*(others - points[k]).T).min() > apart:
            kept.append(k)
    return kept


def _check(risk_map: RiskMap, radius: float, count: int,
           candidates: Mapping[str, Position]) -> None:
    check_whole('count', count, 1)
    if not risk_map.resolution <= radius < math.inf:
        raise InvalidOption(f'the radius to hold must be at least a cell of the map, '
                            f'{risk_map.resolution:g} m, and finite, got {radius:g}')
    for name, (x, y) in candidates.items():
        if not risk_map.contains(risk_map.to_map_axes((x, y))):
            (left, low), (right, high) = risk_map.bounds
            raise InvalidOption(
                f'candidate {name!r} at ({x:.6g}, {y:.6g}) is off the map, which spans x '
                f'{left:.6g} to {right:.6g} and y {low:.6g} to {high:.6g} [m]')

# SPDX-License-Identifier: Apache-2.0
"""Habits: the value of driven trips against an ambusher who has watched them, and better shares."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.distance import directed_hausdorff
from scipy.stats import binom

from ..arrays import FloatArray
from ..errors import InvalidOption
from ..game.budget import shortest_length
from ..maps.risk_map import RiskMap
from ..maps.track_file import Track
from ..planning.options import PlanningOptions
from ..planning.plan import Plan
from ..planning.trip import PLANNED, Trip, plan_quietly
from .path_mixtures import PathMixture, PathMixtures

# A trip has to come this near to start and goal, as a share of their distance.
NEAR = 0.05
# Minimum step of a vehicle that moves, as a share of the reach.
MIN_STEP = 0.05
# Quantile of a track's steps that counts as a usual step.
USUAL = 0.75
# Maximum number of consecutive positions in an outlier, and its minimum distance from the median of
# the positions around it [usual steps].
MAX_SPIKE, MIN_SPIKE = 3, 5.0
# Maximum step that does not break a track [usual steps].
MAX_STEP = 5.0
# Maximum step that does not break a track, as a share of the distance from start to goal: for
# tracks with short steps, and for all.
MAX_BRIDGED, MAX_USUAL = 0.1, 0.6
# Minimum overlap in time of two tracks of one trip, as a share of the shorter one.
MIN_OVERLAP = 0.5
# Minimum length budget of the optimum, as a multiple of the shortest route.
MIN_DETOUR = 1.05


class LeftOut(NamedTuple):
    """A track or trip that does not count, and the ``reason``, which others may share."""

    name: str
    reason: str
    detail: str = ''

    def __str__(self) -> str:
        return f'{self.name} {self.reason}{self.detail}'


@dataclass(frozen=True, eq=False)
class Habits:
    """Trips (K,) of ``lengths`` [m], judged as mixtures of paths.

    ``driven`` has equal shares, and ``interval`` is the 95 % interval of its value. ``best`` has
    the shares of least value, and ``plan`` is the optimal strategy, both within the same mean
    length.
    """

    trips: Sequence[Track]
    lengths: FloatArray
    driven: PathMixture
    interval: tuple[float, float]
    best: PathMixture
    plan: Plan


def judge(risk_map: RiskMap, trips: Sequence[Track], options: PlanningOptions) -> Habits:
    """Judge trips that have start and goal in common, as ``find_trips`` returns them.

    The plan's ``max_detour`` is that of the trips, at least ``MIN_DETOUR``. Raises InvalidOption if
    nobody can wait anywhere, and the errors of ``plan_trip`` and ``PathMixtures``.
    """
    begin, (start, goal) = time.monotonic(), trips[0].xy[[0, -1]]
    end = begin + options.strategy.time_limit
    lengths = np.array([_steps(trip.xy).sum() for trip in trips])
    mean = float(lengths.mean())
    roads = options.network.roads
    if roads and roads.timed:  # trips without times cannot be compared with a time budget
        options = replace(options, network=replace(options.network,
                                                   graph=replace(roads, timed=False)))
    (network,) = Trip(risk_map, start, goal, (), options).networks(np.empty((0, 3)))
    shortest = network.ground_length or shortest_length(network)
    options = replace(options, strategy=replace(options.strategy,
                                                max_detour=max(mean / shortest, MIN_DETOUR)))
    plan = plan_quietly(risk_map, start, goal, options, share=PLANNED)
    if not len(plan.strategy.game.sites):
        raise InvalidOption('the secured area covers everything around start and goal, so that '
                            'nobody can wait there: choose a smaller radius (--secured)')
    mixtures = PathMixtures(risk_map, plan, [trip.xy for trip in trips],
                            np.zeros(len(trips), dtype=np.int64))
    driven = mixtures.judge(np.full(len(trips), 1.0 / len(trips)))
    best = mixtures.best(lengths / mean, end)
    return Habits(trips, lengths, driven, _interval(driven), best, plan)


def _interval(driven: PathMixture) -> tuple[float, float]:
    """Bootstrap interval of the mean loss at the worst place, over resamples of the trips.

    The place stays the same: with its own worst place, each resample of a few trips would look
    worse than the habits behind them. The number of resampled trips that an ambush there hits is
    binomial, so its quantiles need no draws.
    """
    count, hit = len(driven.hit), int(driven.hit.sum())
    low, high = driven.value * binom.ppf((0.025, 0.975), count, hit / count) / max(hit, 1)
    return float(low), float(high)


def find_trips(tracks: Iterable[Track], start: FloatArray, goal: FloatArray, near: float,
               reach: float) -> tuple[list[Track], list[LeftOut]]:
    """Extract the trips from start to goal, and the tracks and trips that do not count.

    A trip begins at its start and ends at its goal exactly. It leads from the last approach to the
    start, within ``near`` [m], to the first approach to the goal after it; a track can have several
    trips. Outliers are removed, short jumps are bridged. Copies, and trips driven at the same time
    within ``reach`` [m] of each other, count once.
    """
    trips: list[Track] = []
    left_out = []
    for track in tracks:
        for found in _trips_of(track, start, goal, near, MIN_STEP * reach):
            if isinstance(found, LeftOut):
                left_out.append(found)
            elif twin := next((trip for trip in trips if _is_same(found, trip, reach)), None):
                same = 'is a copy of' if found.times is None else 'is the same trip as'
                left_out.append(LeftOut(found.name, same, f' {twin.name}'))
            else:
                trips.append(found)
    return trips, left_out


def _trips_of(track: Track, start: FloatArray, goal: FloatArray, near: float,
              min_step: float) -> Iterator[Track | LeftOut]:
    """Yield the trips of a track, and reasons for leaving it or parts of it out."""
    times = np.zeros(len(track.xy)) if track.times is None else track.times
    if len(backward := np.flatnonzero(np.diff(times) < 0.0)):
        yield LeftOut(track.name, 'goes back in time', f' after position {backward[0] + 1}')
        return
    moving, positions = [0], track.xy.tolist()
    for k, position in enumerate(positions):
        if math.dist(positions[moving[-1]], position) >= min_step:
            moving.append(k)
    kept = _drop_spikes(track.xy, moving)
    xy, times = track.xy[kept], times[kept]
    distances = np.stack([np.hypot(*(xy - end).T) for end in (start, goal)])
    end = np.where(distances.min(axis=0) <= near, distances.argmin(axis=0), -1)
    for k, name in enumerate(('start', 'goal')):
        if k not in end:
            yield LeftOut(track.name, f'never comes within {near:.4g} m of the {name}')
            return
    # Runs of positions near the start (0), near the goal (1) or at neither (-1).
    runs = [run for run in np.split(np.arange(len(end)), np.flatnonzero(np.diff(end)) + 1)
            if end[run[0]] >= 0]
    trips = [(int(one[distances[0, one].argmin()]), int(other[distances[1, other].argmin()]))
             for one, other in pairwise(runs) if (end[one[0]], end[other[0]]) == (0, 1)]
    if not trips:
        yield LeftOut(track.name, 'leads from the goal to the start: the return trip is planned '
                      'separately')
    steps = _steps(xy)
    distance = math.dist(start, goal)
    max_step = min(max(MAX_STEP * np.quantile(steps, USUAL), MAX_BRIDGED * distance),
                   max(MAX_USUAL * distance, near))
    for number, (first, last) in enumerate(trips, start=1):
        name = track.name if len(trips) == 1 else f'trip {number} of {track.name}'
        if (jump := steps[first:last].max()) > max_step:
            yield LeftOut(name, 'has a jump', f' of {jump:.4g} m, more than {max_step:.4g} m')
            continue
        when = np.pad(times[first : last + 1], 1, mode='edge')
        yield Track(name, np.vstack((start, xy[first : last + 1], goal)),
                    None if track.times is None else when)



def _steps(xy: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(*np.diff(xy, axis=0).T))


def _drop_spikes(xy: FloatArray, indices: list[int]) -> list[int]:
    """Drop the indices of outliers among positions (L, 2)."""
    points = xy[indices]
    usual = float(np.quantile(_steps(points), USUAL)) if len(indices) > 1 else 0.0
    medians = median_filter(points, (2 * MAX_SPIKE + 1, 1), mode='nearest')
    near = np.hypot(*(points - medians).T) <= MIN_SPIKE * usual
    return [k for k, is_near in zip(indices, near.tolist(), strict=True) if is_near]


def _is_same(one: Track, other: Track, reach: float) -> bool:
    """Return whether two trips were driven side by side or, without times, are copies."""
    if one.times is None or other.times is None:
        return np.array_equal(one.xy, other.xy)
    (a, b), (c, d) = one.times[[0, -1]], other.times[[0, -1]]
    return min(b, d) - max(a, c) >= MIN_OVERLAP * min(b - a, d - c) and all(
        directed_hausdorff(line, _resample(coarse, reach / 2.0))[0] <= reach
        for line, coarse in ((one.xy, other.xy), (other.xy, one.xy)))


def _resample(xy: FloatArray, step: float) -> FloatArray:
    """Positions (K, 2) on the line (L, 2), a ``step`` apart [m]."""
    along = np.append(0.0, _steps(xy).cumsum())
    places = np.arange(0.0, along[-1] + step, step)
    return np.column_stack([np.interp(places, along, axis) for axis in xy.T])

# SPDX-License-Identifier: Apache-2.0
"""Refine a plan's network where the ambusher waits, and plan again, while that lowers the value.

A network's value is higher than the ground's, above all where the minimum cut is: where the optimal
ambusher waits. So the nodes around his sites come nearer to each other, and the next plan begins
from what the one before knows. The cut moves on to coarser ground, and after two or three rounds
the value hardly falls (docs/theory.md, section 10).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, IndexArray
from ..errors import TimeLimit
from ..game.strategy import Strategy
from ..maps.risk_map import RiskMap
from .options import PlanningOptions, finest_spacing, grading, node_spacing
from .solving import WarmStart

# Most rounds after the first plan, and most nodes of a network that is refined further.
ROUNDS, MAX_NODES = 6, 30_000
# Fall of the value in a round, as a share of it, below which refinement ends.
LEAST_FALL = 0.02
# Sites with less of the ambusher's charge than this share are not refined. If those on ground that
# is not fine have less than the second share of it together, the network is fine enough.
SHARE, COARSE_SHARE = 0.003, 0.1
# At sites with more of the charge than this share the flow is narrow: there the whole disc has to
# be fine, and the first spacing is wanted, at other sites the second [reaches].
NARROW_SHARE, SPACINGS = 0.1, (1.0 / 9.0, 1.0 / 6.0)
# Ground is fine if its spacing is at most this many times what is wanted.
FINE = 1.5
# Directions in which the rim of a disc is looked at.
COMPASS = np.array([(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4.0])
# Distance of refined places from each other, as a share of the radius around them.
APART = 0.25


class Round(NamedTuple):
    """A round of refinement: the nodes of its network, value, lower bound, and time [s]."""

    nodes: int
    value: float
    lower_bound: float
    seconds: float


class Planned(NamedTuple):
    """A strategy, the order of its stops, and how that was found."""

    strategy: Strategy
    order: tuple[int, ...]
    order_found: str


# Plans once: with ``Network.refined`` (K, 3), a similar strategy, and the plan of the round before.
PlanOnce = Callable[[FloatArray, 'WarmStart | None', 'Planned | None'], Planned]


def refine(plan_once: PlanOnce, risk_map: RiskMap, options: PlanningOptions,
           warm: WarmStart | None, rounds: int | None) -> tuple[Planned, tuple[Round, ...]]:
    """Plan, and plan again on finer networks; the plan of least value, and all rounds.

    At most ``rounds`` after the first one, by default as many as ``network.refine`` allows. Raises
    what the first plan raises.
    """
    most = options.network.refine if rounds is None else rounds
    most = ROUNDS if most is None else most
    begin = time.monotonic()
    end = begin + options.strategy.time_limit
    refined = warm.refined if warm else np.empty((0, 3))
    best = newest = plan_once(refined, warm, None)
    done = [_round(newest, begin)]
    while len(done) <= most and time.monotonic() < end:
        if (places := next_places(newest.strategy, risk_map, options)) is None:
            break
        begin, before = time.monotonic(), best.strategy.value
        try:
            newest = plan_once(places, WarmStart.of(newest.strategy, places), newest)
        except TimeLimit:
            break
        done.append(_round(newest, begin))
        if newest.strategy.value < before:
            best = newest
        if newest.strategy.value > (1.0 - LEAST_FALL) * before:
            break
    return best, tuple(done)


def next_places(strategy: Strategy, risk_map: RiskMap,
                options: PlanningOptions) -> FloatArray | None:
    """``Network.refined`` (K, 3) of the next round; None: the network is fine enough.

    Added are the sites where the ambusher waits on ground that is not fine.
    """
    network, game, reach = strategy.network, strategy.game, options.game.ambush_radius
    grades = grading(risk_map, options, network.refined)
    if grades is None or len(network.points) > MAX_NODES or strategy.value <= 0.0:
        return None
    charge = strategy.ambush_probability * game.loss
    sites = np.flatnonzero(charge > SHARE * charge.sum())
    narrow = charge[sites] > NARROW_SHARE * charge.sum()
    finest = np.where(narrow, *(finest_spacing(risk_map, each * reach) for each in SPACINGS))
    ends = network.points[[network.source, *network.stops, network.target]]
    rims = np.where(narrow, game.reach, 0.0)[:, None] * COMPASS[:, None]
    plain = node_spacing(risk_map, options.network)
    spacing = np.max([grades.wanted(network.points[sites] + rim, ends, plain) for rim in rims],
                     axis=0)
    coarse = spacing > FINE * finest
    if charge[sites[coarse]].sum() <= COARSE_SHARE * charge.sum():
        return None
    added = np.column_stack((network.points[sites[coarse]], finest[coarse]))
    every = np.concatenate((network.refined, added))
    return every[_thinned(every, APART * grades.around)]


def _thinned(places: FloatArray, apart: float) -> IndexArray:
    """Those places (K, 3) that are not within ``apart`` [m] of a finer one, or of one before."""
    order, kept = np.argsort(places[:, 2], kind='stable'), np.ones(len(places), dtype=bool)
    for k, near in enumerate(cKDTree(places[order, :2]).query_ball_point(places[order, :2], apart)):
        kept[k] = not any(other < k and kept[other] for other in near)
    return np.sort(order[kept])


def _round(planned: Planned, begin: float) -> Round:
    strategy = planned.strategy
    return Round(len(strategy.network.points), strategy.value, strategy.lower_bound,
                 time.monotonic() - begin)

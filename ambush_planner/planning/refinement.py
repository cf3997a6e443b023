# SPDX-License-Identifier: Apache-2.0
"""Refinement of a plan's network around the ambusher's sites, while that lowers the value.

A network's value is higher than the ground's, and only nodes around the sites of the optimal
ambusher, at the minimum cut, can lower it. So each round makes the network finer there, and starts
from these sites. The cut moves to coarser parts of the network, and after two or three rounds the
value hardly falls (docs/theory.md, section 10).

The plan of the first network is finished before anything is refined. Rounds find values only; the
network of least value then gets a route distribution, and becomes the plan if its value is lower
than the first one's. So the best finished plan is returned, however short the time is.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..game.search import Progress, Search
from ..maps.risk_map import RiskMap
from .cell_losses import thin_out
from .options import PlanningOptions, grading, node_spacing, useful_spacing
from .solving import Ground, WarmStart

# If no number of rounds is given: the most rounds after the first one, and the most nodes of a
# network that is refined further, since larger ones take minutes.
ROUNDS, MAX_NODES = 6, 12_000
# Time that must be left for another round [times of the last one]: it has twice the nodes, and then
# needs a route distribution.
NEXT_ROUND = 6.0
# Relative fall of the value in a round below which refinement ends.
LEAST_FALL = 0.02
# Share of all site prices below which a site is not refined; and share of sites with a coarse
# network, together, up to which the network is fine enough.
SHARE, COARSE_SHARE = 0.003, 0.1
# Shares of all site prices that divide sites into classes, and the spacing for each class
# [reaches].
CLASSES, SPACINGS = (0.1, 0.25), (1.0 / 6.0, 1.0 / 9.0, 1.0 / 18.0)
# Ratio of the spacing at a site to that of its class up to which the network is fine there.
FINE = 1.5
# Directions from a site to the places on its rim that are examined.
COMPASS = np.array([(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4.0])
# Least distance between refined places, as a share of their radius.
MIN_DISTANCE = 0.25


# Finds the value on the network with ``WarmStart.refined``.
FindValue = Callable[['WarmStart | None'], Search]


class Round(NamedTuple):
    """A round of refinement: number of nodes, value, and time [s].

    ``value`` is an estimate, that of the program's strategies at the known sites, except in the
    first round: there it is the plan's.
    """

    nodes: int
    value: float
    seconds: float


def refine(find_value: FindValue, ground: Ground, warm: WarmStart | None, latest: float,
           end: float, progress: Progress, value: float
           ) -> tuple[Search | None, tuple[Round, ...]]:
    """Find the value on finer and finer networks; return the search of least value and all rounds.

    Rounds end when the network is fine enough and, if their number is not given, when they gain
    little or the network is large. None begins after ``latest`` (``time.monotonic``), or with less
    than ``NEXT_ROUND`` left until ``end``. The search is None if the first round is cut short.
    ``value`` is that of the present plan, for ``progress``.
    """
    given, rounds = ground.options.network.refine, list[Round]()
    best: Search | None = None
    newest: Search | None = None
    while len(rounds) <= (ROUNDS if given is None else given) and time.monotonic() < latest:
        if newest is not None:
            places = next_places(newest, ground.risk_map, ground.options)
            if places is None or (given is None and rounds[-1].nodes > MAX_NODES):
                break
            if time.monotonic() + NEXT_ROUND * rounds[-1].seconds > end:
                break
            warm = WarmStart.after(newest, places)
        begin = time.monotonic()
        newest = find_value(warm)
        if newest.reason != 'stalled':  # it was cut short
            break
        nodes, found = len(newest.legs.games[0].network.points), newest.program.value
        rounds.append(Round(nodes, found, time.monotonic() - begin))
        progress(f'refining the network, {nodes} nodes', value)
        previous = best.program.value if best else np.inf
        if found < previous:
            best = newest
        if given is None and found > (1.0 - LEAST_FALL) * previous:
            break
    return best, tuple(rounds)


def next_places(search: Search, risk_map: RiskMap, options: PlanningOptions) -> FloatArray | None:
    """Choose ``Network.refined`` (K, 3) of the next round; None: the network is fine enough.

    It adds the ambusher's sites at which the network is not fine.
    """
    network, reach = search.legs.games[0].network, options.game.ambush_radius
    grades = grading(risk_map, options, network.refined)
    q = search.program.ambush.q
    site_prices = np.append(q, np.zeros(len(search.loss) - len(q))) * search.loss
    if grades is None or network.refined is None or not site_prices.any():
        return None
    sites = np.flatnonzero(site_prices > SHARE * site_prices.sum())
    share, points = site_prices[sites] / site_prices.sum(), search.points[sites]
    site_class = np.searchsorted(CLASSES, share)
    target = np.array([useful_spacing(risk_map, each * reach) for each in SPACINGS])[site_class]
    ends = network.points[[(game.network.source, game.network.target)
                           for game in search.legs.games]].reshape(-1, 2)
    rims = search.legs.reach * COMPASS
    plain = node_spacing(risk_map, options.network)
    spacing = np.max([grades.spacing_at(points + rim, ends, plain) for rim in rims], axis=0)
    coarse = spacing > FINE * target
    if site_prices[sites[coarse]].sum() <= COARSE_SHARE * site_prices.sum():
        return None
    added = np.column_stack((points[coarse], target[coarse]))
    places = np.concatenate((network.refined, added))
    finest_first = np.argsort(places[:, 2], kind='stable')
    places = places[np.sort(thin_out(places[:, :2], finest_first, MIN_DISTANCE * grades.radius))]
    return None if np.array_equal(places, network.refined) else places

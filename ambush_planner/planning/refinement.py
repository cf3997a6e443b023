# SPDX-License-Identifier: Apache-2.0
"""Refine a plan's network where the ambusher waits, while that lowers the value.

A network's value is higher than the ground's, and only nodes where the optimal ambusher waits, at
the minimum cut, can lower it. So the nodes around his sites come nearer to each other, and the next
round begins with these sites. The cut moves on to coarser parts of the network, and after two or
three rounds the value hardly falls (docs/theory.md, section 10). The rounds find values only; the
network of least value then gets a route distribution.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..game.search import Search
from ..game.slack import ceiling
from ..maps.risk_map import RiskMap
from .cell_losses import thinned
from .options import PlanningOptions, finest_spacing, grading, node_spacing
from .solving import WarmStart

# Unless the number of rounds is given: most rounds after the first one, and most nodes, those of
# all legs, of a network that is refined further, as larger ones take minutes.
ROUNDS, MAX_NODES = 6, 15_000
# Share of the time limit after which no round begins.
REFINED_BY = 0.4
# Fall of the value in a round, as a share of it, below which refinement then ends.
LEAST_FALL = 0.02
# Sites that cause less than this share of the ambusher's mean loss are not refined. If those where
# the network is not fine cause at most the second share of it together, the network is fine enough.
SHARE, COARSE_SHARE = 0.003, 0.1
# At sites that cause more than the first share the flow is narrow: their rims have to be fine, too.
# Spacings that are wanted at sites that cause less than each share, and more [reaches].
NARROW, SPACINGS = (0.1, 0.25), (1.0 / 6.0, 1.0 / 9.0, 1.0 / 18.0)
# The network is fine where its spacing is at most this many times what is wanted.
FINE = 1.5
# Directions in which the rim of a disc is looked at.
COMPASS = np.array([(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4.0])
# Distance of refined places from each other, as a share of the radius around them.
APART = 0.25


class Round(NamedTuple):
    """A round of refinement: the nodes of its network, the value there, and time [s].

    The value is the least that was found, plus the risk slack.
    """

    nodes: int
    value: float
    seconds: float


# Finds the value on the network with ``WarmStart.refined`` from what another search knows.
FindValue = Callable[['WarmStart | None'], Search]


def refine(find_value: FindValue, risk_map: RiskMap, options: PlanningOptions,
           warm: WarmStart | None) -> tuple[Search, tuple[Round, ...]]:
    """Find the value on ever finer networks; the search of least value, and all rounds.

    Rounds end when the network is fine enough, and unless their number is given, when they gain
    little or the network is large. Raises what the first search raises.
    """
    given = options.network.refine
    begin = time.monotonic()
    latest = begin + REFINED_BY * options.strategy.time_limit
    best = newest = find_value(warm)
    done = [_round(newest, begin)]
    while len(done) <= (ROUNDS if given is None else given) and time.monotonic() < latest:
        too_large = given is None and done[-1].nodes > MAX_NODES
        if too_large or (places := next_places(newest, risk_map, options)) is None:
            break
        begin, before = time.monotonic(), best.lp.bound
        newest = find_value(WarmStart.after(newest, places))
        if newest.reason != 'stalled':  # it was cut short
            break
        done.append(_round(newest, begin))
        if newest.lp.bound < before:
            best = newest
        if given is None and newest.lp.bound > (1.0 - LEAST_FALL) * before:
            break
    return best, tuple(done)


def next_places(search: Search, risk_map: RiskMap, options: PlanningOptions) -> FloatArray | None:
    """``Network.refined`` (K, 3) of the next round; None: the network is fine enough.

    Added are the sites where the ambusher waits and the network is not fine.
    """
    game, network, reach = search.game, search.game.network, options.game.ambush_radius
    grades = grading(risk_map, options, network.refined)
    dual_weights = search.lp.q * search.loss
    if grades is None or not dual_weights.any():
        return None
    sites = np.flatnonzero(dual_weights > SHARE * dual_weights.sum())
    share, points = dual_weights[sites] / dual_weights.sum(), search.points[sites]
    narrow, level = share > NARROW[0], np.searchsorted(NARROW, share)
    finest = np.array([finest_spacing(risk_map, each * reach) for each in SPACINGS])[level]
    ends = network.points[[network.source, *network.stops, network.target]]
    rims = np.where(narrow, game.reach, 0.0)[:, None] * COMPASS[:, None]
    plain = node_spacing(risk_map, options.network)
    spacing = np.max([grades.wanted(points + rim, ends, plain) for rim in rims], axis=0)
    coarse = spacing > FINE * finest
    if dual_weights[sites[coarse]].sum() <= COARSE_SHARE * dual_weights.sum():
        return None
    added = np.column_stack((points[coarse], finest[coarse]))
    every = np.concatenate((network.refined, added))
    finest_first = np.argsort(every[:, 2], kind='stable')
    return every[np.sort(thinned(every[:, :2], finest_first, APART * grades.around))]


def _round(search: Search, begin: float) -> Round:
    """The round of a search, which it reports, too."""
    bound = float(search.lp.bound)
    value = ceiling(bound, search.slack)
    search.problem.progress(value, bound)
    return Round(len(search.problem.game.network.points), value, time.monotonic() - begin)

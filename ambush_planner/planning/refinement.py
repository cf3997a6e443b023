# SPDX-License-Identifier: Apache-2.0
"""Refine a plan's network where the ambusher waits, while that lowers the value.

A network's value is higher than the ground's, and only nodes where the optimal ambusher waits, at
the minimum cut, can lower it. So the nodes around these sites come nearer to each other, and the
next round begins with these sites. The cut moves on to coarser parts of the network, and after two
or three rounds the value hardly falls (docs/theory.md, section 10).

The first plan, of the plain network, is finished before anything is refined. Rounds find values
only; the network of least value then gets a route distribution, and becomes the plan if that costs
less than the first one. So the best finished plan is returned, however short the time is.
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

# Unless the number of rounds is given: most rounds after the first one, and most nodes, those of
# all legs, of a network that is refined further, as larger ones take minutes.
ROUNDS, MAX_NODES = 6, 15_000
# Time that has to be left for a further round [times of the last one], as that has twice the nodes,
# and then needs a route distribution.
NEXT_ROUND = 6.0
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


# Finds the value on the network with ``WarmStart.refined`` from what another search knows.
FindValue = Callable[['WarmStart | None'], Search]


class Round(NamedTuple):
    """A round of refinement: the nodes of its network, and its time [s].

    ``value`` is that of its finished strategy, or of the strategy of a program that was not
    finished, at the sites so far.
    """

    nodes: int
    value: float
    seconds: float


def refine(find_value: FindValue, ground: Ground, warm: WarmStart | None, latest: float,
           end: float, progress: Progress, value: float
           ) -> tuple[Search | None, tuple[Round, ...]]:
    """Find the value on ever finer networks; the search of least value, and all rounds.

    Rounds end when the network is fine enough, and unless their number is given, when they gain
    little or the network is large. None begins after ``latest`` (``time.monotonic``), nor if less
    than ``NEXT_ROUND`` is left until ``end``. The search is None if the first one is cut short.
    ``value`` is that of the plan so far, for ``progress``.
    """
    given, done = ground.options.network.refine, list[Round]()
    best: Search | None = None
    newest: Search | None = None
    while len(done) <= (ROUNDS if given is None else given) and time.monotonic() < latest:
        if newest is not None:
            places = next_places(newest, ground.risk_map, ground.options)
            if places is None or (given is None and done[-1].nodes > MAX_NODES):
                break
            if time.monotonic() + NEXT_ROUND * done[-1].seconds > end:
                break
            warm = WarmStart.after(newest, places)
        begin = time.monotonic()
        newest = find_value(warm)
        if newest.reason != 'stalled':  # it was cut short
            break
        nodes, found = len(newest.legs.games[0].network.points), newest.program.value
        done.append(Round(nodes, found, time.monotonic() - begin))
        progress(f'refining the network, {nodes} nodes', value)
        before = best.program.value if best else np.inf
        if found < before:
            best = newest
        if given is None and found > (1.0 - LEAST_FALL) * before:
            break
    return best, tuple(done)


def next_places(search: Search, risk_map: RiskMap, options: PlanningOptions) -> FloatArray | None:
    """``Network.refined`` (K, 3) of the next round; None: the network is fine enough.

    Added are the sites where the ambusher waits and the network is not fine.
    """
    network, reach = search.legs.games[0].network, options.game.ambush_radius
    grades = grading(risk_map, options, network.refined)
    q = search.program.ambush.q
    site_prices = np.append(q, np.zeros(len(search.loss) - len(q))) * search.loss
    if grades is None or not site_prices.any():
        return None
    sites = np.flatnonzero(site_prices > SHARE * site_prices.sum())
    share, points = site_prices[sites] / site_prices.sum(), search.points[sites]
    narrow, level = share > NARROW[0], np.searchsorted(NARROW, share)
    finest = np.array([useful_spacing(risk_map, each * reach) for each in SPACINGS])[level]
    ends = network.points[[(game.network.source, game.network.target)
                           for game in search.legs.games]].reshape(-1, 2)
    rims = np.where(narrow, search.legs.reach, 0.0)[:, None] * COMPASS[:, None]
    plain = node_spacing(risk_map, options.network)
    spacing = np.max([grades.spacing_at(points + rim, ends, plain) for rim in rims], axis=0)
    coarse = spacing > FINE * finest
    if site_prices[sites[coarse]].sum() <= COARSE_SHARE * site_prices.sum():
        return None
    added = np.column_stack((points[coarse], finest[coarse]))
    assert network.refined is not None  # it is graded
    every = np.concatenate((network.refined, added))
    finest_first = np.argsort(every[:, 2], kind='stable')
    return every[np.sort(thin_out(every[:, :2], finest_first, APART * grades.radius))]

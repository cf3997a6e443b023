# SPDX-License-Identifier: Apache-2.0
"""The bound that a circulation between faces proves on a planar two-way network.

A closed curve through faces and discs whose signed crossings of one route do not add up to 0
separates the source from the target, so every route meets it: the route drives one of the curve's
links, or the curve's sites hit it. Let curves c of weights w_c go through each link with at most
``price`` times its cost, and through disc j with at most q_j alpha_j in all. Then for every route

    price * cost(route) + sum of q_j alpha_j over the sites that hit it  >=  sum of all w_c,

since what the curves through one disc add up to is paid once if the route is hit there. The mean
over a strategy within the budget is a bound on its value (docs/theory.md, Proposition 7.3). A
circulation is such curves, added up: it is decomposed into simple cycles, and those whose
crossings add up to 1 or -1 count. A curve that winds around an end n times counts n times if each
route meets n of its links and sites. Of the others, through which some route spirals, a search over
labels finds the least that any route pays.
"""

from __future__ import annotations

import itertools
import math
import time
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from ...arrays import NEGLIGIBLE, ROUNDING, BoolArray, FloatArray, IndexArray, sums
from ...errors import SolverFailed
from ..ambusher import Ambusher
from ..budget import Budget
from ..distribution.acyclic import simple_cycles
from ..faces import Circulation, Faces
from .best_response import SEARCHES, TripNetworks

# Maximum number of sets of a curve's sites, all of one size, whose routes are looked for.
MOST_SETS = 300


def curve_bound(faces: Faces, ambusher: Ambusher, given: Circulation,
                budget: Budget, deadline: float, enough: float) -> float:
    """What an ambusher proves by a circulation about strategies within the budget.

    Flow beyond q_j alpha_j, or beyond a link's share of the price, counts for nothing. How often
    curves count that wind more than once is found until ``enough`` is proved, or to ``deadline``
    (``time.monotonic``); the others count once. Raises SolverFailed if the circulation is that of
    another network.
    """
    game, paid, worth = faces.game, ambusher.price * budget.cost, 0.0
    if ambusher.price > 0.0:
        worth = ambusher.price * budget.limit
    dual_weights = game.loss * ambusher.q
    given = given.at(dual_weights > 0.0)
    if len(given.through) != len(faces.left):
        raise SolverFailed('the circulation is that of another network')
    edge, most = np.flatnonzero(game.playable), np.full(len(faces.left), np.inf)
    np.minimum.at(most, faces.link[edge], paid[edge])
    passed = sums(given.site, np.maximum(given.flow, 0.0), len(dual_weights))
    fits = np.minimum(dual_weights, passed) / np.where(passed > 0.0, passed, 1.0)
    inside = np.where(given.flow > 0.0, given.flow * fits[given.site], given.flow)
    site, row = np.unique(given.site, return_inverse=True)
    row_of = np.zeros(len(dual_weights), dtype=np.int64)
    row_of[game.sites] = np.arange(len(game.sites))
    entering = csr_matrix(game.entering[row_of[site]])
    arcs = _arcs(faces, np.clip(given.through, -most, most), inside, entering, row.ravel(),
                 given.face)
    once, used, winding = _curves(arcs)
    total, spirals = once + sum(curve.weight for curve in winding) - worth, 0.0
    if not winding:
        return max(total, 0.0)
    routes = _RoutesAcross(faces, entering)
    for curve in sorted(winding, key=lambda curve: -curve.weight * curve.winds):
        if total >= enough or time.monotonic() > deadline:
            return max(total, 0.0)
        link, inner = arcs.link[curve.arcs], np.unique(arcs.row[curve.arcs])
        met = routes.least_met(link[link >= 0], inner[inner >= 0], curve.winds)
        total += (met - 1) * curve.weight
        if met == curve.winds:
            used[curve.arcs] += curve.weight
        else:
            spirals += met * curve.weight
    if spirals > 0.0 and total < enough:
        across = arcs.link >= 0
        spent = sums(arcs.link[across], used[across], len(most))
        left = np.append(np.maximum(np.where(np.isfinite(most), most, 0.0) - spent, 0.0), 0.0)
        shares = _shares(faces, arcs, used, site, dual_weights)
        searched = (each.network.least_cost(left[faces.link], shares[each.number, game.sites],
                                            SEARCHES, deadline, enough - total + spirals)
                    for each in TripNetworks(game, game.entering).legs)
        total += max(sum(least for least, _ in searched) - spirals, 0.0)
    return max(total, 0.0)


class _Arcs(NamedTuple):
    """The flows ``size`` (K,) of a circulation, from ``tail`` to ``head`` (K,).

    These are faces, and then parts of the rims of discs. An arc crosses ``link`` or leads into or
    out of the disc in ``row``; the other one is -1. ``gain`` is what it adds to the winding.
    """

    tail: IndexArray
    head: IndexArray
    gain: IndexArray
    size: FloatArray
    link: IndexArray
    row: IndexArray


def _arcs(faces: Faces, through: FloatArray, inside: FloatArray, entering: csr_matrix,
          row: IndexArray, face: IndexArray) -> _Arcs:
    """Arcs of the flows through links (L,), and into the discs ``row`` (T,) from a ``face`` (T,).

    ``entering`` (S, M) are the edges that enter each disc.
    """
    link, pair = np.flatnonzero(through), np.flatnonzero(inside)
    found, offset, part = _disc_pairs(faces, entering, row[pair], face[pair])
    tail = np.concatenate((faces.left[link], face[pair]))
    head = np.concatenate((faces.right[link], faces.count + part))
    gain = np.concatenate((faces.crossed[link], offset))
    flow = np.concatenate((through[link], inside[pair] * found))
    tail, head = np.where(flow > 0.0, tail, head), np.where(flow > 0.0, head, tail)
    gain, size = np.where(flow > 0.0, gain, -gain), np.abs(flow)
    kept = size > NEGLIGIBLE * size.max(initial=0.0)
    return _Arcs(*(each[kept] for each in (
        tail, head, gain, size, np.append(link, np.full(len(pair), -1)),
        np.append(np.full(len(link), -1), row[pair]))))


def _shares(faces: Faces, arcs: _Arcs, used: FloatArray, site: IndexArray,
            dual_weights: FloatArray) -> FloatArray:
    """What ``used`` flows (K,) leave of the dual weights (N,), shared among the legs (legs, N).

    In proportion to the other flows there into each site.
    """
    legs, count, into = len(faces.first), len(dual_weights), arcs.head >= faces.count
    at, leg = site[arcs.row[into]], faces.leg(arcs.tail[into])
    left = np.maximum(dual_weights - sums(at, used[into], count), 0.0)
    others = (arcs.size - used)[into]
    flow = sums(leg * count + at, others, legs * count).reshape(legs, count)
    through = flow.sum(axis=0)
    return left * np.where(through > 0.0, flow / np.where(through > 0.0, through, 1.0), 1.0 / legs)


class _Winding(NamedTuple):
    """A curve that winds around an end more than once: its weight, how often, and its arcs."""

    weight: float
    winds: int
    arcs: IndexArray


class _RoutesAcross:
    """The routes across curves, through discs that the edges ``entering`` (S, M) enter."""

    def __init__(self, faces: Faces, entering: csr_matrix) -> None:
        network, edge = faces.game.network, np.flatnonzero(faces.game.playable)
        order = edge[np.lexsort((network.heads[edge], network.tails[edge]))]
        self._ends, self._head = (network.source, network.target), network.heads[order]
        count = faces.game.node_count
        self._first = np.searchsorted(network.tails[order], np.arange(count + 1))
        self._link, self._entering = faces.link[order], csr_matrix(entering[:, order]) > 0.0

    def least_met(self, links: IndexArray, sites: IndexArray, winds: int) -> int:
        """How many of a curve's links and sites each route meets at least, up to ``winds``.

        A site counts once, a link each time. A route that meets no site crosses ``winds`` links.
        """
        crossing, entering = np.isin(self._link, links), self._entering[sites]
        times, least = np.asarray(entering.sum(axis=0)).ravel(), winds
        for count in range(1, winds):
            if math.comb(len(sites), count) > MOST_SETS:
                return min(count, least)
            for met in itertools.combinations(range(len(sites)), count):
                if count >= least:
                    return least
                free = np.asarray(entering[list(met)].sum(axis=0)).ravel()
                crossed = self._crossed(crossing, times > free, least - count)
                least = min(least, count + crossed)
        return least

    def _crossed(self, crossing: BoolArray, blocked: BoolArray, most: int) -> int:
        """The fewest ``crossing`` edges of a route without ``blocked`` ones, or ``most``."""
        weight = np.where(blocked, np.inf, np.where(crossing, 1.0, ROUNDING))
        count = len(self._first) - 1
        graph = csr_matrix((weight, self._head, self._first), (count, count))
        source, target = self._ends
        away = dijkstra(graph, indices=source, limit=most - 0.5)[target]
        return min(round(away), most) if np.isfinite(away) else most


def _disc_pairs(faces: Faces, entering: csr_matrix, row: IndexArray,
                face: IndexArray) -> tuple[FloatArray, IndexArray, IndexArray]:
    """Whether each pair (T,) of a disc and a face exists, as 0 or 1, its winding offset, its part.

    A curve passes a disc only within one part of its rim: it does not cross the secured area.
    Pairs of a disc around an end count as missing: its winding offsets depend on the way.
    """
    discs = faces.discs(entering)
    if not len(discs.face):
        return np.zeros(len(row)), row * 0, row * 0
    key, wanted = discs.disc * faces.count + discs.face, row * faces.count + face
    at = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
    found = (key[at] == wanted) & ~discs.around[row]
    offset = np.where(found, discs.offset[at], 0)
    return found.astype(np.float64), offset, discs.part[at]


def _curves(arcs: _Arcs) -> tuple[float, FloatArray, list[_Winding]]:
    """Take a circulation apart into simple cycles.

    Returns the weight and the flow (K,) of those of gain 1 or -1, and those of a larger gain.
    """
    once, used = 0.0, np.zeros(len(arcs.size))
    winding: list[_Winding] = []
    for cycle, least in simple_cycles(arcs.tail, arcs.head, arcs.size):
        winds = abs(int(arcs.gain[cycle].sum()))
        if winds == 1:
            once += least
            used[cycle] += least
        elif winds > 1:
            winding.append(_Winding(least, winds, cycle))
    return once, used, winding

# SPDX-License-Identifier: Apache-2.0
"""The bound that a circulation between faces proves on a planar two-way network.

A closed curve through faces and discs whose signed crossings of one route do not add up to 0
separates the source from the target, so every route meets it: the route drives one of the curve's
links, or the curve's sites hit it. Let curves c of weights w_c go through each link with at most
``price`` times its cost, and through disc j with at most the site price q_j alpha_j in all. Then
for every route

    price * cost(route) + sum of q_j alpha_j over the sites that hit it  >=  sum of all w_c,

since what the curves through one disc add up to is paid once if the route is hit there. The mean
over a strategy within the budget is a bound on its value (docs/theory.md, Proposition 7.3). A
circulation is such curves, added up: it is decomposed into simple cycles, each of which counts once
if its crossings do not add up to 0. A curve that winds around an end n times counts as often as
each route meets its links and sites, up to n.
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
from ..budget import Budget
from ..distribution.acyclic import simple_cycles
from ..faces import Circulation, Faces

# Maximum number of sets of a curve's sites, all of one size, whose routes are looked for.
MOST_SETS = 300


def curve_bound(faces: Faces, given: Circulation, site_prices: FloatArray, budget: Budget,
                price: float, deadline: float = math.inf, target: float = math.inf) -> float:
    """The bound that a circulation proves within the budget, for ``site_prices`` (N,).

    Flow beyond a site price, or beyond a link's share of the price, counts for nothing. How often
    curves count that wind more than once is found until ``target`` is proved, or to ``deadline``
    (``time.monotonic``); the others count once. Raises SolverFailed if the circulation is that of
    another network.
    """
    game = faces.game
    if len(given.through) != len(faces.left) or given.site.max(initial=-1) >= len(site_prices):
        raise SolverFailed('the circulation is that of another network')
    edge, most = np.flatnonzero(game.playable), np.full(len(faces.left), np.inf)
    paid = np.zeros(len(faces.link))
    if price > 0.0:
        paid = price * budget.cost
    np.minimum.at(most, faces.link[edge], paid[edge])
    inwards = sums(given.site, np.maximum(given.flow, 0.0), len(site_prices))
    fits = np.minimum(site_prices, inwards) / np.where(inwards > 0.0, inwards, 1.0)
    inside = np.where(given.flow > 0.0, given.flow * fits[given.site], given.flow)
    row_of = np.zeros(len(site_prices), dtype=np.int64)
    row_of[game.sites] = np.arange(len(game.sites))
    arcs, certain = _arcs(faces, np.clip(given.through, -most, most), inside, row_of[given.site],
                          given.face)
    bound = float(site_prices[game.sites[certain]].sum()) - (
        price * budget.limit if price > 0.0 else 0.0)
    winding = []
    for cycle, weight in simple_cycles(arcs.tail, arcs.head, arcs.size):
        winds = abs(int(arcs.gain[cycle].sum()))
        bound += weight * min(winds, 1)
        if winds > 1:
            winding.append((weight, winds, cycle))
    if not winding:
        return bound
    routes = _RoutesAcross(faces)
    for weight, winds, cycle in sorted(winding, key=lambda curve: -curve[0] * (curve[1] - 1)):
        if bound >= target or time.monotonic() > deadline:
            break
        link, row = arcs.link[cycle], np.unique(arcs.row[cycle])
        bound += weight * (routes.least_met(link[link >= 0], row[row >= 0], winds) - 1)
    return bound


class _Arcs(NamedTuple):
    """The flows ``size`` (K,) of a circulation, from ``tail`` to ``head`` (K,).

    These are faces, and then parts of the rims of discs. An arc crosses ``link`` or leads into or
    out of the disc in ``row`` of the game; the other one is -1. ``gain`` is what it adds to the
    winding.
    """

    tail: IndexArray
    head: IndexArray
    gain: IndexArray
    size: FloatArray
    link: IndexArray
    row: IndexArray


def _arcs(faces: Faces, through: FloatArray, inside: FloatArray, row: IndexArray,
          face: IndexArray) -> tuple[_Arcs, IndexArray]:
    """Arcs of the flows through links (L,), and into the discs of ``row`` (T,) from ``face`` (T,).

    A curve passes a disc only within one part of its rim: it does not cross the secured area.
    Flows into discs around an end are left out, as their winding depends on the way: every route
    meets these discs. They are returned, too, as rows of sites (K,).
    """
    pair, link = np.flatnonzero(inside), np.flatnonzero(through)
    rows, disc = np.unique(row, return_inverse=True)
    discs = faces.discs(csr_matrix(faces.game.entering[rows]))
    tail, head = faces.left[link], faces.right[link]
    gain, flow, of = faces.crossed[link], through[link], np.full(len(link), -1)
    if len(pair) and len(discs.face):
        key = discs.disc * faces.count + discs.face
        wanted = disc.ravel()[pair] * faces.count + face[pair]
        at = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        found = (key[at] == wanted) & ~discs.unavoidable[disc.ravel()[pair]]
        at, pair = at[found], pair[found]
        tail = np.concatenate((tail, face[pair]))
        head = np.concatenate((head, faces.count + discs.part[at]))
        gain = np.concatenate((gain, discs.offset[at]))
        flow, of = np.concatenate((flow, inside[pair])), np.concatenate((of, row[pair]))
    forward, size = flow > 0.0, np.abs(flow)
    kept = size > NEGLIGIBLE * size.max(initial=0.0)
    arcs = _Arcs(*(each[kept] for each in (
        np.where(forward, tail, head), np.where(forward, head, tail),
        np.where(forward, gain, -gain), size,
        np.append(link, np.full(len(of) - len(link), -1)), of)))
    return arcs, rows[discs.unavoidable]


class _RoutesAcross:
    """The routes of a leg across curves of its faces."""

    def __init__(self, faces: Faces) -> None:
        network, edge = faces.game.network, np.flatnonzero(faces.game.playable)
        order = edge[np.lexsort((network.heads[edge], network.tails[edge]))]
        self._ends, self._head = (network.source, network.target), network.heads[order]
        count = faces.game.node_count
        self._first = np.searchsorted(network.tails[order], np.arange(count + 1))
        self._link, self._order, self._entering = faces.link[order], order, faces.game.entering

    def least_met(self, links: IndexArray, rows: IndexArray, winds: int) -> int:
        """Return the least number of a curve's links and sites that a route meets, up to ``winds``.

        A site counts once, a link each time. A route that meets no site crosses ``winds`` links.
        """
        crossing = np.isin(self._link, links)
        entering = csr_matrix(self._entering[rows][:, self._order])
        times, least = np.asarray(entering.sum(axis=0)).ravel(), winds
        for count in range(1, winds):
            if math.comb(len(rows), count) > MOST_SETS:
                return min(count, least)
            for met in itertools.combinations(range(len(rows)), count):
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

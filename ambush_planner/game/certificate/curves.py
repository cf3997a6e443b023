# SPDX-License-Identifier: Apache-2.0
"""Lower bound from a circulation between the faces of a planar two-way network.

A closed curve through faces and discs winds around an end if its signed crossings of a reference
route do not sum to 0. Every route then meets the curve: it drives one of the links that the curve
crosses, or one of the curve's sites hits it. Let curves c have weights w_c that sum to at most
``price`` times the cost of each link, and to at most the site price q_j alpha_j of each disc j.
Then every route satisfies

    price * cost(route) + sum of q_j alpha_j over the sites that hit it  >=  sum of all w_c,

because a route that site j hits pays for all curves through disc j at once. The mean over a
strategy within the budget bounds its value (docs/theory.md, Proposition 7.3). The circulation is
decomposed into simple cycles, which are such curves. A curve that winds n times counts as often as
every route meets it, at most n times.
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

# Maximum number of sets of a curve's sites, all of one size, that are enumerated.
MAX_SETS = 300


def curve_bound(faces: Faces, circulation: Circulation, site_prices: FloatArray, budget: Budget,
                price: float, deadline: float = math.inf, target: float = math.inf) -> float:
    """Return the lower bound that a circulation proves within the budget, at ``site_prices`` (N,).

    Flow beyond a site price, or beyond the price of a link, is left out. Curves that wind several
    times count once, until it is computed how often each counts; this ends when ``target`` is
    proved, or at ``deadline`` (``time.monotonic``). Raises SolverFailed if the circulation belongs
    to another network.
    """
    game, flow, site = faces.game, circulation.flow, circulation.site
    if len(circulation.through) != len(faces.left) or site.max(initial=-1) >= len(site_prices):
        raise SolverFailed('the circulation is that of another network')
    edge, capacity = np.flatnonzero(game.playable), np.full(len(faces.left), np.inf)
    edge_price = price * budget.cost if price > 0.0 else np.zeros(len(faces.link))
    np.minimum.at(capacity, faces.link[edge], edge_price[edge])
    inflow = sums(site, np.maximum(flow, 0.0), len(site_prices))
    shares = np.minimum(site_prices, inflow) / np.where(inflow > 0.0, inflow, 1.0)
    row_of = np.zeros(len(site_prices), dtype=np.int64)
    row_of[game.sites] = np.arange(len(game.sites))
    arcs, unavoidable = _arcs(faces, np.clip(circulation.through, -capacity, capacity),
                              np.where(flow > 0.0, flow * shares[site], flow), row_of[site],
                              circulation.face)
    bound = float(site_prices[game.sites[unavoidable]].sum()) - (
        price * budget.limit if price > 0.0 else 0.0)
    winding = []
    for cycle, weight in simple_cycles(arcs.tail, arcs.head, arcs.size):
        winds = abs(int(arcs.gain[cycle].sum()))
        bound += weight * min(winds, 1)
        if winds > 1:
            winding.append((weight, winds, cycle))
    if not winding:
        return bound
    routes = _Crossings(faces)
    for weight, winds, cycle in sorted(winding, key=lambda curve: -curve[0] * (curve[1] - 1)):
        if bound >= target or time.monotonic() > deadline:
            break
        link, row = arcs.link[cycle], np.unique(arcs.row[cycle])
        bound += weight * (routes.least_met(link[link >= 0], row[row >= 0], winds) - 1)
    return bound


class _Arcs(NamedTuple):
    """Arcs (K,) of a circulation with flow ``size``, from ``tail`` to ``head``.

    Nodes are the faces, then the parts of the discs' rims. An arc either crosses a ``link`` or
    leads into or out of the disc in a ``row`` of the game; the other number is -1. ``gain`` is what
    the arc adds to the winding number.
    """

    tail: IndexArray
    head: IndexArray
    gain: IndexArray
    size: FloatArray
    link: IndexArray
    row: IndexArray


def _arcs(faces: Faces, through: FloatArray, disc_flow: FloatArray, row: IndexArray,
          face: IndexArray) -> tuple[_Arcs, IndexArray]:
    """Arcs of flows ``through`` links (L,), and from ``face`` (T,) into the discs of ``row`` (T,).

    A curve passes a disc only within one part of its rim, so it does not cross the secured area.
    Every route meets an unavoidable disc, around which winding is not defined: flow into such discs
    is left out, and their rows (K,) are returned as well.
    """
    pair, link = np.flatnonzero(disc_flow), np.flatnonzero(through)
    rows, disc = np.unique(row, return_inverse=True)
    discs = faces.discs(csr_matrix(faces.game.entering[rows]))
    tail, head = faces.left[link], faces.right[link]
    gain, flow, arc_row = faces.crossed[link], through[link], np.full(len(link), -1)
    if len(pair) and len(discs.face):
        key = discs.disc * faces.count + discs.face
        wanted = disc.ravel()[pair] * faces.count + face[pair]
        place = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        found = (key[place] == wanted) & ~discs.unavoidable[disc.ravel()[pair]]
        place, pair = place[found], pair[found]
        tail = np.concatenate((tail, face[pair]))
        head = np.concatenate((head, faces.count + discs.part[place]))
        gain = np.concatenate((gain, discs.offset[place]))
        flow = np.concatenate((flow, disc_flow[pair]))
        arc_row = np.concatenate((arc_row, row[pair]))
    forward, size = flow > 0.0, np.abs(flow)
    kept = size > NEGLIGIBLE * size.max(initial=0.0)
    arcs = _Arcs(*(each[kept] for each in (
        np.where(forward, tail, head), np.where(forward, head, tail),
        np.where(forward, gain, -gain), size,
        np.append(link, np.full(len(arc_row) - len(link), -1)), arc_row)))
    return arcs, rows[discs.unavoidable]


class _Crossings:
    """Counts how often every route of a leg meets a curve."""

    def __init__(self, faces: Faces) -> None:
        network, edge = faces.game.network, np.flatnonzero(faces.game.playable)
        order = edge[np.lexsort((network.heads[edge], network.tails[edge]))]
        self._ends, self._head = (network.source, network.target), network.heads[order]
        count = faces.game.node_count
        self._first = np.searchsorted(network.tails[order], np.arange(count + 1))
        self._link, self._order, self._entering = faces.link[order], order, faces.game.entering

    def least_met(self, links: IndexArray, rows: IndexArray, winds: int) -> int:
        """Least number of a curve's links and sites that a route meets, at most ``winds``.

        A site counts once, a link each time. A route that meets no site crosses ``winds`` links.
        Sets of sites are enumerated: for each, a route may meet no others.
        """
        crossing = np.isin(self._link, links)
        entering = csr_matrix(self._entering[rows][:, self._order])
        times, least = np.asarray(entering.sum(axis=0)).ravel(), winds
        for count in range(1, winds):
            if math.comb(len(rows), count) > MAX_SETS:
                return min(count, least)
            for met in itertools.combinations(range(len(rows)), count):
                if count >= least:
                    return least
                free = np.asarray(entering[list(met)].sum(axis=0)).ravel()
                crossed = self._crossed(crossing, times > free, least - count)
                least = min(least, count + crossed)
        return least

    def _crossed(self, crossing: BoolArray, blocked: BoolArray, limit: int) -> int:
        """Fewest ``crossing`` edges on a route without ``blocked`` ones, at most ``limit``."""
        weight = np.where(blocked, np.inf, np.where(crossing, 1.0, ROUNDING))
        count = len(self._first) - 1
        graph = csr_matrix((weight, self._head, self._first), (count, count))
        source, target = self._ends
        fewest = dijkstra(graph, indices=source, limit=limit - 0.5)[target]
        return min(round(fewest), limit) if np.isfinite(fewest) else limit

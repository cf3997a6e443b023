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
if its crossings do not add up to 0. Routes meet one that winds around an end more often more than
once, which labels find if it matters (``best_response``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ...arrays import NEGLIGIBLE, FloatArray, IndexArray, sums
from ...errors import SolverFailed
from ..budget import Budget
from ..distribution.acyclic import simple_cycles
from ..faces import Circulation, Faces


def curve_bound(faces: Faces, given: Circulation, site_prices: FloatArray, budget: Budget,
                price: float) -> float:
    """The bound that a circulation proves within the budget, for ``site_prices`` (N,).

    Flow beyond a site price, or beyond a link's share of the price, counts for nothing. Raises
    SolverFailed if the circulation is that of another network.
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
    return bound + sum(weight for cycle, weight in simple_cycles(arcs.tail, arcs.head, arcs.size)
                       if arcs.gain[cycle].sum() != 0)


class _Arcs(NamedTuple):
    """The flows ``size`` (K,) of a circulation, from ``tail`` to ``head`` (K,).

    These are faces, and then parts of the rims of discs. ``gain`` is what an arc adds to the
    winding.
    """

    tail: IndexArray
    head: IndexArray
    gain: IndexArray
    size: FloatArray


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
    gain, flow = faces.crossed[link], through[link]
    if len(pair) and len(discs.face):
        key = discs.disc * faces.count + discs.face
        wanted = disc.ravel()[pair] * faces.count + face[pair]
        at = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        found = (key[at] == wanted) & ~discs.unavoidable[disc.ravel()[pair]]
        at, pair = at[found], pair[found]
        tail = np.concatenate((tail, face[pair]))
        head = np.concatenate((head, faces.count + discs.part[at]))
        gain = np.concatenate((gain, discs.offset[at]))
        flow = np.concatenate((flow, inside[pair]))
    forward, size = flow > 0.0, np.abs(flow)
    kept = size > NEGLIGIBLE * size.max(initial=0.0)
    arcs = _Arcs(*(each[kept] for each in (
        np.where(forward, tail, head), np.where(forward, head, tail),
        np.where(forward, gain, -gain), size)))
    return arcs, rows[discs.unavoidable]

# SPDX-License-Identifier: Apache-2.0
"""The last stage of a solve: strategies with their certificates.

Value and bound are recomputed from both sides' strategies alone (``certificate``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray
from .ambusher import Ambusher
from .certificate.certificate import lower_bounds
from .distribution.chain import MarkovChain, RouteMixture
from .hits import Law
from .legs import Legs
from .search import Incumbent, Search
from .strategy import TripStrategy, make_strategies
from .tolerance import CERTIFICATE_TOLERANCE, Reason, ceiling, within


def certify(search: Search, best: Incumbent) -> TripStrategy:
    """Certify the strategies of an incumbent: their value everywhere, and the best lower bound.

    Their games have the network's nodes as sites, and the added ones that the value or a bound
    depends on.
    """
    if isinstance(best.law, MarkovChain):
        best = replace(best, law=best.law.without_rare())
    best = search.value_everywhere(best)
    legs, count = search.legs, len(search.loss)
    of_nodes, ambushes = np.arange(count) < len(legs.loss), [*search.earlier, search.program.ambush]
    needed = of_nodes.copy()
    for ambush in ambushes:
        needed[np.flatnonzero(ambush.q)] = True
        for circulation in ambush.circulations:
            needed[circulation.site] = True
    if best.worst >= 0:
        needed[best.worst] = True
    added = np.flatnonzero(needed & ~of_nodes)
    legs = legs.with_sites(search.points[added], search.loss[added],
                           csr_matrix(search.entering[added]))
    ambusher, bounds = _best_proof(search, legs, best, [ambush.ambusher(legs.games[0], needed)
                                                        for ambush in ambushes])
    law, mixtures = best.law, list[RouteMixture | None]([None] * len(legs.games))
    if isinstance(law, RouteMixture):
        mixtures = [law.of_leg(k, int(first)) for k, first in enumerate(legs.first[:-1])]
    found = make_strategies(legs, law.uses(legs.edge_count), mixtures, ambusher, bounds,
                            iterations=search.evaluations)
    reason: Reason = 'complete'
    if not within(found.value, found.lower_bound, search.problem.tolerance + CERTIFICATE_TOLERANCE):
        reason = 'time' if search.problem.out_of_time else search.reason
    leg_bound = best.entropy_bound if len(legs.games) == 1 else np.nan
    strategies = tuple(replace(leg, reason=reason, entropy_bound=leg_bound) for leg in found.legs)
    return replace(found, legs=strategies, reason=reason, entropy_bound=best.entropy_bound)


def _best_proof(search: Search, legs: Legs, best: Incumbent,
                ambushers: list[Ambusher]) -> tuple[Ambusher, FloatArray]:
    """Best certified bounds (legs,) and their ambusher; stops early within the tolerance."""
    target, proved = best.value / ceiling(1.0, search.tolerance), []
    for ambusher in ambushers:
        bounds = np.zeros(len(legs.games))
        if search.program.bound > 0.0:  # else the search for a bound can take minutes
            targets = _leg_targets(legs, best.law, ambusher, target)
            bounds = lower_bounds(legs, ambusher, search.problem.certificate_deadline, targets)
        proved.append((ambusher, bounds))
        if bounds.sum() >= target:
            break
    return max(proved, key=lambda each: float(each[1].sum()))


def _leg_targets(legs: Legs, law: Law, ambusher: Ambusher, target: float) -> FloatArray:
    """Bound to prove for each leg (legs,), so that the sum is ``target``.

    A leg can prove at most the cost of its own strategy against the ambusher. What all legs
    together can prove beyond the target is subtracted from them in proportion to their hits.
    """
    if len(legs.games) == 1:
        return np.array([target])
    game = legs.games[0]
    site_prices = (game.loss * ambusher.q)[game.sites]
    rows = np.flatnonzero(site_prices)
    uses, entering = legs.split(law.uses(legs.edge_count)), csr_matrix(legs.entering[rows])
    leg, hits = np.repeat(np.arange(len(legs.games)), np.diff(legs.first)), []
    for k in range(len(legs.games)):
        of_leg = csr_matrix(entering.multiply(leg == k))
        of_leg.eliminate_zeros()  # the law asks which entries there are
        hits.append(float(site_prices[rows] @ law.meets(of_leg)))
    overruns = [price * (float(p[p > 0.0] @ budget.reduced_cost[p > 0.0]) - budget.margin)
                if price > 0.0 else 0.0
                for price, budget, p in zip(ambusher.prices, legs.budgets, uses, strict=True)]
    costs, shares = np.add(hits, overruns), np.array(hits)
    surplus = max(float(costs.sum()) - target, 0.0)
    return np.asarray(costs - surplus * shares / max(float(shares.sum()), np.finfo(float).tiny))

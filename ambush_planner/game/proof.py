# SPDX-License-Identifier: Apache-2.0
"""The last stage of a solve: strategies with their value at any place and a bound that is proved.

Both are computed again from the strategies and the ambusher alone (``certificate``).
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
    """The strategies of an incumbent, with their value at any place and a bound that is proved.

    In games with the sites that matter for it or for its bound.
    """
    if isinstance(best.law, MarkovChain):
        best = replace(best, law=best.law.without_rare())
    best = search.at_any_site(best)
    legs, count = search.legs, len(search.loss)
    own, ambushes = np.arange(count) < len(legs.loss), [*search.earlier, search.program.ambush]
    kept = own.copy()
    for each in ambushes:
        kept[np.flatnonzero(each.q)] = True
        for circulation in each.circulations:
            kept[circulation.site] = True
    if best.worst >= 0:
        kept[best.worst] = True
    added = np.flatnonzero(kept & ~own)
    legs = legs.with_sites(search.points[added], search.loss[added],
                           csr_matrix(search.entering[added]))
    ambusher, bounds = _best_proof(search, legs, best, [each.ambusher(legs.games[0], kept)
                                                        for each in ambushes])
    law, mixtures = best.law, list[RouteMixture | None]([None] * len(legs.games))
    if isinstance(law, RouteMixture):
        mixtures = [law.of_leg(k, int(first)) for k, first in enumerate(legs.first[:-1])]
    found = make_strategies(legs, law.uses(legs.edge_count), mixtures, ambusher, bounds,
                            iterations=search.evaluations)
    reason: Reason = 'complete'
    if not within(found.value, found.lower_bound, search.problem.tolerance + CERTIFICATE_TOLERANCE):
        reason = 'time' if search.problem.out_of_time else search.reason
    alone = best.entropy_bound if len(legs.games) == 1 else np.nan
    strategies = tuple(replace(leg, reason=reason, entropy_bound=alone) for leg in found.legs)
    return replace(found, legs=strategies, reason=reason, entropy_bound=best.entropy_bound)


def _best_proof(search: Search, legs: Legs, best: Incumbent,
                ambushers: list[Ambusher]) -> tuple[Ambusher, FloatArray]:
    """The ambusher who proves most, and the legs' bounds; those within the tolerance will do."""
    target, proved = best.value / ceiling(1.0, search.tolerance), []
    for ambusher in ambushers:
        bounds = np.zeros(len(legs.games))
        if search.program.bound > 0.0:  # else a search for what is proved can take minutes
            targets = _leg_targets(legs, best.law, ambusher, target)
            bounds = lower_bounds(legs, ambusher, search.problem.certificate_deadline, targets)
        proved.append((ambusher, bounds))
        if bounds.sum() >= target:
            break
    return max(proved, key=lambda each: float(each[1].sum()))


def _leg_targets(legs: Legs, law: Law, ambusher: Ambusher, target: float) -> FloatArray:
    """The bound to prove of each leg (legs,): they add up to ``target`` if that is possible.

    What the leg's own strategy costs against the ambusher, less its share of what need not be
    proved.
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
    paid = [price * (float(p[p > 0.0] @ budget.reduced_cost[p > 0.0]) - budget.margin)
            if price > 0.0 else 0.0
            for price, budget, p in zip(ambusher.prices, legs.budgets, uses, strict=True)]
    costs, shares = np.add(hits, paid), np.array(hits)
    spare = max(float(costs.sum()) - target, 0.0)
    return np.asarray(costs - spare * shares / max(float(shares.sum()), np.finfo(float).tiny))

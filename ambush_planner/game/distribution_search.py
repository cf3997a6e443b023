# SPDX-License-Identifier: Apache-2.0
"""The third stage of a solve: the law of greatest entropy within the tolerance of the bound.

It is a Markov chain for each leg, found in rounds that begin at the program's flow; sites that it
violates are added. If no chain is within the tolerance, whole routes are drawn.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import NEGLIGIBLE
from .distribution.acyclic import acyclic_subnetwork, order_potential, topological_order
from .distribution.gibbs import acyclic_network, in_series
from .distribution.route_distribution import DISTRIBUTION, RouteDistribution
from .hits import largest_product
from .search import Incumbent, Search
from .tolerance import ROUNDS, ceiling, within
from .value.potential import Potential
from .value.routes import ROUTES, Routes
from .value_search import ROUTES_GAP, find_sites, flow_law

# Share of the tolerance that a program's strategies may use; a distribution may use the rest.
FLOW_TOLERANCE = 0.5
# Share of the tolerance above which a site is violated by a distribution.
SEPARATION_TOLERANCE = 0.8
# Least relative growth of the entropy for another round: the accuracy of a rough one.
GROWTH = DISTRIBUTION.early_accuracy.missing
# Share of the remaining time after which rounds end if none is within the tolerance by then; the
# flow is improved instead.
ROUNDS_END = 0.8


def find_distribution(search: Search) -> Incumbent:
    """Find the law of greatest entropy within the tolerance, or of least value if none is.

    Without a reach, chains are within the tolerance, and usually also with one. Whole routes can
    have a lower value, since a chain does not remember which sites it has met.
    """
    best = find_chain(search)
    if best is None:
        law = flow_law(search)
        best = Incumbent(law, largest_product(search.loss, search.entering, law)[0])
    if best.within_tolerance or search.legs.no_reentry or search.problem.out_of_time:
        return best
    mixture = find_mixture(search)
    # More sites are known now.
    value, _ = largest_product(search.loss, search.entering, best.law)
    return mixture if mixture.value <= value else best


def find_chain(search: Search) -> Incumbent | None:
    """Find the chains of greatest entropy within the tolerance, or of least value if none is.

    They are found in rounds that begin at the latest distribution, or at the program's flow; every
    chain on the way counts. Rounds begin again if no distribution near a chain keeps to the caps of
    added sites. Returns None if no chain keeps the budgets.
    """
    program, entropy, distribution = search.program, 0.0, search.distribution
    if distribution:
        added = slice(distribution.site_count, None)
        distribution.add_sites(csr_matrix(search.entering[added]), search.loss[added])
        distribution.measure(_cap(search))
    else:
        distribution = _around_flow(search)
    best: Incumbent | None = None
    known = len(search.loss)  # sites when rounds began
    end, begin = search.deadline, time.monotonic()
    latest = begin + ROUNDS_END * (end - begin)
    if search.problem.site_search is None:  # else unknown sites may cost the flow more
        best = search.better(best, distribution)
    for _ in range(ROUNDS):
        distribution.deadline = end if best and best.within_tolerance else latest
        if time.monotonic() > distribution.deadline:
            search.reason = 'time'
            break
        found, feasible = None, distribution.round()
        search.evaluations += distribution.evaluations
        if not feasible and not distribution.rounds:
            break
        if feasible:
            threshold = ceiling(search.bound, SEPARATION_TOLERANCE * search.tolerance)
            found = search.add_violated_sites(distribution.chain, threshold, ROUTES.site_spacing)
        if found:
            distribution.add_sites(found.entering, found.alpha)
            search.solve_program()
        if not feasible or (found and program.bound == 0.0):
            # The flow keeps to the caps of all sites: begin again there, and if the bound is 0,
            # without edges that they hit.
            if len(search.loss) == known:
                break
            distribution, known = _around_flow(search), len(search.loss)
            continue
        distribution.measure(_cap(search))
        best = search.better(best, distribution)
        grew = distribution.entropy > entropy * (1.0 + GROWTH)
        entropy = distribution.entropy
        found_good = best is not None and best.within_tolerance  # and within the budgets
        if distribution.good and (distribution.no_reentry or found_good and not grew):
            break
    if best and not best.within_tolerance:
        find_sites(search, ROUNDS)
        best = search.better(best, _around_flow(search))
    search.distribution = distribution
    return best


def _cap(search: Search) -> float:
    """Cap of each site's mean loss, without the tolerance."""
    program = search.program
    if isinstance(program, Routes):
        least = ceiling(program.value, FLOW_TOLERANCE * search.tolerance)
        return max(program.bound, least / ceiling(1.0, search.tolerance))
    return search.bound


def _around_flow(search: Search) -> RouteDistribution:
    """Begin a distribution at the program's flow, on an acyclic subnetwork of each leg."""
    legs, bound = search.legs, search.program.bound
    flow = search.program.flow
    safe = legs.avoiding(search.entering) if bound == 0.0 else None
    parts = []
    for k, (game, p) in enumerate(zip(legs.games, legs.split(flow), strict=True)):
        # Drop edges that the budget leaves to less than ``NEGLIGIBLE`` of the routes. So a budget
        # that allows only shortest routes allows them all in one order of the nodes.
        used = game.least_weights(legs.budgets[k].used_margin) <= 1.0 / NEGLIGIBLE
        game = game.restricted_to(used | (p > 0.0)) or game
        if safe and not p[~safe.games[k].playable].any():  # no route is hit at all
            game = safe.games[k]
        position = topological_order(game, p, order_potential(game))
        part = acyclic_subnetwork(game, position)
        assert part is not None  # it contains the flow
        parts.append(acyclic_network(game.network, np.flatnonzero(part.playable), position))
    network = in_series(parts, legs.first)
    distribution = RouteDistribution(network, flow[network.edge], legs, search.tolerance,
                                     search.deadline)
    distribution.add_sites(search.entering, search.loss)
    distribution.measure(_cap(search))
    if not legs.no_reentry:  # without a reach, the search is as fast from 0
        ambush = search.program.ambush
        distribution.aim(ambush.q, np.array([
            price * budget.margin for price, budget in zip(ambush.prices, legs.budgets, strict=True)
            if budget.is_limited]))
    return distribution


def find_mixture(search: Search) -> Incumbent:
    """Find the mixture of whole routes of least value, by column generation and separation."""
    if isinstance(search.program, Potential):
        potential = search.program
        search.earlier.append(potential.ambush)
        routes = Routes(search.legs, ROUTES_GAP * search.tolerance)
        known = len(routes.loss)
        routes.add_sites(csr_matrix(search.entering[known:]), search.loss[known:])
        routes.bound = potential.bound
        search.program = routes
    find_sites(search, ROUNDS)
    program = search.program
    assert isinstance(program, Routes)
    good = within(program.value, program.bound, search.tolerance)
    return Incumbent(program.mixture, program.value, rating=(good, -program.value))

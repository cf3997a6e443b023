"""Stage 4, for games in which a route can come back into a site's reach: count each route once.

The linear program and the Gibbs law limit expected entries. Where routes come back, entries exceed
hits, so the law keeps to limits that are too tight for some sites, and its ambusher may prove
little. Level lines come with an ambusher that proves more. Without them, a program over sampled
routes (``route_program``) gives one, and a mixture of routes. On an acyclic part around the best of
these strategies the law is searched for again, each site's limit on entries raised by its ratio of
entries to hits, until its true value is within the slack.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from .acyclic import conserved_strategy
from .entropy_stage import EntropyStage, Solution, mixture
from .game import Game
from .hits import hit_probabilities, hits_can_differ, largest_losses, worst_loss
from .limit_rows import LimitRows
from .route_program import RouteProgram, solve_on_routes
from .route_sampler import RouteSampler, route_edges, route_entropy, shortest_route

# Routes drawn from the law that the program over routes begins with.
SAMPLED_ROUTES = 60
# The program over routes closes its gap to this share of the slack.
PROGRAM_GAP = 0.2
# Most repetitions of the law, and the share of the slack that its limits aim at.
MAX_ROUNDS, AIM = 10, 0.9
# Limits less than this share of the slack below the best value are not worth another law.
LEAST_GAIN = 0.2
# Laws whose values differ by less than this share of the slack are compared by their entropy.
SAME = 0.05
# From the fourth law on, one that gains less than this share of what was missing is the last.
LEAST_PROGRESS = 0.01
# Flows below this are rounding of the program over routes.
NEGLIGIBLE = 1e-9
# Sites whose entries cost less than this share of the aim keep a limit of one entry per hit.
NEAR_LIMIT = 0.7
# Least share of the value that one of several ambushers may cause at a site.
LEAST_SHARE = 1e-3
# Hit probabilities below this have no reliable ratio to entries.
LEAST_HIT = 1e-6


def count_routes_once(stage: EntropyStage, solution: Solution) -> Solution:
    """Improve a solution until its value, hits counted once, is within the slack of its bound.

    If the slack cannot be reached, returns the solution of most entropy among those whose value is
    within the slack of the least one found, and not above the value of ``solution``.
    """
    game = stage.game
    if not hits_can_differ(game):
        return solution
    value = worst_loss(game, solution.p)
    q, prices, bound = stage.best_proof(solution)
    solution = replace(solution, q=q, prices=prices)
    network, base = game.network, stage.level_lines
    if base is None or value < worst_loss(game, base):
        if value <= bound * (1.0 + stage.slack) or time.monotonic() > stage.deadline:
            return solution
        if base is None:
            program = _on_sampled_routes(stage, solution)
            bound, base = program.bound, conserved_strategy(game, program.p, NEGLIGIBLE)
            solution = replace(solution, q=program.q, prices=program.prices)
            if base is None or value <= bound * (1.0 + stage.slack):
                return solution
        else:
            base = solution.p
    limit = bound * (1.0 + stage.slack)
    mixed = replace(solution, p=base, entropy_bound=np.nan)
    laws = _laws_around(stage, mixed, bound)
    if laws:
        least = min(each.value for each in laws)
        most = least * (1.0 + SAME * stage.slack)
        most = min(most, limit) if least <= limit else most
        near = [each.solution for each in laws if each.value <= most]
        law = max(near, key=lambda each: route_entropy(network, each.p))
        fitting = mixture(law.p, base, lambda p: worst_loss(game, p) <= limit)
        if fitting is not None:
            return replace(law, p=fitting)
    candidates = [_Valued(value, solution), _Valued(worst_loss(game, base), mixed), *laws]
    most = min(value, min(each.value for each in candidates) * (1.0 + stage.slack))
    good = [each for each in candidates if each.value <= most]
    best = max(good, key=lambda each: route_entropy(network, each.solution.p))
    return replace(best.solution, iterations=stage.evaluations)


def _on_sampled_routes(stage: EntropyStage, solution: Solution) -> RouteProgram:
    game = stage.game
    drawn = RouteSampler(game.network, solution.p).draw_many(SAMPLED_ROUTES,
                                                             np.random.default_rng(0))
    drawn.append(shortest_route(game.network, np.flatnonzero(game.playable)))
    routes = [route_edges(game.network, route) for route in drawn]
    return solve_on_routes(game, routes, stage.budgets, solution.q, solution.prices,
                           PROGRAM_GAP * stage.slack, stage.deadline)


class _Valued(NamedTuple):
    value: float
    solution: Solution


def _laws_around(stage: EntropyStage, base: Solution, bound: float) -> list[_Valued]:
    """Repeat the law with limits on entries that follow from the hits of the law before.

    The limits aim at the ``bound``, of which each of several ambushers' sites gets a share; each
    time that no law can keep them, half way from there to the least value so far. Ends at a law
    whose value is within the slack of the bound.
    """
    game = stage.game
    network = stage.acyclic_part(game, base.p)
    loss, aim = game.loss[game.sites], bound * (1.0 + AIM * stage.slack)
    share = _shares(game, base.p)
    eased, latest, start = np.ones(len(loss)), base, None
    best = worst_loss(game, base.p)
    found: list[_Valued] = []
    for _ in range(MAX_ROUNDS):
        entries, level = game.hits @ latest.p, aim * share
        hit, near = entries.copy(), np.flatnonzero(loss * entries > NEAR_LIMIT * level)
        hit[near] = hit_probabilities(game, latest.p, near)
        ratio = entries / np.maximum(hit, LEAST_HIT)
        ratio[hit <= LEAST_HIT] = 1.0
        if found:
            eased *= np.minimum(level / np.maximum(loss * hit, level), 1.0)
        limits = LimitRows(game, network, level * ratio * eased, stage.budgets)
        drawn, law = stage.gibbs_strategy(network, limits, limits.start(start, np.inf))
        p = None if law.infeasible else mixture(drawn, base.p, stage.within_budgets)
        if time.monotonic() > stage.deadline:
            break
        if p is None:
            eased[:], start, aim = 1.0, None, np.sqrt(aim * best)
            if aim > best * (1.0 - LEAST_GAIN * stage.slack):
                break
            continue
        start = limits.unscaled(law.multipliers)
        most = limits.entropy_bound(law, (1.0 + stage.slack) / (1.0 + AIM * stage.slack))
        latest = replace(base, p=p, multipliers=start, iterations=stage.evaluations,
                         entropy_bound=most)
        found.append(_Valued(worst_loss(game, p), latest))
        missing = found[-1].value - bound * (1.0 + stage.slack)
        gained = min(each.value for each in found[:-1]) - found[-1].value if found[3:] else np.inf
        best = min(best, found[-1].value)
        if gained < LEAST_PROGRESS * missing or missing <= 0.0:
            break
    return found


def _shares(game: Game, p: FloatArray) -> FloatArray:
    """The share (S,) of the value that each site may cause; 1 if there is one ambusher.

    With k ambushers, the k costliest sites keep their shares of the value of p (M,), and all others
    have the least of these, so that no k sites cause more than the whole.
    """
    losses, rows = largest_losses(game, p)
    share = np.full(len(game.sites), losses[-1])
    share[rows] = losses
    return np.asarray(np.maximum(share / losses.sum(), LEAST_SHARE))

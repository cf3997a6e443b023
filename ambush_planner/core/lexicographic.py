"""The default strategy: least risk within the length budget, then most entropy, acyclic."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_matrix, identity
from scipy.sparse.linalg import splu

from .acyclic import acyclic_edges, forward_edges
from .arrays import sums
from .errors import BudgetInfeasible, SolverFailed
from .flow_programs import BudgetedValue, largest_flow, most_entropy, shortest_flow
from .game import BoolArray, Game
from .game_value import GameValue, indifferent_ambusher, solve_by_cut
from .outcome import Outcome
from .paths import distances_from, on_some_route
from .risk_map import FloatArray

# The later stages may miss the least value by this much, relative: without any room, the minimum
# cut leaves their feasible sets no interior.
ROOM = 4e-7
# A part of the network suits a budget that is this much longer than the shortest strategy on it.
WELL = 0.98
# Nodes that an optimal strategy visits less often than this are left out.
HOPELESS = 1e-8
# Edges that an accepted strategy uses less than this can be left out where the budget binds.
HARDLY = 1e-4
# A scaled flow below this has too few digits: the value is many orders over the first guess.
TINY_FLOW, RESCALINGS = 1e-3, 6
# Routes this near to the shortest, relative, count as shortest when the budget allows no detour.
NO_DETOUR = 1e-7


@dataclass(frozen=True, eq=False)
class _LeastRisk:
    """Stage 1: a value that an acyclic part of the network attains, and the ambusher's side."""

    value: float
    edges: BoolArray
    q: FloatArray
    length_price: float = 0.0


def max_entropy_strategy(
    game: Game, budget: float, risk_slack: float, deadline: float
) -> Outcome:
    """Solve the stages one after the other, each within the room that the one before leaves.

    1. The least value z that a strategy of expected length <= ``budget`` [m] attains.
    2. Values up to (1 + ``risk_slack``) z are accepted.
    3. Of these strategies, the one of maximal edge entropy on an acyclic part of the network that
       holds one of value z.

    Raises
    ------
    BudgetInfeasible
        The shortest playable route is longer than the budget.
    """
    left = _only_routes_within(game, budget)
    limit = np.inf if left is not game else budget
    accept = (1.0 + risk_slack) * (1.0 + ROOM)
    risk = _least_risk(left, limit, accept, deadline)
    capacity = _capacities(left, accept * risk.value)
    p, iterations = most_entropy(left, risk.edges, capacity, limit, deadline)
    price = risk.length_price
    if left is not game:
        price = risk.value / (NO_DETOUR * budget) if budget > 0.0 else 0.0
    return Outcome(_as_walk(game, p), risk.q, budget, price, iterations)


def _capacities(game: Game, value: float) -> FloatArray:
    """Visits (S,) that keep each site's mean loss within ``value``."""
    capacities: FloatArray = value / game.loss[game.sites]
    return capacities


def _only_routes_within(game: Game, budget: float) -> Game:
    """Check the budget; where it allows no detour at all, keep the shortest routes alone."""
    network = game.network
    edges, lengths = network.edges[game.playable], network.lengths[game.playable]
    ahead = distances_from(edges, lengths, game.node_count, network.source)
    behind = distances_from(edges[:, ::-1], lengths, game.node_count, network.target)
    shortest = float(ahead[network.target])
    if shortest > budget * (1.0 + NO_DETOUR):
        raise BudgetInfeasible(
            f"the shortest playable route is {shortest:.3f} m long, more than the budget of "
            f"{budget:.3f} m; raise max_detour, or alpha_threshold"
        )
    if budget > shortest * (1.0 + NO_DETOUR):
        return game
    through = ahead[network.tails] + network.lengths + behind[network.heads]
    return replace(game, playable=game.playable & (through <= shortest * (1.0 + NO_DETOUR)))


def _least_risk(game: Game, budget: float, accept: float, deadline: float) -> _LeastRisk:
    """Stage 1; ``accept`` times its value is what the later stages may use."""
    if game.ambush_radius > 0.0:
        return _by_program(game, budget, accept, deadline, 0.0)
    lean, exact = _solve_leanly(game)
    if float(exact.p @ game.network.lengths) <= budget:
        return _LeastRisk(exact.value, _edges_around(lean, exact), exact.q)
    if exact.value == 0.0:
        return _by_program(game, budget, accept, deadline, 0.0)
    # The flow is too long, but its acyclic part may hold shorter strategies of the same value. The
    # part around the shortest of all is narrower, and comes second.
    capacity = _capacities(lean, (1.0 + ROOM) * exact.value)
    around = acyclic_edges(lean, exact.p)
    if shortest_flow(replace(lean, playable=around), capacity, deadline).length < WELL * budget:
        return _LeastRisk(exact.value, around, exact.q)
    least = shortest_flow(lean, capacity, deadline)
    if least.length > budget:
        return _by_program(game, budget, accept, deadline, exact.value)
    return _LeastRisk(exact.value, forward_edges(lean, -least.potential), exact.q)


def _without_hopeless_nodes(game: Game, value: float) -> Game | None:
    """Leave out the nodes that a strategy of this value visits next to never, if there are any.

    A node whose alpha is many orders over the value bounds the visits so tightly that rounding
    alone would break the bound. None: there are no such nodes, or no route does without them.
    """
    hopeless = value < HOPELESS * game.loss
    if not hopeless.any():
        return None
    network = game.network
    usable = game.playable & ~hopeless[network.heads] & ~hopeless[network.tails]
    useful = on_some_route(
        network.edges[usable], game.node_count, network.source, network.target
    )
    if not useful[network.source]:
        return None
    return replace(game, playable=usable & useful[network.tails] & useful[network.heads])


def _solve_leanly(game: Game) -> tuple[Game, GameValue]:
    """Solve by a cut, without the nodes that hardly count where the value allows it."""
    exact = solve_by_cut(game)
    lean = _without_hopeless_nodes(game, exact.value) if exact.value > 0.0 else None
    if lean is None:
        return game, exact
    again = solve_by_cut(lean)
    if again.value > exact.value * (1.0 + ROOM / 4.0):
        return game, exact
    return lean, replace(again, q=exact.q)


def _edges_around(game: Game, exact: GameValue) -> BoolArray:
    """Acyclic edges that hold the exact strategy; past every site when the value is 0."""
    if exact.value == 0.0:
        harmless = game.loss[game.network.heads] == 0.0
        game = replace(game, playable=game.playable & harmless)
    return acyclic_edges(game, exact.p)


def _by_program(
    game: Game, budget: float, accept: float, deadline: float, at_least: float
) -> _LeastRisk:
    """Least value by a convex program, where no minimum cut tells it but only ``at_least``."""
    safe = _past_all_sites(game)
    if safe is not None and _shortest(safe) <= budget:
        flow = shortest_flow(safe, np.full(len(game.sites), np.inf), deadline)
        return _LeastRisk(0.0, forward_edges(safe, -flow.potential), indifferent_ambusher(game))
    value, best = _least_value(game, budget, deadline, at_least)
    game = _without_hopeless_nodes(game, value) or game
    flow = shortest_flow(game, _capacities(game, accept * value), deadline)
    # No accepted strategy uses an edge more than the spare length over its reduced cost; edges
    # that can hardly be used would leave the entropy problem next to no interior.
    spare = max(budget - flow.length, 1e-9 * flow.length)
    usable = flow.reduced_cost * HARDLY <= spare
    edges = forward_edges(replace(game, playable=game.playable & usable), -flow.potential)
    if not edges.any():
        raise SolverFailed("the shortest strategy of least risk leaves no usable edges")
    q = np.zeros(game.node_count)
    q[game.sites] = best.site_price / game.loss[game.sites]
    total = q.sum()
    # In the scaled flow's units the dual reads: sum of site prices on a route + price * length is
    # at least 1 + price * budget; multiplied by the value it is the certificate's inequality.
    return _LeastRisk(value, edges, q / total, best.length_price / total)


def _least_value(
    game: Game, budget: float, deadline: float, at_least: float
) -> tuple[float, BudgetedValue]:
    """Solve for the largest flow in units in which it is neither tiny nor huge."""
    scale = at_least if at_least > 0.0 else float(game.loss[game.sites].min())
    best = largest_flow(game, _capacities(game, scale), budget, at_least > 0.0, deadline)
    for _ in range(RESCALINGS):
        if best.size > TINY_FLOW:
            break
        scale /= best.size + TINY_FLOW**2
        best = largest_flow(game, _capacities(game, scale), budget, at_least > 0.0, deadline)
    return scale / best.size, best


def _past_all_sites(game: Game) -> Game | None:
    """The game on the edges that no ambush hits, if a route is left; else None."""
    untouched = replace(game, playable=game.playable & (game.hits.getnnz(axis=0) == 0))
    return untouched if np.isfinite(_shortest(untouched)) else None


def _shortest(game: Game) -> float:
    """Length of the shortest playable route [m]; inf if there is none."""
    network = game.network
    edges, lengths = network.edges[game.playable], network.lengths[game.playable]
    return float(distances_from(edges, lengths, game.node_count, network.source)[network.target])


def _as_walk(game: Game, p: FloatArray) -> FloatArray:
    """Turn an almost conserved p on an acyclic network into the walk's exact probabilities.

    The walk leaves node i along edge k with probability p_k / sum of p out of i; its visits x
    follow node by node from the source, so conservation holds to rounding.
    """
    network, n = game.network, game.node_count
    out = sums(network.tails, p, n)
    used = np.flatnonzero(p > 0.0)
    tail, head = network.edges[used].T
    share = p[used] / out[tail]
    system = identity(n, format="csc") - csc_matrix((share, (head, tail)), shape=(n, n))
    start = np.zeros(n)
    start[network.source] = 1.0
    x = splu(system, diag_pivot_thresh=0.0).solve(start)
    walk = np.zeros_like(p)
    walk[used] = np.maximum(x[tail], 0.0) * share
    return walk

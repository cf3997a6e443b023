"""A trip whose legs pay separately: a lower bound for the trip, as easy to find as for one leg.

Let a copy of each site wait for each leg, so that a site pays once per leg. The best ambusher of
that game, all copies of a site added up, causes every trip at least the same loss: a site that he
holds for one leg may only hit the others as well (docs/theory.md, Proposition 13.1). The game has a
planar network for each leg, one budget, and no other connection between the legs: without a reach a
linear program solves it, with one the faces of all legs together.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack

from ..arrays import FloatArray, IndexArray, sums
from ..errors import SolverFailed, TimeLimit
from ..network.network import Network
from .budget import Budget
from .entropy_stage import EntropyStage, Solution
from .faces import Faces
from .flow_program import capped_at_one
from .game import Game
from .hits import worst_loss
from .least_risk import LeastRisk, least_risk

# Relative gap of the programs here, as a share of the slack.
GAP = 0.1


def along_separate_legs(stage: EntropyStage) -> Solution | None:
    """On a trip without a reach: the best ambusher of the separate legs, and a strategy."""
    game = stage.game
    if game.network.legs == 1 or game.reach > 0.0:
        return None
    separate = separate_legs(game)
    found = _by_entries(stage, separate, tuple(replace(b, game=separate) for b in stage.budgets))
    stage.level_lines = or_by_entries(stage, found.p)
    q = once_at_each_place(game, found.q)
    return Solution(stage.level_lines, q, found.prices, stage.evaluations)


def or_by_entries(stage: EntropyStage, p: FloatArray) -> FloatArray:
    """On a trip, p (M,) or the strategy of least value by entries, whichever is better."""
    if stage.game.network.legs == 1:
        return p
    with contextlib.suppress(TimeLimit, SolverFailed):
        other = _by_entries(stage, stage.game, stage.budgets, p).p
        return min(p, other, key=lambda each: worst_loss(stage.game, each))
    return p


def _by_entries(stage: EntropyStage, game: Game, budgets: tuple[Budget, ...],
                good: FloatArray | None = None) -> LeastRisk:
    return least_risk(game, budgets, stage.potential, GAP * stage.slack, stage.program_deadline(),
                      good)


def separate_legs(game: Game) -> Game:
    """The game in which each node of each layer is a site of its own."""
    given = game.network
    first, node = np.tile(given.representatives, given.legs), _node_of_leg(given)
    network = Network(given.points[first], given.alpha[first], node[given.edges],
                      int(node[given.source]), int(node[given.target]), seconds=given.seconds)
    separate = replace(game, network=network, loss=game.loss[first])
    if game.reach == 0.0:
        return separate
    layer = given.leg[given.tails]
    hits = csr_matrix(vstack([
        game.hits @ diags((layer == leg).astype(np.float64)) for leg in range(given.legs)
    ]))
    hits.eliminate_zeros()
    return replace(separate, known_hits=hits)


def _node_of_leg(network: Network) -> IndexArray:
    """The node (N,) that stands for each node if every leg has one for each place, in order."""
    return network.leg * network.place_count + network.places


def once_at_each_place(game: Game, q: FloatArray) -> FloatArray:
    """An ambusher q (N,) from that of separate legs, with at most one ambusher at each place."""
    network = game.network
    node = np.tile(network.representatives, network.legs)
    node[_node_of_leg(network)] = np.arange(game.node_count)
    found = sums(node, q, game.node_count)
    total, first = game.at_places(found), network.representatives
    capped = capped_at_one(total, game.ambushers)
    ratio = np.divide(capped, total, out=np.zeros_like(total), where=total > 0.0)
    found *= ratio[network.places]
    found[first] += np.where(total > 0.0, 0.0, capped)
    return found


def join_faces(game: Game, legs: Sequence[Faces]) -> Faces:
    """The faces of all legs; ``game`` is that of ``separate_legs``."""
    network, count = game.network, legs[0].game.node_count
    links = np.cumsum([0, *(len(leg.left) for leg in legs)])
    faces = np.cumsum([0, *(leg.count for leg in legs)])
    link = np.full(len(network.edges), -1)
    turned = np.zeros(links[-1], dtype=bool)
    for number, leg in enumerate(legs):
        own = np.flatnonzero(network.tails // count == number)
        edge = own[leg.link >= 0]
        link[edge] = leg.link[leg.link >= 0] + links[number]
        # The last edge of a leg leads to the stop's copy in the next layer, a higher node.
        tail, head = network.edges[edge].T
        turned[link[edge]] = (tail < head) != (tail % count < head % count)
    left = np.concatenate([leg.left + first for leg, first in zip(legs, faces, strict=False)])
    right = np.concatenate([leg.right + first for leg, first in zip(legs, faces, strict=False)])
    crossed = np.concatenate([leg.crossed for leg in legs])
    return Faces(game, int(faces[-1]), link, np.where(turned, right, left),
                 np.where(turned, left, right), np.where(turned, -crossed, crossed), legs[0].outer)

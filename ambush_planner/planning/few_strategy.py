# SPDX-License-Identifier: Apache-2.0
"""A mixture of few routes as a strategy, so that it can be shown and audited like any other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray, IndexArray
from ..game.ambusher import Ambusher
from ..game.budget import Budget
from ..game.certificate.certificate import Certificate
from ..game.game import make_game
from ..game.route_sampler import route_edges
from ..game.strategy import Strategy, strategy_of
from ..network.network import Network
from .few_routes import FewRoutes
from .path_mixtures import side_by_side


def few_strategy(strategy: Strategy, few: FewRoutes) -> tuple[Strategy, list[IndexArray]]:
    """The strategy on a network with a copy of its nodes for each route, and the routes there.

    Value and bound are those of the mixture, and the ambusher waits where it is hit hardest.
    """
    whole = strategy.network
    inner = [route[1:-1] for route in few.routes]
    of = np.concatenate(([whole.source, whole.target], *inner))
    edges, line = side_by_side(list(map(len, inner)))
    routes = [np.append(0, edges[line == k, 1]) for k in range(len(inner))]
    p = few.shares[line]
    seconds = None if whole.seconds is None else np.concatenate(
        [whole.seconds[route_edges(whole, route)] for route in few.routes])
    network = Network(whole.points[of], whole.alpha[of], edges, 0, 1,
                      np.unique(whole.places[of], return_inverse=True)[1], whole.leg[of], seconds)
    game = make_game(network, strategy.game.options)
    budget = replace(Budget.length(game, math.inf), least=strategy.shortest_length)
    ambusher = Ambusher(_at_worst(network, game.loss, few.worst_xy))
    mixed = strategy_of(game, p, ambusher, budget, 0.0)
    return replace(mixed, certificate=Certificate(few.value, few.lower_bound)), routes


def _at_worst(network: Network, loss: FloatArray, worst: FloatArray) -> FloatArray:
    """q (N,) of an ambusher at the node with a loss that is nearest to the worst place."""
    away = np.where(loss > 0.0, np.hypot(*(network.points - worst).T), np.inf)
    q = np.zeros(len(network.points))
    q[int(away.argmin())] = 1.0
    return q

# SPDX-License-Identifier: Apache-2.0
"""Solve the game of a plan; with a reach, against an ambusher anywhere in free ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, frozen_array
from ..errors import TimeLimit
from ..game.game import GameOptions, make_game
from ..game.revaluation import open_gap
from ..game.search import Multipliers
from ..game.strategy import Strategy, solve_game
from ..game.value.routes import Progress, no_progress
from ..maps.risk_map import RiskMap
from ..network.hiding_places import with_hiding_places, with_places
from ..network.network import Network
from .cell_losses import CellLosses, CellSearch
from .options import PlanningOptions, holds_anywhere, node_spacing, solved_game


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Another strategy to start from: its network and its multipliers, if it has any.

    ``refined`` (K, 3) is that of the new network.
    """

    network: Network
    multipliers: Multipliers | None
    refined: FloatArray

    @classmethod
    def of(cls, strategy: Strategy, refined: FloatArray | None = None) -> WarmStart:
        """Start from a strategy; by default its network's places are refined again."""
        network = strategy.network
        return cls(network, strategy.multipliers, network.refined if refined is None else refined)

    def on(self, network: Network) -> Multipliers | None:
        """The multipliers for another network: each site's from the nearest node."""
        points = self.network.points
        if self.multipliers is None:
            return None
        if np.array_equal(points, network.points):
            return self.multipliers
        _, nearest = cKDTree(points).query(network.points)
        sites = frozen_array(self.multipliers.sites[nearest], np.float64)
        return Multipliers(sites, self.multipliers.budgets)

    def sites_beyond(self, network: Network) -> FloatArray:
        """Positions (K, 2) of binding sites without edges that another network lacks [m]."""
        own = self.network
        if self.multipliers is None:
            return np.empty((0, 2))
        binding = self.multipliers.sites[own.representatives] > 0.0
        binding[own.places[own.edges]] = False
        places = np.unique(own.points[own.representatives[binding]], axis=0)
        return np.asarray(places[cKDTree(network.points).query(places)[0] > 0.0])


def solve_on_network(risk_map: RiskMap, network: Network, options: PlanningOptions,
                     warm: WarmStart | None = None, progress: Progress = no_progress) -> Strategy:
    """Solve the game on a network built on the map.

    With a reach, an ambusher may wait anywhere on free ground (``holds_anywhere``): the places that
    matter are added to the network as nodes without edges. At the time limit, the best strategy is
    returned if it is within ``max_gap``. Raises the errors of ``solve``.
    """
    cells = CellLosses(risk_map, options.game.ambush_in_obstacles)
    played = solved_game(risk_map, options)
    network = add_hiding_places(network, risk_map, options, played)
    if warm:
        places = warm.sites_beyond(network)
        network = with_places(network, places, cells.at(places))
    game = make_game(network, played)
    ground = CellSearch(cells, game) if holds_anywhere(options) else None
    try:
        return solve_game(game, options.strategy, ground, warm.on(network) if warm else None,
                          progress)
    except TimeLimit as late:
        if late.strategy is None:
            raise
        return _within_max_gap(late.strategy, late, options)


def _within_max_gap(strategy: Strategy, late: TimeLimit, options: PlanningOptions) -> Strategy:
    """The strategy if it is within ``max_gap``; raises TimeLimit if not."""
    gap = open_gap(strategy, options.strategy)
    if gap <= options.max_gap * strategy.value:
        return strategy
    raise TimeLimit(f'after {options.strategy.time_limit:g} s the strategy may be '
                    f'{gap / strategy.value:.2g} of its value from the best, more than max_gap '
                    f'{options.max_gap:g}; allow more time, or choose a larger spacing',
                    strategy) from late


def add_hiding_places(network: Network, risk_map: RiskMap, options: PlanningOptions,
                      played: GameOptions) -> Network:
    """Add the obstacle cells in which an ambusher can hide, if the ``played`` game has any."""
    if not played.ambush_in_obstacles or played.reach == 0.0:
        return network
    spacing = node_spacing(risk_map, options.network)
    return with_hiding_places(network, risk_map, played.reach, spacing)

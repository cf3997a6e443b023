# SPDX-License-Identifier: Apache-2.0
"""Solve the game of a plan; with a reach, against an ambusher anywhere on the ground."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray
from ..errors import TimeLimit
from ..game.game import Game, GameOptions, make_game
from ..game.revaluation import open_gap
from ..game.search import Search
from ..game.solver import find_value, finish, make_problem, solve_game
from ..game.strategy import Strategy
from ..game.value.routes import Progress, no_progress
from ..maps.risk_map import RiskMap
from ..network.hiding_places import with_hiding_places, with_places
from ..network.network import Network
from .cell_losses import CellLosses, CellSearch
from .options import PlanningOptions, holds_anywhere, node_spacing, solved_game


@dataclass(frozen=True, eq=False)
class WarmStart:
    """What another strategy, or another search, knows: where the ambusher waits between nodes.

    ``places`` (K, 2) are his sites without edges [m]; ``refined`` (K, 3) is that of the new
    network.
    """

    places: FloatArray
    refined: FloatArray

    @classmethod
    def of(cls, strategy: Strategy, refined: FloatArray | None = None) -> WarmStart:
        """Start from a strategy; by default its network's places are refined again."""
        network = strategy.network
        waits = strategy.ambush_probability[network.representatives] > 0.0
        waits[network.places[network.edges]] = False
        return cls(network.points[network.representatives[waits]],
                   network.refined if refined is None else refined)

    @classmethod
    def after(cls, search: Search, refined: FloatArray) -> WarmStart:
        """Start from a search on another network."""
        added = np.flatnonzero(search.lp.q > 0.0)
        added = added[added >= len(search.game.sites)]
        return cls(search.points[added], refined)

    def sites_beyond(self, network: Network) -> FloatArray:
        """Positions (K, 2) of the places at which another network has no node [m]."""
        away = cKDTree(network.points).query(self.places)[0] if len(self.places) else np.zeros(0)
        return self.places[away > 0.0]


def solve_on_network(risk_map: RiskMap, network: Network, options: PlanningOptions,
                     warm: WarmStart | None = None, progress: Progress = no_progress) -> Strategy:
    """Solve the game on a network built on the map.

    With a reach, an ambusher may wait anywhere on the ground (``holds_anywhere``): the places that
    matter are added to the network as nodes without edges. At the time limit, the best strategy is
    returned if it is within ``max_gap``. Raises the errors of ``solve``.
    """
    game, site_search = _played(risk_map, network, options, warm)
    try:
        return solve_game(game, options.strategy, site_search, progress)
    except TimeLimit as late:
        return _within_max_gap(late, options)


def find_value_on(risk_map: RiskMap, network: Network, options: PlanningOptions,
                  warm: WarmStart | None = None, progress: Progress = no_progress) -> Search:
    """The first half of ``solve_on_network``: the value, and where the ambusher waits."""
    game, site_search = _played(risk_map, network, options, warm)
    return find_value(make_problem(game, options.strategy, site_search, progress))


def finish_on(search: Search, options: PlanningOptions, end: float) -> Strategy:
    """The second half of ``solve_on_network``, which ends at ``end`` (``time.monotonic``)."""
    try:
        return finish(search, options.strategy, end)
    except TimeLimit as late:
        return _within_max_gap(late, options)


def with_time(options: PlanningOptions, end: float) -> PlanningOptions:
    """The options with the time limit at ``end`` (``time.monotonic``), or next to nothing."""
    left = max(end - time.monotonic(), 1e-6)
    return replace(options, strategy=replace(options.strategy, time_limit=left))


def _played(risk_map: RiskMap, network: Network, options: PlanningOptions,
            warm: WarmStart | None) -> tuple[Game, CellSearch | None]:
    """The game on a network, and the search for sites between its nodes."""
    cells = CellLosses(risk_map, options.game.ambush_in_obstacles)
    played = solved_game(risk_map, options)
    network = add_hiding_places(network, risk_map, options, played)
    if warm:
        places = warm.sites_beyond(network)
        network = with_places(network, places, cells.at(places))
    game = make_game(network, played)
    return game, CellSearch(cells, game) if holds_anywhere(options) else None


def _within_max_gap(late: TimeLimit, options: PlanningOptions) -> Strategy:
    """The best strategy by the time limit if it is within ``max_gap``; raises TimeLimit if not."""
    strategy = late.strategy
    if strategy is None:
        raise late
    gap = open_gap(strategy, options.strategy)
    if gap <= options.max_gap * strategy.value:
        return strategy
    raise TimeLimit(f'after {options.strategy.time_limit:.3g} s the strategy may be '
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

# SPDX-License-Identifier: Apache-2.0
"""Solve the game of a plan; with a reach, against ambushes anywhere on the ground."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray
from ..game.game import Game, GameOptions, make_games
from ..game.search import Search
from ..game.solver import finish, finish_flow, make_problem, search_ends, solve_legs
from ..game.strategy import TripStrategy
from ..game.value_search import find_value, tighten
from ..maps.risk_map import RiskMap
from ..network.hiding_places import hiding_places, with_places
from ..network.network import Network
from .cell_losses import CellLosses, CellSearch
from .options import PlanningOptions, holds_anywhere, node_spacing, solved_game


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Sites and value of an earlier solve, with which a new one starts.

    ``places`` (K, 2) are sites of its ambusher between the nodes [m]; ``value`` is its value.
    ``refined`` (K, 3) belongs to the new network (``Network.refined``).
    """

    places: FloatArray
    refined: FloatArray | None
    value: float = np.inf

    @classmethod
    def of(cls, trip: TripStrategy, refined: FloatArray | None = None) -> WarmStart:
        """Start from a strategy; by default with the refinement of its network."""
        network = trip.game.network
        sites = trip.ambusher.q > 0.0
        for leg in trip.legs:
            sites[leg.network.edges] = False
        refined = network.refined if refined is None else refined
        return cls(network.points[sites], refined, trip.value)

    @classmethod
    def after(cls, search: Search, refined: FloatArray) -> WarmStart:
        """Start from a search on another network."""
        added = np.flatnonzero(search.program.ambush.q > 0.0)
        added = added[added >= len(search.legs.loss)]
        return cls(search.points[added], refined, search.program.value)

    def new_places(self, network: Network) -> FloatArray:
        """Return the places (K, 2) at which a network has no node [m]."""
        distance = (cKDTree(network.points).query(self.places)[0] if len(self.places)
                    else np.zeros(0))
        return self.places[distance > 0.0]


@dataclass(frozen=True, eq=False)
class Ground:
    """Map and options of a plan, with the losses of ambushes at the map's cells."""

    risk_map: RiskMap
    options: PlanningOptions
    cells: CellLosses

    @classmethod
    def of(cls, risk_map: RiskMap, options: PlanningOptions) -> Ground:
        """Make the ground of a plan with these options."""
        return cls(risk_map, options, CellLosses(risk_map, options.game.ambush_in_obstacles))

    def solve(self, networks: Sequence[Network], end: float,
              warm: WarmStart | None = None) -> TripStrategy:
        """Solve the game on the networks of a trip's legs by ``end`` (``time.monotonic``).

        With a reach, an ambusher may wait anywhere on the ground (``holds_anywhere``): violated
        sites are added to the networks as nodes without edges. Raises the errors of
        ``solve_legs``.
        """
        options = replace(self.options.strategy, time_limit=time_left(end))
        games, site_search = self.make_games(networks, warm)
        return solve_legs(games, options, site_search)

    def find_value(self, networks: Sequence[Network], end: float,
                   warm: WarmStart | None = None) -> Search:
        """Run the first stages of ``solve``, to a rough precision: value and sites."""
        options = replace(self.options.strategy, time_limit=time_left(end))
        games, site_search = self.make_games(networks, warm)
        return find_value(make_problem(games, options, site_search,
                                       warm.value if warm else np.inf), rough=True)

    def compare(self, networks: Sequence[Network], end: float,
                warm: WarmStart | None = None) -> TripStrategy:
        """Find strategies of nearly the least value, of any entropy: faster than ``solve``."""
        return finish_flow(self.find_value(networks, end, warm))

    def finish(self, search: Search, end: float) -> TripStrategy:
        """Run the last stages of ``solve`` on a search by ``find_value``."""
        search.move_deadlines(*search_ends(end, time_left(end)))
        tighten(search)
        return finish(search)

    def make_games(self, networks: Sequence[Network], warm: WarmStart | None
                   ) -> tuple[tuple[Game, ...], CellSearch | None]:
        """Make the games on the networks, and the search for sites between their nodes."""
        game = solved_game(self.risk_map, self.options)
        networks = add_hiding_places(networks, self.risk_map, self.options, game)
        if warm:
            places = warm.new_places(networks[0])
            losses = self.cells.losses_at(places)
            networks = [with_places(each, places, losses) for each in networks]
        games = make_games(networks, game)
        return games, CellSearch(self.cells, games) if holds_anywhere(self.options) else None


def time_left(end: float) -> float:
    """Return the time until ``end`` (``time.monotonic``) [s], always positive."""
    return max(end - time.monotonic(), 1e-6)


def add_hiding_places(networks: Sequence[Network], risk_map: RiskMap, options: PlanningOptions,
                      game: GameOptions) -> list[Network]:
    """Add the obstacle cells in which an ambusher can hide as nodes, if the game has any."""
    if not game.ambush_in_obstacles or game.reach == 0.0:
        return list(networks)
    spacing = node_spacing(risk_map, options.network)
    places, loss = hiding_places(networks, risk_map, game.reach, spacing)
    return [with_places(each, places, loss) for each in networks]

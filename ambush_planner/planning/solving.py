"""Solve the game of a plan; with a reach, against an ambusher at any cell of the map."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray, frozen_array
from ..errors import TimeLimit
from ..game.certificate import certify
from ..game.game import Game, GameOptions, make_game
from ..game.hits import worst_loss
from ..game.limit_rows import Multipliers
from ..game.revaluation import open_gap
from ..game.strategy import (
    CERTIFICATE_TOLERANCE,
    Strategy,
    StrategyOptions,
    make_budgets,
    solve,
)
from ..maps.risk_map import RiskMap
from ..network.hiding_places import with_hiding_places, with_places
from ..network.network import Network
from .cell_losses import CellLosses
from .options import PlanningOptions, node_spacing, solved_game

# Most solves with the cells as sites that cost the strategy before more than its value.
_MOST_REPETITIONS = 8
# Share of the slack that is left to cells which exceed the value at the sites.
_LEFT_TO_CELLS = 0.2
# Side of the squares of which the worst cell becomes a site, in node spacings.
_SQUARE = 0.5


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Another strategy to start from: its network and its multipliers."""

    network: Network
    multipliers: Multipliers

    def on(self, network: Network) -> Multipliers:
        """The multipliers for another network: each site's from the nearest node."""
        points = self.network.points
        if np.array_equal(points, network.points):
            return self.multipliers
        _, nearest = cKDTree(points).query(network.points)
        sites = frozen_array(self.multipliers.sites[nearest], np.float64)
        return Multipliers(sites, self.multipliers.budgets)

    def sites_beyond(self, network: Network) -> FloatArray:
        """Positions (K, 2) of binding sites without edges that another network lacks [m]."""
        own = self.network
        binding = self.multipliers.sites[own.representatives] > 0.0
        binding[own.places[own.edges]] = False
        places = np.unique(own.points[own.representatives[binding]], axis=0)
        return np.asarray(places[cKDTree(network.points).query(places)[0] > 0.0])


def solve_on_network(risk_map: RiskMap, network: Network, options: PlanningOptions,
                     warm: WarmStart | None = None) -> Strategy:
    """Solve the game on a network built on the map.

    With a reach, cells that cost the strategy more than its value are added to the network as nodes
    without edges, and the game is solved again; the value then holds for all cells
    (``holds_anywhere``). At the time limit, the best strategy is returned if it is within
    ``max_gap``. Raises the errors of ``solve``.
    """
    network = add_hiding_places(network, risk_map, options)
    game, until = solved_game(risk_map, options), time.monotonic() + options.strategy.time_limit
    cells = CellLosses(risk_map, options.game.ambush_in_obstacles)
    if warm:
        places = warm.sites_beyond(network)
        network = with_places(network, places, cells.at(places))
    start = warm.on(network) if warm else None
    anywhere = holds_anywhere(game, options)
    slack = options.strategy.risk_slack * (1.0 - _LEFT_TO_CELLS * anywhere)
    asked = replace(options.strategy, risk_slack=slack)
    strategy, late = _solved(network, game, asked, until, start)
    if not anywhere:
        return _within_max_gap(strategy, late, options)
    square = _SQUARE * node_spacing(risk_map, options.network)
    found: list[Strategy] = []
    for repetitions in range(_MOST_REPETITIONS + 1):
        worst = cells.worst(strategy.game, strategy.edge_probability, strategy.value, square)
        found.append(_valued(strategy, worst.points[:1], worst.alpha[:1], options))
        most = max(_limit(strategy, options), strategy.value)
        if late or found[-1].value <= most or repetitions == _MOST_REPETITIONS:
            break
        added = with_places(strategy.network, worst.points, worst.alpha)
        start = _extended(strategy, len(worst.alpha))
        try:
            strategy, late = _solved(added, game, asked, until, start)
        except TimeLimit as error:
            late = error
    best = min(found, key=lambda each: each.value)
    proof = max(found, key=lambda each: each.lower_bound)
    if proof is not best:
        best = _proved_by(best, proof, options)
    return _within_max_gap(best, late, options)


def holds_anywhere(game: Game | GameOptions, options: PlanningOptions) -> bool:
    """Whether a plan's value holds for an ambusher at any cell of the map, not only at its sites.

    Several ambushers could surround one cell, and cyclic strategies have no hit probabilities.
    """
    return game.reach > 0.0 and game.ambushers == 1 and options.strategy.solver == 'max_entropy'


def _solved(network: Network, game: GameOptions, options: StrategyOptions, until: float,
            start: Multipliers | None) -> tuple[Strategy, TimeLimit | None]:
    """The strategy, and the error if time ran out; raises the error if there is no strategy."""
    left = max(until - time.monotonic(), 1e-3)
    try:
        return solve(network, game, replace(options, time_limit=left), start), None
    except TimeLimit as late:
        if late.strategy is None:
            raise
        return late.strategy, late


def _within_max_gap(strategy: Strategy, late: TimeLimit | None,
                    options: PlanningOptions) -> Strategy:
    """The strategy if it was solved in time or is within ``max_gap``; raises TimeLimit if not."""
    gap = open_gap(strategy, options.strategy)
    if late is None or gap <= options.max_gap * strategy.value:
        return strategy
    raise TimeLimit(f'after {options.strategy.time_limit:g} s the strategy may be '
                    f'{gap / strategy.value:.2g} of its value from the best, more than max_gap '
                    f'{options.max_gap:g}; allow more time, or choose a larger spacing',
                    strategy) from late


def _valued(strategy: Strategy, points: FloatArray, alpha: FloatArray,
            options: PlanningOptions) -> Strategy:
    """The strategy with more sites (K, 2) and their losses (K,), which may raise its value.

    Its lower bound holds all the same: more sites cannot help the convoy.
    """
    limit = _limit(strategy, options)
    if not len(alpha):
        return replace(strategy, counting_gap=strategy.counting_gap and strategy.value > limit)
    network = with_places(strategy.network, points, alpha)
    game = make_game(network, strategy.game.options)
    p, none = strategy.edge_probability, np.zeros(len(alpha))
    value = worst_loss(game, p)
    return replace(
        strategy, game=game, value=value, gap=value - strategy.lower_bound,
        visit_probability=frozen_array(game.visits(p), np.float64),
        ambush_probability=frozen_array(
            np.append(strategy.ambush_probability, none), np.float64),
        multipliers=_extended(strategy, len(alpha)),
        counting_gap=value > limit and (strategy.counting_gap or strategy.value <= limit),
    )


def _proved_by(strategy: Strategy, proof: Strategy, options: PlanningOptions) -> Strategy:
    """The strategy with the ambusher and the bound of another one, on the game with more sites.

    Their edges are the same, and the nodes of the one are the first nodes of the other.
    """
    count = len(proof.network.points) - len(strategy.network.points)
    p, larger = strategy.edge_probability, proof if count > 0 else strategy
    q = np.append(proof.ambush_probability, np.zeros(max(-count, 0)))
    prices = proof.length_price, proof.exposure_price
    # The bound also depends on how far rounding puts p over its budgets.
    budgets = make_budgets(larger.game, options.strategy)
    certificate = certify(larger.game, p, q, budgets, prices)
    proved = replace(
        strategy, game=larger.game, value=certificate.value, lower_bound=certificate.bound,
        gap=certificate.value - certificate.bound, length_price=prices[0],
        exposure_price=prices[1],
        visit_probability=frozen_array(larger.game.visits(p), np.float64),
        ambush_probability=frozen_array(q, np.float64),
        multipliers=_extended(strategy, max(count, 0)),
    )
    return replace(proved, counting_gap=proved.counting_gap
                   and proved.value > _limit(proved, options))


def _limit(strategy: Strategy, options: PlanningOptions) -> float:
    """The largest value within the slack of the strategy's bound."""
    return strategy.lower_bound * (1.0 + options.strategy.risk_slack + CERTIFICATE_TOLERANCE)


def _extended(strategy: Strategy, count: int) -> Multipliers | None:
    """The strategy's multipliers with ``count`` more nodes."""
    found = strategy.multipliers
    if found is None:
        return None
    sites = np.append(found.sites, np.zeros(count))
    return Multipliers(frozen_array(sites, np.float64), found.budgets)


def add_hiding_places(network: Network, risk_map: RiskMap, options: PlanningOptions) -> Network:
    """Add the obstacle cells in which an ambusher can hide, if the game includes them."""
    radius = solved_game(risk_map, options).reach
    if not options.game.ambush_in_obstacles or radius == 0.0:
        return network
    spacing = node_spacing(risk_map, options.network)
    return with_hiding_places(network, risk_map, radius, spacing)

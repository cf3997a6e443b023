"""The problems that are timed, by name: ``block:200``, ``reach-hills:52``, ``city:1.1``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from maps import SIDE, block, block_network, hills, network_across

from ambush_planner import GameOptions, Network, NetworkOptions, StrategyOptions, build_network

# Reach of an ambush, in spacings of the nodes.
REACH = 4.0
# As the demo has it: four cells, about 6700 nodes; and as many nodes in the city as are asked for.
TERRAIN_SPACING, TERRAIN_SECURED, CITY_NODES = 360.0, 2000.0, 7500


@dataclass(frozen=True)
class Problem:
    """How the network is made, and the options; those that are not told have their defaults."""

    network: Callable[[], Network]
    game: GameOptions
    options: StrategyOptions


def problem(name: str) -> Problem:
    """``block:N`` and ``reach-block:N``, ``reach-hills:N`` N nodes across; ``terrain:D``,
    ``city:D`` with max_detour D."""
    kind, _, number = name.partition(':')
    if kind == 'block':
        return Problem(lambda: block_network(int(number)), GameOptions(), StrategyOptions())
    if kind.startswith('reach-'):
        risk_map = {'block': block, 'hills': hills}[kind.removeprefix('reach-')](100)
        game = GameOptions(ambush_radius=REACH * SIDE / int(number))
        return Problem(lambda: network_across(risk_map, int(number)), game, StrategyOptions())
    return _on_ground(kind, StrategyOptions(max_detour=float(number)))


def _on_ground(name: str, options: StrategyOptions) -> Problem:
    from grounds import GROUNDS  # matplotlib's terrain is in the memory of those alone

    place = GROUNDS[name]()
    lay, game = NetworkOptions(target_nodes=CITY_NODES), GameOptions()
    if name == 'terrain':
        lay = NetworkOptions(spacing=TERRAIN_SPACING)
        game = GameOptions(secured_radius=TERRAIN_SECURED)
    return Problem(
        lambda: build_network(place.risk_map, place.start, place.goal, lay), game, options
    )

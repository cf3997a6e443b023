"""The attachment ``strategy.npz``: a strategy with its network, written, read back and checked."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np

from ..arrays import frozen_array
from ..errors import AmbushPlannerError
from ..game.budget import Budget
from ..game.game import Game, GameOptions, make_game
from ..game.strategy import Strategy, strategy_from_solution
from ..game.strategy_solver import Multipliers, Solution
from ..network.network import Network
from .npz import BadAttachment, Shape, packed, unpacked

STRATEGY_FILE = 'strategy.npz'
NUMBERS = (
    'value', 'lower_bound', 'length_budget', 'length_price', 'shortest_length',
    'expected_length', 'expected_exposure', 'least_exposure', 'exposure_budget', 'exposure_price',
    'edge_entropy', 'route_entropy',
)
# Of numbers that have to be the same but for rounding, relative.
VALUE_TOLERANCE = 1e-9
_BUDGETS = ('length_budget', 'exposure_budget')
# How far an ambush reaches in the game that was solved [m]: with the tube of the driven path.
_REACH = 'reach'
# What the search for the law started from, if not from nothing: the multipliers of the sites
# (N,), then of the budgets.
_START = 'start'
_ARRAYS: dict[str, tuple[type, Shape]] = {
    'points': (np.float64, ('nodes', 2)),
    'alpha': (np.float64, ('nodes',)),
    'ambush_probability': (np.float64, ('nodes',)),
    'edges': (np.int64, ('edges', 2)),
    'edge_probability': (np.float64, ('edges',)),
    _START: (np.float64, ('multipliers',)),
    **dict.fromkeys(('source', 'target', 'legs'), (np.int64, ())),
    **dict.fromkeys((*NUMBERS, _REACH), (np.float64, ())),
}
# Lattices join a node with eight others at most, triangulations with six on average.
_MOST_EDGES_OF_A_NODE = 8
# What a network of a million nodes takes (the most that network.target_nodes asks for): 224
# bytes a node with its edges.
_MOST_BYTES = 2**28
# What any file may unpack to, and otherwise as a multiple of its size: no two edges are the
# same, so that even an empty lattice is packed 13 times only.
_ALWAYS_UNPACKED = 2**24
_MOST_PACKED = 40


def strategy_file(strategy: Strategy) -> bytes:
    """Return the strategy and its network as an npz file."""
    network, start = strategy.network, None
    return packed({
        **{name: getattr(network, name) for name in ('points', 'alpha', 'edges')},
        **{name: np.int64(getattr(network, name)) for name in ('source', 'target', 'legs')},
        'edge_probability': strategy.edge_probability,
        'ambush_probability': strategy.ambush_probability,
        **{name: np.float64(getattr(strategy, name)) for name in NUMBERS},
        _START: np.empty(0) if start is None else np.append(start.sites, start.budgets),
        _REACH: np.float64(strategy.game.ambush_radius),
    })


def strategy_from_file(data: bytes, options: GameOptions) -> Strategy:
    """Return the strategy in the bytes of a ``strategy.npz``, for the game with these options.

    All that follows from the probabilities is computed again, the certificate too, and must be
    what the file states. Iterations and law are not in the file and come back as 0 and None.

    Raises
    ------
    BadAttachment
        An array is missing or of the wrong shape, a number is not finite, the probabilities are
        no strategy, or a stated number does not follow from them.
    """
    content = arrays_of(data)
    try:
        with warnings.catch_warnings():
            # Edges that the network drops are found by the shape of the probabilities.
            warnings.simplefilter('ignore', UserWarning)
            network = Network(
                content['points'], content['alpha'], content['edges'],
                int(content['source']), int(content['target']),
                legs=int(content['legs']),
            )
        game = make_game(network, replace(options, ambush_radius=float(content[_REACH])))
        if len(network.edges) != len(content['edges']):
            raise BadAttachment('it has edges that no network has')
        strategy = _strategy(game, content)
    except AmbushPlannerError as error:
        raise BadAttachment(str(error)) from error
    _compare(strategy, content)
    return strategy


def arrays_of(data: bytes) -> dict[str, np.ndarray]:
    """Return the arrays in the bytes of a ``strategy.npz``, checked for form and range only.

    Raises
    ------
    BadAttachment
        An array is missing, of the wrong shape, or would take more memory than any strategy.
    """
    most = min(_MOST_BYTES, max(_ALWAYS_UNPACKED, _MOST_PACKED * len(data)))
    content = unpacked(data, STRATEGY_FILE, _ARRAYS, most)
    nodes, edges = len(content['points']), len(content['edges'])
    if edges > _MOST_EDGES_OF_A_NODE * nodes:
        raise BadAttachment(f'{nodes} points cannot have {edges} edges')
    for name in (*NUMBERS, _REACH):
        number = float(content[name])
        if math.isnan(number) or (name not in _BUDGETS and math.isinf(number)):
            raise BadAttachment(f'{name} is not a finite number')
    if len(content[_START]) not in (0, nodes + len(_BUDGETS)):
        raise BadAttachment(f'{_START} has {len(content[_START])} multipliers')
    for name in ('edge_probability', 'ambush_probability', _START):
        if not (np.isfinite(content[name]) & (content[name] >= 0.0)).all():
            raise BadAttachment(f'{name} must be finite and >= 0')
    return content


def _strategy(game: Game, content: dict[str, np.ndarray]) -> Strategy:
    network = game.network
    p = frozen_array(content['edge_probability'], np.float64)
    q = frozen_array(content['ambush_probability'], np.float64)
    stated = {name: float(content[name]) for name in NUMBERS}
    budgets = (
        Budget(game, network.lengths, stated['length_budget'], stated['shortest_length'],
               'detour', 'm'),
        Budget(game, network.edge_exposure, stated['exposure_budget'], stated['least_exposure'],
               'exposure', 'loss x m'),
    )
    prices = stated['length_price'], stated['exposure_price']
    return strategy_from_solution(game, Solution(p, q, prices, 0), budgets)


def _start(content: dict[str, np.ndarray]) -> Multipliers | None:
    sites, budgets = np.split(frozen_array(content[_START], np.float64), [len(content['points'])])
    return Multipliers(sites, tuple(budgets.tolist())) if len(sites) else None


def _compare(strategy: Strategy, content: dict[str, np.ndarray]) -> None:
    # The route entropy is a difference of two numbers of the edge entropy's size.
    rounding = VALUE_TOLERANCE * abs(strategy.edge_entropy)
    for name in NUMBERS:
        stated, computed = float(content[name]), float(getattr(strategy, name))
        least = rounding if name == 'route_entropy' else 1e-12
        if not math.isclose(stated, computed, rel_tol=VALUE_TOLERANCE, abs_tol=least):
            raise BadAttachment(
                f'{name} is stated as {stated:.12g}, the probabilities give {computed:.12g}'
            )

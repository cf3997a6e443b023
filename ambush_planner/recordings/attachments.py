# SPDX-License-Identifier: Apache-2.0
"""The attachments of a recording, npz files.

``strategy.npz`` holds the strategy with its network, ``map_changes.npz`` the cells that changed
since the departure was planned, ``roads.npz`` the roads of the method graph in the map's
coordinates. Of plans that were made without ROS, ``map.npz`` holds the risk map, and ``few.npz``
the few routes that departures draw from, if they do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from io import BytesIO
from typing import Any, cast, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import ROUNDING, arrays_in, frozen_array
from ..game.ambusher import Ambusher
from ..game.budget import Budget
from ..game.certificate.certificate import lower_bound
from ..game.faces import Circulation
from ..game.game import GameOptions, make_game
from ..game.slack import Reason
from ..game.strategy import Strategy, strategy_of
from ..maps.road_file import RoadGraph
from ..network.network import Network
from ..planning.few_routes import FewRoutes

STRATEGY_FILE, MAP_CHANGES_FILE, ROADS_FILE = 'strategy.npz', 'map_changes.npz', 'roads.npz'
MAP_FILE, FEW_FILE = 'map.npz', 'few.npz'
NUMBERS = (
    'value', 'lower_bound', 'length_budget', 'length_price', 'shortest_length',
    'expected_length', 'expected_exposure', 'least_exposure', 'edge_entropy', 'route_entropy',
)
# Rounding between releases of numpy and scipy, relative and absolute.
_SAME = 1e-9
_NETWORK = ('points', 'alpha', 'edges', 'source', 'target', 'places', 'leg', 'refined')
# Of networks with driving times, or with lengths over the ground.
_ON_ROADS = ('seconds', 'ground_length')
_PROBABILITIES = ('edge_probability', 'ambush_probability')
# What a plan adds to the game's options [m]: tube, what a site stands for, the secured area.
_PLANNED = {'tube': 'tube', 'widened': 'widened', 'secured_radius': 'secured_distance'}
# For which leg the ambusher waits at each site, on trips.
_BY_LEG = 'by_leg'
# The flows of the ambusher's circulation, if he has one.
_CIRCULATION = ('through', 'site', 'face', 'flow')
_ROADS = ('points', 'pairs', 'speeds', 'timed', 'names', 'name', 'places')
# The lists of arrays of few routes.
_RAGGED = ('paths', 'routes')
_FEW = (*_RAGGED, *(f'{name}_counts' for name in _RAGGED), 'shares', 'value', 'worst_xy',
        'lower_bound', 'candidates', 'costs', 'curve')
# Why the search ended.
_REASON = 'reason'


def strategy_file(strategy: Strategy) -> bytes:
    """Return the strategy and its network as an npz file."""
    network, ambusher = strategy.network, strategy.ambusher
    arrays: dict[str, Any] = {
        **{name: getattr(network, name) for name in (*_NETWORK, *_ON_ROADS)},
        **{name: getattr(strategy, name) for name in (*_PROBABILITIES, *NUMBERS)},
        **{name: getattr(strategy.game.options, each) for name, each in _PLANNED.items()},
        _BY_LEG: ambusher.by_leg, _REASON: strategy.reason,
    }
    if ambusher.circulation is not None:
        arrays |= {name: getattr(ambusher.circulation, name) for name in _CIRCULATION}
    return _npz({name: array for name, array in arrays.items() if array is not None})


def strategy_from_file(data: bytes, options: GameOptions) -> tuple[Strategy, Mapping[str, float]]:
    """Return the strategy in the bytes of a ``strategy.npz``, and the numbers stated there.

    ``options`` are the game's. Everything that follows from the probabilities, including the
    certificate, is computed from them; the stated ``NUMBERS`` are for comparison. Iterations are
    not recorded.
    """
    content = arrays_in(BytesIO(data), (*_NETWORK, *_ON_ROADS, *_PROBABILITIES, *NUMBERS,
                                        *_PLANNED, *_CIRCULATION, _BY_LEG, _REASON))
    ground_length = content.get('ground_length')
    network = Network(content['points'], content['alpha'], content['edges'], int(content['source']),
                      int(content['target']), content['places'], content['leg'],
                      content.get('seconds'), content['refined'],
                      None if ground_length is None else float(ground_length))
    planned: dict[str, Any] = {name: float(content[name]) for name in _PLANNED}
    game = make_game(network, replace(options, **planned))
    stated = {name: float(content[name]) for name in NUMBERS}
    p, q = (frozen_array(content[name], np.float64) for name in _PROBABILITIES)
    if len(p) != len(network.edges) or not ((p >= 0.0).all() and (q >= 0.0).all()):
        raise ValueError('its probabilities are not those of its network')
    budget = replace(Budget.length(game, math.inf), limit=stated['length_budget'])
    circulation = Circulation(*(content[name] for name in _CIRCULATION)) if (
        _CIRCULATION[0] in content) else None
    ambusher = Ambusher(q, stated['length_price'],
                        content.get(_BY_LEG), circulation)
    # A bound of what was stated is enough: a larger one can take seconds.
    enough = (1.0 - ROUNDING / 10.0) * stated['lower_bound']
    bound = lower_bound(game, ambusher, budget, enough=enough)
    strategy = strategy_of(game, p, ambusher, budget, bound)
    reason = str(content[_REASON])
    if reason not in get_args(Reason):
        raise ValueError(f'{reason!r} is no reason why a search ends')
    return replace(strategy, reason=cast(Reason, reason)), stated


def misstated(strategy: Strategy,
              stated: Mapping[str, float]) -> Iterator[tuple[str, float, float]]:
    """The ``NUMBERS`` that a strategy does not have: name, what is stated, what it has.

    A lower bound may be stated too low, as time may have limited the proof.
    """
    # The route entropy is a difference of two numbers of the edge entropy's size.
    rounding = _SAME * max(1e-3, abs(strategy.edge_entropy))
    for name in NUMBERS:
        found, said = getattr(strategy, name), stated[name]
        if not (math.isclose(said, found, rel_tol=_SAME, abs_tol=rounding)
                or (name == 'lower_bound' and said < found)):
            yield name, said, found


def map_changes_file(before: npt.NDArray[np.int8], after: npt.NDArray[np.int8]) -> bytes:
    """Return the cells in which two maps (H, W) differ; no bytes if they are equal.

    An npz file: ``cells`` (K,) = row * W + column, and their ``values`` (K,) afterwards.
    """
    cells = np.flatnonzero(before.ravel() != after.ravel()).astype(np.int32)
    if not len(cells):
        return b''
    return _npz({'cells': cells, 'values': after.ravel()[cells].astype(np.int8)})


def changed_map(before: npt.NDArray[np.int8], data: bytes) -> npt.NDArray[np.int8]:
    """Return the map (H, W) after the changes in the bytes of a ``map_changes.npz``."""
    after = before.ravel().copy()
    content = arrays_in(BytesIO(data), ('cells', 'values'))
    after[content['cells']] = content['values']
    return after.reshape(before.shape)


@lru_cache(4)
def roads_file(roads: RoadGraph) -> bytes:
    """Return roads as an npz file."""
    return _npz({name: getattr(roads, name) for name in _ROADS})


def roads_from_file(data: bytes | None) -> RoadGraph | None:
    """Return the roads in the bytes of a ``roads.npz``; None if there are none."""
    if data is None:
        return None
    content = arrays_in(BytesIO(data), _ROADS)
    named = (tuple(content['names'].tolist()), content['name'], content['places']) if (
        'names' in content) else ()  # older ones have none
    return RoadGraph(content['points'], content['pairs'], content['speeds'],
                     bool(content['timed']), '', *named)


def few_file(few: FewRoutes) -> bytes:
    """Return few routes as an npz file; the lengths of lists of arrays are in ``..._counts``."""
    arrays: dict[str, Any] = {}
    for name, value in vars(few).items():
        if name in _RAGGED:
            arrays[name], arrays[f'{name}_counts'] = np.concatenate(value), list(map(len, value))
        else:
            arrays[name] = value
    return _npz(arrays)


def few_from_file(data: bytes) -> FewRoutes:
    """Return the few routes in the bytes of a ``few.npz``."""
    content = arrays_in(BytesIO(data), _FEW)
    ragged = {name: tuple(np.split(content[name], np.cumsum(content[f'{name}_counts'])[:-1]))
              for name in _RAGGED}
    return FewRoutes(
        **ragged, shares=frozen_array(content['shares'], np.float64),
        value=float(content['value']), worst_xy=content['worst_xy'],
        lower_bound=float(content['lower_bound']), candidates=int(content['candidates']),
        costs=content['costs'],
        curve=tuple((int(k), value) for k, value in content['curve'].tolist()))


def _npz(arrays: Mapping[str, Any]) -> bytes:
    stream = BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()

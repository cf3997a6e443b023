# SPDX-License-Identifier: Apache-2.0
"""The attachments of a recording, npz files.

``strategy.npz`` holds the strategies of all legs with their networks, ``map_changes.npz`` the
cells that changed since the departure was planned, ``roads.npz`` the roads of the method graph in
the map's coordinates. Of plans that were made without ROS, ``map.npz`` holds the risk map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from io import BytesIO
from typing import Any, cast, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import ROUNDING, arrays_in, frozen_array
from ..game.ambusher import Ambusher
from ..game.budget import Budget
from ..game.certificate.certificate import lower_bounds
from ..game.distribution.chain import RouteMixture
from ..game.faces import Circulation
from ..game.game import GameOptions, make_games
from ..game.legs import Legs
from ..game.strategy import TripStrategy, make_strategies
from ..game.tolerance import Reason
from ..maps.road_file import RoadGraph
from ..network.network import Network

STRATEGY_FILE, MAP_CHANGES_FILE, ROADS_FILE = 'strategy.npz', 'map_changes.npz', 'roads.npz'
MAP_FILE = 'map.npz'
# What all legs have in common: nodes, where the ambusher waits, and the number of legs (before
# format 11 there was one).
_NODES, _Q, _LEGS = ('points', 'alpha'), 'ambush_probability', 'legs'
# Of graded networks.
_REFINED = 'refined'
# Of each leg. Names of a later leg end with its number, from 1.
_EDGES, _P = 'edges', 'edge_probability'
_NETWORK = (_EDGES, 'source', 'target')
# Of networks with driving times, or with lengths over the ground.
_ON_ROADS = ('seconds', 'ground_length')
_BUDGET = ('length_budget', 'shortest_length', 'length_price')
# The flows of the ambusher's circulation, if he has one.
_CIRCULATION = ('through', 'site', 'face', 'flow')
# The edges of whole routes, if these are drawn, how many each has, and their shares.
_MIXTURE = ('route_edges', 'route_counts', 'route_shares')
_OF_LEG = (*_NETWORK, _P, *_ON_ROADS, *_BUDGET, *_CIRCULATION, *_MIXTURE)
# What a leg loses at least against the ambusher; before format 11, of the only one.
_LEG_BOUNDS, _LOWER_BOUND = 'leg_bounds', 'lower_bound'
# What a plan adds to the game's options [m]: tube, what a site stands for, the secured area.
_PLANNED = {'tube': 'tube', 'widened': 'widened', 'secured_radius': 'secured_distance'}
# Why the search ended.
_REASON = 'reason'
_COMMON = (*_NODES, _Q, _LEGS, _REFINED, _LEG_BOUNDS, _LOWER_BOUND, *_PLANNED, _REASON)
_ROADS = ('points', 'pairs', 'speeds', 'timed', 'names', 'name', 'places')


def strategy_file(trip: TripStrategy) -> bytes:
    """Return the strategies of a trip's legs and their networks as an npz file."""
    network = trip.game.network
    arrays: dict[str, Any] = {
        **{name: getattr(network, name) for name in (*_NODES, _REFINED)},
        **{name: getattr(trip.game.options, each) for name, each in _PLANNED.items()},
        _Q: trip.ambusher.q, _LEGS: len(trip.legs), _REASON: trip.reason,
        _LEG_BOUNDS: [leg.lower_bound for leg in trip.legs],
    }
    for k, leg in enumerate(trip.legs):
        own = {**{name: getattr(leg.network, name) for name in (*_NETWORK, *_ON_ROADS)},
               **{name: getattr(leg, name) for name in (_P, *_BUDGET)}}
        # As differences from row to row, numbers of nodes take a tenth.
        own[_EDGES] = np.diff(leg.network.edges, axis=0, prepend=0).astype(np.int32)
        # Without a reach, a shortest path proves the bound (section 5 of docs/theory.md).
        for circulation in () if leg.game.no_reentry else leg.ambusher.circulations:
            own |= {name: getattr(circulation, name) for name in _CIRCULATION}
        if leg.mixture:
            routes = leg.mixture.routes
            own |= dict(zip(_MIXTURE, (np.concatenate(routes), list(map(len, routes)),
                                       leg.mixture.shares), strict=True))
        arrays |= {_named(name, k): array for name, array in own.items()}
    return _npz({name: array for name, array in arrays.items() if array is not None})


def _named(name: str, leg: int) -> str:
    return f'{name}_{leg}' if leg else name


def strategy_from_file(data: bytes, options: GameOptions) -> TripStrategy:
    """Return the strategies in the bytes of a ``strategy.npz``.

    ``options`` are the game's. Everything that follows from the probabilities, including the
    certificate, is computed from them.
    """
    common = arrays_in(BytesIO(data), _COMMON)
    own = [arrays_in(BytesIO(data), [_named(name, k) for name in _OF_LEG])
           for k in range(int(common.get(_LEGS, 1)))]
    content = [{name: each[_named(name, k)] for name in _OF_LEG if _named(name, k) in each}
               for k, each in enumerate(own)]
    reason = str(common[_REASON])
    if reason not in get_args(Reason):
        raise ValueError(f'{reason!r} is no reason why a search ends')
    networks = [_network_in(common, each) for each in content]
    planned: dict[str, Any] = {name: float(common[name]) for name in _PLANNED}
    q = frozen_array(common[_Q], np.float64)
    games = make_games(networks, replace(options, **planned), q > 0.0)
    budgets = [Budget(game, float(each[_BUDGET[0]]), float(each[_BUDGET[1]]))
               for game, each in zip(games, content, strict=True)]
    legs = Legs(games, tuple(budgets))
    p = [frozen_array(each[_P], np.float64) for each in content]
    if any(len(each) != len(network.edges) for each, network in zip(p, networks, strict=True)):
        raise ValueError('its probabilities are not those of its network')
    ambusher = Ambusher(q, tuple(float(each[_BUDGET[2]]) for each in content),
                        tuple(Circulation(*(each[name] for name in _CIRCULATION))
                              for each in content if _CIRCULATION[0] in each))
    # The bounds of the solve are enough: larger ones can take seconds.
    bounds = common[_LEG_BOUNDS if _LEG_BOUNDS in common else _LOWER_BOUND]
    enough = (1.0 - ROUNDING / 10.0) * np.atleast_1d(bounds)
    trip = make_strategies(legs, np.concatenate(p), [_mixture_in(each) for each in content],
                           ambusher, lower_bounds(legs, ambusher, targets=enough), reason=reason)
    return replace(trip, reason=cast(Reason, reason))


def _network_in(common: Mapping[str, Any], own: Mapping[str, Any]) -> Network:
    """The network of a leg."""
    length, edges = own.get('ground_length'), own[_EDGES]
    if _LEGS in common:  # earlier, they were written as they are
        edges = edges.cumsum(axis=0, dtype=np.int64)
    return Network(common['points'], common['alpha'], edges, int(own['source']),
                   int(own['target']), own.get('seconds'), common.get(_REFINED),
                   None if length is None else float(length))


def _mixture_in(own: Mapping[str, Any]) -> RouteMixture | None:
    """The whole routes of a leg, if such are drawn."""
    if _MIXTURE[0] not in own:
        return None
    edges, counts, shares = (own[name] for name in _MIXTURE)
    return RouteMixture(np.split(edges, np.cumsum(counts)[:-1]), shares,
                        np.zeros(len(counts), dtype=np.int64))


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


def _npz(arrays: Mapping[str, Any]) -> bytes:
    stream = BytesIO()
    # Column after column, points take half as much.
    columns: dict[str, Any] = {name: np.asarray(each, order='F') for name, each in arrays.items()}
    np.savez_compressed(stream, **columns)
    return stream.getvalue()

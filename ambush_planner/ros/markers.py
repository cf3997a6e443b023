# SPDX-License-Identifier: Apache-2.0
"""Markers of a strategy for RViz and Foxglove: one per topic, built from whole arrays.

Each function returns a serialised visualization_msgs/MarkerArray for a frame and a time [ns].
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IndexArray
from ..game.strategy import TripStrategy
from ..network.network import Network
from ..recordings.cdr import LINE_LIST, SPHERE_LIST, marker_array

# Minimum probability of edges and nodes that are drawn, and of sites relative to the likeliest one:
# others would be almost transparent.
_MIN_SHOWN = 1e-3
# Accuracy of positions, as a share of the edge length, and of colours: finer digits cannot be seen,
# and would double the size of a recording.
_ACCURACY, _LEVELS = 1.0 / 64.0, 128.0
# Height of a layer as a fraction of the network's extent, and its maximum [m]. In Foxglove, lines
# must lie below the path, which is at 0, and discs above the map.
_HEIGHT, _MAX_HEIGHT = 0.005, 50.0
_LAYERS = {'network': -3, 'edge_probabilities': -2, 'mean_direction': -1, 'ambush_sites': 1,
           'stops': 1}
_DISCS = ('ambush_sites', 'stops')
# Colours from rare to certain: the convoy in blues, the ambusher in oranges. Discs are not opaque,
# so that the path below them is visible.
_CONVOY = np.array([[0.55, 0.80, 1.00, 0.25], [0.25, 0.55, 1.00, 0.70], [0.00, 0.20, 1.00, 1.0]])
_AMBUSHER = np.array([[1.00, 0.70, 0.20, 0.35], [1.00, 0.50, 0.10, 0.70], [0.90, 0.30, 0.00, 0.9]])
_PLAIN_COLOURS = {'stops': (0.0, 0.2, 1.0, 0.9), 'network': (0.5, 0.5, 0.5, 0.4)}
_ONE_COLOUR = np.empty((0, 4), dtype=np.float32)


def edge_probabilities(trip: TripStrategy, frame: str, stamp_ns: int) -> bytes:
    """Return a line list of the edges in use, coloured by the square root of their probability.

    The root keeps the many edges in the middle visible compared with the few at the ends. Of a trip
    with stops, the uses by all legs.
    """
    network, (edges, uses) = trip.game.network, trip.ground_uses
    shown = np.flatnonzero(uses >= _MIN_SHOWN)
    colours = _colours(_CONVOY, np.repeat(np.sqrt(np.minimum(uses[shown], 1.0)), 2))
    return _marker('edge_probabilities', frame, stamp_ns, network, 0.12,
                   network.points[edges[shown].ravel()], colours)


def mean_direction(trip: TripStrategy, frame: str, stamp_ns: int) -> bytes:
    """Return a line list with an arrow per node: the average direction of convoys from there.

    The length shows how certain the direction is, the colour how often the node is visited. Each
    leg has arrows of its own.
    """
    network, arrows, often = trip.game.network, [], []
    for leg in trip.legs:
        x, direction = leg.visit_probability, leg.mean_direction()
        shown = np.flatnonzero((x >= _MIN_SHOWN) & (np.hypot(*direction.T) > 1e-6))
        arrows.append(_arrows(network.points[shown],
                              0.8 * _edge_length(network) * direction[shown]))
        often.append(x[shown])
    colours = _colours(_CONVOY, np.repeat(np.sqrt(np.concatenate(often)), 6))
    return _marker('mean_direction', frame, stamp_ns, network, 0.06, np.concatenate(arrows),
                   colours)


def ambush_sites(trip: TripStrategy, frame: str, stamp_ns: int) -> bytes:
    """Return a list of flat discs at the ambush sites, coloured by their probability.

    Discs have the ambush radius, if it is not 0. If no ambush causes a loss, the list is empty.
    """
    network, q = trip.game.network, trip.ambusher.q
    often = float(q.max())
    shown = np.flatnonzero((q >= _MIN_SHOWN * often) & (trip.value > 0.0))
    diameter = 2.0 * trip.game.reach / _edge_length(network) or 0.6
    return _marker('ambush_sites', frame, stamp_ns, network, diameter, network.points[shown],
                   _colours(_AMBUSHER, q[shown] / often))


def stops(trip: TripStrategy, frame: str, stamp_ns: int) -> bytes:
    """Return a list of flat discs at the stops."""
    network, begins = trip.game.network, [leg.network.source for leg in trip.legs[1:]]
    return _marker('stops', frame, stamp_ns, network, 1.0,
                   network.points[np.array(begins, dtype=np.int64)])


def network_lines(trip: TripStrategy, frame: str, stamp_ns: int) -> bytes:
    """Return a grey line list of all edges, with opposite edges drawn once."""
    network, (edges, _) = trip.game.network, trip.ground_uses
    return _marker('network', frame, stamp_ns, network, 0.03,
                   network.points[_pairs(edges, len(network.points)).ravel()])


# What draws the marker of each topic, by its name below the node's.
MARKERS = {'network': network_lines, 'edge_probabilities': edge_probabilities,
           'mean_direction': mean_direction, 'ambush_sites': ambush_sites, 'stops': stops}


def _marker(namespace: str, frame: str, stamp_ns: int, network: Network, size: float,
            points: FloatArray, colours: npt.NDArray[np.float32] = _ONE_COLOUR) -> bytes:
    """Return lines of a width, or discs of a diameter, in edge lengths.

    Without points it deletes an earlier marker.
    """
    length, extent = _edge_length(network), float(np.ptp(network.points, axis=0).max())
    discs, width = namespace in _DISCS, size * length
    height = _LAYERS[namespace] * min(_HEIGHT * extent, _MAX_HEIGHT)
    scale = (width, width, 0.1 * length) if discs else (width, 0.0, 0.0)
    unit = 2.0 ** math.floor(math.log2(_ACCURACY * length))  # so that the last bits are 0
    return marker_array(frame, stamp_ns, namespace, SPHERE_LIST if discs else LINE_LIST, height,
                        scale, _PLAIN_COLOURS.get(namespace, (0.0,) * 4),
                        np.rint(points / unit) * unit, np.rint(colours * _LEVELS) / _LEVELS)


def _edge_length(network: Network) -> float:
    """Return the median length of edges [m], to which sizes are relative."""
    return float(np.median(network.lengths))


def _pairs(edges: IndexArray, count: int) -> IndexArray:
    """Return the connected nodes (K, 2) of edges (M, 2) between ``count``, each pair once."""
    tails, heads = edges.T
    # One number per pair: np.unique over rows takes 8 times as long.
    keys = np.unique(np.minimum(tails, heads) * count + np.maximum(tails, heads))
    return np.stack(np.divmod(keys, count), axis=1)


def _colours(ramp: FloatArray, shares: FloatArray) -> npt.NDArray[np.float32]:
    """Return a colour (K, 4) of the ramp for each share (K,) in 0..1."""
    at = np.linspace(0.0, 1.0, len(ramp))
    channels = [np.interp(shares, at, channel) for channel in ramp.T]
    return np.stack(channels, axis=1).astype(np.float32)


def _arrows(tails: FloatArray, shafts: FloatArray) -> FloatArray:
    """Return the ends (6 * K, 2) of the three strokes of each arrow."""
    tips = tails + shafts
    across = np.stack((-shafts[:, 1], shafts[:, 0]), axis=1)
    left, right = (tips - 0.3 * shafts + 0.15 * side * across for side in (1.0, -1.0))
    return np.stack((tails, tips, tips, left, tips, right), axis=1).reshape(-1, 2)

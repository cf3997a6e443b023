"""What is measured on paths (L, 3) = (x, y, yaw): length, turning, hairpins, closeness, and whether
Nav2 would take them; and the least that can be had of some of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array, vstack
from scipy.spatial import cKDTree

from ambush_planner import RiskMap, Strategy
from ambush_planner.arrays import BoolArray, FloatArray, IndexArray
from ambush_planner.routes.corridors import Corridors
from ambush_planner.routes.taut_string import portals_along, taut_strings

HAIRPIN = np.radians(120.0)  # change of heading within one spacing
NEAR_ITSELF = 3.0  # spacings, beside the path; along it three times as far
NEAR_EDGE = 1.5  # spacings from the map's outer edge
AWAY = 10.0  # spacings from start and goal
PLACES = 64  # along an edge or a path, where it is looked at


@dataclass(frozen=True)
class Drive:
    """Of one path: length [m], turning [rad], hairpins, shares of its length, Nav2's verdict."""

    length: float
    turning: float
    hairpins: int
    near_itself: float
    near_edge: float
    near_edge_away: float
    accepted: bool


def measure(poses: FloatArray, risk_map: RiskMap, spacing: float, step: float) -> Drive:
    """Measure a path; ``spacing`` is that of nodes, ``step`` the largest one of poses [m]."""
    gone, yaw = _along(poses)
    fine = np.arange(0.0, gone[-1], spacing / 20.0)
    points = np.stack([np.interp(fine, gone, xy) for xy in poses[:, :2].T], axis=1)
    return Drive(
        float(gone[-1]),
        float(np.abs(np.diff(yaw)).sum()),
        _hairpins(gone, yaw, spacing),
        _near_itself(points, fine, spacing),
        float(_near_edge(points, risk_map, NEAR_EDGE * spacing).mean()),
        float((_near_edge(points, risk_map, NEAR_EDGE * spacing)
               & _away(points, AWAY * spacing)).mean()),
        accepted(poses, risk_map, step),
    )


def _along(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance gone at each pose, and the heading there without jumps by 360 degrees."""
    gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    return gone, np.unwrap(poses[:, 2])


def _hairpins(gone: FloatArray, yaw: FloatArray, spacing: float) -> int:
    """How many times the heading changes by more than ``HAIRPIN`` within a spacing."""
    end = np.searchsorted(gone, gone + spacing, side='right')
    sharp = [np.ptp(yaw[k : max(e, k + 2)]) > HAIRPIN for k, e in enumerate(end)]
    return int((np.diff(np.concatenate(([False], sharp)).astype(int)) > 0).sum())


def _near_itself(points: FloatArray, fine: FloatArray, spacing: float) -> float:
    near = cKDTree(points).query_pairs(NEAR_ITSELF * spacing, output_type='ndarray')
    apart = np.abs(fine[near[:, 0]] - fine[near[:, 1]]) > 3.0 * NEAR_ITSELF * spacing
    return len(np.unique(near[apart])) / len(points)


def _near_edge(points: FloatArray, risk_map: RiskMap, margin: float) -> BoolArray:
    uv = risk_map.to_map_axes(points)
    near: BoolArray = np.minimum(uv, risk_map.size - uv).min(axis=1) < margin
    return near


def _away(points: FloatArray, distance: float) -> BoolArray:
    """Which points (K, 2) of a path are further than that from its ends."""
    gaps = np.linalg.norm(points[:, None] - points[[0, -1]], axis=2)
    far: BoolArray = gaps.min(axis=1) > distance
    return far


def accepted(poses: FloatArray, risk_map: RiskMap, step: float) -> bool:
    """Poses close together, yaw without jumps over 45 degrees, nothing in obstacles or off the
    map: by looking at points a tenth of a cell apart, not by the planner's own test."""
    steps = np.diff(poses[:, :2], axis=0)
    jumps = np.abs((np.diff(poses[:, 2]) + np.pi) % (2 * np.pi) - np.pi)
    if np.hypot(*steps.T).max() > step * (1.0 + 1e-9) or jumps.max() > np.radians(45.0):
        return False
    gone, _ = _along(poses)
    fine = np.arange(0.0, gone[-1], risk_map.resolution / 10.0)
    points = np.stack([np.interp(fine, gone, xy) for xy in poses[:, :2].T], axis=1)
    uv = risk_map.to_map_axes(np.concatenate((points, poses[:, :2])))
    inside = bool(((uv > 0.0) & (uv < risk_map.size)).all())
    return inside and not risk_map.obstacles[risk_map.cells(uv)].any()


def turning_of(points: FloatArray) -> float:
    """Sum of the turns at the corners of a line [rad]."""
    heading = np.arctan2(*np.diff(points, axis=0).T[::-1])
    return float(np.abs((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi).sum())


def least_turning(corridors: Corridors, route: IndexArray) -> float:
    """Turning of the shortest line in the corridors of a route: no line there turns less [rad]."""
    portals = portals_along(corridors, [corridors.shortened(route)])
    none = np.zeros(len(portals.nodes))
    at, side = np.array(taut_strings(portals, none, [0])[0]).T
    left, right = (portals.places(none, which)[at] for which in (1, -1))
    return turning_of(np.where(side[:, None] > 0, left, right))


def least_near_edge(strategy: Strategy, risk_map: RiskMap, spacing: float) -> float:
    """Least length near the map's edge, as drawn, of all strategies with no larger value and no
    longer routes, over this one's length."""
    network, value, length = strategy.network, strategy.value, strategy.expected_length
    tail, head = network.edges.T
    count, flows = len(network.points), np.arange(len(tail))
    places = (np.arange(PLACES) + 0.5)[:, None, None] / PLACES
    points = network.points[tail] + places * (network.points[head] - network.points[tail])
    near = _near_edge(points.reshape(-1, 2), risk_map, NEAR_EDGE * spacing)
    near = near.reshape(PLACES, -1).mean(axis=0)
    hits = coo_array((network.alpha[head], (head, flows)), (count, len(tail)))
    long = coo_array(network.lengths[None])
    ends = np.zeros(count)
    ends[[network.source, network.target]] = -1.0, 1.0
    change = np.concatenate((np.ones(len(tail)), np.full(len(tail), -1.0)))
    balance = coo_array((change, (np.append(head, tail), np.tile(flows, 2))), (count, len(tail)))
    best = linprog(
        near * network.lengths, vstack((hits, long)).tocsr(),
        np.append(np.full(count, value), length), balance.tocsr(), ends, method='highs',
    )
    return float(best.fun / length)


def apart(paths: list[FloatArray], distance: float) -> int:
    """How many different ones there are among paths (L, 3).

    Two are the same if at equal shares of their lengths neither x nor y differs by more than
    ``distance`` [m]. Each path is held against one of every kind before it.
    """
    kinds = np.empty((len(paths), PLACES, 2))
    count = 0
    for path in paths:
        gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))))
        places = np.linspace(0.0, gone[-1], PLACES)
        here = np.stack([np.interp(places, gone, xy) for xy in path[:, :2].T], axis=1)
        alike = np.arange(count)
        for step in (PLACES // 4, 1):  # most differ at a few places already
            off = np.abs(kinds[alike, ::step] - here[::step]).max(axis=(1, 2), initial=0.0)
            alike = alike[off <= distance]
        if len(alike) == 0:
            kinds[count] = here
            count += 1
    return count

"""Measurements of paths (L, 3) = (x, y, yaw): length, turning, hairpins, and Nav2's rules."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ambush_planner import RiskMap
from ambush_planner.arrays import BoolArray, FloatArray

HAIRPIN = np.radians(120.0)  # change of heading within one spacing
NEAR_ITSELF = 3.0  # distance between parts of a path, three times as far along it [spacings]
NEAR_EDGE = 1.5  # distance from the map's outer edge [spacings]


@dataclass(frozen=True)
class Drive:
    """Length [m], turning [rad] and hairpins of a path, and shares of its length."""

    length: float
    turning: float
    hairpins: int
    near_itself: float
    near_edge: float
    accepted: bool


def measure(poses: FloatArray, risk_map: RiskMap, spacing: float, step: float) -> Drive:
    """Measure a path on a network of ``spacing``, with poses at most ``step`` apart [m]."""
    points, along = resampled(poses, spacing / 20.0)
    travelled, yaw = distances(poses), np.unwrap(poses[:, 2])
    uv = risk_map.to_map_axes(points)
    near_edge = np.minimum(uv, risk_map.size - uv).min(axis=1) < NEAR_EDGE * spacing
    return Drive(
        float(travelled[-1]),
        float(np.abs(np.diff(yaw)).sum()),
        _hairpins(travelled, yaw, spacing),
        _near_itself(points, along, spacing),
        float(near_edge.mean()),
        accepted(poses, risk_map, step),
    )


def distances(poses: FloatArray) -> FloatArray:
    """Distance travelled at each pose [m]."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))


def resampled(poses: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Points every ``step`` [m] along a path, and their distances along it."""
    travelled = distances(poses)
    along = np.arange(0.0, travelled[-1], step)
    return np.stack([np.interp(along, travelled, xy) for xy in poses[:, :2].T], axis=1), along


def _hairpins(travelled: FloatArray, yaw: FloatArray, spacing: float) -> int:
    """Number of changes of heading by more than ``HAIRPIN`` within one spacing."""
    end = np.searchsorted(travelled, travelled + spacing, side='right')
    sharp = [np.ptp(yaw[k : max(e, k + 2)]) > HAIRPIN for k, e in enumerate(end)]
    return int((np.diff(np.concatenate(([False], sharp)).astype(int)) > 0).sum())


def _near_itself(points: FloatArray, along: FloatArray, spacing: float) -> float:
    near = cKDTree(points).query_pairs(NEAR_ITSELF * spacing, output_type='ndarray')
    apart: BoolArray = np.abs(along[near[:, 0]] - along[near[:, 1]]) > 3.0 * NEAR_ITSELF * spacing
    return len(np.unique(near[apart])) / len(points)


def accepted(poses: FloatArray, risk_map: RiskMap, step: float) -> bool:
    """Whether poses are close, yaw jumps by at most 45 degrees, and no point is in an obstacle.

    Checks points a tenth of a cell apart, independently of the planner's own test.
    """
    steps = np.diff(poses[:, :2], axis=0)
    jumps = np.abs((np.diff(poses[:, 2]) + np.pi) % (2 * np.pi) - np.pi)
    if np.hypot(*steps.T).max() > step * (1.0 + 1e-9) or jumps.max() > np.radians(45.0):
        return False
    points, _ = resampled(poses, risk_map.resolution / 10.0)
    uv = risk_map.to_map_axes(np.concatenate((points, poses[:, :2])))
    inside = bool(((uv > 0.0) & (uv < risk_map.size)).all())
    return inside and not risk_map.obstacles[risk_map.cells(uv)].any()


def turning_of(points: FloatArray) -> float:
    """Sum of the turns at the corners of a line [rad]."""
    heading = np.arctan2(*np.diff(points, axis=0).T[::-1])
    return float(np.abs((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi).sum())

"""The path that is driven: the shortest one beside the drawn route, with round corners.

A route's strips and discs (``corridors``) overlap in a *portal* at each of its nodes: a piece of
the line that halves the angle between its two edges. Strips are convex, so what leads from portal
to portal in straight lines stays in them, and the shortest such path, the taut string, is found by
the funnel algorithm (Lee and Preparata 1984) in one pass. It uses a part of the portals only; its
corners are rounded in what is left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .arrays import FloatArray, IndexArray
from .corridors import Corridors
from .errors import InvalidOption
from .risk_map import to_map_axes, to_world
from .routes import MOST_POSES

# Of the portals, for the taut string; the more is left, the wider the turns can be.
TAUT = (0.8, 0.5, 0.2)
# Portals reach at most so far along their edges [lengths], so that those next to each other never
# cross.
ALONG = 0.45
# Poses in a turn are at most so far from one another [rad].
TURN = math.radians(20.0)
# Along a path where it is compared with others.
PLACES = 64


@dataclass(frozen=True, eq=False)
class _Portals:
    """``nodes`` (K, 2) of a route, unit vectors (K, 2) to the left, and room to both sides (K,)."""

    nodes: FloatArray
    leftward: FloatArray
    left: FloatArray
    right: FloatArray


@dataclass(frozen=True, eq=False)
class _Corners:
    """A line with round corners: ``points`` (C, 2), and for those within it the turn [rad], to the
    left > 0, and the length (C - 2,) by which the turn begins before the corner."""

    points: FloatArray
    turn: FloatArray
    cut: FloatArray

    @property
    def radius(self) -> float:
        """The smallest of the turns' radii [m]; inf without a turn."""
        bent = np.abs(self.turn) > 1e-9
        return float((self.cut[bent] / np.tan(np.abs(self.turn[bent]) / 2)).min(initial=math.inf))


def driven_path(
    corridors: Corridors, route: IndexArray, spacing: float, turning_radius: float = 0.0,
    ends: tuple[tuple[float, float], tuple[float, float]] | None = None,
) -> FloatArray:
    """Poses (L, 3) = (x, y, yaw) of the path that is driven for a drawn route, in the world.

    The path begins and ends exactly at the route's ends. Poses are at most ``spacing`` [m] apart;
    yaw is the direction of travel and changes by at most 20 degrees from pose to pose. Corners
    are as round as the corridors allow; where that is less than ``turning_radius`` [m], the
    string is pulled less taut, and what the corridors do not allow stays sharper. It meets each
    stop of a trip exactly, with the yaw of the arrival; there the convoy may turn on the spot.

    Parameters
    ----------
    route : (K,) int
        Node indices, source first, target last.
    ends
        Start and goal [m] where they are beside the route's ends: from and to there the path is
        the straight line to the route's next node, which the caller has found to be clear.

    Raises
    ------
    InvalidOption
        That would be more than ``MOST_POSES``.
    """
    network = corridors.network
    at = [0, *np.flatnonzero(np.isin(route, network.stops)).tolist(), len(route) - 1]
    places = list(map(tuple, network.points[route[at]].tolist()))
    if ends is not None:
        places[0], places[-1] = ends
    legs = [
        _driven_leg(corridors, route[first : last + 1], spacing, turning_radius, leg_ends)
        for (first, last), leg_ends in zip(pairwise(at), pairwise(places), strict=True)
    ]
    poses = np.concatenate((legs[0], *(leg[1:] for leg in legs[1:])))
    _check_count(float(len(poses)), spacing)
    return poses


def _driven_leg(
    corridors: Corridors, route: IndexArray, spacing: float, turning_radius: float,
    ends: tuple[tuple[float, float], tuple[float, float]],
) -> FloatArray:
    route, portals = _way(corridors, route, ends)
    best = None
    for share in TAUT:
        line = _rounded(portals, _taut(portals, share), share)
        if best is None or line.radius > best.radius:
            best = line
        if best.radius >= turning_radius:
            break
    assert best is not None  # TAUT is not empty
    uv, yaw = _poses(best, spacing)
    in_world = to_world(corridors.origin, uv)
    poses = np.column_stack((in_world, _wrapped(yaw + corridors.origin[2])))
    # Turning to the world and back may have cost a digit.
    poses[[0, -1], :2] = ends
    return poses


def driven_paths(
    corridors: Corridors, routes: list[IndexArray], spacing: float, turning_radius: float = 0.0
) -> list[FloatArray]:
    """``driven_path`` of each route."""
    return [driven_path(corridors, route, spacing, turning_radius) for route in routes]


def different_paths(paths: list[FloatArray], distance: float) -> int:
    """How many different ones there are among paths (L, 3).

    Two are the same if at equal shares of their lengths neither x nor y differs by more than
    ``distance`` [m]. Each path is held against one of every kind before it.
    """
    kinds = np.empty((len(paths), 2, PLACES))
    count = 0
    for path in paths:
        gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))))
        places = np.linspace(0.0, gone[-1], PLACES)
        kinds[count] = [np.interp(places, gone, xy) for xy in path[:, :2].T]
        apart = np.abs(kinds[:count] - kinds[count]).max(axis=(1, 2))
        count += not (apart <= distance).any()
    return count


def _way(
    corridors: Corridors, route: IndexArray,
    ends: tuple[tuple[float, float], tuple[float, float]],
) -> tuple[IndexArray, _Portals]:
    """The route that is followed, and its portals."""
    at = corridors.network.points[route[[0, -1]]]
    moved = [not np.array_equal(*pair) for pair in zip(at, np.array(ends), strict=True)]
    first, last = int(moved[0]), len(route) - int(moved[1])
    if last - first > 1:
        inner = corridors.shortened(route[first:last])
        route = np.concatenate((route[:first], inner, route[last:]))
    portals = _portals(corridors, route)
    for end, next_to_it in ((0, 1), (-1, -2)):
        if moved[end]:
            portals.nodes[end] = to_map_axes(corridors.origin, ends[end])
            portals.left[next_to_it] = portals.right[next_to_it] = 0.0
    return route, portals


def _portals(corridors: Corridors, route: IndexArray) -> _Portals:
    nodes = corridors.uv[route]
    edges = corridors.edges_along(route)
    step = np.diff(nodes, axis=0)
    length = np.hypot(*step.T)
    unit = step / length[:, None]
    left, right = corridors.left[edges], corridors.right[edges]
    halves = unit[:-1] + unit[1:]
    size = np.hypot(*halves.T)
    # Half the turn: how much of a portal leads along the edges, and how much off them.
    off = np.maximum(size / 2, 1e-9)
    leftward = np.stack((-halves[:, 1], halves[:, 0]), axis=1) / np.maximum(size, 1e-9)[:, None]
    along = np.sqrt(np.maximum(1.0 - off**2, 0.0))
    shortest = np.minimum(length[:-1], length[1:])
    least = np.minimum(np.minimum(left, right)[:-1], np.minimum(left, right)[1:])
    disc = np.minimum(corridors.disc[route[1:-1]], least)
    # Leaving the disc behind an edge's end for the far side of a strip must not lead out of it.
    widest = np.maximum(np.maximum(left, right)[:-1], np.maximum(left, right)[1:])
    outer = disc / np.hypot(1.0, (widest + disc) / ((1.0 - ALONG) * shortest))
    limit = ALONG * shortest / np.maximum(along, 1e-9)
    inner_left = np.minimum(np.minimum(left[:-1], left[1:]) / off, limit)
    inner_right = np.minimum(np.minimum(right[:-1], right[1:]) / off, limit)
    turn = unit[:-1, 0] * unit[1:, 1] - unit[:-1, 1] * unit[1:, 0]
    usable = size > 1e-6
    zero = np.zeros(1)
    return _Portals(
        nodes,
        np.concatenate((np.zeros((1, 2)), leftward, np.zeros((1, 2)))),
        np.concatenate((zero, np.where(turn >= 0, inner_left, outer) * usable, zero)),
        np.concatenate((zero, np.where(turn <= 0, inner_right, outer) * usable, zero)),
    )


def _taut(portals: _Portals, share: float) -> list[tuple[int, int]]:
    """The taut string's corners as (portal, side), side 1 its left end, -1 its right end, 0 for the
    ends of the route: the funnel algorithm."""
    left = portals.nodes + share * portals.left[:, None] * portals.leftward
    right = portals.nodes - share * portals.right[:, None] * portals.leftward
    ends = {1: left.tolist(), -1: right.tolist()}
    last = len(left) - 1
    first_side = np.where(_left_first(left, right), 1, -1).tolist()
    corners, apex, k, half = [(0, 0)], ends[1][0], 1, 0
    tip = {1: apex, -1: apex}
    at = {1: 0, -1: 0}
    while k <= last:
        side = first_side[k] if half == 0 else -first_side[k]
        (ax, ay), (x, y), (sx, sy), (ox, oy) = apex, ends[side][k], tip[side], tip[-side]
        # The funnel is as wide as its tips say; a side moves in where the next end is within.
        if side * ((sx - ax) * (y - ay) - (sy - ay) * (x - ax)) <= 0.0:
            if tip[side] == apex or side * ((ox - ax) * (y - ay) - (oy - ay) * (x - ax)) > 0.0:
                tip[side], at[side] = ends[side][k], k
            else:  # beyond the other side: a corner there, from which it goes on
                corners.append((at[-side], -side))
                apex, k, half = tip[-side], at[-side] + 1, 0
                tip = {1: apex, -1: apex}
                at = {1: at[-side], -1: at[-side]}
                continue
        k, half = (k, 1) if half == 0 else (k + 1, 0)
    return [*(corner for corner in corners if corner[0] != last), (last, 0)]


def _left_first(left: FloatArray, right: FloatArray) -> list[bool]:
    """Whether, from one portal to the next, the left end may move before the right one does: if
    the diagonal from the old right to the new left end lies between the portals."""
    old, new = right[:-1], left[1:]
    before = _cross(old - left[:-1], new - left[:-1]) >= 0.0
    after = _cross(right[1:] - old, new - old) >= 0.0
    return [True, *(before & after).tolist()]


def _rounded(portals: _Portals, taut: list[tuple[int, int]], share: float) -> _Corners:
    """Let each turn begin as early as segments, portals and the room beyond the string allow."""
    at, side = np.array(taut).T
    room = np.where(side > 0, portals.left[at], np.where(side < 0, portals.right[at], 0.0))
    points = portals.nodes[at] + (share * side * room)[:, None] * portals.leftward[at]
    step = np.diff(points, axis=0)
    length = np.hypot(*step.T)
    unit = step / np.maximum(length, np.finfo(float).tiny)[:, None]
    before, after, inner = unit[:-1], unit[1:], at[1:-1]
    turn = np.arctan2(_cross(before, after), (before * after).sum(axis=1))
    outward = side[1:-1, None] * portals.leftward[inner]
    with np.errstate(divide="ignore", invalid="ignore"):
        # The chord of the turn leaves the corner by this share of the cut, along the portal.
        leaves = np.abs(_cross(before, after) / _cross(outward, before + after))
        most = (1.0 - share) * room[1:-1] / leaves
    cut = np.fmin(most, np.minimum(length[:-1], length[1:]) / 2)
    cut = np.fmin(cut, _reach(portals, points[1:-1], before, inner - 1))
    cut = np.fmin(cut, _reach(portals, points[1:-1], after, inner + 1))
    return _Corners(points, turn, np.where(np.abs(turn) > 1e-9, 0.999 * cut, 0.0))


def _reach(
    portals: _Portals, points: FloatArray, direction: FloatArray, portal: IndexArray
) -> FloatArray:
    """Distance (C,) along lines through the points to the lines of portals; nan: no such line."""
    line = portals.leftward[portal]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(_cross(portals.nodes[portal] - points, line) / _cross(direction, line))


def _poses(line: _Corners, spacing: float) -> tuple[FloatArray, FloatArray]:
    """Positions (L, 2) and yaws (L,) along straight parts and turns, one after the other."""
    step = np.diff(line.points, axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])
    unit = np.stack((np.cos(yaw), np.sin(yaw)), axis=1)
    cut = np.concatenate(([0.0], line.cut, [0.0]))
    straight = np.maximum(np.hypot(*step.T) - cut[:-1] - cut[1:], 0.0)
    turn = np.abs(line.turn)
    arc = np.where(turn > 1e-9, line.cut * turn / np.tan(np.maximum(turn, 1e-9) / 2), 0.0)
    # Straight parts and turns take turns: part 2 k is straight, 2 k + 1 the turn behind it.
    parts = np.zeros(2 * len(step) - 1)
    with np.errstate(over="ignore"):
        parts[::2] = np.ceil(straight / spacing - 1e-9)
        parts[1::2] = np.ceil(np.maximum(arc / spacing, turn / TURN) - 1e-9)
    _check_count(float(parts.sum()) + 1.0, spacing)
    count = parts.astype(np.int64)
    part = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(part)) - np.repeat(np.cumsum(count) - count, count)) / count[part]
    k, bent = part // 2, part % 2 == 1
    bend = np.concatenate((line.turn, [0.0]))[k]
    angle = yaw[k] + np.where(bent, share * bend, 0.0)
    begin = np.where(bent, cut[k + 1], -cut[k])  # of the part, before its corner
    origin = line.points[np.where(bent, k + 1, k)] - begin[:, None] * unit[k]
    # In a turn by w the chord to where it has come to points by half of that aside.
    half = share * bend / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.where(bent & (bend != 0.0), cut[k + 1] / np.tan(np.abs(bend) / 2), 0.0)
    chord = np.where(bent, 2.0 * radius * np.abs(np.sin(half)), share * straight[k])
    toward = yaw[k] + np.where(bent, half, 0.0)
    uv = origin + chord[:, None] * np.stack((np.cos(toward), np.sin(toward)), axis=1)
    return np.concatenate((uv, line.points[-1:])), np.concatenate((angle, yaw[-1:]))


def _check_count(poses: float, spacing: float) -> None:
    if not poses <= MOST_POSES:
        raise InvalidOption(
            f"a pose every {spacing:g} m (route.path_spacing) makes a path of {poses:.3g} poses, "
            f"and {MOST_POSES} are the most; choose a larger distance"
        )


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product


def _wrapped(angle: FloatArray) -> FloatArray:
    """The same angles in [-pi, pi)."""
    wrapped: FloatArray = (angle + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped

"""The path that is driven: the shortest one beside the drawn route, with round corners.

The taut string leaves a margin at both ends of each portal, in which its corners are rounded. Where
that makes too tight a turn, the margin is widened.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .arrays import FloatArray, IndexArray
from .corridors import Corridors
from .errors import InvalidOption
from .risk_map import to_world
from .routes import MOST_POSES
from .taut_string import Portals, cross, portals_along, taut_string

# Of a portal's width: the margin at first, how much wider it gets where a turn is too tight, in so
# many passes, and the most.
MARGIN, WIDER, PASSES, MOST = 0.03, 3.0, 3, 0.49
# Turns are wanted at least so wide [length of the shorter edge at the node].
ROUND = 0.3
# Poses in a turn are at most so far from one another [rad].
TURN = math.radians(20.0)
# Along a path where it is compared with others.
PLACES = 64


@dataclass(frozen=True, eq=False)
class _Corners:
    """A line with round corners, ``points`` (C, 2).

    For those within it: the ``turn`` (C - 2,) [rad], to the left > 0, and the length ``cut``
    (C - 2,) [m] by which the turn begins before the corner.
    """

    points: FloatArray
    turn: FloatArray
    cut: FloatArray

    @property
    def radii(self) -> FloatArray:
        """Of the turns (C - 2,) [m]; inf where there is none."""
        bent = np.abs(self.turn) > 1e-9
        tangent = np.tan(np.where(bent, np.abs(self.turn), 1.0) / 2)
        radii: FloatArray = np.where(bent, self.cut / tangent, math.inf)
        return radii

    @property
    def radius(self) -> float:
        """The smallest of the turns' radii [m]; inf without a turn."""
        return float(self.radii.min(initial=math.inf))


def driven_path(
    corridors: Corridors, route: IndexArray, spacing: float, turning_radius: float = 0.0,
    ends: tuple[tuple[float, float], tuple[float, float]] | None = None,
) -> FloatArray:
    """Poses (L, 3) = (x, y, yaw) of the path that is driven for a drawn route, in the world.

    The path begins and ends exactly at the route's ends. Poses are at most ``spacing`` [m] apart;
    yaw is the direction of travel and changes by at most 20 degrees from pose to pose. Corners
    have at least ``turning_radius`` [m], or ``ROUND`` edges if that is more, where the corridors
    have the room; elsewhere they are as round as these allow (``turn_radii``). Each stop of a trip
    is met exactly, with the yaw of the arrival; there the convoy may turn on the spot.

    Parameters
    ----------
    route : (K,) int
        Node indices, source first, target last.
    ends
        Start and goal [m] to the last digit, where the corridors lead from and to other places than
        the network's source and target (``with_end_at``).

    Raises
    ------
    InvalidOption
        That would be more than ``MOST_POSES``.
    """
    network = corridors.network
    at = [0, *np.flatnonzero(np.isin(route, network.stops)).tolist(), len(route) - 1]
    points = list(map(tuple, network.points[route[at]].tolist()))
    if ends is not None:
        points[0], points[-1] = ends
    route = network.places[route]
    legs = [
        _driven_leg(corridors, route[first : last + 1], spacing, turning_radius, leg_ends)
        for (first, last), leg_ends in zip(pairwise(at), pairwise(points), strict=True)
    ]
    poses = np.concatenate((legs[0], *(leg[1:] for leg in legs[1:])))
    _check_count(float(len(poses)), spacing)
    return poses


def _driven_leg(
    corridors: Corridors, route: IndexArray, spacing: float, turning_radius: float,
    ends: tuple[tuple[float, float], tuple[float, float]],
) -> FloatArray:
    route = corridors.shortened(route)
    portals = portals_along(corridors, route)
    line = _smooth(portals, turning_radius)
    uv, yaw = _poses(line, spacing)
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


def turn_radii(poses: FloatArray) -> FloatArray:
    """Radii (L - 1,) [m] of the arcs from pose to pose of a path (L, 3) of ``driven_path``.

    They are inf where it is straight, 0 where it turns on the spot.
    """
    half = np.abs(_wrapped(np.diff(poses[:, 2]))) / 2
    bent = half > 1e-9
    chord = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    radii: FloatArray = np.where(bent, chord / (2.0 * np.sin(np.where(bent, half, 1.0))), math.inf)
    return radii


def tight_turns(poses: FloatArray, turning_radius: float) -> int:
    """How many turns of a path (L, 3) are tighter than ``turning_radius`` [m]."""
    tight = turn_radii(poses) < turning_radius * (1.0 - 1e-6)
    return int(np.count_nonzero(tight & ~np.append(False, tight[:-1])))


def different_paths(paths: list[FloatArray], distance: float) -> int:
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
            apart = np.abs(kinds[alike, ::step] - here[::step]).max(axis=(1, 2), initial=0.0)
            alike = alike[apart <= distance]
        if len(alike) == 0:
            kinds[count] = here
            count += 1
    return count


def _smooth(portals: Portals, turning_radius: float) -> _Corners:
    """The taut string with round corners; where they are too tight it keeps further inside."""
    margin = MARGIN * portals.width
    wanted = np.maximum(ROUND * portals.length, turning_radius)
    best = None
    for _ in range(PASSES):
        taut = taut_string(portals, margin)
        line = _rounded(portals, taut, margin)
        if best is None or line.radius >= best.radius:
            best = line
        at = np.array([portal for portal, _ in taut[1:-1]], dtype=np.int64)
        tight = at[line.radii < wanted[at]]
        tight = tight[margin[tight] < MOST * portals.width[tight]]
        if len(tight) == 0:
            break
        margin[tight] = np.minimum(WIDER * margin[tight], MOST * portals.width[tight])
    assert best is not None  # PASSES is not 0
    return best


def _rounded(
    portals: Portals, taut: list[tuple[int, int]], margin: FloatArray
) -> _Corners:
    """Let each turn begin as early as segments, portals and the room beyond the string allow."""
    at, side = np.array(taut).T
    left, right = (portals.places(margin, side)[at] for side in (1, -1))
    points = np.where(side[:, None] > 0, left, right)
    step = np.diff(points, axis=0)
    length = np.hypot(*step.T)
    unit = step / np.maximum(length, np.finfo(float).tiny)[:, None]
    before, after, inner = unit[:-1], unit[1:], at[1:-1]
    turn = np.arctan2(cross(before, after), (before * after).sum(axis=1))
    outward = side[1:-1, None] * portals.leftward[inner]
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = margin[inner] / _leaves(turn, outward, after - before)
    cut = np.fmin(cut, _reach(portals, points[1:-1], before, inner - 1))
    cut = np.fmin(cut, _reach(portals, points[1:-1], after, inner + 1))
    cut = _shared(cut, np.tan(np.abs(turn) / 2), length)
    return _Corners(points, turn, np.where(np.abs(turn) > 1e-9, 0.999 * cut, 0.0))


def _leaves(turn: FloatArray, outward: FloatArray, aside: FloatArray) -> FloatArray:
    """How far poses along turns (C,) leave the corners, in cuts, along portals (C, 2).

    ``aside`` (C, 2) is the change of direction. The poses' chords are outside a circle of ``k``
    times the turn's radius, and no further from the corner than the chord of the whole turn.
    """
    half, k = np.abs(turn) / 2, math.cos(TURN / 2)
    cosine = np.abs((outward * aside).sum(axis=1)) / np.hypot(*aside.T)
    within = (k * np.cos(half)) ** 2 - (1.0 - cosine**2)
    chord = np.sin(half) / cosine
    circle = (cosine - np.sqrt(np.maximum(within, 0.0))) / np.sin(half)
    leaves: FloatArray = np.where(within > 0.0, np.minimum(chord, circle), chord)
    return leaves


def _shared(cut: FloatArray, tangent: FloatArray, length: FloatArray) -> FloatArray:
    """Cuts (C,) of which two neighbours fit in the length (C + 1,) between their corners.

    Both turns get equal radii, and each one also what the other does not need.
    """
    tangent = np.concatenate(([0.0], np.maximum(tangent, 1e-12), [0.0]))
    most = np.concatenate(([0.0], cut, [0.0]))
    fair = length / np.maximum(tangent[:-1] + tangent[1:], 1e-12)
    ahead = np.maximum(fair * tangent[:-1], length - most[1:])
    behind = np.maximum(fair * tangent[1:], length - most[:-1])
    shared: FloatArray = np.minimum(cut, np.minimum(ahead[1:], behind[:-1]))
    return shared


def _reach(
    portals: Portals, points: FloatArray, direction: FloatArray, portal: IndexArray
) -> FloatArray:
    """Distance (C,) along lines through the points to the lines of portals; nan: no such line."""
    line = portals.leftward[portal]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(cross(portals.nodes[portal] - points, line) / cross(direction, line))


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


def _wrapped(angle: FloatArray) -> FloatArray:
    """The same angles in [-pi, pi)."""
    wrapped: FloatArray = (angle + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped

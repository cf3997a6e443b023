# SPDX-License-Identifier: Apache-2.0
"""The driven path: the shortest line in the drawn route's corridor, with rounded corners.

The taut string leaves a margin at both ends of each portal, in which its corners are rounded;
turns may also use free space beyond the ends if no ambush gains by it. If a turn is too tight, the
margin is widened.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IndexArray, members
from ..errors import InvalidOption
from ..maps.risk_map import to_world
from ..maps.ros_messages import MAX_POSES
from .corridors import Corridors
from .cut_corners import cross, free_depth, pad
from .taut_string import Portals, portals_along, taut_strings

# Initial and largest margin [portal widths].
MARGIN, MAX_MARGIN = 0.03, 0.49
# Factor by which the margin grows at tight turns in each pass, and the number of passes.
GROWTH, PASSES = 3.0, 3
# Desired turning radius [lengths of the shorter edge at the node].
ROUND = 0.3
# Largest change of yaw between poses [rad].
TURN = math.radians(20.0)
# Number of routes whose paths are made together.
AT_ONCE = 32

# Start and goal [m].
Ends = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines through ``points`` (C, 2) with round corners, concatenated [m].

    Line i has the points from ``bounds[i]`` to ``bounds[i + 1]``. ``turn`` (C,) is the turning
    angle at each point [rad], positive to the left, ``cut`` (C,) the distance from the start of the
    turn to the corner [m]; both are 0 at the ends of a line.
    """

    points: FloatArray
    turn: FloatArray
    cut: FloatArray
    bounds: IndexArray

    @property
    def radii(self) -> FloatArray:
        """Turning radii (C,) [m]; inf without a turn."""
        bent = np.abs(self.turn) > 1e-9
        tangent = np.tan(np.where(bent, np.abs(self.turn), 1.0) / 2)
        radii: FloatArray = np.where(bent, self.cut / tangent, math.inf)
        return radii


def driven_path(corridors: Corridors, route: IndexArray, spacing: float,
                turning_radius: float = 0.0, ends: Ends | None = None) -> FloatArray:
    """Make the path to drive for a drawn route: world poses (L, 3) = (x, y, yaw).

    The path begins and ends exactly at the route's ends. Poses are at most ``spacing`` [m] apart;
    yaw is the direction of travel and changes by at most 20 degrees between poses. Turns have a
    radius of at least ``turning_radius`` [m] and of ``ROUND`` edges, or the largest radius that the
    corridors allow (``turn_radii``).

    Parameters
    ----------
    route : (K,) int
        Node indices from source to target.
    ends
        Exact start and goal [m] if they moved from the network's source and target
        (``move_end``).

    Raises InvalidOption if the path would have more than ``MAX_POSES``.
    """
    return driven_paths(corridors, [route], spacing, turning_radius, ends)[0]


def driven_paths(corridors: Corridors, routes: list[IndexArray], spacing: float,
                 turning_radius: float = 0.0, ends: Ends | None = None) -> list[FloatArray]:
    """Make the paths of several routes as ``driven_path``, several times faster."""
    paths: list[FloatArray] = []
    for first in range(0, len(routes), AT_ONCE):
        paths += _drive(corridors, routes[first : first + AT_ONCE], spacing, turning_radius, ends)
    for path in paths:
        _check_count(float(len(path)), spacing)
    return paths


def join_legs(legs: Sequence[FloatArray]) -> FloatArray:
    """Join the paths of legs; poses at stops are those of the arrival."""
    return np.concatenate((legs[0], *(leg[1:] for leg in legs[1:])))


def _drive(corridors: Corridors, routes: list[IndexArray], spacing: float, turning_radius: float,
           ends: Ends | None) -> list[FloatArray]:
    """Poses (L, 3) along each route."""
    portals = portals_along(corridors, [corridors.shorten(route) for route in routes])
    uv, yaw, bounds = _poses(_smooth(portals, turning_radius), spacing)
    poses = np.column_stack((to_world(corridors.origin, uv),
                             _wrap(yaw + corridors.origin[2])))
    # The transforms to map axes and back may have changed the last digit of the ends.
    points = corridors.network.points
    begin, end = ends or (points[[route[k] for route in routes]] for k in (0, -1))
    poses[bounds[:-1], :2], poses[bounds[1:] - 1, :2] = begin, end
    return np.split(poses, bounds[1:-1])


def turn_radii(poses: FloatArray) -> FloatArray:
    """Return the radii (L - 1,) of the arcs between poses of a driven path (L, 3) [m].

    They are inf on straight parts and 0 for turns on the spot.
    """
    half = np.abs(_wrap(np.diff(poses[:, 2]))) / 2
    bent = half > 1e-9
    chord = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    radii: FloatArray = np.where(bent, chord / (2.0 * np.sin(np.where(bent, half, 1.0))), math.inf)
    return radii


def tight_turns(poses: FloatArray, turning_radius: float) -> int:
    """Count the turns of a path (L, 3) that are tighter than ``turning_radius`` [m]."""
    tight = turn_radii(poses) < turning_radius * (1.0 - 1e-6)
    return int(np.count_nonzero(tight & ~np.append(False, tight[:-1])))


def _smooth(portals: Portals, turning_radius: float) -> _Lines:
    """Taut strings with round corners, and with wider margins if turns are too tight."""
    margin = MARGIN * portals.width
    min_radius = np.maximum(ROUND * portals.length, turning_radius)
    count = len(portals.bounds) - 1
    route_of = np.repeat(np.arange(count), np.diff(portals.bounds))
    best: list[tuple[FloatArray, ...]] = [()] * count
    radius = np.full(count, -1.0)
    routes = np.arange(count)
    for _ in range(PASSES):
        taut = taut_strings(portals, margin, routes.tolist())
        portal, side = np.array(sum(taut, [])).T
        lines = _round_corners(portals, portal, side, np.cumsum([0, *map(len, taut)]), margin)
        smallest = np.minimum.reduceat(lines.radii, lines.bounds[:-1])
        for k in np.flatnonzero(smallest >= radius[routes]).tolist():
            part = slice(*lines.bounds[k : k + 2])
            best[routes[k]] = lines.points[part], lines.turn[part], lines.cut[part]
        radius[routes] = np.maximum(radius[routes], smallest)
        tight = portal[lines.radii < min_radius[portal]]
        tight = tight[margin[tight] < MAX_MARGIN * portals.width[tight]]
        if len(tight) == 0:
            break
        margin[tight] = np.minimum(GROWTH * margin[tight], MAX_MARGIN * portals.width[tight])
        routes = np.unique(route_of[tight])
    points, turn, cut = map(np.concatenate, zip(*best, strict=True))
    return _Lines(points, turn, cut, np.cumsum([0, *(len(each[0]) for each in best)]))


def _round_corners(portals: Portals, portal: IndexArray, side: IndexArray, bounds: IndexArray,
                   margin: FloatArray) -> _Lines:
    """Round the corners as widely as segments, portals and margins allow.

    Corners are given by ``portal`` (C,) and ``side`` (C,), as ``taut_strings`` returns them.
    """
    left, right = (portals.places(margin, each)[portal] for each in (1, -1))
    points = np.where(side[:, None] > 0, left, right)
    step = np.diff(points, axis=0)
    length = np.hypot(*step.T)
    unit = step / np.maximum(length, np.finfo(float).tiny)[:, None]
    before, after, inner = unit[:-1], unit[1:], portal[1:-1]
    real = side[1:-1] != 0
    turn = np.where(real, np.arctan2(cross(before, after), (before * after).sum(axis=1)), 0.0)
    outward = side[1:-1, None] * portals.leftward[inner]
    with np.errstate(divide='ignore', invalid='ignore'):
        offset = _relative_offset(turn, outward, after - before)
        room = portals.room[inner, np.where(side[1:-1] > 0, 0, 1)]
        free_cut = _free_cuts(portals, points[1:-1], turn, np.minimum(length[:-1], length[1:]))
        cut = np.fmax(margin[inner] / offset, np.fmin((margin[inner] + room) / offset, free_cut))
        cut = np.fmin(cut, _distance_to_portals(portals, points[1:-1], before, inner - 1))
        cut = np.fmin(cut, _distance_to_portals(portals, points[1:-1], after, inner + 1))
    tangent = np.maximum(np.tan(np.abs(turn) / 2), 1e-12)
    turn, cut, tangent = (pad(np.where(real, each, 0.0)) for each in (turn, cut, tangent))
    cut = _fit_between_corners(cut, tangent, length)
    return _Lines(points, turn, np.where(np.abs(turn) > 1e-9, 0.999 * cut, 0.0), bounds)


def _relative_offset(turn: FloatArray, outward: FloatArray, lateral: FloatArray) -> FloatArray:
    """Offsets of turns (C,) from their corners along portals (C, 2), as multiples of the cuts.

    ``lateral`` (C, 2) is the change of direction. Chords between poses lie outside a circle of
    ``k`` times the turning radius, and no further from the corner than the chord of the whole turn.
    """
    half, k = np.abs(turn) / 2, math.cos(TURN / 2)
    cosine = np.abs((outward * lateral).sum(axis=1)) / np.hypot(*lateral.T)
    discriminant = (k * np.cos(half)) ** 2 - (1.0 - cosine**2)
    chord = np.sin(half) / cosine
    circle = (cosine - np.sqrt(np.maximum(discriminant, 0.0))) / np.sin(half)
    offset: FloatArray = np.where(discriminant > 0.0, np.minimum(chord, circle), chord)
    return offset


def _free_cuts(portals: Portals, points: FloatArray, turn: FloatArray,
               short: FloatArray) -> FloatArray:
    """Largest cuts (C,) that no additional ambush hits; ``short`` (C,) is the shorter segment."""
    sine, cosine = np.sin(np.abs(turn) / 2), np.cos(turn / 2)
    depth = free_depth(points, short, sine, cosine, portals.reach, portals.secured)
    # Depth of the deepest chord between poses; a small turn has a single chord.
    deepest: FloatArray = np.minimum((1.0 - math.cos(TURN / 2) * cosine) / sine, sine)
    return depth / deepest


def _fit_between_corners(cut: FloatArray, tangent: FloatArray, length: FloatArray) -> FloatArray:
    """Limit cuts (C,) so that neighbours fit in the length (C - 1,) between their corners.

    Both turns get equal radii, and each also gets the length that the other does not need.
    """
    fair = length / np.maximum(tangent[:-1] + tangent[1:], 1e-12)
    room_ahead = np.maximum(fair * tangent[:-1], length - cut[1:])
    room_behind = np.maximum(fair * tangent[1:], length - cut[:-1])
    cut = cut.copy()
    cut[1:-1] = np.minimum(cut[1:-1], np.minimum(room_ahead[1:], room_behind[:-1]))
    return cut


def _distance_to_portals(portals: Portals, points: FloatArray, direction: FloatArray,
                         portal: IndexArray) -> FloatArray:
    """Distance (C,) from points along directions to the lines of portals; NaN at route ends."""
    line = portals.leftward[portal]
    found: FloatArray = np.abs(cross(portals.nodes[portal] - points, line) / cross(direction, line))
    return found


def _poses(lines: _Lines, spacing: float) -> tuple[FloatArray, FloatArray, IndexArray]:
    """Positions (L, 2) and yaws (L,) along the lines, and the bounds of each line in them.

    A corner contributes the poses of its turn and of the straight part after it, the end of a line
    a single pose.
    """
    first, last = lines.bounds[:-1], lines.bounds[1:] - 1
    step = np.diff(lines.points, axis=0, append=lines.points[-1:])
    yaw = np.arctan2(step[:, 1], step[:, 0])
    yaw[last] = yaw[last - 1]
    unit = np.stack((np.cos(yaw), np.sin(yaw)), axis=1)
    straight = np.maximum(np.hypot(*step.T) - lines.cut - np.append(lines.cut[1:], 0.0), 0.0)
    straight[last] = 0.0
    turn = np.abs(lines.turn)
    arc = np.where(turn > 1e-9, lines.cut * turn / np.tan(np.maximum(turn, 1e-9) / 2), 0.0)
    # Part 2 k is the turn at corner k, 2 k + 1 the straight part after it.
    parts = np.zeros(2 * len(step))
    with np.errstate(over='ignore'):
        parts[::2] = np.ceil(np.maximum(arc / spacing, turn / TURN) - 1e-9)
        parts[1::2] = np.ceil(straight / spacing - 1e-9)
    parts[2 * last + 1] = 1.0
    line_counts = np.add.reduceat(parts, 2 * first)
    _check_count(float(line_counts.max()), spacing)
    count = parts.astype(np.int64)
    part, number = members(count)
    share = number / count[part]
    k, bent = part // 2, part % 2 == 0
    segment = k - bent  # turns start in the direction before the corner
    bend = np.where(bent, lines.turn[k], 0.0)
    angle = yaw[segment] + share * bend
    sign = np.where(bent, -1.0, 1.0)[:, None]
    origin = lines.points[k] + sign * lines.cut[k, None] * unit[segment]
    # After turning by w, the chord from the start of the turn points w / 2 aside.
    half = share * bend / 2
    with np.errstate(divide='ignore', invalid='ignore'):
        radius = np.where(bend != 0.0, lines.cut[k] / np.tan(np.abs(bend) / 2), 0.0)
    chord = np.where(bent, 2.0 * radius * np.abs(np.sin(half)), share * straight[k])
    heading = yaw[segment] + half
    uv = origin + chord[:, None] * np.stack((np.cos(heading), np.sin(heading)), axis=1)
    return uv, angle, np.append(0, np.cumsum(line_counts.astype(np.int64)))


def _check_count(poses: float, spacing: float) -> None:
    if not poses <= MAX_POSES:
        raise InvalidOption(
            f'a pose every {spacing:g} m (route.path_spacing) makes a path of {poses:.3g} poses; '
            f'at most {MAX_POSES} are allowed, choose a larger distance'
        )


def _wrap(angle: FloatArray) -> FloatArray:
    """Return the same angles in [-pi, pi)."""
    wrapped: FloatArray = (angle + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped

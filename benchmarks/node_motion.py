# SPDX-License-Identifier: Apache-2.0
"""A robot on patrol, known by TF: does it keep its word, however often it asks?

It drives between two ends of a warehouse and follows the node's paths as regulated pure pursuit
does: it steers to a place ahead, which cuts corners, and turns on the spot when that lies to its
side. It asks by the action every second. Every tenth request under way is for a goal that cannot be
reached, and must be refused with the right code. Each goal must get one departure. Measured: the
driven length over that of the drawn path, how often the worst cell is met against the value
published at the departures, times of answers. Exit code 1 if a target is missed.

tf2_msgs and nav2_msgs are built by test/interfaces.py where they are not installed.
"""

from __future__ import annotations

import itertools
import math
import os
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid
from node_rig import (
    ANSWER_TIMEOUT,
    PLANNER,
    Caller,
    NoAnswer,
    grid_of,
    pose,
    resident,
    run_and_publish,
    running_node,
    say,
    within,
)
from rclpy.action import ActionClient
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python
from report import conditions, new_parser, quantiles, table
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from scipy.stats import binom
from std_msgs.msg import Header

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / 'test'))
import interfaces  # noqa: E402

for package in ('tf2_msgs', 'nav2_msgs'):
    interfaces.install(package)
os.environ['PYTHONPATH'] = os.pathsep.join(sys.path)  # of the node, too
from nav2_msgs.action import ComputePathToPose  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

RESOLUTION, INSCRIBED = 0.05, 0.22  # m
WIDTH, HEIGHT = 26.0, 18.0  # m
ENDS = (np.array([2.0, 9.0]), np.array([24.0, 9.0]))  # m
REACH = 1.0  # game.ambush_radius [m]
TF_PERIOD = 0.02  # s
LOOKAHEAD = (0.3, 0.9, 0.6)  # least and largest [m], and time [s], of regulated pure pursuit
TURN_RATE = 1.8  # rad/s on the spot
SIDEWAYS = math.radians(45.0)  # angle from which it turns on the spot
ARRIVED = 0.25  # m, Nav2's goal checker
UNREACHABLE = 10  # requests under way from one for an unreachable goal to the next
CODES = {getattr(ComputePathToPose.Result, name): name for name in (
    'UNKNOWN', 'TF_ERROR', 'START_OUTSIDE_MAP', 'GOAL_OUTSIDE_MAP', 'START_OCCUPIED',
    'GOAL_OCCUPIED', 'TIMEOUT', 'NO_VALID_PATH')}
CLOSED = [(np.array([8.0, 5.0]), 'GOAL_OCCUPIED'), (np.array([-3.0, 9.0]), 'GOAL_OUTSIDE_MAP'),
          (np.array([13.0, 16.2]), 'NO_VALID_PATH')]
PERIOD = 1.0  # from one request to the next [s]
# Targets.
MEAN_RATIO, WORST_RATIO, MEDIAN, LATE = 1.02, 1.15, 0.02, 0.1


def warehouse() -> np.ndarray:
    """Cells (H, W) of a costmap: racks, pillars and a closed room, with their inflation."""
    lethal = np.zeros((round(HEIGHT / RESOLUTION), round(WIDTH / RESOLUTION)), bool)
    lethal[[0, -1]] = lethal[:, [0, -1]] = True

    def block(x: float, y: float, width: float, height: float) -> tuple[slice, slice]:
        low, size = np.array((y, x)) / RESOLUTION, np.array((height, width)) / RESOLUTION
        return slice(int(low[0]), int(low[0] + size[0])), slice(int(low[1]), int(low[1] + size[1]))

    for x, y in itertools.product((6.0, 11.0, 16.0), (2.0, 6.5, 11.0)):
        lethal[block(x, y, 3.5, 3.0 if y != 6.5 else 2.5)] = True
    lethal[block(12.0, 15.2, 2.0, 2.0)] = True
    lethal[block(12.2, 15.4, 1.6, 1.6)] = False
    away = distance_transform_edt(~lethal) * RESOLUTION
    values = np.where(away <= INSCRIBED, 99, (98 * np.exp(-3.0 * (away - INSCRIBED))).astype(int))
    return np.where(lethal, 100, values).astype(np.int8)


class Robot:
    """A robot that follows paths, and publishes where it is."""

    def __init__(self, caller: Caller, place: np.ndarray, speed: float) -> None:
        self._publisher = caller.node.create_publisher(TFMessage, '/tf', 100)
        self._clock, self._speed = caller.node.get_clock(), speed
        self.place, self.yaw, self.path = place, 0.0, place[None]
        self.trace, self.driven = [place], 0.0
        self._moved = time.monotonic()
        caller.node.create_timer(TF_PERIOD, self._move)

    def _move(self) -> None:
        now = time.monotonic()
        self._step(now - self._moved)
        self._moved = now
        self.trace.append(self.place)
        at = TransformStamped(header=Header(frame_id='map', stamp=self._clock.now().to_msg()),
                              child_frame_id='base_link')
        at.transform.translation.x, at.transform.translation.y = map(float, self.place)
        at.transform.rotation.z = math.sin(self.yaw / 2)
        at.transform.rotation.w = math.cos(self.yaw / 2)
        self._publisher.publish(TFMessage(transforms=[at]))

    def _step(self, seconds: float) -> None:
        """Drive or turn for some time, to a place ahead on the path."""
        least, most, ahead = LOOKAHEAD
        away = np.hypot(*(self.path - self.place).T)
        nearest = int(away.argmin())
        self.path = self.path[nearest:]
        beyond = np.flatnonzero(away[nearest:] >= np.clip(self._speed * ahead, least, most))
        aim = self.path[int(beyond[0]) if len(beyond) else -1] - self.place
        if (distance := float(np.hypot(*aim))) < 1e-3:
            return
        angle = _wrapped(math.atan2(aim[1], aim[0]) - self.yaw)
        if abs(angle) > SIDEWAYS:
            self.yaw += math.copysign(min(TURN_RATE * seconds, abs(angle)), angle)
            return
        step = min(self._speed * seconds, distance)
        turn = 2.0 * math.sin(angle) / distance * step  # along the circle through the aim
        self.place = self.place + step * np.array((math.cos(self.yaw + turn / 2),
                                                   math.sin(self.yaw + turn / 2)))
        self.yaw, self.driven = _wrapped(self.yaw + turn), self.driven + step


@dataclass
class Trip:
    """The record of one trip; ``drawn`` is the length driven plus that of the last new path."""

    way: int
    value: float = math.nan
    secured: float = 0.0
    drawn: float = 0.0
    driven: float = 0.0
    trace: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))


class Patrol:
    """Trips to and fro."""

    def __init__(self, caller: Caller, speed: float) -> None:
        self._caller, self.robot = caller, Robot(caller, ENDS[0], speed)
        self._action = ActionClient(caller.node, ComputePathToPose,
                                    f'{PLANNER}/compute_path_to_pose')
        self._closed = itertools.cycle(CLOSED)
        self.trips: list[Trip] = []
        self.departures, self.under_way, self.wrong = [], [], []  # s, s, texts
        self._departed: np.ndarray | None = None  # the goal of the last departure
        self.answers: Counter[str] = Counter()

    def begin(self) -> None:
        """Publish the map, and wait until the node knows it and the robot."""
        grid = grid_of(warehouse(), RESOLUTION)
        self._caller.publisher(OccupancyGrid, '/alpha_map').publish(grid)
        self._caller.wait(self._action.server_is_ready, 'no action')
        end = time.monotonic() + ANSWER_TIMEOUT
        while self._request(ENDS[0])[0] != 'NONE' and time.monotonic() < end:
            self._caller.idle_until(time.monotonic() + 0.2)

    def drive(self, trips: int) -> None:
        """Make some trips, to and fro."""
        for number in range(trips):
            way = (number + 1) % 2
            self.trips.append(self._drive_one(Trip(way), ENDS[way]))

    def _drive_one(self, trip: Trip, goal: np.ndarray) -> Trip:
        """Drive to a goal."""
        robot, begin = self.robot, time.monotonic()
        robot.trace, robot.driven = [robot.place], 0.0
        self._departed = None
        self._ask(trip, goal)
        due, asked = begin, 0
        while np.hypot(*(robot.place - goal)) > ARRIVED:
            due, asked = due + PERIOD, asked + 1
            self._caller.idle_until(max(due, time.monotonic()))
            if time.monotonic() > begin + 400.0:
                self.wrong.append('not arrived after 400 s')
                robot.place = goal
                break
            if asked % UNREACHABLE == 0:
                self._ask_for_the_impossible()
            self._ask(trip, goal)
        trip.driven, trip.trace = robot.driven, np.array(robot.trace)
        return trip

    def _ask(self, trip: Trip, goal: np.ndarray) -> None:
        """Ask for a path to the goal, and follow it."""
        begin, before = time.monotonic(), len(self.robot.trace)
        code, result = self._request(goal)
        took = time.monotonic() - begin
        if code != 'NONE':
            self.wrong.append(f'{code}: {result.error_msg}')
            return
        path = np.array([(each.pose.position.x, each.pose.position.y)
                         for each in result.path.poses])
        been = np.array(self.robot.trace[before - 1:])  # it drives on while the node answers
        off = float(np.hypot(*(been - path[0]).T).min())
        if off > 1.0:
            self.wrong.append(f'a path that begins {off:.2g} m off')
        kind = next((each for each in ('continued', 'diverted', 'arrived')
                     if each in result.error_msg), 'new')
        self.answers[kind] += 1
        if kind == 'new':
            if self._departed is goal:
                self.wrong.append('another departure for the same goal')
            self._departed = goal
        (self.departures if kind == 'new' else self.under_way).append(took)
        self.robot.path = path
        if kind in ('new', 'diverted'):
            trip.drawn = self.robot.driven + float(np.hypot(*np.diff(path, axis=0).T).sum())
        if kind == 'new' and math.isnan(trip.value):
            self._caller.wait(lambda: self._caller.status.get('departure_value'), 'no value')
            trip.value = float(self._caller.status['departure_value'])
            trip.secured = float(self._caller.status['secured_radius'])

    def _ask_for_the_impossible(self) -> None:
        goal, expected = next(self._closed)
        code, _ = self._request(goal)
        self.answers[code] += 1
        if code != expected:
            self.wrong.append(f'{code}, not {expected}')

    def _request(self, goal: np.ndarray) -> tuple[str, Any]:
        sent = self._action.send_goal_async(ComputePathToPose.Goal(goal=pose(*map(float, goal))))
        self._caller.wait(sent.done, 'no acceptance')
        answer = sent.result().get_result_async()
        self._caller.wait(answer.done, 'no result', ANSWER_TIMEOUT)
        result = answer.result().result
        return ('NONE' if result.path.poses else CODES.get(result.error_code, '?')), result


def worst_met(trips: list[Trip]) -> tuple[float, float, int]:
    """How often the worst free cell is met, by trips of one way, their value, and their number."""
    free = np.argwhere(warehouse()[::4, ::4] < 99)[:, ::-1] * 4 * RESOLUTION + RESOLUTION / 2
    met = np.zeros(len(free))
    for trip in trips:
        ends = trip.trace[0], ENDS[trip.way]
        secured = np.min([np.hypot(*(trip.trace - end).T) for end in ends], axis=0) <= trip.secured
        outside = np.min([np.hypot(*(free - end).T) for end in ends], axis=0) > trip.secured
        if (~secured).any():
            near, _ = cKDTree(trip.trace[~secured]).query(free, distance_upper_bound=REACH)
            met += (near <= REACH) & outside
    value = float(np.mean([trip.value for trip in trips]))
    return float(met.max() / len(trips)), value, len(trips)


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def nav2_parameters() -> dict[str, object]:
    """The parameters of config/nav2.yaml, without recordings."""
    file = str(ROOT / 'config' / 'nav2.yaml')
    found = parameter_dict_from_yaml_file(file, use_wildcard=True)
    values = {name: parameter_value_to_python(each.value) for name, each in found.items()}
    return {**values, 'recording.enabled': False}


def measure_one(speed: float, trips: int) -> tuple[list[str], bool]:
    """One row of the table, and whether its targets are met."""
    with running_node(nav2_parameters()) as caller:
        patrol = Patrol(caller, speed)
        patrol.begin()
        for each in (patrol.departures, patrol.under_way, patrol.answers, patrol.wrong):
            each.clear()
        before = resident(caller.process.pid)
        patrol.drive(trips)
        grown = resident(caller.process.pid) - before
    driven = [trip for trip in patrol.trips if trip.drawn]
    if not driven:
        raise NoAnswer('no trip got a path')
    ratios = [trip.driven / trip.drawn for trip in driven]
    met = [worst_met([trip for trip in driven if trip.way == way])
           for way in sorted({trip.way for trip in driven})]
    allowed = [float(binom.ppf(0.999, n, min(value, 1.0))) / n for _, value, n in met]
    late = patrol.under_way or [0.0]
    right = (not patrol.wrong and within(late, MEDIAN, LATE)
             and np.mean(ratios) <= MEAN_RATIO and max(ratios) <= WORST_RATIO and all(
                 share <= most for (share, _, _), most in zip(met, allowed, strict=True)))
    for text in patrol.wrong:
        say(text)
    return [
        f'{speed:g}', str(len(driven)),
        ', '.join(f'{kind} {count}' for kind, count in sorted(patrol.answers.items())),
        str(len(patrol.wrong)), f'{np.mean(ratios):.3f} / {max(ratios):.3f}',
        '; '.join(f'{share:.2f} of {value:.3f} (at most {most:.2f} of {n})'
                  for (share, value, n), most in zip(met, allowed, strict=True)),
        *(quantiles([1e3 * each for each in some], 0.99) for some in (patrol.departures, late)),
        f'{grown:+.1f}', 'yes' if right else '**no**', f'{os.getloadavg()[0]:.1f}',
    ], right


def measure(options: Any) -> tuple[str, bool]:
    """All cases: the table, and whether the targets are met."""
    rows, every = [], []
    for speed in options.speeds:
        row, met = measure_one(speed, options.trips)
        say(' | '.join(row))
        rows.append(row)
        every.append(met)
    head = ('m/s', 'trips', 'answers', 'wrong', 'driven / drawn: mean / worst',
            'worst cell met of the value, by way',
            'departures: median / 99 % / largest [ms]',
            'under way: median / 99 % / largest [ms]', 'memory [MB]', 'met', 'load')
    text = (
        f"{conditions('ros-jazzy-rclpy')}.\n\nA warehouse of {WIDTH:g} x {HEIGHT:g} m with the "
        f'parameters of config/nav2.yaml.\n\n'
        f'{table(head, rows)}\n\n'
        f'Targets: every code right; the worst cell met within a binomial interval of 99.9 % of '
        f'the value published at the departures; driven / drawn at most {MEAN_RATIO:g} in '
        f'the mean and {WORST_RATIO:g} at worst, answers under way in '
        f'{1e3 * MEDIAN:g} ms (median) and {1e3 * LATE:g} ms (99 %).'
    )
    return text, all(every)


def main() -> int:
    parser = new_parser(__doc__)
    parser.add_argument('--trips', type=int, default=40, help='of each case')
    parser.add_argument('--speeds', type=float, nargs='+', default=[2.0, 0.5, 0.26], metavar='V',
                        help='of the robot [m/s]')
    options = parser.parse_args()
    return run_and_publish(lambda: measure(options), 'node_motion', options.results)


if __name__ == '__main__':
    sys.exit(main())

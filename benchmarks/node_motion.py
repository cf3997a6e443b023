"""A robot that drives, known by TF, while its costmap changes five times a second.

The robot follows the node's last path at up to ``--speed``. A new goal comes every ten seconds, and
a departure for the present goal is asked for every ``--period`` by the action; every tenth request
is for a goal that cannot be reached, and must be refused with the right code. Meanwhile another
client sends goals, of which only the time until they are accepted counts, in turns to the node and
to an action server that does nothing: what is late there, is late for lack of processors. All of
them are processes of their own. Exit code 1 if a target is missed.

tf2_msgs, map_msgs and nav2_msgs are built by test/interfaces.py where they are not installed.
"""

from __future__ import annotations

import itertools
import json
import os
import sys
import time
from collections import Counter
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from node_neighbours import (
    RATE,
    RESOLUTION,
    SIDE,
    ComputePathToPose,
    costmap,
    neighbour,
    obstacle_at,
)
from node_rig import (
    ANSWER_TIMEOUT,
    PLANNER,
    Caller,
    percentiles,
    pose,
    run_and_publish,
    running_node,
    say,
    spread,
)
from rclpy.action import ActionClient
from report import conditions, new_parser, table
from scipy.ndimage import distance_transform_edt
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

NEW_GOAL, TF_PERIOD = 10.0, 0.02  # s
AWAY = 1.0  # m that goals keep from obstacles
ARRIVED = 3.0  # m from the goal, where the next one comes
# Time from a change of the map to its arrival in the node at the latest [s].
ARRIVAL = 1.0
TF_DELAY = 5  # periods of TF after which the node knows the robot's place at the latest
FIRST_CHANGE = 3.0  # s after the publisher's start, which takes one
# Each tenth request is for a goal that cannot be reached.
UNREACHABLE = 10
CODES = {getattr(ComputePathToPose.Result, name): name
         for name in ('UNKNOWN', 'INVALID_PLANNER', 'TF_ERROR', 'START_OUTSIDE_MAP',
                      'GOAL_OUTSIDE_MAP', 'START_OCCUPIED', 'GOAL_OCCUPIED', 'TIMEOUT',
                      'NO_VALID_PATH')}
# Targets: answers [s] and acceptance [ms], and the share of goals that may be accepted later.
MEDIAN, WORST, ACCEPTED = 0.3, 3.0, 20.0
LATE = {4000: 0.01}  # else 0.001
NAV2 = {'map.preset': 'costmap', 'robot_base_frame': 'base_link', 'route.path_spacing': 0.05,
        'max_planning_time': 10.0, 'game.ambush_radius': 1.0, 'game.secured_radius': 2.0,
        'route.tracking_error': 0.25, 'recording.enabled': False, 'diagnostics.error_hold': 1.0}


class Robot:
    """A robot that follows paths and publishes where it is."""

    def __init__(self, caller: Caller, place: np.ndarray, speed: float) -> None:
        self._publisher = caller.node.create_publisher(TFMessage, '/tf', 100)
        self._clock = caller.node.get_clock()
        self.place, self._speed, self._path = place, speed, place[None]
        self.track = [place]  # since the last request
        self._moved = time.monotonic()
        caller.node.create_timer(TF_PERIOD, self._move)

    def follow(self, path: np.ndarray) -> None:
        """Follow a path (L, 2), after a drive back along the track to where the path begins."""
        track = np.array([*self.track, self.place])
        begin = int(np.argmin(np.hypot(*(track - path[0]).T)))
        self._path = np.concatenate((track[begin:][::-1], path))

    def _move(self) -> None:
        now = time.monotonic()
        left, self._moved = self._speed * (now - self._moved), now
        while left > 0.0 and len(self._path):
            step = self._path[0] - self.place
            length = float(np.hypot(*step))
            if length > left:
                self.place = self.place + step * (left / length)
                break
            self.place, left, self._path = self._path[0], left - length, self._path[1:]
        self.track.append(self.place)
        at = TransformStamped(header=Header(frame_id='map', stamp=self._clock.now().to_msg()),
                              child_frame_id='base_link')
        at.transform.translation.x, at.transform.translation.y = map(float, self.place)
        at.transform.rotation.w = 1.0
        self._publisher.publish(TFMessage(transforms=[at]))


class Run:
    """One run: requests, and their answers. The map changes from ``changes`` on."""

    def __init__(self, caller: Caller, cells: int, speed: float, changes: float) -> None:
        self._caller, self._cells, self._changes = caller, cells, changes
        self._rng, self._size = np.random.default_rng(5), cells * RESOLUTION
        values = costmap(cells)
        self._free = distance_transform_edt(values < 99) * RESOLUTION
        self._blocked = RESOLUTION * (np.argwhere(values == 100)[cells] + 0.5)[::-1]
        middle = slice(2 * cells // 5, 3 * cells // 5)
        self._free[middle, middle] = 0.0  # the closed room
        self._action = ActionClient(caller.node, ComputePathToPose,
                                    f'{PLANNER}/compute_path_to_pose')
        self._robot: Robot | None = None
        self._robot = Robot(caller, self._goal(), speed)
        self.times: list[float] = []  # of departures [s]
        self.refused: Counter[str] = Counter()
        self.wrong: list[str] = []

    def begin(self) -> None:
        """Wait for the map, and have the first plan solved."""
        self._caller.wait(lambda: 'goal_pose' in self._caller.status.get('message', '')
                          and 'alpha_map' not in self._caller.status['message'], 'the map')
        self._caller.wait(self._action.server_is_ready, 'the action')
        while not self.times:  # until the node knows where the robot is
            self._ask(self._goal())
        for each in (self.times, self.refused, self.wrong):
            each.clear()  # targets hold after the first plan

    def drive(self, seconds: float, period: float) -> None:
        """Ask, drive and change the goal for the given time."""
        goal, changed = self._goal(), time.monotonic()
        due = begin = changed
        closed = itertools.cycle(self._unreachable())
        for number in itertools.count(1):
            self._caller.idle_until(due)
            if (now := time.monotonic()) >= begin + seconds:
                return
            due = max(now, due + period)
            if np.hypot(*(self._robot.place - goal)) < ARRIVED or now >= changed + NEW_GOAL:
                changed, goal = now, self._goal()
            self._ask(*(next(closed) if number % UNREACHABLE == 0 else (goal,)))

    def _goal(self) -> np.ndarray:
        """A free place (2,), not near the map's edge or the robot."""
        while True:
            place = self._rng.uniform(0.1 * self._size, 0.9 * self._size, 2)
            near = np.hypot(*(self._robot.place - place)) < self._size / 3 if self._robot else False
            if not near and self._free[_cell(place)] > AWAY:
                return place

    def _unreachable(self) -> list[tuple[np.ndarray, str]]:
        """Goals that cannot be reached, with the codes that say why."""
        return [(self._blocked, 'GOAL_OCCUPIED'),
                (np.array([-self._size, 0.0]), 'GOAL_OUTSIDE_MAP'),
                (np.full(2, 0.5 * self._size), 'NO_VALID_PATH')]

    def _ask(self, goal: np.ndarray, expected: str = '') -> None:
        """Ask for a departure from where the robot is, and follow it; or for the expected code."""
        begin = time.monotonic()
        self._robot.track = [*self._robot.track[-TF_DELAY:], self._robot.place]
        sent = self._action.send_goal_async(ComputePathToPose.Goal(goal=pose(*goal)))
        self._caller.wait(sent.done, 'acceptance')
        answer = sent.result().get_result_async()
        self._caller.wait(answer.done, 'a result', ANSWER_TIMEOUT)
        result, end = answer.result().result, time.monotonic()
        if result.path.poses:
            self.times.append(end - begin)
            if expected:
                self.wrong.append(f'a path instead of {expected}')
            else:
                self._robot.follow(np.array([(each.pose.position.x, each.pose.position.y)
                                             for each in result.path.poses]))
            return
        code = CODES[result.error_code]
        right = {expected} if expected else set()
        if any(self._covered(at, begin, end) for at in self._robot.track):
            right.add('START_OCCUPIED')
        if self._covered(goal, begin, end):
            right.add('GOAL_OCCUPIED')
        self.refused[code] += 1
        if code not in right:
            self.wrong.append(code)
            say(f"{code}, not {' or '.join(right) or 'a path'}: {result.error_msg}"[:300])

    def _covered(self, place: np.ndarray, begin: float, end: float) -> bool:
        """Whether the obstacle was at a place, on the node's map, in a period of time."""
        first, last = ((at - self._changes) * RATE for at in (begin - ARRIVAL, end))
        return any(
            all(low - 1 <= cell <= low + SIDE for cell, low in
                zip(_cell(place), obstacle_at(self._cells, step), strict=True))
            for step in range(max(0, int(first)), int(last) + 1))


def _cell(place: np.ndarray) -> tuple[int, int]:
    column, row = (place / RESOLUTION).astype(int).tolist()
    return row, column


def measure_one(cells: int, whole: bool, options: Any) -> tuple[list[str], bool]:
    """One row of the table, and whether its targets are met."""
    parameters = {**NAV2, 'network.target_nodes': options.nodes}
    with running_node(parameters) as rig, Caller(rig) as caller:
        changes = time.monotonic() + FIRST_CHANGE
        run = Run(caller, cells, options.speed, changes)
        with neighbour(rig, 'maps', cells, whole, changes), neighbour(rig, 'idle'):
            run.begin()
            with neighbour(rig, 'goals', options.seconds) as goals:
                run.drive(options.seconds, options.period)
                accepted, alone = json.loads(goals.communicate()[0])
    share, noise = (float(np.mean(np.array(each) > ACCEPTED)) for each in (accepted, alone))
    median, _, worst = percentiles(run.times)
    met = (not run.wrong and median < MEDIAN and worst < WORST
           and share <= LATE.get(cells, 0.001))
    refused = ', '.join(f'{code} {count}' for code, count in sorted(run.refused.items()))
    return [
        f'{cells} x {cells}, {"whole maps" if whole else "updates"}',
        str(len(run.times) + run.refused.total()), str(len(run.times)), refused,
        str(len(run.wrong)), spread(run.times), spread(accepted),
        f'{100 * share:.2f} % of {len(accepted)}', spread(alone), f'{100 * noise:.2f} %',
        'yes' if met else '**no**',
    ], met


def measure(options: Any) -> tuple[str, bool]:
    """All cases: the table, and whether the targets are met."""
    rows, every = [], []
    for cells in options.cells:
        for whole in (False, True):
            say(f'{cells} x {cells} cells, {"whole" if whole else "updates"}')
            row, met = measure_one(cells, whole, options)
            say(' | '.join(row))
            rows.append([*row, f'{os.getloadavg()[0]:.1f}'])
            every.append(met)
    late = f'later than {ACCEPTED:g} ms'
    head = ('map', 'requests', 'departures', 'refused', 'wrong code',
            'departures: median / 99 % / largest [s]',
            'goals accepted: median / 99 % / largest [ms]', late, 'by an idle server [ms]',
            late, 'met', 'load')
    text = (
        f"{conditions('ros-jazzy-rclpy')}.\n\nA robot at up to {options.speed:g} m/s, known by TF; "
        f'a departure every {options.period:g} s, a new goal every {NEW_GOAL:g} s, a map or an '
        f'update at {RATE:g} Hz, for {options.seconds:g} s.\n\n{table(head, rows)}\n\n'
        f'Targets: a departure or the right code, median < {MEDIAN:g} s, largest < {WORST:g} s, at '
        f'most 0.1 % of the goals accepted {late} (1 % at 4000 x 4000 cells).'
    )
    return text, all(every)


def main() -> int:
    parser = new_parser(__doc__)
    parser.add_argument('--seconds', type=float, default=120.0, help='of each case')
    parser.add_argument('--period', type=float, default=1.0, help='seconds between departures')
    parser.add_argument('--speed', type=float, default=2.0, help='of the robot [m/s]')
    parser.add_argument('--cells', type=int, nargs='+', default=[400, 2000], metavar='N',
                        help="of the map's sides")
    parser.add_argument('--nodes', type=int, default=400, help='of the network')
    options = parser.parse_args()
    return run_and_publish(lambda: measure(options), 'node_motion', options.results)


if __name__ == '__main__':
    sys.exit(main())

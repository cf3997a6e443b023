# SPDX-License-Identifier: Apache-2.0
"""Two processes ask for one robot's path at 5 Hz while a slow disk must record each departure.

One process drives the robot, changes the map every second and asks; the other only asks for the
same goal. Every flush to the node's disk takes a quarter of a second, and ``recording.required`` is
set. Exit code 1 if a trip has more than one departure although its path was clear, if a request was
refused for another reason than a blocked goal, or if a recording does not verify.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from node_motion import Robot
from node_rig import (
    LATCHED,
    TIMEOUT,
    Caller,
    NodeSilent,
    Rig,
    pose,
    run_and_publish,
    running_node,
    say,
    spread,
)
from node_soak import grid
from report import conditions, new_parser, table
from std_msgs.msg import Header

from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.planning.clear_ground import ClearGround
from ambush_planner.recordings import RecordedDeparture, read_departures
from ambush_planner.recordings.verify import Verifier, together

SPEED, PERIOD = 2.0, 0.2  # m/s of the robot; s between the requests of a process
PATIENCE = 0.3  # s without an answer after which the robot stops
ARRIVED = 0.4  # m
FLUSH = 0.25  # s that every flush of the node's disk takes
GOAL_TOPIC = '/trip_goal'
# Loaded by the node's interpreter: a disk that is slow to flush.
SLOW_DISK = f"""
import os, time
flush = os.fsync
def slow(descriptor):
    time.sleep({FLUSH})
    flush(descriptor)
os.fsync = slow
"""


def goal_of(trip: int) -> tuple[float, float]:
    """The goal of a trip [m]: to and fro."""
    return (55.0, 5.0)[trip % 2], 15.0 + 5.0 * (trip // 2 % 6)


class Asker:
    """Asks for the robot's path; ``paths`` gets each that comes."""

    def __init__(self, caller: Caller) -> None:
        self._caller, self._pending = caller, []
        self.here = PoseStamped(header=Header(frame_id='base_link'))
        self.here.pose.orientation.w = 1.0
        self.asked, self.refused, self.times = 0, 0, []
        self.path: np.ndarray | None = None

    def ask(self, goal: tuple[float, float]) -> None:
        request = GetPlan.Request(start=self.here, goal=pose(*goal))
        self._pending.append((time.monotonic(), goal, self._caller.send(GetPlan, 'get_plan',
                                                                      request)))
        self.asked += 1

    def take(self, goal: tuple[float, float]) -> None:
        """Take the answers that have come; the latest one for this goal is the ``path``."""
        for each in list(self._pending):
            begin, asked_for, answer = each
            if answer.done():
                self._pending.remove(each)
                self.times.append(1e3 * (time.monotonic() - begin))
                path = path_from_ros(answer.result().plan)[:, :2]
                self.refused += not len(path)
                if len(path) and asked_for == goal:
                    self.path = path

    @property
    def waits(self) -> float:
        """How long the oldest request has waited [s]."""
        return time.monotonic() - self._pending[0][0] if self._pending else 0.0


def drive(caller: Caller, seconds: float) -> dict[str, Any]:
    """Drive to and fro, change the map and ask."""
    robot, asker, trip = Robot(caller, np.array(goal_of(-1)), SPEED), Asker(caller), 0
    goals = caller.node.create_publisher(PoseStamped, GOAL_TOPIC, LATCHED)
    caller.publisher(OccupancyGrid, '/alpha_map').publish(grid(0, robot.place))
    caller.idle_until(time.monotonic() + 5.0)  # the node has map and robot before anybody asks
    goals.publish(pose(*goal_of(trip)))
    end = time.monotonic() + seconds
    for k in range(int(seconds / PERIOD)):
        if k % round(1.0 / PERIOD) == 0:
            caller.publisher(OccupancyGrid, '/alpha_map').publish(
                grid(round(k * PERIOD), robot.place))
        if np.hypot(*(robot.place - goal_of(trip))) <= ARRIVED and end - time.monotonic() > 10.0:
            trip += 1
            goals.publish(pose(*goal_of(trip)))
            asker.path = None
        asker.ask(goal_of(trip))
        caller.idle_until(time.monotonic() + PERIOD)
        asker.take(goal_of(trip))
        waits = asker.path is None or asker.waits > PATIENCE
        robot.path = robot.place[None] if waits else asker.path
    return {'trips': trip + 1, **results_of(asker)}


def follow(caller: Caller, seconds: float) -> dict[str, Any]:
    """Ask for the goal that the other process names."""
    asker, goals = Asker(caller), []
    caller.node.create_subscription(PoseStamped, GOAL_TOPIC, goals.append, LATCHED)
    caller.wait(lambda: goals, 'a goal', 10 * TIMEOUT)
    for _ in range(int(seconds / PERIOD)):
        place = goals[-1].pose.position
        asker.ask((place.x, place.y))
        caller.idle_until(time.monotonic() + PERIOD)
        asker.take((place.x, place.y))
    return results_of(asker)


def results_of(asker: Asker) -> dict[str, Any]:
    return {'asked': asker.asked, 'refused': asker.refused, 'times': asker.times}


def run(seconds: float) -> tuple[str, bool]:
    """Start the node and both processes, and judge the recordings."""
    parameters = {'network.spacing': 2.0, 'robot_base_frame': 'base_link',
                  'recording.required': True, 'transform.max_age': 10.0}
    with tempfile.TemporaryDirectory(prefix='ambush_planner_') as name:
        slow = Path(name) / 'slow'
        slow.mkdir()
        (slow / 'sitecustomize.py').write_text(SLOW_DISK)
        before = os.environ.get('PYTHONPATH', '')
        os.environ['PYTHONPATH'] = os.pathsep.join([str(slow), before])
        with running_node(parameters, Path(name)) as rig:
            os.environ['PYTHONPATH'] = before
            askers = [subprocess.Popen(
                [sys.executable, __file__, '--ask', what, '--domain', str(rig.domain),
                 '--seconds', str(seconds)], stdout=subprocess.PIPE, text=True)
                for what in ('driver', 'follower')]
            said = [json.loads(each.communicate()[0]) for each in askers]
        files = sorted(rig.recordings.rglob('*.mcap'))
        verifier = Verifier()
        verdicts = [verifier.verify(each) for each in files]
        problems = [f'{each.path.name}: {problem}' for each in verdicts
                    for problem in each.problems] + together(verdicts)[0]
        departures = read_departures(files, lambda error: problems.append(str(error)))
        return results(said, departures, len(files), problems)


def second_departures(departures: Sequence[RecordedDeparture]) -> tuple[int, int]:
    """Departures to the same goal as the one before, and how many had a clear path left."""
    again = clear = 0
    for one, other in zip(departures, departures[1:], strict=False):
        if one.metadata.ends[1] != other.metadata.ends[1]:
            continue
        again += 1
        path, place = one.path_poses[:, :2], np.array(other.metadata.ends[0])
        rest = np.vstack((place, path[int(np.hypot(*(path - place).T).argmin()) + 1:]))
        ground = ClearGround(other.newest, other.parameters.occupancy,
                             other.parameters.planning.network)
        clear += bool(len(rest) > 1 and ground.drivable_steps(rest).all())
    return again, clear


def results(said: Sequence[dict[str, Any]], departures: Sequence[RecordedDeparture], files: int,
            problems: Sequence[str]) -> tuple[str, bool]:
    """The table, and whether the targets are met."""
    trips, times = said[0]['trips'], [time for each in said for time in each['times']]
    again, clear = second_departures(departures)
    diverted = Counter(len(each.parts) - 1 for each in departures)
    met = not problems and not clear and len(departures) - again <= trips
    met = met and not any(each['refused'] for each in said)
    rows = [
        ['trips, departures', f'{trips}, {len(departures)}'],
        ['departures to the same goal again: its path blocked and no other rest clear; **else**',
         f'{again - clear}; **{clear}**'],
        ['departures by how often they were diverted',
         ', '.join(f'{each}: {diverted[each]}' for each in sorted(diverted))],
        ['requests, refused', f'{sum(each["asked"] for each in said)}, '
                              f'{sum(each["refused"] for each in said)}'],
        ['answers, median / 99 % / largest [ms]', spread(times or [np.nan])],
        ['recordings, verified', f'{files}, ' + ('; '.join(problems[:5]) or 'all hold')],
    ]
    text = (f'Two processes ask for one robot at {1 / PERIOD:g} Hz each, with '
            f'`recording.required`, {FLUSH:g} s per flush of the disk, and a new map every second. '
            f"{conditions('ros-jazzy-rclpy')}.\n\n{table(('', ''), rows)}\n\nTarget: one "
            'departure a trip unless all rests of the plan are blocked, no request refused, all '
            f'recordings hold; {"met" if met else "**missed**"}.')
    return text, met


def ask(what: str, domain: int, seconds: float) -> None:
    """Be one of the processes that ask, and print what has come."""
    rig = Rig(SimpleNamespace(check=lambda: None), domain, Path())
    with Caller(rig) as caller:
        caller.client(GetPlan, 'get_plan')
        print(json.dumps((drive if what == 'driver' else follow)(caller, seconds)))


def main() -> int:
    parser = new_parser(__doc__)
    parser.add_argument('--seconds', type=float, default=600.0, help='duration')
    parser.add_argument('--ask', choices=('driver', 'follower'), help='be one of the processes')
    parser.add_argument('--domain', type=int, help='their ROS domain')
    options = parser.parse_args()
    if options.ask:
        try:
            ask(options.ask, options.domain, options.seconds)
        except NodeSilent as error:
            say(str(error))
            return 2
        return 0
    return run_and_publish(lambda: run(options.seconds), 'node_two_askers', options.results)


if __name__ == '__main__':
    sys.exit(main())

"""Departures while the map changes every second, and while the goal moves a little.

The node is a process of its own and gets the whole map each time; times are the caller's, from the
request to the answer read, in milliseconds. Exit code 1 if a target is missed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from node_rig import (
    EMPTY,
    FAILURES,
    FRAME,
    Caller,
    empty_service,
    field,
    percentiles,
    pose,
    processor_time,
    resident,
    running_node,
    say,
    scratch,
)
from node_timings import stopwatch
from report import RESULTS, conditions, table, write_block
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ambush_planner.maps.ros_messages import occupancy_from_ros
from ambush_planner.ros.conversions import occupancy_to_ros

RESOLUTION = 0.5
SIDE = 3  # cells, of an obstacle that is somewhere else each second
PERIOD = 0.2  # s, of departures and goals
MEDIAN, SELDOM = 100.0, 500.0  # ms, targets


@dataclass(frozen=True)
class Found:
    """Times of departures and of a service that does nothing [ms], the node's processor time for
    each departure with all else [ms], how many solves there were, and its memory [MB]."""

    times: list[float]
    nothing: list[float]
    processor: float
    solves: int
    maps: int
    memory: tuple[float, float]


def run(caller: Caller, pid: int, seconds: float, change: Callable[[float], int]) -> Found:
    """Depart every ``PERIOD``; ``change`` is called before each with the time passed [s]."""
    solved = {caller.status['solve_seconds']}
    begin, maps, before = time.monotonic(), 0, resident(pid)
    times, nothing, used = [], [], processor_time(pid)
    for k in range(int(seconds / PERIOD)):
        caller.idle_until(begin + k * PERIOD)
        maps += change(time.monotonic() - begin)
        times.append(stopwatch(caller.new_route))
        nothing.append(stopwatch(lambda: caller.call(Trigger, EMPTY)))
        solved.add(caller.status['solve_seconds'])
    used = (processor_time(pid) - used) / len(times)
    return Found(times, nothing, used, len(solved) - 1, maps, (before, resident(pid)))


def changing_map(caller: Caller, values: np.ndarray) -> Callable[[float], int]:
    """Publish the map once a second; each time an obstacle of 3 x 3 cells is somewhere else."""
    rng, published = np.random.default_rng(7), [0]
    publisher = caller.publisher(OccupancyGrid, '/alpha_map')

    def change(passed: float) -> int:
        if passed < published[0]:
            return 0
        published[0] += 1
        row, column = rng.integers(0, len(values) - SIDE, 2)
        current = values.copy()
        current[row:row + SIDE, column:column + SIDE] = 100
        header = Header(frame_id=FRAME, stamp=caller.node.get_clock().now().to_msg())
        publisher.publish(occupancy_to_ros(current, RESOLUTION, (0.0, 0.0, 0.0), header))
        return 1

    return change


def moving_goal(caller: Caller, goal: PoseStamped) -> Callable[[float], int]:
    """Publish a goal up to a metre from the planned one, within the tolerance."""
    rng = np.random.default_rng(8)
    publisher = caller.publisher(PoseStamped, '/goal_pose')

    def change(_: float) -> int:
        x, y = rng.uniform(-0.7, 0.7, 2)
        publisher.publish(pose(goal.pose.position.x + x, goal.pose.position.y + y))
        return 0

    return change


def measure(seconds: float, cells: int, nodes: int) -> dict[str, Found]:
    """Both cases, on one node."""
    grid, size = field(cells, RESOLUTION), cells * RESOLUTION
    parameters = {'network.target_nodes': nodes, 'recording.enabled': False}
    start, goal = pose(size / 20, size / 2), pose(size * 19 / 20, size / 2)
    with (
        scratch() as folder,
        running_node(folder, parameters) as rig,
        empty_service(rig.domain),
        Caller(rig.domain, rig.process.check) as caller,
    ):
        caller.give(grid, start, goal)
        say('the first solve')
        caller.new_route()
        found = {}
        for name, change in (
            (f'the goal moves within the tolerance, every {PERIOD:g} s', moving_goal(caller, goal)),
            (f'an obstacle of {SIDE} x {SIDE} cells jumps, once a second',
             changing_map(caller, occupancy_from_ros(grid)[0])),
        ):
            say(f'{name}, for {seconds:g} s')
            found[name] = run(caller, rig.process.pid, seconds, change)
        return found


def result(found: dict[str, Found], cells: int, nodes: int) -> tuple[str, bool]:
    """The table, and whether the targets are met."""
    rows, every = [], []
    for name, each in found.items():
        median, seldom, largest = percentiles(each.times)
        every.append(median < MEDIAN and seldom < SELDOM)
        rows.append([
            name, str(len(each.times)), f'{median:.3g} / {seldom:.3g} / {largest:.3g}',
            ' / '.join(f'{value:.3g}' for value in percentiles(each.nothing)),
            f'{each.processor:.3g}',
            f'< {MEDIAN:g} / {SELDOM:g}', 'yes' if every[-1] else '**no**', str(each.maps),
            str(each.solves), f'{each.memory[0]:.0f} -> {each.memory[1]:.0f}',
        ])
    head = ('meanwhile', 'departures', '`new_route` answered: median / 99 % / largest [ms]',
            'a service that does nothing, of another process',
            "node's processor time for each [ms]", 'target', 'met', 'maps', 'solves', 'memory [MB]')
    text = (
        f'A map of {cells} x {cells} cells, published whole each time, {nodes} nodes; a departure '
        f'every {PERIOD:g} s.\n\n{table(head, rows)}'
    )
    return text, all(every)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument('--seconds', type=float, default=60.0, help='of each case')
    parser.add_argument('--cells', type=int, default=4000, metavar='N', help="of the map's sides")
    parser.add_argument('--nodes', type=int, default=10_000, metavar='N', help='of the network')
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `node_ground` is replaced'
    )
    options = parser.parse_args()
    try:
        found = measure(options.seconds, options.cells, options.nodes)
        text, met = result(found, options.cells, options.nodes)
    except FAILURES as error:
        say(f'node_ground: {error}')
        return 2
    text = f"{conditions('ros-jazzy-rclpy')}.\n\n{text}"
    print(text)
    write_block(options.results, 'node_ground', text)
    return int(not met)


if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Departures while the map changes every second, and while the goal moves slightly.

The node is a process of its own and receives the whole map each time. Times are the caller's [ms],
from the request to the answer read. Exit code 1 if a target is missed.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from node_rig import (
    Caller,
    Rig,
    grid_of,
    percentiles,
    pose,
    resident,
    rough_map,
    run_and_publish,
    running_node,
    say,
    spread,
    stopwatch,
)
from report import conditions, new_parser, table

from ambush_planner.maps.ros_messages import occupancy_from_ros

RESOLUTION = 0.5
SIDE = 3  # cells, of the obstacle
PERIOD = 0.2  # s, of departures and goals
# Targets for the median and 99th percentile [ms].
MEDIAN, SELDOM = 100.0, 500.0


def depart_during(
    caller: Caller, rig: Rig, seconds: float, change: Callable[[float], None]
) -> tuple[list[str], bool]:
    """Depart every ``PERIOD``; ``change`` is called before with the elapsed time [s]."""
    solved = {caller.status['solve_seconds']}
    begin, before = time.monotonic(), resident(rig.process.pid)
    times = []
    for k in range(int(seconds / PERIOD)):
        caller.idle_until(begin + k * PERIOD)
        change(time.monotonic() - begin)
        times.append(stopwatch(lambda: caller.trigger('new_route')))
        solved.add(caller.status['solve_seconds'])
    median, seldom, _ = percentiles(times)
    met = median < MEDIAN and seldom < SELDOM
    return [
        str(len(times)), spread(times), f'< {MEDIAN:g} / {SELDOM:g}',
        'yes' if met else '**no**', str(len(solved) - 1),
        f'{before:.0f} -> {resident(rig.process.pid):.0f}',
    ], met


def moving_obstacle(caller: Caller, values: np.ndarray) -> Callable[[float], None]:
    """Publish the map once a second with an obstacle at a new place."""
    rng, seconds = np.random.default_rng(7), iter(range(1_000_000))
    publisher, due = caller.publisher(OccupancyGrid, '/alpha_map'), next(seconds)

    def change(elapsed: float) -> None:
        nonlocal due
        if elapsed >= due:
            due = next(seconds)
            row, column = rng.integers(0, len(values) - SIDE, 2)
            current = values.copy()
            current[row:row + SIDE, column:column + SIDE] = 100
            grid = grid_of(current, RESOLUTION)
            grid.header.stamp = caller.node.get_clock().now().to_msg()
            publisher.publish(grid)

    return change


def moving_goal(caller: Caller, goal: PoseStamped) -> Callable[[float], None]:
    """Publish a goal up to a metre from the planned one, within the tolerance."""
    rng = np.random.default_rng(8)
    publisher = caller.publisher(PoseStamped, '/goal_pose')

    def change(_: float) -> None:
        x, y = rng.uniform(-0.7, 0.7, 2)
        publisher.publish(pose(goal.pose.position.x + x, goal.pose.position.y + y))

    return change


def measure(seconds: float, cells: int, nodes: int) -> tuple[str, bool]:
    """Both cases on one node; the table, and whether the targets are met."""
    grid, size = rough_map(cells, RESOLUTION), cells * RESOLUTION
    start, goal = pose(size / 20, size / 2), pose(size * 19 / 20, size / 2)
    with (
        running_node({'network.target_nodes': nodes, 'recording.enabled': False}) as rig,
        Caller(rig) as caller,
    ):
        caller.give(grid, start, goal)
        say('the first solve')
        caller.trigger('new_route')
        rows, every = [], []
        for name, change in (
            (f'the goal moves within the tolerance, every {PERIOD:g} s', moving_goal(caller, goal)),
            (f'an obstacle of {SIDE} x {SIDE} cells jumps, once a second',
             moving_obstacle(caller, occupancy_from_ros(grid)[0])),
        ):
            say(f'{name}, for {seconds:g} s')
            cells_of_row, met = depart_during(caller, rig, seconds, change)
            rows.append([name, *cells_of_row])
            every.append(met)
    head = ('meanwhile', 'departures', '`new_route` answered: median / 99 % / largest [ms]',
            'target', 'met', 'solves', 'memory [MB]')
    text = (
        f"{conditions('ros-jazzy-rclpy')}.\n\nA map of {cells} x {cells} cells, published whole "
        f'each time, {nodes} nodes; a departure every {PERIOD:g} s.\n\n{table(head, rows)}'
    )
    return text, all(every)


def main() -> int:
    parser = new_parser(__doc__)
    parser.add_argument('--seconds', type=float, default=60.0, help='of each case')
    parser.add_argument('--cells', type=int, default=4000, metavar='N', help="of the map's sides")
    parser.add_argument('--nodes', type=int, default=10_000, metavar='N', help='of the network')
    options = parser.parse_args()
    return run_and_publish(
        lambda: measure(options.seconds, options.cells, options.nodes),
        'node_map_changes', options.results,
    )


if __name__ == '__main__':
    sys.exit(main())

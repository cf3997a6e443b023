# SPDX-License-Identifier: Apache-2.0
"""How soon the node answers with a route of a known strategy, and while its inputs change.

The goal moves within its tolerance, or the map changes every second.

The node is a process of its own. Times are the caller's [ms], from the request to the answer read.
Exit code 1 if a target is missed.
"""

from __future__ import annotations

import math
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
    pose,
    processor_time,
    resident,
    rough_map,
    run_and_publish,
    running_node,
    say,
    spread,
    stopwatch,
    within,
)
from report import conditions, new_parser, table

from ambush_planner.maps.ros_messages import occupancy_from_ros

# A map of 100 m x 100 m.
CELLS, RESOLUTION = 200, 0.5
START, GOAL = pose(5.0, 50.0), pose(95.0, 50.0)
# Interval of calls [s].
PERIOD = 0.05
# Targets for the median and 99th percentile of departures with recording [ms], and for their files
# [kB].
TARGETS, MAX_FILE = {'new_route': (8.0, 20.0), 'get_plan': (15.0, math.inf)}, 300.0
# Routes on the map are about 125 m long: about 500 poses.
PATH = {'route.path_spacing': 0.25}
# Side of the obstacle that jumps [cells], and interval of departures and goals meanwhile [s].
SIDE, MEANWHILE = 3, 0.2
# Targets for the median and 99th percentile of `new_route` meanwhile [ms].
MEDIAN_MEANWHILE, SELDOM_MEANWHILE = 100.0, 500.0

def timed(caller: Caller, calls: int, call: Callable[[], object]) -> list[float]:
    """Times of calls at regular intervals."""
    times, begin = [], time.monotonic()
    for k in range(calls):
        caller.idle_until(begin + k * PERIOD)
        times.append(stopwatch(call))
    return times


def departures(calls: int, nodes: int) -> tuple[str, bool]:
    """Time departures with and without recording; the table, and whether the target is met."""
    rows, every = [], []
    for recording in (True, False):
        settings = {'network.target_nodes': nodes, 'recording.enabled': recording, **PATH}
        say(f'{calls} departures of each kind, recording {recording}')
        with running_node(settings) as rig, Caller(rig) as caller:
            caller.give(rough_map(CELLS, RESOLUTION), START, GOAL)
            for name, call in (
                ('new_route', lambda: caller.trigger('new_route')),
                ('get_plan', lambda: caller.get_plan(START, GOAL)),
            ):
                call()  # which may solve the game
                before = processor_time(rig.process.pid)
                times = timed(caller, calls, call)
                each = (processor_time(rig.process.pid) - before) / calls
                if recording:
                    every.append(within(times, *TARGETS[name]))
                rows.append([
                    f'`{name}`', 'on' if recording else 'off', spread(times), f'{each:.1f}',
                    *(('< {:g} / {:g}'.format(*TARGETS[name]), 'yes' if every[-1] else '**no**')
                      if recording else ('', '')),
                ])
            if recording:
                sizes = [file.stat().st_size for file in rig.recordings.rglob('*.mcap')]
    size = max(sizes) / 1e3
    every.append(size <= MAX_FILE)
    head = ('departure', 'recording', 'median / 99 % / largest [ms]',
            "the node's processor time [ms]", 'target', 'met')
    text = (
        f'### A departure on a known strategy ({nodes} nodes)\n\n{calls} calls for each row, one '
        f'every {1e3 * PERIOD:g} ms. The answer of `get_plan` has the path. A recording has up to '
        f'{size:.0f} kB (target: {MAX_FILE:g}).\n\n{table(head, rows)}'
    )
    return text, all(every)


def depart_during(
    caller: Caller, rig: Rig, seconds: float, change: Callable[[float], None]
) -> tuple[list[str], bool]:
    """Depart every ``MEANWHILE``; ``change`` is called before with the elapsed time [s]."""
    solved = {caller.status['solve_seconds']}
    begin, before = time.monotonic(), resident(rig.process.pid)
    times = []
    for k in range(int(seconds / MEANWHILE)):
        caller.idle_until(begin + k * MEANWHILE)
        change(time.monotonic() - begin)
        times.append(stopwatch(lambda: caller.trigger('new_route')))
        solved.add(caller.status['solve_seconds'])
    met = within(times, MEDIAN_MEANWHILE, SELDOM_MEANWHILE)
    return [
        str(len(times)), spread(times), f'< {MEDIAN_MEANWHILE:g} / {SELDOM_MEANWHILE:g}',
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


def meanwhile(seconds: float, cells: int, nodes: int) -> tuple[str, bool]:
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
            (f'the goal moves within the tolerance, every {MEANWHILE:g} s',
             moving_goal(caller, goal)),
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
        f'### While the map changes\n\nA map of {cells} x {cells} cells, published whole '
        f'each time, {nodes} nodes; a departure every {MEANWHILE:g} s.\n\n{table(head, rows)}'
    )
    return text, all(every)


def main() -> int:
    parser = new_parser(__doc__)
    parser.add_argument('--calls', type=int, default=500, metavar='N', help='departures in a row')
    parser.add_argument('--nodes', type=int, default=10_000, metavar='N', help='of the network')
    parser.add_argument('--seconds', type=float, default=60.0, help='of each case meanwhile')
    parser.add_argument('--cells', type=int, default=4000, metavar='N',
                        help='of the sides of the map that changes')
    options = parser.parse_args()

    def measure() -> tuple[str, bool]:
        parts = (departures(options.calls, options.nodes),
                 meanwhile(options.seconds, options.cells, options.nodes))
        text = '\n\n'.join((f"{conditions('ros-jazzy-rclpy')}.", *(part for part, _ in parts)))
        return text, all(met for _, met in parts)

    return run_and_publish(measure, 'node_latency', options.results)


if __name__ == '__main__':
    sys.exit(main())

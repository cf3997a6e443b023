# SPDX-License-Identifier: Apache-2.0
"""How soon the node answers with a route of a known strategy, and while its map changes.

The node is a process of its own. Times are the caller's [ms], from the request to the answer read.
Exit code 1 if a target is missed.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable

import numpy as np
from nav_msgs.msg import OccupancyGrid
from node_rig import (
    Caller,
    grid_of,
    pose,
    processor_time,
    resident,
    rough_map,
    run_and_publish,
    running_node,
    say,
    stopwatch,
    within,
)
from report import conditions, new_parser, quantiles, table

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
# Side of the obstacle that jumps [cells], interval of departures meanwhile [s], and of jumps.
SIDE, MEANWHILE, JUMP = 3, 0.2, 5
# Targets for the median and 99th percentile of `new_route` meanwhile [ms].
MEDIAN_MEANWHILE, SELDOM_MEANWHILE = 100.0, 500.0

def departures(calls: int, nodes: int) -> tuple[str, bool]:
    """Time departures that are recorded; the table, and whether the targets are met."""
    rows, every = [], []
    say(f'{calls} departures of each kind')
    with running_node({'network.target_nodes': nodes, **PATH}) as caller:
        caller.give(rough_map(CELLS, RESOLUTION), START, GOAL)
        for name, call in (
            ('new_route', lambda: caller.trigger('new_route')),
            ('get_plan', lambda: caller.get_plan(START, GOAL)),
        ):
            call()  # which may solve the game
            before, times, begin = processor_time(caller.process.pid), [], time.monotonic()
            for k in range(calls):
                caller.idle_until(begin + k * PERIOD)
                times.append(stopwatch(call))
            each = (processor_time(caller.process.pid) - before) / calls
            every.append(within(times, *TARGETS[name]))
            rows.append([f'`{name}`', quantiles(times, 0.99), f'{each:.1f}',
                         '< {:g} / {:g}'.format(*TARGETS[name]), 'yes' if every[-1] else '**no**'])
        size = max(file.stat().st_size for file in caller.folder.rglob('*.mcap')) / 1e3
    every.append(size <= MAX_FILE)
    head = ('departure', 'median / 99 % / largest [ms]', "the node's processor time [ms]", 'target',
            'met')
    text = (
        f'### A departure on a known strategy ({nodes} nodes)\n\n{calls} calls for each row, one '
        f'every {1e3 * PERIOD:g} ms. The answer of `get_plan` has the path. A recording has up to '
        f'{size:.0f} kB (target: {MAX_FILE:g}).\n\n{table(head, rows)}'
    )
    return text, all(every)


def moving_obstacle(caller: Caller, values: np.ndarray) -> Callable[[int], None]:
    """Publish the map before every fifth departure with an obstacle at a new place."""
    rng, publisher = np.random.default_rng(7), caller.publisher(OccupancyGrid, '/alpha_map')

    def change(number: int) -> None:
        if number % JUMP == 0:
            row, column = rng.integers(0, len(values) - SIDE, 2)
            current = values.copy()
            current[row:row + SIDE, column:column + SIDE] = 100
            grid = grid_of(current, RESOLUTION)
            grid.header.stamp = caller.node.get_clock().now().to_msg()
            publisher.publish(grid)

    return change


def meanwhile(seconds: float, cells: int, nodes: int) -> tuple[str, bool]:
    """Depart every ``MEANWHILE`` while an obstacle jumps; the table, and if the target is met."""
    grid, size, times = rough_map(cells, RESOLUTION), cells * RESOLUTION, []
    start, goal = pose(size / 20, size / 2), pose(size * 19 / 20, size / 2)
    with running_node({'network.target_nodes': nodes, 'recording.enabled': False}) as caller:
        caller.give(grid, start, goal)
        say('the first solve')
        caller.trigger('new_route')
        say(f'the map changes for {seconds:g} s')
        change, solved = moving_obstacle(caller, occupancy_from_ros(grid)[0]), set[str]()
        begin, before = time.monotonic(), resident(caller.process.pid)
        for k in range(int(seconds / MEANWHILE)):
            caller.idle_until(begin + k * MEANWHILE)
            solved.add(caller.status['solve_seconds'])
            change(k)
            times.append(stopwatch(lambda: caller.trigger('new_route')))
        grown = f'{before:.0f} -> {resident(caller.process.pid):.0f}'
    met = within(times, MEDIAN_MEANWHILE, SELDOM_MEANWHILE)
    head = ('departures', '`new_route` answered: median / 99 % / largest [ms]', 'target', 'met',
            'solves', 'memory [MB]')
    row = [str(len(times)), quantiles(times, 0.99), f'< {MEDIAN_MEANWHILE:g} / '
           f'{SELDOM_MEANWHILE:g}', 'yes' if met else '**no**', str(len(solved) - 1), grown]
    text = (
        f'### While the map changes\n\nA map of {cells} x {cells} cells, published whole '
        f'each time, {nodes} nodes; a departure every {MEANWHILE:g} s. An obstacle of {SIDE} x '
        f'{SIDE} cells jumps, once a second.\n\n{table(head, [row])}'
    )
    return text, met


def main() -> int:
    parser = new_parser(__doc__)
    parser.add_argument('--calls', type=int, default=500, metavar='N', help='departures in a row')
    parser.add_argument('--nodes', type=int, default=10_000, metavar='N', help='of the network')
    parser.add_argument('--seconds', type=float, default=60.0, help='while the map changes')
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

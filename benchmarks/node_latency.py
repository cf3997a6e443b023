# SPDX-License-Identifier: Apache-2.0
"""How soon the node answers: during a long solve, with a route of a known strategy, and meanwhile.

Meanwhile, the goal moves within its tolerance, or the map changes every second.

The node is a process of its own. Times are the caller's [ms], from the request to the answer read.
Exit code 1 if a target is missed.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from node_rig import (
    Caller,
    NodeSilent,
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
from rcl_interfaces.srv import DescribeParameters
from report import conditions, new_parser, table
from std_msgs.msg import Header

from ambush_planner.maps.ros_messages import occupancy_from_ros

# A map of 100 m x 100 m.
CELLS, RESOLUTION = 200, 0.5
START, GOAL = pose(5.0, 50.0), pose(95.0, 50.0)
# Interval of calls [s].
PERIOD = 0.05
# Target for the 99th percentile during a solve [ms].
DURING_SOLVE = 50.0
# Targets for the median and 99th percentile of departures with recording [ms], and for their files
# [kB].
TARGETS, MAX_FILE = {'new_route': (8.0, 20.0), 'get_plan': (15.0, math.inf)}, 300.0
# Routes on the map are about 125 m long: about 500 poses.
PATH = {'route.path_spacing': 0.25}
QUICK = {
    'strategy.solver': 'max_entropy', 'network.spacing': 5.0, 'max_planning_time': 60.0,
}
# The paper's simplex method needs minutes for 40 000 nodes.
SLOW = {'strategy.solver': 'simplex', 'network.spacing': 0.5, 'max_planning_time': 3600.0}

# Side of the obstacle that jumps [cells], and interval of departures and goals meanwhile [s].
SIDE, MEANWHILE = 3, 0.2
# Targets for the median and 99th percentile of `new_route` meanwhile [ms].
MEDIAN_MEANWHILE, SELDOM_MEANWHILE = 100.0, 500.0

Samples = dict[str, list[float]]
Calls = Mapping[str, Callable[[], object]]


def during_a_solve(samples: int) -> tuple[str, bool]:
    """Call the node in turns, idle and during a solve; return the table and whether it passed."""
    with running_node(QUICK) as rig, Caller(rig) as caller:
        caller.give(rough_map(CELLS, RESOLUTION), START, GOAL)
        caller.trigger('new_route')
        say('calls to an idle node')
        calls = cheap_calls(caller)
        idle = alternate(caller, samples, calls)
        caller.set_parameters(SLOW)
        answer = caller.send('new_route')
        caller.wait(lambda: caller.status['state'] == 'solving', 'the solve to begin')
        caller.set_parameters(QUICK)
        say('the same calls during a solve')
        during = alternate(caller, samples, calls)
        if answer.done() or caller.status['state'] != 'solving':
            raise NodeSilent('the solve ended before the calls; use fewer --samples')
        cancel = stopwatch(lambda: caller.call('cancel'))
        caller.wait(answer.done, 'the answer of the cancelled solve')
    seldom = {name: [float(np.quantile(each[name], 0.99)) for each in (during, idle)]
              for name in during}
    met = {name: times[0] < DURING_SOLVE for name, times in seldom.items()}
    rows = [
        [name, f'**{seldom[name][0] / seldom[name][1]:.2f}x**',
         spread(times), spread(idle[name]), 'yes' if met[name] else '**no**']
        for name, times in during.items()
    ]
    head = ('median / 99 % / largest [ms]', '99 %, during : idle', 'during the solve', 'idle',
            f'99 % < {DURING_SOLVE:g} ms')
    text = (
        '### During a solve of minutes (simplex, 40 000 nodes)\n\n'
        f'{samples} calls of each kind in turns, one every {1e3 * PERIOD:g} ms. `cancel` ended the '
        f'solve in {cancel:.3g} ms.\n\n{table(head, rows)}'
    )
    return text, all(met.values())


def cheap_calls(caller: Caller) -> Calls:
    """Calls that need no solve."""
    return {
        'service `get_parameters`': caller.get_parameter,
        'service `describe_parameters`': lambda: caller.call(
            'describe_parameters', DescribeParameters.Request(names=['map.alpha_min'])),
        'service `get_plan`, strategy known': lambda: caller.get_plan(START, GOAL),
        'bad map to its diagnostics': bad_maps(caller),
    }


def alternate(caller: Caller, samples: int, calls: Calls) -> Samples:
    """Times of several kinds of calls, which alternate at regular intervals."""
    times: Samples = {name: [] for name in calls}
    begin = time.monotonic()
    for k in range(samples * len(calls)):
        caller.idle_until(begin + k * PERIOD)
        name = list(calls)[k % len(calls)]
        times[name].append(stopwatch(calls[name]))
    return times


def bad_maps(caller: Caller) -> Callable[[], None]:
    """A function that publishes another invalid map and waits for its diagnostics."""
    publisher = caller.publisher(OccupancyGrid, '/alpha_map')
    widths = iter(range(1, 1_000_000))

    def publish_bad_map() -> None:
        bad = OccupancyGrid(header=Header(frame_id='map'))
        bad.info.width = next(widths)
        publisher.publish(bad)
        text = f'width {bad.info.width},'
        caller.wait(lambda: text in caller.status['message'], 'diagnostics of a bad map')

    return publish_bad_map


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
                times = alternate(caller, calls, {name: call})[name]
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
    parser.add_argument(
        '--samples', type=int, default=300, metavar='N', help='calls of each kind and state'
    )
    parser.add_argument('--calls', type=int, default=500, metavar='N', help='departures in a row')
    parser.add_argument('--nodes', type=int, default=10_000, metavar='N', help='of the network')
    parser.add_argument('--seconds', type=float, default=60.0, help='of each case meanwhile')
    parser.add_argument('--cells', type=int, default=4000, metavar='N',
                        help='of the sides of the map that changes')
    options = parser.parse_args()

    def measure() -> tuple[str, bool]:
        parts = (during_a_solve(options.samples), departures(options.calls, options.nodes),
                 meanwhile(options.seconds, options.cells, options.nodes))
        text = '\n\n'.join((f"{conditions('ros-jazzy-rclpy')}.", *(part for part, _ in parts)))
        return text, all(met for _, met in parts)

    return run_and_publish(measure, 'node_latency', options.results)


if __name__ == '__main__':
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""A departure every second for an hour, next to a robot that asks for its path every second.

An obstacle moves each time. Regularly the goal or the whole map changes, a plan between other
places is requested, or the game is solved again. Exit code 1 if a call failed, if the node's memory
grew (judged in runs of ten minutes or more) or its threads, open files or subscriptions, or if a
sampled recording does not verify.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from node_motion import ARRIVED, Robot
from node_rig import (
    PLANNER,
    Caller,
    NodeSilent,
    Refused,
    Rig,
    grid_of,
    pose,
    resident,
    run_and_publish,
    running_node,
    say,
    spread,
    stopwatch,
)
from report import conditions, new_parser, table
from std_msgs.msg import Header

from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.recordings.recording_file import read_recording
from ambush_planner.recordings.verify import Verifier

CELLS, RESOLUTION = 120, 0.5
SIDE = 3  # cells, of the moving obstacle
START = pose(5.0, 30.0)
SPEED = 1.0  # m/s, of the robot
CLEAR = 3.0  # m, from the robot to the obstacle
# Departures between events.
NEW_GOAL, OTHER_PLAN, REPLAN, NEW_MAP = 10, 15, 30, 60
KEPT = 32  # plans that the node keeps; solved first, as they take memory
# Time after which the node's memory counts [s], at most a third of the run: by then the plans that
# it keeps have been replaced, and hold what departures on them compute.
WARM_UP = 400.0
# Share of the run at either end over which memory is averaged.
WINDOW = 0.05
GROWTH_ALLOWED = 5.0  # %
LONG_ENOUGH = 600.0  # s
VERIFIED = 60  # recordings


@dataclass
class Journal:
    """Number of calls, failures, times of answers [ms], and what the node uses by time [s]."""

    calls: int = 0
    departures: int = 0
    refused: int = 0
    failures: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    under_way: list[float] = field(default_factory=list)
    memory: list[tuple[float, float]] = field(default_factory=list)
    resources: list[tuple[int, int, int]] = field(default_factory=list)

    def attempt(self, call: Callable[[], object]) -> None:
        """Make a call and note its failure."""
        self.calls += 1
        try:
            call()
        except (NodeSilent, Refused) as error:
            self.failures.append(str(error))
            say(str(error))


class Patrol:
    """A robot that drives to and fro, and may ask for its path at any time.

    ``refused`` counts its requests that failed: it had driven on while its plan was solved.
    """

    def __init__(self, caller: Caller) -> None:
        self._caller, self._trips, self.refused = caller, 0, 0
        self.robot = Robot(caller, np.array((5.0, 20.0)), SPEED)

    def ask(self) -> None:
        """Ask for the path to the goal, the next one if it has arrived."""
        x, y = self._goal
        if np.hypot(*(self.robot.place - (x, y))) <= ARRIVED:
            self._trips += 1
            x, y = self._goal
        here = PoseStamped(header=Header(frame_id='base_link'))
        here.pose.orientation.w = 1.0
        try:
            self.robot.path = path_from_ros(self._caller.get_plan(here, pose(x, y)))[:, :2]
        except Refused:
            self.refused += 1

    @property
    def _goal(self) -> tuple[float, float]:
        return 5.0 if self._trips % 2 else 55.0, 20.0 + 5.0 * (self._trips // 2 % 5)


def soak(rig: Rig, caller: Caller, seconds: float, period: float) -> Journal:
    """Call the node for the given time."""
    caller.give(grid(0), START, goal(0))
    for k in range(KEPT):
        caller.get_plan(START, pose(55.0, 5.0 + 50.0 * k / KEPT))
    patrol = Patrol(caller)
    journal, begin = Journal(), time.monotonic()
    for k in range(int(seconds / period)):
        caller.idle_until(begin + k * period)
        caller.publisher(OccupancyGrid, '/alpha_map').publish(grid(k, patrol.robot.place))
        journal.under_way.append(stopwatch(patrol.ask))
        if k % NEW_GOAL == NEW_GOAL - 1:
            caller.publisher(PoseStamped, '/goal_pose').publish(goal(k))
        if k % OTHER_PLAN == OTHER_PLAN - 1:
            journal.attempt(lambda k=k: caller.get_plan(goal(k), START))
        if k % REPLAN == REPLAN - 1:
            journal.attempt(lambda: caller.trigger('replan'))
        depart = partial(journal.attempt, lambda: caller.trigger('new_route'))
        journal.times.append(stopwatch(depart))
        journal.memory.append((time.monotonic() - begin, resident(rig.process.pid)))
        journal.resources.append(resources(caller, rig.process.pid))
        if (k + 1) % max(1, int(seconds / period / 20)) == 0:
            say(f'{journal.memory[-1][0]:.0f} s: {caller.status["departures"]} departures, '
                f'{journal.memory[-1][1]:.1f} MB, {journal.resources[-1]}, '
                f'{len(journal.failures)} failed')
    caller.idle_until(time.monotonic() + 2.0)  # for the last report
    journal.refused = patrol.refused
    journal.departures = int(caller.status['departures'])
    return journal


def resources(caller: Caller, pid: int) -> tuple[int, int, int]:
    """Threads and open files of the node, and its subscriptions."""
    listens = caller.node.get_subscriber_names_and_types_by_node(PLANNER[1:], '/')
    process = Path(f'/proc/{pid}')
    return (len(list((process / 'task').iterdir())), len(list((process / 'fd').iterdir())),
            len(listens))


def grid(k: int, robot: Sequence[float] | np.ndarray = (0.0, 0.0)) -> OccupancyGrid:
    """The map at the ``k``-th departure."""
    values = np.random.default_rng(k // NEW_MAP).integers(0, 60, (CELLS, CELLS), dtype=np.int8)
    # The obstacle stays away from the ends of trips.
    row, column = np.random.default_rng(k).integers((0, 20), (CELLS - SIDE, 95))
    if np.hypot(*(np.array((column, row)) * RESOLUTION - robot)) > CLEAR:
        values[row:row + SIDE, column:column + SIDE] = 100
    return grid_of(values, RESOLUTION)


def goal(k: int) -> PoseStamped:
    """A goal on the east side."""
    return pose(55.0, 5.0 + (7.0 * k) % 50.0)


def verify(files: Sequence[Path]) -> str:
    """Verify some of the recordings; return the first problems."""
    verdicts = map(Verifier().verify, files[::max(1, len(files) // VERIFIED)])
    return '; '.join(f'{each.path.name}: {problem}' for each in verdicts
                     for problem in each.problems)[:500]


def growth(memory: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """Memory after the warm-up and at the end [MB], medians of windows, and the growth [%]."""
    total = memory[-1][0]
    warm, window = min(WARM_UP, total / 3.0), WINDOW * total
    first = [size for at, size in memory if warm <= at <= warm + window] or [memory[0][1]]
    last = [size for at, size in memory if at >= total - window]
    before, after = statistics.median(first), statistics.median(last)
    return before, after, 100.0 * (after / before - 1.0)


def results(
    journal: Journal, period: float, files: Sequence[int], departures: int, problems: str
) -> tuple[str, bool]:
    """The table, and whether the targets are met.

    ``files`` are the sizes of recordings, ``departures`` the number of those of no diversion.
    """
    seconds = journal.memory[-1][0]
    before, after, change = growth(journal.memory)
    tenth = max(1, len(journal.times) // 10)
    judged = seconds >= LONG_ENOUGH - period
    thirds = np.array_split(journal.resources, 3)
    early, late = np.median(thirds[1], axis=0), np.median(thirds[2], axis=0)
    met = not journal.failures and not problems and bool((late <= early).all())
    met = met and not (judged and change >= GROWTH_ALLOWED) and departures == journal.departures
    rows = [
        ['**memory growth**', f'**{change:+.2f} %**' + ('' if judged else ' (run too short)')],
        ['memory after the warm-up, at the end, largest [MB]',
         f'{before:.1f}, {after:.1f}, {max(size for _, size in journal.memory):.1f}'],
        ['threads, open files, subscriptions, in the second and the last third (medians)',
         '; '.join(', '.join(f'{each:g}' for each in part) for part in (early, late))],
        ['calls, failed', f'{journal.calls}, {len(journal.failures)}'],
        ["the robot's requests, refused as it had driven on during a solve",
         f'{len(journal.under_way)}, {journal.refused}'],
        ['answer to the robot in the first and the last tenth, median / 99 % / largest [ms]',
         f'{spread(journal.under_way[:tenth])}; {spread(journal.under_way[-tenth:])}'],
        ['departures, recordings of them and of diversions',
         f'{journal.departures}, {departures} and {len(files) - departures} '
         f'({sum(files) / 2.0**20:.1f} MB)'],
        [f'about {VERIFIED} recordings verified', problems or 'all hold'],
        ['answer of `new_route` in the first and the last tenth, median / 99 % / largest [ms]',
         f'{spread(journal.times[:tenth])}; {spread(journal.times[-tenth:])}'],
    ]
    text = (
        f"A departure every {period:g} s for {seconds:.0f} s, and as often a request of a robot "
        f"on its way at {SPEED:g} m/s; a new goal every {NEW_GOAL} departures, a plan between "
        f"other places every {OTHER_PLAN}, a new solve every {REPLAN}, a new map every {NEW_MAP}, "
        f"and a moving obstacle of {SIDE} x {SIDE} cells. "
        f"{conditions('ros-jazzy-rclpy')}.\n\n{table(('', ''), rows)}\n\nTarget: no failed call, "
        f"memory growth < {GROWTH_ALLOWED:g} %, no more threads, files or subscriptions, all "
        f"recordings hold; "
        f"{'met' if met else '**missed**'}."
    )
    return text, met


def run(seconds: float, period: float, spacing: float) -> tuple[str, bool]:
    """Start and use a node, and check its recordings."""
    with tempfile.TemporaryDirectory(prefix='ambush_planner_') as folder:
        parameters = {'network.spacing': spacing, 'robot_base_frame': 'base_link'}
        with running_node(parameters, Path(folder)) as rig:
            with Caller(rig) as caller:
                journal = soak(rig, caller, seconds, period)
        files = sorted(rig.recordings.rglob('*.mcap'))
        sizes = [path.stat().st_size for path in files]
        departures = sum(read_recording(path).metadata.diversion is None for path in files)
        return results(journal, period, sizes, departures, verify(files))


def main() -> int:
    parser = new_parser(__doc__)
    parser.add_argument('--seconds', type=float, default=3600.0, help='duration')
    parser.add_argument('--period', type=float, default=1.0, help='seconds between departures')
    parser.add_argument('--spacing', type=float, default=2.0, help="of the network's nodes [m]")
    options = parser.parse_args()
    return run_and_publish(
        lambda: run(options.seconds, options.period, options.spacing), 'node_soak', options.results
    )


if __name__ == '__main__':
    sys.exit(main())

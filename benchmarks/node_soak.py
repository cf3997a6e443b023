# SPDX-License-Identifier: Apache-2.0
"""A departure every second for an hour, as an operator would use the node.

An obstacle moves each time. Regularly the goal or the whole map changes, a plan between other
places is requested, or the game is solved again. Exit code 1 if a call failed, if the node's memory
grew (judged in runs of ten minutes or more), or if a sampled recording does not verify.
"""

from __future__ import annotations

import statistics
import subprocess
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
from node_rig import (
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

CELLS, RESOLUTION = 120, 0.5
SIDE = 3  # cells, of the moving obstacle
START = pose(5.0, 30.0)
# Departures between events.
NEW_GOAL, OTHER_PLAN, REPLAN, NEW_MAP = 10, 15, 30, 60
GROWTH_ALLOWED = 5.0  # %
LONG_ENOUGH = 600.0  # s
VERIFIED = 60  # recordings


@dataclass
class Journal:
    """Number of calls, failures, times of departures [ms], and and memory [MB]."""

    calls: int = 0
    departures: int = 0
    failures: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)

    def attempt(self, call: Callable[[], object]) -> None:
        """Make a call and note its failure."""
        self.calls += 1
        try:
            call()
        except (NodeSilent, Refused) as error:
            self.failures.append(str(error))
            say(str(error))


def soak(rig: Rig, caller: Caller, seconds: float, period: float) -> Journal:
    """Call the node for the given time."""
    caller.give(grid(0), START, goal(0))
    journal, begin = Journal(), time.monotonic()
    for k in range(int(seconds / period)):
        caller.idle_until(begin + k * period)
        caller.publisher(OccupancyGrid, '/alpha_map').publish(grid(k))
        if k % NEW_GOAL == NEW_GOAL - 1:
            caller.publisher(PoseStamped, '/goal_pose').publish(goal(k))
        if k % OTHER_PLAN == OTHER_PLAN - 1:
            journal.attempt(lambda k=k: caller.get_plan(goal(k), START))
            journal.departures += 1
        if k % REPLAN == REPLAN - 1:
            journal.attempt(lambda: caller.trigger('replan'))
        depart = partial(journal.attempt, lambda: caller.trigger('new_route'))
        journal.times.append(stopwatch(depart))
        journal.departures += 1
        journal.memory.append(resident(rig.process.pid))
        if (k + 1) % max(1, int(seconds / period / 20)) == 0:
            say(f'{time.monotonic() - begin:.0f} s: {journal.departures} departures, '
                f'{journal.memory[-1]:.1f} MB, {len(journal.failures)} failed')
    return journal


def grid(k: int) -> OccupancyGrid:
    """The map at the ``k``-th departure."""
    values = np.random.default_rng(k // NEW_MAP).integers(0, 60, (CELLS, CELLS), dtype=np.int8)
    # The obstacle stays away from the ends of trips.
    row, column = np.random.default_rng(k).integers((0, 20), (CELLS - SIDE, 95))
    values[row:row + SIDE, column:column + SIDE] = 100
    return grid_of(values, RESOLUTION)


def goal(k: int) -> PoseStamped:
    """A goal on the east side."""
    return pose(55.0, 5.0 + (7.0 * k) % 50.0)


def verify(files: Sequence[Path]) -> str:
    """Verify some of the recordings; return the first lines about a problem, or ''."""
    some = files[::max(1, len(files) // VERIFIED)]
    command = [sys.executable, '-m', 'ambush_planner.commands.cli', 'verify', *map(str, some)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
    return '' if done.returncode == 0 else (done.stdout + done.stderr)[:500]


def growth(memory: Sequence[float]) -> tuple[float, float, float]:
    """Memory in the second tenth and in the last one [MB], medians, and the growth [%]."""
    tenth = max(1, len(memory) // 10)
    before, after = statistics.median(memory[tenth : 2 * tenth] or memory), statistics.median(
        memory[-tenth:])
    return before, after, 100.0 * (after / before - 1.0)


def results(
    journal: Journal, period: float, files: Sequence[int], problems: str
) -> tuple[str, bool]:
    """The table, and whether the targets are met; ``files`` are the recordings' sizes."""
    seconds = period * len(journal.memory)
    before, after, change = growth(journal.memory)
    tenth = max(1, len(journal.times) // 10)
    judged = seconds >= LONG_ENOUGH
    met = not journal.failures and not (judged and change >= GROWTH_ALLOWED)
    met = met and len(files) == journal.departures and not problems
    rows = [
        ['**memory growth**', f'**{change:+.2f} %**' + ('' if judged else ' (run too short)')],
        ['memory after a tenth of the time, at the end, largest [MB]',
         f'{before:.1f}, {after:.1f}, {max(journal.memory):.1f}'],
        ['calls, failed', f'{journal.calls}, {len(journal.failures)}'],
        ['departures, recordings',
         f'{journal.departures}, {len(files)} ({sum(files) / 2.0**20:.1f} MB)'],
        [f'about {VERIFIED} recordings verified', problems or 'all hold'],
        ['answer of `new_route` in the first and the last tenth, median / 99 % / largest [ms]',
         f'{spread(journal.times[:tenth])}; {spread(journal.times[-tenth:])}'],
    ]
    text = (
        f"A departure every {period:g} s for {seconds:.0f} s; a new goal every {NEW_GOAL} "
        f"departures, a plan between other places every {OTHER_PLAN}, a new solve every {REPLAN}, "
        f"a new map every {NEW_MAP}, and a moving obstacle of {SIDE} x {SIDE} cells. "
        f"{conditions('ros-jazzy-rclpy')}.\n\n{table(('', ''), rows)}\n\nTarget: no failed call, "
        f"memory growth < {GROWTH_ALLOWED:g} %, all recordings hold; "
        f"{'met' if met else '**missed**'}."
    )
    return text, met


def run(seconds: float, period: float, spacing: float) -> tuple[str, bool]:
    """Start, use and stop the node, and verify its recordings."""
    with tempfile.TemporaryDirectory(prefix='ambush_planner_') as folder:
        with running_node({'network.spacing': spacing}, Path(folder)) as rig, Caller(rig) as caller:
            journal = soak(rig, caller, seconds, period)
        files = sorted(rig.recordings.rglob('*.mcap'))
        return results(journal, period, [path.stat().st_size for path in files], verify(files))


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

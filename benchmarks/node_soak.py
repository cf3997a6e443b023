"""A departure every second for an hour, as an operator would ask: memory, failed calls, leftovers.

An obstacle is somewhere else each time. Now and then the goal changes, the whole map, somebody asks
for a plan between other places, or has the game solved anew. Every departure is recorded in a
temporary folder, about 0.5 GB in an hour, and some are verified in the end. Exit code 1 if a call
failed, if the node grew (judged in runs of ten minutes or more), if a recording does not hold, or
if the node left anything: a file that metadata.yaml does not list, shared memory, a process.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import node_rig
import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from node_rig import (
    FAILURES,
    Caller,
    NodeSilent,
    Refused,
    Rig,
    children,
    percentiles,
    pose,
    resident,
    running_node,
    say,
    scratch,
    shared_memory,
)
from report import RESULTS, conditions, table, write_block

from ambush_planner.recordings import recordings_in
from ambush_planner.recordings.bag_folder import FILE_NAME
from ambush_planner.recordings.verify import Verifier

CELLS, RESOLUTION = 120, 0.5
SIDE = 3  # cells, of an obstacle that is somewhere else at each departure
START = pose(5.0, 30.0)
# Departures from one of these events to the next.
NEW_GOAL, OTHER_PLAN, REPLAN, NEW_MAP = 10, 15, 30, 60
# From then on the node's memory counts: caches are full.
WARM_UP = 60.0  # s
WINDOW = 0.05  # share of the run in which its memory is taken, at either end
GROWTH_ALLOWED = 5.0  # %
LONG_ENOUGH = 600.0  # s
SHARED = Path('/dev/shm')
VERIFIED = 60  # recordings


@dataclass
class Journal:
    """What was asked for, what failed, each departure's time [ms], memory by seconds [MB]."""

    calls: int = 0
    departures: int = 0
    failures: list[str] = field(default_factory=list)
    answers: list[float] = field(default_factory=list)
    memory: list[tuple[float, float]] = field(default_factory=list)
    solves: set[tuple[str, str]] = field(default_factory=set)

    def note(self, failure: str) -> None:
        """Count a call."""
        self.calls += 1
        if failure:
            self.failures.append(failure)
            say(failure)


def soak(rig: Rig, caller: Caller, seconds: float, period: float) -> Journal:
    """Ask until the time is up."""
    caller.give(grid(0), START, goal(0))
    journal, begin = Journal(), time.monotonic()
    for k in range(int(seconds / period)):
        caller.idle_until(begin + k * period)
        events(caller, journal, k)
        asked = time.perf_counter()
        journal.note(trouble(caller.new_route))
        journal.answers.append(1e3 * (time.perf_counter() - asked))
        journal.departures += 1
        journal.solves.add((caller.status['solve_seconds'], caller.status['value']))
        journal.memory.append((time.monotonic() - begin, resident(rig.process.pid)))
        if (k + 1) % max(1, int(seconds / period / 20)) == 0:
            say(f'{journal.memory[-1][0]:.0f} s: {journal.departures} departures, '
                f'{journal.memory[-1][1]:.1f} MB, {len(journal.failures)} failed')
    return journal


def events(caller: Caller, journal: Journal, k: int) -> None:
    """What else happens at the ``k``-th departure."""
    caller.publisher(OccupancyGrid, '/alpha_map').publish(grid(k))
    if k % NEW_GOAL == NEW_GOAL - 1:
        caller.publisher(PoseStamped, '/goal_pose').publish(goal(k))
    if k % OTHER_PLAN == OTHER_PLAN - 1:
        journal.note(trouble(lambda: caller.get_plan(goal(k), START)))
        journal.departures += 1
    if k % REPLAN == REPLAN - 1:
        journal.note(trouble(lambda: caller.trigger('replan')))


def trouble(call: Callable[[], object]) -> str:
    """Why a call failed; empty if it did not."""
    try:
        call()
    except (NodeSilent, Refused) as error:
        return str(error)
    return ''


def grid(k: int) -> OccupancyGrid:
    """The map at the ``k``-th departure: another one at times, and always other obstacles."""
    whole = node_rig.field(CELLS, RESOLUTION, seed=k // NEW_MAP)
    # Not where trips begin and end.
    row, column = np.random.default_rng(k).integers((0, 20), (CELLS - SIDE, 95))
    values = np.array(whole.data, dtype=np.int8).reshape(CELLS, CELLS)
    values[row:row + SIDE, column:column + SIDE] = 100
    whole.data = array('b', values.tobytes())
    return whole


def goal(k: int) -> PoseStamped:
    """A goal on the east side."""
    return pose(55.0, 5.0 + (7.0 * k) % 50.0)


def leftovers(rig: Rig, memory: Sequence[Path], workers: Sequence[int]) -> Iterator[str]:
    """What a node that has ended should not have left; ``memory`` was the node's."""
    for path in memory:
        # Fast DDS shares some with whatever else runs on the machine.
        if path.exists() and not used_by_others(path):
            yield f'shared memory {path.name}'
    for pid in workers:
        if Path(f'/proc/{pid}').exists():
            yield f'process {pid}'
    for folder in rig.recordings.iterdir():
        there = {path.name for path in folder.iterdir()} - {FILE_NAME}
        listed = set(json.loads((folder / FILE_NAME).read_text())[
            'rosbag2_bagfile_information']['relative_file_paths'])
        yield from (f'unlisted {name}' for name in sorted(there - listed))
        yield from (f'listed, but missing {name}' for name in sorted(listed - there))


def used_by_others(path: Path) -> bool:
    """Whether a process that lives has this shared memory."""
    pids = (int(folder.name) for folder in Path('/proc').glob('[0-9]*'))
    return any(path in used for used in map(shared_memory_if_alive, pids))


def shared_memory_if_alive(pid: int) -> set[Path]:
    """Shared memory of a process that may end at any moment."""
    try:
        return shared_memory(pid)
    except OSError:
        return set()


def verified(folder: Path) -> tuple[int, list[str]]:
    """How many recordings, of all times, were verified, and what does not hold."""
    files = recordings_in(folder)
    some = files[::max(1, len(files) // VERIFIED)]
    verifier = Verifier()
    verdicts = [verifier.verify(path) for path in some]
    return len(some), [
        f'{each.path.name}: {problem}' for each in verdicts for problem in each.problems
    ]


def growth(memory: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """Memory after the warm-up and in the end [MB], medians of windows, and its growth [%]."""
    total = memory[-1][0]
    warm, window = min(WARM_UP, WINDOW * total), WINDOW * total
    first = [size for at, size in memory if warm <= at <= warm + window] or [memory[0][1]]
    last = [size for at, size in memory if at >= total - window]
    before, after = statistics.median(first), statistics.median(last)
    return before, after, 100.0 * (after / before - 1.0)


def results(
    journal: Journal, period: float, files: tuple[int, float], left: Sequence[str],
    held: tuple[int, Sequence[str]],
) -> tuple[str, bool]:
    """A table, and whether nothing was wrong."""
    seconds = journal.memory[-1][0]
    before, after, change = growth(journal.memory)
    tenth = max(1, len(journal.answers) // 10)
    judged = seconds >= LONG_ENOUGH - period
    met = not journal.failures and not left and not (judged and change >= GROWTH_ALLOWED)
    met = met and files[0] == journal.departures and not held[1]
    rows = [
        ['**memory growth**', f'**{change:+.2f} %**' + ('' if judged else ' (too short to tell)')],
        ['memory after the warm-up, in the end, largest [MB]',
         f'{before:.1f}, {after:.1f}, {max(size for _, size in journal.memory):.1f}'],
        ['calls, failed', f'{journal.calls}, {len(journal.failures)}'],
        ['departures, recordings', f'{journal.departures}, {files[0]} ({files[1]:.1f} MB)'],
        ['strategies in force at a departure', str(len(journal.solves))],
        ['recordings verified', f'{held[0]}: ' + (', '.join(held[1][:9]) or 'all hold')],
        ['answer of `new_route` in the first and the last tenth, median / 99 % / largest [ms]',
         '; '.join(' / '.join(f'{value:.3g}' for value in percentiles(part))
                   for part in (journal.answers[:tenth], journal.answers[-tenth:]))],
        ['left behind', ', '.join(left) or 'nothing'],
    ]
    text = (
        f"A departure every {period:g} s for {seconds:.0f} s; a new goal every {NEW_GOAL} "
        f"departures, a plan between other places every {OTHER_PLAN}, a solve anew every {REPLAN}, "
        f"a new map every {NEW_MAP}, and an obstacle of {SIDE} x {SIDE} cells that is somewhere "
        f"else each time. {conditions('ros-jazzy-rclpy')}.\n\n{table(('', ''), rows)}\n"
        f"\nTarget: no failed call, memory growth < {GROWTH_ALLOWED:g} %, all holds, nothing left "
        f"behind; {'met' if met else '**missed**'}."
    )
    return text, met


def run(seconds: float, period: float, spacing: float) -> tuple[str, bool]:
    """Start the node, soak it, stop it, look what it left."""
    with scratch() as folder:
        others = set(SHARED.iterdir())
        with running_node(folder, {'network.spacing': spacing}) as rig:
            with Caller(rig.domain, rig.process.check) as caller:
                journal = soak(rig, caller, seconds, period)
            memory = shared_memory(rig.process.pid) - others
            workers = children(rig.process.pid)
        left = list(leftovers(rig, sorted(memory), workers))
        held = verified(rig.recordings)
        sizes = [path.stat().st_size for path in rig.recordings.rglob('*.mcap')]
        return results(journal, period, (len(sizes), sum(sizes) / node_rig.MEGABYTE), left, held)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument('--seconds', type=float, default=3600.0, help='how long')
    parser.add_argument('--period', type=float, default=1.0, help='seconds between departures')
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `node_soak` is replaced'
    )
    parser.add_argument('--spacing', type=float, default=2.0, help="of the network's nodes [m]")
    options = parser.parse_args()
    if not 0.0 < options.period <= options.seconds:
        parser.error('--period must be over 0 and at most --seconds')
    try:
        text, met = run(options.seconds, options.period, options.spacing)
    except FAILURES as error:
        say(f'node_soak: {error}')
        return 2
    print(text)
    write_block(options.results, 'node_soak', text)
    return int(not met)


if __name__ == '__main__':
    sys.exit(main())

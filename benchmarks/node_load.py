"""A thousand service calls at once, from several processes, and how many are answered.

None of the clients waits for an answer before its next call. A client of rclpy's default quality
of service keeps 10 messages: what comes faster than it reads is lost on its own side. So the
target, every call answered, is held against clients that keep 1000. Exit code 1 if it is missed.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

from nav_msgs.srv import GetPlan
from node_rig import (
    FAILURES,
    TIMEOUT,
    Caller,
    NodeSilent,
    Rig,
    children,
    field,
    pose,
    resident,
    running_node,
    say,
    scratch,
)
from rclpy.task import Future
from report import RESULTS, conditions, table, write_block
from std_srvs.srv import Trigger

DEPTHS = (10, 1000)
# Without an answer for so long [s], and for so long a call that may be answered first, the rest is
# missing.
STALL, STALL_A_CALL = 10.0, 0.05
CELLS, RESOLUTION = 60, 0.5
START, GOAL = pose(2.0, 15.0), pose(28.0, 15.0)


@dataclass(frozen=True)
class Round:
    """All calls of one kind: how many were made, answered, and answered well, and when all was."""

    what: str
    depth: int
    calls: int
    answered: int
    good: int
    seconds: float
    memory: float


class Together:
    """Where the processes of the clients wait for each other, in each of them."""

    barrier: Barrier

    @classmethod
    def meet_at(cls, barrier: Barrier) -> None:
        cls.barrier = barrier


@contextmanager
def client_processes(count: int) -> Iterator[Executor]:
    """Processes that begin together, each with one call of ``ask`` at a time."""
    # No fork: it would copy the middleware's state without its threads.
    spawn = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(count, spawn, Together.meet_at, (spawn.Barrier(count),)) as pool:
        yield pool


def ask(domain: int, service: str, depth: int, calls: int) -> tuple[int, int, float]:
    """What a client does; how many calls were answered, how many well, and in what time."""
    together = Together.barrier
    request: Any = Trigger.Request()
    if service == 'get_plan':
        request = GetPlan.Request(start=START, goal=GOAL)
    with Caller(domain, lambda: None) as caller:
        kind = GetPlan if service == 'get_plan' else Trigger
        client = caller.client(kind, service, depth)
        together.wait(TIMEOUT)
        begin = time.monotonic()
        futures = [client.call_async(request) for _ in range(calls)]
        last = gather(caller, futures, STALL + STALL_A_CALL * together.parties * calls)
    done = [future.result() for future in futures if future.done()]
    good = sum(bool(each.plan.poses if kind is GetPlan else each.success) for each in done)
    return len(done), good, last - begin


def gather(caller: Caller, futures: Sequence[Future], stall: float) -> float:
    """Take answers until there are all or none came for ``stall`` [s]; when the last one came."""
    count, last = 0, time.monotonic()
    while count < len(futures) and time.monotonic() - last < stall:
        caller.idle_until(time.monotonic() + 0.02)
        done = sum(future.done() for future in futures)
        if done > count:
            count, last = done, time.monotonic()
    return last


def run_round(
    rig: Rig, what: str, service: str, depth: int, calls: int, clients: int, pool: Executor
) -> Round:
    """Let the clients call at the same time, add up what they got."""
    say(f'{what}, clients of depth {depth}')
    share = calls // clients
    asked = [pool.submit(ask, rig.domain, service, depth, share) for _ in range(clients)]
    try:
        found = [each.result() for each in asked]
    except BrokenExecutor as error:
        raise NodeSilent('a client ended early') from error
    answered, good = (sum(each[k] for each in found) for k in (0, 1))
    rig.process.check()
    seconds, memory = max(each[2] for each in found), resident(rig.process.pid)
    return Round(what, depth, share * clients, answered, good, seconds, memory)


def load(rig: Rig, calls: int, clients: int) -> list[Round]:
    """All rounds; the first calls of all find no strategy and share one solve."""
    with client_processes(clients) as pool, Caller(rig.domain, rig.process.check) as caller:
        caller.give(field(CELLS, RESOLUTION), START, GOAL)
        deep = max(DEPTHS)
        what = '`new_route`, nothing solved yet'
        rounds = [run_round(rig, what, 'new_route', deep, calls, clients, pool)]
        for service in ('new_route', 'get_plan'):
            for depth in DEPTHS:
                what = f'`{service}`, strategy known'
                rounds.append(run_round(rig, what, service, depth, calls, clients, pool))
        caller.ask_parameter()
        caller.new_route()
    return rounds


def results(
    rounds: Sequence[Round], clients: int, memory: float, processes: int
) -> tuple[str, bool]:
    """A row a round, and whether the target is met."""
    rows = [
        [each.what, str(each.depth), f'**{each.answered / each.calls:.1%}**',
         str(each.calls - each.answered), str(each.answered - each.good), f'{each.seconds:.2f}',
         f'{each.memory:.1f}']
        for each in rounds
    ]
    head = ('calls', 'clients keep', 'answered', 'missing', 'refused', 'seconds', 'node [MB]')
    met = all(each.good == each.calls for each in rounds if each.depth == max(DEPTHS))
    text = (
        f"{rounds[0].calls} calls a row at once, {clients} client processes; recording on. "
        f"{conditions('ros-jazzy-rclpy')}.\n\n{table(head, rows)}\n\nAfterwards the node answers "
        f"and departs, with {processes} worker process; it had {memory:.1f} MB before. Target: "
        f"every call answered with a route; {'met' if met else '**missed**'}."
    )
    return text, met


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument('--calls', type=int, default=1000, metavar='N', help='calls a row')
    parser.add_argument('--clients', type=int, default=4, metavar='N', help='client processes')
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `node_load` is replaced'
    )
    options = parser.parse_args()
    try:
        with scratch() as folder, running_node(folder, {'network.spacing': 1.0}) as rig:
            with Caller(rig.domain, rig.process.check) as caller:
                caller.ask_parameter()
            memory = resident(rig.process.pid)
            rounds = load(rig, options.calls, options.clients)
            processes = len(children(rig.process.pid))
    except FAILURES as error:
        say(f'node_load: {error}')
        return 2
    text, met = results(rounds, options.clients, memory, processes)
    print(text)
    write_block(options.results, 'node_load', text)
    return int(not met)


if __name__ == '__main__':
    sys.exit(main())

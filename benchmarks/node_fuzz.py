"""Random and mutated messages, requests and parameters for a planner node, over DDS.

After each message the node has to answer: to the request, if it was one, and to `get_parameters`.
After every hundred it gets its defaults and good inputs, and has to find a route from start to
goal. It must not end, must not meet an error that it does not know, and must not grow after the
first thousand. Exit code 1 if it does; what was sent last is printed, and each message can be sent
again by its seed and number.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections import Counter, deque
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from geometry_msgs.msg import PoseStamped
from node_attacks import Attack, attack, good_map, good_pose
from node_rig import (
    FAILURES,
    Caller,
    Refused,
    Rig,
    children,
    give_nodes_map_updates,
    resident,
    running_node,
    say,
    scratch,
)
from report import RESULTS, conditions, table, write_block

from ambush_planner.planning.parameters import PARAMETERS

# The node's solves are given up after this [s], so that one message costs no more.
PLANNING_TIME = 2.0
NODE = {'max_planning_time': PLANNING_TIME}
CHECK_EVERY = 100
SHOWN = 5
# Messages until the node has used all of itself, threads and libraries.
WARM_UP = 1000
# Memory allocators do not give everything back at once.
GROWTH_ALLOWED = 5.0  # %
START, GOAL = (1.25, 5.25), (8.75, 5.25)
UNKNOWN = re.compile(r'Traceback|internal error|^\S*Error at$', re.MULTILINE)


@dataclass
class Solution:
    """What was sent so far, and the node's memory [MB] after so many messages."""

    sent: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    memory: dict[int, float] = field(default_factory=dict)
    departures: int = 0
    seconds: float = 0.0


class WrongRoute(Exception):
    """With good inputs and its defaults the node did not plan as it should."""


def fuzz(rig: Rig, caller: Caller, seed: int, numbers: range) -> Solution:
    """Send the messages with these numbers; the failures of node and caller go through."""
    outcome, begin = Solution(), time.monotonic()
    recent: deque[str] = deque(maxlen=SHOWN)
    every = min(WARM_UP, max(1, len(numbers) // 10))
    caller.watch_status()
    try:
        for done, number in enumerate(numbers, 1):
            sent = attack(seed, number)
            recent.append(f'--seed {seed} --first {number}: {sent.what} on {sent.target}')
            send(caller, sent)
            outcome.sent['requests' if sent.is_service else 'messages on topics'] += 1
            outcome.codes[caller.status.get('code', 'none yet')] += 1
            if done % CHECK_EVERY == 0 or done == len(numbers):
                check_good_inputs(caller)
            if done % every == 0:
                outcome.memory[done] = resident(rig.process.pid)
                say(f'{done} of {len(numbers)}: {outcome.memory[done]:.1f} MB')
    except Exception:
        say('sent last:\n  ' + '\n  '.join(recent))
        raise
    outcome.departures = int(caller.status['departures'])
    outcome.seconds = time.monotonic() - begin
    return outcome


def send(caller: Caller, sent: Attack) -> None:
    """Send one message, and have the node answer."""
    if sent.is_service:
        caller.call(sent.kind, sent.target, sent.content)
    else:
        caller.publisher(sent.kind, sent.target).publish(sent.content)
    caller.ask_parameter()


def check_good_inputs(caller: Caller) -> None:
    """With its defaults and good inputs the node finds a route, whatever came before."""
    values = {name: each.default for name, each in PARAMETERS.items()
              if not each.fixed and not name.startswith('recording')}
    if refused := caller.set_parameters({**values, 'max_planning_time': PLANNING_TIME}):
        raise WrongRoute(f'the defaults were refused: {refused}')
    start, goal = good_pose(*START), good_pose(*GOAL)
    caller.give(good_map(), start, goal)
    caller.wait(lambda: finds_route(caller, start, goal), 'a route as it should be')


def finds_route(caller: Caller, start: PoseStamped, goal: PoseStamped) -> bool:
    """Tell whether a path leads from start to goal; the map may be on its way still."""
    try:
        path = caller.get_plan(start, goal)
    except Refused:
        return False
    ends = [(p.pose.position.x, p.pose.position.y) for p in (*path.poses[:1], *path.poses[-1:])]
    return ends == [START, GOAL]


def growth(memory: dict[int, float]) -> float:
    """How much larger the node is in the end than after the first thousand messages [%]."""
    warm = [size for count, size in memory.items() if count >= WARM_UP]
    return 100.0 * (warm[-1] / warm[0] - 1.0) if warm else 0.0


def results(outcome: Solution, seed: int, unknown: int) -> str:
    """What was sent and what became of the node."""
    total = sum(outcome.sent.values())
    kinds = ', '.join(f'{count} {kind}' for kind, count in sorted(outcome.sent.items()))
    rows = [[str(count), f'{size:.1f}'] for count, size in outcome.memory.items()]
    change = growth(outcome.memory)
    codes = ', '.join(f'{code} {count}' for code, count in outcome.codes.most_common())
    verdict = 'met' if change <= GROWTH_ALLOWED and not unknown else '**missed**'
    return (
        f"{total} messages of seed {seed} ({kinds}) in {outcome.seconds:.0f} s. The node answered "
        f"after each, and planned well after every {CHECK_EVERY}; there were {outcome.departures} "
        f"departures. {conditions('ros-jazzy-rclpy')}.\n\nThe diagnostics' code after a message: "
        f"{codes}.\n\n{table(('messages', 'node [MB]'), rows)}\n\n"
        f"Target: no end, no unknown error, no growth after {WARM_UP}; {verdict}: {unknown} "
        f"unknown errors in the log, memory {change:+.1f} % (up to {GROWTH_ALLOWED:g} % is the "
        "allocator's)."
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument('--messages', type=int, default=10_000, metavar='N', help='how many')
    parser.add_argument('--seed', type=int, default=1, help='what they follow from')
    parser.add_argument('--first', type=int, default=0, metavar='N', help='number of the first')
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `node_fuzz` is replaced'
    )
    options = parser.parse_args()
    numbers = range(options.first, options.first + options.messages)
    try:
        with ExitStack() as stack:
            folder = stack.enter_context(scratch())
            give_nodes_map_updates()
            rig = stack.enter_context(running_node(folder, NODE))
            try:
                with Caller(rig.domain, rig.process.check) as caller:
                    outcome = fuzz(rig, caller, options.seed, numbers)
                say(f'worker processes: {len(children(rig.process.pid))}')
            finally:
                found = UNKNOWN.findall(rig.log)
                say(f'{len(found)} unknown errors in the log' + ''.join(
                    f'\n{rig.log[m.start():m.start() + 2000]}'
                    for m in list(UNKNOWN.finditer(rig.log))[:SHOWN]))
    except (*FAILURES, WrongRoute) as error:
        say(f'node_fuzz: {error}')
        return 1
    text = results(outcome, options.seed, len(found))
    print(text)
    write_block(options.results, 'node_fuzz', text)
    return int(bool(found) or growth(outcome.memory) > GROWTH_ALLOWED)


if __name__ == '__main__':
    sys.exit(main())

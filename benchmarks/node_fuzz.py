# SPDX-License-Identifier: Apache-2.0
"""Random and mutated messages, requests and parameters for a planner node, over DDS.

After each message the node must answer: the request, if it was one, and `get_parameters`. After
every hundred it gets its default parameters and good inputs, and must find a route. It must not
exit, log an internal error, or grow after the first thousand messages; otherwise the exit code is 1
or 2. Each message follows from the seed and its number, so ``--first N --messages 1`` repeats it.
"""

from __future__ import annotations

import re
import struct
import sys
import time
from collections import Counter
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from node_rig import Caller, Refused, grid_of, pose, resident, run_and_publish, running_node, say
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from rclpy.serialization import serialize_message
from report import conditions, new_parser, table

from ambush_planner.parameters.table import PARAMETERS

try:
    from map_msgs.msg import OccupancyGridUpdate
except ModuleNotFoundError:  # it is not on PyPI
    OccupancyGridUpdate = None

Random = np.random.Generator

# Time limit of the node's solves, to bound the cost of a message [s].
PLANNING_TIME = 2.0
CHECK_EVERY = 100
# Number of messages until the node's memory has settled.
WARM_UP = 1000
GROWTH_ALLOWED = 5.0  # %, for the memory allocator
SIDE = 10.0  # of the good map [m]
START, GOAL = (1.25, 5.25), (8.75, 5.25)
INTERNAL_ERROR = re.compile(r'Traceback|internal error|^\S*Error at$', re.MULTILINE)
ODD_NUMBERS = (
    float('nan'), float('inf'), -float('inf'), -0.0, 5e-324, 1e-30, 1e30, 1.8e308, -1.0
)
ODD_NAMES = ('', '/map', 'odom', 'mäp', 'a' * 300, 'line\nbreak', '%s%n', '\ufffe', '{0}')
ODD_LENGTHS = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0xFFFFFFF8, 100_000_000)


def send(caller: Caller, rng: Random) -> str:
    """Send a random message or request, wait for answers, and describe it."""
    choice = rng.random()
    if choice < 0.7:
        kind, topic, make = pick(rng, TOPICS)
        message = make(rng)
        data = bytes(serialize_message(spoiled(rng, message) if rng.random() < 0.3 else message))
        for _ in range(rng.integers(0, 4)):
            data = pick(rng, MUTATIONS)(rng, data)
        caller.publisher(kind, topic).publish(data)
        name = topic
    else:
        name, request = pick(rng, REQUESTS if choice < 0.9 else PARAMETER_REQUESTS)
        caller.call(name, request(rng))
    caller.call('get_parameters', GetParameters.Request(names=['strategy.solver']))
    return name


def a_map(rng: Random) -> OccupancyGrid:
    low, high = pick(rng, ((0, 60), (0, 60), (-1, 101), (-128, 128)))
    return grid_of(rng.integers(low, high, rng.integers(1, 25, 2), dtype=np.int8), SIDE / 20)


def an_update(rng: Random) -> Any:
    rows, columns = rng.integers(0, 6, 2).tolist()
    x, y = rng.integers(-2, 20, 2).tolist()
    made = OccupancyGridUpdate(x=x, y=y, width=columns, height=rows)
    made.header.frame_id = 'map'
    made.data = rng.integers(-128, 128, rows * columns, dtype=np.int8).tolist()
    return made


def a_pose(rng: Random) -> PoseStamped:
    return pose(*rng.uniform(0.0, SIDE, 2).tolist())


def an_estimate(rng: Random) -> PoseWithCovarianceStamped:
    stamped = a_pose(rng)
    made = PoseWithCovarianceStamped(header=stamped.header)
    made.pose.pose = stamped.pose
    return made


def spoiled(rng: Random, message: Any) -> Any:
    """A message with some of its numbers and texts replaced by odd ones."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, 'get_fields_and_field_types'):
            spoiled(rng, value)
        elif rng.random() < 0.3 and kind in ODD:
            setattr(message, name, ODD[kind](rng))
    return message


TOPICS = (
    (OccupancyGrid, '/alpha_map', a_map),
    (PoseStamped, '/start_pose', a_pose),
    (PoseStamped, '/goal_pose', a_pose),
    (PoseWithCovarianceStamped, '/initialpose', an_estimate),
    *([(OccupancyGridUpdate, '/alpha_map_updates', an_update)] if OccupancyGridUpdate else []),
)


def flip(rng: Random, data: bytes) -> bytes:
    changed = bytearray(data)
    for at in rng.integers(0, len(data), rng.integers(1, 9)) if data else ():
        changed[at] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def truncate(rng: Random, data: bytes) -> bytes:
    return data[:int(rng.integers(0, len(data) + 1))]


def extend(rng: Random, data: bytes) -> bytes:
    return data + rng.bytes(int(rng.integers(1, 5000)))


def overwrite(rng: Random, data: bytes) -> bytes:
    """An odd length or number in one of the aligned places of the body."""
    new = pick(rng, (struct.pack('<I', pick(rng, ODD_LENGTHS)),
                     struct.pack('<d', pick(rng, ODD_NUMBERS))))
    places = (len(data) - 4) // len(new)
    if places < 1:
        return data
    at = 4 + len(new) * int(rng.integers(places))
    return data[:at] + new + data[at + len(new):]


MUTATIONS = (flip, truncate, extend, overwrite, overwrite)


def a_plan(rng: Random) -> GetPlan.Request:
    request = GetPlan.Request(start=a_pose(rng), goal=a_pose(rng))
    return spoiled(rng, request) if rng.random() < 0.5 else request


def parameters(rng: Random) -> SetParametersAtomically.Request:
    return SetParametersAtomically.Request(
        parameters=[a_parameter(rng) for _ in range(rng.integers(0, 4))]
    )


def a_parameter(rng: Random) -> Parameter:
    """A parameter with a value near its default, of another type, or odd."""
    name = a_name(rng)
    default = PARAMETERS[name].default if name in PARAMETERS else 1.0
    value = ParameterValue(type=int(rng.integers(0, 256)))
    if rng.random() < 0.8:
        value.type = {bool: 1, int: 2, float: 3, str: 4}[type(default)]
    value.bool_value = bool(rng.random() < 0.5)
    value.integer_value = pick(rng, (-1, 0, 1, 2, 50, 100, 2**62, -(2**63)))
    odd = PLANNING_TIME if name == 'max_planning_time' else number(rng)
    value.double_value = pick(rng, (0.0, 0.5, 1.0, 2.0, odd))
    choices = PARAMETERS[name].choices if name in PARAMETERS else ()
    value.string_value = pick(rng, (*choices, *ODD_NAMES))
    return Parameter(name=name, value=value)


def a_name(rng: Random) -> str:
    return pick(rng, ODD_NAMES if rng.random() < 0.05 else list(PARAMETERS))


REQUESTS = (
    ('get_plan', a_plan),
    *((name, lambda _: None) for name in ('new_route', 'replan', 'cancel')),
)
PARAMETER_REQUESTS = (
    ('set_parameters_atomically', parameters),
    ('get_parameters', lambda rng: GetParameters.Request(names=[a_name(rng)])),
    ('describe_parameters', lambda rng: DescribeParameters.Request(names=[a_name(rng)])),
)


def number(rng: Random, largest: float = 1e308) -> float:
    chosen = pick(rng, (*ODD_NUMBERS, float(rng.uniform(-SIDE, 2.0 * SIDE))))
    return float(np.clip(chosen, -largest, largest))


# Odd values of a field, by its type.
ODD = {'double': number, 'float': lambda rng: float(np.float32(number(rng, 3e38))),
       'string': lambda rng: pick(rng, ODD_NAMES), 'uint32': lambda rng: pick(rng, ODD_LENGTHS),
       'int32': lambda rng: int(rng.integers(-(2**31), 2**31))}


def pick(rng: Random, choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


def check_good_inputs(caller: Caller) -> None:
    """Check that the node finds a route with its default parameters and good inputs."""
    values = {name: each.default for name, each in PARAMETERS.items() if not each.fixed}
    caller.set_parameters({**values, 'max_planning_time': PLANNING_TIME})
    values = np.random.default_rng(1).integers(0, 60, (20, 20), dtype=np.int8)
    values[8:12, 8:12] = 100
    caller.give(grid_of(values, SIDE / 20), pose(*START), pose(*GOAL))

    def finds_route() -> bool:  # once the map has arrived
        try:
            path = caller.get_plan(pose(*START), pose(*GOAL))
        except Refused:
            return False
        ends = [(p.pose.position.x, p.pose.position.y) for p in (path.poses[0], path.poses[-1])]
        return ends == [START, GOAL]

    caller.wait(finds_route, 'no route from start to goal')


def fuzz(caller: Caller, seed: int, numbers: range) -> tuple[str, bool]:
    """Send the messages with these numbers; the report, and whether the targets are met."""
    sent, codes, memory = Counter(), Counter(), {}
    begin, every = time.monotonic(), min(WARM_UP, max(1, len(numbers) // 10))
    for done, message in enumerate(numbers, 1):
        try:
            sent[send(caller, np.random.default_rng([seed, message]))] += 1
            codes[caller.status.get('code', 'none yet')] += 1
            if done % CHECK_EVERY == 0 or done == len(numbers):
                check_good_inputs(caller)
        except Exception:
            say(f'failed with --seed {seed} --first {message} --messages 1, or earlier')
            raise
        if done % every == 0:
            memory[done] = resident(caller.process.pid)
            say(f'{done} of {len(numbers)}: {memory[done]:.1f} MB')
    settled = [size for count, size in memory.items() if count >= WARM_UP]
    growth = 100.0 * (settled[-1] / settled[0] - 1.0) if settled else 0.0
    log = (caller.folder / 'node.log').read_text(errors='replace')
    errors = [log[each.start():][:2000] for each in INTERNAL_ERROR.finditer(log)]
    for error in errors[:3]:
        say(error)
    met = growth <= GROWTH_ALLOWED and not errors
    rows = [[str(count), f'{size:.1f}'] for count, size in memory.items()]
    return (
        f'{len(numbers)} messages of seed {seed} in {time.monotonic() - begin:.0f} s '
        f"({', '.join(f'{count} on {name}' for name, count in sent.most_common())}). The node "
        f'answered after each, and planned well after every {CHECK_EVERY}. '
        f"{conditions('ros-jazzy-rclpy')}.\n\nThe diagnostics' code after a message: "
        f"{', '.join(f'{code} {count}' for code, count in codes.most_common())}.\n\n"
        f"{table(('messages', 'node [MB]'), rows)}\n\nTarget: no exit, no internal error, no "
        f"growth after {WARM_UP}; {'met' if met else '**missed**'}: {len(errors)} internal errors "
        f'in the log, memory {growth:+.1f} % (up to {GROWTH_ALLOWED:g} % is allowed).'
    ), met


def main() -> int:
    parser = new_parser(__doc__)
    parser.add_argument('--messages', type=int, default=10_000, metavar='N', help='how many')
    parser.add_argument('--seed', type=int, default=1, help='seed of all messages')
    parser.add_argument('--first', type=int, default=0, metavar='N', help='number of the first')
    options = parser.parse_args()

    def measure() -> tuple[str, bool]:
        with running_node({'max_planning_time': PLANNING_TIME}) as caller:
            numbers = range(options.first, options.first + options.messages)
            return fuzz(caller, options.seed, numbers)

    return run_and_publish(measure, 'node_fuzz', options.results)


if __name__ == '__main__':
    sys.exit(main())

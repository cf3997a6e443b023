"""How long the node takes, in milliseconds: beside a solve, for a large map, for a departure."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import rclpy
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from node_rig import (
    EMPTY,
    FRAME,
    Caller,
    NodeSilent,
    Rig,
    empty_service,
    field,
    pose,
    running_node,
    say,
    scratch,
)
from rcl_interfaces.srv import DescribeParameters
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ambush_planner.commands.node_process import free_domain
from ambush_planner.ros.conversions import occupancy_to_ros
from ambush_planner.ros.planner_node import PlannerNode

# A map of 100 m x 100 m.
CELLS, RESOLUTION = 200, 0.5
START, GOAL = pose(5.0, 50.0), pose(95.0, 50.0)
# Routes on it are about 125 m long: about 500 poses.
PATH = {'route.path_spacing': 0.25}
QUICK = {
    'strategy.solver': 'max_entropy', 'network.spacing': 5.0, 'max_planning_time': 60.0,
}
# The paper's simplex method needs minutes for 40 000 nodes.
SLOW = {'strategy.solver': 'simplex', 'network.spacing': 0.5, 'max_planning_time': 3600.0}

NOTHING = 'a service that does nothing, of another process: answer arrived'

Samples = dict[str, list[float]]


@dataclass(frozen=True)
class Beside:
    """Times of each kind of question, idle and during a solve, and what ending the solve took."""

    idle: Samples
    during: Samples
    seconds: float
    cancel: float


@dataclass(frozen=True)
class Departures:
    """Times of the departures of one configuration, and the poses of their paths."""

    recording: bool
    period: float
    times: Samples
    poses: list[int]


def beside_a_solve(samples: int, period: float) -> Beside:
    """Ask the node in turns, one question a ``period`` [s], idle and while it solves."""
    with (
        scratch() as folder,
        running_node(folder, QUICK) as rig,
        Caller(rig.domain, rig.process.check) as caller,
    ):
        caller.give(field(CELLS, RESOLUTION), START, GOAL)
        caller.new_route()
        say('questions to an idle node')
        idle = questions(caller, samples, period)
        caller.set_parameters(SLOW)
        answer = caller.send(Trigger, 'new_route')
        caller.wait(lambda: caller.status['state'] == 'solving', 'the solve to begin')
        caller.set_parameters(QUICK)
        begin = time.monotonic()
        say('the same questions during a solve')
        during = questions(caller, samples, period)
        if answer.done() or caller.status['state'] != 'solving':
            raise NodeSilent('the solve ended before the questions; ask fewer')
        seconds = time.monotonic() - begin
        cancel = stopwatch(lambda: caller.call(Trigger, 'cancel'))
        caller.wait(answer.done, 'the answer of the solve that was cancelled')
    return Beside(idle, during, seconds, cancel)


def questions(caller: Caller, samples: int, period: float) -> Samples:
    """Times of each question, which take turns."""
    asked: Mapping[str, Callable[[], object]] = {
        'service `get_parameters`': caller.ask_parameter,
        'service `describe_parameters`': lambda: caller.call(
            DescribeParameters, 'describe_parameters',
            DescribeParameters.Request(names=['map.alpha_min'])),
        'service `get_plan`, strategy known': lambda: caller.get_plan(START, GOAL),
        'bad map to its diagnostics': bad_maps(caller),
    }
    times: Samples = {name: [] for name in asked}
    begin = time.monotonic()
    for k in range(samples * len(asked)):
        caller.idle_until(begin + k * period)
        name = list(asked)[k % len(asked)]
        times[name].append(stopwatch(asked[name]))
    return times


def bad_maps(caller: Caller) -> Callable[[], None]:
    """Each call publishes another map that cannot be, and waits until the node says why."""
    publisher = caller.publisher(OccupancyGrid, '/alpha_map')
    widths = iter(range(1, 1_000_000))

    def ask() -> None:
        bad = OccupancyGrid(header=Header(frame_id=FRAME))
        bad.info.width = next(widths)
        publisher.publish(bad)
        told = f'width {bad.info.width},'
        caller.wait(lambda: told in caller.status['message'], 'diagnostics of a bad map')

    return ask


def large_maps(count: int, cells: int) -> list[float]:
    """Times of the map's callback for different maps, in a node of this process."""
    rng, times = np.random.default_rng(1), []
    with node_here() as node:
        (callback,) = (each.callback for each in node.subscriptions
                       if each.topic_name == '/alpha_map')
        for _ in range(count):
            values = rng.integers(0, 101, (cells, cells), dtype=np.int8)
            grid = occupancy_to_ros(values, 0.05, (0.0, 0.0, 0.0), Header(frame_id=FRAME))
            data = bytes(serialize_message(grid))
            times.append(stopwatch(lambda data=data: callback(data)))
    return times


@contextmanager
def node_here() -> Iterator[PlannerNode]:
    """A planner node in this process, not spinning."""
    context, off = Context(), Parameter('recording.enabled', value=False)
    with free_domain() as domain:
        rclpy.init(args=[], context=context, domain_id=domain)
        node = PlannerNode(context=context, parameter_overrides=[off])
        try:
            yield node
        finally:
            node.destroy_node()
            rclpy.try_shutdown(context=context)


def departures(calls: int, nodes: int, periods: tuple[float, ...]) -> list[Departures]:
    """Departures on a known strategy, recorded and not; with period 0 back to back."""
    parameters = {'network.target_nodes': nodes, **PATH}
    found = []
    with scratch() as folder, running_node(folder, parameters) as rig:
        with Caller(rig.domain, rig.process.check) as caller:
            caller.give(field(CELLS, RESOLUTION), START, GOAL)
            caller.new_route()
        with empty_service(rig.domain):
            for recording in (True, False):
                with Caller(rig.domain, rig.process.check) as caller:
                    caller.set_parameters({'recording.enabled': recording})
                found += [departures_every(rig, calls, recording, each) for each in periods]
    return found


def departures_every(rig: Rig, calls: int, recording: bool, period: float) -> Departures:
    """The caller that has the path's topic, too, is busy with the path when the answer comes."""
    say(f'{calls} departures of each kind, recording {recording}, every {period:g} s')
    times: Samples = {}
    with Caller(rig.domain, rig.process.check) as caller:
        caller.meet(EMPTY)
        _, times[NOTHING] = arrivals(caller, calls, period, lambda: caller.call(Trigger, EMPTY))
        read, times['`new_route`: answer arrived'] = arrivals(
            caller, calls, period, caller.new_route)
        times['`new_route`: answer read by Python'] = read
    with Caller(rig.domain, rig.process.check) as caller:
        # Not the paths themselves: with hundreds of them Python's garbage collector takes 0.2 s.
        received: list[tuple[float, int]] = []
        caller.subscribe(PathMessage, '/path', lambda path: received.append(
            (time.perf_counter(), len(path.poses))))
        caller.wait(lambda: received, 'the latest path')
        answers, paths = routes_and_paths(caller, calls, period, received)
    times['`new_route`: answer, where `path` is received, too'] = answers
    times['`new_route`: `path` received'] = paths
    with Caller(rig.domain, rig.process.check) as caller:
        read, times['`get_plan`: answer with the path arrived'] = arrivals(
            caller, calls, period, lambda: caller.get_plan(START, GOAL))
        times['`get_plan`: answer with the path read by Python'] = read
    return Departures(recording, period, times, [count for _, count in received])


def arrivals(
    caller: Caller, calls: int, period: float, ask: Callable[[], object]
) -> tuple[list[float], list[float]]:
    """Times until answers were read, and until they had arrived."""
    arrived: list[float] = []

    def timed() -> None:
        begin = time.perf_counter()
        ask()
        arrived.append(1e3 * (caller.arrived - begin))

    read = paced(caller, calls, period, timed)
    return read, arrived[1:]


def routes_and_paths(
    caller: Caller, calls: int, period: float, received: list[tuple[float, int]]
) -> tuple[list[float], list[float]]:
    """Times until the answer, and until the path came on its topic."""
    paths = []

    def ask() -> None:
        known, begin = len(received), time.perf_counter()
        caller.new_route()
        answered = time.perf_counter()
        caller.wait(lambda: len(received) > known, 'a path')
        paths.append(1e3 * (received[-1][0] - begin))
        answers.append(1e3 * (answered - begin))

    answers: list[float] = []
    paced(caller, calls, period, ask)
    return answers, paths


def paced(
    caller: Caller, calls: int, period: float, ask: Callable[[], object]
) -> list[float]:
    """Times of calls of which one begins each ``period`` [s]."""
    begin, times = time.monotonic(), []
    ask()  # the first one also meets the other
    for k in range(calls):
        caller.idle_until(begin + k * period)
        times.append(stopwatch(ask))
    return times


def stopwatch(run: Callable[[], object]) -> float:
    """What it takes [ms]."""
    begin = time.perf_counter()
    run()
    return 1e3 * (time.perf_counter() - begin)

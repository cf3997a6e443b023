"""A planner node in a process of its own and a caller beside it, for the benchmarks of the node."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ambush_planner.commands.node_process import NodeFailed, NodeProcess, free_domain
from ambush_planner.ros.conversions import occupancy_to_ros, pose_to_ros

FRAME = 'map'
PLANNER = '/ambush_planner'
# Discovery alone can take more than 3 s.
TIMEOUT = 30.0
# The node's own limit for a solve is 60 s.
ANSWER_TIMEOUT = 90.0
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MEGABYTE = 2.0**20
EMPTY = 'empty'
EMPTY_SERVICE = f"""
import rclpy
from rclpy.executors import ExternalShutdownException
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("empty")
node.create_service(Trigger, "{PLANNER}/{EMPTY}", lambda _, answer: answer)
try:
    rclpy.spin(node)
except ExternalShutdownException:
    pass
"""
TESTS = Path(__file__).resolve().parent.parent / 'test'


class NodeSilent(Exception):
    """The node did not do in time what it should."""


class Refused(Exception):
    """The node said no."""


@dataclass(frozen=True)
class Rig:
    """A running node: its process, its ROS domain and its folder."""

    process: NodeProcess
    domain: int
    folder: Path

    @property
    def log(self) -> str:
        """What the node has printed so far."""
        return (self.folder / 'node.log').read_text(errors='replace')

    @property
    def recordings(self) -> Path:
        """Where it records."""
        return self.folder / 'recordings'


FAILURES = (NodeFailed, NodeSilent, Refused)


@contextmanager
def scratch() -> Iterator[Path]:
    """A temporary folder, in which the processes started from here log, too."""
    with tempfile.TemporaryDirectory(prefix='ambush_planner_') as name:
        os.environ['ROS_LOG_DIR'] = str(Path(name, 'log'))
        yield Path(name)


def give_nodes_map_updates() -> None:
    """Let nodes started from now on have ``map_msgs``."""
    sys.path.append(str(TESTS))
    import interfaces
    interfaces.install('map_msgs')
    added = (str(interfaces.BUILT / 'map_msgs'), os.environ.get('PYTHONPATH', ''))
    os.environ['PYTHONPATH'] = os.pathsep.join(filter(None, added))


@contextmanager
def running_node(folder: Path, parameters: Mapping[str, object]) -> Iterator[Rig]:
    """Start a node that records and logs in a folder, and stop it in the end; see NodeProcess."""
    # Read by the middleware in this process, and inherited by the node's.
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    where = {'recording.directory': str(folder / 'recordings')}
    with free_domain() as domain:
        with NodeProcess({**where, **parameters}, domain, folder / 'node.log') as process:
            yield Rig(process, domain, folder)


@contextmanager
def empty_service(domain: int) -> Iterator[None]:
    """Serve, from a process of its own, a Trigger that does nothing: what ROS itself takes."""
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain)}
    process = subprocess.Popen([sys.executable, '-c', EMPTY_SERVICE], env=environment)
    try:
        yield
    finally:
        process.terminate()  # killed, it could take the node along: they share memory
        try:
            process.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class StampingExecutor(SingleThreadedExecutor):
    """Notes when an answer is there, before Python reads it."""

    arrived = 0.0

    def _take_client(self, client: Any) -> Any:
        self.arrived = time.perf_counter()
        return super()._take_client(client)


class Caller:
    """A ROS node in this process that asks the planner; to be used in a ``with``.

    ``check`` is called while waiting, and may raise. ``status`` holds the values of the latest
    diagnostics once ``watch_status`` was called.
    """

    def __init__(self, domain: int, check: Callable[[], None]) -> None:
        self._domain, self._check = domain, check
        self._clients: dict[tuple[str, int], Any] = {}
        self._publishers: dict[str, Any] = {}
        self.status: dict[str, str] = {}

    def __enter__(self) -> Caller:
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=self._domain)
        self.node = rclpy.create_node('caller', context=self._context)
        self._executor = StampingExecutor(context=self._context)
        self._executor.add_node(self.node)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    @property
    def arrived(self) -> float:
        """When the last answer was there, not read yet, by ``time.perf_counter``."""
        return self._executor.arrived

    def watch_status(self) -> None:
        """Keep the diagnostics from now on."""
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_status, 10)

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to a latched topic of the planner, and wait until it is there."""
        self.node.create_subscription(kind, topic, callback, LATCHED)
        self.wait(lambda: self.node.count_publishers(topic), f'a publisher of {topic}')

    def publisher(self, kind: type, topic: str) -> Any:
        """A publisher that the planner listens to."""
        if topic not in self._publishers:
            qos = LATCHED if kind is OccupancyGrid else 1
            made = self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
            self.wait(made.get_subscription_count, f'a subscription of {topic}')
        return self._publishers[topic]

    def client(self, kind: type, name: str, depth: int = 10) -> Any:
        """A client of a service of the planner; both have found each other."""
        if (name, depth) not in self._clients:
            service, qos = f'{PLANNER}/{name}', QoSProfile(depth=depth)
            made = self.node.create_client(kind, service, qos_profile=qos)
            self._clients[name, depth] = made
            self.wait(made.service_is_ready, f'the service {name}')
            self._be_met()
        return self._clients[name, depth]

    def _be_met(self) -> None:
        """Return once the planner knows the clients there are: until then answers are lost.

        It finds them in the order in which they were made, and answers this last one.
        """
        last = self.node.create_client(GetParameters, f'{PLANNER}/get_parameters')
        self._ask_until_answered(last)
        self.node.destroy_client(last)

    def _ask_until_answered(self, client: Any) -> None:
        """Call a service that changes nothing until it answers."""
        what = f'an answer of {client.srv_name}'
        self.wait(client.service_is_ready, what)
        deadline = time.monotonic() + ANSWER_TIMEOUT
        while True:
            future = client.call_async(client.srv_type.Request())
            try:
                return self.wait(future.done, what, 2.0)
            except NodeSilent:
                if time.monotonic() > deadline:
                    raise

    def send(self, kind: type, name: str, request: Any = None) -> Future:
        """Call a service of the planner; the future of the answer."""
        return self.client(kind, name).call_async(request or kind.Request())

    def call(self, kind: type, name: str, request: Any = None) -> Any:
        """Call a service of the planner; the answer. Raises NodeSilent."""
        future = self.send(kind, name, request)
        self.wait(future.done, f'an answer of {name}', ANSWER_TIMEOUT)
        return future.result()

    def meet(self, name: str) -> None:
        """Call a Trigger of another node, which does nothing, until it answers."""
        self._ask_until_answered(self.client(Trigger, name))

    def new_route(self) -> None:
        """Depart between the latest start and goal. Raises Refused."""
        self.trigger('new_route')

    def trigger(self, name: str) -> None:
        """Call a Trigger that has to succeed. Raises Refused."""
        answer = self.call(Trigger, name)
        if not answer.success:
            raise Refused(f'{name}: {answer.message}{self._others()}')

    def get_plan(self, start: PoseStamped, goal: PoseStamped) -> PathMessage:
        """Depart between two poses. Raises Refused."""
        path = self.call(GetPlan, 'get_plan', GetPlan.Request(start=start, goal=goal)).plan
        if not path.poses:
            raise Refused(f'get_plan: no path{self._others()}')
        return path

    def ask_parameter(self, name: str = 'strategy.solver') -> None:
        """The smallest thing that a node can be asked."""
        self.call(GetParameters, 'get_parameters', GetParameters.Request(names=[name]))

    def set_parameters(self, values: Mapping[str, Any]) -> str:
        """Set parameters together; empty, or why they were refused."""
        request = SetParametersAtomically.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])
        result = self.call(SetParametersAtomically, 'set_parameters_atomically', request).result
        return '' if result.successful else result.reason or 'no reason'

    def give(self, grid: OccupancyGrid, start: PoseStamped, goal: PoseStamped) -> None:
        """Publish the inputs, and wait until the node has some of each."""
        self.publisher(OccupancyGrid, '/alpha_map').publish(grid)
        self.publisher(PoseStamped, '/start_pose').publish(start)
        self.publisher(PoseStamped, '/goal_pose').publish(goal)
        if not self.status:
            self.watch_status()
        self.wait(lambda: self.status.get('state') == 'ready', 'map, start and goal to be taken')

    def idle_until(self, moment: float) -> None:
        """Take what comes until ``time.monotonic()`` is ``moment``."""
        while (left := moment - time.monotonic()) > 0.0:
            self._check()
            self._executor.spin_once(timeout_sec=left)

    def wait(
        self, done: Callable[[], object], what: str, timeout: float = TIMEOUT
    ) -> None:
        """Spin until ``done``; raises NodeSilent when the time is up."""
        deadline = time.monotonic() + timeout
        while not done():
            self._check()
            if time.monotonic() > deadline:
                raise NodeSilent(f'not within {timeout:g} s: {what}{self._others()}')
            self._executor.spin_once(timeout_sec=0.05)

    def _others(self) -> str:
        """Say so if a planner of somebody else has come into the domain: it answers, too."""
        count = self.node.get_node_names().count(PLANNER.strip('/'))
        return f'; there are {count} planners in ROS domain {self._domain}' if count != 1 else ''

    def _on_status(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.status = {value.key: value.value for value in status.values}


def field(cells: int, resolution: float, seed: int = 1) -> OccupancyGrid:
    """A square map without obstacles, rough enough that its game has many routes."""
    values = np.random.default_rng(seed).integers(0, 60, (cells, cells), dtype=np.int8)
    return occupancy_to_ros(values, resolution, (0.0, 0.0, 0.0), Header(frame_id=FRAME))


def pose(x: float, y: float, yaw: float = 0.0) -> PoseStamped:
    """A pose on the map."""
    return PoseStamped(header=Header(frame_id=FRAME), pose=pose_to_ros(x, y, yaw))


def resident(pid: int) -> float:
    """Memory of a process that is in RAM [MB]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / MEGABYTE


def processor_time(pid: int) -> float:
    """What a process has used of the processors so far, all its threads together [ms]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return 1e3 * (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def children(pid: int) -> list[int]:
    """Processes that a process has started and not yet waited for."""
    lists = Path(f'/proc/{pid}/task').glob('*/children')
    return [int(child) for each in lists for child in each.read_text().split()]


def shared_memory(pid: int) -> set[Path]:
    """Files of shared memory that a process uses."""
    lines = Path(f'/proc/{pid}/maps').read_text().splitlines()
    return {Path(line.split()[5]) for line in lines if ' /dev/shm/' in line}


def percentiles(samples: Sequence[float]) -> tuple[float, float, float]:
    """Median, 99th percentile, largest."""
    return statistics.median(samples), float(np.quantile(samples, 0.99)), max(samples)


def say(text: str) -> None:
    """Progress, which is no result."""
    print(text, file=sys.stderr, flush=True)

# SPDX-License-Identifier: Apache-2.0
"""A planner node in a process of its own and a client for it, shared by the node's benchmarks."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from report import RESULTS, publish
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from ambush_planner.ros.conversions import occupancy_to_ros, pose_to_ros
from ambush_planner.ros.topics import REQUESTS

sys.path.append(str(Path(__file__).resolve().parents[1]))
from examples.demo.client import NoAnswer, NodeClient
from examples.demo.node_process import NodeFailed, NodeProcess, free_domain

PLANNER = '/ambush_planner'
SERVICES: dict[str, Any] = {
    'new_route': Trigger, 'replan': Trigger, 'cancel': Trigger, 'get_plan': GetPlan,
    'get_parameters': GetParameters, 'describe_parameters': DescribeParameters,
    'set_parameters_atomically': SetParametersAtomically,
}
# Discovery alone can take more than 3 s.
TIMEOUT = 30.0
# The node's own time limit for a solve is 60 s.
ANSWER_TIMEOUT = 90.0
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Refused(Exception):
    """The node refused a request."""


class Caller(NodeClient):
    """A ROS node in this process that calls a planner, which is a ``process`` with a ``folder``."""

    def __init__(self, process: NodeProcess, domain: int, folder: Path) -> None:
        super().__init__(domain, process.check)
        self.process, self.folder = process, folder
        self._publishers: dict[str, Any] = {}

    def __enter__(self) -> Caller:
        super().__enter__()
        self._clients = {
            name: self.node.create_client(kind, f'{PLANNER}/{name}', qos_profile=REQUESTS)
            for name, kind in SERVICES.items()}
        # Answers are lost until the planner has discovered the client. It discovers what listens in
        # the order of its creation, so a report that arrives shows that it has.
        self.listen()
        for name, client in self._clients.items():
            self.wait(client.service_is_ready, f'no service {name}')
        self.wait(lambda: self.status, 'no diagnostics')
        return self

    def wait(self, done: Callable[[], object], failure: str, timeout: float = TIMEOUT) -> None:
        super().wait(done, failure, timeout)

    def publisher(self, kind: type, topic: str) -> Any:
        """A publisher to which the planner has subscribed."""
        if topic not in self._publishers:
            qos = LATCHED if kind is OccupancyGrid else 1
            made = self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
            self.wait(made.get_subscription_count, f'no subscription of {topic}')
        return self._publishers[topic]

    def call(self, name: str, request: Any = None) -> Any:
        """Call one of the ``SERVICES``; return the answer. Raises NoAnswer."""
        future = self._clients[name].call_async(request or SERVICES[name].Request())
        self.wait(future.done, f'no answer of {name}', ANSWER_TIMEOUT)
        return future.result()

    def trigger(self, name: str) -> None:
        """Call a Trigger that must succeed. Raises Refused."""
        answer = self.call(name)
        if not answer.success:
            raise Refused(f'{name}: {answer.message}')

    def get_plan(self, start: PoseStamped, goal: PoseStamped) -> PathMessage:
        """Depart between two poses. Raises Refused."""
        path = self.call('get_plan', GetPlan.Request(start=start, goal=goal)).plan
        if not path.poses:
            raise Refused('get_plan: no path')
        return path

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        """Set parameters together. Raises Refused."""
        request = SetParametersAtomically.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])
        result = self.call('set_parameters_atomically', request).result
        if not result.successful:
            raise Refused(f'parameters: {result.reason}')

    def give(self, grid: OccupancyGrid, start: PoseStamped, goal: PoseStamped) -> None:
        """Publish the inputs, and wait until the node has received all of them."""
        self.publisher(OccupancyGrid, '/alpha_map').publish(grid)
        self.publisher(PoseStamped, '/start_pose').publish(start)
        self.publisher(PoseStamped, '/goal_pose').publish(goal)
        self.wait(lambda: self.status.get('state') == 'ready', 'map, start and goal were not taken')

    def idle_until(self, moment: float) -> None:
        """Process messages until ``time.monotonic()`` is ``moment``."""
        while (left := moment - time.monotonic()) > 0.0:
            self.check()
            self.executor.spin_once(timeout_sec=left)


@contextmanager
def running_node(parameters: Mapping[str, object]) -> Iterator[Caller]:
    """Run a node that records and logs in a temporary folder; yield its caller."""
    # Read by the middleware in this process, and inherited by the node's.
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    with tempfile.TemporaryDirectory(prefix='ambush_planner_') as name, free_domain() as domain:
        folder = Path(name)
        os.environ['ROS_LOG_DIR'] = str(folder / 'log')
        settings = {'recording.directory': str(folder / 'recordings'), **parameters}
        with (NodeProcess(settings, domain, folder / 'node.log') as process,
              Caller(process, domain, folder) as caller):
            yield caller


def rough_map(cells: int, resolution: float) -> OccupancyGrid:
    """A square map without obstacles, rough enough that its game has many routes."""
    values = np.random.default_rng(1).integers(0, 60, (cells, cells), dtype=np.int8)
    return grid_of(values, resolution)


def grid_of(values: np.ndarray, resolution: float) -> OccupancyGrid:
    """The message of a map."""
    return occupancy_to_ros(values, resolution, (0.0, 0.0, 0.0), Header(frame_id='map'))


def pose(x: float, y: float) -> PoseStamped:
    """A pose on the map."""
    return PoseStamped(header=Header(frame_id='map'), pose=pose_to_ros(x, y))


def resident(pid: int) -> float:
    """Resident memory of a process [MB]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 2.0**20


def processor_time(pid: int) -> float:
    """Processor time that a process has taken [ms]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return 1e3 * (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def stopwatch(run: Callable[[], object]) -> float:
    """Duration of a call [ms]."""
    begin = time.perf_counter()
    run()
    return 1e3 * (time.perf_counter() - begin)


def within(samples: Sequence[float], median: float, seldom: float) -> bool:
    """Whether the median and the 99th percentile of samples are below these."""
    return bool((np.quantile(samples, [0.5, 0.99]) < (median, seldom)).all())


def say(text: str) -> None:
    """Print progress."""
    print(text, file=sys.stderr, flush=True)


def run_and_publish(
    measure: Callable[[], tuple[str, bool]], block: str, path: Path = RESULTS
) -> int:
    """Publish the text of a measurement; return 0, 1 if a target was missed, 2 on failure."""
    try:
        text, met = measure()
    except (NodeFailed, NoAnswer, Refused) as error:
        say(f'{block}: {error}')
        return 2
    publish(path, block, text)
    return int(not met)

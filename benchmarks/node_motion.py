"""A robot that drives, known by TF, beside a costmap that changes five times a second.

The robot follows the node's last path at up to ``--speed``. A new goal comes every ten seconds, and
a departure for the present goal is asked for every ``--period`` through get_plan. Meanwhile goals
of the action are sent, of which only the time until they are accepted counts. Node, map's
publisher and this caller are processes of their own. Exit code 1 if a target is missed.

tf2_msgs, map_msgs and nav2_msgs are built by test/interfaces.py where they are not installed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.srv import GetPlan
from node_rig import (
    PLANNER,
    TIMEOUT,
    Caller,
    Rig,
    grid_of,
    percentiles,
    pose,
    run_and_publish,
    running_node,
    say,
    spread,
)
from rclpy.action import ActionClient
from report import conditions, new_parser, table
from scipy.ndimage import distance_transform_edt, gaussian_filter
from std_msgs.msg import Header

from ambush_planner.ros.conversions import pose_to_ros

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path.append(str(REPOSITORY / 'test'))
import interfaces  # noqa: E402

for package in ('tf2_msgs', 'map_msgs', 'nav2_msgs'):
    interfaces.install(package)
os.environ['PYTHONPATH'] = os.pathsep.join(sys.path)  # of the node, too
from map_msgs.msg import OccupancyGridUpdate  # noqa: E402
from nav2_msgs.action import ComputePathToPose  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

RESOLUTION, RATE, NEW_GOAL = 0.05, 5.0, 10.0  # m, Hz, s
TF_PERIOD, ACTION_PERIOD = 0.02, 0.5  # s
SIDE, AWAY = 8, 1.0  # cells of the obstacle that moves; m that goals keep from the others
ARRIVED = 3.0  # m from the goal, where the next one comes
COVERED = ('START_OCCUPIED', 'GOAL_OCCUPIED')
# Targets: answers [s] and acceptance [ms], and the share of goals that may be accepted later.
MEDIAN, WORST, ACCEPTED = 0.3, 3.0, 20.0
LATE = {2000: 0.001, 4000: 0.01}
NAV2 = {'map.preset': 'costmap', 'robot_base_frame': 'base_link', 'route.path_spacing': 0.05,
        'network.target_nodes': 500, 'max_planning_time': 10.0, 'recording.enabled': False,
        'diagnostics.error_hold': 1.0}


def costmap(cells: int) -> np.ndarray:
    """A smooth map (H, W) with blocks."""
    rng = np.random.default_rng(1)
    rough = gaussian_filter(rng.random((cells, cells)), cells / 40)
    values = (60 * (rough - rough.min()) / np.ptp(rough)).astype(np.int8)
    for row, column in rng.integers(0, cells - cells // 25, (25, 2)):
        values[row:row + cells // 25, column:column + cells // 25] = 100
    return values


def publish_maps(cells: int, whole: bool) -> None:
    """Publish a map and its changes until killed, in a process of its own."""
    import rclpy
    from nav_msgs.msg import OccupancyGrid
    from node_rig import LATCHED
    from rclpy.serialization import serialize_message

    rclpy.init()
    node = rclpy.create_node('costmap')
    maps = node.create_publisher(OccupancyGrid, 'alpha_map', LATCHED)
    updates = node.create_publisher(OccupancyGridUpdate, 'alpha_map_updates', 10)
    values, rng = costmap(cells), np.random.default_rng(3)
    grid = grid_of(values, RESOLUTION)
    maps.publish(grid)
    before, header = (0, 0), Header(frame_id='map')
    data = bytearray(serialize_message(grid))
    cells_at = len(data) - values.size  # the cells come last
    begin, k = time.monotonic(), 0
    while rclpy.ok():
        k += 1
        time.sleep(max(0.0, begin + k / RATE - time.monotonic()))
        row, column = (int(each) for each in rng.integers(0, cells - SIDE, 2))
        for at, lethal in ((before, False), ((row, column), True)):
            part = (slice(at[0], at[0] + SIDE), slice(at[1], at[1] + SIDE))
            block = np.full((SIDE, SIDE), 100, np.int8) if lethal else values[part]
            if whole:
                shown = np.frombuffer(data, np.int8)[cells_at:].reshape(values.shape)
                shown[part] = block
            else:
                updates.publish(OccupancyGridUpdate(
                    header=header, x=at[1], y=at[0], width=SIDE, height=SIDE,
                    data=block.ravel().tolist()))
        if whole:
            maps.publish(bytes(data))
        before = row, column


@contextmanager
def changing_map(rig: Rig, cells: int, whole: bool) -> Iterator[None]:
    process = subprocess.Popen(
        [sys.executable, __file__, '--publish', str(cells), *(['--whole'] if whole else [])],
        env={**os.environ, 'ROS_DOMAIN_ID': str(rig.domain)})
    try:
        yield
    finally:
        process.terminate()
        process.wait(TIMEOUT)


class Robot:
    """A robot that follows paths and publishes where it is."""

    def __init__(self, caller: Caller, place: np.ndarray, speed: float) -> None:
        self._publisher = caller.node.create_publisher(TFMessage, '/tf', 100)
        self._clock = caller.node.get_clock()
        self.place, self._speed, self._path = place, speed, place[None]
        self._moved = time.monotonic()
        caller.node.create_timer(TF_PERIOD, self._move)

    def follow(self, path: np.ndarray) -> float:
        """Follow a path (L, 2) from its pose nearest to the robot; return how far that is [m]."""
        away = np.hypot(*(path - self.place).T)
        nearest = int(np.argmin(away[:max(1, len(path) // 2)]))
        self._path = path[nearest:]
        return float(away[0])

    def _move(self) -> None:
        now = time.monotonic()
        left, self._moved = self._speed * (now - self._moved), now
        while left > 0.0 and len(self._path):
            step = self._path[0] - self.place
            length = float(np.hypot(*step))
            if length > left:
                self.place = self.place + step * (left / length)
                break
            self.place, left, self._path = self._path[0], left - length, self._path[1:]
        at = TransformStamped(header=Header(frame_id='map', stamp=self._clock.now().to_msg()),
                              child_frame_id='base_link')
        at.transform.translation.x, at.transform.translation.y = map(float, self.place)
        at.transform.rotation.w = 1.0
        self._publisher.publish(TFMessage(transforms=[at]))


class Run:
    """One run: requests, their answers, and how long goals of the action take to be accepted."""

    def __init__(self, rig: Rig, caller: Caller, cells: int, speed: float) -> None:
        self.caller, self._rng, self._size = caller, np.random.default_rng(5), cells * RESOLUTION
        self._free = distance_transform_edt(costmap(cells) < 99) * RESOLUTION > AWAY
        self.robot: Robot | None = None
        self.robot = Robot(caller, self.goal(), speed)
        self.times: list[float] = []
        self.first: list[float] = []  # of a new goal
        self.accepted: list[float] = []
        self.refused: list[str] = []
        self.covered: list[str] = []  # the obstacle that moves has come to the robot or the goal
        self._action = ActionClient(caller.node, ComputePathToPose,
                                    f'{PLANNER}/compute_path_to_pose')

    def goal(self) -> np.ndarray:
        """A free place (2,), not near the map's edge or the robot."""
        while True:
            place = self._rng.uniform(0.1 * self._size, 0.9 * self._size, 2)
            near = np.hypot(*(self.robot.place - place)) < self._size / 3 if self.robot else False
            if not near and self._free[tuple((place[::-1] / RESOLUTION).astype(int))]:
                return place

    def ask(self, goal: np.ndarray, new: bool) -> None:
        """Ask for a departure from where the robot is, and follow it."""
        start = PoseStamped(header=Header(frame_id='base_link'), pose=pose_to_ros(0.0, 0.0))
        begin = time.monotonic()
        path = self.caller.call(GetPlan, 'get_plan',
                                GetPlan.Request(start=start, goal=pose(*goal))).plan
        spent = time.monotonic() - begin
        if not path.poses:
            self.caller.wait(lambda: self.caller.status.get('code', 'NONE') != 'NONE', 'the reason')
            code = self.caller.status['code']
            (self.covered if code in COVERED else self.refused).append(code)
            say(f"{code}: {self.caller.status['message']}"[:300])
            return
        (self.first if new else self.times).append(spent)
        places = [(p.pose.position.x, p.pose.position.y) for p in path.poses]
        self.robot.follow(np.array(places))

    def send_goal(self, goal: np.ndarray) -> None:
        """Send the action a goal, and note how long it takes to be accepted [ms]."""
        wish = ComputePathToPose.Goal(goal=pose(*goal), use_start=False)
        begin = time.monotonic()
        self._action.send_goal_async(wish).add_done_callback(
            lambda _: self.accepted.append(1e3 * (time.monotonic() - begin)))

    def accepted_alone(self, seconds: float) -> list[float]:
        """How long goals take to be accepted before there is a map [ms]: the machine's share."""
        self.caller.wait(self._action.server_is_ready, 'the action')
        end = time.monotonic() + seconds
        while time.monotonic() < end or not self.accepted:
            self.send_goal(self.robot.place)
            self.caller.idle_until(time.monotonic() + ACTION_PERIOD)
        alone, self.accepted = self.accepted, []
        return alone

    def drive(self, seconds: float, period: float) -> None:
        """Ask, drive and change the goal for the given time."""
        self.caller.client(GetPlan, 'get_plan')
        self.caller.wait(lambda: 'alpha_map' not in self.caller.status.get('message', 'alpha_map'),
                         'the map')
        self.ask(self.goal(), True)
        self.first.clear()
        begin = time.monotonic()
        due, changed, goal, new = begin, begin, self.goal(), True
        while (now := time.monotonic()) < begin + seconds:
            near = np.hypot(*(self.robot.place - goal)) < ARRIVED
            if near or now >= changed + NEW_GOAL:
                changed, goal, new = now, self.goal(), True
            if now >= due:
                due = now + period
                self.ask(goal, new)
                new = False
            self.send_goal(goal)
            self.caller.idle_until(time.monotonic() + ACTION_PERIOD)


def measure_one(cells: int, whole: bool, seconds: float, period: float, speed: float,
                parameters: dict[str, Any]) -> tuple[list[str], bool]:
    """One row of the table, and whether its targets are met."""
    with running_node({**NAV2, **parameters}) as rig, Caller(rig) as caller:
        run = Run(rig, caller, cells, speed)
        alone = run.accepted_alone(seconds / 4)
        with changing_map(rig, cells, whole):
            run.drive(seconds, period)
    every = [*run.first, *run.times]
    late = sum(each > ACCEPTED for each in run.accepted)
    median, _, worst = percentiles(every)
    met = not run.refused and median < MEDIAN and worst < WORST
    met = met and late <= LATE.get(cells, 0.001) * len(run.accepted)
    return [
        f'{cells} x {cells}, {"whole maps" if whole else "updates"}', str(len(every)),
        f'{len(run.covered)}, {len(run.refused)}', spread(every), spread(run.first),
        f'{late} of {len(run.accepted)}', spread(run.accepted), spread(alone),
        'yes' if met else '**no**',
    ], met


def measure(options: Any) -> tuple[str, bool]:
    """All cases: the table, and whether the targets are met."""
    rows, every = [], []
    for cells in options.cells:
        for whole in (False, True):
            say(f'{cells} x {cells} cells, {"whole" if whole else "updates"}')
            row, met = measure_one(cells, whole, options.seconds, options.period, options.speed,
                                   {'network.target_nodes': options.nodes})
            say(' | '.join(row))
            rows.append(row)
            every.append(met)
    head = ('map', 'departures', 'refused as occupied, refused',
            'answered: median / 99 % / largest [s]', 'first of a new goal [s]',
            f'goals accepted later than {ACCEPTED:g} ms', 'accepted [ms]',
            'without a map [ms]', 'met')
    text = (
        f"{conditions('ros-jazzy-rclpy')}.\n\nA robot at up to {options.speed:g} m/s, known by TF; "
        f'a departure every {options.period:g} s, a new goal every {NEW_GOAL:g} s, a map or an '
        f'update at {RATE:g} Hz, for {options.seconds:g} s.\n\n{table(head, rows)}\n\n'
        f'Targets: none refused but for the obstacle that moves, median < {MEDIAN:g} s, largest < '
        f'{WORST:g} s, at most 0.1 % of the goals accepted later than {ACCEPTED:g} ms (1 % at '
        '4000 x 4000 cells).'
    )
    return text, all(every)


def main() -> int:
    parser = new_parser(__doc__)
    parser.add_argument('--seconds', type=float, default=120.0, help='of each case')
    parser.add_argument('--period', type=float, default=1.0, help='seconds between departures')
    parser.add_argument('--speed', type=float, default=2.0, help='of the robot [m/s]')
    parser.add_argument('--cells', type=int, nargs='+', default=[400, 2000], metavar='N',
                        help="of the map's sides")
    parser.add_argument('--nodes', type=int, default=500, help='of the network')
    parser.add_argument('--publish', type=int, help='publish a map of this size (internal)')
    parser.add_argument('--whole', action='store_true', help='with --publish: whole maps')
    options = parser.parse_args()
    if options.publish:
        with suppress(RuntimeError):  # terminated while it publishes
            publish_maps(options.publish, options.whole)
        return 0
    return run_and_publish(lambda: measure(options), 'node_motion', options.results)


if __name__ == '__main__':
    sys.exit(main())

"""``ambush_demo``: real ground, the real node, departures over DDS, a report of the recordings."""

from __future__ import annotations

import argparse
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..errors import AmbushPlannerError
from ..game.game import GameOptions
from ..game.strategy import Strategy, StrategyOptions
from ..maps.ros_messages import path_from_ros
from ..planning.evaluation import energy_efficient_route, evaluate, risk_avoiding_route
from ..planning.frontier import frontier
from ..recordings import recordings_in
from ..recordings.durable_files import write_durably
from . import cli
from . import report_words as words
from .demo_client import DemoClient, NoAnswer
from .demo_figures import FixedRoute, routes_figure
from .demo_ground import GOAL, OPTIONS, RESOLUTION, START, load_ground
from .figures import as_png
from .frontier import write_frontier
from .node_process import NodeFailed, NodeProcess, free_domain
from .report import write_report

# Four cells: about 6000 nodes.
SPACING = 360.0
# Own troops hold the ground around the start and the goal.
SECURED_RADIUS = 2000.0
# Whoever waits can hit what comes within the weapon range that the map's risk is made with.
AMBUSH_RADIUS = OPTIONS.view.weapon_range
# Other budgets that the frontier shows, and the time for each of its strategies [s].
DETOURS, SLACKS, SWEEP_SECONDS = (1.1, 1.2, 1.5), (0.01, 0.1), 30.0
EPILOG = """\
It starts the node ambush_planner as a process of its own, publishes a risk map made from the
elevation model that comes with matplotlib, and asks for departures by service call. The folder
then holds a recording of each departure (MCAP, for ros2 bag and Foxglove), the report that
ambush_report writes of them, verified, routes.png, which has the routes beside those of planners
that leave no choice, frontier.png and frontier.csv (what other budgets would buy), and the node's
log.
--json: {"verdict", "folder", "departures", "value", "lower_bound", "seconds"}
""" + cli.EXIT_CODES


class DemoFailed(AmbushPlannerError):
    """What the demo left is not what it should be."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'demo', 'Random routes on real ground: departures, recordings, a report.', EPILOG
    )
    made.add_argument(
        '-o', '--output', type=Path, default=Path('out/demo'), metavar='FOLDER',
        help='where the results go; made if missing (default: %(default)s)',
    )
    made.add_argument(
        '-n', '--departures', type=cli.positive, default=8, metavar='COUNT',
        help='number of routes to ask for (default: %(default)s)',
    )
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> int:
    say = console.step
    folder = Path(os.path.abspath(options.output))
    folder.mkdir(parents=True, exist_ok=True)
    before = set(folder.rglob('*.mcap'))
    try:
        say('making the risk map from the elevation model')
        paths, seconds = _departures(load_ground().values, folder, options.departures, say)
    except (NodeFailed, NoAnswer) as error:
        raise DemoFailed(str(error)) from error
    recordings = [path for path in recordings_in(folder) if path not in before]
    if len(recordings) != options.departures:
        raise DemoFailed(f'{options.departures} departures left {len(recordings)} recordings')
    say('verifying the recordings and writing the report')
    written = write_report(recordings[0].parent, folder, True, console)
    if written.code != cli.Exit.HOLDS:
        raise DemoFailed('the recordings do not hold; see the report')
    strategy = written.sections[-1].strategy
    figure = routes_figure(
        written.sections[-1].risk_map, strategy, [path[:, :2] for path in paths],
        fixed_routes(strategy), SECURED_RADIUS,
    )
    write_durably(folder / 'routes.png', as_png(figure))
    say('frontier.png: what another length budget, or more risk, would buy')
    _sweep(strategy, folder)
    total = console.seconds
    console.line(table(strategy, paths, [*seconds, total]))
    console.line(f'\n{cli.place(folder)}: report.html, routes.png, frontier.png, '
                 'frontier.csv, node.log and the recordings')
    console.result = {
        'folder': cli.place(folder), 'departures': options.departures, 'value': strategy.value,
        'lower_bound': strategy.lower_bound, 'seconds': round(total, 1),
    }
    return cli.Exit.HOLDS


def _sweep(strategy: Strategy, folder: Path) -> None:
    """Other budgets on the same network, to choose by looking."""
    game = GameOptions(
        ambush_radius=strategy.game.ambush_radius, secured_radius=SECURED_RADIUS
    )
    options = StrategyOptions(time_limit=SWEEP_SECONDS)
    rows = frontier(strategy.network, game, DETOURS, SLACKS, options)
    write_frontier(folder / 'frontier.csv', rows, options.max_detour, options.risk_slack)


def _departures(
    values: np.ndarray, folder: Path, count: int, say: Callable[[str], None]
) -> tuple[list[FloatArray], list[float]]:
    """Return the departures' paths (L, 3), and how long each took [s]."""
    # Read by the middleware in this process, and inherited by the node's.
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    with ExitStack() as stack:
        domain = stack.enter_context(free_domain())
        say(f'starting the node in ROS domain {domain}')
        node = NodeProcess(_node_parameters(folder), domain, folder / 'node.log')
        check = stack.enter_context(_interrupts_held(node.check))
        stack.enter_context(node)
        client = stack.enter_context(DemoClient(domain, check))
        client.wait_for_node()
        rows, columns = values.shape
        say(f'publishing the map ({columns} x {rows} cells), start and goal')
        client.publish_inputs(values, RESOLUTION, START, GOAL)
        paths, seconds = [], []
        for k in range(count):
            say(f'departure {k + 1} of {count}' + (': solving the game' * (k == 0)))
            begin = time.monotonic()
            paths.append(path_from_ros(client.depart()))
            seconds.append(time.monotonic() - begin)
        say('stopping the node')
    say('the node ended with exit code 0')
    return paths, seconds


@contextmanager
def _interrupts_held(check: Callable[[], None]) -> Iterator[Callable[[], None]]:
    """Yield ``check`` as a function where SIGINT and SIGTERM raise KeyboardInterrupt, too.

    They do so nowhere else: rclpy turns an interrupt while it makes a message into a
    RuntimeError, and the node's end must not be interrupted.
    """
    came = threading.Event()

    def check_both() -> None:
        if came.is_set():
            raise KeyboardInterrupt
        check()

    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.signal(number, lambda *_: came.set()) for number in numbers]
    try:
        yield check_both
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    if came.is_set():
        raise KeyboardInterrupt


def _node_parameters(folder: Path) -> dict[str, object]:
    return {
        'network.spacing': SPACING,
        'game.secured_radius': SECURED_RADIUS,
        'game.ambush_radius': AMBUSH_RADIUS,
        'recording.enabled': True,
        'recording.directory': str(folder),
    }


def fixed_routes(strategy: Strategy) -> list[FixedRoute]:
    """The shortest and the safest route, each with its worst ambush, once it is known."""
    game, points = strategy.game, strategy.network.points
    measures = evaluate(strategy)
    routes = []
    for name, row, route in (
        ('shortest route', measures['energy_efficient'], energy_efficient_route(game)),
        ('safest route', measures['risk_avoidance'], risk_avoiding_route(game)),
    ):
        worst = route[np.argmax(game.loss[route])]
        label = f'{name} ({row.expected_length / 1000:.1f} km, loss {row.v_repeated:.2f})'
        routes.append(FixedRoute(label, points[route], points[worst]))
    return routes


def table(
    strategy: Strategy, paths: Sequence[FloatArray], seconds: Sequence[float]
) -> str:
    """The strategy in numbers, and how the departures went.

    ``seconds``: of each departure, and last of the whole demo.
    """
    first, *later, total = seconds
    further = f', {1000 * float(np.median(later)):.0f} ms a further one' if later else ''
    rows = [
        *words.quantities(strategy),
        *((words.PLANNERS[name], f'mean loss {row.v_repeated:.2f} once it is known')
          for name, row in evaluate(strategy).items() if name != 'stochastic'),
        ('different routes', f'{len({path.tobytes() for path in paths})} of {len(paths)}'),
        ('seconds', f'{total:.1f}; {first:.1f} for the first departure{further}'),
    ]
    return '\n' + '\n'.join(f'{name:<37} {told}' for name, told in rows)


main = cli.command(parser, _work)

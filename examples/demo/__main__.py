# SPDX-License-Identifier: Apache-2.0
"""``make demo``: departures on real terrain through the real node, with a verified report."""

from __future__ import annotations

import argparse
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from ambush_planner.arrays import FloatArray
from ambush_planner.commands import cli
from ambush_planner.commands import report_words as words
from ambush_planner.commands.frontier import write_frontier
from ambush_planner.commands.report import write_report
from ambush_planner.errors import AmbushPlannerError
from ambush_planner.game.strategy import StrategyOptions
from ambush_planner.map_figures import as_png
from ambush_planner.maps.ros_messages import path_from_ros
from ambush_planner.operations.frontier import trip_frontier
from ambush_planner.planning.evaluation import evaluate
from ambush_planner.recordings.durable_files import write_all_durably
from ambush_planner.recordings.recorded_departures import recordings_in
from ambush_planner.recordings.report_data import Section

from .figures import fixed_routes, routes_figure
from .ground import ELEVATION, GOAL, OPTIONS, RESOLUTION, START, load_ground
from .node_process import NodeProcess, free_domain

# Parameters of the network, if they are not the defaults.
NETWORK: dict[str, float] = {}
# Friendly forces hold the ground around start and goal [m].
SECURED_RADIUS = 2000.0
# Detours and slacks of the frontier, and the time limit of each solve [s].
DETOURS, SLACKS, SWEEP_SECONDS = (1.05, 1.1, 1.2, 1.5), (0.01, 0.1), 25.0
EPILOG = """\
The demo starts the node, publishes a risk map made from an elevation model of matplotlib's sample
data, and requests departures. FOLDER then holds the recordings (MCAP), their verified report.html,
routes.png (the routes next to fixed ones), frontier.csv (what other budgets would buy) and
node.log.
--json: {"verdict", "folder", "departures", "value", "lower_bound", "seconds"}
""" + cli.EXIT_CODES


class DemoFailed(AmbushPlannerError):
    """The node left other recordings than expected."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'demo', 'Run a real node on real terrain: departures, recordings, a report.', EPILOG
    )
    made.add_argument('-o', '--output', type=Path, default=Path('out/demo'), metavar='FOLDER',
                      help='folder for the results; made if missing (default: %(default)s)')
    made.add_argument('-n', '--departures', type=cli.number(1, 1e6, int), default=8,
                      metavar='COUNT', help='number of routes to request (default: %(default)s)')
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    folder = Path(os.path.abspath(options.output))
    folder.mkdir(parents=True, exist_ok=True)
    before = set(folder.rglob('*.mcap'))
    paths, seconds = _departures(folder, options.departures, console.step)
    recordings = [path for path in recordings_in(folder) if path not in before]
    if len(recordings) != options.departures:
        raise DemoFailed(f'{options.departures} departures left {len(recordings)} recordings')
    console.step('verifying the recordings and writing the report')
    code, sections = write_report(recordings[0].parent, folder, True, console)
    if code != cli.Exit.HOLDS:
        raise DemoFailed('the recordings could not be verified; see the report')
    section, trip = sections[-1], sections[-1].trip
    figure = routes_figure(section.risk_map, trip, [path[:, :2] for path in paths],
                           fixed_routes(trip.legs[0]))
    write_all_durably({folder / 'routes.png': as_png(figure, 'routes.png', [ELEVATION])})
    console.step('solving for other budgets')
    last, budgets = section.departures[-1], StrategyOptions(time_limit=SWEEP_SECONDS)
    planning = replace(last.parameters.planning, strategy=budgets)
    said = last.metadata.trip
    rows = trip_frontier(section.risk_map, said.start, said.goal, planning, DETOURS, SLACKS,
                         lambda row: console.step(
                             f'detour {row.max_detour:g}, slack {row.risk_slack:g}: '
                             f'value {row.value:.4g}'), planned=trip)
    write_frontier(folder / 'frontier.csv', rows)
    total = console.seconds
    console.line(table(section, paths, seconds, total))
    console.line(f'\n{cli.place(folder)}: report.html, routes.png, frontier.csv, '
                 'node.log and the recordings')
    console.result = {'folder': cli.place(folder), 'departures': options.departures,
                      'value': trip.value, 'lower_bound': trip.lower_bound,
                      'seconds': round(total, 1)}
    return cli.Exit.HOLDS


def _departures(folder: Path, count: int,
                say: Callable[[str], None]) -> tuple[list[FloatArray], list[float]]:
    """Return the paths (L, 3) of departures, and the time that each took [s]."""
    from .client import DemoClient

    # The middleware of this process reads it, and the node inherits it.
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    say('making the risk map from the elevation model')
    values = load_ground().values
    parameters = {
        **NETWORK, 'game.secured_radius': SECURED_RADIUS, 'route.start_tolerance': 0.0,
        'game.ambush_radius': OPTIONS.view.weapon_range, 'recording.enabled': True,
        'recording.directory': str(folder),
    }
    paths, seconds = [], []
    with free_domain() as domain:
        say(f'starting the node in ROS domain {domain}')
        node = NodeProcess(parameters, domain, folder / 'node.log')
        with (
            _interrupts_held(node.check) as check, node, DemoClient(domain, check) as client,
        ):
            say('publishing the map ({1} x {0} cells), start and goal'.format(*values.shape))
            client.publish_inputs(values, RESOLUTION, START, GOAL)
            for k in range(count):
                say(f'departure {k + 1} of {count}' + (': solving the game' * (k == 0)))
                begin = time.monotonic()
                paths.append(path_from_ros(client.depart()))
                seconds.append(time.monotonic() - begin)
                if k == 0:
                    say('refining the network where the ambusher waits')
                    client.wait_until_refined()
            say('stopping the node')
    return paths, seconds


@contextmanager
def _interrupts_held(check: Callable[[], None]) -> Iterator[Callable[[], None]]:
    """Yield ``check`` as the only place where SIGINT and SIGTERM raise KeyboardInterrupt.

    Elsewhere, rclpy turns an interrupt into a RuntimeError while it builds a message, and the
    node's shutdown must not be interrupted.
    """
    came: list[int] = []  # an Event's lock would not let one signal interrupt another

    def check_both() -> None:
        if came:
            raise KeyboardInterrupt
        check()

    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.signal(number, lambda got, _: came.append(got)) for number in numbers]
    try:
        yield check_both
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    if came:
        raise KeyboardInterrupt


def table(section: Section, paths: Sequence[FloatArray], seconds: Sequence[float],
          total: float) -> str:
    """Return the numbers of the strategy and of the departures, for a terminal."""
    first, *later = seconds
    further = f', {1000 * float(np.median(later)):.0f} ms for a further one' if later else ''
    rows = [
        *words.quantities(section),
        *((words.PLANNERS[name], f'mean loss {row.v_repeated:.2f} once it is known')
          for name, row in evaluate(section.trip.legs[0]).items() if name != 'stochastic'),
        ('different routes', f'{len({path.tobytes() for path in paths})} of {len(paths)}'),
        ('seconds', f'{total:.1f}; {first:.1f} for the first departure{further}'),
    ]
    return '\n' + '\n'.join(f'{name:<37} {value}' for name, value in rows)


main = cli.command(parser, _work)

if __name__ == '__main__':
    raise SystemExit(main())

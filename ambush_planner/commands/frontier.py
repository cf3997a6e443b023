# SPDX-License-Identifier: Apache-2.0
"""``ambush frontier``: what a longer detour, or a little more risk, buys."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import asdict, fields
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from ..colours import AMBUSHER
from . import cli
from .geo_files import add_outputs, check_outputs, write_table
from .planner_parser import planner_parser, source_names
from .positions import read_ground

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..operations.frontier import FrontierRow

EPILOG = """\
The table (.csv) has value, length, exposure and entropy for each budget, the picture (.png) the
same as curves.
"""
DETAILS = """\
Solves a strategy for each of --detours, all with --slack, and for each of --slacks, all with
--detour.
Columns of the table are value and lower_bound, expected_length [m; s on roads with speeds],
expected_exposure [loss x m], route_entropy [nats], and error if there is no strategy, which is a
finding.
--json: {"verdict", "files", "rows": [{...}]}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = planner_parser(
        'frontier', 'Compare length budgets and slacks: value, length, exposure, entropy.',
        EPILOG, DETAILS, '--start POSITION --goal POSITION [options] -o FILE ...',
        ('--detours', '--slacks'), stops=False)
    add_outputs(made, 'table and picture to write', ('.csv', '.png'))
    made.add_argument('--detours', type=float, nargs='+', metavar='D',
                      help="length budgets, as multiples of the shortest route's length "
                      '(default: 1.02 to 1.5)')
    made.add_argument('--slacks', type=float, nargs='+', metavar='E', help='shares '
                      'of the value to give up for less predictable routes (default: 0 to 0.3)')
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from .inputs import options_from

    of_map, planning = options_from(arguments)
    check_outputs(arguments.output, console)
    risk_map, (x, y), (to_x, to_y), _ = read_ground(arguments, of_map)

    from ..operations.frontier import DETOURS, SLACKS, trip_frontier

    detours, slacks = arguments.detours or DETOURS, arguments.slacks or SLACKS
    solved, budgets = count(1), len(detours) + len(slacks)
    with console.waiting('solving') as tell:
        rows = trip_frontier(risk_map, (x, y), (to_x, to_y), planning, detours, slacks,
                             lambda _: tell(f'{next(solved)} of {budgets} budgets'))
    write_frontier(arguments.output, rows, planning.strategy.max_detour,
                   planning.strategy.risk_slack, source_names(arguments))
    console.line(_as_text(rows))
    files = [cli.place(path) for path in arguments.output]
    console.line('\n' + ', '.join(files))
    console.result = {'files': files, 'rows': [asdict(row) for row in rows]}
    return cli.Exit.FINDING if any(row.error for row in rows) else cli.Exit.HOLDS


def write_frontier(paths: Sequence[Path], rows: Sequence[FrontierRow], max_detour: float,
                   risk_slack: float, sources: Sequence[str] = ()) -> None:
    """Write tables (.csv) and pictures (.png) with mode 0600."""
    from ..operations.frontier import FrontierRow

    write_table(paths, [each.name for each in fields(FrontierRow)], [asdict(row) for row in rows],
                lambda: frontier_figure(rows, max_detour, risk_slack), sources)


def _as_text(rows: Sequence[FrontierRow]) -> str:
    """Return a table for a terminal, with the length relative to the shortest."""
    head = ('detour', 'slack', 'value', 'gap', 'length', 'exposure', 'route entropy')
    lines = [''.join(f'{name:>14}' for name in head)]
    for row in rows:
        gap = (row.value - row.lower_bound) / row.value if row.value > 0.0 else 0.0
        numbers = f'  {row.error}' if row.error else (
            f'{row.value:14.4g}{gap:14.1e}{row.expected_length / row.shortest_length:14.3f}'
            f'{row.expected_exposure:14.4g}{row.route_entropy:14.2f}'
        )
        lines.append(f'{row.max_detour:14g}{row.risk_slack:14g}{numbers}')
    return '\n'.join(lines)


def frontier_figure(rows: Sequence[FrontierRow], max_detour: float, risk_slack: float) -> Figure:
    """Plot value, exposure and route entropy: over the detour (left) and over the slack (right).

    Dashed lines mark ``max_detour`` and ``risk_slack``, which are fixed in each other's sweep.
    """
    from matplotlib.figure import Figure

    from ..figures import PROBABILITY
    from ..map_figures import HALO, WIDTH

    figure = Figure(figsize=(WIDTH, 6.2), layout='constrained')
    panels = figure.subplots(3, 2, sharex='col', sharey='row')
    words = {'max_detour': 'detour', 'risk_slack': 'slack'}
    convoy, style = PROBABILITY(0.6), {'marker': 'o', 'markersize': 5, 'zorder': 3}
    for (value, exposure, entropy), name, fixed, title in (
        (panels[:, 0], 'max_detour', max_detour, f'Longer routes (slack {risk_slack:g})'),
        (panels[:, 1], 'risk_slack', risk_slack, f'More risk (detour {max_detour:g})'),
    ):
        solved = [row for row in rows if row.swept == name and not row.error]
        solved.sort(key=lambda row: getattr(row, name))
        x = [getattr(row, name) for row in solved]
        bound = value.plot(x, [row.lower_bound for row in solved], color='0.45', linestyle=':',
                           **style)
        lines = value.plot(x, [row.value for row in solved], color=AMBUSHER, **style)
        exposure.plot(x, [row.expected_exposure for row in solved], color=convoy, **style)
        entropy.plot(x, [row.route_entropy / math.log(10.0) for row in solved], color=convoy,
                     **style)
        for axes in (value, exposure, entropy):
            axes.axvline(fixed, color='0.6', linestyle='--', linewidth=1.2, zorder=1)
            axes.grid(color='0.92')
            axes.margins(y=0.15)
        value.annotate(f'{words[name]} {fixed:g}', (fixed, 1.0), xycoords=('data', 'axes fraction'),
                       xytext=(4, -14), textcoords='offset points', path_effects=HALO)
        value.set_title(title, loc='left')
    for axes, label in zip(panels[:, 0], (
        'mean loss\nby the best ambush', 'danger on the way\n(mean loss x m)',
        'equally likely routes\n(a power of 10)',
    ), strict=True):
        axes.set_ylabel(label)
        bottom, top = axes.get_ylim()
        axes.set_ylim(max(0.0, min(bottom, 0.8 * top)), top)  # small changes look small
    panels[2, 0].set_xlabel('detour: mean over shortest length')
    panels[2, 1].set_xlabel('slack: share of the value given up')
    panels[0, 0].legend([*lines, *bound], ['value', 'lower bound'], frameon=False)
    return figure


main = cli.command(parser, _work)

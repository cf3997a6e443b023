"""What a trip by way of stops costs beside its legs one by one, on the demo's terrain.

The table goes to the screen and into results.md, a picture of the trip into ``--picture``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from grounds import terrain
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from problems import TERRAIN_SECURED
from report import RESULTS, conditions, table, write_block

from ambush_planner import GameOptions, NetworkOptions, PlanningOptions, RiskMap, plan_trip
from ambush_planner.commands.figures import (
    draw_ambush_sites,
    draw_edges,
    draw_ends,
    draw_risk_map,
    draw_secured,
    frame,
)
from ambush_planner.planning.plan import Plan, departure_paths

STOPS = ((21015.0, 8955.0), (25020.0, 16020.0), (8685.0, 23625.0))
SPACING = 600.0
OPTIONS = PlanningOptions(
    NetworkOptions(spacing=SPACING), GameOptions(secured_radius=TERRAIN_SECURED)
)
# A reach in spacings.
REACH = 1.5
SHOWN = 6
COLOURS = ('#332288', '#cc3377', '#117733', '#e69f00', '#0072b2', '#56b4e9')


def timed(work: Callable[[], Plan]) -> tuple[Plan, float]:
    begin = time.process_time()
    return work(), time.process_time() - begin


def rows(options: PlanningOptions, name: str) -> tuple[list[list[str]], Plan]:
    """A row for the legs one by one, for the trip in the given order, and for the best order."""
    ground = terrain()
    places = (ground.start, *STOPS, ground.goal)
    legs = [
        timed(lambda pair=pair: plan_trip(ground.risk_map, *pair, options))
        for pair in pairwise(places)
    ]
    alone = sum(seconds for _, seconds in legs)
    values = [leg.strategy.value for leg, _ in legs]
    found = [[
        f'{name}: {len(legs)} legs one by one', '-', f'{max(values):.4g} to {sum(values):.4g}', '-',
        f'{sum(leg.strategy.expected_length for leg, _ in legs) / 1000:.1f}', f'{alone:.2f}', '1',
    ]]
    for order in ('given', 'best'):
        trip, seconds = timed(lambda order=order: plan_trip(
            ground.risk_map, ground.start, ground.goal, options, stops=STOPS, order=order))
        found.append([
            f'{name}: trip, {order} order', ' '.join(str(k + 1) for k in trip.order),
            f'{trip.strategy.value:.4g}', f'{trip.strategy.gap / trip.strategy.value:.1e}',
            f'{trip.strategy.expected_length / 1000:.1f}', f'{seconds:.2f}',
            f'**{seconds / alone:.1f}**',
        ])
    return found, trip


def picture(risk_map: RiskMap, trip: Plan) -> Figure:
    """The strategy over all legs on the left, departures on the right."""
    figure = Figure(figsize=(15.0, 9.0), dpi=110, layout='compressed')
    left, right = figure.subplots(1, 2)
    strategy, network = trip.strategy, trip.network
    start, *stops, goal = network.points[[network.source, *network.stops, network.target]]
    frame(left, risk_map, f'One strategy over {network.legs} legs: mean loss {strategy.value:.2f}')
    frame(right, risk_map, f'{SHOWN} departures')
    draw_edges(left, network, strategy.edge_probability)
    draw_ambush_sites(left, network, strategy.ambush_probability)
    paths = departure_paths(trip, SHOWN, 100.0, np.random.default_rng(1))
    for path, colour in zip(paths, COLOURS, strict=True):
        right.plot(*path[:, :2].T, color=colour, linewidth=1.4, zorder=4)
    for axes in (left, right):
        draw_risk_map(axes, risk_map)
        draw_secured(axes, [start, *stops, goal], TERRAIN_SECURED)
        draw_ends(axes, start, goal, stops)
    figure.legend(
        handles=[Line2D([], [], color=COLOURS[4], label='likely edges'),
                 Line2D([], [], color='black', linestyle='--', label='secured ground')],
        loc='lower center', ncol=2)
    return figure


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument('--picture', type=Path, help='where the picture goes')
    parser.add_argument('--print-only', action='store_true', help='leave results.md as it is')
    arguments = parser.parse_args()
    reaching = replace(OPTIONS, game=replace(OPTIONS.game, ambush_radius=REACH * SPACING))
    plain, trip = rows(OPTIONS, 'no reach')
    wide, _ = rows(reaching, f'reach {REACH * SPACING:g} m')
    text = table(
        ['', 'stops', 'value', 'gap, relative', 'km', 'processor seconds', 'ratio'],
        [*plain, *wide])
    text += f'\n\n{len(trip.network.points)} nodes in {trip.network.legs} layers. {conditions()}.'
    print(text)
    if not arguments.print_only:
        write_block(RESULTS, 'trips', text)
    if arguments.picture:
        picture(terrain().risk_map, trip).savefig(arguments.picture)
    return 0


if __name__ == '__main__':
    sys.exit(main())

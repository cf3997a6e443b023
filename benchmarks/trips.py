"""Cost of a trip with stops compared with its legs one by one, on the demo's terrain."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

from report import conditions, new_parser, publish, table
from scenarios import Scenario, terrain

from ambush_planner import GameOptions, NetworkOptions, PlanningOptions, plan_trip
from ambush_planner.planning.plan import Plan

STOPS = ((21015.0, 8955.0), (25020.0, 16020.0), (8685.0, 23625.0))
REACH = 1.5  # spacings
TERRAIN_SECURED = 2000.0  # m


def timed(work: Callable[[], Plan]) -> tuple[Plan, float]:
    begin = time.process_time()
    return work(), time.process_time() - begin


def measure(
    scenario: Scenario, options: PlanningOptions, name: str
) -> tuple[list[list[str]], Plan]:
    """A row for the legs one by one, for the trip in the given order, and for the best order."""
    places = (scenario.start, *STOPS, scenario.goal)
    legs = [
        timed(lambda pair=pair: plan_trip(scenario.risk_map, *pair, options))
        for pair in pairwise(places)
    ]
    alone = sum(seconds for _, seconds in legs)
    values = [leg.strategy.value for leg, _ in legs]
    rows = [[
        f'{name}: {len(legs)} legs one by one', '-', f'{max(values):.4g} to {sum(values):.4g}', '-',
        f'{sum(leg.strategy.expected_length for leg, _ in legs) / 1000:.1f}', f'{alone:.2f}', '1',
    ]]
    for order in ('given', 'best'):
        trip, seconds = timed(lambda order=order: plan_trip(
            scenario.risk_map, scenario.start, scenario.goal, options, stops=STOPS, order=order))
        rows.append([
            f'{name}: trip, {order} order', ' '.join(str(k + 1) for k in trip.order),
            f'{trip.strategy.value:.4g}', f'{trip.strategy.gap / trip.strategy.value:.1e}',
            f'{trip.strategy.expected_length / 1000:.1f}', f'{seconds:.2f}',
            f'**{seconds / alone:.1f}**',
        ])
    return rows, trip


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--spacing', type=float, default=600.0, help='of the nodes [m]')
    arguments = parser.parse_args()
    options = PlanningOptions(
        NetworkOptions(spacing=arguments.spacing), GameOptions(secured_radius=TERRAIN_SECURED)
    )
    reach = REACH * arguments.spacing
    scenario = terrain()
    plain, trip = measure(scenario, options, 'no reach')
    wide, _ = measure(
        scenario, replace(options, game=replace(options.game, ambush_radius=reach)),
        f'reach {reach:g} m',
    )
    head = ['', 'stops', 'value', 'gap, relative', 'km', 'processor seconds', 'ratio']
    publish(arguments.results, 'trips', (
        f'{table(head, [*plain, *wide])}\n\n{len(trip.network.points)} nodes in '
        f'{trip.network.legs} layers. {conditions()}.'
    ))


if __name__ == '__main__':
    main()

# SPDX-License-Identifier: Apache-2.0
"""Recordings of departures for the tests of the tools, written as the format says."""

from functools import cache

import numpy as np
from games import plain_options
from recording_samples import metadata_entries, new_route_call

from ambush_planner.game.game import GameOptions
from ambush_planner.game.strategy import StrategyOptions
from ambush_planner.maps.occupancy import OccupancyOptions, risk_from_occupancy
from ambush_planner.parameters.table import PARAMETERS
from ambush_planner.planning.options import PlanningOptions
from ambush_planner.planning.trip import plan_trip
from ambush_planner.recordings.attachments import strategy_file
from ambush_planner.recordings.encoding import encode
from ambush_planner.recordings.messages import map_message, path_message, pose_message

START_NS = 1_700_000_000_000_000_000
DAY_NS = 86_400_000_000_000
START, GOAL = (12.5, 147.5), (387.5, 152.5)
SPACING, SECURED = 20.0, 40.0


def occupancy(hill=60):
    """A hill in the middle that cannot be crossed, bad ground around it, 40 x 60 cells of 5 m."""
    row, column = np.mgrid[:60, :80]
    away = np.hypot(row - 30, column - 40)
    values = np.clip(95 - 3 * away, 0, 95) + 2 * ((row + column) % 3)
    values[away < 8] = 100
    values[(row > 45) & (column > 30)] += hill // 10
    return np.clip(values, 0, 100).astype(np.int8)


def parameters(**changes):
    values = {name: declaration.default for name, declaration in PARAMETERS.items()}
    values |= {'network.spacing': SPACING, 'game.secured_radius': SECURED}
    return values | changes


@cache
def sample_plan(solver='max_entropy', hill=60, start=START, reach=0.0, held=()):
    risk_map = risk_from_occupancy(occupancy(hill), 5.0, options=OccupancyOptions())
    options = PlanningOptions(
        network=plain_options(spacing=SPACING),
        game=GameOptions(ambush_radius=reach, secured_radius=SECURED, secured_places=held),
        strategy=StrategyOptions(solver=solver),
    )
    return plan_trip(risk_map, start, GOAL, options)


def departure(a_plan, route, number=1, hill=60, strategy=None, entries=(), stamp_ns=None,
              start=START, changes=b''):
    """Messages, metadata and attachments of one departure; ``entries`` replace metadata entries.

    ``changes`` are the bytes of a map_changes.npz.
    """
    strategy = strategy_file(a_plan.trip) if strategy is None else strategy
    stamp = START_NS + number * DAY_NS if stamp_ns is None else stamp_ns
    poses = np.column_stack((a_plan.network.points[route], np.zeros(len(route))))
    risk_map = risk_from_occupancy(occupancy(hill), 5.0)
    messages = [map_message(risk_map, OccupancyOptions(), 'map', stamp),
                pose_message('/start_pose', start, 'map', stamp),
                pose_message('/goal_pose', GOAL, 'map', stamp), path_message(poses, 'map', stamp)]
    metadata = metadata_entries() | {
        'departure_id': f'00000000-0000-4000-8000-{number:012d}', 'departure': number,
        'parameters': parameters(), 'trip': {'start': start, 'goal': GOAL, 'stops': []},
        'ends': [start, GOAL], 'value': a_plan.value, 'route': [[int(node) for node in route]],
        'route_entropy_source': [source(number)], 'call': new_route_call(stamp), **dict(entries),
    }
    files = {'strategy.npz': strategy, 'map_changes.npz': changes}
    return messages, metadata, {name: data for name, data in files.items() if data}


def source(number):
    """256 random bits."""
    return int.from_bytes(np.random.default_rng(number).bytes(32), 'big') | 2**255


def record(folder, departures):
    """Write departures as one session, whatever is in them, and return their files."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f'run_{k}.mcap' for k in range(len(departures))]
    for path, (messages, metadata, files) in zip(paths, departures, strict=True):
        path.write_bytes(encode(messages, metadata, files, 'zstd'))
    return paths


def record_drawn(folder, count, a_plan=None, seed=1, **options):
    """Record departures that are drawn from a plan, by default the sample; return their files."""
    a_plan = a_plan or sample_plan()
    return record(folder, [departure(a_plan, route, number, **options)
                           for number, route in enumerate(drawn(a_plan, count, seed), start=1)])


def drawn(a_plan, count, seed=1):
    rng = np.random.default_rng(seed)
    return [a_plan.strategy.sample_route(rng) for _ in range(count)]


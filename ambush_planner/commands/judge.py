# SPDX-License-Identifier: Apache-2.0
"""``ambush judge``: what an ambusher causes who has watched the trips that were driven."""

from __future__ import annotations

import argparse
import math
import warnings
from collections import Counter
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InvalidOption
from ..words import distance, percent
from . import cli, readers
from .planner_parser import planner_parser, source_names
from .positions import read_ground

if TYPE_CHECKING:
    from ..maps.risk_map import RiskMap
    from ..maps.track_file import Track
    from ..operations.judge import Habits
    from ..operations.path_mixtures import PathMixture

EPILOG = """\
TRACKS are GPX or CSV files (x and y, or lat and lon), lines of a vector file, recordings, or
folders of these. Trips are found between start and goal; their mean length is the budget of the
optimal strategy.
"""
DETAILS = """\
Of TRACKS are read, and in a folder all .gpx, .csv and .mcap:
  .gpx    tracks, or routes if there are none
  .csv    columns x and y [m] or lat and lon [degrees]; optional are time (ISO 8601) and what tells
          tracks apart (track, vehicle, device_id, imei, trip, ...)
  .mcap   recordings
  others  lines of a GeoPackage, GeoJSON or other vector file; FILE|layername=NAME names a layer
A trip leads from the last approach to the start to the first approach to the goal after it. The
picture has mode 0600.
--json: {"verdict", "picture", "trips", "left_out", "near", "max_detour", "interval",
"shares": [{"track", "share"}], "driven": {...}, "reweighted": {...}, "optimal": {...}}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = planner_parser(
        'judge', 'Judge trips that were driven: what would an ambusher cause who has watched them?',
        EPILOG, DETAILS, 'TRACKS ... --start POSITION --goal POSITION [options] -o PICTURE.png',
        stops=False, hidden='detour')  # the tracks set the length budget
    made.add_argument('tracks', nargs='+', metavar='TRACKS', help='tracks of trips, or recordings')
    made.add_argument('-o', '--output', type=cli.file_of('.png'), required=True,
                      metavar='PICTURE.png', help='the picture to write')
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    from ..game.strategy import StrategyOptions
    from .inputs import options_from

    (of_map, planning), output = options_from(arguments), arguments.output
    if arguments.detour is not None or planning.strategy.max_detour != StrategyOptions.max_detour:
        raise cli.UsageError('the tracks set the length budget: leave out --detour and '
                             'strategy.max_detour')
    if not planning.game.ambush_radius > 0.0:
        raise InvalidOption('how far does an ambusher reach? Add --reach METRES')

    risk_map, start, goal, _ = read_ground(arguments, of_map)

    from ..map_figures import as_png
    from ..operations.judge import NEAR, find_trips, judge
    from ..planning.concerns import concerns, is_sound
    from ..planning.options import solved_game
    from ..recordings.durable_files import write_all_durably
    from .judge_figure import judge_figure

    tracks = [track for source in arguments.tracks for track in _tracks(source, risk_map, console)]
    game = solved_game(risk_map, planning)
    near = max(game.ambush_radius, game.secured_distance, NEAR * math.dist(start, goal))
    trips, left_out = find_trips(tracks, start, goal, near, game.ambush_radius)
    days = [f'{datetime.fromtimestamp(each.times[0], timezone.utc):%Y-%m-%d}' for each in trips
            if each.times is not None]
    console.line(f'{cli.count(len(trips), "trip")} within {near:.4g} m of start and goal'
                 + (f', {min(days)} to {max(days)}' if days else ''))
    for reason, count in Counter(each.reason for each in left_out).items():
        first = next(each for each in left_out if each.reason == reason)
        console.item(f'left out: {first}' if count == 1 else f'left out: {count} tracks, such as '
                     f'{first.name}, which {reason}{first.detail}', 0)
    console.result = {'trips': len(trips), 'left_out': [*map(str, left_out)], 'near': near}
    if not trips:
        console.error('no track has a trip from start to goal')
        return cli.Exit.TOO_FEW
    with console.waiting('solving the game'), warnings.catch_warnings():
        warnings.simplefilter('ignore')  # rounding at values of 0
        habits = judge(risk_map, trips, planning)
    write_all_durably({output: as_png(judge_figure(habits, risk_map), output.name,
                                      source_names(arguments))})
    _tell(habits, risk_map, console)
    for text in concerns(habits.plan, lambda xy: arguments.start[0].like(xy, risk_map)):
        console.warn(text)
    console.result['picture'] = console.secret([output])[0]
    return cli.Exit.HOLDS if is_sound(habits.plan) else cli.Exit.FINDING


def _tracks(source: str, risk_map: RiskMap, console: cli.Console) -> Iterator[Track]:
    """The tracks of a file, or of the files and recordings in a folder."""
    import numpy as np

    from ..maps.tables import InvalidFeatures
    from ..maps.track_file import Track, read_tracks

    path = Path(source)
    if not path.is_dir() and path.suffix.lower() != '.mcap':
        yield from read_tracks(source, risk_map)
        return
    files = sorted(each for each in path.rglob('*') if each.suffix.lower() in ('.gpx', '.csv'))
    for file in files:
        yield from read_tracks(str(file), risk_map)
    if path.is_dir() and not any(path.rglob('*.mcap')):
        if not files:
            raise InvalidFeatures(f'{path}: no .gpx, .csv or .mcap file in this folder')
        return
    departures, unreadable, _ = readers.read_all(path, console)
    if unreadable:
        raise unreadable[0]
    for each in departures:
        poses = each.path_poses
        yield Track(each.path.name, poses[:, :2], np.full(len(poses), each.stamp_ns / 1e9))


def _tell(habits: Habits, risk_map: RiskMap, console: cli.Console) -> None:
    import numpy as np

    from ..planning.concerns import assumptions
    from .judge_figure import MIN_SHARE

    strategy, hit, shares = habits.plan.strategy, habits.driven.hit, habits.best.shares
    (low, high), detour = habits.interval, habits.plan.options.strategy.max_detour
    named = [{'track': habits.trips[k].name, 'share': float(shares[k])}
             for k in np.argsort(-shares) if shares[k] >= MIN_SHARE]
    rows = {'driven': _numbers(habits.driven, habits, risk_map),
            'reweighted': _numbers(habits.best, habits, risk_map),
            'optimal': {'value': strategy.value, 'mean_length': habits.plan.driven_length,
                        'lower_bound': strategy.lower_bound}}
    separator = ',' if risk_map.crs else ' '  # as in a POSITION
    places = [separator.join(map(str, row.get('worst_lat_lon', row['worst_xy'])))
              for row in (rows['driven'], rows['reweighted'])]
    console.line(f'{"mean loss":>21}{"mean length":>13}')
    for (name, row), text in zip(rows.items(), (
        f'worst at {places[0]}: {hit.sum()} of {len(hit)} trips; 95 %: {low:.4g} to {high:.4g}',
        f'worst at {places[1]}',
        f'on its network, none of {detour:.3g} times the shortest is below '
        f'{strategy.lower_bound:.4g}',
    ), strict=True):
        console.line(f'{name:<11}{row["value"]:>10.4g}{distance(row["mean_length"]):>13}  {text}')
    for name, text in (
        ('reweighted', ', '.join(f'{percent(each["share"])} {each["track"]}' for each in named)),
        ('assumption', '; '.join(assumptions(habits.plan)[:2])),
    ):
        console.item(f'{name:<11}{text}', 0)
    console.result |= {**rows, 'max_detour': detour, 'interval': [low, high], 'shares': named}


def _numbers(mixture: PathMixture, habits: Habits, risk_map: RiskMap) -> dict[str, Any]:
    from ..maps.coordinates import Coordinates

    at, crs = mixture.worst_xy, risk_map.crs
    return {'value': mixture.value, 'mean_length': float(mixture.shares @ habits.lengths),
            'worst_xy': at.round(2).tolist(), **({
                'worst_lat_lon': Coordinates(crs).to_lat_lon(at).round(6).tolist()} if crs else {})}


main = cli.command(parser, _work)

# SPDX-License-Identifier: Apache-2.0
"""``ambush judge``: what an ambusher causes who has watched the trips that were driven."""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..game.strategy import StrategyOptions
from ..map_figures import as_png
from ..maps.coordinates import Coordinates
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import read_risk_map
from ..maps.track_file import Track, read_tracks
from ..operations.judge import NEAR, Habits, find_trips, judge
from ..operations.path_mixtures import PathMixture
from ..planning.concerns import assumptions, concerns, is_sound
from ..planning.options import solved_game
from ..recordings.durable_files import write_all_durably
from ..words import distance, percent
from . import cli, readers
from .inputs import options_from, planner_parser
from .judge_figure import MIN_SHARE, judge_figure
from .positions import places_on

EPILOG = """\
TRACKS are GPX or CSV files (x and y, or lat and lon), lines of a vector file, or recordings. Trips
are found between start and goal; their mean length is the budget of the optimal strategy.
"""
DETAILS = """\
Of TRACKS are read, if they are no recordings (.mcap, or a folder):
  .gpx    tracks, or routes if there are none
  .csv    columns x and y [m] or lat and lon [degrees], optional track and time (ISO 8601 or [s])
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
    (of_map, planning), output = options_from(arguments), arguments.output
    if arguments.detour is not None or planning.strategy.max_detour != StrategyOptions.max_detour:
        raise cli.UsageError('the tracks set the length budget: leave out --detour and '
                             'strategy.max_detour')
    if not planning.game.ambush_radius > 0.0:
        raise InvalidOption('how far does an ambusher reach? Add --reach METRES')
    risk_map = read_risk_map(arguments.map, of_map)
    start, goal, _ = places_on(arguments, risk_map)
    tracks = [track for source in arguments.tracks for track in _tracks(source, risk_map, console)]
    game = solved_game(risk_map, planning)
    near = max(game.ambush_radius, game.secured_distance, NEAR * math.dist(start, goal))
    trips, left_out = find_trips(tracks, start, goal, near, game.ambush_radius)
    console.line(f'{cli.count(len(trips), "trip")} within {near:.4g} m of start and goal')
    for sentence in left_out:
        console.item(f'left out: {sentence}', 0)
    console.result = {'trips': len(trips), 'left_out': left_out, 'near': near}
    if not trips:
        console.error('no track has a trip from start to goal')
        return cli.Exit.TOO_FEW
    with console.waiting('solving the game'), warnings.catch_warnings():
        warnings.simplefilter('ignore')  # rounding at values of 0
        habits = judge(risk_map, trips, planning)
    write_all_durably({output: as_png(judge_figure(habits, risk_map))})
    _tell(habits, risk_map, console)
    for text in concerns(habits.plan):
        console.warn(text)
    console.result['picture'] = console.secret([output])[0]
    return cli.Exit.HOLDS if is_sound(habits.plan) else cli.Exit.FINDING


def _tracks(source: str, risk_map: RiskMap, console: cli.Console) -> Iterator[Track]:
    """The tracks of a file, or of recordings in a file or a folder."""
    path = Path(source)
    if not path.is_dir() and path.suffix.lower() != '.mcap':
        yield from read_tracks(source, risk_map.crs)
        return
    departures, unreadable, _ = readers.read_all(path, console)
    if unreadable:
        raise unreadable[0]
    for each in departures:
        poses = each.path_poses
        yield Track(each.path.name, poses[:, :2], np.full(len(poses), each.stamp_ns / 1e9))


def _tell(habits: Habits, risk_map: RiskMap, console: cli.Console) -> None:
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
    at, crs = mixture.worst_xy, risk_map.crs
    return {'value': mixture.value, 'mean_length': float(mixture.shares @ habits.lengths),
            'worst_xy': at.round(2).tolist(), **({
                'worst_lat_lon': Coordinates(crs).to_lat_lon(at).round(6).tolist()} if crs else {})}


main = cli.command(parser, _work)

# SPDX-License-Identifier: Apache-2.0
"""``ambush draw``: departures from a plan file, recorded, with the driver's card and route."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from datetime import date, datetime, timedelta, timezone
from pathlib import Path
from typing import TYPE_CHECKING

from ..route_files import SUFFIXES
from ..words import distance
from . import cli
from .card import add_speed
from .console import when
from .geo_files import require_for

if TYPE_CHECKING:
    from ..recordings import plan_departures
    from ..recordings.metadata import Metadata, RecordedDay
    from ..recordings.plan_file import SavedPlan

CARD = '.html'
DESCRIPTION = """\
Draw a departure from a plan, and record it. The operating system's entropy draws.

  ambush draw week.plan -o card.html route.gpx
  ambush draw week.plan --days 5 -o card.html      five days at once, a sealed card for each"""
EPILOG = """\
PLAN is a file of ambush plan -o PLAN. The recording is in the folder PLAN.departures next to it,
which verify, audit, report, judge, export and card read. FILE is the driver's card (.html) or the
route in a format of ambush export (.gpx for a receiver, .gpkg, .geojson, .csv, .png); nothing in it
tells of other routes. With --days, the day is in the name of each file, as in
card_2026-11-30.html, and the console does not tell the routes.
If a departure for the same day and slot was drawn before, from this plan or from one next to it for
the same trip, say with --earlier whether it was driven; on a terminal, the command asks. One that
was not driven does not count in audit and report; they name it, and --why.
The exit code is 1, and nothing is drawn, if map, roads or layers of the plan have changed. If the
plan's gap is wide, it warns and the exit code is 1.
If a file cannot be written, nothing is, and nothing has been drawn.
"""
DETAILS = """\
--json: {"verdict", "files", "departures": [{"number", "date", "slot", "length", "recording"}]}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'draw', DESCRIPTION, EPILOG,
        ('-o', '--date', '--days', '--slot', '--speed', '--earlier', '--why', '--dry-run'), DETAILS,
        'ambush draw PLAN [options]')
    made.add_argument('plan', type=cli.existing, metavar='PLAN', help='the plan, such as week.plan')
    made.add_argument('-o', '--output', type=cli.file_of(CARD, *SUFFIXES), nargs='+', default=[],
                      metavar='FILE', help=f'card{CARD}, or a route: {", ".join(SUFFIXES)}')
    made.add_argument('--date', type=_date, metavar='YYYY-MM-DD',
                      help='day of the departure, or of the first one (default: today)')
    made.add_argument('--days', type=cli.number(1, 366, int), metavar='COUNT',
                      help='one departure a day, this many days')
    made.add_argument('--slot', type=cli.time_of_day, metavar='HH:MM',
                      help='time of departure (default: drawn, if the plan has slots)')
    add_speed(made)
    made.add_argument('--earlier', choices=('driven', 'unused'), help='whether the departure that '
                      'was drawn before for the same day was driven')
    made.add_argument('--why', default='', metavar='TEXT',
                      help='why that departure was not driven, with --earlier unused')
    made.add_argument('--late-entry', action='store_true',
                      help='enter a departure for a day before that of others')
    made.add_argument('--ground-unchanged', action='store_true', help='draw even if map, roads or '
                      'layers have changed or are gone: the ground is as it was')
    made.add_argument('--dry-run', action='store_true',
                      help='record nothing: for training, as such draws do not count')
    return made


def _date(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f'must be YYYY-MM-DD, got {text!r}') from None


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    require_for(arguments.output)
    if arguments.why and arguments.earlier != 'unused':
        raise cli.UsageError('--why is the reason of --earlier unused')

    from ..recordings import plan_departures
    from ..recordings.plan_file import read_plan

    with console.waiting('reading the plan'):
        saved = read_plan(arguments.plan)
    if not _ground_is_the_same(arguments, saved, console):
        return cli.Exit.FINDING
    if saved.plan.gap_is_wide:
        from ..planning.concerns import wide_gap

        console.warn(wide_gap(saved.plan))
    today = date.today()
    first = arguments.date or today
    if arguments.slot and saved.slots:
        if arguments.slot not in saved.slots.times:
            console.warn(f"{arguments.slot} is not one of the plan's slots "
                         f'{", ".join(saved.slots.times)}')
        console.warn(f'the time of departure is not drawn, so the value is {saved.plan.value:.4g}, '
                     f'that of a known time, instead of {saved.value:.4g}')
    folder = plan_departures.departures_folder(arguments.plan)
    if first < today:
        passed = f"{first} has passed: today is {today} by this computer's clock"
        later = [path.stem for _, day, path in plan_departures.names_in(folder)
                 if day > first.isoformat()]
        if later and not arguments.late_entry:
            raise cli.UsageError(f'{passed}, and departures after it were drawn, up to '
                                 f'{later[-1]}; to enter one that was left out, add --late-entry')
        console.warn(passed)
    dates = [(first + timedelta(days=k)).isoformat() for k in range(arguments.days or 1)]
    if arguments.dry_run:
        with console.waiting('drawing'):
            return _finish(arguments, console, saved, folder, dates, {})
    with plan_departures.locked(folder):
        replaced = _replaced(arguments, saved, folder, dates)
        with console.waiting('drawing'):
            return _finish(arguments, console, saved, folder, dates, replaced)


def _ground_is_the_same(arguments: argparse.Namespace, saved: SavedPlan,
                        console: cli.Console) -> bool:
    """Return whether the plan's sources are unchanged, or the user says that the ground is."""
    from ..recordings import sources

    changed = sources.changes(saved.sources, arguments.plan.parent)
    if not changed or arguments.ground_unchanged:
        for text in changed:
            console.warn(f'{text}; you say that the ground has not changed')
        return True
    for text in changed:
        console.error(text)
    console.say('Nothing was drawn. If the ground has changed, plan again to a new name, and see '
                'which departures are affected with ambush verify FOLDER --map MAP [--roads FILE]. '
                'If it is as it was, add --ground-unchanged.')
    return False


def _replaced(arguments: argparse.Namespace, saved: SavedPlan, folder: Path,
              dates: list[str]) -> dict[str, str]:
    """Dates and ids of the departures that were drawn before, but not driven; raises UsageError."""
    from ..recordings import plan_departures

    _check_clock(folder, arguments.date)
    slot = arguments.slot
    again = [(day, said) for day, said in plan_departures.earlier_departures(saved, folder, dates)
             if not (slot and day.slot) or slot == day.slot]
    if not again:
        return {}
    answer = arguments.earlier or _asked(*again[-1])
    return {day.date: said.departure_id for day, said in again} if answer == 'unused' else {}


def _check_clock(folder: Path, named: date | None) -> None:
    """Raise UsageError if the clock is behind the last departure, unless the day is named."""
    from ..recordings import plan_departures

    if (names := plan_departures.names_in(folder)) and not named:
        last = max(path.stat().st_mtime_ns for _, _, path in names)
        if last > time.time_ns():
            raise cli.UsageError(f'the clock says {when(time.time_ns())}, but the last departure '
                                 f'was drawn at {when(last)}: set the clock, or name the day '
                                 'with --date')


def _asked(day: RecordedDay, said: Metadata) -> str:
    question = (f'A departure for {day.date}{day.slot and f", {day.slot}"} was drawn at '
                f'{when(said.call.request_ns)}. Was it driven?')
    if not sys.stdin.isatty():
        raise cli.UsageError(f'{question} Add --earlier driven, or --earlier unused')
    print(f'{question} [y/n] ', end='', file=sys.stderr, flush=True)
    answer = sys.stdin.readline().strip().lower()
    if answer[:1] not in ('y', 'n'):
        raise cli.UsageError('nothing was drawn: answer y or n')
    return 'driven' if answer[:1] == 'y' else 'unused'


def _finish(arguments: argparse.Namespace, console: cli.Console, saved: SavedPlan, folder: Path,
            dates: list[str], replaced: dict[str, str]) -> cli.Exit:
    """Draw, write everything or nothing, and tell."""
    from ..recordings import plan_departures
    from ..recordings.durable_files import write_all_durably

    names = [] if arguments.dry_run else plan_departures.names_in(folder)
    number = max((each for each, *_ in names), default=0)
    files: dict[Path, bytes] = {}
    rows = []
    for k, day in enumerate(dates, start=1):
        drawn = plan_departures.draw_departure(saved, arguments.slot or '')
        row = {'number': number + k, 'date': day, 'slot': drawn.slot or None,
               'length': drawn.length, 'recording': None}
        for path, data in _outputs(arguments, console, saved, drawn, number + k, day):
            files[path] = data
        if not arguments.dry_run:
            path = folder / plan_departures.file_name(number + k, day)
            files[path] = plan_departures.departure_bytes(
                saved, drawn, number + k, day, time.time_ns(), replaced.get(day, ''),
                arguments.why if day in replaced else '')
            row['recording'] = cli.place(path)
        rows.append(row)
    try:
        write_all_durably(files)
    except OSError:
        console.say('Nothing was written, so nothing was drawn.')
        raise
    if arguments.days is None:
        when_leaving = ', '.join(filter(None, (dates[0], drawn.slot)))
        console.line(f'{when_leaving}: {distance(drawn.length)}')
    if files:
        console.secret(files)
    if arguments.dry_run:
        console.say('Nothing was recorded: do not drive this.')
    console.result = {'files': [cli.place(path) for path in files], 'departures': rows}
    return cli.Exit.FINDING if saved.plan.gap_is_wide else cli.Exit.HOLDS


def _outputs(arguments: argparse.Namespace, console: cli.Console, saved: SavedPlan,
             drawn: plan_departures.DrawnDeparture, number: int,
             day: str) -> Iterator[tuple[Path, bytes]]:
    """The files that were asked for, with the day in their names if there are several days."""
    from ..recordings.plan_departures import local_zone
    from ..route_files import Drawn, content_of
    from .card_page import card_of, card_page

    plan, training = saved.plan, 'TRAINING ' * arguments.dry_run
    name = training + ' '.join(filter(None, (day, drawn.slot)))
    card = card_of(drawn.poses, plan.own_map, plan.trip, (plan.trip, drawn.route),
                   plan.options.network.roads, saved.names, arguments.speed, drawn.slot,
                   f'Departure {number}', day, local_zone(day, drawn.slot), arguments.dry_run)
    for asked in arguments.output:
        path = asked.with_stem(f'{asked.stem}_{day}') if arguments.days else asked
        if path.suffix.lower() == CARD:
            yield path, card_page(card, console).encode()
        else:
            times = [datetime.now(timezone.utc)]
            route = Drawn(plan.drawn_from, plan.own_map, [drawn.poses], times, slots=[name],
                          labels=[name], way_points=[card.way_points], routes_only=True)
            yield path, content_of(path, route)


main = cli.command(parser, _work)

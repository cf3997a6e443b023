# SPDX-License-Identifier: Apache-2.0
"""``ambush plan``: from a map to a plan file, or to routes for a quick look."""

from __future__ import annotations

import argparse
import math
import re
import shlex
import warnings
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

from ..route_files import PLAN, SUFFIXES
from ..words import distance, duration, over_legs, percent
from . import cli
from .geo_files import FORMATS_HELP, add_outputs, check_outputs, tell_outputs
from .planner_parser import planner_parser, source_names
from .positions import read_ground

if TYPE_CHECKING:
    from ..operations.slots import Slots
    from ..planning.plan import Plan
    from ..route_files import Drawn

DESCRIPTION = """\
Plan on a map. Save the plan and draw from it each day, or draw routes for a quick look.

  ambush plan map.tif --start 36.55,-84.38 --goal 36.70,-84.12 --reach 500 -o week.plan
  ambush plan map.yaml --start 4 20 --goal 56 20 --reach 2 -n 20 -o routes.csv routes.png"""
EPILOG = """\
FILE.plan saves the plan, for ambush draw; .gpx .gpkg .geojson .csv and .png
have the routes that -n draws. All are secret, and only you can read them.
If the gap is over 10 % (strategy.max_gap): exit code 1, no FILE.plan without --accept-gap.
"""
DETAILS = f"""\
The node reads FILE.plan, too.
{FORMATS_HELP}
With --routes, the files have a layer or track for each route, with its number and share, and .png
shows all. The table on the console has the faces of one or two dice (a first and a second one) and
the cards that stand for each route, by the nearest shares, and the value of each such draw.
With --slots, a time of departure is drawn for each route: an ambusher can wait in one slot only.
--json: {{"verdict", "files", "departures", "value", "lower_bound", "expected_length",
"shortest_length", "driven_length", "shortest_route_loss", "best_ambush": {{"xy", "hit"}},
"refinement": [{{"nodes", "value", "seconds"}}], "seconds", "first_hit_value", "few": null, or with
--routes {{"value", "lower_bound", "candidates", "worst_xy", "legs", "shares", "costs", "curve",
"draws"}},
"slots": null, or with --slots {{"value", "lower_bound", "shares", "drawn"}}}}
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = planner_parser('plan', DESCRIPTION, EPILOG, DETAILS,
                          '--start POSITION --goal POSITION [options] -o FILE ...',
                          ('-n', '--routes', '--slots', '--window', '-v'))
    add_outputs(made, 'files to write', (PLAN, *SUFFIXES))
    number = made.add_mutually_exclusive_group()
    number.add_argument('-n', '--departures', type=cli.number(1, 1e4, int), default=1,
                        metavar='COUNT', help='number of routes to draw for a look (default: 1)')
    number.add_argument('--routes', type=int, metavar='K', help='find '
                        'the best mixture of at most K routes a leg, to brief, or draw by hand')
    for end in ('start', 'goal'):
        made.add_argument(f'--{end}-name', default='', metavar='NAME',
                          help=f'name of the {end} on cards')
    made.add_argument('--slots', nargs='+', type=cli.time_of_day, default=(), metavar='HH:MM',
                      help='also draw the time of departure, one of these (local time)')
    made.add_argument('--window', type=cli.number(1, 1e4, int), default=1, metavar='COUNT',
                      help='number of consecutive slots that an ambush lasts (default: 1)')
    made.add_argument('--accept-gap', action='store_true', help='save FILE.plan even if a much '
                      'better plan may exist')
    made.add_argument('--overwrite', action='store_true',
                      help='overwrite a plan from which departures were drawn')
    made.add_argument('--seed', type=cli.number(0, 2**63, int), metavar='N',
                      help='always draw the same routes; for tests only, as they can be predicted')
    made.add_argument('-v', '--verbose', action='store_true', help='also print the lower bound '
                      'and all assumptions')
    return made


def _work(arguments: argparse.Namespace, console: cli.Console) -> cli.Exit:
    _check_departures(arguments)
    from .inputs import options_from

    (of_map, planning), slots = options_from(arguments), arguments.slots
    for before, after in pairwise(slots):
        if after <= before:
            raise cli.UsageError(f'--slots must go forwards in time, but {after} follows {before}')
    if arguments.window > 1 and not slots:
        raise cli.UsageError('--window needs --slots HH:MM ...')
    if arguments.routes is not None and any(
            path.suffix.lower() == PLAN for path in arguments.output):
        raise cli.UsageError('--routes is for briefing and for draws by hand: leave out FILE.plan, '
                             'or --routes')
    check_outputs(arguments.output, console)
    risk_map, start, goal, stops = read_ground(arguments, of_map)

    import numpy as np

    from ..operations.few_routes import MAX_ROUTES
    from ..operations.slots import Slots
    from ..planning.concerns import concerns
    from ..planning.one_place import find_one_place
    from ..planning.options import PlanningOptions
    from ..planning.trip import plan_trip
    from ..recordings.plan_file import saved_plan
    from ..recordings.sources import sources_of
    from ..route_files import draw, write_routes
    from .few_files import FewDrawn, tell_few

    if arguments.routes is not None and not 1 <= arguments.routes <= MAX_ROUTES:
        raise cli.UsageError(f'--routes must be a number from 1 to {MAX_ROUTES}')
    rng = np.random.default_rng(arguments.seed)
    limit = planning.strategy.time_limit
    what = f'at most {limit:g} s (strategy.time_limit)'
    with console.waiting(what) as tell, warnings.catch_warnings():
        warnings.simplefilter('ignore')  # the concerns tell more
        plan = plan_trip(risk_map, start, goal, planning, stops=stops,
                         progress=lambda phase, value: tell(phase + (
                             f', value so far {value:.4g}' if value < math.inf else '')),
                         routes=arguments.routes, rng=rng)
    plan = replace(plan, options=replace(plan.options, max_gap=PlanningOptions.max_gap))
    refused = plan.gap_is_wide and not arguments.accept_gap
    day = None
    if slots:
        day = Slots.of(slots, arguments.window)
        if arguments.window >= len(slots):
            console.warn('an ambush lasts as long as all slots together, so drawing the time of '
                         'departure does not lower the value')
    if arguments.seed is not None:
        console.warn('drawn with --seed, so anyone who knows the seed can predict these routes; '
                     'use it for tests only')
    few = plan.few
    quick = [path for path in arguments.output if path.suffix.lower() != PLAN]
    output = quick if refused else arguments.output
    drawn = (FewDrawn(plan.trip, risk_map, few.paths, (), few) if few else
             draw(plan, arguments.departures if quick else 0, rng))
    drawn = replace(drawn, sources=source_names(arguments))
    if day:
        slots = () if few else [day.drawn(rng) for _ in drawn.paths]
        drawn = replace(drawn, slots=slots, covered=day.covered)
    _tell(plan, day, arguments, console)
    if few:
        tell_few(plan, few, arguments.routes, day.covered if day else 1.0, console)
    if day:
        _tell_slots(plan, day, drawn, console)
    for text in concerns(plan, lambda xy: arguments.start[0].like(xy, risk_map)):
        console.warn(f'{"at a known time of departure, " * bool(day)}{text}')
    if find_one_place(plan):
        console.say(f'To find what to hold: {_hold_line(arguments, plan)}')
    console.result['seconds'] = round(console.seconds, 1)
    plans = [path for path in output if path not in quick]
    write_routes(output, drawn, saved_plan(
        plan, of_map, day, sources_of(plans[0].parent, arguments.map, planning.network.graph),
        (arguments.start_name, arguments.goal_name)) if plans else None)
    if len(output) < len(arguments.output):
        console.error('no plan was saved: a much better one may exist; --accept-gap saves it '
                      'nevertheless')
    tell_outputs(output, drawn, console)
    return cli.Exit.HOLDS if plan.value > 0.0 and not plan.gap_is_wide else cli.Exit.FINDING


def _check_departures(arguments: argparse.Namespace) -> None:
    """Raise UsageError if a plan with departures would be overwritten, unless that is asked for."""
    from ..recordings.plan_departures import departures_folder, names_in

    for path in arguments.output:
        if path.suffix.lower() != PLAN or arguments.overwrite:
            continue
        folder = departures_folder(path)
        if path.exists() and (drawn := names_in(folder)):
            raise cli.UsageError(
                f'{cli.place(path)} is a plan with {cli.count(len(drawn), "departure")} '
                f'({cli.place(folder)}): plan to a new name, or add --overwrite; the recordings '
                'keep the plan that they were drawn from')


def _hold_line(arguments: argparse.Namespace, plan: Plan) -> str:
    """The call of ``ambush hold`` for the same trip."""
    from ..maps.road_file import ROAD_OPTIONS

    given = [word for name in ('start', 'via', 'goal', 'roads', *ROAD_OPTIONS, *cli.WORDS, 'crs',
                               'set')
             if (value := getattr(arguments, name))
             for word in (f'--{name.replace("_", "-")}', *(
                 map(str, value) if isinstance(value, list) else [value] * (value is not True)))]
    radius = 2.0 * (plan.options.game.ambush_radius or plan.spacing)
    return ' '.join(['ambush hold', *map(_quoted, [str(arguments.map), *given]),
                     f'--radius {radius:g} -o hold.png'])


def _quoted(word: str) -> str:
    """A word for a shell; a position X Y [m] is two words."""
    return word if re.fullmatch('[-+.e0-9]+ [-+.e0-9]+', word) else shlex.quote(word)


def _tell(plan: Plan, day: Slots | None, arguments: argparse.Namespace,
          console: cli.Console) -> None:
    from ..planning.ambush_costs import best_ambush
    from ..planning.concerns import assumptions
    from ..planning.evaluation import evaluate
    from ..words import best_ambush as in_words

    trip, few = plan.drawn_from, plan.few
    covered = day.covered if day else 1.0
    value, bound = plan.value * covered, plan.lower_bound * covered
    shortest = evaluate(plan)['energy_efficient'].v_repeated
    summed = f', {over_legs(len(trip.legs), trip.first_hit_value * covered)}' * (len(trip.legs) > 1)
    console.fact('value', f'{value:.4g}: mean loss per departure{summed} if the ambusher plays '
                 'optimally and knows everything except the draw')
    best = best_ambush(trip, plan.own_map)
    if best:
        place = arguments.start[0].like(best.xy, plan.own_map)
        console.fact('in words', in_words(best.hit, place, covered))
    console.fact('shortest route', f'{shortest:.4g}, once it is known')
    ratio = f'{trip.expected_length / trip.shortest_length:.2f} times the shortest'
    if plan.network.travel_unit == 's':
        console.fact('mean time', f'{duration(trip.expected_length)}, {ratio}; '
                     f'{distance(plan.driven_length)}')
    else:
        console.fact('mean length', f'{distance(plan.driven_length)} as driven' + (
            '' if few else f' (along the network {distance(trip.expected_length)}, {ratio})'))
    if few:
        price = few.value / few.lower_bound if few.lower_bound else math.inf
        console.fact('few routes', f'{price:.2f} times the value of all {few.candidates} paths '
                     'that were tried, mixed at best')
    if not arguments.verbose:
        console.fact('assumption', '; '.join(assumptions(plan)[:2]))
    if arguments.verbose:
        console.fact('lower bound', f'{bound:.4g}: ' + (
            'no mixture of the paths that were tried has a smaller value' if few else
            'no planner can guarantee less on this network of '
            f'{len(plan.network.points)} nodes'))
        if len(plan.refinement) > 1 and not few:
            values = ', '.join(f'{each.value:.4g}' for each in plan.refinement)
            known = ', at a known time' * bool(day)
            console.fact('refined', f'{values} after each round{known}, before the final strategy')
        for text in assumptions(plan):
            console.fact('assumption', text)
    console.result = {
        'refinement': [each._asdict() for each in plan.refinement],
        'value': value, 'lower_bound': bound,
        'best_ambush': best and {'xy': best.xy, 'hit': best.hit * covered},
        'expected_length': trip.expected_length, 'shortest_length': trip.shortest_length,
        'driven_length': plan.driven_length, 'shortest_route_loss': shortest,
        'first_hit_value': trip.first_hit_value * covered, 'few': None, 'slots': None,
    }


def _tell_slots(plan: Plan, day: Slots, drawn: Drawn, console: cli.Console) -> None:
    shares = dict(zip(day.times, day.shares, strict=True))
    console.fact('slots', ', '.join(f'{slot} {percent(share)}' for slot, share in shares.items()))
    if drawn.slots:
        console.fact('departures', ', '.join(drawn.slots))
    console.result['slots'] = {
        'value': plan.value * day.covered, 'lower_bound': plan.lower_bound * day.covered,
        'shares': shares, 'drawn': list(drawn.slots)}


main = cli.command(parser, _work)

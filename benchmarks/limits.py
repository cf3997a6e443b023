# SPDX-License-Identifier: Apache-2.0
"""Plans within time limits on a busy machine: are limits kept, and is refinement never a loss?

``--each`` maps, of families that the seed draws, are planned by default and without refinement
(``network.refine`` 0), within each of the ``--limits``, while ``--busy`` loops take the processor.
``--crowd N`` instead plans a map of mountains N times, ``--busy`` at once, within each limit.

Measured is ``ambush plan`` in a process that has imported everything, from the map's file to the
last number that it prints. The plan's file and a picture of six routes are written after that.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from families import Problem, draw, problem_parser
from one_run import Answer, run
from report import conditions, publish, table
from scenarios import ROOT, across

from ambush_planner import GameOptions, PlanningOptions
from ambush_planner.arrays import FloatArray
from ambush_planner.commands import plan
from ambush_planner.maps.elevation import Elevation
from ambush_planner.maps.risk_map_file import npz_bytes
from ambush_planner.maps.terrain_risk import terrain_map

WORSE, APART = 1.03, 1.1  # most of a value: over that without refinement, over the crowd's least
LATE = 1.1, 1.0  # a plan may take 1.1 times its limit plus 1 s
NODES = 2500  # of the problems of ``families``: decides cells and reach
CELL, SIZE = 30.0, (500, 667)  # of the mountains: 20 by 15 km
HEIGHT, DECAY = 350.0, 2.1  # standard deviation [m] of heights, and power of their spectrum
# A plan of a moment, so that everything is imported.
SMALL = [str(ROOT / 'docs/yard.yaml'), '--start', '4', '20', '--goal', '56', '20', '--reach', '2',
         '--set', 'network.target_nodes=200', 'network.refine=0']


def relief(seed: int) -> FloatArray:
    """Heights [m] of mountains."""
    wave = np.hypot(np.fft.fftfreq(SIZE[0])[:, None], np.fft.rfftfreq(SIZE[1]))
    wave[0, 0] = np.inf
    noise = np.fft.rfft2(np.random.default_rng(seed).standard_normal(SIZE))
    heights = np.fft.irfft2(noise * wave**-DECAY, SIZE)
    return np.asarray(1500.0 + HEIGHT * heights / heights.std())


def mountains(seed: int) -> Problem:
    """From one side of a map of mountains to the other, off road, with risk from the terrain."""
    risk_map = terrain_map(Elevation(relief(seed), CELL)).risk_map()
    game = GameOptions(ambush_radius=500.0, secured_radius=1500.0)
    return Problem(across(risk_map, 0.1), PlanningOptions(game=game), (), '')


def arguments_of(problem: Problem, file: Path) -> list[str]:
    """The problem as arguments of ``ambush plan``; its map is written to the file."""
    file.write_bytes(npz_bytes(problem.scenario.risk_map))
    game, (start, goal) = problem.options.game, (problem.scenario.start, problem.scenario.goal)
    secured = [] if game.secured_radius is None else ['--secured', str(game.secured_radius)]
    return [str(file), '--start', *map(str, start), '--goal', *map(str, goal), '--reach',
            str(game.ambush_radius), *secured, '--detour', str(problem.options.strategy.max_detour)]


def planned(_: str, given: list[str], time_limit: float, **options: float) -> Answer:
    """``ambush plan`` within a limit [s]: wall seconds, value and bound."""
    settings = {'strategy.time_limit': time_limit, **options}
    sets = ['--set', *(f'{name}={value:g}' for name, value in settings.items())]
    with TemporaryDirectory() as folder:
        files = ['-n', '6', '--json', '-o', f'{folder}/x.plan', f'{folder}/x.png']
        for each in ([*SMALL, *files[:-2], f'{folder}/y.plan', files[-1]], [*given, *sets, *files]):
            begin, out = time.monotonic(), io.StringIO()
            with contextlib.redirect_stdout(out):
                code = plan.main(each)
            whole = time.monotonic() - begin
    found = json.loads(out.getvalue() or '{}')
    seconds = found.get('seconds', whole)
    return {'seconds': seconds, 'status': f'{code}, files after {whole:.1f} s',
            'value': found.get('value', math.inf), 'bound': found.get('lower_bound', 0.0),
            'late': seconds > LATE[0] * time_limit + LATE[1]}


@contextlib.contextmanager
def busy(loops: int) -> Iterator[None]:
    """Processes that do nothing, as fast as they can."""
    running = [subprocess.Popen([sys.executable, '-c', 'while True: pass']) for _ in range(loops)]
    try:
        yield
    finally:
        for each in running:
            each.kill()
            each.wait()


def gap(answer: Answer) -> str:
    bound = answer.get('bound', 0.0)
    return f"{answer['value'] / bound - 1.0:.1%}" if bound else '-'


def over(answer: Answer, limit: float) -> str:
    """Wall seconds over the limit."""
    return f"{answer['seconds'] - limit:+.1f}" + ' (late)' * answer.get('late', True)


def compared(names: list[str], limits: list[float], seconds: float) -> tuple[list[list[str]], bool]:
    """The rows of maps by limits, and whether all is as wanted."""
    rows, good = [], True
    with TemporaryDirectory() as folder:
        given = {name: arguments_of(draw(name), Path(folder, f'{k}.npz'))
                 for k, name in enumerate(names)}
        for limit, name in product(limits, names):
            plain, default = (run('limits.planned', name, seconds, given=given[name],
                                  time_limit=limit, **options)
                              for options in ({'network.refine': 0}, {}))
            values = [each.get('value', math.inf) for each in (default, plain)]
            ratio = values[0] / values[1] if values[1] < math.inf else 0.0
            ended = not any(each.get('late', True) for each in (default, plain))
            good &= ended and (values[0] == values[1] or ratio <= WORSE)
            rows.append([f'{limit:g} s', f'`{name}`', f'{values[0]:.4g}', f'**{ratio:.3f}**',
                         gap(default), gap(plain), over(default, limit), over(plain, limit)])
    return rows, good


def crowded(seed: int, count: int, at_once: int, limit: float, seconds: float
            ) -> tuple[list[str], bool]:
    """The row of a map that is planned many times at once, and whether all is as wanted."""
    with TemporaryDirectory() as folder, ThreadPoolExecutor(at_once) as pool:
        given = arguments_of(mountains(seed), Path(folder, 'mountains.npz'))
        answers = list(pool.map(lambda k: run(
            'limits.planned', f'mountains:{seed} {k + 1}', seconds, given=given,
            time_limit=limit), range(count)))
    values = np.sort([each.get('value', math.inf) for each in answers])
    worst, latest = float(values[-1] / values[0]), max(each['seconds'] for each in answers)
    row = [f'{limit:g} s', f'mountains:{seed}', f'{count}, {at_once} at once', f'{values[0]:.4g}',
           f'{np.median(values) / values[0]:.3f}', f'**{worst:.3f}**',
           max(map(gap, answers), key=lambda text: float(text.strip('%-') or 1e9)),
           f'{latest - limit:+.1f}']
    return row, worst <= APART and not any(each.get('late', True) for each in answers)


def main() -> None:
    parser = problem_parser(__doc__)
    parser.set_defaults(each=3)
    parser.add_argument('--limits', type=float, nargs='+', default=[5.0, 10.0, 20.0, 60.0],
                        metavar='SECONDS')
    parser.add_argument('--busy', type=int, default=3, help='loops, or plans of a crowd at once')
    parser.add_argument('--crowd', type=int, default=0, metavar='N', help='plans of one map')
    options = parser.parse_args()
    if options.crowd:
        found = [crowded(options.seed, options.crowd, options.busy, limit, options.limit)
                 for limit in options.limits]
        rows, good = [row for row, _ in found], all(kept for _, kept in found)
        head = ['limit', 'map', 'plans', 'least value', 'median over it', 'worst over it',
                'widest gap', 'latest: s over the limit']
        block, words = 'crowd', f'Wanted: no value over {APART} times the least'
    else:
        families = np.random.default_rng(options.seed).permutation(options.families)
        names = [f'plan:{family}:{NODES}:{options.seed}' for family in families[: options.each]]
        with busy(options.busy):
            rows, good = compared(names, options.limits, options.limit)
        head = ['limit', 'map', 'value', 'over that without refinement', 'gap', 'without',
                's over the limit', 'without']
        block, words = 'limits', (f'{options.busy} busy loops. Wanted: no value over {WORSE} times '
                                  'that without refinement')
    publish(options.results, block, (
        f'Seed {options.seed}. {words}, and at most {LATE[0]:g} limits + {LATE[1]:g} s: '
        f'{"met" if good else "**missed**"}. {conditions("highspy")}.\n\n{table(head, rows)}'))
    sys.exit(0 if good else 1)


if __name__ == '__main__':
    main()

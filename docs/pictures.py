# SPDX-License-Identifier: Apache-2.0
"""Draw the pictures of the documents into docs/images; ``make demo`` and ``make paper`` first.

Those of the demo's terrain show the strategy that its node has recorded in out/demo.
"""

from __future__ import annotations

import argparse
import io
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from ambush_planner import GameOptions, PlanningOptions, figures, map_figures, plan_trip
from ambush_planner.arrays import IndexArray
from ambush_planner.colours import AMBUSHER, PROBABILITY
from ambush_planner.game.hits import largest_product, law_of
from ambush_planner.game.route_sampler import route_strategy
from ambush_planner.planning.evaluation import energy_efficient_route, evaluate
from ambush_planner.planning.plan import departure_paths
from ambush_planner.recordings.recorded_departures import read_departures, recordings_in
from ambush_planner.recordings.report_data import Section, sections_of

sys.path.append(str(Path(__file__).resolve().parents[1]))
from examples.demo import figures as demo_figures
from examples.demo import ground as demo_ground

DOCS = Path(__file__).resolve().parent
# The trip of docs/python.md [m].
STOPS = ((8685.0, 23625.0), (21015.0, 8955.0), (25020.0, 16020.0))
TRIP = PlanningOptions(game=GameOptions(secured_radius=2000.0))
TRIPS_SHOWN = 6
# The moving picture: pixels across, steps of a day, and times that they are shown [ms].
PIXELS, STEPS, STEP_TIME, NIGHT, LAST = 1200, 4, 130, 500, 4000
# The pictures that commands of the pages draw: the file, and for each block that is run, its page
# and a part of it.
_ROADS = (('gis.md', "'dem.tif', 'w'"), ('operations.md', "open('roads.osm', 'w')"),
          ('operations.md', 'terrain: dem.tif'), ('operations.md', 'ambush risk layers.yaml'))
_YARD = ('tutorial.md', "<<'EOF'")
COMMANDS = {
    'judge': ('judge.png', (*_ROADS, ('operations.md', '-o judge.png'))),
    'hold': ('hold.png', (*_ROADS, ('operations.md', '-o hold.png'))),
    'six': ('six.png', (*_ROADS, ('operations.md', '-o six.png'))),
    'card': ('card.html', (*_ROADS, ('operations.md', '-o week.plan'),
                           ('operations.md', '-o card.html'))),
    'tutorial_routes': ('plan.png', (_YARD, ('tutorial.md', '-o plan.png'))),
}
# What a browser shows of pages [pixels], and its names.
SHOWN = {'card': (800, 1130), 'report': (1200, 800)}
BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')
# The paper's pictures that docs/paper.md shows, by their names in out/paper.
PAPER = {'figure_solvers': 'solvers', 'figure_2_interior_point': 'figure_2',
         'figure_7_threshold': 'figure_7'}
LEGEND = {'loc': 'outside lower center', 'frameon': False}


def strategy(demo: Section) -> Figure:
    """Where the convoy drives and where the ambusher waits."""
    figure = Figure((6.4, 6.6), layout='compressed')
    figures.draw_strategy(figure.subplots(), demo.trip, demo.risk_map)
    return figure


def routes(demo: Section) -> Figure:
    """The demo's own picture."""
    paths = [each.path_poses[:, :2] for each in demo.departures[-8:]]
    fixed = demo_figures.fixed_routes(demo.trip.legs[0])
    return demo_figures.routes_figure(demo.risk_map, demo.trip, paths, fixed)


def trip(demo: Section) -> Figure:
    """The strategies of all legs on the left, departures on the right."""
    plan = plan_trip(demo.risk_map, demo_ground.START, demo_ground.GOAL, TRIP, stops=STOPS)
    known = evaluate(plan)['energy_efficient'].v_repeated
    figure = Figure((map_figures.WIDTH, 5.7), layout='compressed')
    left, right = figure.subplots(1, 2)
    for axes, title in (
        (left, f'{len(plan.legs)} legs, each drawn on its own: mean loss {plan.value:.2f}\n'
               f'(the shortest trip, once known: {known:.2f})'),
        (right, f'{TRIPS_SHOWN} departures'),
    ):
        risk = figures.draw_ground(axes, plan.trip, demo.risk_map, title)
    edges = figures.draw_network(left, plan.trip)
    figures.draw_sites(left, plan.trip)
    paths = departure_paths(plan, TRIPS_SHOWN, 100.0, np.random.default_rng(1))
    figures.draw_routes(right, [path[:, :2] for path in paths], figures.places_of(plan.trip))
    right.label_outer()
    for axes, shown, label, form in ((left, edges, figures.PASSES, figures.PERCENT),
                                     (right, risk, map_figures.LOSS, None)):
        figure.colorbar(shown, ax=axes, label=label, location='bottom', shrink=0.9, format=form)
    figure.legend(handles=[figures.SITES, figures.SECURED_AREA, map_figures.OBSTACLE], ncols=3,
                  **LEGEND)
    return figure


class Panel:
    """One half of the moving picture: a convoy that drives every day, and its ambusher."""

    def __init__(self, axes: Axes, demo: Section, title: str) -> None:
        self.axes, self.game = axes, demo.trip.game
        self.points = self.game.network.points
        figures.draw_ground(axes, demo.trip, demo.risk_map, title)
        axes.set(xticks=[], yticks=[], ylabel='')
        self.text = axes.set_xlabel(' \n ', fontsize=10, linespacing=1.4)
        self.way, = axes.plot([], [], color=PROBABILITY[2], linewidth=2.6, zorder=4,
                              path_effects=map_figures.HALO)
        self.site = axes.scatter([], [], s=130, color=AMBUSHER, edgecolors='white', zorder=9)
        self.hit = axes.scatter([], [], s=420, marker='X', color=AMBUSHER, edgecolors='black',
                                zorder=9)
        self.name = axes.annotate('', (0.0, 0.0), (8, 16), textcoords='offset points', va='center',
                                  weight='bold', path_effects=map_figures.HALO, zorder=9)
        self.losses: list[float] = []

    def step(self, route: IndexArray, row: int, share: float) -> None:
        """Show the first part of a day's route, and the ambusher at a site."""
        shown = route[: 1 + round(share * (len(route) - 1))]
        hit = self.hit_at(route, row)
        self.way.set_data(*self.points[shown if hit is None else shown[: hit + 1]].T)
        place = self.points[self.game.sites[row]]
        self.site.set_offsets(place)
        self.name.xy = place
        right, top = self.axes.transAxes.inverted().transform(
            self.axes.transData.transform(place)) > (0.5, 0.85)
        self.name.xyann = (-8 if right else 8, -16 if top else 16)  # inside the map
        self.name.set_ha('right' if right else 'left')
        self.name.set_text('ambusher')
        self.hit.set_offsets(np.empty((0, 2)))

    def hit_at(self, route: IndexArray, row: int) -> int | None:
        """Where along a route the ambush stops it; None if it is not hit."""
        used = route_strategy(self.game.network, route) > 0.0
        entered = self.game.network.heads[self.game.entering[[row]].indices]
        stops = np.flatnonzero(np.isin(route, entered[used[self.game.entering[[row]].indices]]))
        return int(stops[0]) if len(stops) else None

    def night(self, route: IndexArray, row: int, limit: str) -> None:
        """Count the day's loss, and keep the route as a thin line."""
        hit, site = self.hit_at(route, row), self.game.sites[row]
        self.losses.append(0.0 if hit is None else float(self.game.loss[site]))
        if hit is not None:
            self.hit.set_offsets(self.points[site])
            self.name.set_text('ambushed')
        driven = route if hit is None else route[: hit + 1]
        self.axes.plot(*self.points[driven].T, color=PROBABILITY[1], linewidth=0.9, alpha=0.6,
                       zorder=3)
        days, hits = len(self.losses), np.count_nonzero(self.losses)
        self.text.set_text(f'ambushed on {hits} of {days} days\n'
                           f'mean loss {np.mean(self.losses):.2f}{limit}')


def route_a_day(demo: Section, path: Path, days: int = 20) -> None:
    """The same route ambushed every day, next to drawn routes and the ambusher who plays best.

    Both panels use the game's own hits; the routes and the ambusher's places come from seed 1.
    """
    (chosen,), rng = demo.trip.legs, np.random.default_rng(1)
    figure = Figure((map_figures.WIDTH, 5.0), dpi=PIXELS / map_figures.WIDTH, layout='constrained')
    left, right = (
        Panel(axes, demo, title) for axes, title in zip(figure.subplots(1, 2), (
            'The shortest route, every day\nThe ambusher waits at its worst place',
            'A random route for every departure\nThe ambusher knows all but the next route',
        ), strict=True)
    )
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.1)
    figure.supxlabel('Grey: the darker, the larger the loss if ambushed there. Black: impassable.\n'
                     'Dashed: the secured area, where nobody can wait.', fontsize=9)
    figure.draw_without_rendering()
    figure.set_layout_engine('none')  # labels near the edge would move the panels
    same = energy_efficient_route(chosen.game)
    game, law = chosen.game, law_of(chosen.game, route_strategy(chosen.network, same))
    worst = largest_product(game.loss[game.sites], game.entering, law)[1]
    q = chosen.ambush_probability[chosen.game.sites]
    frames, times = [], []

    def shoot(milliseconds: int) -> None:
        stream = io.BytesIO()
        figure.savefig(stream, format='png')
        frames.append(Image.open(stream).convert('RGB'))
        times.append(milliseconds)

    for route in chosen.sample_routes(days, rng):
        row = int(rng.choice(len(q), p=q / q.sum()))
        for share in np.linspace(1 / STEPS, 1.0, STEPS):
            left.step(same, worst, share)
            right.step(route, row, share)
            shoot(STEP_TIME)
        left.night(same, worst, '')
        right.night(route, row, f', in the long run at most {chosen.value:.2f}')
        shoot(NIGHT)
    times[-1] = LAST
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=times, loop=0,
                   quality=60, method=6, kmin=501, kmax=1000)


def by_commands(folder: Path, name: str) -> None:
    """Run the commands of the pages in a new folder, for their pictures."""
    file, wanted = COMMANDS[name]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])
    runs = {'sh': '{}', 'python': "python - <<'END'\n{}END\n",
            'yaml': "cat > layers.yaml <<'END'\n{}END\n"}
    script = ''
    for page, part in wanted:
        blocks = re.findall(r'(?ms)^```(sh|python|yaml)\n(.*?)^```$', (DOCS / page).read_text())
        script += next(runs[kind].format(text) for kind, text in blocks if part in text)
    with TemporaryDirectory() as place:
        Path(place, 'docs').symlink_to(DOCS)
        subprocess.run(['bash', '-c', script.replace('ros2 run ambush_planner ', '')], cwd=place,
                       env={**os.environ, 'PATH': path}, check=False)  # 1 is a finding
        (made,) = Path(place).rglob(file)
        if name in SHOWN:
            photograph(made, folder, name)
        else:
            shutil.copyfile(made, folder / f'{name}.png')


def photograph(page: Path, folder: Path, name: str) -> None:
    """Take a picture of the top of a page in a browser."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        print(f'no {name}.png: install chromium', file=sys.stderr)
        return
    width, height = SHOWN[name]
    with TemporaryDirectory() as profile:
        subprocess.run([browser, '--headless', '--no-sandbox', '--disable-gpu', '--hide-scrollbars',
                        f'--user-data-dir={profile}', '--virtual-time-budget=10000',
                        f'--screenshot={folder / f"{name}.png"}',
                        f'--window-size={width},{height}', page.resolve().as_uri()],
                       check=True, stderr=subprocess.DEVNULL)


def main() -> None:
    """Draw the named pictures, or all."""
    still = {'strategy': strategy, 'routes': routes, 'trip': trip}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('names', nargs='*', default=[*still, 'route_a_day', 'report', *COMMANDS,
                                                    'paper'])
    parser.add_argument('-o', '--output', type=Path, default=DOCS / 'images')
    options = parser.parse_args()
    folder = options.output.resolve()
    demo = sections_of(read_departures(recordings_in('out/demo'), print))[-1]
    for name in options.names:
        if name in still:
            (folder / f'{name}.png').write_bytes(map_figures.as_png(
                still[name](demo), f'{name}.png', [demo_ground.ELEVATION]))
        elif name == 'route_a_day':
            route_a_day(demo, folder / 'route_a_day.webp')
        elif name == 'report':
            photograph(Path('out/demo/report.html'), folder, name)
        elif name in COMMANDS:
            by_commands(folder, name)
        else:
            for drawn, shown in PAPER.items():
                shutil.copyfile(f'out/paper/{drawn}.png', folder / f'paper_{shown}.png')


if __name__ == '__main__':
    main()

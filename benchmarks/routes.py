"""Would you drive it? Paths of many departures on four maps, against what a grid planner finds.

The table goes to the screen and into results.md, a picture of each map into ``--pictures``, and one
of all maps with routes of the paper's strategy, as they are drawn, above paths of ours.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time
from timeit import repeat

import numpy as np
from drives import AWAY, Drive, apart, least_near_edge, least_turning, measure, turning_of
from grid_planner import shortest_line
from grounds import GROUNDS, Ground
from maps import SIDE, block
from matplotlib.figure import Figure
from report import RESULTS, conditions, table, write_block
from scipy.spatial import Delaunay

from ambush_planner import (
    Network,
    NetworkOptions,
    RiskMap,
    SolverFailed,
    Strategy,
    StrategyOptions,
    build_network,
    solve,
)
from ambush_planner.arrays import FloatArray
from ambush_planner.commands.demo_figures import FixedRoute, draw_fixed_routes
from ambush_planner.commands.figures import (
    draw_ambush_sites,
    draw_ends,
    draw_risk_map,
    draw_routes,
    frame,
)
from ambush_planner.network.construction import METHODS, chosen_spacing
from ambush_planner.planning.evaluation import energy_efficient_route, risk_avoiding_route
from ambush_planner.routes.corridors import make_corridors
from ambush_planner.routes.driven_path import driven_path, tight_turns

SHOWN = 8
# Two paths are the same if they are nowhere further apart than this [spacings].
SAME = 0.1
# Turns are counted as tight, or as made on the spot, that have smaller radii [spacings].
TIGHT, SPOT = 0.1, 0.001
# What the first version reached on terrain and depot, as far as it was measured.
FIRST = {
    'terrain': ('1.5', '2.3', '1.9', '4 %', '5 %'),
    'depot': ('1.5', '6.1', '3.7', '0 %', '0 %'),
}
WANTED = {
    'mean length : any-angle A*': 1.25,
    'hairpins a route': 0.05,
    "turning : the shortest drawn route's": 1.3,
    'near itself': 0.0,
    "near the map's edge": 0.01,
}


@dataclass(frozen=True, eq=False)
class Trial:
    """All that was measured on one map."""

    ground: Ground
    strategy: Strategy
    spacing: float
    papers: list[FloatArray]
    paths: list[FloatArray]
    drives: list[Drive]
    shortest: FixedRoute
    safest: FixedRoute
    shortest_drive: Drive
    drawn_turning: float
    least_turning: float
    least_near_edge: float
    grid_length: float
    grid_turning: float
    different: int
    milliseconds: float


def run(ground: Ground, departures: int, nodes: int) -> Trial:
    """Solve, draw and drive."""
    risk_map, options = ground.risk_map, NetworkOptions(target_nodes=nodes)
    spacing = chosen_spacing(risk_map, options)
    network = build_network(risk_map, ground.start, ground.goal, options)
    strategy = solve(network, options=StrategyOptions(max_detour=1.2, risk_slack=0.01))
    corridors = make_corridors(network, risk_map)
    step = max(risk_map.resolution, spacing)
    rng = np.random.default_rng(0)
    routes = [strategy.sample_route(rng) for _ in range(departures)]
    started = process_time()
    paths = [driven_path(corridors, route, step) for route in routes]
    seconds = process_time() - started
    straight, grid = energy_efficient_route(strategy.game), shortest_line(ground)
    shortest, safest = (
        _fixed(name, driven_path(corridors, route, step), risk_map)
        for name, route in (
            ('shortest', straight), ('safest', risk_avoiding_route(strategy.game)))
    )
    return Trial(
        ground, strategy, spacing,
        _papers_routes(network, rng), paths,
        [measure(path, risk_map, spacing, step) for path in paths],
        shortest, safest, measure(shortest.points, risk_map, spacing, step),
        turning_of(network.points[straight]),
        float(np.mean([least_turning(corridors, route) for route in routes])),
        least_near_edge(strategy, risk_map, spacing),
        float(np.hypot(*np.diff(grid, axis=0).T).sum()), turning_of(grid),
        apart(paths, SAME * spacing), 1e3 * seconds / len(paths),
    )


def _papers_routes(network: Network, rng: np.random.Generator) -> list[FloatArray]:
    """Routes (K, 2) of the paper's strategy with the first version's budget; none if it fails."""
    try:
        strategy = solve(network, options=StrategyOptions('interior_point', max_detour=1.5))
    except SolverFailed:
        return []
    return [network.points[route] for route in strategy.sample_routes(SHOWN, rng)]


def _fixed(name: str, poses: FloatArray, risk_map: RiskMap) -> FixedRoute:
    """A path that is known, and where an ambush on it costs most."""
    losses = risk_map.alpha[risk_map.cells(risk_map.to_map_axes(poses[:, :2]))]
    return FixedRoute(name, poses, poses[np.argmax(losses), :2])


def figures_of(trial: Trial) -> dict[str, float]:
    """The numbers that are wanted, by name."""
    def mean(name: str) -> float:
        return float(np.mean([getattr(drive, name) for drive in trial.drives]))

    return {
        'mean length : any-angle A*': mean('length') / trial.grid_length,
        'hairpins a route': mean('hairpins'),
        "turning : the shortest drawn route's": mean('turning') / trial.drawn_turning,
        'near itself': mean('near_itself'),
        "near the map's edge": mean('near_edge'),
    }


def routes_table(trials: dict[str, Trial]) -> str:
    """A row for each number that is wanted, and what else there is to say; in bold what is not
    reached."""
    reached = {name: figures_of(trial) for name, trial in trials.items()}
    rows = []
    for k, (what, wanted) in enumerate(WANTED.items()):
        share = what.startswith('near')
        cells = []
        for name in trials:
            text = f'{reached[name][what]:.1%}' if share else f'{reached[name][what]:.2f}'
            cell = text if reached[name][what] <= wanted else f'**{text}**'
            cells.append(f'{cell} ({FIRST[name][k]})' if name in FIRST else cell)
        rows.append([what, f'<= {wanted:.0%}' if share else f'<= {wanted:g}', *cells])
    good = [np.mean([drive.accepted for drive in trial.drives]) for trial in trials.values()]
    rows.append(["accepted by Nav2's rules", '100 %',
                 *(f'{share:.0%}' if share == 1.0 else f'**{share:.1%}**' for share in good)])
    return table(['', 'wanted', *trials], rows + _other_rows(list(trials.values())))


def _other_rows(trials: list[Trial]) -> list[list[str]]:
    def row(name: str, texts: list[str]) -> list[str]:
        return [name, '', *texts]

    return [
        row('shortest route on the network, driven : any-angle A*', [
            f'{t.shortest_drive.length / t.grid_length:.2f}' for t in trials]),
        row('hairpins: standard error', [
            f'{np.std([drive.hairpins for drive in t.drives]) / len(t.drives) ** 0.5:.3f}'
            for t in trials]),
        row('turning [rad]: mean path, least in its corridors', [
            f'{np.mean([drive.turning for drive in t.drives]):.1f}, {t.least_turning:.1f}'
            for t in trials]),
        row('turning [rad]: shortest route as drawn, driven; any-angle A*', [
            f'{t.drawn_turning:.1f}, {t.shortest_drive.turning:.1f}; {t.grid_turning:.1f}'
            for t in trials]),
        row("turning : the shortest driven route's, any-angle A*'s", [
            ', '.join(_ratio(float(np.mean([drive.turning for drive in t.drives])), of)
                      for of in (t.shortest_drive.turning, t.grid_turning)) for t in trials]),
        row(f'turns a path tighter than {TIGHT} spacings, on the spot', [
            ', '.join(f'{np.mean([tight_turns(path, radius * t.spacing) for path in t.paths]):.2f}'
                      for radius in (TIGHT, SPOT)) for t in trials]),
        row(f"near the map's edge, {AWAY:g} spacings and more from start and goal", [
            f'{np.mean([drive.near_edge_away for drive in t.drives]):.1%}' for t in trials]),
        row("near the map's edge, least of any strategy as good, as drawn", [
            f'{t.least_near_edge:.1%}' for t in trials]),
        row('the shortest path itself: near itself, near the edge', [
            f'{t.shortest_drive.near_itself:.0%}, {t.shortest_drive.near_edge:.0%}'
            for t in trials]),
        row('route entropy [nats] (upper bound for paths)', [
            f'{t.strategy.route_entropy:.1f}' for t in trials]),
        row(f'different paths in {len(trials[0].paths)} draws', [str(t.different) for t in trials]),
        row('nodes, nodes of a route', [
            f'{len(t.strategy.network.points)}, {t.strategy.visit_probability.sum():.0f}'
            for t in trials]),
        row('processor time a path', [f'{t.milliseconds:.2f} ms' for t in trials]),
    ]


def _ratio(turning: float, of: float) -> str:
    return f'{turning / of:.1f}' if of > 1e-6 else 'none'


def networks_table(across: int) -> str:
    """Processor seconds for large networks, and for Qhull alone on all their nodes at once."""
    risk_map, spacing = block(across), SIDE / across
    ends = (0.5 * spacing, 0.5 * SIDE), (SIDE - 0.5 * spacing, 0.5 * SIDE)
    rows = []
    for method in METHODS:
        options = NetworkOptions(method=method, spacing=spacing)
        build = partial(build_network, risk_map, *ends, options)
        points = build().points
        seconds = [min(repeat(work, number=1, repeat=7, timer=process_time))
                   for work in (build, partial(Delaunay, points))]
        rows.append([f'`{method}`', str(len(points)), *(f'{s:.2f}' for s in seconds)])
    return table(['network', 'nodes', 'processor seconds', 'Qhull alone'], rows)


def picture(trial: Trial, path: Path) -> None:
    """Left: eight paths and the best ambush sites. Right: the shortest and the safest path."""
    figure = Figure(figsize=(15.0, 8.0), dpi=100, layout='compressed')
    left, right = figure.subplots(1, 2)
    risk_map, strategy = trial.ground.risk_map, trial.strategy
    frame(left, risk_map, f'{SHOWN} departures')
    frame(right, risk_map, 'the same path every day')
    draw_routes(left, [poses[:, :2] for poses in trial.paths[:SHOWN]])
    draw_ambush_sites(left, strategy.network, strategy.ambush_probability)
    lines = draw_fixed_routes(right, [
        replace(fixed, points=fixed.points[:, :2]) for fixed in (trial.shortest, trial.safest)
    ])
    for axes in (left, right):
        draw_risk_map(axes, risk_map)
        draw_ends(axes, trial.ground.start, trial.ground.goal)
    right.legend(handles=lines, loc='best')
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def before_and_after(trials: dict[str, Trial], path: Path) -> None:
    """Above: eight routes of the paper's strategy, as drawn. Below: eight paths of ours."""
    trials = {name: trial for name, trial in trials.items() if trial.papers}
    wide = [np.divide(*trial.ground.risk_map.size) for trial in trials.values()]
    figure = Figure(figsize=(4.0 * sum(wide) + 1.0, 9.0), dpi=80, layout='compressed')
    grid = figure.subplots(2, len(trials), width_ratios=wide, squeeze=False)
    for (name, trial), pair in zip(trials.items(), grid.T, strict=True):
        ours = [poses[:, :2] for poses in trial.paths[:SHOWN]]
        for axes, who, lines in zip(
            pair, ("the paper's, as drawn", 'driven now'), (trial.papers, ours), strict=True
        ):
            frame(axes, trial.ground.risk_map, f'{name}: {who}')
            draw_routes(axes, lines)
            draw_risk_map(axes, trial.ground.risk_map)
            draw_ends(axes, trial.ground.start, trial.ground.goal)
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument('--maps', nargs='+', default=list(GROUNDS), choices=list(GROUNDS))
    parser.add_argument('--departures', type=int, default=1000, help='paths of a map')
    parser.add_argument(
        '--nodes', type=int, default=NetworkOptions.target_nodes, metavar='N', help='of a network'
    )
    parser.add_argument('--across', type=int, default=200, help='nodes across in large networks')
    parser.add_argument('--pictures', type=Path, default=Path('out/routes'), help='folder')
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `routes` is replaced'
    )
    options = parser.parse_args()
    trials, missing = {}, []
    for name in options.maps:
        try:
            ground = GROUNDS[name]()
        except FileNotFoundError as error:
            missing.append(f'`{name}` is left out: {error.filename} is not there.')
            continue
        trials[name] = run(ground, options.departures, options.nodes)
        picture(trials[name], options.pictures / f'{name}.png')
        print(name, figures_of(trials[name]), file=sys.stderr)
    if any(trial.papers for trial in trials.values()):
        before_and_after(trials, options.pictures / 'before_and_after.png')
    text = '\n\n'.join([
        f"{options.departures} departures a map, in brackets the first version's. {conditions()}.",
        *missing, routes_table(trials), '### Large networks', networks_table(options.across),
    ])
    print(text)
    write_block(options.results, 'routes', text)


if __name__ == '__main__':
    main()

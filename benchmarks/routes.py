"""Would you drive it? Paths of many departures on four maps, compared with a grid planner's."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from time import process_time

import numpy as np
from drives import Drive, measure, turning_of
from grid_planner import shortest_line
from report import conditions, new_parser, publish, table
from scenarios import SCENARIOS, Scenario

from ambush_planner import NetworkOptions, Strategy, StrategyOptions, solve
from ambush_planner.arrays import FloatArray
from ambush_planner.network.construction import chosen_spacing
from ambush_planner.planning.evaluation import energy_efficient_route
from ambush_planner.routes.corridors import make_corridors
from ambush_planner.routes.driven_path import different_paths, driven_path

# Upper limits of the targets.
TARGETS = {
    'mean length : any-angle A*': 1.25,
    'hairpins a route': 0.05,
    "turning : the shortest drawn route's": 1.3,
    'near itself': 0.0,
    "near the map's edge": 0.01,
}


@dataclass(frozen=True, eq=False)
class Trial:
    """The measurements on one map."""

    scenario: Scenario
    strategy: Strategy
    paths: list[FloatArray]
    drives: list[Drive]
    shortest: float
    drawn_turning: float
    grid_length: float
    different: int
    milliseconds: float

    def mean(self, name: str) -> float:
        return float(np.mean([getattr(drive, name) for drive in self.drives]))

    def figures(self) -> dict[str, float]:
        """The figures with targets, by name."""
        values = (
            self.mean('length') / self.grid_length, self.mean('hairpins'),
            self.mean('turning') / self.drawn_turning, self.mean('near_itself'),
            self.mean('near_edge'),
        )
        return dict(zip(TARGETS, values, strict=True))


def run(scenario: Scenario, departures: int, nodes: int) -> Trial:
    """Solve, draw routes and measure their paths."""
    risk_map, options = scenario.risk_map, NetworkOptions(target_nodes=nodes)
    spacing = chosen_spacing(risk_map, options)
    network = scenario.network(options)
    strategy = solve(network, options=StrategyOptions(max_detour=1.2, risk_slack=0.01))
    corridors = make_corridors(network, risk_map)
    step = max(risk_map.resolution, spacing)
    rng = np.random.default_rng(0)
    routes = [strategy.sample_route(rng) for _ in range(departures)]
    started = process_time()
    paths = [driven_path(corridors, route, step) for route in routes]
    seconds = process_time() - started
    straight = energy_efficient_route(strategy.game)
    shortest = measure(driven_path(corridors, straight, step), risk_map, spacing, step).length
    return Trial(
        scenario, strategy, paths,
        [measure(path, risk_map, spacing, step) for path in paths], shortest,
        turning_of(network.points[straight]),
        float(np.hypot(*np.diff(shortest_line(scenario), axis=0).T).sum()),
        different_paths(corridors, routes), 1e3 * seconds / len(paths),
    )


def routes_table(trials: dict[str, Trial]) -> str:
    """A row for each target, with missed ones in bold, and further figures."""
    figures, rows = [trial.figures() for trial in trials.values()], []
    for name, target in TARGETS.items():
        form = '.1%' if name.startswith('near') else '.2f'
        cells = [f'{each[name]:{form}}' for each in figures]
        met = [each[name] <= target for each in figures]
        rows.append([name, f'<= {target:{form}}', *_bold_if_missed(cells, met)])
    shares = [trial.mean('accepted') for trial in trials.values()]
    cells = _bold_if_missed([f'{share:.1%}' for share in shares], [s == 1.0 for s in shares])
    rows.append(["accepted by Nav2's rules", '100 %', *cells])

    def add(name: str, texts: list[str]) -> None:
        rows.append([name, '', *texts])

    of = list(trials.values())
    add('shortest route on the network, driven : any-angle A*',
        [f'{t.shortest / t.grid_length:.2f}' for t in of])
    add('turning [rad]: mean path, shortest drawn route',
        [f"{t.mean('turning'):.1f}, {t.drawn_turning:.1f}" for t in of])
    add('route entropy [nats] (upper bound for paths)',
        [f'{t.strategy.route_entropy:.1f}' for t in of])
    add(f'different paths in {len(of[0].paths)} draws', [str(t.different) for t in of])
    add('nodes, nodes of a route', [
        f'{len(t.strategy.network.points)}, {t.strategy.visit_probability.sum():.0f}' for t in of])
    add('processor time a path', [f'{t.milliseconds:.2f} ms' for t in of])
    return table(['', 'target', *trials], rows)


def _bold_if_missed(cells: list[str], met: list[bool]) -> list[str]:
    return [cell if ok else f'**{cell}**' for cell, ok in zip(cells, met, strict=True)]


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--maps', nargs='+', default=list(SCENARIOS), choices=list(SCENARIOS))
    parser.add_argument('--departures', type=int, default=1000, help='paths on each map')
    parser.add_argument(
        '--nodes', type=int, default=NetworkOptions.target_nodes, metavar='N', help='of a network'
    )
    options = parser.parse_args()
    trials = {}
    for name in options.maps:
        try:
            scenario = SCENARIOS[name]()
        except FileNotFoundError as error:
            print(f'`{name}` is left out: {error.filename} does not exist', file=sys.stderr)
            continue
        trials[name] = run(scenario, options.departures, options.nodes)
        print(name, trials[name].figures(), file=sys.stderr)
    publish(options.results, 'routes', (
        f'{options.departures} departures on each map. {conditions()}.\n\n{routes_table(trials)}'
    ))


if __name__ == '__main__':
    main()

# SPDX-License-Identifier: Apache-2.0
"""Would you drive it? Paths of many departures on three maps, next to A* on the map's cells."""

from __future__ import annotations

from time import process_time

import numpy as np
from peers import best_route
from report import conditions, new_parser, publish, table
from scenarios import SCENARIOS, Scenario
from scipy.spatial import cKDTree

from ambush_planner import Network, NetworkOptions, PlanningOptions, RiskMap, plan_trip
from ambush_planner.arrays import FloatArray

# Upper limits of the targets.
TARGETS = {
    'mean length : A* on cells, 8-connected': 1.2,
    'hairpins a route': 0.05,
    "turning : the shortest drawn route's": 1.3,
    'near itself': 0.0,
    "near the map's edge": 0.01,
}
ACCEPTED = "accepted by Nav2's rules"
HAIRPIN = np.radians(120.0)  # change of heading within one spacing
NEAR_ITSELF = 3.0  # distance between parts of a path, three times as far along it [spacings]
NEAR_EDGE = 1.5  # distance from the map's outer edge [spacings]


def figures(scenario: Scenario, departures: int, nodes: int) -> dict[str, float | str]:
    """The means over the paths of many departures, by name; those without a target as text."""
    risk_map = scenario.risk_map
    plan = plan_trip(risk_map, scenario.start, scenario.goal,
                     PlanningOptions(network=NetworkOptions(target_nodes=nodes)))
    network, strategy = plan.network, plan.strategy
    begin = process_time()
    paths = plan.paths(departures, np.random.default_rng(0))
    seconds = process_time() - begin
    measured = np.array([measure(path, risk_map, plan.spacing) for path in paths])
    length, turning, hairpins, near_itself, near_edge, accepted = measured.mean(axis=0)
    drawn_turning = turning_of(shortest(network))
    cells = scenario.network(NetworkOptions(method='uniform_grid8', spacing=risk_map.resolution))
    grid_length = distances(shortest(cells))[-1]
    means = length / grid_length, hairpins, turning / drawn_turning, near_itself, near_edge
    return dict(zip(TARGETS, means, strict=True)) | {
        ACCEPTED: accepted,
        'turning [rad]: mean path, shortest drawn route': f'{turning:.1f}, {drawn_turning:.1f}',
        'route entropy [nats] (upper bound for paths)': f'{strategy.route_entropy:.1f}',
        'different paths in 1000 draws': f'{plan.different_paths}',
        'nodes, nodes of a route':
            f'{len(network.points)}, {strategy.visit_probability.sum():.0f}',
        'processor time a path': f'{1e3 * seconds / len(paths):.2f} ms',
    }


def shortest(network: Network) -> FloatArray:
    """The positions (K, 2) of the nodes of the shortest route."""
    return network.points[best_route(network, network.lengths)]


def measure(poses: FloatArray, risk_map: RiskMap, spacing: float) -> tuple[float, ...]:
    """Length [m], turning [rad], hairpins, shares near itself and the edge, accepted by Nav2."""
    points, along = resampled(poses, spacing / 20.0)
    travelled, yaw = distances(poses), np.unwrap(poses[:, 2])
    uv = risk_map.to_map_axes(points)
    near_edge = np.minimum(uv, risk_map.size - uv).min(axis=1) < NEAR_EDGE * spacing
    return (float(travelled[-1]), float(np.abs(np.diff(yaw)).sum()),
            _hairpins(travelled, yaw, spacing), _near_itself(points, along, spacing),
            float(near_edge.mean()), float(accepted(poses, risk_map, spacing)))


def distances(poses: FloatArray) -> FloatArray:
    """Distance travelled at each pose [m]."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))


def resampled(poses: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Points every ``step`` [m] along a path, and their distances along it."""
    travelled = distances(poses)
    along = np.arange(0.0, travelled[-1], step)
    return np.stack([np.interp(along, travelled, xy) for xy in poses[:, :2].T], axis=1), along


def _hairpins(travelled: FloatArray, yaw: FloatArray, spacing: float) -> int:
    """Number of changes of heading by more than ``HAIRPIN`` within one spacing."""
    end = np.searchsorted(travelled, travelled + spacing, side='right')
    sharp = [np.ptp(yaw[k : max(e, k + 2)]) > HAIRPIN for k, e in enumerate(end)]
    return int((np.diff(np.concatenate(([False], sharp)).astype(int)) > 0).sum())


def _near_itself(points: FloatArray, along: FloatArray, spacing: float) -> float:
    near = cKDTree(points).query_pairs(NEAR_ITSELF * spacing, output_type='ndarray')
    apart = np.abs(along[near[:, 0]] - along[near[:, 1]]) > 3.0 * NEAR_ITSELF * spacing
    return len(np.unique(near[apart])) / len(points)


def accepted(poses: FloatArray, risk_map: RiskMap, step: float) -> bool:
    """Whether poses are close, yaw jumps by at most 45 degrees, and no point is in an obstacle.

    Checks points a tenth of a cell apart, independently of the planner's own test.
    """
    steps = np.diff(poses[:, :2], axis=0)
    jumps = np.abs((np.diff(poses[:, 2]) + np.pi) % (2 * np.pi) - np.pi)
    if np.hypot(*steps.T).max() > step * (1.0 + 1e-9) or jumps.max() > np.radians(45.0):
        return False
    points, _ = resampled(poses, risk_map.resolution / 10.0)
    uv = risk_map.to_map_axes(np.concatenate((points, poses[:, :2])))
    inside = bool(((uv > 0.0) & (uv < risk_map.size)).all())
    return inside and not risk_map.obstacles[risk_map.cells(uv)].any()


def turning_of(points: FloatArray) -> float:
    """Sum of the turns at the corners of a line [rad]."""
    heading = np.arctan2(*np.diff(points, axis=0).T[::-1])
    return float(np.abs((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi).sum())


def routes_table(trials: dict[str, dict[str, float | str]]) -> str:
    """A row for each figure, with missed targets in bold."""
    rows = []
    for name in next(iter(trials.values())):
        target = TARGETS.get(name, 1.0 if name == ACCEPTED else None)
        form = '.1%' if name.startswith(('near', 'accepted')) else '.2f'
        cells = []
        for trial in trials.values():
            value = trial[name]
            text = value if isinstance(value, str) else f'{value:{form}}'
            missed = not isinstance(value, str) and target is not None and (
                value < target if name == ACCEPTED else value > target)
            cells.append(f'**{text}**' if missed else text)
        sign = '>=' if name == ACCEPTED else '<='
        rows.append([name, '' if target is None else f'{sign} {target:{form}}', *cells])
    return table(['', 'target', *trials], rows)


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--maps', nargs='+', default=list(SCENARIOS), choices=list(SCENARIOS))
    parser.add_argument('--departures', type=int, default=1000, help='paths on each map')
    parser.add_argument(
        '--nodes', type=int, default=NetworkOptions.target_nodes, metavar='N', help='of a network'
    )
    options = parser.parse_args()
    trials = {name: figures(SCENARIOS[name](), options.departures, options.nodes)
              for name in options.maps}
    publish(options.results, 'routes', (
        f'{options.departures} departures on each map. {conditions()}.\n\n{routes_table(trials)}'
    ))


if __name__ == '__main__':
    main()

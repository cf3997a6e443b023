# SPDX-License-Identifier: Apache-2.0
"""The cost of random routes without a game: how others vary their routes, at our mean length.

On the same network, against the same ambusher: the largest loss over all free cells outside the
secured area, each route counted once, over the value of our plan. Amplitudes of noise and numbers
of alternatives are the largest whose mean length is at most ours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice, pairwise

import networkx
import numpy as np
from families import draw, problem_parser
from games import meets, standing_places
from one_run import Answer, run
from report import conditions, publish, table
from scipy.ndimage import gaussian_filter

from ambush_planner import Network, RiskMap, plan_trip
from ambush_planner.arrays import FloatArray
from ambush_planner.network.shortest_paths import shortest_path

Route = list[int]  # edges
DRAWN = 200  # routes of a random planner
AMPLITUDES = np.geomspace(0.05, 4.0, 12)  # of noise, in the logarithm of the costs
SMOOTH = 0.1  # of the map's width, of the hills of cost
YEN = 30  # shortest routes
AT_ONCE = 2000  # places whose hits are computed together


class Others:
    """Planners on one network; each returns routes whose mean length is at most ``length`` [m]."""

    def __init__(self, risk_map: RiskMap, network: Network, length: float, seed: int) -> None:
        self._map, self._network, self._length = risk_map, network, length
        self._number = {tuple(edge): k for k, edge in enumerate(network.edges.tolist())}
        self._rng = np.random.default_rng(seed)

    def planners(self) -> dict[str, Callable[[], list[Route]]]:
        lengths, exposure = self._network.lengths, self._network.edge_exposure
        return {
            'the shortest route, always': lambda: [self.route(lengths)],
            'the least exposed route, always': lambda: [self.route(exposure)],
            '10 alternatives, used edges x 1.4': lambda: self.alternatives(10, 1.4),
            '30 alternatives, used edges x 1.2': lambda: self.alternatives(30, 1.2),
            f'{YEN} shortest routes (Yen)': self.shortest,
            'shortest routes on noisy lengths': lambda: self.noisy(lengths, self.rough),
            'least exposed routes on noisy exposures': lambda: self.noisy(exposure, self.rough),
            'shortest routes over random hills of cost': lambda: self.noisy(lengths, self.hills),
            'least exposed routes over such hills': lambda: self.noisy(exposure, self.hills),
        }

    def route(self, weights: FloatArray) -> Route:
        network = self._network
        return self._edges(shortest_path(network.edges, weights, len(network.points),
                                         network.source, network.target).tolist())

    def alternatives(self, most: int, factor: float) -> list[Route]:
        """Shortest routes in turns, each making its edges longer for those after it."""
        weights, routes = self._network.lengths.copy(), list[Route]()
        for _ in range(most):
            routes.append(self.route(weights))
            weights[routes[-1]] *= factor
        fits = [k for k in range(1, most + 1) if self._fits(routes[:k])]
        return routes[: max(fits, default=1)]

    def shortest(self) -> list[Route]:
        graph = networkx.DiGraph()
        for (tail, head), length in zip(self._number, self._network.lengths, strict=True):
            graph.add_edge(tail, head, weight=length)
        ends = self._network.source, self._network.target
        found: Iterator[list[int]] = networkx.shortest_simple_paths(graph, *ends, weight='weight')
        return [self._edges(nodes) for nodes in islice(found, YEN)]

    def noisy(self, costs: FloatArray, noise: Callable[[], FloatArray]) -> list[Route]:
        """Best routes on costs times the exponential of noise."""
        drawn, chosen = [noise() for _ in range(DRAWN)], list[Route]()
        for amplitude in AMPLITUDES:
            routes = [self.route(costs * np.exp(amplitude * each)) for each in drawn]
            if chosen and not self._fits(routes):
                break
            chosen = routes
        return chosen

    def rough(self) -> FloatArray:
        return self._rng.normal(size=len(self._network.edges))

    def hills(self) -> FloatArray:
        """Smooth noise (M,) at the middles of the edges."""
        shape = self._map.obstacles.shape
        field = gaussian_filter(self._rng.normal(size=shape), SMOOTH * max(shape), mode='wrap')
        middle = self._network.points[self._network.edges].mean(axis=1)
        at: FloatArray = field[self._map.cells(self._map.to_map_axes(middle))]
        return (at - field.mean()) / float(field.std())

    def mean_length(self, routes: list[Route]) -> float:
        return float(np.mean([self._network.lengths[route].sum() for route in routes]))

    def _fits(self, routes: list[Route]) -> bool:
        return self.mean_length(routes) <= self._length

    def _edges(self, nodes: list[int]) -> Route:
        return [self._number[step] for step in pairwise(nodes)]


def compared(name: str) -> Answer:
    """Loss and mean length of every other planner, over our value and mean length."""
    problem = draw(name)
    scenario, game = problem.scenario, problem.options.game
    plan = plan_trip(scenario.risk_map, scenario.start, scenario.goal, problem.options)
    if plan.value == 0.0:
        return {'failed': True, 'seconds': plan.seconds, 'status': 'nothing to lose'}
    network, strategy, tube = plan.network, plan.strategy, plan.tube or 0.0
    reach = game.ambush_radius + tube
    secured = reach if game.secured_radius is None else game.secured_radius
    places, alpha = standing_places(scenario.risk_map, network, secured)
    others = Others(scenario.risk_map, network, strategy.expected_length, len(places))
    drawn = {planner: make() for planner, make in others.planners().items()}
    worst = dict.fromkeys(drawn, 0.0)
    for first in range(0, len(places), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        near = meets(network, places[some], reach, secured - tube)
        for planner, routes in drawn.items():
            hit = np.mean([near[:, route].any(axis=1) for route in routes], axis=0)
            worst[planner] = max(worst[planner], float((alpha[some] * hit).max()))
    rows = {planner: (worst[planner] / strategy.value,
                      others.mean_length(routes) / strategy.expected_length)
            for planner, routes in drawn.items()}
    return {'seconds': plan.seconds, 'status': 'compared', 'rows': rows}


def main() -> None:
    parser = problem_parser(__doc__)
    parser.set_defaults(limit=600.0)
    parser.add_argument('--nodes', type=int, default=1500)
    options = parser.parse_args()
    first = options.seed
    names = [f'plan:{family}:{options.nodes}:{seed}' for family in options.families
             for seed in range(first, first + options.each)]
    answers = [run('others.compared', name, options.limit) for name in names]
    found = [answer['rows'] for answer in answers if 'failed' not in answer]
    rows = []
    for planner in found[0]:
        losses, lengths = np.array([each[planner] for each in found]).T
        rows.append((float(np.median(losses)), [
            planner, f'**{np.median(losses):.2f}**', f'{losses.min():.2f} to {losses.max():.2f}',
            f'{np.median(lengths):.2f}']))
    head = ('', 'loss over our value, median', 'range', 'mean length over ours, median')
    publish(options.results, 'others', (
        f'{len(found)} problems of {options.nodes} nodes, seeds {first} to '
        f'{first + options.each - 1}. {conditions()}.\n\n{table(head, [row for _, row in rows])}'
        f'\n\nThe best of them: {min(rows)[1][0]}, {min(rows)[0]:.2f} times our value.'))


if __name__ == '__main__':
    main()

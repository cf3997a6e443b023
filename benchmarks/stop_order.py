"""Cost and gain of the best order of three stops over a random one, on problems of the families."""

from __future__ import annotations

import time

from families import FAMILIES, Problem, draw
from report import conditions, new_parser, publish, table

from ambush_planner import NetworkOptions, PlanningOptions, plan_trip
from ambush_planner.planning.options import node_spacing
from ambush_planner.planning.plan import Plan

STOPS = 3


def plan(problem: Problem, order: str) -> tuple[Plan, float]:
    """The plan in the given or the best order, and its processor seconds."""
    scenario, network = problem.scenario, NetworkOptions(target_nodes=problem.nodes // (STOPS + 1))
    spacing = node_spacing(scenario.risk_map, network)
    options = PlanningOptions(network, problem.game(spacing), problem.strategy())
    begin = time.process_time()
    made = plan_trip(scenario.risk_map, scenario.start, scenario.goal, options,
                     stops=problem.stops, order=order)
    return made, time.process_time() - begin


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--nodes', type=int, default=2500, help='in all layers together')
    parser.add_argument('--families', nargs='+', default=['hills-obstacles', 'rough', 'city'],
                        choices=list(FAMILIES))
    parser.add_argument('--each', type=int, default=2, help='problems of each family')
    parser.add_argument('--seed', type=int, default=1, help='the first seed')
    arguments = parser.parse_args()
    rows = []
    for family in arguments.families:
        for seed in range(arguments.seed, arguments.seed + arguments.each):
            name = f'{family}:{arguments.nodes}:{seed}'
            problem = draw(name, stops=STOPS)
            (given, slow), (best, slower) = (plan(problem, order) for order in ('given', 'best'))
            lengths = [each.strategy.shortest_length for each in (given, best)]
            values = [each.strategy.value for each in (given, best)]
            rows.append([
                f'`{name}` reach {problem.reach:g}', ' '.join(str(k + 1) for k in best.order),
                f'{lengths[1] / lengths[0]:.2f}', f'{values[1] / values[0]:.2f}', f'{slow:.1f}',
                f'{slower:.1f}', f'**{slower / slow:.1f}**',
            ])
    head = ('', 'best order', 'shortest route, ratio', 'value, ratio', 'given: processor seconds',
            'best: processor seconds', 'ratio')
    publish(arguments.results, 'stop_order', f'{table(head, rows)}\n\n{conditions()}.')


if __name__ == '__main__':
    main()

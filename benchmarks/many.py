"""Speed-up of ``solve_many`` with a pool of processes over a single process."""

from __future__ import annotations

import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from report import conditions, new_parser, publish, table
from scenarios import SIDE, hills

from ambush_planner import (
    NetworkOptions,
    Problem,
    RiskMap,
    Strategy,
    StrategyOptions,
    build_network,
    solve,
    solve_many,
)


def value(strategy: Strategy) -> float:
    return strategy.value


def solve_one(problem: Problem) -> float:
    network = build_network(
        problem.risk_map, problem.start_xy, problem.goal_xy, problem.network
    )
    return solve(network, problem.game, problem.strategy).value


def problems_on(risk_map: RiskMap, count: int, nodes: int) -> list[Problem]:
    """Pairs of free places on opposite sides of the map."""
    rng = np.random.default_rng(0)
    ends = rng.uniform(0.05, 0.95, (50 * count, 2)) * SIDE
    starts, goals = (
        np.stack([np.full(len(ends), x * SIDE), y], axis=1)
        for x, y in zip((0.04, 0.96), ends.T, strict=True)
    )
    rows, columns = risk_map.cells(np.stack([starts, goals]))
    free = np.flatnonzero(~risk_map.obstacles[rows, columns].any(axis=0))[:count]
    network, strategy = NetworkOptions(target_nodes=nodes), StrategyOptions(max_detour=1.5)
    return [
        Problem(risk_map, tuple(starts[k]), tuple(goals[k]), network, strategy=strategy)
        for k in free
    ]


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--cells', type=int, default=1000, help='map cells across')
    parser.add_argument('--pairs', type=int, default=40, help='number of problems')
    parser.add_argument('--nodes', type=int, default=900, help='nodes of each network')
    parser.add_argument('--repeats', type=int, default=3, help='runs, of which the best counts')
    options = parser.parse_args()
    jobs = os.cpu_count() or 1
    problems = problems_on(hills(options.cells), options.pairs, options.nodes)
    alone, pooled = [], []
    with ProcessPoolExecutor(jobs, multiprocessing.get_context('spawn')) as pool:
        # The processes start and import everything before the measurement.
        tiny = RiskMap(np.ones((9, 9)), np.zeros((9, 9), bool), 1.0)
        list(pool.map(solve_one, [Problem(tiny, (1.5, 1.5), (7.5, 7.5))] * 4 * jobs))
        for _ in range(options.repeats):
            begin = time.perf_counter()
            values = [solve_one(problem) for problem in problems]
            alone.append(time.perf_counter() - begin)
            begin = time.perf_counter()
            results = list(solve_many(problems, pool, answer=value, in_flight=2 * jobs))
            pooled.append(time.perf_counter() - begin)
            if [each.answer for each in results] != values:
                raise RuntimeError('solve_many returns other values')
    rows = [
        ['in this process', '1', f'{min(alone):.2f}', '1.00'],
        ['`solve_many`', str(jobs), f'{min(pooled):.2f}', f'{min(alone) / min(pooled):.2f}'],
    ]
    publish(options.results, 'many', (
        f'{len(problems)} pairs on one map of {options.cells} x {options.cells} cells, networks of '
        f'about {options.nodes} nodes; the best of {options.repeats} runs. {conditions()}.\n\n'
        f"{table(('', 'processes', 'seconds', 'speed-up'), rows)}"
    ))


if __name__ == '__main__':
    main()

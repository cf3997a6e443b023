"""What ``solve_many`` brings: speed-up over one process, and the cost of shipping maps.

The peer sends each problem whole, map included, through ``Executor.map``. The tables go to the
screen and into results.md.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import pickle
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import Any

import maps
import numpy as np
from report import RESULTS, conditions, table, write_block

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

WAYS = ('in this process', 'solve_many', 'map with each problem')


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
    ends = rng.uniform(0.05, 0.95, (50 * count, 2)) * maps.SIDE
    starts, goals = (
        np.stack([np.full(len(ends), x * maps.SIDE), y], axis=1)
        for x, y in zip((0.04, 0.96), ends.T, strict=True)
    )
    rows, columns = risk_map.cells(np.stack([starts, goals]))
    free = np.flatnonzero(~risk_map.obstacles[rows, columns].any(axis=0))[:count]
    options = NetworkOptions(target_nodes=nodes), StrategyOptions(max_detour=1.5)
    return [
        Problem(risk_map, tuple(starts[k]), tuple(goals[k]), options[0], strategy=options[1])
        for k in free
    ]


class Scales:
    """An executor that weighs what is sent through it."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self.maps, self.bytes = 0, 0

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        self.bytes += len(pickle.dumps(arguments))
        self.maps += any(isinstance(each, bytes) and len(each) > 1000 for each in arguments)
        return self._executor.submit(function, *arguments)


def run(way: str, problems: list[Problem], jobs: int) -> dict[str, Any]:
    """Seconds, and what was sent; processes are there and have imported all before it begins."""
    if way == WAYS[0]:
        begin = time.perf_counter()
        values = [solve_one(problem) for problem in problems]
        return {'seconds': time.perf_counter() - begin, 'values': values, 'maps': 0, 'bytes': 0}
    with ProcessPoolExecutor(jobs, multiprocessing.get_context('spawn')) as pool:
        tiny = RiskMap(np.ones((9, 9)), np.zeros((9, 9), bool), 1.0)
        list(pool.map(solve_one, [Problem(tiny, (1.5, 1.5), (7.5, 7.5))] * 4 * jobs))
        begin = time.perf_counter()
        if way == WAYS[1]:
            scales = Scales(pool)
            results = solve_many(problems, scales, answer=value, in_flight=2 * jobs)
            found = {'values': [each.answer for each in results], 'maps': scales.maps,
                     'bytes': scales.bytes}
        else:
            found = {'values': list(pool.map(solve_one, problems)), 'maps': len(problems),
                     'bytes': len(problems) * len(pickle.dumps(problems[0]))}
        return found | {'seconds': time.perf_counter() - begin}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument('--cells', type=int, default=1000, help='map cells across')
    parser.add_argument('--pairs', type=int, default=40, help='number of problems')
    parser.add_argument('--nodes', type=int, default=900, help='nodes of each network')
    parser.add_argument('--repeats', type=int, default=3, help='turns; the best one counts')
    arguments = parser.parse_args()
    jobs = os.cpu_count() or 1
    problems = problems_on(maps.hills(arguments.cells), arguments.pairs, arguments.nodes)
    best: dict[str, dict[str, Any]] = {}
    for _ in range(arguments.repeats):
        for way in WAYS:
            found = run(way, problems, jobs)
            assert way == WAYS[0] or found['values'] == best[WAYS[0]]['values']
            if way not in best or found['seconds'] < best[way]['seconds']:
                best[way] = found
    alone = best[WAYS[0]]['seconds']
    rows = [
        [way, str(1 if way == WAYS[0] else jobs), f'{each["seconds"]:.2f}',
         f'{alone / each["seconds"]:.2f}', str(each['maps']), f'{each["bytes"] / 1e6:.1f}']
        for way, each in best.items()
    ]
    head = ['', 'processes', 'seconds', 'speed-up', 'maps sent', 'MB sent']
    text = (
        f'{len(problems)} pairs on one map of {arguments.cells} x {arguments.cells} cells, '
        f'networks of about {arguments.nodes} nodes; the best of {arguments.repeats}.\n\n'
        f'{table(head, rows)}\n\n{conditions()}'
    )
    print(text)
    write_block(RESULTS, 'many', f'## Many pairs\n\n{text}')


if __name__ == '__main__':
    main()

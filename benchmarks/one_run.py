"""Run one solver on one problem in a process of its own and print what came out as JSON.

A process of its own, so that the peak of its memory is the solver's. Seconds are the processor's:
on one thread they do not depend on what else the machine does. `solver.py` starts these.
"""

from __future__ import annotations

import argparse
import json
import resource
import signal
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from peers import Answer, EntropyProblem, clarabel_entropy, highs
from problems import Problem, problem

from ambush_planner import Network, Strategy, TimeLimit, solve
from ambush_planner.game.cut import solve_by_min_cut
from ambush_planner.game.game import make_game

# With this our side loads what it loads at its first use.
WARM_UP = 'block:12'


def build(given: Problem, file: Path) -> Callable[[], Answer]:
    """The network from the map."""

    def run() -> Answer:
        started = time.process_time()
        network = given.network()
        return {'seconds': time.process_time() - started} | _size(network)

    return run


def value(given: Problem, file: Path) -> Callable[[], Answer]:
    """The exact value without a length budget, by a minimum cut."""
    game = make_game(given.network(), given.game)

    def run() -> Answer:
        started = time.process_time()
        found = solve_by_min_cut(game)
        return {'seconds': time.process_time() - started, 'value': found.value}

    return run


def strategy(given: Problem, file: Path) -> Callable[[], Answer]:
    """The default strategy, all stages; leaves its entropy problem in the file for others."""
    network = given.network()

    def run() -> Answer:
        started = time.process_time()
        answer, found = _solved(network, given)
        seconds = time.process_time() - started
        if found is not None:
            np.savez(
                file, edges=np.flatnonzero(found.edge_probability > 0.0), value=found.value,
                length=found.expected_length, budget=found.length_budget,
            )
        return answer | _size(network) | {'seconds': seconds}

    return run


def whole(given: Problem, file: Path) -> Callable[[], Answer]:
    """Network and strategy."""

    def run() -> Answer:
        started = time.process_time()
        network = given.network()
        answer, _ = _solved(network, given)
        return answer | _size(network) | {'seconds': time.process_time() - started}

    return run


def _solved(network: Network, given: Problem) -> tuple[Answer, Strategy | None]:
    try:
        found = solve(network, given.game, given.options)
    except TimeLimit as error:  # rounding stood in the way
        if error.strategy is None:
            raise
        return {'status': 'gap not closed', 'failed': True, 'gap': error.strategy.gap}, None
    return {
        'value': found.value,
        'gap': found.gap,
        'route_entropy': found.route_entropy,
        'length': found.expected_length / found.shortest_length,
        'price': found.length_price,
        'iterations': found.iterations,
        'acyclic_edges': int((found.edge_probability > 0.0).sum()),
    }, found


def _size(network: Network) -> Answer:
    return {'nodes': len(network.points), 'edges': len(network.edges)}


def simplex(given: Problem, file: Path) -> Callable[[], Answer]:
    """The value with the length budget by HiGHS' dual simplex method."""
    with np.load(file) as left:
        return highs(given.network(), float(left['budget']), 'simplex')


def interior_point(given: Problem, file: Path) -> Callable[[], Answer]:
    """The value without a length budget by HiGHS' interior point method without crossover."""
    return highs(given.network(), np.inf, 'ipx')


def conic(given: Problem, file: Path) -> Callable[[], Answer]:
    """The route-entropy problem by Clarabel, within what the strategy used."""
    with np.load(file) as left:
        entropy = EntropyProblem(left['edges'], float(left['value']), float(left['length']))
    return clarabel_entropy(given.network(), entropy)


OURS = (build, value, strategy, whole)
TASKS = (*OURS, simplex, interior_point, conic)


def measure(run: Callable[[], Answer], long_enough: float) -> Answer:
    """Run until it has taken ``long_enough`` [s]; the last answer with the median time."""
    times: list[float] = []
    while not times or sum(times) < long_enough:
        answer = run()
        times.append(answer['seconds'])
    return answer | {'seconds': statistics.median(times)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    tasks = {task.__name__: task for task in TASKS}
    parser.add_argument('task', choices=tasks, help='what is measured')
    parser.add_argument('problem', help='such as block:200, of problems.py')
    parser.add_argument('file', type=Path, help='.npz in which `strategy` leaves its problem')
    parser.add_argument('--limit', type=int, default=0, help='seconds after which it ends')
    parser.add_argument(
        '--repeat-for', type=float, default=0.5, help='seconds for which a short run is repeated'
    )
    arguments = parser.parse_args()
    task = tasks[arguments.task]
    if task in OURS:
        task(problem(WARM_UP), arguments.file)()
    prepared = task(problem(arguments.problem), arguments.file)
    # Native code does not look at Python's signals: SIGPROF's default ends the process.
    signal.setitimer(signal.ITIMER_PROF, arguments.limit)
    answer = measure(prepared, arguments.repeat_for)
    signal.setitimer(signal.ITIMER_PROF, 0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(json.dumps(answer | {'peak': peak}))


if __name__ == '__main__':
    main()

"""Run one task on one problem in a process of its own and print the result as JSON.

A separate process makes the peak memory the solver's own. Seconds are processor time on one thread,
so they do not depend on the machine's load. ``solver.py`` starts this script.

Problems: ``block:N``, and with an ambush radius of 4 spacings ``reach-block:N`` and
``reach-hills:N``, all N nodes across; ``terrain:D`` and ``city:D`` with ``max_detour`` D.
"""

from __future__ import annotations

import argparse
import json
import resource
import signal
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from peers import Answer, EntropyProblem, clarabel_entropy, highs
from scenarios import SCENARIOS, SIDE, block, block_network, hills, network_across

from ambush_planner import (
    GameOptions,
    Network,
    NetworkOptions,
    Strategy,
    StrategyOptions,
    TimeLimit,
    solve,
)
from ambush_planner.game.cut import solve_by_min_cut
from ambush_planner.game.game import make_game

# Ambush radius of the ``reach-`` problems [spacings].
REACH = 4.0
# Network options of the two scenarios: the terrain's spacing [m] and the city's number of nodes.
NETWORKS = {
    'terrain': NetworkOptions(spacing=360.0), 'city': NetworkOptions(target_nodes=7500)
}
TERRAIN_SECURED = 2000.0  # m
# A small problem solved first to load all libraries.
WARM_UP = 'block:12'


@dataclass(frozen=True)
class TimedProblem:
    """How the network is made, and the options of the solve."""

    network: Callable[[], Network]
    game: GameOptions
    options: StrategyOptions


def problem(name: str) -> TimedProblem:
    """The problem called ``name``; see the top of this file."""
    kind, _, number = name.partition(':')
    if kind == 'block':
        return TimedProblem(lambda: block_network(int(number)), GameOptions(), StrategyOptions())
    if kind.startswith('reach-'):
        risk_map = {'block': block, 'hills': hills}[kind.removeprefix('reach-')](100)
        game = GameOptions(ambush_radius=REACH * SIDE / int(number))
        return TimedProblem(lambda: network_across(risk_map, int(number)), game, StrategyOptions())
    scenario = SCENARIOS[kind]()
    game = GameOptions(secured_radius=TERRAIN_SECURED if kind == 'terrain' else 0.0)
    options = StrategyOptions(max_detour=float(number))
    return TimedProblem(lambda: scenario.network(NETWORKS[kind]), game, options)


def value(given: TimedProblem, file: Path) -> Callable[[], Answer]:
    """The exact value without a length budget, by a minimum cut."""
    game = make_game(given.network(), given.game)

    def run() -> Answer:
        started = time.process_time()
        found = solve_by_min_cut(game)
        return {'seconds': time.process_time() - started, 'value': found.value}

    return run


def strategy(given: TimedProblem, file: Path) -> Callable[[], Answer]:
    """The default strategy, all stages; saves its entropy problem for Clarabel."""
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
        return answer | {'seconds': seconds}

    return run


def whole(given: TimedProblem, file: Path) -> Callable[[], Answer]:
    """Network and strategy."""

    def run() -> Answer:
        started = time.process_time()
        answer, _ = _solved(given.network(), given)
        return answer | {'seconds': time.process_time() - started}

    return run


def _solved(network: Network, given: TimedProblem) -> tuple[Answer, Strategy | None]:
    size = {'nodes': len(network.points), 'edges': len(network.edges)}
    try:
        found = solve(network, given.game, given.options)
    except TimeLimit as error:
        if error.strategy is None:
            raise
        return size | {'status': 'gap not closed', 'failed': True, 'gap': error.strategy.gap}, None
    return size | {
        'value': found.value,
        'gap': found.gap,
        'route_entropy': found.route_entropy,
        'length': found.expected_length / found.shortest_length,
        'price': found.length_price,
        'iterations': found.iterations,
    }, found


def simplex(given: TimedProblem, file: Path) -> Callable[[], Answer]:
    """The value with the length budget by HiGHS' dual simplex method."""
    with np.load(file) as saved:
        return highs(given.network(), float(saved['budget']), 'simplex')


def interior_point(given: TimedProblem, file: Path) -> Callable[[], Answer]:
    """The value without a length budget by HiGHS' interior point method without crossover."""
    return highs(given.network(), np.inf, 'ipx')


def conic(given: TimedProblem, file: Path) -> Callable[[], Answer]:
    """The route-entropy problem by Clarabel, within the strategy's own value and length."""
    with np.load(file) as saved:
        entropy = EntropyProblem(saved['edges'], float(saved['value']), float(saved['length']))
    return clarabel_entropy(given.network(), entropy)


OURS = (value, strategy, whole)
TASKS = (*OURS, simplex, interior_point, conic)


def measure(run: Callable[[], Answer], duration: float) -> Answer:
    """Repeat for at least ``duration`` [s]; return the last answer with the median time."""
    times: list[float] = []
    while not times or sum(times) < duration:
        answer = run()
        times.append(answer['seconds'])
    return answer | {'seconds': statistics.median(times)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    tasks = {task.__name__: task for task in TASKS}
    parser.add_argument('task', choices=tasks, help='what is measured')
    parser.add_argument('problem', help='such as block:200')
    parser.add_argument('file', type=Path, help='.npz in which `strategy` saves its problem')
    parser.add_argument('--limit', type=int, default=0, help='processor seconds; 0: no limit')
    parser.add_argument(
        '--repeat-for', type=float, default=0.5, help='seconds for which a short run is repeated'
    )
    arguments = parser.parse_args()
    task = tasks[arguments.task]
    if task in OURS:
        task(problem(WARM_UP), arguments.file)()
    prepared = task(problem(arguments.problem), arguments.file)
    # Native code does not return to Python's signal handlers; SIGPROF's default ends the process.
    signal.setitimer(signal.ITIMER_PROF, arguments.limit)
    answer = measure(prepared, arguments.repeat_for)
    signal.setitimer(signal.ITIMER_PROF, 0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(json.dumps(answer | {'peak': peak}))


if __name__ == '__main__':
    main()

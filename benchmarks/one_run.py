"""Run one task on one problem of a family in a process of its own and print the result as JSON.

A separate process makes the peak memory the task's own. Seconds are processor time on one thread,
so they do not depend on the machine's load. ``solver.py`` starts this script.
"""

from __future__ import annotations

import argparse
import json
import resource
import signal
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from families import Problem, draw
from peers import EntropyProblem, clarabel_entropy, highs

from ambush_planner import GameOptions, Network, NoRoute, TimeLimit, solve
from ambush_planner.game import (
    entropy_stage,
    face_program,
    separate_legs,
    soft_search,
    strategy_solver,
)
from ambush_planner.game import strategy as whole_solve

Answer = dict[str, Any]
# The stages that are timed: module, function, name.
STAGES = (
    (strategy_solver, 'least_risk_by_cut', 'cut'),
    (soft_search, 'least_risk_by_cut', 'cut'),
    (entropy_stage, 'chain_ambusher', 'chain'),
    (face_program.FaceProgram, 'solve', 'faces'),
    (strategy_solver, 'least_risk', 'program'),
    (separate_legs, 'least_risk', 'program'),
    (entropy_stage, 'maximize_entropy', 'law'),
    (strategy_solver, 'count_routes_once', 'once'),
    (entropy_stage, 'hit_bound', 'certificate'),
    (whole_solve, 'certify', 'certificate'),
)


class Stages:
    """Processor seconds of each stage without those inside it, and the stages in order."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self.path: list[str] = []
        self._begun: list[float] = []
        for module, function, name in STAGES:
            setattr(module, function, self._timed(getattr(module, function), name))

    def _timed(self, stage: Callable[..., Any], name: str) -> Callable[..., Any]:
        def timed(*given: Any, **named: Any) -> Any:
            self._begun.append(0.0)
            begin, word = time.process_time(), name
            try:
                found = stage(*given, **named)
                failed = found is None if name == 'cut' else getattr(found, 'infeasible', False)
                word = f'({name})' if failed else name
                return found
            finally:
                spent = time.process_time() - begin
                self.seconds[name] += spent - self._begun.pop()
                if self._begun:
                    self._begun[-1] += spent
                if name != 'certificate' and self.path[-1:] != [word]:
                    self.path.append(word)

        return timed


def strategy(given: Problem, file: Path, limit: float) -> Answer:
    """The default strategy, all stages; saves its entropy problem for Clarabel."""
    try:
        network = given.network()
    except NoRoute:
        return {'failed': True, 'seconds': 0.0, 'status': 'no route', 'reach': given.reach}
    spacing = float(np.median(network.lengths))
    warm_up = draw('hills-coarse:100:0', 0.0, 1.2)
    solve(warm_up.network())  # loads all libraries
    stages, game, status = Stages(), given.game(spacing), 'solved'
    options = given.strategy()
    begin = time.process_time()
    try:
        found = solve(network, game, replace(options, time_limit=limit) if limit else options)
    except TimeLimit as error:
        if error.strategy is None:
            raise
        found, status = error.strategy, 'gap not closed'
    seconds = time.process_time() - begin
    np.savez(file, edges=np.flatnonzero(found.edge_probability > 0.0), value=found.value,
             length=found.expected_length, budget=found.length_budget, spacing=spacing)
    return {
        'seconds': seconds, 'status': status, 'nodes': len(network.points),
        'reach': given.reach, 'detour': given.detour, 'value': found.value, 'gap': found.gap,
        'route_entropy': found.route_entropy, 'entropy_gap': found.entropy_gap,
        'price': found.length_price, 'evaluations': found.iterations,
        'stages': dict(stages.seconds), 'path': ' '.join(stages.path),
    }


def _same(given: Problem, file: Path) -> tuple[Network, GameOptions]:
    with np.load(file) as saved:
        spacing = float(saved['spacing'])
    return given.network(), given.game(spacing)


def simplex(given: Problem, file: Path, limit: float) -> Answer:
    """The value with the length budget by HiGHS' dual simplex method."""
    return _highs(given, file, 'simplex', limit)


def interior_point(given: Problem, file: Path, limit: float) -> Answer:
    """The value with the length budget by HiGHS' interior point method without crossover."""
    return _highs(given, file, 'ipx', limit)


def _highs(given: Problem, file: Path, solver: str, limit: float) -> Answer:
    network, game = _same(given, file)
    with np.load(file) as saved:
        run = highs(network, game, float(saved['budget']), solver)
    signal.setitimer(signal.ITIMER_PROF, limit)
    return run()


def conic(given: Problem, file: Path, limit: float) -> Answer:
    """The route-entropy problem by Clarabel, within the strategy's own value and length."""
    network, game = _same(given, file)
    with np.load(file) as saved:
        entropy = EntropyProblem(saved['edges'], float(saved['value']), float(saved['length']))
    run = clarabel_entropy(network, game, entropy)
    signal.setitimer(signal.ITIMER_PROF, limit)
    return run()


TASKS = {task.__name__: task for task in (strategy, simplex, interior_point, conic)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('task', choices=TASKS, help='what is measured')
    parser.add_argument('problem', help='family:nodes:seed')
    parser.add_argument('file', type=Path, help='.npz in which `strategy` saves its problem')
    parser.add_argument('--reach', type=float, help="spacings, in place of the seed's")
    parser.add_argument('--detour', type=float, help="in place of the seed's")
    parser.add_argument('--ambushers', type=int, default=1)
    parser.add_argument('--stops', type=int, default=0)
    parser.add_argument('--limit', type=float, default=0.0, help='seconds; 0: no limit')
    given = parser.parse_args()
    warnings.simplefilter('ignore')
    # Native code does not return to Python's handlers; SIGPROF's default ends the process.
    problem = draw(given.problem, given.reach, given.detour, given.ambushers, given.stops)
    answer = TASKS[given.task](problem, given.file, given.limit)
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(json.dumps(answer | {'peak': peak}))


if __name__ == '__main__':
    main()

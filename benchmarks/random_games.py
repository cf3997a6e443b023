"""Random valid games of the kinds that users have: does any solve fail, and is each value right?

Ground (real terrain, a city, a maze, Nav2's depot, hills), start and goal, 500 to 5000 nodes, ways
to lay the network, budgets, reach, thresholds, slacks and ambushers are drawn from a seed of each
game's own: ``--first SEED --count 1`` plays one again. Up to 1500 nodes the value is held against
HiGHS' dual simplex method on the whole program, built here. Results go into results.md.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from grounds import GROUNDS, Ground
from maps import hills
from report import RESULTS, conditions, table, write_block
from scipy.optimize import linprog
from scipy.sparse import coo_matrix, csr_matrix, hstack, vstack

from ambush_planner import (
    AmbushPlannerError,
    BudgetInfeasible,
    GameOptions,
    GoalBlocked,
    Network,
    NetworkOptions,
    NoRoute,
    StartBlocked,
    Strategy,
    StrategyOptions,
    TimeLimit,
    build_network,
    solve,
)
from ambush_planner.game.strategy import CERTIFICATE_TOLERANCE

# Nodes up to which HiGHS judges, and how far it may be off: its own tolerances, relative.
JUDGED, AGREES = 1500, 1e-5
# Games that take longer than this are told [processor seconds].
SLOW = 30.0
# A strategy's routes that are looked at, for nodes that come twice.
ROUTES = 20
SITUATIONS = ('plain', 'detour', 'reach', 'reach and detour', 'several ambushers', 'exposure')


@dataclass(frozen=True, eq=False)
class Case:
    """A network, its options, and the words that tell them."""

    network: Network
    game: GameOptions
    strategy: StrategyOptions
    words: str


@dataclass
class Tally:
    """What became of the games."""

    games: int = 0
    judged: int = 0
    infeasible: int = 0
    failures: list[str] = field(default_factory=list)
    kinds: Counter[str] = field(default_factory=Counter)
    worst: tuple[float, str] = (0.0, '-')
    difference: tuple[float, str] = (0.0, '-')
    slowest: tuple[float, str] = (0.0, '-')
    seconds: list[float] = field(default_factory=list)


@cache
def ground(name: str) -> Ground:
    if name == 'hills':
        return Ground(hills(100), (3.0, 50.0), (97.0, 50.0))
    return GROUNDS[name]()


def available() -> list[str]:
    """Grounds whose maps are there."""
    names = []
    for name in ('terrain', 'city', 'maze', 'depot', 'hills'):
        try:
            ground(name)
            names.append(name)
        except FileNotFoundError as error:
            print(f'without {name}: {error}', file=sys.stderr)
    return names


def draw_case(seed: int, names: list[str]) -> Case | None:
    """A game of this seed; None where start and goal do not lie on the same free ground."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice(names))
    place = ground(name)
    start, goal = _ends(rng, place) if rng.random() < 0.5 else (place.start, place.goal)
    method = str(rng.choice(
        ['uniform_delaunay'] * 6
        + ['lattice_delaunay', 'uniform_grid8', 'random_delaunay', 'gradient_delaunay']
    ))
    nodes = int(math.exp(rng.uniform(math.log(500), math.log(5000))))
    options = NetworkOptions(method, target_nodes=nodes, seed=seed)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', UserWarning)
            network = build_network(place.risk_map, start, goal, options)
    except (NoRoute, StartBlocked, GoalBlocked):
        return None
    spacing = float(np.median(network.lengths))
    reach = spacing * float(rng.choice([0.0, 0.0, rng.uniform(0.3, 6.0)]))
    game = GameOptions(
        ambush_radius=reach,
        secured_radius=float(rng.choice([0.0, 2.0 * reach, spacing * rng.uniform(0.0, 6.0)])),
        alpha_threshold=float(rng.choice(
            [math.inf, math.inf, math.inf, np.quantile(network.alpha, rng.uniform(0.7, 0.99))]
        )),
        ambushers=int(rng.choice([1, 1, 1, 1, 1, 1, 2, 4])),
    )
    strategy = StrategyOptions(
        max_detour=float(rng.choice([
            1.0, 1.0 + 1e-9, 1.000001, 1.01, 1.05, 1.1, 1.2, 1.2, 1.2, 1.3, 1.5, 3.0, 1e6, math.inf,
            1.0 + rng.exponential(0.1),
        ])),
        max_exposure=float(rng.choice([math.inf] * 6 + [1.1, 1.3])),
        risk_slack=float(rng.choice([0.0, 0.001, 0.01, 0.01, 0.01, 0.05, 0.3])),
    )
    words = (
        f'seed {seed}: {name}, {method}, {len(network.points)} nodes, '
        f'reach {reach / spacing:.2g} spacings, secured {game.secured_radius / spacing:.2g}, '
        f'threshold {game.alpha_threshold:.3g}, ambushers {game.ambushers}, '
        f'detour {strategy.max_detour:.10g}, exposure {strategy.max_exposure:g}, '
        f'slack {strategy.risk_slack:g}'
    )
    return Case(network, game, strategy, words)


def _ends(
    rng: np.random.Generator, place: Ground
) -> tuple[tuple[float, float], tuple[float, float]]:
    free = np.argwhere(~place.risk_map.obstacles)
    cells = free[rng.choice(len(free), 2, replace=False)][:, ::-1]
    (x, y), (u, v) = place.risk_map.to_world(cells + 0.5).tolist()
    return (x, y), (u, v)


def highs_value(strategy: Strategy) -> float:
    """The least value by the whole program: minimise k t + sum s, losses_j <= t + s_j."""
    game = strategy.game
    network, edge = game.network, np.flatnonzero(game.playable)
    m, n, sites, k = len(edge), game.node_count, len(game.sites), game.ambushers
    tail, head = network.edges[edge].T
    column = np.arange(m)
    balance = coo_matrix(
        (np.repeat([1.0, -1.0], m), (np.concatenate((tail, head)), np.tile(column, 2))), (n, m)
    ).tocsr()
    supply = np.zeros(n)
    supply[network.source], supply[network.target] = 1.0, -1.0
    losses = csr_matrix(game.hits[:, edge].multiply(game.loss[game.sites][:, None]))
    several = sites if k > 1 else 0
    top = csr_matrix(-np.ones((sites, 1)))
    beyond = csr_matrix((-np.ones(several), (np.arange(several),) * 2), (sites, several))
    rows, limits = [hstack((losses, top, beyond))], [np.zeros(sites)]
    for cost, limit in (
        (network.lengths, strategy.length_budget),
        (network.edge_exposure, strategy.exposure_budget),
    ):
        if np.isfinite(limit):
            unit = limit or 1.0
            rows.append(csr_matrix(np.concatenate((cost[edge] / unit, np.zeros(1 + several)))))
            limits.append(np.array([limit / unit]))
    found = linprog(
        np.concatenate((np.zeros(m), [float(k)], np.ones(several))),
        vstack(rows), np.concatenate(limits),
        hstack((balance, csr_matrix((n, 1 + several)))), supply, method='highs-ds',
        options={'primal_feasibility_tolerance': 1e-10, 'dual_feasibility_tolerance': 1e-10},
    )
    if found.status != 0:
        raise ArithmeticError(f'HiGHS: {found.message}')
    return float(found.fun)


def play(case: Case, tally: Tally) -> None:
    """Solve, look at the strategy, and let HiGHS judge the small ones."""
    tally.games += 1
    begin = time.process_time()
    try:
        strategy = solve(case.network, case.game, case.strategy)
    except (BudgetInfeasible, NoRoute):
        tally.infeasible += 1  # a threshold forbids all short routes
        return
    except TimeLimit as error:
        found = error.strategy
        reached = f'{found.value:.6g} over {found.lower_bound:.6g}' if found else 'nothing'
        tally.failures.append(f'{case.words}: gap not closed: {reached}')
        return
    except AmbushPlannerError as error:
        tally.failures.append(f'{case.words}: {type(error).__name__}: {error}')
        return
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        tally.failures.append(f'{case.words}: {error!r} at {Path(place.filename).name}, '
                              f'line {place.lineno}')
        return
    seconds = time.process_time() - begin
    tally.seconds.append(seconds)
    tally.slowest = max(tally.slowest, (seconds, case.words))
    tally.kinds[situation(case, strategy)] += 1
    over = strategy.gap / strategy.value if strategy.value > 0.0 else 0.0
    excess = over / (1.0 - over) - case.strategy.risk_slack
    tally.worst = max(tally.worst, (excess, case.words))
    tally.failures += [f'{case.words}: {fault}' for fault in faults(case, strategy, tally)]


def faults(case: Case, strategy: Strategy, tally: Tally) -> list[str]:
    """What is wrong with a published strategy."""
    found = []
    value, bound = strategy.value, strategy.lower_bound
    if not bound <= value * (1.0 + 1e-9):
        found.append(f'bound {bound:.12g} above value {value:.12g}')
    if value > bound * (1.0 + case.strategy.risk_slack + 2.0 * CERTIFICATE_TOLERANCE):
        found.append(f'value {value:.9g} over slack and bound {bound:.9g}')
    if strategy.expected_length > strategy.length_budget * (1.0 + 1e-6):
        found.append('over the length budget')
    if strategy.expected_exposure > strategy.exposure_budget * (1.0 + 1e-6):
        found.append('over the exposure budget')
    for route in strategy.sample_routes(ROUTES, np.random.default_rng(0)):
        if len(np.unique(route)) != len(route):
            found.append('a route comes back to a node')
            break
    if len(case.network.points) <= JUDGED:
        tally.judged += 1
        found += _judged(case, strategy, tally)
    return found


def _judged(case: Case, strategy: Strategy, tally: Tally) -> list[str]:
    try:
        least = highs_value(strategy)
    except ArithmeticError as error:
        return [str(error)] if strategy.length_price == 0.0 else []
    value, bound = strategy.value, strategy.lower_bound
    # Budgets that hardly leave room: HiGHS' own tolerance on the length is worth this much.
    loose = 1e-8 * sum(
        price * budget
        for price, budget in (
            (strategy.length_price, strategy.length_budget),
            (strategy.exposure_price, strategy.exposure_budget),
        )
        if price > 0.0
    )
    room = AGREES * least + loose + 1e-9
    low = bound - room <= least
    high = value <= least * (1.0 + case.strategy.risk_slack) + room
    near = least <= value + room
    tally.difference = max(
        tally.difference, (max(bound - least - loose, 0.0) / max(least, 1e-12), case.words)
    )
    return [] if low and high and near else [
        f'HiGHS has {least:.9g}, value {value:.9g}, bound {bound:.9g}'
    ]


def situation(case: Case, strategy: Strategy) -> str:
    """Which of the kinds of game this is."""
    binds = strategy.length_price > 0.0
    if case.game.ambushers > 1:
        return 'several ambushers'
    if strategy.exposure_price > 0.0:
        return 'exposure'
    if case.game.ambush_radius > 0.0:
        return 'reach and detour' if binds else 'reach'
    return 'detour' if binds else 'plain'


def report(tally: Tally, first: int) -> str:
    """The tally as Markdown."""
    seconds = np.array(tally.seconds or [0.0])
    kinds = ', '.join(f'{tally.kinds[kind]} {kind}' for kind in SITUATIONS)
    rows = [
        ['games', f'{tally.games} (seeds from {first})'],
        ['**failures**', f'**{len(tally.failures)}**'],
        ['solved, by what raises the value', kinds],
        ['refused: no route within threshold and budgets', str(tally.infeasible)],
        ['values held against HiGHS', str(tally.judged)],
        ["bound above HiGHS' value at most by, relative", f'{tally.difference[0]:.1e}'],
        ['gap beyond the slack at most, relative', f'{tally.worst[0]:.1e}'],
        ['processor seconds: median, 99 %, largest',
         ', '.join(f'{s:.2f}' for s in (*np.quantile(seconds, [0.5, 0.99]), seconds.max()))],
        ['slowest', tally.slowest[1]],
    ]
    text = f"{table(('', ''), rows)}\n\n{conditions()}."
    return text + ''.join(f'\n* {failure}' for failure in tally.failures)


def show(case: Case, tally: Tally, failures: list[str], seconds: float, count: int) -> None:
    """Progress on standard error."""
    for failure in failures:
        print(f'FAILURE {failure}', file=sys.stderr, flush=True)
    if count == 1 or seconds > SLOW:
        print(f"{seconds:.1f} s, HiGHS' check included: {case.words}", file=sys.stderr)
    if tally.games % 10 == 0:
        print(f'{tally.games} games, {len(tally.failures)} failures', file=sys.stderr, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument('--count', type=int, default=2000, help='number of games')
    parser.add_argument('--first', type=int, default=0, help='seed of the first one')
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help='file whose block `random_games` is replaced'
    )
    options = parser.parse_args()
    names, tally = available(), Tally()
    seed = options.first
    while tally.games < options.count:
        case = draw_case(seed, names)
        seed += 1
        if case is not None:
            told, begin = len(tally.failures), time.process_time()
            play(case, tally)
            show(case, tally, tally.failures[told:], time.process_time() - begin, options.count)
    text = report(tally, options.first)
    print(text)
    write_block(options.results, 'random_games', text)
    sys.exit(1 if tally.failures else 0)


if __name__ == '__main__':
    main()

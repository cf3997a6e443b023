"""Random valid games as users have them: does any solve fail, and is each value right?

Map (real terrain, a city, a maze, Nav2's depot, hills), start and goal, 500 to 5000 nodes, network
method, budgets, reach, thresholds, slacks and ambushers are drawn from a seed of each game's own:
``--first SEED --count 1`` repeats a game. Up to 1500 nodes the value is checked by HiGHS' dual
simplex method on the whole program, built here.
"""

from __future__ import annotations

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
from report import conditions, new_parser, publish, table
from scenarios import SCENARIOS, Scenario, hills
from scipy.optimize import linprog
from scipy.sparse import coo_matrix, csr_matrix, hstack, vstack

from ambush_planner import (
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
    solve,
)
from ambush_planner.game.strategy import CERTIFICATE_TOLERANCE

# Largest number of nodes that HiGHS checks, and the relative tolerance of its value.
CHECKED_NODES, TOLERANCE = 1500, 1e-5
# With a reach, a value whose gap is open by ``counting_gap`` may be over HiGHS' by this much more
# than the slack: HiGHS counts entries, the bound counts hits, and no method here promises to find
# the optimum of either. The gap is published.
COUNTING_TOLERANCE = 0.01
# Games that take longer than this are reported [processor seconds].
SLOW = 30.0
# Number of routes checked for repeated nodes.
ROUTES = 20
MAPS = ('terrain', 'city', 'maze', 'depot', 'hills')
KINDS = ('plain', 'detour', 'reach', 'reach and detour', 'several ambushers', 'exposure')


@dataclass(frozen=True, eq=False)
class RandomGame:
    """A network, its options, and their description."""

    network: Network
    game: GameOptions
    strategy: StrategyOptions
    words: str


@dataclass
class Tally:
    """Results of all games so far."""

    games: int = 0
    checked: int = 0
    infeasible: int = 0
    failures: list[str] = field(default_factory=list)
    kinds: Counter[str] = field(default_factory=Counter)
    worst: tuple[float, str] = (0.0, '-')
    difference: tuple[float, str] = (0.0, '-')
    slowest: tuple[float, str] = (0.0, '-')
    seconds: list[float] = field(default_factory=list)


@cache
def scenario(name: str) -> Scenario:
    if name == 'hills':
        return Scenario(hills(100), (3.0, 50.0), (97.0, 50.0))
    return SCENARIOS[name]()


def draw_game(seed: int) -> RandomGame | None:
    """The game of this seed; None if its map is missing, or start and goal are not connected."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice(MAPS))
    try:
        chosen = scenario(name)
    except FileNotFoundError:
        return None
    if rng.random() < 0.5:
        chosen = _with_random_ends(rng, chosen)
    method = str(rng.choice(
        ['uniform_delaunay'] * 6
        + ['lattice_delaunay', 'uniform_grid8', 'random_delaunay', 'gradient_delaunay']
    ))
    nodes = int(math.exp(rng.uniform(math.log(500), math.log(5000))))
    options = NetworkOptions(method, target_nodes=nodes, seed=seed)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', UserWarning)
            network = chosen.network(options)
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
    return RandomGame(network, game, strategy, words)


def _with_random_ends(rng: np.random.Generator, chosen: Scenario) -> Scenario:
    free = np.argwhere(~chosen.risk_map.obstacles)
    cells = free[rng.choice(len(free), 2, replace=False)][:, ::-1]
    start, goal = map(tuple, chosen.risk_map.to_world(cells + 0.5).tolist())
    return Scenario(chosen.risk_map, start, goal)


def highs_value(strategy: Strategy) -> float:
    """The optimal value by the whole program: minimise k t + sum s, losses_j <= t + s_j."""
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


def play(game: RandomGame, tally: Tally) -> None:
    """Solve the game and check its strategy."""
    tally.games += 1
    begin = time.process_time()
    try:
        strategy = solve(game.network, game.game, game.strategy)
    except (BudgetInfeasible, NoRoute):
        tally.infeasible += 1  # the threshold forbids all short routes
        return
    except TimeLimit as error:
        found = error.strategy
        reached = f'{found.value:.6g} over {found.lower_bound:.6g}' if found else 'nothing'
        tally.failures.append(f'{game.words}: gap not closed: {reached}')
        return
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        tally.failures.append(f'{game.words}: {error!r} at {Path(place.filename).name}, '
                              f'line {place.lineno}')
        return
    seconds = time.process_time() - begin
    tally.seconds.append(seconds)
    tally.slowest = max(tally.slowest, (seconds, game.words))
    tally.kinds[kind_of(game, strategy)] += 1
    over = strategy.gap / strategy.value if strategy.value > 0.0 else 0.0
    excess = over / (1.0 - over) - game.strategy.risk_slack
    tally.worst = max(tally.worst, (excess, game.words))
    tally.failures += [f'{game.words}: {fault}' for fault in faults(game, strategy, tally)]


def faults(game: RandomGame, strategy: Strategy, tally: Tally) -> list[str]:
    """Everything that is wrong with a strategy."""
    found = []
    value, bound = strategy.value, strategy.lower_bound
    if not bound <= value * (1.0 + 1e-9):
        found.append(f'bound {bound:.12g} above value {value:.12g}')
    slack = game.strategy.risk_slack + 2.0 * CERTIFICATE_TOLERANCE
    if value > bound * (1.0 + slack) and not strategy.counting_gap:
        found.append(f'value {value:.9g} exceeds bound {bound:.9g} by more than the slack')
    if strategy.expected_length > strategy.length_budget * (1.0 + 1e-6):
        found.append('over the length budget')
    if strategy.expected_exposure > strategy.exposure_budget * (1.0 + 1e-6):
        found.append('over the exposure budget')
    for route in strategy.sample_routes(ROUTES, np.random.default_rng(0)):
        if len(np.unique(route)) != len(route):
            found.append('a route visits a node twice')
            break
    if len(game.network.points) <= CHECKED_NODES:
        tally.checked += 1
        found += _check_value(game, strategy, tally)
    return found


def _check_value(game: RandomGame, strategy: Strategy, tally: Tally) -> list[str]:
    try:
        least = highs_value(strategy)
    except ArithmeticError as error:
        return [str(error)] if strategy.length_price == 0.0 else []
    value, bound = strategy.value, strategy.lower_bound
    # Effect of HiGHS' feasibility tolerance on tight budgets.
    loose = 1e-8 * sum(
        price * budget
        for price, budget in (
            (strategy.length_price, strategy.length_budget),
            (strategy.exposure_price, strategy.exposure_budget),
        )
        if price > 0.0
    )
    margin = TOLERANCE * least + loose + 1e-9
    low = bound - margin <= least
    allowed = game.strategy.risk_slack + COUNTING_TOLERANCE * strategy.counting_gap
    high = value <= least * (1.0 + allowed) + margin
    # With a reach HiGHS counts every entry, and a route that comes back is hit only once.
    near = game.game.ambush_radius > 0.0 or least <= value + margin
    tally.difference = max(
        tally.difference, (max(bound - least - loose, 0.0) / max(least, 1e-12), game.words)
    )
    return [] if low and high and near else [
        f'HiGHS has {least:.9g}, value {value:.9g}, bound {bound:.9g}'
    ]


def kind_of(game: RandomGame, strategy: Strategy) -> str:
    """Which of the ``KINDS`` a game is."""
    binds = strategy.length_price > 0.0
    if game.game.ambushers > 1:
        return 'several ambushers'
    if strategy.exposure_price > 0.0:
        return 'exposure'
    if game.game.ambush_radius > 0.0:
        return 'reach and detour' if binds else 'reach'
    return 'detour' if binds else 'plain'


def report(tally: Tally, first: int) -> str:
    """The tally as Markdown."""
    seconds = np.array(tally.seconds or [0.0])
    kinds = ', '.join(f'{tally.kinds[kind]} {kind}' for kind in KINDS)
    rows = [
        ['games', f'{tally.games} (seeds from {first})'],
        ['**failures**', f'**{len(tally.failures)}**'],
        ['solved, by what raises the value', kinds],
        ['refused: no route within threshold and budgets', str(tally.infeasible)],
        ['values checked by HiGHS', str(tally.checked)],
        ["largest excess of a bound over HiGHS' value, relative", f'{tally.difference[0]:.1e}'],
        ['largest excess of a gap over the slack, relative', f'{tally.worst[0]:.1e}'],
        ['processor seconds: median, 99 %, largest',
         ', '.join(f'{s:.2f}' for s in (*np.quantile(seconds, [0.5, 0.99]), seconds.max()))],
        ['slowest', tally.slowest[1]],
    ]
    text = f"{table(('', ''), rows)}\n\n{conditions()}."
    return text + ''.join(f'\n* {failure}' for failure in tally.failures)


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--count', type=int, default=2000, help='number of games')
    parser.add_argument('--first', type=int, default=0, help='seed of the first one')
    options = parser.parse_args()
    tally, seed = Tally(), options.first
    while tally.games < options.count:
        game = draw_game(seed)
        seed += 1
        if game is None:
            continue
        shown, begin = len(tally.failures), time.process_time()
        play(game, tally)
        seconds = time.process_time() - begin
        for failure in tally.failures[shown:]:
            print(f'FAILURE {failure}', file=sys.stderr, flush=True)
        if options.count == 1 or seconds > SLOW:
            print(f"{seconds:.1f} s including HiGHS' check: {game.words}", file=sys.stderr)
        if tally.games % 10 == 0:
            print(f'{tally.games} games, {len(tally.failures)} failures', file=sys.stderr)
    publish(options.results, 'random_games', report(tally, options.first))
    sys.exit(1 if tally.failures else 0)


if __name__ == '__main__':
    main()

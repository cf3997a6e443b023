# SPDX-License-Identifier: Apache-2.0
"""Random valid games as users have them: does any fail, and is what is published right?

Maps, networks, trips, roads, reaches, secured areas, budgets and thresholds are drawn
from a seed of each game's own: ``--first SEED --count 1`` repeats a game. All strategies are
checked by invariants. Up to ``CHECKED`` nodes, values are computed again by geometry and recursions
that are not the package's (test/games.py), and bounds are compared with HiGHS' dual simplex method.
"""

from __future__ import annotations

import math
import sys
import time
import traceback
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from families import FAMILIES, draw
from games import (
    hit_once,
    is_acyclic,
    may_wait,
    meets,
    neighbours,
    standing_places,
    unbalanced,
    value_lp,
)
from peers import highs
from report import conditions, new_parser, publish, quantiles, table
from scenarios import Scenario
from scipy.sparse import csr_matrix

from ambush_planner import (
    BudgetInfeasible,
    GameOptions,
    GoalBlocked,
    InvalidNetwork,
    Network,
    NetworkOptions,
    NoRoute,
    PlanningOptions,
    StartBlocked,
    StopBlocked,
    Strategy,
    StrategyOptions,
    TimeLimit,
    build_network,
    plan_trip,
    solve,
)

CHECKED = 1000  # nodes
SAME = 1e-6  # relative difference of values that are computed twice
LOOSE = 1e-5  # relative tolerance of HiGHS, and of the budget
ROUTES = 20  # drawn from each strategy
LIMIT = 60.0  # for a game [s]; what has been found by then is checked, too
SLOW = 30.0  # games that are printed [processor seconds]
NODES = 150, 3000
METHODS = ('uniform_delaunay',) * 6 + (
    'lattice_delaunay', 'uniform_grid8', 'random_delaunay', 'gradient_delaunay')
DETOURS = (1.0, 1.0 + 1e-9, 1.000001, 1.01, 1.05, 1.1, 1.2, 1.2, 1.5, 3.0, 1e6, math.inf)
NO_GAME = NoRoute, StartBlocked, StopBlocked, GoalBlocked, InvalidNetwork


@dataclass(frozen=True, eq=False)
class RandomGame:
    """A network or, for a plan, a map; options; and what was drawn in words."""

    kind: str
    network: Network
    options: PlanningOptions
    words: str
    scenario: Scenario | None = None
    stops: tuple[tuple[float, float], ...] = ()

    def solved(self) -> Strategy:
        if self.scenario is None:
            return solve(self.network, self.options.game, self.options.strategy)
        return plan_trip(self.scenario.risk_map, self.scenario.start, self.scenario.goal,
                         self.options, stops=self.stops).strategy


@dataclass
class Tally:
    """Results of all games so far: (seconds, gap over the slack, words) by kind."""

    solved: dict[str, list[tuple[float, float, str]]] = field(
        default_factory=lambda: defaultdict(list))
    counts: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)


def draw_game(seed: int) -> RandomGame | None:
    """The game of this seed; None if its places are not connected."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(['nodes'] * 6 + ['trip', 'roads', 'plan', 'plan']))
    nodes = int(math.exp(rng.uniform(*np.log(NODES))))
    if kind == 'roads':
        network = roads(rng, nodes)
        options = drawn_options(rng, network, NetworkOptions())
        return RandomGame(kind, network, options, words_of(seed, kind, network, options))
    if kind == 'trip':
        nodes //= 3  # in each layer
    problem = draw(f'{kind}:{rng.choice(list(FAMILIES))}:{nodes}:{seed}')
    chosen, stops = problem.scenario, problem.stops
    built = replace(problem.options.network, method=str(rng.choice(METHODS)), seed=seed,
                    refine=None)
    try:
        network = build_network(chosen.risk_map, chosen.start, chosen.goal, built, stops)
    except NO_GAME:
        return None
    options = drawn_options(rng, network, built)
    planned = kind == 'plan' or len(stops) > 2
    return RandomGame(kind, network, options, words_of(seed, kind, network, options),
                      chosen if planned else None, stops)


def roads(rng: np.random.Generator, nodes: int) -> Network:
    """Streets between random junctions, some of them one way, and a few bridges over others."""
    points = rng.uniform(0.0, math.sqrt(nodes), (nodes, 2))
    pairs = neighbours(points)
    pairs = pairs[rng.random(len(pairs)) < 0.8]
    bridges = np.sort(rng.integers(0, nodes, (nodes // 50, 2)))
    pairs = np.unique(np.vstack((pairs, bridges[bridges[:, 0] < bridges[:, 1]])), axis=0)
    edges = np.vstack((pairs, pairs[rng.random(len(pairs)) < 0.8][:, ::-1]))
    source, target = int(points[:, 0].argmin()), int(points[:, 0].argmax())
    alpha = rng.choice([0.0, 1.0, 1.0, 2.0, 5.0], nodes)
    alpha[[source, target]] = 0.0
    return Network(points, alpha, edges, source, target)


def drawn_options(rng: np.random.Generator, network: Network,
                  network_options: NetworkOptions) -> PlanningOptions:
    spacing = float(np.median(network.lengths))
    reach = spacing * float(rng.choice([0.0, 0.0, rng.uniform(0.3, 6.0)]))
    secured = float(rng.choice([0.0, -1.0, 2.0 * reach, spacing * rng.uniform(0.0, 6.0), 1e9],
                            p=[0.25, 0.25, 0.25, 0.22, 0.03]))
    above = float(np.quantile(network.alpha, rng.uniform(0.7, 0.99)))
    game = GameOptions(ambush_radius=reach, secured_radius=None if secured < 0.0 else secured,
                       alpha_threshold=float(rng.choice([math.inf] * 3 + [above])))
    strategy = StrategyOptions(
        max_detour=float(rng.choice([*DETOURS, 1.0 + rng.exponential(0.1)])),
        risk_slack=float(rng.choice([0.0, 0.001, 0.01, 0.01, 0.01, 0.05, 0.3])),
        time_limit=LIMIT)
    options = PlanningOptions(network=network_options, game=game, strategy=strategy)
    return replace(options, drive=replace(options.drive, tube=0.0))


def words_of(seed: int, kind: str, network: Network, options: PlanningOptions) -> str:
    game, strategy, spacing = options.game, options.strategy, float(np.median(network.lengths))
    return (f'seed {seed}: {kind} {options.network.method} {len(network.points)} nodes, '
            f'reach {game.ambush_radius / spacing:.2g} spacings, secured '
            f'{game.secured_distance / spacing:.2g}, threshold {game.alpha_threshold:.3g}, '
            f'detour {strategy.max_detour:.10g}, slack {strategy.risk_slack:g}')


def play(game: RandomGame, tally: Tally) -> None:
    """Solve the game and check its strategy."""
    begin = time.process_time()
    try:
        strategy = game.solved()
    except (BudgetInfeasible, *NO_GAME):
        tally.counts['refused'] += 1  # the threshold forbids all short routes
        return
    except TimeLimit as error:
        tally.counts['late'] += 1
        if error.strategy is None:
            return
        strategy = error.strategy
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        tally.failures.append(f'{game.words}: {error!r} at {Path(place.filename).name}, '
                              f'line {place.lineno}')
        return
    seconds = time.process_time() - begin
    gap = strategy.value / max(strategy.lower_bound, 1e-300) - 1.0 if strategy.value else 0.0
    over = max(gap - game.options.strategy.risk_slack, 0.0)
    tally.solved[kind_of(game)].append((seconds, over, game.words))
    tally.failures += [f'{game.words}: {fault}' for fault in faults(game, strategy, tally)]


def kind_of(game: RandomGame) -> str:
    return f"{game.kind}, {'a' if game.options.game.ambush_radius > 0.0 else 'no'} reach"


def faults(game: RandomGame, strategy: Strategy, tally: Tally) -> Iterator[str]:
    """Everything that is wrong with a strategy."""
    network, p = strategy.network, strategy.edge_probability
    if p.min() < 0.0 or unbalanced(network, p) > SAME:
        yield f'no unit flow: least {p.min()}, unbalanced by {unbalanced(network, p)}'
    if not is_acyclic(network, p):
        yield 'it has a cycle'
        return
    if strategy.lower_bound > strategy.value * (1.0 + 1e-9):
        yield f'bound {strategy.lower_bound:.12g} above value {strategy.value:.12g}'
    mean, budget = strategy.expected_length, strategy.length_budget
    if mean > budget * (1.0 + LOOSE):
        yield f'length {mean:.12g} over the budget {budget:.12g}'
    used = set(map(tuple, network.edges[p > 0.0].tolist()))
    for route in strategy.sample_routes(ROUTES, np.random.default_rng(0)):
        nodes = route.tolist()
        ends = nodes[0] == network.source and nodes[-1] == network.target
        if not ends or len(set(nodes)) != len(nodes) or not used.issuperset(pairwise(nodes)):
            yield 'a drawn route is none of the strategy'
    if len(network.points) <= CHECKED:
        tally.counts['checked'] += 1
        yield from wrong_values(game, strategy)


def geometric_hits(network: Network, radius: float, secured: float | None = None) -> csr_matrix:
    """(N, M): edges that bring a route into the disc of a node; secured: as far as that."""
    secured = radius if secured is None else secured
    near = meets(network, network.points, radius, secured)
    apart = np.linalg.norm(network.points[:, None] - network.points, axis=2)
    exposed = (apart[:, network.ends] > secured).all(axis=1) | (secured == 0.0)
    exposed[network.source] = False
    before = (apart <= radius)[:, network.tails] & exposed[network.tails]
    return csr_matrix((near & ~before & may_wait(network, secured)[:, None]).astype(float))


def wrong_values(game: RandomGame, strategy: Strategy) -> Iterator[str]:
    """Compare value and bound with what geometry, recursion and HiGHS find."""
    network, value, options = strategy.network, strategy.value, game.options.game
    p, reach, secured = strategy.edge_probability, options.ambush_radius, options.secured_distance
    _, site = np.unique(network.points, axis=0, return_index=True)
    at_end = (network.points[:, None] == network.points[network.ends]).all(axis=2).any(axis=1)
    site = site[(may_wait(network, secured) & ~at_end)[site]]
    if reach > 0.0:
        hits = meets(network, network.points[site], reach, secured)
        entries = geometric_hits(network, reach, secured)[site]
    else:
        hits = (network.points[network.heads] == network.points[site][:, None]).all(axis=2)
        entries = csr_matrix(hits.astype(float))
    own = (network.alpha[site] * hit_once(network, p, hits)).max(initial=0.0)
    anywhere = game.scenario is not None and reach > 0.0
    if anywhere and game.scenario:
        points, alpha = standing_places(game.scenario.risk_map, network, secured)
        hits = meets(network, points, reach, secured)
        own = max(own, (alpha * hit_once(network, p, hits)).max(initial=0.0))
    rounding = SAME**2 * float(network.alpha.max())
    if own > value * (1.0 + SAME) + rounding or (
            not anywhere and value > own * (1.0 + SAME) + rounding):
        yield f'value {value:.9g}, computed again {own:.9g}'
    if anywhere:  # the bound is that of larger discs, also around places nearer to the secured area
        site, entries = strategy.game.sites, strategy.game.entering
    usable = (network.alpha <= options.alpha_threshold)[network.edges].all(axis=1)
    found = highs(value_lp(
        network, csr_matrix(entries.multiply(network.alpha[site][:, None])),
        [(network.travel_costs, strategy.length_budget)], usable),
        primal_feasibility_tolerance=1e-10, dual_feasibility_tolerance=1e-10)
    # HiGHS counts entries, so its value is the optimum only if no site is entered twice.
    least = found.get('value', value)
    if strategy.lower_bound > least * (1.0 + LOOSE) + 1e-9:
        yield f'bound {strategy.lower_bound:.9g} above {least:.9g} by HiGHS'
    if reach == 0.0 and not game.stops and value * (1.0 + LOOSE) + 1e-9 < least:
        yield f'value {value:.9g} below {least:.9g} by HiGHS'


def report(tally: Tally, first: int, games: int) -> str:
    rows = []
    for kind, results in sorted(tally.solved.items()):
        seconds, over, _ = zip(*results, strict=True)
        rows.append([kind, str(len(results)), quantiles(seconds),
                     f'{np.mean(np.array(over) <= 1e-4):.0%}', f'{100.0 * max(over):.2g}'])
    slowest = max(result for each in tally.solved.values() for result in each)
    head = ('', 'games', 'seconds: median / 95 % / worst', 'within the slack', 'most over it [%]')
    return (f"{games} games, seeds from {first}, {tally.counts['refused']} of them without a route "
            f"within threshold and budget, {tally.counts['late']} ended by the limit of "
            f"{LIMIT:g} s, {tally.counts['checked']} checked by recursion and HiGHS: "
            f"**{len(tally.failures)} failures**. {conditions('highspy')}.\n\n"
            f'{table(head, rows)}\n\nThe slowest: {slowest[2]}.'
            + ''.join(f'\n* {failure}' for failure in tally.failures))


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument('--count', type=int, default=2000, help='number of games')
    parser.add_argument('--first', type=int, default=0, help='seed of the first one')
    options = parser.parse_args()
    warnings.simplefilter('ignore', UserWarning)
    tally, seed, games = Tally(), options.first, 0
    while games < options.count:
        game, seed = draw_game(seed), seed + 1
        if game is None:
            continue
        games, shown, begin = games + 1, len(tally.failures), time.process_time()
        play(game, tally)
        for failure in tally.failures[shown:]:
            print(f'FAILURE {failure}', file=sys.stderr, flush=True)
        if options.count == 1 or time.process_time() - begin > SLOW:
            print(f'{time.process_time() - begin:.1f} s with checks: {game.words}', file=sys.stderr)
        if games % 50 == 0:
            print(f'{games} games, {len(tally.failures)} failures', file=sys.stderr)
    publish(options.results, 'random_games', report(tally, options.first, games))
    sys.exit(1 if tally.failures else 0)


if __name__ == '__main__':
    main()

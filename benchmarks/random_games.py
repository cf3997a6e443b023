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
    flow_value,
    hit_once,
    is_acyclic,
    may_wait,
    meets,
    neighbours,
    standing_places,
    unbalanced,
)
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
    plan_trip,
)
from ambush_planner.game.game import make_games
from ambush_planner.game.solver import solve_legs
from ambush_planner.game.strategy import TripStrategy
from ambush_planner.network.construction import build_trip_graph

CHECKED = 1000  # nodes
SAME = 1e-6  # relative difference of values that are computed twice
LOOSE = 1e-5  # relative tolerance of HiGHS, and of the budget
ROUTES = 20  # drawn from each strategy
LIMIT = 60.0  # for a game [s]; what has been found by then is checked, too
NODES = 150, 3000
METHODS = ('uniform_delaunay',) * 6 + (
    'lattice_delaunay', 'uniform_grid8', 'random_delaunay', 'gradient_delaunay')
DETOURS = (1.0, 1.0 + 1e-9, 1.000001, 1.01, 1.05, 1.1, 1.2, 1.2, 1.5, 3.0, 1e6, math.inf)
KINDS = ('nodes',) * 6 + ('trip', 'roads', 'plan', 'plan', 'road trip')
NO_GAME = NoRoute, StartBlocked, StopBlocked, GoalBlocked, InvalidNetwork


@dataclass(frozen=True, eq=False)
class RandomGame:
    """The networks of legs or, for a plan, a map; options; and what was drawn in words."""

    kind: str
    networks: tuple[Network, ...]
    options: PlanningOptions
    words: str
    scenario: Scenario | None = None
    stops: tuple[tuple[float, float], ...] = ()

    def solved(self) -> TripStrategy:
        if self.scenario is None:
            return solve_legs(make_games(self.networks, self.options.game), self.options.strategy)
        return plan_trip(self.scenario.risk_map, self.scenario.start, self.scenario.goal,
                         self.options, stops=self.stops).trip


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
    kind = str(rng.choice(KINDS))
    nodes = int(math.exp(rng.uniform(*np.log(NODES))))
    if 'trip' in kind:
        nodes //= 3
    if 'road' in kind:
        networks = roads(rng, nodes, int(rng.integers(1, 5)) if kind == 'road trip' else 0)
        options = drawn_options(rng, networks[0], NetworkOptions())
        return RandomGame(kind, networks, options, words_of(seed, kind, networks, options))
    problem = draw(f'{kind}:{rng.choice(list(FAMILIES))}:{nodes}:{seed}')
    chosen, stops = problem.scenario, problem.stops
    built = replace(problem.options.network, method=str(rng.choice(METHODS)), seed=seed,
                    refine=None)
    try:
        networks = build_trip_graph(chosen.risk_map, chosen.start, chosen.goal, built,
                                    stops).networks()
    except NO_GAME:
        return None
    options = drawn_options(rng, networks[0], built)
    planned = kind == 'plan' or len(stops) > 2
    return RandomGame(kind, networks, options, words_of(seed, kind, networks, options),
                      chosen if planned else None, stops)


def roads(rng: np.random.Generator, nodes: int, stops: int) -> tuple[Network, ...]:
    """Streets between random junctions, some of them one way, and a few bridges over others.

    With a trip from west to east on them through some stops.
    """
    points = rng.uniform(0.0, math.sqrt(nodes), (nodes, 2))
    pairs = neighbours(points)
    pairs = pairs[rng.random(len(pairs)) < 0.8]
    bridges = np.sort(rng.integers(0, nodes, (nodes // 50, 2)))
    pairs = np.unique(np.vstack((pairs, bridges[bridges[:, 0] < bridges[:, 1]])), axis=0)
    edges = np.vstack((pairs, pairs[rng.random(len(pairs)) < 0.8][:, ::-1]))
    order = points[:, 0].argsort()
    ends = [int(order[0]), *rng.choice(order[1:-1], stops, replace=False).tolist(), int(order[-1])]
    alpha = rng.choice([0.0, 1.0, 1.0, 2.0, 5.0], nodes)
    alpha[ends] = 0.0
    return tuple(Network(points, alpha, edges, one, other) for one, other in pairwise(ends))


def drawn_options(rng: np.random.Generator, network: Network,
                  network_options: NetworkOptions) -> PlanningOptions:
    spacing = float(np.median(network.lengths))
    reach = spacing * float(rng.choice([0.0, 0.0, rng.uniform(0.3, 6.0)]))
    secured = float(rng.choice([0.0, -1.0, 2.0 * reach, spacing * rng.uniform(0.0, 6.0), 1e6],
                            p=[0.25, 0.25, 0.25, 0.22, 0.03]))
    above = float(np.quantile(network.alpha, rng.uniform(0.7, 0.99)))
    game = GameOptions(ambush_radius=reach, secured_radius=None if secured < 0.0 else secured,
                       alpha_threshold=float(rng.choice([math.inf] * 3 + [above])))
    strategy = StrategyOptions(
        max_detour=float(rng.choice([*DETOURS, 1.0 + rng.exponential(0.1)])),
        risk_slack=float(rng.choice([0.0, 0.001, 0.01, 0.01, 0.01, 0.05, 0.3])),
        time_limit=LIMIT)
    options = PlanningOptions(network=network_options, game=game, strategy=strategy,
                              max_gap=math.inf)
    return replace(options, drive=replace(options.drive, tube=0.0))


def words_of(seed: int, kind: str, networks: tuple[Network, ...],
             options: PlanningOptions) -> str:
    game, strategy, spacing = options.game, options.strategy, float(np.median(networks[0].lengths))
    return (f'seed {seed}: {kind} {options.network.method} {len(networks[0].points)} nodes, '
            f'reach {game.ambush_radius / spacing:.2g} spacings, secured '
            f'{game.secured_distance / spacing:.2g}, threshold {game.alpha_threshold:.3g}, '
            f'detour {strategy.max_detour:.10g}, slack {strategy.risk_slack:g}, '
            f'{len(networks)} legs')


def play(game: RandomGame, tally: Tally) -> None:
    """Solve the game and check its strategies."""
    begin = time.process_time()
    try:
        trip = game.solved()
    except (BudgetInfeasible, *NO_GAME):
        tally.counts['refused'] += 1  # the threshold forbids all short routes
        return
    except TimeLimit:
        tally.counts['late'] += 1
        return
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        tally.failures.append(f'{game.words}: {error!r} at {Path(place.filename).name}, '
                              f'line {place.lineno}')
        return
    seconds = time.process_time() - begin
    tally.counts['late'] += trip.reason == 'time'
    gap = trip.value / max(trip.lower_bound, 1e-300) - 1.0 if trip.value else 0.0
    over = max(gap - game.options.strategy.risk_slack, 0.0)
    reach = 'a' if game.options.game.ambush_radius > 0.0 else 'no'
    tally.solved[f'{game.kind}, {reach} reach'].append((seconds, over, game.words))
    tally.failures += [f'{game.words}: {fault}' for fault in faults(game, trip, tally)]


def faults(game: RandomGame, trip: TripStrategy, tally: Tally) -> Iterator[str]:
    """Everything that is wrong with strategies."""
    if trip.lower_bound > trip.value * (1.0 + 1e-9):
        yield f'bound {trip.lower_bound:.12g} above value {trip.value:.12g}'
    for leg in trip.legs:
        network, p = leg.network, leg.edge_probability
        if p.min() < 0.0 or unbalanced(network, p) > SAME:
            yield f'no unit flow: least {p.min()}, unbalanced by {unbalanced(network, p)}'
        if not is_acyclic(network, p) and leg.mixture is None:
            yield 'it has a cycle'
            return
        mean, budget = leg.expected_length, leg.length_budget
        if mean > budget * (1.0 + LOOSE):
            yield f'length {mean:.12g} over the budget {budget:.12g}'
        used = set(map(tuple, network.edges[p > 0.0].tolist()))
        for route in leg.sample_routes(ROUTES, np.random.default_rng(0)):
            nodes = route.tolist()
            ends = nodes[0] == network.source and nodes[-1] == network.target
            if not ends or len(set(nodes)) != len(nodes) or not used.issuperset(pairwise(nodes)):
                yield 'a drawn route is none of the strategy'
    if trip.game.node_count <= CHECKED:
        tally.counts['checked'] += 1
        yield from wrong_values(game, trip)


def met_by(leg: Strategy, hits: np.ndarray) -> np.ndarray:
    """How likely each of some places is met, by ``hits`` (S, M) of the edges."""
    if leg.mixture is None:
        return hit_once(leg.network, leg.edge_probability, hits)
    return sum(share * hits[:, route].any(axis=1)
               for route, share in zip(leg.mixture.routes, leg.mixture.shares, strict=True))


def geometric_hits(network: Network, radius: float, secured: float,
                   others: tuple[int, ...]) -> csr_matrix:
    """(N, M): edges that bring a route into the disc of a node that is not secured."""
    near = meets(network, network.points, radius, secured, others)
    apart = np.linalg.norm(network.points[:, None] - network.points, axis=2)
    ends = [network.source, network.target, *others]
    exposed = (apart[:, ends] > secured).all(axis=1) | (secured == 0.0)
    exposed[network.source] = False
    before = (apart <= radius)[:, network.tails] & exposed[network.tails]
    waits = may_wait(network, secured, others)[:, None]
    return csr_matrix((near & ~before & waits).astype(float))


def wrong_values(game: RandomGame, trip: TripStrategy) -> Iterator[str]:
    """Compare value and bound with what geometry, recursion and HiGHS find."""
    networks, value, options = [leg.network for leg in trip.legs], trip.value, game.options.game
    reach, secured, alpha = options.ambush_radius, options.secured_distance, networks[0].alpha
    visits = tuple(np.unique([(each.source, each.target) for each in networks]).tolist())
    _, site = np.unique(networks[0].points, axis=0, return_index=True)
    site = np.setdiff1d(site[may_wait(networks[0], secured, visits)[site]], visits)
    anywhere = game.scenario is not None and reach > 0.0
    own, entries, more = np.zeros(len(site)), [], np.zeros(0)
    if anywhere and game.scenario:
        points, loss = standing_places(game.scenario.risk_map, networks[0], secured, others=visits)
        more = np.zeros(len(points))
    for leg, network in zip(trip.legs, networks, strict=True):
        if reach > 0.0:
            hits = meets(network, network.points[site], reach, secured, visits)
            entries.append(geometric_hits(network, reach, secured, visits)[site])
        else:
            hits = network.heads == site[:, None]
            entries.append(csr_matrix(hits.astype(float)))
        own += alpha[site] * met_by(leg, hits)
        if anywhere:
            more += loss * met_by(leg, meets(network, points, reach, secured, visits))
    again = max(float(own.max(initial=0.0)), float(more.max(initial=0.0)))
    rounding = SAME**2 * float(alpha.max())
    if again > value * (1.0 + SAME) + rounding or (
            not anywhere and value > again * (1.0 + SAME) + rounding):
        yield f'value {value:.9g}, computed again {again:.9g}'
    if anywhere:  # the bound is that of larger discs, also around places nearer to the secured area
        site, entries = trip.game.sites, [leg.game.entering for leg in trip.legs]
    usable = [(each.alpha <= options.alpha_threshold)[each.edges].all(axis=1) for each in networks]
    least = flow_value(networks, [csr_matrix(each.multiply(alpha[site][:, None]))
                                  for each in entries],
                       [leg.length_budget for leg in trip.legs], usable)
    least = value if least is None else least  # HiGHS ended in an unknown state
    # HiGHS counts entries, so its value is the optimum only if no site is entered twice.
    if trip.lower_bound > least * (1.0 + LOOSE) + 1e-9:
        yield f'bound {trip.lower_bound:.9g} above {least:.9g} by HiGHS'
    if reach == 0.0 and value * (1.0 + LOOSE) + 1e-9 < least:
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
        games, shown = games + 1, len(tally.failures)
        play(game, tally)
        for failure in tally.failures[shown:]:
            print(f'FAILURE {failure}', file=sys.stderr, flush=True)
        if games % 50 == 0:
            print(f'{games} games, {len(tally.failures)} failures', file=sys.stderr)
    publish(options.results, 'random_games', report(tally, options.first, games))
    sys.exit(1 if tally.failures else 0)


if __name__ == '__main__':
    main()

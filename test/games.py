# SPDX-License-Identifier: Apache-2.0
"""Random ambush games and slow, independent oracles for them.

The suites are deterministic. ``HUNT=20 pytest ...`` runs twenty times as many, random examples.
"""

import os
import warnings
from collections.abc import Sequence
from fractions import Fraction
from itertools import islice, pairwise

import networkx
import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.sparse import block_diag, coo_matrix, csr_matrix, hstack, vstack
from scipy.spatial import ConvexHull, Delaunay, cKDTree

from ambush_planner import (
    GameOptions,
    Network,
    NetworkOptions,
    NoRoute,
    PlanningOptions,
    RiskMap,
    StrategyOptions,
    build_network,
)
from ambush_planner.network import construction

METHODS = tuple(each for each in construction.METHODS if each != 'graph')
PLAIN = (0.5, 1.0, 2.0, 3.0, 7.0)
WITH_ZERO = (0.0, *PLAIN)
NASTY = (0.0, 1e-9, 1e-6, 1e-3, 1.0, 1.0 / 3.0, 1e3, 1e6, 1e9)


HUNT = int(os.environ.get('HUNT', '1'))


def examples(count: int) -> settings:
    """Hypothesis' settings for ``count`` examples in CI."""
    return settings(max_examples=count * HUNT, derandomize='HUNT' not in os.environ, database=None,
                    deadline=None, suppress_health_check=[HealthCheck.too_slow])


@st.composite
def networks(draw, alphas=WITH_ZERO, max_nodes=9):
    """Networks of any shape with a route: loops, dead ends, corridors, s next to t, two nodes."""
    n = draw(st.integers(2, max_nodes))
    place = st.tuples(st.integers(0, 6), st.integers(0, 6))
    points = draw(st.lists(place, min_size=n, max_size=n, unique=True))
    alpha = [0.0, *draw(st.lists(st.sampled_from(alphas), min_size=n - 2, max_size=n - 2)), 0.0]
    pairs = [(i, j) for i in range(n - 1) for j in range(1, n) if i != j]
    edges = draw(st.sets(st.sampled_from(pairs), max_size=4 * n))
    inner = draw(st.permutations(range(1, n - 1)))[: draw(st.integers(0, n - 2))]
    route = [0, *inner, n - 1]
    edges |= set(zip(route[:-1], route[1:], strict=True))
    return Network(np.array(points, float), np.array(alpha), np.array(sorted(edges)), 0, n - 1)


def random_map(seed: int, cells: int = 12, obstacles: float = 0.15, yaw: float = 0.0) -> RiskMap:
    """A smooth map of losses 1..10 with scattered single obstacle cells."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0:cells, 0:cells] / cells
    waves = rng.normal(size=(4, 3))
    height = sum(np.sin(3.0 * a * u + 3.0 * b * v + c) for a, b, c in waves)
    alpha = 1.0 + 9.0 * (height - height.min()) / np.ptp(height)
    return RiskMap(alpha, rng.random((cells, cells)) < obstacles, 1.0, (3.0, -2.0, yaw))


def terrain_network(seed: int, method: str = 'uniform_delaunay', cells: int = 12) -> Network:
    """A network on a random map; tries further seeds until there is a route."""
    while True:
        risk_map = random_map(seed, cells, obstacles=0.08)
        free = np.argwhere(~risk_map.obstacles)
        column = free[:, 1]
        start, goal = free[np.argmin(column)], free[np.argmax(column)]
        ends = risk_map.to_world(np.array([start, goal])[:, ::-1] + 0.5)
        try:
            return build_network(risk_map, *ends,
                                 NetworkOptions(method=method, spacing=1.3, seed=seed))
        except NoRoute:
            seed += 1_000_003


def ground(seed: int, kind: str, cells: int = 40) -> tuple[RiskMap, tuple, tuple]:
    """Hills, a city or a maze, with a start on the left and a goal on the right."""
    rng = np.random.default_rng(seed)
    alpha = random_map(seed, cells, 0.0).alpha
    obstacles = np.zeros((cells, cells), bool)
    rows, columns = np.mgrid[0:cells, 0:cells]
    if kind == 'city':
        obstacles = (rows % 7 > 2) & (columns % 9 > 2) & (rng.random((cells, cells)) < 0.97)
    elif kind == 'maze':
        obstacles = columns % 5 == 4
        for wall in range(4, cells, 5):
            for door in rng.integers(0, cells - 4, 2):
                obstacles[door : door + 4, wall] = False
    obstacles[:, [0, -1]] = False
    start, goal = (0.5, rng.uniform(5, cells - 5)), (cells - 0.5, rng.uniform(5, cells - 5))
    return RiskMap(alpha, obstacles, 1.0), start, goal


def two_pairs_of_gates() -> tuple[RiskMap, tuple, tuple, PlanningOptions]:
    """A wall with two gates, one with a pass, and another with two gates; start, goal, options."""
    alpha, obstacles = np.full((40, 60), 0.5), np.zeros((40, 60), bool)
    alpha[:, 26:34] = 0.05
    for column, gates in ((25, (8, 31)), (30, (20,)), (35, (8, 31))):
        obstacles[:, column] = True
        obstacles[gates, column] = False
        alpha[gates, column] = 4.0 if len(gates) > 1 else 0.05
    options = PlanningOptions(game=GameOptions(ambush_radius=11.0, secured_radius=0.0),
                              strategy=StrategyOptions(max_detour=1.5))
    return RiskMap(alpha, obstacles, 1.0), (5.0, 20.0), (55.0, 20.0), options


def plain_options(**options) -> NetworkOptions:
    """Options of networks that plans do not refine: tests of something else are quick on them."""
    return NetworkOptions(refine=0, **options)


terrain_networks = st.builds(terrain_network, st.integers(0, 10**6), st.sampled_from(METHODS),
                             st.integers(5, 10))


def neighbours(points: np.ndarray) -> np.ndarray:
    """The pairs (K, 2) of points that Delaunay's triangulation joins, sorted."""
    corners = Delaunay(points).simplices
    sides = np.concatenate([corners[:, [k - 1, k]] for k in range(3)])
    return np.unique(np.sort(sides, axis=1), axis=0)


def planar_network(seed: int, inside: bool = False) -> Network:
    """Delaunay's edges between a few random points, both ways; source and target on the hull.

    Or anywhere if ``inside``, and a fifth of the edges are missing.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 4, (rng.integers(8, 12), 2))
    pairs = neighbours(points)
    hull = np.unique(ConvexHull(points).vertices)
    apart = np.linalg.norm(points[hull][:, None] - points[hull], axis=2)
    source, target = (int(hull[k]) for k in np.unravel_index(apart.argmax(), apart.shape))
    if inside:
        source, target = (int(k) for k in rng.choice(len(points), 2, replace=False))
        pairs = pairs[rng.random(len(pairs)) < 0.8]
    edges = [e for a, b in pairs.tolist() for e in ((a, b), (b, a))
             if e[1] != source and e[0] != target]
    alpha = rng.choice([0.5, 1.0, 2.0, 5.0], len(points))
    alpha[[source, target]] = 0.0
    return Network(points, alpha, edges, source, target)


def paper_example() -> Network:
    """The paper's 8-node network with 7 routes."""
    from paper.environment import make_example  # the benchmarks do not need it
    return make_example()


def quiet_network(*args) -> Network:
    """A network without warnings about its useless edges."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', UserWarning)
        return Network(*args)


def exact_value(network: Network) -> Fraction:
    """Value of the plain game in rational arithmetic: networkx' maximum flow, nodes split."""
    graph = networkx.DiGraph()
    for node, alpha in enumerate(network.alpha):
        limit = {'capacity': 1 / Fraction(float(alpha))} if alpha > 0 else {}
        graph.add_edge((node, 'in'), (node, 'out'), **limit)
    for tail, head in network.edges.tolist():
        graph.add_edge((tail, 'out'), (head, 'in'))
    ends = (network.source, 'in'), (network.target, 'out')
    try:
        return 1 / networkx.maximum_flow_value(
            graph, *ends, flow_func=networkx.algorithms.flow.edmonds_karp
        )
    except networkx.NetworkXUnbounded:
        return Fraction(0)


def ends_of(network: Network, others: tuple[int, ...] = ()) -> np.ndarray:
    """Positions (K, 2) of source and target, and of the ``others``, where other legs end."""
    return np.unique(network.points[[network.source, network.target, *others]], axis=0)


def meets(network: Network, centres: np.ndarray, radius: float, secured: float,
          others: tuple[int, ...] = (), held=()) -> np.ndarray:
    """(K, M): whether an edge comes into the disc of a centre, ``secured`` or more from all ends.

    And outside ``held`` discs (x, y, radius).
    """
    edge, begin, end = exposed_parts(network, secured, others, held)
    along, hit = end - begin, np.zeros((len(centres), len(network.edges)), bool)
    if not len(edge):
        return hit
    squared, middles = (along**2).sum(axis=1), cKDTree((begin + end) / 2)
    within = (radius + np.sqrt(squared.max()) / 2) * (1.0 + 1e-9)
    for first in range(0, len(centres), 500):
        near = cKDTree(centres[first : first + 500]).sparse_distance_matrix(
            middles, within, output_type='ndarray')
        row, part = near['i'] + first, near['j']
        off = centres[row] - begin[part]
        share = np.clip((off * along[part]).sum(axis=1) / squared[part], 0.0, 1.0)
        met = np.hypot(*(off - share[:, None] * along[part]).T) <= radius
        hit[row[met], edge[part[met]]] = True
    return hit


def exposed_parts(network: Network, secured: float, others: tuple[int, ...] = (), held=()
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The parts of edges ``secured`` or more from all ends: edges (K,), begins, ends (K, 2)."""
    discs = [(x, y, secured) for x, y in ends_of(network, others)]
    ends, radii = np.split(np.array([*discs, *held]), [2], axis=1)
    start = network.points[network.tails]
    along = network.points[network.heads] - start
    length = np.hypot(*along.T)
    near = ((ends[:, None] - start) * along).sum(axis=2) / length**2
    off = np.linalg.norm(start + near[..., None] * along - ends[:, None], axis=2)
    half = np.sqrt(np.maximum(radii**2 - off**2, 0.0)) / length
    cuts = np.vstack((0.0 * length, near - half, near + half, 0.0 * length + 1.0))
    cuts = np.sort(np.clip(cuts, 0.0, 1.0), axis=0)
    middle = start + ((cuts[1:] + cuts[:-1]) / 2)[..., None] * along
    outside = (np.linalg.norm(middle[:, :, None] - ends, axis=3) > radii[:, 0]).all(axis=2)
    piece, edge = np.nonzero(outside & (cuts[1:] > cuts[:-1] + 1e-12))
    begin, end = (start[edge] + cuts[piece + k, edge][:, None] * along[edge] for k in (0, 1))
    return edge, begin, end


def standing_places(risk_map: RiskMap, network: Network, secured: float,
                    within: tuple[float, ...] = (0.5,),
                    others: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """Positions (K, 2) in free cells that are not secured, at shares ``within`` of a cell; losses.
    """
    rows, columns = np.nonzero(~risk_map.obstacles)
    offsets = np.array([(u, v) for u in within for v in within])
    cells = np.stack((columns, rows), axis=1)[:, None] + offsets
    points = risk_map.to_world(cells.reshape(-1, 2) * risk_map.resolution)
    alpha = np.repeat(risk_map.alpha[rows, columns], len(offsets))
    ends = ends_of(network, others)
    outside = np.linalg.norm(points[:, None] - ends, axis=2).min(axis=1) > secured
    return points[outside], alpha[outside]


def may_wait(network: Network, secured: float, others: tuple[int, ...] = (), held=()
             ) -> np.ndarray:
    """(N,): whether a node is outside the secured area and costs something."""
    apart = np.linalg.norm(network.points[:, None] - ends_of(network, others), axis=2)
    free = (apart > secured).all(axis=1) | (secured == 0.0)
    for *place, radius in held:
        free &= np.hypot(*(network.points - place).T) > radius
    return (network.alpha > 0.0) & free


def reached(network: Network, reach: float, secured: float, others: tuple[int, ...] = (), held=()
            ) -> np.ndarray:
    """(N, M): whether an edge comes into reach of a node outside the secured area, and counts.

    That is the area around the ends, and ``held`` discs (x, y, radius). Without a reach, the edge
    has to lead to the node.
    """
    met = (meets(network, network.points, reach, secured, others, held) if reach > 0.0 else
           np.arange(len(network.points))[:, None] == network.heads)
    return met & may_wait(network, secured, others, held)[:, None]


def hit_once(network: Network, p: np.ndarray, hits: np.ndarray) -> np.ndarray:
    """P(hit) (S,) of a route drawn from an acyclic p, each site once; ``hits`` (S, M) is bool.

    One pass per site over the nodes in order: the probability of arriving at a node unhit.
    """
    used = np.flatnonzero(p > 0.0)
    order = list(networkx.topological_sort(networkx.DiGraph(network.edges[used].tolist())))
    leaving = {node: used[network.tails[used] == node] for node in order}
    unhit = np.zeros((len(network.points), len(hits)))
    unhit[network.source] = 1.0
    for node in order[:-1]:
        total = p[leaving[node]].sum()
        for edge in leaving[node]:
            unhit[network.heads[edge]] += unhit[node] * p[edge] / total * ~hits[:, edge]
    return 1.0 - unhit[network.target]


def flow_value(networks: Sequence[Network], losses: Sequence[csr_matrix],
               limits: Sequence[float],
               usable: Sequence[np.ndarray] | None = None) -> float | None:
    """Least value of flows of the legs of a trip, if every entry counts, by one linear program.

    ``losses`` (S, M) of the entries of each leg's edges; mean costs of travel are within the
    ``limits``, and flow is on ``usable`` edges (M,) only. None if HiGHS finds no optimum.
    """
    sites, costs, balance, supply = losses[0].shape[0], [], [], []
    for network, limit in zip(networks, limits, strict=True):
        m, n = len(network.edges), len(network.points)
        ends = np.r_[network.tails, network.heads], np.tile(np.arange(m), 2)
        balance.append(coo_matrix((np.repeat([1.0, -1.0], m), ends), (n, m)))
        supply.append(np.zeros(n))
        supply[-1][[network.source, network.target]] = 1.0, -1.0
        costs.append(csr_matrix([network.travel_costs / limit] if 0.0 < limit < np.inf
                                else (0, m)))
    shared = hstack((*losses, csr_matrix(-np.ones((sites, 1)))))
    budgets, flow = (hstack((rows := block_diag(each), csr_matrix((rows.shape[0], 1))))
                     for each in (costs, balance))
    most = np.full(shared.shape[1], np.inf)
    if usable is not None:
        most[:-1] = np.where(np.concatenate(usable), np.inf, 0.0)
    found = linprog(
        np.append(np.zeros(len(most) - 1), 1.0), vstack((shared, budgets)),
        np.append(np.zeros(sites), np.ones(budgets.shape[0])), flow, np.concatenate(supply),
        np.column_stack((0.0 * np.isinf(most), most)), method='highs-ds',
        options={'primal_feasibility_tolerance': 1e-10, 'dual_feasibility_tolerance': 1e-10})
    return float(found.fun) if found.status == 0 else None


def lp_value(network: Network, budget: float = np.inf) -> float:
    """Least value without a reach within a length budget, by one linear program over all edges."""
    into = network.heads, np.arange(len(network.edges))
    losses = csr_matrix((network.alpha[network.heads], into),
                        (len(network.points), len(network.edges)))
    found = flow_value([network], [losses], [budget])
    assert found is not None
    return found


def routes_of(network: Network, used: np.ndarray | None = None,
              most: int | None = None) -> list[list[int]]:
    """All simple routes over all edges, or over those that are ``used`` (M,), as edge indices.

    Or the first ones, ``most`` at most.
    """
    number = {tuple(e): k for k, e in enumerate(network.edges.tolist())
              if used is None or used[k]}
    graph = networkx.DiGraph(list(number))
    graph.add_nodes_from((network.source, network.target))
    routes = networkx.all_simple_paths(graph, network.source, network.target)
    return [[number[step] for step in pairwise(route)] for route in islice(routes, most)]


def drawn_routes(network: Network, p: np.ndarray) -> dict[tuple[int, ...], float]:
    """The routes of an acyclic p (M,) as edge indices, with their probabilities."""
    leaving = np.bincount(network.tails, p, len(network.points))[network.tails]
    share = p / np.where(leaving > 0.0, leaving, 1.0)
    return {tuple(route): float(share[route].prod()) for route in routes_of(network, p > 0.0)}


def value_by_routes(loss: np.ndarray, hits: np.ndarray, routes,
                    limits=()) -> float | None:
    """Least value of any mixture of routes, each hit once by each site; None if none is allowed.

    ``loss`` (S,) of each site, and how hard it hits an edge, ``hits`` (S, M): the hardest of a
    route's edges counts. ``limits``: costs of edges (M,), each with the largest mean of a route.
    """
    losses = np.array([hits[:, route].max(axis=1) for route in routes]).T * loss[:, None]
    return least_value(losses, [([cost[route].sum() for route in routes], limit)
                                for cost, limit in limits])


def least_value(losses: np.ndarray, limits=(), leg=None) -> float | None:
    """Value of the game with ``losses`` [site, route]; None if no mixture is within ``limits``.

    ``limits``: costs of the routes, each with the largest mean. ``leg`` of a trip (routes,) that
    each route is of, by default the same: those of each are mixed with shares that sum to 1.
    """
    sites, routes = losses.shape
    leg = np.zeros(routes, int) if leg is None else np.asarray(leg)
    limits = [each for each in limits if np.isfinite(each[1])]
    rows = [np.hstack((losses, -np.ones((sites, 1)))),
            *(np.r_[cost, 0.0][None] for cost, _ in limits)]
    one = (np.arange(leg.max() + 1)[:, None] == leg).astype(float)
    found = linprog(np.r_[np.zeros(routes), 1.0], np.vstack(rows),
                    np.r_[np.zeros(sites), [limit for _, limit in limits]],
                    np.column_stack((one, np.zeros(len(one)))), np.ones(len(one)),
                    method='highs-ds')
    return float(found.fun) if found.status == 0 else None


def trip_value(alpha: np.ndarray, networks: Sequence[Network], hits: Sequence[np.ndarray],
               limits: Sequence[float]) -> float:
    """Least value of any mixtures of routes of the legs, drawn one by one, as one linear program.

    ``hits`` (N, M) of each leg; a route counts once at each node of loss ``alpha`` (N,). Mean
    lengths are within the ``limits`` of the legs.
    """
    columns, lengths, leg = [], [], []
    for k, (network, near) in enumerate(zip(networks, hits, strict=True)):
        for route in routes_of(network):
            columns.append(alpha * near[:, route].any(axis=1))
            lengths.append(network.lengths[route].sum())
            leg.append(k)
    found = least_value(np.array(columns).T, [(np.equal(leg, k) * lengths, limit)
                                              for k, limit in enumerate(limits)], leg)
    assert found is not None
    return found


def value_is_right(network: Network, value: float, budget: float, slack: float = 0.0) -> bool:
    """Whether a correct solver may find this value within 2e-7 of the budget [m].

    At most by the part ``slack`` over the least. Where routes are nearly as short as the shortest,
    the value is steep in the budget.
    """
    least = lp_value(network, budget)
    room = 2e-6 * least + 1e-8
    if least - room <= value <= (least + room) * (1 + slack):
        return True
    loose = lp_value(network, budget * (1 + 2e-7))
    return loose - room <= value <= (2 * least - loose + room) * (1 + slack)


def least_weight(network: Network, weights: np.ndarray) -> float:
    """Least sum of edge weights (M,) >= 0 over all routes: a plain Dijkstra."""
    graph = networkx.DiGraph()
    graph.add_nodes_from((network.source, network.target))
    graph.add_weighted_edges_from(np.column_stack((network.edges, weights)).tolist())
    try:
        return float(networkx.dijkstra_path_length(graph, network.source, network.target))
    except networkx.NetworkXNoPath:
        return np.inf


def unbalanced(network: Network, p: np.ndarray) -> float:
    """Largest residual of the conservation of one unit of p (M,) from source to target."""
    balance = np.bincount(network.tails, weights=p, minlength=len(network.points))
    balance -= np.bincount(network.heads, weights=p, minlength=len(network.points))
    balance[[network.source, network.target]] -= (1.0, -1.0)
    return float(np.abs(balance).max())


def is_acyclic(network: Network, p: np.ndarray) -> bool:
    """Whether the edges with p > 0 form no cycle."""
    graph = networkx.DiGraph(network.edges[p > 0.0].tolist())
    return networkx.is_directed_acyclic_graph(graph)


def check_unit_flow(network: Network, p: np.ndarray) -> None:
    """p (M,) is one unit of flow from source to target, without cycles."""
    assert p.min() >= 0.0 and p.max() <= 1.0 + 1e-12
    assert unbalanced(network, p) < 1e-8
    assert connected_flow(network, p) == pytest.approx(1.0, abs=1e-7)
    assert is_acyclic(network, p)


def connected_flow(network: Network, p: np.ndarray) -> float:
    """Maximum flow from source to target through the support of p, capacities p."""
    graph = networkx.DiGraph()
    for (tail, head), capacity in zip(network.edges.tolist(), p.tolist(), strict=True):
        if capacity > 0.0:
            graph.add_edge(tail, head, capacity=capacity)
    return networkx.maximum_flow_value(graph, network.source, network.target)

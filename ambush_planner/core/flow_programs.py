"""The convex programs of the game, in the standard form of ``interior_point``.

All are flows p on a set of edges under capacities at the sites, ``hits p <= u``; each capacity gets
a slack. Where sites are single nodes, the conservation of a capacitated node splits in two rows,
``in_j + slack_j = u_j`` and ``out_j + slack_j = u_j``. Every variable then stands in at most two
rows, and the normal matrix has the pattern of the network with its nodes split, which is planar
where the network is. Sites with a reach keep one general row each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, hstack, identity, vstack

from .game import BoolArray, Game
from .interior_point import Program, Solution, minimise
from .network import IndexArray
from .risk_map import FloatArray

# No route of an optimal strategy enters a disc so often.
MANY = 1e4


@dataclass(frozen=True, eq=False)
class FlowRows:
    """Rows of a capacitated flow: variables p on the edges ``edge`` (m,), then a slack a capacity.

    ``site`` (C,) are the capacitated sites (indices into ``game.sites``), ``capacity`` (C,) their
    u, ``node`` (R',) the nodes whose conservation the first R' rows state.
    """

    game: Game
    edge: IndexArray
    site: IndexArray
    capacity: FloatArray
    node: IndexArray
    rows: csr_matrix
    rhs: FloatArray
    places: FloatArray

    def program(
        self, cost: FloatArray | float, entropic: bool, dense: FloatArray, budget: float
    ) -> Program:
        """Standard form with a cost and a dense row on the edges, none on the slacks."""
        slacks = np.zeros(len(self.site))
        edges = np.broadcast_to(np.asarray(cost, dtype=np.float64), self.edge.shape)
        return Program(
            self.rows,
            self.rhs,
            np.concatenate((edges, slacks)),
            np.concatenate((np.full(len(self.edge), entropic), slacks > 0.0)),
            np.concatenate((dense, slacks)),
            budget,
            self.places,
        )

    def start(self) -> FloatArray:
        """A positive point: the same flow everywhere, slacks that fit where they can."""
        p = np.full(len(self.edge), 1.0 / np.sqrt(len(self.edge)))
        used = self.game.hits[self.site][:, self.edge] @ p
        return np.concatenate((p, np.maximum(self.capacity - used, 0.1 * self.capacity)))

    def capacity_prices(self, solution: Solution) -> FloatArray:
        """Duals >= 0 of the capacities, for all sites (S,)."""
        prices = np.zeros(len(self.game.sites))
        prices[self.site] = np.maximum(-(self.rows.T @ solution.y)[len(self.edge) :], 0.0)
        return prices

    def potentials(self, solution: Solution) -> FloatArray:
        """Duals of conservation (N,): they fall along every edge that the solution uses."""
        potential = np.full(self.game.node_count, np.nan)
        potential[self.node] = solution.y[: len(self.node)]
        potential[self.game.network.target] = -np.inf
        potential[self.game.network.source] = np.inf
        return potential


def flow_rows(
    game: Game,
    edges: BoolArray,
    capacity: FloatArray,
    size: float | None,
    at_most_one: bool = False,
) -> FlowRows:
    """Rows for flows of a given size (None: free, or ``at_most_one``) on ``edges`` (M,).

    ``capacity`` (S,) may be infinite. Every node of ``edges`` must lie on a route.
    """
    edge = np.flatnonzero(edges)
    if size is not None or at_most_one:
        # Cycles aside, a node is visited at most once and a disc is entered a few times at most:
        # larger capacities never bind.
        most = MANY if game.ambush_radius > 0.0 else 1.0
        capacity = np.where(capacity < most, capacity, np.inf)
    site = np.flatnonzero(np.isfinite(capacity) & (_uses(game, edge) > 0))
    node = np.unique(game.network.edges[edge])
    ends = [game.network.target] if size is not None else [game.network.source, game.network.target]
    node = node[~np.isin(node, ends)]
    build = _general_rows if game.ambush_radius > 0.0 else _split_rows
    rows, places = build(game, edge, site, node)
    rhs = np.zeros(rows.shape[0])
    u = capacity[site]
    if game.ambush_radius == 0.0:
        rhs[np.searchsorted(node, game.sites[site])] = u
    rhs[len(node) :] = u
    if size is not None:
        rhs[np.searchsorted(node, game.network.source)] = size
    return FlowRows(game, edge, site, u, node, rows, rhs, places)


def _uses(game: Game, edge: IndexArray) -> IndexArray:
    """How many of the edges hit each site (S,)."""
    return np.diff(game.hits[:, edge].indptr)


def _incidence(game: Game, nodes: IndexArray, ends: IndexArray) -> csr_matrix:
    """(len(nodes), len(ends)) 0/1: which of ``nodes`` each edge end is (-1: none of them)."""
    row_of = np.full(game.node_count + 1, -1)
    row_of[nodes] = np.arange(len(nodes))
    row = row_of[ends]
    known = np.flatnonzero(row >= 0)
    return csr_matrix(
        (np.ones(len(known)), (row[known], known)), shape=(len(nodes), len(ends))
    )


def _split_rows(
    game: Game, edge: IndexArray, site: IndexArray, node: IndexArray
) -> tuple[csr_matrix, FloatArray]:
    """``out - in = 0`` of plain nodes; ``out + slack = u``, ``in + slack = u`` of capacitated."""
    tail, head = game.network.edges[edge].T
    held = game.sites[site]
    plain = node[~np.isin(node, held)]
    entering_plain = _incidence(game, node, np.where(np.isin(head, plain), head, -1))
    slack = _incidence(game, node, held)
    conservation = hstack((_incidence(game, node, tail) - entering_plain, slack))
    entering = hstack((_incidence(game, held, head), identity(len(held))))
    points = game.network.points
    rows = vstack((conservation, entering)).tocsr()
    return rows, np.concatenate((points[node], points[held]))


def _general_rows(
    game: Game, edge: IndexArray, site: IndexArray, node: IndexArray
) -> tuple[csr_matrix, FloatArray]:
    """``out - in = 0`` of every node, then ``hits p + slack = u`` of every site."""
    tail, head = game.network.edges[edge].T
    conservation = _incidence(game, node, tail) - _incidence(game, node, head)
    hits = hstack((game.hits[site][:, edge], identity(len(site))))
    empty = csr_matrix((len(node), len(site)))
    points = game.network.points
    rows = vstack((hstack((conservation, empty)), hits)).tocsr()
    return rows, np.concatenate((points[node], points[game.sites[site]]))


def most_entropy(
    game: Game, edges: BoolArray, capacity: FloatArray, budget: float, deadline: float
) -> tuple[FloatArray, int]:
    """Unit flow p (M,) of maximal edge entropy on ``edges`` and the iterations it took."""
    rows = flow_rows(game, edges, capacity, 1.0)
    lengths = game.network.lengths[rows.edge]
    scale = float(lengths.mean()) or 1.0
    program = rows.program(0.0, True, lengths / scale, budget / scale)
    solution = minimise(program, rows.start(), deadline)
    p = np.zeros(len(edges))
    p[rows.edge] = solution.f[: len(rows.edge)]
    return p, solution.iterations


@dataclass(frozen=True, eq=False)
class ShortestFlow:
    """Least expected length [m], node potentials (N,) and reduced costs (M,) [m].

    Potentials fall along every edge that the flow uses. A unit flow p under the same capacities
    is at least ``reduced_cost' p`` longer than ``length``.
    """

    length: float
    potential: FloatArray
    reduced_cost: FloatArray


def shortest_flow(game: Game, capacity: FloatArray, deadline: float) -> ShortestFlow:
    """Unit flow of least expected length under ``capacity`` (S,)."""
    rows = flow_rows(game, game.playable, capacity, 1.0)
    m = len(rows.edge)
    lengths = game.network.lengths[rows.edge]
    scale = float(lengths.mean()) or 1.0
    program = rows.program(lengths / scale, False, np.zeros_like(lengths), np.inf)
    solution = minimise(program, rows.start(), deadline)
    reduced = np.zeros(len(game.network.edges))
    reduced[rows.edge] = np.maximum(lengths - scale * (rows.rows.T @ solution.y)[:m], 0.0)
    return ShortestFlow(float(lengths @ solution.f[:m]), rows.potentials(solution), reduced)


@dataclass(frozen=True, eq=False)
class BudgetedValue:
    """Least value under a length budget: size of the scaled flow, prices of sites and length."""

    size: float
    site_price: FloatArray
    length_price: float


def largest_flow(
    game: Game, capacity: FloatArray, budget: float, at_most_one: bool, deadline: float
) -> BudgetedValue:
    """Largest flow under ``capacity`` (S,) whose mean length is at most ``budget`` [m].

    ``at_most_one`` tells that its size is known to be at most 1.

    ``l' f <= budget * size(f)`` is one row that is homogeneous in f, so this is again a flow
    program, in which the least value is one over the flow's size.
    """
    rows = flow_rows(game, game.playable, capacity, None, at_most_one)
    leaving = game.network.tails[rows.edge] == game.network.source
    dense = np.zeros(len(rows.edge))
    limit = np.inf
    if np.isfinite(budget):
        dense = game.network.lengths[rows.edge] / budget - leaving
        limit = 0.0
    program = rows.program(np.where(leaving, -1.0, 0.0), False, dense, limit)
    solution = minimise(program, rows.start(), deadline)
    size = float(solution.f[: len(rows.edge)][leaving].sum())
    price = solution.price / budget if np.isfinite(budget) else 0.0
    return BudgetedValue(size, rows.capacity_prices(solution), price)

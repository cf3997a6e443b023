"""The Gibbs law of routes: of all strategies within given limits, the one of most route entropy.

On an acyclic network let every edge e have a weight c_e, and draw a route with probability

    P(route) = exp(-sum of c_e over its edges) / Z.

With Z_i = sum over edges i->k of exp(-c_ik) Z_k and Z_target = 1 it is the Markov chain that goes
from i to k with probability exp(-c_ik) Z_k / Z_i: one pass backward and one forward over the edges
in topological order. With c = C' v, v >= 0, it is the strategy of greatest route entropy among all
with C p <= 1 if v minimises the convex function

    log Z(C' v) + sum v,        gradient 1 - C p.

For every strategy with C p <= 1 that function is at least its entropy, so at least 0: a value
below 0 proves that there is none (M. Saerens et al., *Randomized shortest-path problems*, Neural
Computation 21, 2009; the law is also known as maximum causal entropy).
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, field

import numpy as np
import scipy
from scipy.optimize import minimize
from scipy.sparse import coo_matrix, csr_matrix, identity
from scipy.sparse.linalg import splu, spsolve_triangular

from .arrays import FloatArray, IndexArray, sums
from .game import Game
from .paths import distances_from

# Before 1.13 scipy solved triangular systems row by row in Python.
FAST_TRIANGULAR = tuple(int(part) for part in scipy.__version__.split(".")[:2]) >= (1, 13)
# Rows of one block of the partition function's safe evaluation.
BLOCK = 400
MAX_EVALUATIONS = 1500
# Correction pairs of L-BFGS: more where there are few multipliers to store them for.
CORRECTIONS, MANY_ROWS, FEW_CORRECTIONS = 50, 100_000, 20
SMALL_START = 1e-3
# Entropy that may be missing when the search ends, relative.
MISSING_ENTROPY = 1e-3


class AcyclicNetwork:
    """The edges of an acyclic game in topological order, ready for the two passes.

    ``edge`` (m,) are the network's edge indices, ``tail`` and ``head`` (m,) their positions in the
    order, in which the source is 0 and the target n - 1.
    """

    def __init__(self, game: Game, rank: IndexArray) -> None:
        network = game.network
        edge = np.flatnonzero(game.playable)
        used = np.unique(network.edges[edge])
        nodes = used[np.argsort(rank[used], kind="stable")]
        place = np.full(game.node_count, -1)
        place[nodes] = np.arange(len(nodes))
        tail, head = place[network.edges[edge]].T
        order = np.lexsort((head, tail))
        self.edge, self.tail, self.head = edge[order], tail[order], head[order]
        self.count = len(nodes)
        self._first = np.searchsorted(self.tail, np.arange(self.count + 1))
        self._level = np.zeros(self.count)
        # Row i of the matrices 1 - W: the diagonal, then the edges out of i.
        self._indptr = (self._first + np.arange(self.count + 1)).astype(np.int32)
        self._place = np.arange(len(self.edge)) + self.tail + 1
        indices = np.empty(len(self.edge) + self.count, dtype=np.int32)
        indices[self._indptr[:-1]] = np.arange(self.count)
        indices[self._place] = self.head
        self._indices = indices

    def law(self, weights: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return log Z, p (m,) and the probability (m,) of each edge at its tail.

        Weights are scaled by the partition function of the evaluation before; where that is too
        far off for floating point it is found block by block first.
        """
        scaled = self._scaled_partition(weights)
        if scaled is None:
            self._level = self._log_partition(weights)
            scaled = self._scaled_partition(weights)
        factor, partition = scaled if scaled is not None else self._no_choice(weights)
        out = partition[self.tail]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(out > 0.0, factor * partition[self.head] / out, 0.0)
        self._level = self._level + np.log(np.maximum(partition, 1e-290))
        x = self._forward(share)
        return float(self._level[0]), x[self.tail] * share, share

    def _scaled_partition(self, weights: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        level = self._level
        with np.errstate(over="ignore", invalid="ignore"):
            factor = np.exp(level[self.head] - level[self.tail] - weights)
            if not np.isfinite(factor).all():
                return None
            partition = self._backward(factor)
        good = np.isfinite(partition).all() and partition[0] > 1e-280 and partition.max() < 1e280
        return (factor, partition) if good else None

    def _no_choice(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where even the safe levels fail: weights so far apart that only the best edge counts."""
        key = weights - self._level[self.head]
        best = np.full(self.count, np.inf)
        np.minimum.at(best, self.tail, key)
        chosen = (key <= best[self.tail]).astype(float)
        ties = sums(self.tail, chosen, self.count)
        return chosen / ties[self.tail], np.ones(self.count)

    def _backward(self, factor: FloatArray) -> FloatArray:
        """y with y_i = sum over edges out of i of factor * y_head, y_target = 1."""
        last = np.zeros(self.count)
        last[-1] = 1.0
        matrix = self._matrix(factor)
        if FAST_TRIANGULAR:
            return np.asarray(spsolve_triangular(matrix, last, lower=False, unit_diagonal=True))
        return np.asarray(_natural_lu(matrix).solve(last))

    def _forward(self, share: FloatArray) -> FloatArray:
        """x with x_k = sum over edges into k of x_tail * share, x_source = 1."""
        first = np.zeros(self.count)
        first[0] = 1.0
        matrix = self._matrix(share)
        if FAST_TRIANGULAR:
            transposed = matrix.T.tocsr()
            return np.asarray(
                spsolve_triangular(transposed, first, lower=True, unit_diagonal=True)
            )
        return np.asarray(_natural_lu(matrix).solve(first, trans="T"))

    def _matrix(self, factor: FloatArray) -> csr_matrix:
        data = np.ones(len(self._indices))
        data[self._place] = -factor
        return csr_matrix((data, self._indices, self._indptr), shape=(self.count, self.count))

    def _log_partition(self, weights: FloatArray) -> FloatArray:
        """log Z_i (n,) whatever their size: solved in blocks from the target on, each scaled.

        Relative to the best way on from each node, so that nothing in a block vanishes.
        """
        backwards = np.stack((self.head, self.tail), axis=1)
        best = distances_from(backwards, weights, self.count, self.count - 1)
        excess = np.maximum(weights + best[self.head] - best[self.tail], 0.0)
        log_z = np.full(self.count, -np.inf)
        log_z[-1] = 0.0
        for end in range(self.count - 1, 0, -BLOCK):
            begin = max(end - BLOCK, 0)
            edges = slice(self._first[begin], self._first[end])
            tail, head, weight = self.tail[edges] - begin, self.head[edges], excess[edges]
            size, inner = end - begin, self.head[edges] < end
            leaving = log_z[head[~inner]] - weight[~inner]
            scale = float(leaving.max())
            pull = sums(tail[~inner], np.exp(leaving - scale), size)
            links = coo_matrix(
                (np.exp(-weight[inner]), (tail[inner], head[inner] - begin)), shape=(size, size)
            )
            y = np.asarray(_natural_lu(identity(size, format="csc") - links).solve(pull))
            with np.errstate(divide="ignore", invalid="ignore"):
                log_z[begin:end] = np.where(y > 0.0, np.log(np.maximum(y, 1e-300)), -690.0) + scale
        return log_z - best


def _natural_lu(matrix: csr_matrix):  # type: ignore[no-untyped-def]
    return splu(matrix.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0)


@dataclass
class GibbsStrategy:
    """The last evaluation of the law: p (m,), multipliers v (R,), how far it is over its limits.

    ``excess`` is max(C p) - 1; ``reached`` says that the search ended where it was to end,
    ``infeasible`` that no strategy is within the limits.
    """

    p: FloatArray
    multipliers: FloatArray
    excess: float = np.inf
    infeasible: bool = False
    reached: bool = False
    evaluations: int = field(default=0)


class _Done(Exception):
    """Ends the search from within."""


def most_entropy(
    network: AcyclicNetwork, rows: csr_matrix, start: FloatArray, tolerance: float,
    deadline: float, softness: float = 0.0, evaluations: int = MAX_EVALUATIONS,
) -> GibbsStrategy:
    """Minimise log Z(C' v) + sum v + softness / 2 (sum v)^2 over v >= 0 by L-BFGS-B.

    Every evaluation is a strategy. The search ends at one that is over its limits C p <= 1, C =
    ``rows`` (R, m), by no more than ``tolerance`` and whose entropy is within a thousandth of the
    greatest, when the limits are proved infeasible, after so many ``evaluations``, or at
    ``deadline`` (``time.monotonic``). ``softness`` lets the
    strategy be over its limits by softness * sum v: then there always is a minimum.
    """
    found = GibbsStrategy(np.empty(0), start)
    if rows.shape[0] == 0:
        _, p, _ = network.law(np.zeros(len(network.edge)))
        return GibbsStrategy(p, start, 0.0, reached=True, evaluations=1)
    columns = rows.T.tocsr()

    def objective(v: FloatArray) -> tuple[float, FloatArray]:
        if not np.isfinite(v).all():  # a line search that ran away
            raise _Done
        log_z, p, _ = network.law(columns @ v)
        used, total = rows @ p, float(v.sum())
        found.p, found.multipliers = p, v.copy()
        found.excess = float(used.max()) - 1.0
        found.evaluations += 1
        value = log_z + total + softness / 2.0 * total**2
        found.infeasible = softness == 0.0 and value < 0.0
        # The strategy's own entropy is log Z + v' C p; no strategy within the limits has more
        # than log Z + sum v.
        missing = total - float(v @ used)
        near = missing <= MISSING_ENTROPY * max(value, 1.0)
        found.reached = softness == 0.0 and found.excess <= tolerance and near
        if found.reached or found.infeasible or time.monotonic() > deadline:
            raise _Done
        return value, 1.0 - used + softness * total

    pairs = CORRECTIONS if rows.shape[0] < MANY_ROWS else FEW_CORRECTIONS
    options = {
        "maxcor": pairs, "maxiter": evaluations, "maxfun": evaluations, "ftol": 1e-15,
        "gtol": 1e-12,
    }
    with contextlib.suppress(_Done):
        minimize(
            objective, start, jac=True, method="L-BFGS-B", bounds=[(0.0, None)] * len(start),
            options=options,
        )
    return found

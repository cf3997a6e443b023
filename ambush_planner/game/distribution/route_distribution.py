# SPDX-License-Identifier: Apache-2.0
"""The route distribution: the most unpredictable strategy whose losses keep to caps.

P(hit) of each site, every route counted once, is a smooth function of the Markov chain. So the
distribution of greatest entropy is found by rounds. Each one limits the hits by rows that are exact
at the chain before (``MarkovChain.hits_with_derivatives``) and finds the Gibbs distribution of
greatest entropy within these limits, which after the first round is also drawn towards the chain
before: it maximises

    H(p) + w sum of p ln(share before),    share: the probability of an edge at its tail,

with the weight w of the past: 1/2 at first, and k/(k + 1) for rising k later, as if rounds were
averaged, since they can swing back and forth. Where rounds stand still, the chain before is the new
one, so p has the greatest entropy (theory.md, Proposition 8.5). Where no route can meet a site
twice, the rows are exact for every chain, and one round does it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import block_diag, csr_matrix, diags, vstack

from ...arrays import FloatArray, IndexArray
from ..legs import Legs
from ..tolerance import ceiling, within
from .chain import NO_FLOW, MarkovChain
from .entropy_search import Accuracy, maximize_entropy
from .gibbs import AcyclicNetwork


class DistributionRounds(NamedTuple):
    """The constants of the rounds of a route distribution."""

    aim: float = 0.95  # share of the tolerance that a distribution uses, if rows are always exact
    early_aim: float = 0.7  # the same if rows are exact only at the chain before
    # How accurate a round is, and a rough one; here, the excess is a share of the tolerance, and
    # at most the missing entropy.
    accuracy: Accuracy = Accuracy(0.04, 5e-4)
    early_accuracy: Accuracy = Accuracy(0.2, 1e-2)
    near: float = 0.97  # share of their cap from which on sites limit their hits, not entries
    small: float = 1e-5  # derivatives that are left out, as no edge is used more than once
    unused: float = 1e-8  # probability of edges that later rounds do without
    swings: int = 5  # rounds that may swing back and forth; later ones are averaged


DISTRIBUTION = DistributionRounds()


class RouteDistribution:
    """Rounds on the acyclic network of all legs, from first strategies p (m,).

    ``chain`` is the strategy that the rounds have reached, ``value`` what it costs when measured.
    Sites have losses (S,) and edges (S, M) that enter their discs; each may cause the ``cap`` plus
    the ``tolerance``. If rows are ``exact`` for every chain, ``entropy_bound`` [nats] is the most
    that the whole tolerance and the budgets allow, else NaN. Rounds from a chain that is not within
    the tolerance are less accurate, as sites will join. ``evaluations`` are those of the latest
    round.
    """

    def __init__(self, network: AcyclicNetwork, p: FloatArray, legs: Legs, tolerance: float,
                 deadline: float) -> None:
        self.network, self.tolerance, self.exact = network, tolerance, legs.no_reentry
        self.chain, self.deadline, self._begun = MarkovChain(network, p), deadline, p > 0.0
        self._aim = DISTRIBUTION.aim if self.exact else DISTRIBUTION.early_aim
        self._budget_rows = _budget_rows(legs, network.edge)
        self._entering = csr_matrix((0, len(p)))
        self._loss, self.cap = np.zeros(0), 0.0
        self.multipliers, self.prices = np.zeros(0), np.zeros(self._budget_rows.shape[0])
        self.rounds, self.evaluations, self.entropy_bound = 0, 0, np.nan

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with the edges that enter their discs, (K, M), and their losses (K,)."""
        self._entering = csr_matrix(vstack((self._entering, self.network.columns(entering))))
        self._loss = np.append(self._loss, loss)
        self.multipliers = np.append(self.multipliers, np.zeros(len(loss)))

    def measure(self, cap: float) -> None:
        """Find the value of p, and rows that are exact at p, for a new ``cap``."""
        self.cap, limit = cap, cap / self._loss
        legs = len(self.network.starts)
        self._could = np.flatnonzero((self._entering.getnnz(axis=1) > 0) & (limit < legs))
        hits = np.asarray(np.minimum(self._entering @ self.chain.p, legs))
        self._near = near = self._could[hits[self._could] > DISTRIBUTION.near * limit[self._could]]
        self._rows = self._entering[near]
        if not self.exact:
            hits[near], self._rows = self.chain.hits_with_derivatives(self._rows)
            self._rows.data[np.abs(self._rows.data) < DISTRIBUTION.small] = 0.0
            self._rows.eliminate_zeros()
        losses, self.entropy = self._loss * hits, self.chain.entropy
        self.worst = int(losses.argmax()) if len(losses) else -1
        self.value = float(losses.max(initial=0.0))

    def _accuracy(self, relative: Accuracy) -> Accuracy:
        return relative._replace(excess=min(relative.excess * self.tolerance, relative.missing))

    @property
    def good(self) -> bool:
        """Return whether the value is within the tolerance of the cap."""
        return within(self.value, self.cap, self.tolerance)

    def round(self) -> bool:
        """The distribution of greatest entropy, near the one before, within rows exact at p.

        Returns False if no distribution is within the rows.
        """
        self.evaluations, near = 0, self._near
        most = ceiling(self.cap, self._aim * self.tolerance) / self._loss
        sites = np.append(near, np.setdiff1d(self._could, near))
        if not most[sites].all():  # an LP that proved nothing allows no hits
            return False
        rows = csr_matrix(vstack((self._rows, self._entering[sites[len(near):]])))
        averaged = max(self.rounds - DISTRIBUTION.swings, 1)
        later = averaged / (averaged + 1.0) if self.rounds and not self.exact else 0.0
        past = -later * np.log(np.maximum(self.chain.share, NO_FLOW))
        start = (1.0 - later) * np.append(self.multipliers[sites], self.prices)
        early = not self.exact and not (self.good and self.rounds)
        accuracy = self._accuracy(DISTRIBUTION.early_accuracy if early else DISTRIBUTION.accuracy)
        # A distribution may exceed its limits by the excess, but not a budget.
        budgets = self._budget_rows / (1.0 - accuracy.excess)
        limits = csr_matrix(vstack((diags(1.0 / most[sites]) @ rows, budgets)))
        found = maximize_entropy(self.network, limits, past, start, accuracy, self.deadline)
        self.evaluations = found.evaluations
        if found.infeasible or not len(found.p):
            return False
        # Where rounds stand still, the chain before stands for this share of the multipliers.
        multipliers = found.multipliers / (1.0 - later)
        self.multipliers, self.prices = np.zeros(len(self._loss)), multipliers[len(sites) :]
        self.multipliers[sites] = multipliers[: len(sites)]
        if self.exact:
            whole = ceiling(1.0, self.tolerance) / ceiling(1.0, self._aim * self.tolerance)
            log_z = self.network.distribution(limits.T @ multipliers)[0]
            self.entropy_bound = float(log_z + whole * self.multipliers.sum()
                                       + self.prices.sum() / (1.0 - accuracy.excess))
        self.chain = MarkovChain(self.network, found.p)
        self.rounds += 1
        if self.rounds == 1 and not self.exact:
            self._leave_unused_edges()
        return True

    def _leave_unused_edges(self) -> None:
        """Go on without the edges that next to no route uses, half of all on a fine network.

        Those of the first strategies stay, as these are within the limits.
        """
        rare = ~self._begun & (self.chain.p < DISTRIBUTION.unused)
        chain, _ = self.chain.avoiding(np.flatnonzero(rare))
        used = np.flatnonzero(self._begun | (chain.p > 0.0))
        self.network = self.network.part(used)
        self.chain = MarkovChain(self.network, chain.p[used])
        self._entering, self._budget_rows = self._entering[:, used], self._budget_rows[:, used]


def _budget_rows(legs: Legs, edge: IndexArray) -> csr_matrix:
    """Rows (legs, m) of the shares of each leg's margin that the edges (m,) of all legs take."""
    used = csr_matrix(block_diag([budget.used_margin[None] for budget in legs.budgets
                                  if budget.is_limited] or [np.zeros((0, legs.edge_count))]))
    return csr_matrix(used[:, edge])

# SPDX-License-Identifier: Apache-2.0
"""The route distribution: the strategy of greatest entropy whose mean losses keep to caps.

P(hit) of each site is a smooth function of the Markov chain, so the distribution of greatest
entropy is found by successive linearisation. Each round limits the hits by rows that are exact at
the previous chain (``MarkovChain.hits_with_derivatives``), and finds the Gibbs distribution of
greatest entropy within these limits. After the first round, it stays near the previous chain:

    maximise H(p) + w sum of p ln(previous share),   share: the probability of an edge at its tail.

The weight w of the past is 1/2 at first, and k/(k + 1) for rising k later, as if rounds were
averaged, since they can swing back and forth. A fixed point of the rounds is a stationary point of
the entropy within the caps (docs/theory.md, Proposition 8.5). If no route can re-enter a reach,
rows are exact for every chain, and one round suffices.
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
    """Constants of the rounds of a route distribution."""

    aim: float = 0.95  # share of the tolerance that a distribution uses, without re-entry
    early_aim: float = 0.7  # the same if rows are exact only at the previous chain
    # How accurate a round is, and a rough one; here, the excess is a share of the tolerance, and
    # at most the missing entropy.
    accuracy: Accuracy = Accuracy(0.04, 5e-4)
    early_accuracy: Accuracy = Accuracy(0.2, 1e-2)
    near: float = 0.97  # share of a site's cap from which on hits are limited, not entries
    small: float = 1e-5  # derivatives below this are dropped, as no edge is used more than once
    unused: float = 1e-8  # edges below this probability are dropped in later rounds
    swings: int = 5  # rounds that may swing back and forth; later ones are averaged


DISTRIBUTION = DistributionRounds()


class RouteDistribution:
    """Rounds on the acyclic network of all legs, beginning at strategies p (m,).

    ``chain`` is the present strategy, ``value`` its value at the known sites when last measured.
    The mean loss at each site may exceed the ``cap`` by the ``tolerance``. With ``no_reentry``,
    rows are exact for every chain, and ``entropy_bound`` [nats] is an upper bound of the entropy
    within the whole tolerance and the budgets; else it is NaN. Rounds from a chain outside the
    tolerance are less accurate, since sites will be added. ``evaluations`` are those of the latest
    round.
    """

    def __init__(self, network: AcyclicNetwork, p: FloatArray, legs: Legs, tolerance: float,
                 deadline: float) -> None:
        self.network, self.tolerance, self.no_reentry = network, tolerance, legs.no_reentry
        self.chain, self.deadline, self._begun = MarkovChain(network, p), deadline, p > 0.0
        self._aim = DISTRIBUTION.aim if self.no_reentry else DISTRIBUTION.early_aim
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

    @property
    def site_count(self) -> int:
        """Number of sites, S."""
        return len(self._loss)

    def aim(self, q: FloatArray, worth: FloatArray) -> None:
        """Begin the search for multipliers in the direction of an ambusher's q (K,) at the sites.

        ``worth`` has the price of each limited budget times its margin.
        """
        self.multipliers[: len(q)] = q
        self.prices = worth / (self.cap or 1.0)

    def measure(self, cap: float) -> None:
        """Compute the value of the chain, and rows that are exact at it, for a new ``cap``."""
        self.cap, limit = cap, cap / self._loss
        legs = len(self.network.starts)
        self._could = np.flatnonzero((self._entering.getnnz(axis=1) > 0) & (limit < legs))
        hits = np.asarray(np.minimum(self._entering @ self.chain.p, legs))
        self._near = near = self._could[hits[self._could] > DISTRIBUTION.near * limit[self._could]]
        self._rows = self._entering[near]
        if not self.no_reentry:
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
        """Find the distribution of greatest entropy, near the previous one, within the rows.

        Returns False if no distribution is within them.
        """
        self.evaluations, near = 0, self._near
        max_hits = ceiling(self.cap, self._aim * self.tolerance) / self._loss
        sites = np.append(near, np.setdiff1d(self._could, near))
        if not max_hits[sites].all():  # a program without a bound allows no hits
            return False
        rows = csr_matrix(vstack((self._rows, self._entering[sites[len(near):]])))
        averaged = max(self.rounds - DISTRIBUTION.swings, 1)
        past_weight = averaged / (averaged + 1.0) if self.rounds and not self.no_reentry else 0.0
        past = -past_weight * np.log(np.maximum(self.chain.share, NO_FLOW))
        start = (1.0 - past_weight) * np.append(self.multipliers[sites], self.prices)
        early = not self.no_reentry and not (self.good and self.rounds)
        accuracy = self._accuracy(DISTRIBUTION.early_accuracy if early else DISTRIBUTION.accuracy)
        # A distribution may exceed its limits by the excess, but not a budget.
        budgets = self._budget_rows / (1.0 - accuracy.excess)
        limits = csr_matrix(vstack((diags(1.0 / max_hits[sites]) @ rows, budgets)))
        found = maximize_entropy(self.network, limits, past, start, accuracy, self.deadline)
        self.evaluations = found.evaluations
        if found.infeasible or not len(found.p):
            return False
        # At a fixed point, the previous chain carries the past's share of the multipliers.
        multipliers = found.multipliers / (1.0 - past_weight)
        self.multipliers, self.prices = np.zeros(len(self._loss)), multipliers[len(sites) :]
        self.multipliers[sites] = multipliers[: len(sites)]
        if self.no_reentry:
            whole = ceiling(1.0, self.tolerance) / ceiling(1.0, self._aim * self.tolerance)
            log_z = self.network.distribution(limits.T @ multipliers)[0]
            self.entropy_bound = float(log_z + whole * self.multipliers.sum()
                                       + self.prices.sum() / (1.0 - accuracy.excess))
        self.chain = MarkovChain(self.network, found.p)
        self.rounds += 1
        if self.rounds == 1 and not self.no_reentry:
            self._leave_unused_edges()
        return True

    def _leave_unused_edges(self) -> None:
        """Drop the edges that hardly any route uses, half of all on a fine network.

        Those of the first strategies stay, because these are within the limits.
        """
        rare = ~self._begun & (self.chain.p < DISTRIBUTION.unused)
        chain, _ = self.chain.avoiding(np.flatnonzero(rare))
        used = np.flatnonzero(self._begun | (chain.p > 0.0))
        self.network = self.network.part(used)
        self.chain = MarkovChain(self.network, chain.p[used])
        self._entering, self._budget_rows = self._entering[:, used], self._budget_rows[:, used]


def _budget_rows(legs: Legs, edge: IndexArray) -> csr_matrix:
    """Rows (legs, m): used margin of each leg by the edges (m,) of all legs."""
    used = csr_matrix(block_diag([budget.used_margin[None] for budget in legs.budgets
                                  if budget.is_limited] or [np.zeros((0, legs.edge_count))]))
    return csr_matrix(used[:, edge])

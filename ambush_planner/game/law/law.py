# SPDX-License-Identifier: Apache-2.0
"""The law of routes: the most unpredictable strategy whose losses keep to a level.

P(hit) of each site, every route counted once, is a smooth function of the Markov chain. So the law
of greatest entropy is found by rounds: each one limits the hits by rows that are exact at the chain
before (``MarkovChain.hits_with_derivatives``), finds the Gibbs law of greatest entropy within these
limits and goes a step towards it. What the rows did not foresee at a site is kept as a reserve for
the next round. Two or three rounds reach the slack. Where no route can meet a site twice, the rows
are exact for every chain, and one round does it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack

from ...arrays import FloatArray, IndexArray
from ..budget import Budget, margin_rows
from ..slack import ceiling, within
from .chain import MarkovChain
from .entropy_search import maximize_entropy
from .gibbs import AcyclicNetwork

# Share of the slack that a law aims at; its tolerance as a share of the slack, and the largest.
AIM, TOLERANCE, MAX_TOLERANCE = 0.95, 0.04, 4e-4
# Sites limit their hits if their entries cost at least this share of their level; else entries.
NEAR = 0.97
# Steps towards a new law: the usual one, and the shortest.
STEP, SHORTEST = 0.6, 0.05
# A longer step may put the value this many slacks over its limit, or must reach this share of
# what it promises.
OVERSHOOT, PROMISE = 3.0, 0.1
# Of a reserve: the share kept in the next round, its largest share of a limit, and the share kept
# if the limits are infeasible with it.
KEPT_RESERVE, MAX_RESERVE, LESS_RESERVE = 0.5, 0.1, 0.3
# Shares of what p costs too much that limits may leave if those without are infeasible.
RELAXED = (0.5, 0.75, 0.9)
# Largest number of doublings of the first multipliers.
DOUBLINGS = 12


class Law:
    """Rounds on one acyclic network, from a first strategy p (m,).

    ``chain`` is the strategy that the rounds have reached, ``value`` what it costs when measured.
    ``level`` (S,) is what each site may cause; the k largest add up to the limit of the value.
    ``entropy_bound`` [nats] is the most that the latest round's rows allow within the whole slack
    and budgets.
    """

    def __init__(self, network: AcyclicNetwork, p: FloatArray, budgets: Sequence[Budget],
                 ambushers: int, slack: float, exact: bool, deadline: float) -> None:
        self.network, self.slack, self.exact = network, slack, exact
        self.chain = MarkovChain(network, p)
        self.deadline, self._k = deadline, ambushers
        self._tolerance = min(TOLERANCE * slack, MAX_TOLERANCE)
        binding = [b for b in budgets if b.binds]
        # A law may exceed its limits by the tolerance, but not a budget.
        self._margin = np.array([b.margin * (1.0 - self._tolerance) for b in binding])
        self._excess = margin_rows(binding, network.edge) / (1.0 - self._tolerance)
        self._entering = csr_matrix((0, len(p)))
        self._loss, self.level = np.zeros(0), np.zeros(0)
        self._claimed, self._reserve = np.zeros(0), np.zeros(0)
        self.multipliers, self.prices = np.zeros(0), np.zeros(len(binding))
        self._before = self.multipliers, self.prices  # those of the round before the last
        self.rounds, self.step, self.evaluations, self.entropy_bound = 0, 1.0, 0, np.nan

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with the edges that enter their discs, (K, M), and their losses (K,)."""
        self._entering = csr_matrix(vstack((self._entering, self.network.columns(entering))))
        self._loss, more = np.append(self._loss, loss), np.zeros(len(loss))
        self._claimed = np.append(self._claimed, more)
        self._reserve = np.append(self._reserve, more)
        self.multipliers = np.append(self.multipliers, more)

    def start_from(self, sites: FloatArray, budgets: FloatArray, level: FloatArray) -> None:
        """Begin with the multipliers per hit of the first sites (K,) and per unit of cost."""
        first = slice(len(sites))
        self.multipliers[first] = sites * level[first] / self._loss[first]
        self.prices = budgets * self._margin

    def unscaled_multipliers(self) -> tuple[FloatArray, FloatArray]:
        """The multipliers per hit of each site (S,), and per unit of each budget's cost."""
        known = len(self.level)
        most = np.maximum(self.level / self._loss[:known], np.finfo(float).tiny)
        return (np.append(self.multipliers[:known] / most, self.multipliers[known:]),
                self.prices / self._margin)

    def measure(self, level: FloatArray) -> None:
        """Find the value of p, and rows that are exact at p, for a new ``level`` (S,)."""
        self.level, limit = level, level / self._loss
        self._level_value = self._sum_of_largest(level)
        counts = self._entering.getnnz(axis=1)
        self._could = np.flatnonzero((counts > limit) & (limit < 1.0))
        hits = self._most_hits(self.chain)
        self._near = near = self._could[hits[self._could] > NEAR * limit[self._could]]
        self._rows = self._entering[near]
        if not self.exact:
            hits[near], self._rows = self.chain.hits_with_derivatives(self._rows)
        self._hits, self.entropy = hits[near], self.chain.entropy
        self.value = self._sum_of_largest(self._loss * hits)
        losses = self._loss[near] * self._hits
        self.worst = int(near[np.argmax(losses)]) if len(near) else -1

    def _value_of(self, chain: MarkovChain) -> float:
        """The value of a strategy."""
        hits = self._most_hits(chain)
        if not self.exact:
            near = self._could[hits[self._could] > NEAR * (self.level / self._loss)[self._could]]
            hits[near] = chain.hits(self._entering[near])
        return self._sum_of_largest(self._loss * hits)

    def _most_hits(self, chain: MarkovChain) -> FloatArray:
        """Bounds (S,) of the hits, from the entries."""
        return np.asarray(np.minimum(self._entering @ chain.p, 1.0))

    def _sum_of_largest(self, losses: FloatArray) -> float:
        return float(np.sort(losses)[max(len(losses) - self._k, 0) :].sum())

    @property
    def limit(self) -> float:
        """Value at which the law is within the slack."""
        return ceiling(self._level_value, self.slack)

    @property
    def good(self) -> bool:
        """Whether the value is within the slack of the level's."""
        return within(self.value, self._level_value, self.slack)

    def round(self, q: FloatArray, prices: FloatArray, bound: float) -> bool:
        """One law within rows that are exact at p, and a step towards it; False if there is none.

        q (S,) and the prices of the budgets are the first multipliers, up to a factor.
        """
        near, aim = self._near, self.level * ceiling(1.0, AIM * self.slack) / self._loss
        if self.rounds:
            known = self._claimed[near] > 0.0
            excess = np.where(known, self._hits - self._claimed[near], 0.0)
            self._reserve[near] = np.maximum(KEPT_RESERVE * self._reserve[near], excess)
        sites = np.append(near, np.setdiff1d(self._could, near))
        rows = csr_matrix(vstack((self._rows, self._entering[sites[len(near):]])))
        for kept, most in self._limits(sites, aim[sites]):
            limits = csr_matrix(vstack((diags(1.0 / most) @ rows, self._excess)))
            start = self._start(limits, sites, q, prices, bound)
            found = maximize_entropy(self.network, limits, start, self._tolerance,
                                     self.deadline, len(sites))
            self.evaluations += found.evaluations
            if not found.infeasible:
                self._reserve *= kept
                break
        if found.infeasible or not len(found.p):
            return False
        self._before = self.multipliers, self.prices
        self.multipliers, self.prices = np.zeros(len(self._loss)), found.multipliers[len(sites) :]
        self.multipliers[sites] = found.multipliers[: len(sites)]
        whole = np.append(self.level[sites] * ceiling(1.0, self.slack) / self._loss[sites] / most,
                          np.full(len(self.prices), 1.0 / (1.0 - self._tolerance)))
        self.entropy_bound = found.log_partition + float(whole @ found.multipliers)
        self._go_towards(found.p)
        self._claimed[:] = 0.0
        self._claimed[sites] = rows @ self.chain.p
        self.rounds += 1
        return True

    def _limits(self, sites: IndexArray, aim: FloatArray) -> Iterator[tuple[float, FloatArray]]:
        """Limits (K,) of the hits to try in turn, and the share of the reserve that each keeps.

        If p costs too much, the last ones do not ask for all of the way to the aim at once: the
        rows are exact only at p.
        """
        reserve = self._reserve[sites]
        for kept in (1.0, LESS_RESERVE) if reserve.any() else ():
            yield kept, aim - np.minimum(kept * reserve, MAX_RESERVE * aim)
        yield 0.0, aim
        over = self.value / self.limit - 1.0 if self.limit else 0.0
        for share in RELAXED if over > 0.0 else ():
            yield 0.0, aim * (1.0 + share * over)

    def _start(self, limits: csr_matrix, sites: IndexArray, q: FloatArray, prices: FloatArray,
               bound: float) -> FloatArray:
        """The better of the last two rounds' multipliers; at first the ambusher's may be better.

        Rows of a chain far from the one before can ask for multipliers far from the last ones.
        """
        starts = [np.append(np.pad(v, (0, len(self._loss) - len(v)))[sites], each)
                  for v, each in ((self.multipliers, self.prices), self._before)]
        if self.rounds == 0 and q.any() and bound > 0.0:
            ambusher = np.append(q[sites] * self.level[sites], prices * self._margin) / bound
            starts[1:] = [ambusher * 2.0**k for k in range(DOUBLINGS)]
        return min(starts, key=lambda v: self.network.law(limits.T @ v)[0] + float(v.sum()))

    def _go_towards(self, newest: FloatArray) -> None:
        """Take the whole step if the value keeps to its limit, else a shorter one."""
        before, old, step = self.value, self.chain.p, self.step
        self.chain = MarkovChain(self.network, newest)
        if self.rounds == 0 or within(self._value_of(self.chain), self._level_value, self.slack):
            return
        while True:
            self.chain = MarkovChain(self.network, (1.0 - step) * old + step * newest)
            value = self._value_of(self.chain) if step > SHORTEST else 0.0
            if value <= max(ceiling(self.limit, OVERSHOOT * self.slack),
                            before + PROMISE * step * (self.limit - before)):
                return
            step /= 2.0

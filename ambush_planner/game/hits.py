# SPDX-License-Identifier: Apache-2.0
"""Expected hits of ambushes: a site hits a route at most once, however often it re-enters.

Rows of the game count entries into a site's reach. Entries are linear in p and bound the hits from
above. The hits depend on the probability law of the routes: a Markov chain, or a mixture of whole
routes. If p has cycles, its law is not known, and entries count as hits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray
from .distribution.acyclic import is_acyclic
from .distribution.chain import chain_of
from .game import Game
from .legs import Legs


class Law(Protocol):
    """Probability law of the drawn routes."""

    def meets(self, rows: csr_matrix) -> FloatArray:
        """Expected hits (K,) by sites whose discs are entered by the edges of ``rows`` (K, M)."""

    def meets_at_most(self, rows: csr_matrix) -> FloatArray:
        """An upper bound (K,) of ``meets`` that is fast to find."""

    def uses(self, edges: int) -> FloatArray:
        """Expected uses of each of the network's ``edges``."""


class EntryLaw:
    """Stand-in for the law of a p (M,) with cycles: every entry counts as a hit."""

    def __init__(self, p: FloatArray) -> None:
        self._p = p

    def meets(self, rows: csr_matrix) -> FloatArray:
        """Expected entries (K,) into the discs that the edges of ``rows`` (K, M) enter."""
        return np.asarray(rows @ self._p)

    meets_at_most = meets

    def uses(self, edges: int) -> FloatArray:
        """Expected uses of each of the network's ``edges``."""
        return self._p


class LegLaws:
    """Joint law of the routes of a trip's legs, which are drawn independently."""

    def __init__(self, legs: Legs, laws: Sequence[Law]) -> None:
        self._legs, self._laws = legs, laws

    def meets(self, rows: csr_matrix) -> FloatArray:
        """Expected hits (K,) on all legs by sites with ``rows`` (K, M)."""
        return np.asarray(sum(law.meets(leg_rows) for law, leg_rows in self._by_leg(rows)))

    def meets_at_most(self, rows: csr_matrix) -> FloatArray:
        """An upper bound (K,) of ``meets`` that is fast to find."""
        return np.asarray(sum(law.meets_at_most(leg_rows) for law, leg_rows in self._by_leg(rows)))

    def uses(self, edges: int) -> FloatArray:
        """Expected uses (M,) of the edges of all legs."""
        counts = np.diff(self._legs.first)
        return np.concatenate([law.uses(int(count))
                               for law, count in zip(self._laws, counts, strict=True)])

    def _by_leg(self, rows: csr_matrix) -> Iterator[tuple[Law, csr_matrix]]:
        return zip(self._laws, self._legs.rows_by_leg(rows), strict=True)


def joint_law(legs: Legs, laws: Sequence[Law]) -> Law:
    """Return the joint law of the routes of all legs."""
    return laws[0] if len(laws) == 1 else LegLaws(legs, laws)


def law_of(game: Game, p: FloatArray) -> Law:
    """Return the Markov chain of p (M,) if it is acyclic, else its entries as hits."""
    return chain_of(game.network, p) if is_acyclic(game.network, p) else EntryLaw(p)


def largest_product(loss: FloatArray, rows: csr_matrix, law: Law) -> tuple[float, int]:
    """Return the largest loss (K,) times expected hits by the ``rows`` (K, M), and its index.

    The index is -1 if none is positive. Hits are computed in the order of their upper bounds, only
    as far as they can exceed the largest found.
    """
    bounds = loss * law.meets_at_most(rows)
    order = np.argsort(-bounds, kind='stable')
    worst, value, done, size = -1, 0.0, 0, 1
    while done < len(order) and bounds[order[done]] > value:
        batch = order[done : done + size]
        losses = loss[batch] * law.meets(rows[batch])
        if losses.max() > value:
            value, worst = float(losses.max()), int(batch[losses.argmax()])
        done, size = done + size, 2 * size
    return value, worst


def entry_value(game: Game, p: FloatArray) -> float:
    """Return the value of p (M,) if every entry into a site's reach counts as a hit."""
    return float((game.loss[game.sites] * (game.entering @ p)).max(initial=0.0))

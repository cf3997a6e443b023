# SPDX-License-Identifier: Apache-2.0
"""Expected hits of ambushes, each route counted once however often it comes back to a site.

The rows of the game count how often a route enters a disc. Entries are linear in p and bound the
hits from above; the hits follow from how routes are drawn: from a Markov chain, or from a mixture
of whole routes. If p has cycles, its routes are not known, and every entry counts.
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
    """Return the law by which routes are drawn."""

    def meets(self, rows: csr_matrix) -> FloatArray:
        """Expected hits (K,) by sites whose discs are entered by the edges of ``rows`` (K, M)."""

    def meets_at_most(self, rows: csr_matrix) -> FloatArray:
        """An upper bound (K,) of ``meets`` that is fast to find."""

    def uses(self, edges: int) -> FloatArray:
        """Expected uses of each of the network's ``edges``."""


class Entries:
    """A strategy p (M,) with cycles: every entry counts as a hit, which is an upper bound."""

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
    """The laws of a trip's legs, whose routes are drawn one by one."""

    def __init__(self, legs: Legs, laws: Sequence[Law]) -> None:
        self._legs, self._laws = legs, laws

    def meets(self, rows: csr_matrix) -> FloatArray:
        """Expected hits (K,), added up over the legs, by the ``rows`` (K, M)."""
        return np.asarray(sum(law.meets(own) for law, own in self._by_leg(rows)))

    def meets_at_most(self, rows: csr_matrix) -> FloatArray:
        """An upper bound (K,) of ``meets`` that is fast to find."""
        return np.asarray(sum(law.meets_at_most(own) for law, own in self._by_leg(rows)))

    def uses(self, edges: int) -> FloatArray:
        """Expected uses (M,) of the edges of all legs."""
        counts = np.diff(self._legs.first)
        return np.concatenate([law.uses(int(count))
                               for law, count in zip(self._laws, counts, strict=True)])

    def _by_leg(self, rows: csr_matrix) -> Iterator[tuple[Law, csr_matrix]]:
        return zip(self._laws, self._legs.rows_by_leg(rows), strict=True)


def joint_law(legs: Legs, laws: Sequence[Law]) -> Law:
    """The law of all legs."""
    return laws[0] if len(laws) == 1 else LegLaws(legs, laws)


def law_of(game: Game, p: FloatArray) -> Law:
    """The Markov chain of p (M,) if it is acyclic, else its entries."""
    return chain_of(game.network, p) if is_acyclic(game.network, p) else Entries(p)


def largest_product(loss: FloatArray, rows: csr_matrix, law: Law) -> tuple[float, int]:
    """The largest of losses (K,) times expected hits by the ``rows`` (K, M), and its index.

    The bounds of the hits say which of them need to be computed.
    """
    bounds = loss * law.meets_at_most(rows)
    order = np.argsort(-bounds, kind='stable')
    worst, value, done, some = -1, 0.0, 0, 1
    while done < len(order) and bounds[order[done]] > value:
        own = order[done : done + some]
        losses = loss[own] * law.meets(rows[own])
        if losses.max() > value:
            value, worst = float(losses.max()), int(own[losses.argmax()])
        done, some = done + some, 2 * some
    return value, worst


def entry_value(game: Game, p: FloatArray) -> float:
    """Mean loss of the best ambush against p (M,) if every entry into a site's reach counts."""
    return float((game.loss[game.sites] * (game.entering @ p)).max(initial=0.0))

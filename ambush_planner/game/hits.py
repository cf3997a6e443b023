# SPDX-License-Identifier: Apache-2.0
"""What ambushes cost a strategy, each route counted once however often it comes back to a site.

The rows of the game count how often a route enters a disc. Entries are linear in p and bound the
hits from above; the hits follow from the strategy's Markov chain (``chain``).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..arrays import FloatArray, IndexArray
from .distribution.acyclic import is_acyclic
from .distribution.chain import chain_of
from .game import Game
from .slack import sum_of_largest


def worst_loss(game: Game, p: FloatArray) -> float:
    """What the best ambush against p (M,) costs on average: the sum of the k largest losses.

    Each route counts once per site if p is acyclic. Otherwise every entry counts, which is an upper
    bound.
    """
    return float(largest_losses(game, p)[0].sum())


def largest_losses(game: Game, p: FloatArray) -> tuple[FloatArray, IndexArray]:
    """The k largest mean losses (K,) that single sites cause, and the rows (K,) of these sites.

    The expected entries bound the hits from above, so only sites that could still be among the
    largest are computed.
    """
    k = min(game.ambushers, len(game.sites))
    losses = game.site_losses(p)
    if game.entries_are_hits or not is_acyclic(game.network, p):
        rows = np.argsort(-losses, kind='stable')[:k]
        return losses[rows], rows
    chain = chain_of(game.network, p)

    def exact(rows: IndexArray) -> FloatArray:
        return np.asarray(game.loss[game.sites[rows]] * chain.meets(game.entering[rows]))

    return largest(losses, exact, k)


def largest(bounds: FloatArray, exact: Callable[[IndexArray], FloatArray],
            k: int) -> tuple[FloatArray, IndexArray]:
    """The k largest of some numbers >= 0, and their indices.

    ``bounds`` (N,) are at least as large; ``exact`` computes the numbers of given indices, which is
    slow.
    """
    k = min(k, len(bounds))
    order = np.argsort(-bounds, kind='stable')
    order = order[bounds[order] > 0.0]
    found, least, done = np.zeros(len(bounds)), 0.0, 0
    while k and done < len(order) and bounds[order[done]] > least:
        some = order[done : 2 * done + k]  # twice as many
        found[some] = exact(some)
        done += len(some)
        least = float(np.partition(found, -k)[-k])
    some = np.argsort(-found, kind='stable')[:k]
    return found[some], some


def hit_probabilities(game: Game, p: FloatArray, rows: IndexArray | None = None) -> FloatArray:
    """P(hit) (K,) of the sites in ``rows`` (default: all) against p (M,).

    If p has cycles, every entry counts, which is an upper bound.
    """
    rows = np.arange(len(game.sites)) if rows is None else rows
    if game.entries_are_hits or not is_acyclic(game.network, p):
        return np.asarray(game.entering[rows] @ p)
    return chain_of(game.network, p).meets(game.entering[rows])


def meeting_probability(game: Game, p: FloatArray, q: FloatArray) -> float:
    """Expected number of ambushers q (N,) that a route of p (M,) meets (the paper's equation 8).

    With one ambusher this is a probability. If p has cycles, every entry counts.
    """
    at_sites = game.at_sites(q)
    rows = np.flatnonzero(at_sites > 0.0)
    return float(at_sites[rows] @ hit_probabilities(game, p, rows))


def entry_value(game: Game, p: FloatArray) -> float:
    """Mean loss of the best ambush against p (M,) if every entry into a site's reach counts."""
    return sum_of_largest(game.site_losses(p), game.ambushers)

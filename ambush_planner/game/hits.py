# SPDX-License-Identifier: Apache-2.0
"""What ambushes cost a strategy, each route counted once however often it comes back to a site.

The rows of the game count how often a route enters a disc. Entries are linear in p and bound the
hits from above; the hits follow from the strategy's Markov chain (``chain``).
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IndexArray
from .distribution.acyclic import is_acyclic
from .distribution.chain import chain_of
from .game import Game


def worst_loss(game: Game, p: FloatArray) -> float:
    """What the best ambush against p (M,) costs on average."""
    return worst_site(game, p)[0]


def worst_site(game: Game, p: FloatArray) -> tuple[float, int]:
    """Mean loss by the best ambush against p (M,), and the row of its site; -1 without a loss.

    Each route counts once per site if p is acyclic. Otherwise every entry counts, which is an upper
    bound. Entries bound the hits from above, so only sites that could still be the worst are
    computed.
    """
    losses = game.site_losses(p)
    order, found, worst, done = np.argsort(-losses, kind='stable'), 0.0, -1, 0
    if game.entries_are_hits or not is_acyclic(game.network, p):
        return float(losses.max(initial=0.0)), int(order[0]) if losses.any() else -1
    chain = chain_of(game.network, p)
    while done < len(order) and losses[order[done]] > found:
        some = order[done : 2 * done + 1]  # twice as many
        hit = game.loss[game.sites[some]] * chain.meets(game.entering[some])
        if hit.max() > found:
            found, worst = float(hit.max()), int(some[hit.argmax()])
        done += len(some)
    return found, worst


def hit_probabilities(game: Game, p: FloatArray, rows: IndexArray | None = None) -> FloatArray:
    """P(hit) (K,) of the sites in ``rows`` (default: all) against p (M,).

    If p has cycles, every entry counts, which is an upper bound.
    """
    rows = np.arange(len(game.sites)) if rows is None else rows
    if game.entries_are_hits or not is_acyclic(game.network, p):
        return np.asarray(game.entering[rows] @ p)
    return chain_of(game.network, p).meets(game.entering[rows])


def meeting_probability(game: Game, p: FloatArray, q: FloatArray) -> float:
    """P(a route of p (M,) meets the ambusher q (N,)): the paper's equation 8.

    If p has cycles, every entry counts.
    """
    at_sites = game.at_sites(q)
    rows = np.flatnonzero(at_sites > 0.0)
    return float(at_sites[rows] @ hit_probabilities(game, p, rows))


def entry_value(game: Game, p: FloatArray) -> float:
    """Mean loss of the best ambush against p (M,) if every entry into a site's reach counts."""
    return float(game.site_losses(p).max(initial=0.0))

"""The soft search: a strategy and a bound for when a program fails or may not end in time.

A law of routes whose limits on sites are soft always exists, and its multipliers are an ambusher.
Round by round the limits get harder, and value and bound approach each other (docs/theory.md,
section 4).
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from .acyclic import without_cycles
from .cut import uniform_ambusher
from .entries import entry_bound, entry_value
from .entropy_stage import EntropyStage, Solution, mixture
from .game import Game
from .least_risk import LeastRisk, least_risk_by_cut
from .limit_rows import LimitRows
from .two_routes import strategy_within_budgets

# The softness of each round.
SOFTNESS = (1e-2, 2.5e-3, 6e-4, 1.5e-4, 4e-5, 1e-5)
# Factor of the multipliers from round to round.
GROWTH = 2.0
# The limits as a share of the first strategy's value if no bound is known.
REFERENCE_SHARE = 0.05


class SoftSearch:
    """Rounds with ever harder soft limits; a second search goes on where the first one ended."""

    def __init__(self, stage: EntropyStage) -> None:
        self.stage = stage
        self.softness = list(SOFTNESS)

    def strategy(self, loose: LeastRisk | None, closed: float) -> Solution | None:
        """Search until the relative gap, in entries, is ``closed``.

        ``loose`` is the solution without budgets, if a cut gives it. The multipliers, scaled to an
        ambusher's strategy, give a bound at every step. Returns the best strategy of each side;
        None if rounding leaves no first strategy within the budgets.
        """
        stage, game, budgets = self.stage, self.stage.game, self.stage.budgets
        first = strategy_within_budgets(game, budgets)
        if first is None:
            return None
        none = (0.0,) * len(budgets)
        chain = stage.chain and stage.chain[:2]
        bound, q = (loose.bound, loose.q) if loose else chain or _ambusher_at_nodes(game)
        best, reached = Solution(first, q, none, 0), bound
        for law in stage.laws:
            best, reached = _best_of_both(stage, best, reached, law, first)
        stage.extend_law_deadline()
        network = stage.acyclic_part(game, best.p)
        level = bound / game.ambushers or REFERENCE_SHARE * entry_value(game, best.p)
        limits = LimitRows(game, network, np.full(len(game.sites), level), budgets)
        start = limits.start(best.multipliers or stage.warm)
        while self.softness and entry_value(game, best.p) > reached * (1.0 + closed):
            p, found = stage.gibbs_strategy(network, limits, start, self.softness.pop(0))
            law = Solution(p, *limits.ambusher(found.multipliers), stage.evaluations,
                           limits.unscaled(found.multipliers))
            best, reached = _best_of_both(stage, best, reached, law, first)
            start = found.multipliers * GROWTH
            if time.monotonic() > stage.law_deadline:
                break
        stage.laws.append(best)
        if reached > bound and stage.hit_bound(best.q, best.prices) < bound:
            best = replace(best, q=q, prices=none)
        return best


def _best_of_both(stage: EntropyStage, best: Solution, bound: float, law: Solution,
                  partner: FloatArray) -> tuple[Solution, float]:
    """The strategy of least value, the ambusher of greatest bound, and the bound, in entries.

    The law is mixed with its ``partner`` to fit the budgets.
    """
    game = stage.game
    reached = entry_bound(game, law.q, stage.budgets, law.prices)
    if reached > bound:
        best, bound = replace(best, q=law.q, prices=law.prices), reached
    p = mixture(law.p, partner, stage.within_budgets)
    if p is not None and entry_value(game, p) < entry_value(game, best.p):
        best = replace(best, p=without_cycles(game.network, p), iterations=law.iterations,
                       multipliers=law.multipliers)
    return best, bound


def _ambusher_at_nodes(game: Game) -> tuple[float, FloatArray]:
    """Bound and q (N,) of the plain game on the same sites, which a reach can only raise."""
    at_nodes = replace(game.options, ambush_radius=0.0, tube=0.0)
    plain = least_risk_by_cut(replace(game, options=at_nodes))
    return (plain.bound, plain.q) if plain else (0.0, uniform_ambusher(game))

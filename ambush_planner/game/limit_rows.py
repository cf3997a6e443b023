"""The limits of the entropy search: expected hits of the sites, and budgets, as rows C p <= 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack

from ..arrays import FloatArray
from .budget import Budget
from .cut import uniform_ambusher
from .entropy_search import GibbsStrategy
from .flow_program import capped_at_places
from .game import Game
from .gibbs import AcyclicNetwork

# Share of a budget's margin that the search keeps below it, unless it is given another.
KEPT_MARGIN = 1e-3
# Smallest tolerance of the search, relative to a limit.
LEAST_TOLERANCE = 1e-6
# Smallest limit of a site's hits; with several ambushers its level may be 0.
LEAST_HITS = 1e-9
# Largest multiplier, scaled to its limit, to start from, except those of a law before.
MAX_FIRST_MULTIPLIER = 300.0


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the Gibbs law: per hit of each site (N,), per unit of each budget's cost."""

    sites: FloatArray
    budgets: tuple[float, ...]


class LimitRows:
    """The limits of stage 3 as rows C p <= 1: sites that can exceed theirs, then the budgets."""

    def __init__(self, game: Game, network: AcyclicNetwork, level: FloatArray,
                 budgets: tuple[Budget, ...], kept: tuple[float, ...] | None = None) -> None:
        self._game, self._budgets = game, budgets
        hits = game.hits[:, network.edge]
        most = np.maximum(level / game.loss[game.sites], LEAST_HITS)
        self._row = np.flatnonzero((hits.getnnz(axis=1) > 0) & (most < _most_hits(game)))
        self._most = most[self._row]
        self._binding = [b for b in budgets if b.binds]
        whole = np.array([b.margin for b in self._binding])
        if kept is None:
            kept = tuple(KEPT_MARGIN * b.margin for b in budgets)
        self._margin = whole - [k for k, b in zip(kept, budgets, strict=True) if b.binds]
        self._whole = whole / self._margin
        # What the search may exceed a limit by, relative: no more than what is kept of a budget.
        self.tolerance = max(float((self._whole - 1.0).min(initial=1.0)), LEAST_TOLERANCE)
        over = [csr_matrix(b.excess[network.edge]) for b in self._binding]
        scale = np.concatenate((self._most, self._margin))
        self.rows = csr_matrix(diags(1.0 / scale) @ vstack([hits[self._row], *over]))
        edge = network.edge
        mean = np.array([float(b.cost[edge].mean()) for b in self._binding])
        self._first = np.minimum(self._margin / np.maximum(mean, 1e-300), MAX_FIRST_MULTIPLIER)

    @property
    def sites(self) -> int:
        """Number of rows of sites, which are the first."""
        return len(self._row)

    def start(self, warm: Multipliers | None,
              most: float = MAX_FIRST_MULTIPLIER) -> FloatArray:
        """Scaled multipliers (R,) to start from: those of ``warm`` unless one exceeds ``most``.

        Otherwise those of the sites are 0.
        """
        cold = np.concatenate((np.zeros(len(self._row)), self._first))
        if warm is None or len(warm.sites) != self._game.node_count:
            return cold
        sites = warm.sites[self._game.sites[self._row]] * self._most
        pairs = zip(warm.budgets, self._budgets, strict=True)
        budgets = np.array([price for price, b in pairs if b.binds]) * self._margin
        start = np.concatenate((sites, budgets))
        return start if start.max(initial=0.0) <= most else cold

    def unscaled(self, multipliers: FloatArray) -> Multipliers:
        """The scaled multipliers (R,) as multipliers per hit and per unit of cost."""
        sites = np.zeros(self._game.node_count)
        count = len(self._row)
        sites[self._game.sites[self._row]] = multipliers[:count] / self._most
        price = iter(multipliers[count:] / self._margin)
        budgets = (float(next(price)) if b.binds else 0.0 for b in self._budgets)
        return Multipliers(sites, tuple(budgets))

    def entropy_bound(self, found: GibbsStrategy, slack: float) -> float:
        """Most entropy within ``slack`` times the limits of the sites and the whole budgets."""
        limits = np.concatenate((np.full(len(self._row), slack), self._whole))
        return found.log_partition + float(found.multipliers @ limits)

    def ambusher(self, multipliers: FloatArray) -> tuple[FloatArray, tuple[float, ...]]:
        """The ambusher's strategy q (N,) and the prices in proportion to the multipliers (R,)."""
        found, game = self.unscaled(multipliers), self._game
        q = np.zeros(game.node_count)
        q[game.sites] = found.sites[game.sites] / game.loss[game.sites]
        total = float(q.sum()) / game.ambushers
        if not total > 0.0:
            return uniform_ambusher(game), (0.0,) * len(found.budgets)
        return capped_at_places(game, q / total), tuple(b / total for b in found.budgets)


def _most_hits(game: Game) -> float:
    """Largest number of hits of one site by one route; a leg may come back to a disc."""
    return (1.0 if game.reach == 0.0 else 3.0) * game.network.legs

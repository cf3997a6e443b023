"""Are departures alike in an order that an observer could use? Shared ground by lag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from .arrays import FloatArray, IndexArray, frozen_array
from .network import Network

# Two weeks of daily departures.
LONGEST_LAG = 14
# Squares in which ground is shared, as a part of the expected length: fine enough to tell
# corridors apart, coarse enough that neighbouring lines count as the same corridor.
SQUARE = 0.1
# Share of shuffled orders that leave the band of pictures anywhere.
OUTSIDE_BAND = 0.01


@dataclass(frozen=True, eq=False)
class Order:
    """Mean shared ground of departures that are k = 1..K apart.

    Attributes
    ----------
    by_lag : (K,) float
        Mean share, 0..1, of the departures that are k + 1 apart for index k.
    mean : float
        Mean share of all pairs, whatever their order.
    band : (K,) float
        ``by_lag`` stays within ``mean`` +- ``band`` at all lags in 99 % of shuffled orders.
    square : float
        Edge of the squares [m].
    statistic : float
        The largest of the standardised deviations from the mean, over the lags.
    shuffled : (B,) float
        The same of B shuffled orders.
    """

    by_lag: FloatArray
    mean: float
    band: FloatArray
    square: float
    statistic: float
    shuffled: FloatArray


def shared_ground(network: Network, routes: Sequence[IndexArray], square: float) -> FloatArray:
    """Share (n, n) of the ground that each two routes have in common, 0..1, 1 on the diagonal.

    Ground is the squares of edge ``square`` [m] that hold a node of the route; the share is twice
    the common squares over the sum of both (Dice's coefficient).
    """
    place = np.floor(network.points / max(square, np.finfo(float).tiny))
    _, index = np.unique(place, axis=0, return_inverse=True)
    nodes = np.concatenate(routes)
    owner = np.repeat(np.arange(len(routes)), [len(route) for route in routes])
    visited = csr_matrix((np.ones(len(nodes)), (owner, index.reshape(-1)[nodes])))
    visited.sum_duplicates()
    visited.data[:] = 1.0
    common = np.asarray((visited @ visited.T).toarray())
    size = np.diag(common)
    share: FloatArray = 2.0 * common / (size[:, None] + size)
    return share


def order_of(share: FloatArray, square: float, resamples: int, rng: np.random.Generator) -> Order:
    """Compare the order of departures with ``resamples`` shuffles of it.

    The statistic is ``max_k sqrt(n - k) |c_k - c| / s`` over the lags k = 1..min(14, n / 2): c_k is
    the mean share at lag k, c and s are mean and standard deviation over all pairs. Independent
    departures are exchangeable, so the recorded order is as likely as any other: the share of
    shuffles that reach the statistic gives an exact test (a permutation test), whatever the
    strategy is and whether or not the departures follow it. It finds routes that are too much
    alike at some lag (habit, rotation) and too little (avoiding yesterday's).
    """
    n = len(share)
    lags = np.arange(1, min(LONGEST_LAG, n // 2) + 1)
    orders = np.vstack((np.arange(n), rng.permuted(np.tile(np.arange(n), (resamples, 1)), axis=1)))
    means = np.stack([share[orders[:, k:], orders[:, :-k]].mean(axis=1) for k in lags], axis=1)
    pairs = share[~np.eye(n, dtype=bool)]
    mean, spread = float(pairs.mean()), float(pairs.std())
    # Departures that are all equally alike have no order.
    scale = np.sqrt(n - lags) / spread if spread > 1e-9 else np.zeros(len(lags))
    statistics = (np.abs(means - mean) * scale).max(axis=1)
    reach = float(np.quantile(statistics[1:], 1.0 - OUTSIDE_BAND))
    return Order(
        by_lag=frozen_array(means[0], np.float64),
        mean=mean,
        band=frozen_array(reach * spread / np.sqrt(n - lags), np.float64),
        square=square,
        statistic=float(statistics[0]),
        shuffled=frozen_array(statistics[1:], np.float64),
    )

"""The statistics of sets of departures: the recorded one, and drawn ones to compare it with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IndexArray
from .audit_draws import ManyRoutes, Steps
from .audit_places import Ground

# Two weeks of daily departures.
LONGEST_LAG = 14
# Share of draws that leave the band of the picture anywhere.
OUTSIDE_BAND = 0.01
# How many bits are set in each number of 16 bits.
_BITS = np.unpackbits(
    np.arange(2**16, dtype=np.uint16).view(np.uint8).reshape(-1, 2), axis=1
).sum(axis=1, dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Order:
    """Mean shared ground of departures that are k = 1..K apart, each (K,), 0..1.

    ``expected`` is its mean over the draws, ``mean`` that over all k; ``by_lag`` less ``mean``
    stays within ``band`` of its expectation at all lags in 99 % of draws; ``square`` [m].
    """

    by_lag: FloatArray
    expected: FloatArray
    band: FloatArray
    mean: float
    square: float


class Tallies:
    """What is counted of each set of departures: the recorded one first, then the drawn ones."""

    def __init__(self, departures: int, sets: int, ground: Ground) -> None:
        self._ground = ground
        self.passages = np.zeros((sets, len(ground.segments)), np.uint16)
        self.surprise = np.zeros(sets)
        # A route is known by the sum of its inner edges' numbers: 64 random bits each.
        self._numbers = np.random.default_rng([1, 0]).integers(
            0, 2**64, len(ground.segments), dtype=np.uint64
        )
        self.known = np.zeros((departures, sets), np.uint64)
        # A bit for each square, 16 at a time.
        self._ground_bits = np.zeros((departures, -(-ground.squares // 16), sets), np.uint16)

    def add(
        self, k: int, many: ManyRoutes, members: IndexArray, sets: slice, steps: Steps
    ) -> None:
        """Count sets of the departures ``members`` of strategy k, one set after the other."""
        n, count = len(members), sets.stop - sets.start
        place = self._ground.of_edge[k][steps.edge]
        places = len(self._ground.segments)
        cell = (steps.route // n) * places + place
        np.add.at(self.passages[sets].reshape(-1), cell, np.uint16(1))
        surprise = np.bincount(
            steps.route // n, weights=many.surprise[steps.edge], minlength=count
        )
        self.surprise[sets] += surprise - n * many.entropy
        inner = self._ground.inner[k][steps.edge]
        known = np.zeros(steps.count, np.uint64)
        np.add.at(known, steps.route[inner], self._numbers[place[inner]])
        self.known[members, sets] = known.reshape(count, n).T
        words = self._ground_bits.shape[1]
        crossed = np.zeros((steps.count, 16 * words), bool)
        square = self._ground.of_node[k]
        crossed[:, square[many.network.source]] = True
        crossed[steps.route, square[many.network.heads[steps.edge]]] = True
        bits = np.packbits(crossed, axis=1).view(np.uint16).reshape(count, n, words)
        self._ground_bits[members, :, sets] = bits.transpose(1, 2, 0)

    def frequency(self, expected: FloatArray, variance: FloatArray) -> FloatArray:
        """The statistic ``frequency`` of each set."""
        found = np.empty(len(self.passages))
        for begin in range(0, len(found), 256):
            part = slice(begin, begin + 256)
            found[part] = ((self.passages[part] - expected) ** 2 / (variance + 1.0)).sum(axis=1)
        return found

    def order(self) -> FloatArray:
        """Mean shared ground by lag of each set (B + 1, K).

        The share of two departures is twice the common squares over the sum of both (Dice).
        """
        bits = self._ground_bits
        size = np.array([_set_bits(each) for each in bits])
        n = len(bits)
        lags = range(1, min(LONGEST_LAG, n // 2) + 1)
        means = np.zeros((bits.shape[2], len(lags)))
        for column, lag in enumerate(lags):
            for i in range(n - lag):
                common = _set_bits(bits[i] & bits[i + lag])
                means[:, column] += 2.0 * common / np.maximum(size[i] + size[i + lag], 1)
            means[:, column] /= n - lag
        return means


def _set_bits(words: npt.NDArray[np.uint16]) -> npt.NDArray[np.int32]:
    """How many bits are set in each column of words (W, B)."""
    return _BITS[words].sum(axis=0, dtype=np.int32)


def deviations(means: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far each lag's share is off the set's own mean over lags, less what draws have there.

    In standard deviations (B + 1, K), and the band of the picture (K,). Mean and deviation are
    taken over all sets, the recorded one too, so that it stays exchangeable with the others.
    """
    centred = means - means.mean(axis=1, keepdims=True)
    off = centred - centred.mean(axis=0)
    spread = off.std(axis=0)
    # Departures that are all equally alike have no order.
    standard = np.where(spread > 1e-9, off / np.maximum(spread, 1e-9), 0.0)
    reach = float(np.quantile(np.abs(standard[1:]).max(axis=1), 1.0 - OUTSIDE_BAND))
    return standard, reach * spread


def identical_pairs(known: np.ndarray) -> FloatArray:
    """Number of pairs of equal numbers in each row (R, n)."""
    ordered = np.sort(known, axis=1)
    pairs = np.zeros(len(known))
    for apart in range(1, known.shape[1]):
        equal = (ordered[:, apart:] == ordered[:, :-apart]).sum(axis=1)
        if not equal.any():
            break
        pairs += equal
    return pairs

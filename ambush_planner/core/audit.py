"""Testing the departures of one strategy together: do they follow it, and do they show patterns?

Under the hypothesis that all is well, departures are independent draws of a Markov chain on an
acyclic network: from node i the next edge is (i, j) with probability p_ij / x_i. Four statistics
are each compared with what such departures give, and all p-values are exact for any number of
departures: (1 + #{T* >= T}) / (B + 1) over B resamples, each a whole set of as many departures
drawn from the published strategy itself (three tests) or a shuffle of the recorded order (one
test); seed and B are fixed. Holm's method holds the chance of any false finding, over all four
tests, to the stated rate.

``frequency``
    ``T = sum_e (N_e - n p_e)^2 / (n p_e (1 - p_e) + 1)`` over the edges: Pearson's statistic of
    the passages N_e, which are binomial but dependent, so that it has no chi-square law here.
    The 1 in the denominator keeps edges that hardly anybody drives from ruling the sum; with many
    departures it does not matter. T grows without bound whenever any edge's frequency is off.
``surprise``
    ``T = |sum_r -ln P(r) - n H|``: the routes' surprise against the route entropy H. Finds
    routes that are all too likely, or all too unlikely, long before single edges show it.
``order``
    Serial correlation of the shared ground; see ``audit_order``.
``repeats``
    Number of pairs of departures on the very same route, against n (n - 1) / 2 sum_r P(r)^2.

A G or Pearson statistic of the choices at each node, given how often the node was visited, does
have a chi-square law in the limit; but while most nodes are visited once it does not see where
the routes lie: departures that all take the likeliest route make it smaller, not larger.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from .arrays import FloatArray, IndexArray, frozen_array
from .audit_draws import ManyRoutes, NotAuditable, Steps, recorded_steps
from .audit_learning import Learning, learning_from
from .audit_order import SQUARE, Order, order_of, shared_ground
from .errors import InvalidOption
from .game import Game

# With fewer, hardly anything but one route driven again and again would be found.
FEWEST_DEPARTURES = 5
FALSE_ALARM_RATE = 0.01
TESTS = ("frequency", "surprise", "order", "repeats")
SEED = 1
# Resamples B: (B + 1) is a multiple of what the default rate and its parts divide evenly.
LEAST_RESAMPLES = 3999
# More take minutes a strategy; a rate that needs more cannot be held against, see ``Audit.blind``.
MOST_RESAMPLES = 99_999
# Rounding: statistics this near to each other, relative or a departure, are equal.
TIE = 1e-9


@dataclass(frozen=True)
class Verdict:
    """One statistic: as recorded, its mean over the resamples, p-value, and whether it is found.

    ``finding``: the p-value is too small for chance, by Holm's method over all tests.
    """

    observed: float
    expected: float
    p_value: float
    finding: bool


@dataclass(frozen=True, eq=False)
class Audit:
    """What the departures of one strategy show.

    Attributes
    ----------
    departures, different : int
        How many there are, and how many different routes among them.
    impossible : int
        Steps and ends of routes that the strategy cannot have drawn; over 0 is a finding that
        needs no test.
    tests : mapping of name to Verdict
        By the names ``TESTS``.
    passages : (M,) int
        How often each edge was driven.
    mean_surprise : float
        Mean of -ln P(r) of the recorded routes [nats]; the route entropy is what it should be.
    false_alarm_rate : float
        Chance that departures which do follow the strategy lead to any finding, at most.
    resamples : int
        B, in each test.
    order : Order
    learning : Learning
    """

    departures: int
    different: int
    impossible: int
    tests: Mapping[str, Verdict]
    passages: IndexArray
    mean_surprise: float
    false_alarm_rate: float
    resamples: int
    order: Order
    learning: Learning

    @property
    def blind(self) -> bool:
        """Whether the rate is so low that ``MOST_RESAMPLES`` cannot give any test a finding."""
        return 1.0 / (self.resamples + 1) > self.false_alarm_rate / len(TESTS)

    @property
    def findings(self) -> tuple[str, ...]:
        """Names of the tests that found something, 'impossible' first; empty: nothing."""
        certain = ("impossible",) if self.impossible else ()
        return certain + tuple(name for name, test in self.tests.items() if test.finding)


def audit(
    game: Game,
    p: FloatArray,
    routes: Sequence[IndexArray],
    false_alarm_rate: float = FALSE_ALARM_RATE,
) -> Audit:
    """Test departures against the strategy that they were drawn from.

    Parameters
    ----------
    game
        The network and its sites; the losses matter for ``learning`` only.
    p : (M,)
        The published strategy, without cycles.
    routes : n >= 5 arrays (K,)
        Node indices of each departure's route, in the order of time.
    false_alarm_rate
        Chance of any finding when all is well, at most. Below 4e-5, 100 000 resamples are too few
        for a finding by the tests (``Audit.blind``).

    Raises
    ------
    NotAuditable
        The strategy has cycles, or there are fewer than ``FEWEST_DEPARTURES`` departures.
    InvalidOption
        The rate is not over 0 and at most 0.5.
    """
    if not 0.0 < false_alarm_rate <= 0.5:
        raise InvalidOption(
            f"the false alarm rate must be over 0 and at most 0.5, got {false_alarm_rate}"
        )
    if len(routes) < FEWEST_DEPARTURES:
        raise NotAuditable(
            f"{len(routes)} departures are too few to tell; at least {FEWEST_DEPARTURES} are needed"
        )
    network = game.network
    many = ManyRoutes(network, p)
    steps, impossible = recorded_steps(network, p, routes)
    resamples = _resamples(false_alarm_rate)
    square = SQUARE * float(p @ network.lengths)
    order = order_of(
        shared_ground(network, routes, square), square, resamples, np.random.default_rng([SEED, 1])
    )
    n = len(routes)
    recorded, drawn = _against_draws(many, p, steps, resamples)
    found = {
        "frequency": _compared(recorded[0], drawn[0], n),
        "surprise": _compared(recorded[1], drawn[1], n),
        "order": _compared(order.statistic, order.shuffled, n),
        "repeats": _compared(recorded[2], drawn[2], n),
    }
    passages = np.bincount(steps.edge, minlength=len(p))
    driven = passages > 0
    return Audit(
        departures=n,
        different=len({np.asarray(route, dtype=np.int64).tobytes() for route in routes}),
        impossible=impossible,
        tests=_judged(found, false_alarm_rate),
        passages=frozen_array(passages, np.int64),
        mean_surprise=float(-(passages[driven] @ np.log(many.choice[driven]))) / n,
        false_alarm_rate=false_alarm_rate,
        resamples=resamples,
        order=order,
        learning=learning_from(game, p, many, steps),
    )


def _resamples(rate: float) -> int:
    """Enough that the smallest p-value possible is a finding, up to ``MOST_RESAMPLES``."""
    if rate * (MOST_RESAMPLES + 1) <= len(TESTS):
        return MOST_RESAMPLES
    return max(LEAST_RESAMPLES, math.ceil(len(TESTS) / rate) - 1)


def _against_draws(
    many: ManyRoutes, p: FloatArray, steps: Steps, resamples: int
) -> tuple[FloatArray, FloatArray]:
    """Frequency, surprise and repeats: as recorded (3,), and of each resample (3, B)."""
    rng = np.random.default_rng([SEED, 0])
    # A route is known by the sum of its edges' numbers: 64 random bits each, modulo 2^64.
    numbers = rng.integers(0, 2**64, len(p), dtype=np.uint64)
    drawn = [
        _statistics(many, p, numbers, part, sets)
        for sets, part in many.draw_sets(steps.count, resamples, rng)
    ]
    return _statistics(many, p, numbers, steps, 1)[:, 0], np.concatenate(drawn, axis=1)


def _statistics(
    many: ManyRoutes, p: FloatArray, numbers: np.ndarray, steps: Steps, sets: int
) -> FloatArray:
    """The three statistics (3, sets) of sets of departures that follow each other in ``steps``."""
    n = steps.count // sets
    of_used = np.zeros(len(p), dtype=np.int64)
    of_used[many.used] = np.arange(len(many.used))
    used, share = len(many.used), p[many.used]
    cell = (steps.route // n) * used + of_used[steps.edge]
    passages = np.bincount(cell, minlength=sets * used).reshape(sets, used)
    # Rounding may leave a p a little over 1.
    variance = n * share * np.maximum(1.0 - share, 0.0)
    frequency = ((passages - n * share) ** 2 / (variance + 1.0)).sum(axis=1)
    surprise = -np.log(many.choice[many.used])
    surprised = np.abs(passages @ surprise - n * float(share @ surprise))
    known = np.zeros(steps.count, dtype=np.uint64)
    np.add.at(known, steps.route, numbers[steps.edge])
    return np.stack((frequency, surprised, identical_pairs(known.reshape(sets, n))))


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


def _compared(recorded: float, resampled: FloatArray, n: int) -> tuple[float, float, float]:
    """The statistic as recorded, its mean otherwise, and the chance of at least the recorded one.

    The chance is exact under the hypothesis, as the recorded set is exchangeable with the others.
    """
    nearly = recorded - TIE * max(abs(recorded), n)
    reached = int((resampled >= nearly).sum())
    return float(recorded), float(resampled.mean()), (1 + reached) / (1 + len(resampled))


def _judged(
    found: Mapping[str, tuple[float, float, float]], rate: float
) -> Mapping[str, Verdict]:
    """Holm: the k-th smallest p-value (k = 0, 1, ...) is held against rate / (tests - k)."""
    names = sorted(found, key=lambda name: found[name][2])
    findings = set()
    for k, name in enumerate(names):
        if found[name][2] > rate / (len(names) - k):
            break
        findings.add(name)
    return MappingProxyType({
        name: Verdict(*compared, name in findings) for name, compared in found.items()
    })

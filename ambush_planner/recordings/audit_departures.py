"""Departures tested together, each under its own strategy: do they follow it, show patterns?

Under the hypothesis that all is well, each departure is an independent draw of a Markov chain on
the acyclic network of its own strategy: from node i the next edge is (i, j) with probability
p_ij / x_i. Four statistics of all departures are each compared with what such departures give:
B times, one route is drawn for each departure from its strategy. The p-values are exact for any
number of departures and strategies, (1 + #{T* >= T}) / (B + 1); seed and B are fixed. Holm's
method holds the chance of any false finding, over all four tests, to the stated rate. A start
that moves a little makes new strategies, not new ground: edges and squares count by place.
Departures that were drawn as a day's distinct ones (``routes.days``) are compared with such draws.

``frequency``
    ``T = sum_e (N_e - E_e)^2 / (V_e + 1)`` over the places of edges, with N_e passages where the
    strategies expect E_e with the variance V_e: Pearson's statistic of counts that are dependent,
    so that it has no chi-square law here. The 1 keeps edges that hardly anybody drives from
    ruling the sum. T grows without bound whenever any place's frequency is off.
``surprise``
    ``T = |sum_r (-ln P(r) - H)|``: the routes' surprise against the route entropies. Finds
    routes that are all too likely, or all too unlikely, long before single edges show it.
``order``
    Shared ground of departures k apart, k = 1..14: by how much its mean c_k differs from the mean
    over all k, standardised with the draws; the largest over k. Finds habit, rotation, and the
    avoidance of yesterday's ground.
``repeats``
    Number of pairs of departures on the very same route between the ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ..arrays import FloatArray, IndexArray, frozen_array
from ..errors import InvalidOption
from .audit_draws import NotAuditable
from .audit_groups import Driven, expected_by_law, expected_of_sets, groups_of, owners
from .audit_learning import Learning, learning_from
from .audit_places import ground_of
from .audit_tallies import Order, Tallies, deviations, identical_pairs

# With fewer, hardly anything but one route driven again and again would be found.
FEWEST_DEPARTURES = 5
FALSE_ALARM_RATE = 0.01
TESTS = ('frequency', 'surprise', 'order', 'repeats')
SEED = 1
# Resamples B, with few strategies and with many (each is a draw of its own); both can give a
# finding at the default rate.
RESAMPLES, RESAMPLES_OF_MANY, MANY, MANY_PLACES = 3999, 999, 25, 25_000
# A smaller one takes more resamples than anybody waits for.
LEAST_RATE = 0.001
# Rounding: statistics this near to each other, relative or a departure, are equal.
TIE = 1e-9


@dataclass(frozen=True)
class Test:
    """One statistic: as recorded, its mean over the draws, p-value, and whether it is found.

    ``finding``: the p-value is too small for chance, by Holm's method over all tests.
    """

    observed: float
    expected: float
    p_value: float
    finding: bool


@dataclass(frozen=True, eq=False)
class Audit:
    """What departures show together.

    Attributes
    ----------
    departures, strategies, different : int
        How many there are, of how many strategies, and how many different routes among them.
    impossible : int
        Steps and ends of routes that their strategies cannot have drawn; over 0 is a finding that
        needs no test.
    tests : mapping of name to Test
        By the names ``TESTS``.
    segments, passages, expected : (C, 2, 2), (C,), (C,)
        Each place of an edge: from where to where [m], how often it was driven, and how often
        that is expected.
    mean_surprise, mean_entropy : float
        Mean of -ln P(r) of the recorded routes, and what it should be [nats].
    false_alarm_rate : float
        Chance that departures which do follow their strategies lead to any finding, at most.
    resamples : int
        B.
    order : Order
    learning : Learning
    """

    departures: int
    strategies: int
    different: int
    impossible: int
    tests: Mapping[str, Test]
    segments: FloatArray
    passages: IndexArray
    expected: FloatArray
    mean_surprise: float
    mean_entropy: float
    false_alarm_rate: float
    resamples: int
    order: Order
    learning: Learning

    @property
    def findings(self) -> tuple[str, ...]:
        """Names of the tests that found something, 'impossible' first; empty: nothing."""
        certain = ('impossible',) if self.impossible else ()
        return certain + tuple(name for name, test in self.tests.items() if test.finding)


def audit(
    departures: Sequence[Driven],
    false_alarm_rate: float = FALSE_ALARM_RATE,
    progress: Callable[[float], None] = lambda share: None,
) -> Audit:
    """Test departures against the strategies that they were drawn from.

    Parameters
    ----------
    departures
        At least 5, in the order of time; those of one strategy share the object.
    false_alarm_rate
        Chance of any finding when all is well, at most; from 0.001 to 0.5.
    progress
        Called with how much is done, 0..1.

    Raises
    ------
    NotAuditable
        A strategy has cycles, there are fewer than ``FEWEST_DEPARTURES`` departures, or those of
        a day have several strategies.
    NotDistinct
        A strategy leaves no room for as many distinct routes as a day has.
    InvalidOption
        The rate is out of range.
    """
    if not LEAST_RATE <= false_alarm_rate <= 0.5:
        raise InvalidOption(
            f'the false alarm rate must be from {LEAST_RATE} to 0.5, got {false_alarm_rate}'
        )
    if len(departures) < FEWEST_DEPARTURES:
        raise NotAuditable(
            f'{len(departures)} departures are too few to tell; at least {FEWEST_DEPARTURES} are '
            'needed'
        )
    groups = groups_of(departures)
    ground = ground_of(
        [group.many for group in groups],
        float(np.mean([each.strategy.expected_length for each in departures])),
    )
    resamples = _resamples(false_alarm_rate, len(groups), len(ground.segments))
    # Set 0 is the recorded one, the others are drawn.
    tallies = Tallies(len(departures), resamples + 1, ground)
    rng = np.random.default_rng(SEED)
    impossible, steps = 0, []
    for k, group in enumerate(groups):
        routes = [departures[i].route for i in group.indices]
        recorded, wrong = group.many.recorded(routes)
        impossible += wrong + group.not_distinct(routes)
        steps.append(recorded)
        tallies.add(k, group.many, group.indices, slice(0, 1), recorded)
        for sets, drawn in group.draw_sets(resamples, rng):
            behind = slice(sets.start + 1, sets.stop + 1)
            tallies.add(k, group.many, group.indices, behind, drawn)
            progress((k + sets.stop / resamples) / len(groups))
    expected, variance = expected_by_law(groups, ground)
    surprise = tallies.surprise
    if any(group.days for group in groups):
        # Days have no law of single departures: what all sets have on average takes its place.
        expected, variance = expected_of_sets(tallies.passages)
        surprise = surprise - surprise.mean()
    by_lag = tallies.order()
    standard, band = deviations(by_lag)
    n = len(departures)
    found = {
        'frequency': _compared(tallies.frequency(expected, variance), n),
        'surprise': _compared(np.abs(surprise), n),
        'order': _compared(np.abs(standard).max(axis=1), n),
        'repeats': _compared(identical_pairs(tallies.known.T), n),
    }
    entropy = float(np.mean([groups[k].many.entropy for k in owners(groups, n)]))
    return Audit(
        departures=n,
        strategies=len(groups),
        different=len(np.unique(tallies.known[:, 0])),
        impossible=impossible,
        tests=_judged(found, false_alarm_rate),
        segments=frozen_array(ground.segments, np.float64),
        passages=frozen_array(tallies.passages[0], np.int64),
        expected=frozen_array(expected, np.float64),
        mean_surprise=float(tallies.surprise[0]) / n + entropy,
        mean_entropy=entropy + float(tallies.surprise[0] - surprise[0]) / n,
        false_alarm_rate=false_alarm_rate,
        resamples=resamples,
        order=Order(
            frozen_array(by_lag[0], np.float64),
            frozen_array(by_lag[1:].mean(axis=0), np.float64),
            frozen_array(band, np.float64),
            float(by_lag[0].mean()),
            ground.square,
        ),
        learning=learning_from(
            [(group.many, group.strategy) for group in groups],
            owners(groups, n), steps, [group.indices for group in groups],
        ),
    )


def _resamples(rate: float, strategies: int, places: int) -> int:
    """Enough that the smallest p-value possible is a finding."""
    many = strategies > MANY or places > MANY_PLACES
    least = RESAMPLES_OF_MANY if many else RESAMPLES
    return max(least, math.ceil(len(TESTS) / rate) - 1)


def _compared(statistics: FloatArray, n: int) -> tuple[float, float, float]:
    """The statistic as recorded (first), its mean otherwise, and the chance of at least that.

    The chance is exact under the hypothesis, as the recorded set is exchangeable with the others.
    """
    recorded, drawn = float(statistics[0]), statistics[1:]
    reached = int((drawn >= recorded - TIE * max(abs(recorded), n)).sum())
    return recorded, float(drawn.mean()), (1 + reached) / (1 + len(drawn))


def _judged(found: Mapping[str, tuple[float, float, float]], rate: float) -> Mapping[str, Test]:
    """Holm: the k-th smallest p-value (k = 0, 1, ...) is held against rate / (tests - k)."""
    names = sorted(found, key=lambda name: found[name][2])
    findings = set()
    for k, name in enumerate(names):
        if found[name][2] > rate / (len(names) - k):
            break
        findings.add(name)
    return MappingProxyType({
        name: Test(*compared, name in findings) for name, compared in found.items()
    })

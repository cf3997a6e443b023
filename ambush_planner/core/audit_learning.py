"""What an observer learns from departures: how soon routes repeat, and what waiting brings him."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from .arrays import FloatArray, frozen_array, sums
from .audit_draws import ManyRoutes, Steps
from .game import Game

# An observer has learnt where to wait when he causes this share of the strategy's value.
LEARNT = 0.9


@dataclass(frozen=True, eq=False)
class Learning:
    """What an observer of n departures knows and gains. Losses are means a departure.

    Attributes
    ----------
    value : float
        z: the loss by an ambusher who knows the strategy; observing cannot bring more.
    effective_routes : float
        exp(route entropy): as hard to guess as this many equally likely routes.
    repeat_probability : float
        Probability that two departures of the strategy take the very same route, sum of P(r)^2.
    seen_probability : float
        Probability that the next departure takes one of the recorded routes again: the sum of
        P(r) over the different ones, each exp(-surprise). A route that cannot be drawn adds 0.
    departures_to_repeat : float
        So many departures until one pair of identical routes is expected: the least n with
        n (n - 1) / 2 * repeat_probability >= 1 (inf where that is beyond floating point).
    loss_after : (n,) float
        Loss, by the strategy's own probabilities, at the place where an observer of the first
        k + 1 departures would wait: where waiting would have cost these departures most.
    departures_to_learn : int or None
        From so many observed departures on, ``loss_after`` stayed at or over ``LEARNT`` times the
        value; None: not within these departures.
    ambushes : int
        How many of the n - 1 departures after the first he would have met by observing and waiting
        at once (fictitious play): at each he waits where the earlier ones say.
    ambusher_loss : float
        What that would have cost, mean over these n - 1. He chooses before the route is drawn, so
        the expectation of this is at most the value, however he chooses.
    ambusher_error : float
        Standard error of that mean: chance moves it by about this.
    fixed_loss : float
        The same had one of the recorded routes been driven every time; mean over these routes.
    """

    value: float
    effective_routes: float
    repeat_probability: float
    seen_probability: float
    departures_to_repeat: float
    loss_after: FloatArray
    departures_to_learn: int | None
    ambushes: int
    ambusher_loss: float
    ambusher_error: float
    fixed_loss: float


def learning_from(game: Game, p: FloatArray, many: ManyRoutes, steps: Steps) -> Learning:
    """Follow an observer through the departures ``steps`` of the strategy ``p``.

    Ties between places are his to break; he takes the one with the lowest index.
    """
    hits = csr_matrix(steps.incidence(len(p)) @ game.hits.T)
    true = game.site_losses(p)
    value = float(true.max(initial=0.0))
    losses = hits.multiply(game.loss[game.sites]).tocsr()
    after, caused = _observe(losses, true)
    repeat = repeat_probability(many, game)
    return Learning(
        value=value,
        effective_routes=_exp(_route_entropy(many, p)),
        repeat_probability=repeat,
        seen_probability=seen_probability(many, game, steps),
        departures_to_repeat=_until_pair(repeat),
        loss_after=frozen_array(after, np.float64),
        departures_to_learn=_settled(after >= LEARNT * value),
        ambushes=int(np.count_nonzero(caused)),
        ambusher_loss=float(caused.mean()),
        ambusher_error=float(caused.std() / math.sqrt(len(caused))),
        fixed_loss=_mean_of_largest(losses),
    )


def repeat_probability(many: ManyRoutes, game: Game) -> float:
    """Sum of P(r)^2 over all routes r of the strategy.

    Two routes that stand together at node i stay together to the end with probability
    c_i = sum_j (p_ij / x_i)^2 c_j, c = 1 at the target; wanted is c at the source. The sweep is
    repeated until nothing changes: as often as the longest route has edges, as there is no cycle.
    """
    network = game.network
    tails, heads = network.tails[many.used], network.heads[many.used]
    square = many.choice[many.used] ** 2
    together = np.zeros(game.node_count)
    while True:
        together[network.target] = 1.0
        following = sums(tails, square * together[heads], game.node_count)
        following[network.target] = 1.0
        if np.array_equal(following, together):
            return float(together[network.source])
        together = following


def seen_probability(many: ManyRoutes, game: Game, steps: Steps) -> float:
    """Sum of P(r) over the different routes r in ``steps`` that lead from source to target."""
    network = game.network
    bounds = np.searchsorted(steps.route, np.arange(1, steps.count))
    seen = {}
    for edges in np.split(steps.edge, bounds):
        reached = np.concatenate(([network.source], network.heads[edges]))
        if np.array_equal(reached, np.concatenate((network.tails[edges], [network.target]))):
            seen[edges.tobytes()] = math.exp(float(np.log(many.choice[edges]).sum()))
    return min(1.0, math.fsum(seen.values()))


def _route_entropy(many: ManyRoutes, p: FloatArray) -> float:
    used = many.used
    return float(-(p[used] * np.log(many.choice[used])).sum())


def _observe(losses: csr_matrix, true: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Loss after each departure, and loss caused at each from the second on.

    Row k of ``losses`` (n, S): what waiting at each site would have cost departure k.
    """
    count, sites = losses.shape
    after, caused = np.zeros(count), np.zeros(count - 1)
    if sites == 0:
        return after, caused
    seen = np.zeros(sites)
    for k in range(count):
        loss = losses[k].toarray().reshape(-1)
        if k > 0:
            caused[k - 1] = loss[np.argmax(seen)]
        seen += loss
        after[k] = true[np.argmax(seen)]
    return after, caused


def _mean_of_largest(losses: csr_matrix) -> float:
    return float(losses.max(axis=1).toarray().mean()) if losses.shape[1] else 0.0


def _settled(reached: np.ndarray) -> int | None:
    """First number of departures from which on all is True; None if the last is not."""
    missed = np.flatnonzero(~reached)
    first = int(missed[-1]) + 1 if len(missed) else 0
    return first + 1 if first < len(reached) else None


def _until_pair(repeat: float) -> float:
    """Least n with n (n - 1) / 2 * repeat >= 1."""
    if repeat <= 0.0:
        return math.inf
    n = math.ceil(0.5 + math.sqrt(0.25 + 2.0 / repeat))
    # Rounding may have pushed the root over a whole number.
    return float(n - 1 if (n - 1) * (n - 2) * repeat >= 2.0 else n)


def _exp(entropy: float) -> float:
    return math.exp(entropy) if entropy < 700.0 else math.inf

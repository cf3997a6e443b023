"""What an observer learns from departures: how soon routes repeat, and what waiting brings him."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import FloatArray, IndexArray, frozen_array, sums
from ..game.strategy import Strategy
from .audit_draws import ManyRoutes, Steps
from .audit_places import SAME_PLACE, numbered

# An observer has learnt where to wait when he causes this share of the strategies' value.
LEARNT = 0.9


@dataclass(frozen=True, eq=False)
class Learning:
    """What an observer of n departures knows and gains. Losses are means a departure.

    Attributes
    ----------
    value : float
        Mean of z: the loss by an ambusher who knows the strategies; observing brings no more.
    effective_routes : float
        exp(mean route entropy): as hard to guess as this many equally likely routes.
    departures_to_repeat : float
        So many departures until one pair of identical routes is expected: the least n with
        n (n - 1) / 2 * sum P(r)^2 >= 1, the sum being the mean over the strategies (inf where
        that is beyond floating point).
    loss_after : (n,) float
        Loss, by the strategy that then holds, at the place where an observer of the first k + 1
        departures would wait: where waiting would have cost these departures most.
    departures_to_learn : int or None
        From so many observed departures on, ``loss_after`` stayed at or over ``LEARNT`` times the
        value; None: not within these departures.
    ambushes : int
        How many of the n - 1 departures after the first he would have met by observing and waiting
        at once (fictitious play): at each he waits where the earlier ones say.
    ambusher_loss : float
        What that would have cost, mean over these n - 1. He chooses before the route is drawn, so
        the expectation of this is at most the value, however he chooses.
    fixed_loss : float
        The same had one of the recorded routes been driven every time; mean over these routes.
    """

    value: float
    effective_routes: float
    departures_to_repeat: float
    loss_after: FloatArray
    departures_to_learn: int | None
    ambushes: int
    ambusher_loss: float
    fixed_loss: float


def learning_from(
    strategies: Sequence[tuple[ManyRoutes, Strategy]],
    owner: IndexArray,
    steps: Sequence[Steps],
    members: Sequence[IndexArray],
) -> Learning:
    """Follow an observer through departures.

    Parameters
    ----------
    strategies
        Each with its walkers.
    owner
        Which of them each departure (n,) was drawn from.
    steps, members
        A strategy an entry: the steps of its departures, and which departures these are.

    Ties between places are his to break; he takes one, always the same.
    """
    losses, true = _by_place(strategies, steps, members, len(owner))
    values = np.array([strategy.value for _, strategy in strategies])[owner]
    value = float(values.mean())
    after, caused = _observe(losses, true, owner)
    repeat = float(np.mean(np.array([repeat_probability(many) for many, _ in strategies])[owner]))
    entropy = float(np.mean(np.array([many.entropy for many, _ in strategies])[owner]))
    return Learning(
        value=value,
        effective_routes=math.exp(entropy) if entropy < 700.0 else math.inf,
        departures_to_repeat=_until_pair(repeat),
        loss_after=frozen_array(after, np.float64),
        departures_to_learn=_settled(after >= LEARNT * values),
        ambushes=int(np.count_nonzero(caused)),
        ambusher_loss=float(caused.mean()),
        fixed_loss=float(losses.max(axis=1).toarray().mean()) if losses.shape[1] else 0.0,
    )


def repeat_probability(many: ManyRoutes) -> float:
    """Sum of P(r)^2 over all routes r of the strategy.

    Two routes that stand together at node i stay together to the end with probability
    c_i = sum_j (p_ij / x_i)^2 c_j, c = 1 at the target; wanted is c at the source. The sweep is
    repeated until nothing changes: as often as the longest route has edges, as there is no cycle.
    """
    network, count = many.network, len(many.network.points)
    tails, heads = network.tails[many.used], network.heads[many.used]
    square = many.choice[many.used] ** 2
    together = np.zeros(count)
    while True:
        together[network.target] = 1.0
        following = sums(tails, square * together[heads], count)
        following[network.target] = 1.0
        if np.array_equal(following, together):
            return float(together[network.source])
        together = following


def _by_place(
    strategies: Sequence[tuple[ManyRoutes, Strategy]],
    steps: Sequence[Steps],
    members: Sequence[IndexArray],
    count: int,
) -> tuple[csr_matrix, list[csr_matrix]]:
    """What waiting at each place costs each departure (n, P), and each strategy on average.

    The sites of different strategies are one place where they are as near as ``SAME_PLACE``.
    """
    games = [strategy.game for _, strategy in strategies]
    points = [game.network.points[game.sites] for game in games]
    number = numbered(np.rint(np.concatenate(points) / SAME_PLACE))
    known = int(number.max(initial=-1)) + 1
    places = np.split(number, np.cumsum([len(each) for each in points])[:-1])
    rows, columns, data, true = [], [], [], []
    for game, (many, _), step, who, place in zip(
        games, strategies, steps, members, places, strict=True
    ):
        shape = (step.count, len(many.p))
        driven = csr_matrix((np.ones(len(step.edge)), (step.route, step.edge)), shape=shape)
        cost = (csr_matrix(driven @ game.hits.T).multiply(game.loss[game.sites])).tocoo()
        rows.append(who[cost.row])
        columns.append(place[cost.col])
        data.append(cost.data)
        true.append(csr_matrix(
            (game.site_losses(many.p), (np.zeros(len(place), np.int64), place)),
            shape=(1, known),
        ))
    cells = np.concatenate(rows), np.concatenate(columns)
    return csr_matrix((np.concatenate(data), cells), shape=(count, known)), true


def _observe(
    losses: csr_matrix, true: Sequence[csr_matrix], owner: IndexArray
) -> tuple[FloatArray, FloatArray]:
    """Loss after each departure, and loss caused at each from the second on."""
    count, places = losses.shape
    after, caused = np.zeros(count), np.zeros(count - 1)
    if places == 0:
        return after, caused
    seen, best = np.zeros(places), 0
    for k in range(count):
        if k > 0:
            caused[k - 1] = _cost(losses, k, best)
        row = slice(losses.indptr[k], losses.indptr[k + 1])
        seen[losses.indices[row]] += losses.data[row]
        best = int(np.argmax(seen))
        after[k] = _cost(true[owner[k]], 0, best)
    return after, caused


def _cost(losses: csr_matrix, k: int, place: int) -> float:
    """``losses[k, place]``, which scipy takes long for."""
    row = slice(losses.indptr[k], losses.indptr[k + 1])
    return float(losses.data[row][losses.indices[row] == place].sum())


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

# SPDX-License-Identifier: Apache-2.0
"""The least value by a linear program over whole routes, each hit once by each site.

Column generation: the mixture of least value of the known routes gives an ambusher's strategy and
the price of the budget (``mixtures``); routes that cost less against these than the mixture's value
join. They are found leg by leg by Dijkstra's method with every entry counted, except where another
leg meets the site; later also from routes of the mixture; last by label searches, which also prove
bounds (``best_response``), against ambushers who wait at few sites. A trip's bound usually comes
from its legs, each with its own share of every site: an LP of its own, over the legs' ways, finds
the shares.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack

from ...arrays import NEGLIGIBLE, ROUNDING, BoolArray, FloatArray, IndexArray, sums
from ...errors import TimeLimit
from ..ambusher import Ambusher, at_nodes, on_nodes, padded
from ..budget import Budget
from ..certificate.best_response import SEARCHES, Searches, TripNetworks
from ..distribution.chain import conserved_strategy
from ..faces import Faces
from ..game import Game
from ..slack import ROUNDS, within
from .mixtures import Mixture, Mixtures
from .potential import Potential


class ColumnGeneration(NamedTuple):
    """The constants of the linear programs over routes."""

    loose: float = 5e-2  # relative gap of the LPs while routes join
    tight: float = 1e-4  # the same once none does
    gain: float = 0.25  # share of the wanted gap by which a route must cost less to join
    # Where sites can be met twice, it is at least this share of the open gap. After ``ROUNDS``
    # rounds in which that falls by less than ``gain`` of the wanted gap, loose LPs become tight,
    # and tight ones end.
    open_gain: float = 0.5
    starts: int = 4  # trips that are improved leg by leg in a round, of the mixture twice as many
    comparisons: int = 1_000_000  # of labels in a search
    # Share of the largest dual weight below which label searches leave out sites, of a whole route
    # and of a leg. Few sites make a search fast, but each that is left out weakens it.
    small: float = 3e-3
    small_on_leg: float = 1e-3
    apart: float = 0.25  # minimum distance of sites that join at once, as a share of the reach
    first_proof: int = 16  # rounds before a proof while routes join; then twice as many, and so on


ROUTES = ColumnGeneration()
# Label searches for whole routes, and for the ways of one leg.
ROUTE_SEARCHES = tuple((kept, ROUTES.comparisons) for kept, _ in SEARCHES)
LEG_SEARCH = ROUTE_SEARCHES[:2]


# Is called with the value of a mixture or strategy, and a bound, as they improve.
Progress = Callable[[float, float], None]


def no_progress(value: float, bound: float) -> None:
    """Nobody watches."""


class Routes:
    """The least value by a linear program over whole routes; it only grows.

    Attributes
    ----------
    bound : float
        No strategy within the budget has a smaller value.
    value : float
        That of the mixture found.
    by_leg : (stops + 1, S)
        The ambusher who proves the bound: how likely he waits at each site for each leg. What he
        proves is the ``best_response`` to him.
    price : float
        His price of the budget [loss per unit of length].
    routes, shares
        The routes, as edges, and their probabilities (C,).
    deadline : float
        When searches end (``time.monotonic``): they raise TimeLimit, what was found by then counts.
    """

    apart = ROUTES.apart
    faces: Faces | None = None

    def __init__(self, game: Game, budget: Budget, gap: float, deadline: float,
                 progress: Progress = no_progress, planar: Potential | None = None) -> None:
        self.game, self.gap, self.deadline = game, gap, deadline
        self._slack = budget.slack
        self.planar, self._by_planar = planar, False
        self._progress = progress
        self._newest: Mixture | None = None  # of the legs
        self.reduced_cost = np.zeros(len(game.playable))  # in slacks of the budget
        if budget.binds:
            share = np.minimum(budget.reduced_cost / budget.slack, 1.0 / NEGLIGIBLE)
            self.reduced_cost = np.where(game.playable, share, 0.0)
        legs = int(game.network.stops_before[-1]) + 1
        self.mixtures, self._of_legs = Mixtures(1, budget.binds), Mixtures(legs, budget.binds)
        self.bound, self.value, self.shares = 0.0, math.inf, np.zeros(0)
        self.by_leg, self._price = np.zeros((legs, 0)), 0.0
        self.entering, self._rng = csr_matrix((0, len(game.playable))), np.random.default_rng(0)
        self._add_sites(*(planar.sites if planar else (game.entering, game.loss[game.sites])))
        if planar and planar.bound > 0.0:
            self.bound, self._by_planar = planar.bound, True
        # The shortest route is within the budget.
        self._add(self._whole.shortest(budget.cost, np.zeros(len(self.loss))))
        self.shares = np.ones(1)
        self.value = self.mixtures.value(self.shares)

    def add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        """Add sites with losses (K,) and the edges (K, M) that enter their discs."""
        self._add_sites(entering, loss)
        if self.planar:
            self.planar.add_sites(entering, loss)

    def _add_sites(self, entering: csr_matrix, loss: FloatArray) -> None:
        self.entering = csr_matrix(vstack((self.entering, entering)))
        networks = TripNetworks(self.game, self.entering)
        self._networks, self._whole, self._legs = networks, networks.whole, networks.legs
        for mixtures in (self.mixtures, self._of_legs):
            mixtures.add_sites(entering, loss)
        self.loss = self.mixtures.loss
        self.by_leg = np.pad(self.by_leg, ((0, 0), (0, len(loss))))
        if self.bound == 0.0:  # any ambusher proves that
            self.by_leg[0] = 1.0 / max(len(self.loss), 1)
        if len(self.shares):
            self.value = self.mixtures.value(self.shares)

    @property
    def q(self) -> FloatArray:
        """How likely the ambusher who proves the bound waits at each site (S,)."""
        if self.planar and self._by_planar:
            return self.planar.q
        return np.asarray(self.by_leg.sum(axis=0))

    @property
    def price(self) -> float:
        """His price of the budget [loss per unit of length]."""
        if self.planar and self._by_planar:
            return self.planar.price
        return self._price / self._slack

    @property
    def provers(self) -> list[Potential | Routes]:
        """Those whose ambushers prove bounds; what potentials prove is checked in no time."""
        planar: list[Potential | Routes] = [self.planar] if self.planar else []
        return planar if self._by_planar else [*planar, self]

    def ambusher(self, game: Game, kept: BoolArray) -> Ambusher:
        """He who proves the bound, in a game with the ``kept`` ones of the sites (S,)."""
        by_leg = padded(self.by_leg, len(kept))[:, kept]
        return Ambusher(at_nodes(game, by_leg.sum(axis=0)), self.price,
                        on_nodes(game, by_leg) if len(by_leg) > 1 else None)

    @property
    def routes(self) -> list[IndexArray]:
        """The routes of the mixture, as edges."""
        return self.mixtures.routes

    @property
    def cap(self) -> float:
        """Loss that each site may cause."""
        return self.value

    @property
    def flow(self) -> FloatArray:
        """The mixture as an acyclic strategy (M,) within the budget."""
        used = self.mixtures.flow(self.shares, len(self.game.playable))
        most = float(self.reduced_cost @ used)
        if most > 1.0:  # as far as the LP's precision allows; the first route is the shortest
            shortest = self.mixtures.flow(np.ones(1), len(used))
            used = shortest + (used - shortest) / most
        found = conserved_strategy(self.game, used, NEGLIGIBLE)
        assert found is not None  # one route of n has a share of 1 / n or more
        return found

    @property
    def mixture(self) -> RouteMixture:
        """The routes and their shares."""
        used = np.flatnonzero(self.shares > 0.0)
        return RouteMixture([self.routes[k] for k in used], self.shares[used])

    def solve(self, prove: bool = True) -> None:
        """Let routes join until the value is within the gap of the bound, or the deadline.

        It also ends when no method finds a route that costs less. The searches over labels are
        left out unless it is to ``prove`` the value.
        """
        precision, rounds = ROUTES.loose, 0
        open_gap, stalled = math.inf, 0
        tight = min(ROUTES.tight, self.gap / 2.0)
        centre: Mixture | None = None
        while True:
            mixture = self.mixtures.solve(precision, self.deadline)
            self.shares = mixture.shares
            self.value = self.mixtures.value(self.shares)
            if self._ended():
                return
            if stalled == ROUNDS and not self._whole.exact:
                if precision == tight:
                    return
                precision, stalled = tight, 0
                continue
            added, rounds, stalled = 0, rounds + 1, stalled + 1
            if self.value - self.bound < open_gap - ROUTES.gain * self.gap * self.value:
                open_gap, stalled = self.value - self.bound, 0
            if precision == ROUTES.loose:
                centre = mixture if centre is None else _between(centre, mixture)
                added = self._add_responses(centre, precision, prove)
            elif not self._whole.exact:  # label searches are faster for a vertex, but jump
                vertex = self.mixtures.solve(precision, self.deadline, vertex=True)
                if not vertex.q.any():  # it meets no site
                    self.shares, self.value = vertex.shares, self.mixtures.value(vertex.shares)
                    return
                mixture, other = (mixture, vertex) if rounds % 2 else (vertex, mixture)
                added = self._add_responses(other, precision, prove)
            added = added or self._add_responses(mixture, precision, prove)
            if prove and len(self._legs) > 1 and (not added or _proved(rounds)):
                self.prove_by_legs()
            if not added and (precision == tight or self._ended()):
                return
            if not added:
                precision, stalled = tight, 0

    def _ended(self) -> bool:
        self._progress(self.value, self.bound)
        rounding = ROUNDING * float(self.loss.max(initial=0.0))
        if within(self.value, max(self.bound, rounding), self.gap):
            return True
        if time.monotonic() > self.deadline:
            raise TimeLimit('the time limit passed before the value was proved')
        return False

    def _add(self, route: IndexArray) -> bool:
        return self.mixtures.add(route, self._whole.met(route),
                                 float(self.reduced_cost[route].sum()))

    def _add_responses(self, mixture: Mixture, precision: float, prove: bool) -> int:
        """Add routes that cost less than the value, by the fastest way that finds any."""
        q, price = self._ambusher(mixture, 0.0)
        base, dual_weights = price * self.reduced_cost, q[0] * self.loss
        for routes in self._responses(mixture, base, dual_weights, precision, prove):
            most = self.value * (1.0 - self._least_gain) + price
            added = sum(self._add(route) for route in routes
                        if self._whole.cost(route, base, dual_weights) < most)
            if added or self._ended():
                return added
        return 0

    @property
    def _least_gain(self) -> float:
        """By which a route must cost less than the value to join, as a share of the value."""
        gain = ROUTES.gain * self.gap
        if self.bound > 0.0 and not self._whole.exact:
            gain = max(gain, ROUTES.open_gain * (1.0 - self.bound / self.value))
        return gain

    def _responses(self, mixture: Mixture, base: FloatArray, dual_weights: FloatArray,
                   precision: float, prove: bool) -> Iterator[list[IndexArray]]:
        """Routes that cost little, in the order in which they are worth their time."""
        legs, rough = len(self.by_leg), precision == ROUTES.loose or self._whole.exact
        searches = ROUTE_SEARCHES if prove and not rough else ()
        if self._whole.exact:
            self._search(mixture, SEARCHES[:1], 0.0)
        for search in searches if legs == 1 else ():
            yield self._search(mixture, (search,), ROUTES.small)
        starts = self._rng.permutation(legs)[:ROUTES.starts].tolist()
        yield [self._descend(base, dual_weights, start, self._random_trip()) for start in starts]
        if legs == 1 or rough:
            return
        near = self._rng.choice(len(self.shares), 2 * ROUTES.starts, p=self.shares)
        yield [self._descend(base, dual_weights, int(self._rng.integers(legs)),
                             *self._legs_of(self.routes[k])) for k in near]
        for search in searches:
            yield self._search(mixture, (search,), ROUTES.small)

    def _search(self, mixture: Mixture, searches: Searches, negligible: float) -> list[IndexArray]:
        """Search the whole network for the route of least cost, and note the bound."""
        q, price = self._ambusher(mixture, negligible)
        least, route = self._whole.least_cost(price * self.reduced_cost, q[0] * self.loss,
                                              searches, self.deadline)
        by_leg = np.zeros_like(self.by_leg)
        by_leg[0] = q[0]
        self._note(least, by_leg, price)
        return [] if route is None else [route]

    def _ambusher(self, mixture: Mixture, negligible: float) -> tuple[FloatArray, float]:
        """q (groups, S) without small dual weights, and the price."""
        q = mixture.q
        q = np.where(q * self.loss > negligible * (q * self.loss).max(), q, 0.0)
        total = q.sum()
        return q / total, float(mixture.price / total)

    def _note(self, least: float, by_leg: FloatArray, price: float) -> None:
        """Keep an ambusher who costs every route at least ``least`` if his bound is the best."""
        bound = least - price
        if bound > self.bound:
            self.bound, self.by_leg, self._price, self._by_planar = bound, by_leg, price, False

    def _descend(self, base: FloatArray, dual_weights: FloatArray, start: int, trip: list[int],
                 ways: list[IndexArray] | None = None) -> IndexArray:
        """Improve the legs of a trip one by one, from leg ``start`` on, as long as its cost falls.

        The sites that other legs meet are free. Without their ways, they meet none yet.
        """
        legs = len(trip)
        ways = [np.zeros(0, dtype=np.int64)] * legs if ways is None else ways
        met = np.array([self._whole.met(way) for way in ways])
        free: list[BoolArray | None] = [None] * legs  # as when the leg was last improved
        best, found = math.inf, np.zeros(0, dtype=np.int64)
        while True:
            for leg in np.roll(np.arange(legs), -start):
                now: BoolArray = np.any(np.delete(met, leg, axis=0), axis=0)
                before, free[leg] = free[leg], now
                if before is None or (now != before).any():
                    network = self._legs[trip[leg]].network
                    ways[leg] = network.shortest(base, np.where(now, 0.0, dual_weights))
                    met[leg] = self._whole.met(ways[leg])
            cost = base[np.concatenate(ways)].sum() + dual_weights @ met.max(axis=0)
            if cost >= best * (1.0 - ROUNDING):
                return found
            best, found = cost, np.concatenate(ways)

    def _random_trip(self) -> list[int]:
        """Legs that follow each other from the source to the target, in a random order of stops."""
        return self._networks.least_trip(lambda k: float(self._rng.random()))[1]

    def _legs_of(self, route: IndexArray) -> tuple[list[int], list[IndexArray]]:
        """The legs of a route, and its way on each."""
        network = self.game.network
        leg = network.leg[network.tails[route]]
        ways = np.split(route, np.flatnonzero(np.diff(leg)) + 1)
        ends = [(network.tails[way[0]], network.heads[way[-1]]) for way in ways]
        return self._networks.trip(ends), ways

    def prove_by_legs(self, end: float = -math.inf) -> None:
        """Improve the bound by the LP in which each leg has sites of its own.

        If none is proved by the deadline, its newest ambusher proves one until ``end``.
        """
        if self.planar:
            self._prove_by_potential(self.planar)
            return
        if self.bound > 0.0 and self._ended() or not len(self.loss):
            return
        for route in self.routes:
            for leg, way in zip(*self._legs_of(route), strict=True):
                self._add_way(leg, way)
        try:
            self._solve_legs()
        except TimeLimit:
            if self._newest and self.bound == 0.0:
                self._proof_by_legs(self._newest, end)
            raise

    def add_level_lines(self, count: int) -> None:
        """Add trips of ``count`` level lines of each leg, which share the sites that they meet.

        So a mixture of them costs hardly more than its legs.
        """
        assert self.planar is not None
        from scipy.optimize import linear_sum_assignment  # slow to load

        charge, lines = self.planar.q * self.loss, self.planar.level_lines(count)
        if not lines:
            return
        first, *later = zip(*(self._legs_of(line)[1] for line in lines), strict=True)
        trips, met = list(first), np.array([self._whole.met(way) for way in first])
        for ways in later:
            others = np.array([self._whole.met(way) for way in ways])
            after = linear_sum_assignment((met * charge) @ others.T, maximize=True)[1]
            trips = [np.concatenate((trip, ways[k])) for trip, k in zip(trips, after, strict=True)]
            met = np.maximum(met, others[after])
        for trip in trips:
            self._add(trip)

    def _prove_by_potential(self, planar: Potential) -> None:
        planar.deadline = self.deadline
        try:
            planar.solve()
        finally:
            if planar.bound > self.bound:
                self.bound, self._by_planar = planar.bound, True

    def _solve_legs(self) -> None:
        """Solve the legs' LP in rounds, in which ways join, until its value is proved."""
        precision, self._newest = ROUTES.loose, None
        centre: Mixture | None = None

        def prove(mixture: Mixture) -> int:
            return self._proof_by_legs(mixture, self.deadline)

        quick = self._add_entering_ways if self.game.reach > 0.0 else prove
        for rounds in itertools.count():
            mixture, added = self._of_legs.solve(precision, self.deadline), 0
            if not mixture.q.any():  # no site needs to be met
                return
            self._newest = mixture
            if precision == ROUTES.loose:
                added, before, centre = quick(mixture), centre, mixture
                if before:
                    centre = _between(before, mixture)
                    added += quick(centre)
            was_tight = precision == ROUTES.tight
            precision = precision if added else ROUTES.tight
            if not added or _proved(rounds):
                added += prove(mixture)
            if (self._ended() or within(mixture.value, self.bound, self.gap / 2.0)
                    or was_tight and not added):
                return

    def _add_entering_ways(self, mixture: Mixture) -> int:
        """Add each leg's way of least cost if every entry is counted."""
        q, price = self._ambusher(mixture, 0.0)
        base, dual_weights = price * self.reduced_cost, q * self.loss
        return sum(self._add_way(k, leg.network.shortest(base, dual_weights[leg.number]))
                   for k, leg in enumerate(self._legs))

    def _proof_by_legs(self, mixture: Mixture, end: float) -> int:
        """Note what a mixture's ambusher proves by ``end``; return the number of new ways."""
        q, price = self._ambusher(mixture, ROUTES.small_on_leg * (self.game.reach > 0.0))
        base, dual_weights, added = price * self.reduced_cost, q * self.loss, 0

        def cost(k: int) -> float:
            nonlocal added
            network, own = self._legs[k].network, dual_weights[self._legs[k].number]
            low, way = network.least_cost(base, own, LEG_SEARCH, end)
            added += self._add_way(k, network.shortest(base, own) if way is None else way)
            return low

        self._note(self._networks.least_trip(cost)[0], q, price)
        return added

    def _add_way(self, leg: int, way: IndexArray) -> bool:
        number, begin, end, _ = self._legs[leg]
        return self._of_legs.add(way, self._whole.met(way),
                                 float(self.reduced_cost[way].sum()), number, (begin, end))


class RouteMixture:
    """Routes, as edges, that are drawn with given shares (C,)."""

    def __init__(self, routes: list[IndexArray], shares: FloatArray) -> None:
        self._edge, self._shares = np.concatenate(routes), shares
        self._route = np.repeat(np.arange(len(routes)), list(map(len, routes)))

    def uses(self, edges: int) -> FloatArray:
        """Expected uses of each of the network's ``edges``."""
        return sums(self._edge, self._shares[self._route], edges)

    def meets_at_most(self, rows: csr_matrix) -> FloatArray:
        """An upper bound (K,) of ``meets`` that is fast to find."""
        return np.asarray(np.minimum(rows @ self.uses(rows.shape[1]), 1.0))

    def meets(self, rows: csr_matrix) -> FloatArray:
        """P(hit) (K,) by sites whose discs are entered by the edges of ``rows`` (K, M)."""
        one = np.ones(len(self._edge))
        along = csr_matrix((one, (self._edge, self._route)), (rows.shape[1], len(self._shares)))
        met = csr_matrix(rows @ along)
        met.data[:] = 1.0
        return np.asarray(met @ self._shares)


def _proved(rounds: int) -> bool:
    """Whether a round is the first with a proof, or twice, four times, ... as late."""
    return rounds >= ROUTES.first_proof and rounds & (rounds - 1) == 0


def _between(centre: Mixture, newest: Mixture) -> Mixture:
    """The newest mixture, with duals halfway from the centre: they vary less from round to round.

    P. Wentges, Weighted Dantzig-Wolfe decomposition for linear mixed-integer programming,
    International Transactions in Operational Research 4, 1997.
    """
    return newest._replace(q=(centre.q + newest.q) / 2.0,
                           price=(centre.price + newest.price) / 2.0)

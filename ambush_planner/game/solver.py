# SPDX-License-Identifier: Apache-2.0
"""The default strategy: least value within the budgets, then the most unpredictable routes.

1. *Value.* One of three programs finds the least value, a flow that attains it, and an ambusher
   who proves it (``value``): a cut without a reach while no budget binds, face potentials on a
   planar network whose links cost the same both ways, whole routes otherwise.
2. *Places.* With a reach, the places of the map that cost the flow most join the program, which
   goes on from where it is.
3. *Law.* On an acyclic network around the flow, the law of greatest entropy within the slack of
   the bound (``law``). Places that cost it more join both the program and the law.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.sparse import csr_matrix, vstack

from ..arrays import ROUNDING, BoolArray, FloatArray, frozen_array
from ..errors import SolverFailed, TimeLimit
from .ambusher import Ambusher, at_nodes, on_nodes
from .budget import Budget
from .certificate.certificate import lower_bound
from .copies import LawOnCopies, law_on_copies
from .faces import Circulation, make_faces
from .game import Game
from .hits import hits_can_differ, worst_loss
from .law.acyclic import forward_part, order_potential, rank_around
from .law.chain import MarkovChain, chain_of
from .law.gibbs import acyclic_network
from .law.law import Law
from .slack import Reason, ceiling, within
from .value.cut import Cut
from .value.potential import Potential
from .value.routes import MIN_FLOW, Progress, RouteMixture, Routes, unseen

# Smallest risk slack of the search, relative to the value.
MIN_SLACK = 9e-6
# Relative gaps at which a program in potentials, and one over routes, ends, as shares of the slack.
PROGRAM_GAP, ROUTES_GAP = 0.1, 0.3
# Largest share by which the flow of a cut exceeds a budget if a law is sought around it: the law
# then keeps the budget in nearly all games, without a loss of entropy.
MAX_EXCESS = 0.07
# Level at which a program in potentials begins, as a multiple of the value without budgets.
FIRST_LEVEL = 2.0
# Least distance of places that join at once, as a share of the reach: places near each other hit
# nearly the same routes. In the last sweeps of a program that is not over routes it is 0.
APART = 0.25
# Shares of the time after which a program over a trip's routes ends, as its law takes seconds; and
# its first proof if places join later, and its last one if they joined until then.
SOLVED, FIRST_PROOF, LAST_PROOF = 0.8, 0.1, 0.9
# Rounds in which places join before the first law, in the last of them all; more while the value
# is 0.
SWEEPS, MAX_SWEEPS = 3, 20
# Share of the slack over the bound from which on a place joins; a law ends just below it.
JOINING = 0.8
# Rounds of a law, and the least growth of the entropy for another one.
ROUNDS, GROWTH = 25, 0.03


class Places(Protocol):
    """Places where an ambusher can wait, and what the edges that enter their discs are."""

    points: FloatArray
    alpha: FloatArray
    mean_loss: FloatArray
    entering: csr_matrix


class Ground(Protocol):
    """A map on which an ambusher may wait at other places than the network's nodes."""

    def worst(self, drawn: MarkovChain | RouteMixture, above: float, apart: float,
              rough: bool) -> Any:
        """The ``Places`` that cost drawn routes more than ``above``, no two within ``apart`` [m].

        A ``rough`` search can miss the worst.
        """


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Multipliers of the Gibbs law: per hit of each site (N,), per unit of each budget's cost."""

    sites: FloatArray
    budgets: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Problem:
    """A game, its budgets, and how far and how long to search.

    ``progress`` is called with the value and the bound so far.
    """

    game: Game
    budgets: tuple[Budget, Budget]
    slack: float
    deadline: float
    ground: Ground | None = None
    warm: Multipliers | None = None
    progress: Progress = unseen


class Solution(NamedTuple):
    """A strategy p (M,) and an ambusher in a game with more sites, and its budgets.

    On a trip the game's network can have copies of the trip's nodes and edges, after these.
    ``value`` is the strategy's, ``bound`` what the ambusher proves. ``entropy_bound`` is the most
    entropy [nats] that a strategy on the same acyclic network can have within the same limits; NaN
    if that is not known. ``reason`` is why the search ended.
    """

    game: Game
    budgets: tuple[Budget, Budget]
    p: FloatArray
    value: float
    bound: float
    ambusher: Ambusher
    multipliers: Multipliers | None
    evaluations: int
    entropy_bound: float
    reason: Reason


def most_unpredictable(problem: Problem) -> Solution:
    """Find the value and the law; at the deadline, the best strategy so far is returned.

    Raises BudgetInfeasible if no strategy is within all budgets.
    """
    slack, best = max(problem.slack, MIN_SLACK), None
    for program in _programs(problem, slack):
        found = _Search(problem, program, slack).run()
        if found and (best is None or found.value < best.value
                      or within(found.value, found.bound, slack)):
            best = found
        if best and (within(best.value, best.bound, slack)
                     or time.monotonic() > problem.deadline):
            break
    assert best is not None  # the flow of the last program is within the budgets
    return best


def _programs(problem: Problem, slack: float) -> Iterator[Cut | Potential | Routes]:
    """The program without budgets if its flow nearly keeps them, then the one within them."""
    cut = _cut_of(problem)
    if cut and cut.excess <= MAX_EXCESS:
        yield cut
    yield _program_within_budgets(problem, slack, cut)


def least_value(game: Game, budgets: tuple[Budget, Budget], gap: float,
                deadline: float) -> float | None:
    """A lower bound of the least value within the budgets, too low by at most the share ``gap``.

    At the deadline it may be lower; on trips it is what separate legs prove. None if nothing is
    proved.
    """
    problem = Problem(game, budgets, gap, deadline)
    cut = _cut_of(problem)
    if cut and cut.excess == 0.0:
        return cut.bound
    program = _program_within_budgets(problem, gap, cut)
    try:
        if isinstance(program, Routes) and game.network.legs > 1:
            program.prove_by_legs()
        else:
            program.solve()
        ended = time.monotonic() <= deadline
    except (TimeLimit, SolverFailed):
        ended = False
    return program.bound if ended else program.bound or None


def _cut_of(problem: Problem) -> Cut | None:
    """The value without budgets, if a cut finds it."""
    return None if hits_can_differ(problem.game) else Cut(problem.game, _binding(problem))


def _binding(problem: Problem) -> tuple[Budget, ...]:
    return tuple(b for b in problem.budgets if b.binds)


def _program_within_budgets(problem: Problem, slack: float,
                            cut: Cut | None) -> Potential | Routes:
    """The fastest program that finds the value within budgets, perhaps from that without."""
    game, binding = problem.game, _binding(problem)
    if game.ambushers == 1 and game.network.legs == 1 and len(binding) <= 1:
        faces, budget = make_faces(game), binding[0] if binding else Budget.none(game)
        if faces and faces.same_both_ways(budget.cost):
            first = FIRST_LEVEL * cut.bound if cut else np.inf
            return Potential(faces, budget, PROGRAM_GAP * slack, problem.deadline, first)
    return Routes(game, binding, ROUTES_GAP * slack, problem.deadline, problem.progress)


class _Search:
    """One program with its law, and the best strategy so far."""

    def __init__(self, problem: Problem, program: Cut | Potential | Routes, slack: float) -> None:
        self.problem, self.program, self.slack = problem, program, slack
        self.game, self.budgets = problem.game, problem.budgets
        self.points = self.game.network.points[self.game.sites]
        self.entering, self.loss = self.game.hits, self.game.loss[self.game.sites]
        # Rating, strategy, its value and the row of its worst site.
        self.best: tuple[tuple[bool, float], MarkovChain, float, int] | None = None
        self.law: Law | None = None
        # On a trip: the latest law on copies, and the one whose copies the best strategy is on.
        self.latest_copies: LawOnCopies | None = None
        self.best_copies: LawOnCopies | None = None
        self.entropy_bound = np.nan
        self.reason: Reason = 'stalled'

    def run(self) -> Solution | None:
        """Find the value, then the law; None if nothing found is within the budgets."""
        if isinstance(self.program, Routes) and self.game.network.legs > 1:
            self._solve_trip(self.program)
            self._find_law_on_copies(self.program)
            if self.best_copies:
                return self._solution()
        self._solve_program()
        for sweep in range(MAX_SWEEPS):
            if self._late() or (sweep >= SWEEPS and self.program.bound > 0.0):
                break
            chain = chain_of(self.game.network, self.program.flow)
            above, apart = ceiling(self.program.bound, self.slack), APART * (sweep < SWEEPS - 1)
            if not self._add_worst(chain, above, apart, rough=sweep == 0):
                break
        self._find_law()
        if self.best is None and not self._keeps_budgets(self.program.flow):
            return None
        return self._solution()

    def _solve_program(self) -> None:
        with self._keep_incumbent():
            self.program.solve()

    def _add_worst(self, chain: MarkovChain, above: float, apart: float,
                   rough: bool = False) -> bool:
        """Add the places that cost a strategy more than ``above``, and solve the program again."""
        found = self._join_worst(chain, above, apart, rough) > 0.0
        if found:
            self._solve_program()
        return found

    def _join_worst(self, drawn: MarkovChain | RouteMixture, above: float, apart: float,
                    rough: bool = False) -> float:
        """Add the places that cost more than ``above``; return the mean loss at the worst, or 0.

        No two of them are within ``apart`` times the reach.
        """
        if self.problem.ground is None:
            return 0.0
        if isinstance(self.program, Routes):
            apart = max(apart, APART)
        found = self.problem.ground.worst(drawn, above, apart * self.game.reach, rough)
        if len(found.points):
            self._add_sites(found)
            self.program.add_sites(found.entering, found.alpha)
        return float(found.mean_loss.max(initial=0.0))

    def _add_sites(self, found: Places) -> None:
        self.points = np.concatenate((self.points, found.points))
        self.entering = csr_matrix(vstack((self.entering, found.entering)))
        self.loss = np.append(self.loss, found.alpha)
        for law in (self.law, self.latest_copies):
            if law:
                law.add_sites(found.entering, found.alpha)

    def _level(self) -> FloatArray:
        """What each site (S,) may cause; the k largest add up to the value at a slack of 0."""
        level, k = self.program.level, min(self.game.ambushers, len(self.loss))
        if not k or not level.any():
            return level
        value = float(np.sort(level)[-k:].sum())
        most = max(self.program.bound, ceiling(value, self.slack / 2.0) / ceiling(1.0, self.slack))
        return level * (most / value)

    def _solve_trip(self, program: Routes) -> None:
        """Let places join a mixture of routes, then prove its value: a proof takes seconds."""
        begin, end = time.monotonic(), self.problem.deadline
        if self.game.reach > 0.0 and end < math.inf:
            self._prove_until(program, begin + FIRST_PROOF * (end - begin))
        program.deadline = begin + SOLVED * (end - begin)
        with self._keep_incumbent():
            if self.game.reach == 0.0:
                program.prove_by_legs()
            program.solve(prove=False)
        apart, before = 1.0, program.value
        for _ in range(MAX_SWEEPS):
            above = ceiling(program.value, self.slack / 2.0)
            if time.monotonic() > program.deadline or (
                    not self._join_worst(program.mixture, above, apart) and apart == APART):
                break
            with self._keep_incumbent():
                program.solve(prove=False)
                if within(program.value, before, self.slack / 4.0):  # the bound may be near
                    program.prove_by_legs()
            apart, before = max(apart / 2.0, APART), program.value
        if time.monotonic() > program.deadline:
            self._prove_until(program, begin + LAST_PROOF * (end - begin))
            return
        with self._keep_incumbent():
            program.prove_by_legs()
            program.solve()

    def _prove_until(self, program: Routes, deadline: float) -> None:
        program.deadline = deadline
        with self._keep_incumbent():
            program.prove_by_legs()

    def _find_law_on_copies(self, program: Routes) -> None:
        """On a trip, rounds of a law on labelled copies of the ground.

        Places that cost it too much join it; new copies are made if it then has no strategy, or if
        the program finds a better mixture.
        """
        for _ in range(ROUNDS):
            if self.latest_copies is None or not self.latest_copies.run(self.problem.deadline):
                self.latest_copies = law_on_copies(program, self.slack, self.problem.deadline)
            law = self.latest_copies
            if law is None or self.best and self._late():
                return
            chain, value, worst = law.chain, law.value, law.worst
            joined = self._join_worst(chain, law.limit, APART)
            rating, mixed = (True, -max(value, joined)), program.value
            keeps = self._keeps_budgets(chain.uses(len(self.game.playable)))
            if keeps and (self.best is None or rating > self.best[0]):
                self.best, self.best_copies = (rating, chain, value, worst), law
            if self._late() or not joined and keeps and within(value, program.bound, self.slack):
                return
            with self._keep_incumbent():
                program.solve(prove=not joined)
            if not joined:
                if within(mixed, program.value, self.slack / 4.0):
                    return
                self.latest_copies = None

    def _find_law(self) -> None:
        """Rounds of a law around the program's flow; each strategy on the way counts."""
        law = self.law = self._new_law()
        law.measure(self._level())
        if self.problem.ground is None:  # otherwise other places may cost the flow more
            self._keep(law)
        before = 0.0
        while law.rounds < ROUNDS and time.monotonic() < self.problem.deadline:
            q, prices = self.program.q, self.program.prices
            if not law.round(q, prices, self.program.bound):
                break
            self._add_worst(law.chain, ceiling(self.program.bound, JOINING * self.slack), APART)
            law.measure(self._level())
            self._keep(law)
            grew, before = law.entropy > before * (1.0 + GROWTH), law.entropy
            if law.good and (law.exact or not grew):
                break

    def _new_law(self) -> Law:
        flow = self.program.flow
        game = self._noticeable(flow)
        safe = game.avoiding(self.entering) if self.program.bound == 0.0 else None
        if safe and not flow[~safe.playable].any():  # no route is hit at all
            game = safe
        rank = rank_around(game, flow, order_potential(game))
        part = forward_part(game, rank)
        assert part is not None  # it contains the flow
        network = acyclic_network(game.network, np.flatnonzero(part.playable), rank)
        law = Law(network, flow[network.edge], self.budgets, game.ambushers, self.slack,
                  not hits_can_differ(game), self.problem.deadline)
        law.add_sites(self.entering, self.loss)
        if self.problem.warm:
            prices = zip(self.problem.warm.budgets, self.budgets, strict=True)
            law.start_from(self.problem.warm.sites[self.game.sites],
                           np.array([price for price, b in prices if b.binds]), self._level())
        return law

    def _noticeable(self, flow: FloatArray) -> Game:
        """The game without edges that the budgets leave to less than ``MIN_FLOW`` of the routes.

        So all best routes for a budget that allows no others are in one order of the nodes.
        """
        game = self.game
        used = [game.through(b.excess) <= b.margin / MIN_FLOW for b in self.budgets if b.binds]
        return game.restricted_to(np.all([game.playable, *used], axis=0) | (flow > 0.0)) or game

    def _keep(self, law: Law) -> None:
        """Keep the strategy of most entropy within the slack, else the one of least value.

        A strategy over a budget counts for nothing.
        """
        p = law.chain.uses(len(self.game.playable))
        if not self._keeps_budgets(p):
            return
        rating = law.good, law.entropy if law.good else -law.value
        if self.best is None or rating > self.best[0]:
            self.best = rating, law.chain, law.value, law.worst
            # With a reach, the rows are those of the chain before.
            self.entropy_bound = law.entropy_bound if law.exact else np.nan
            self.problem.progress(law.value, self.program.bound)

    def _keeps_budgets(self, p: FloatArray) -> bool:
        return all(b.keeps(p) for b in self.budgets)

    def _done(self) -> bool:
        return self._late() or self.best is not None and self.best[0][0]

    def _late(self) -> bool:
        return time.monotonic() > self.problem.deadline

    def _why(self) -> Reason:
        late = self._late() or isinstance(self.program, Routes) and self.program.late
        return 'time' if late else self.reason

    def _solution(self) -> Solution:
        """The best strategy, in the game with all sites that matter for it or for the bound."""
        chain, value, worst = self._best_strategy()
        if self.problem.ground:
            value, worst = self._worst_known(chain, value, worst)
            found = self.problem.ground.worst(chain, value * (1.0 + ROUNDING), 0.0, False)
            if len(found.points):
                value, worst = float(found.mean_loss[0]), len(self.loss)
                self._add_sites(found)
        own = np.arange(len(self.loss)) < len(self.game.sites)
        q, weight, prices = np.zeros(len(self.loss)), np.zeros(len(self.loss)), np.zeros(0)
        q[: len(self.program.q)] = self.program.q
        if self.law:
            weight, prices = self.law.unscaled_multipliers()
        kept = own | (q > 0.0) | (weight > 0.0)
        if worst >= 0:
            kept[worst] = True
        added = np.flatnonzero(kept & ~own)
        sites = self.points[added], self.loss[added], csr_matrix(self.entering[added])
        game = self.game.with_sites(*sites)
        ambusher, bound = self._judged(game, q, kept)
        if self.best_copies:
            assert isinstance(self.program, Routes)
            by_leg = self._shares_by_leg(self.program, len(q))[:, kept]
            return self._unrolled(self.best_copies, chain, sites, ambusher, q[kept], by_leg, value,
                                  bound)
        assert self.law is not None
        per_hit = np.zeros(game.node_count)
        per_hit[game.sites] = weight[kept]
        multipliers = Multipliers(frozen_array(per_hit, np.float64), self._of_all_budgets(prices))
        return Solution(game, self.budgets, chain.uses(len(game.playable)), value, bound, ambusher,
                        multipliers, self.law.evaluations, self.entropy_bound, self._why())

    def _worst_known(self, chain: MarkovChain, value: float, worst: int) -> tuple[float, int]:
        """The value and the row of the worst site, with those that joined for other strategies."""
        most = self.loss * chain.meets_at_most(self.entering)
        more = np.flatnonzero(most > value * (1.0 + ROUNDING))
        losses = self.loss[more] * chain.meets(self.entering[more])
        if losses.max(initial=0.0) <= value * (1.0 + ROUNDING):
            return value, worst
        return float(losses.max()), int(more[losses.argmax()])

    def _best_strategy(self) -> tuple[MarkovChain, float, int]:
        """The best strategy, its value and the row of its worst site."""
        if self.best:
            return self.best[1:]
        p = self.program.flow
        return chain_of(self.game.network, p), worst_loss(self.game, p), -1

    def _unrolled(self, law: LawOnCopies, chain: MarkovChain,
                  sites: tuple[FloatArray, FloatArray, csr_matrix], ambusher: Ambusher,
                  q: FloatArray, by_leg: FloatArray, value: float, bound: float) -> Solution:
        """The solution on the copies' network, with the sites added there as well."""
        edge = np.append(np.arange(len(self.game.playable)), law.network.edge)
        game, p = law.unrolled(chain)
        points, loss, entering = sites
        game = game.with_sites(points, loss, csr_matrix(entering[:, edge]))
        length, exposure = (replace(b, game=game, cost=b.cost[edge]) for b in self.budgets)
        ambusher = replace(ambusher, q=at_nodes(game, q), by_leg=on_nodes(game, by_leg))
        return Solution(game, (length, exposure), p, value, bound, ambusher, None,
                        law.evaluations, np.nan, self._why())

    def _judged(self, game: Game, q: FloatArray, kept: BoolArray) -> tuple[Ambusher, float]:
        """The ambusher q (S,) in the game with the ``kept`` sites, and his bound."""
        ambusher = Ambusher(frozen_array(at_nodes(game, q[kept]), np.float64),
                            self._of_all_budgets(self.program.prices))
        if isinstance(self.program, Routes) and game.network.legs > 1:
            by_leg = self._shares_by_leg(self.program, len(q))[:, kept]
            ambusher = replace(ambusher, by_leg=on_nodes(game, by_leg))
        found = getattr(self.program, 'circulation', None)
        if found and hits_can_differ(game):
            node = np.full(len(kept), -1)
            node[kept] = game.sites
            ambusher = replace(ambusher, circulation=Circulation(found.through, node[found.site],
                                                           found.face, found.flow))
        if self.program.bound == 0.0:  # a search for what he proves can take minutes
            return ambusher, 0.0
        return ambusher, lower_bound(game, ambusher, self.budgets)

    @staticmethod
    def _shares_by_leg(program: Routes, sites: int) -> FloatArray:
        """The ambusher's shares (legs, S) of all ``sites``."""
        return np.pad(program.by_leg, ((0, 0), (0, sites - program.by_leg.shape[1])))

    @contextlib.contextmanager
    def _keep_incumbent(self) -> Iterator[None]:
        """What a program has found before the deadline, or before it fails, counts."""
        try:
            yield
        except TimeLimit:
            self.reason = 'time'
        except SolverFailed:
            self.reason = 'solver'

    def _of_all_budgets(self, binding: FloatArray) -> tuple[float, ...]:
        """Numbers of the budgets that bind, with 0 for the others."""
        number = iter(binding.tolist())
        return tuple(next(number, 0.0) if b.binds else 0.0 for b in self.budgets)


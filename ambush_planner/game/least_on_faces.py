"""Strategies from the faces of a planar network: the cheapest chain of discs, and level lines.

If no budget binds, the law of greatest entropy usually attains the value of the cheapest chain.
With one binding budget, the level lines of the best potential of the faces are an optimal flow.
"""

from __future__ import annotations

import math

from ..errors import SolverFailed
from .acyclic import conserved_strategy, forward_part, rank_by, without_cycles
from .budget import Budget
from .entries import entry_bound
from .entropy_stage import EntropyStage, Solution, mixture
from .face_program import FaceProgram, LevelLines
from .gibbs import acyclic_network
from .hits import worst_loss
from .least_risk import NEGLIGIBLE, without_excessive_sites
from .route_sampler import shortest_route_strategy
from .separate_legs import join_faces, once_at_each_place, or_by_entries, separate_legs

# Relative gaps of the program in potentials of the faces, and of the bound that its ambusher
# proves, as shares of the slack.
FACES_GAP, PROVED_GAP = 0.1, 0.2
# Widths of the strips that this program is solved on, in margins of the budget.
STRIPS = (1.0, 2.0, 4.0, math.inf)


def along_chain(stage: EntropyStage) -> Solution | None:
    """The strategy of greatest entropy at the value of the cheapest chain of discs.

    None if the law on the harmonic part cannot keep to it, perhaps because a budget binds.
    """
    if stage.chain is None:
        return None
    (bound, q, level), prices = stage.chain, (0.0,) * len(stage.budgets)
    game, rank = without_excessive_sites(stage.game, bound), rank_by(stage.potential)
    part = forward_part(game, rank)
    if part is None:
        return None
    kept = (stage.kept_margins(bound, prices),)
    found = stage.law(acyclic_network(part, rank), level, kept, q, prices)
    value = worst_loss(stage.game, found.p)
    fits = value <= bound * (1.0 + stage.slack) and stage.within_budgets(found.p)
    return found if fits else None


def along_level_lines(stage: EntropyStage) -> Solution | None:
    """The level lines of the face potential of least value within a budget, as a flow.

    Driven as a Markov chain, the flow can have a larger value: routes change from line to line.
    None without a chain or exactly one budget, with several ambushers, or if the program fails.
    """
    game, binding = stage.game, [b for b in stage.budgets if b.binds and b.limit > 0.0]
    if not stage.chain or game.ambushers > 1 or len(binding) != 1:
        return None
    try:
        found = _least_on_faces(stage, binding[0], stage.chain.bound)
    except SolverFailed:
        return None
    p = conserved_strategy(game, found.p, NEGLIGIBLE)
    short = None if p is None else mixture(p, shortest_route_strategy(game), stage.within_budgets)
    if short is None:
        return None
    if found.q is not None:
        q = once_at_each_place(game, found.q) if game.network.legs > 1 else found.q
        stage.hit_bound(q, _priced(stage, binding[0], found.price))
    q, prices, _ = stage.best_proof()
    lines = or_by_entries(stage, without_cycles(game.network, short))
    stage.level_lines = lines
    stage.laws.append(Solution(lines, q, prices, stage.evaluations))
    return stage.laws[-1]


def _least_on_faces(stage: EntropyStage, budget: Budget, bound: float) -> LevelLines:
    """Solve on strips around the best route until the ambusher found proves the value.

    Entries show that well enough, and a strip that is too narrow proves next to nothing.
    """
    game, faces = stage.game, stage.faces[0]
    if game.network.legs > 1:
        game = separate_legs(game)
        faces = join_faces(game, stage.faces)
    program = FaceProgram(faces, budget, bound, FACES_GAP * stage.slack, stage.program_deadline())
    for width in STRIPS:
        found = program.solve(width)
        if found.q is None or found.value * (1.0 - PROVED_GAP * stage.slack) <= entry_bound(
            game, found.q, stage.budgets, _priced(stage, budget, found.price)
        ):
            break
    return found


def _priced(stage: EntropyStage, budget: Budget, price: float) -> tuple[float, ...]:
    """The price of one budget, and 0 for the others."""
    return tuple(price if b is budget else 0.0 for b in stage.budgets)

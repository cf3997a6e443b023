# SPDX-License-Identifier: Apache-2.0
"""The first two stages of a solve: the least value, and the sites that decide it.

A program finds the value with the sites known so far (``value``); with a reach, the places of the
map that cost its strategies most join it, until none does.
"""

from __future__ import annotations

from .distribution.chain import MarkovChain, chain_of_legs
from .faces import make_faces
from .hits import Law
from .search import Program, Search, SearchProblem
from .tolerance import ROUNDS, ceiling
from .value.edge_flows import EdgeFlows
from .value.potential import Potential
from .value.routes import ROUTES, Routes

# Optimality gaps of programs in potentials, over routes, and over edges [tolerances].
POTENTIAL_GAP, ROUTES_GAP, EDGES_GAP = 0.1, 0.3, 0.01
# The gap of one in potentials that only says where a network is to be refined [tolerances].
ROUGH_GAP = 0.5
# How often sites join before the distribution is sought; more often while the value is 0. In the
# last of these rounds and later, sites may be as near to each other as the program allows.
SWEEPS = 3
# How often sites join a program over routes before it is solved precisely.
ROUGH_SWEEPS = 2


def find_value(problem: SearchProblem, rough: bool = False) -> Search:
    """Find the least value within the budgets, and an ambusher who nearly proves it.

    A ``rough`` search is less precise, until it is finished (``tighten``).
    """
    search = Search(problem, _program(problem, ROUGH_GAP if rough else POTENTIAL_GAP))
    find_sites(search)
    return search


def _program(problem: SearchProblem, gap: float) -> Program:
    """The program for the value; one in potentials ends at a relative ``gap`` [tolerances]."""
    legs, tolerance = problem.legs, problem.search_tolerance
    if len(legs.games) > 1 and legs.no_reentry:
        return EdgeFlows(legs, EDGES_GAP * tolerance)
    if len(legs.games) == 1:
        faces = make_faces(legs.games[0])
        if faces and faces.same_both_ways(legs.budgets[0].cost):
            return Potential(legs, faces, gap * tolerance, problem.first_value)
    return Routes(legs, ROUTES_GAP * tolerance)


def find_value_by_max_flow(problem: SearchProblem) -> Search | None:
    """The same for a leg without a reach, if the flow that attains the value keeps the budget."""
    legs = problem.legs
    if not legs.no_reentry or len(legs.games) > 1:
        return None
    program = EdgeFlows(legs, EDGES_GAP * problem.search_tolerance)
    return Search(problem, program) if program.solve_by_max_flow() else None


def tighten(search: Search) -> None:
    """Find the value of a rough search precisely."""
    if isinstance(search.program, Potential):
        search.program.tighten(POTENTIAL_GAP * search.tolerance)
        search.solve_program()


def find_sites(search: Search, sweeps: int = SWEEPS) -> None:
    """Constraint generation: solve the program, add the most violated sites, repeat."""
    program = search.program
    for sweep in range(ROUNDS):
        rough = sweep < ROUGH_SWEEPS and program.bound == 0.0 and isinstance(program, Routes)
        if isinstance(program, Routes):
            program.rough = rough
        search.solve_program()
        if search.problem.out_of_time or (sweep >= sweeps and program.bound > 0.0):
            break
        apart = ROUTES.apart if sweep < sweeps - 1 else 0.0
        threshold = max(ceiling(program.bound, search.tolerance), program.value)
        found = search.add_violated_sites(program_law(search), threshold, apart)
        if found is None and not rough:
            break


def program_law(search: Search) -> Law:
    """Return the law by which the program's strategies are drawn."""
    if isinstance(search.program, Routes):
        return search.program.mixture
    return flow_law(search)


def flow_law(search: Search) -> MarkovChain:
    """The chains of the program's flow."""
    networks = [game.network for game in search.legs.games]
    return chain_of_legs(networks, search.program.flow, search.legs.first)

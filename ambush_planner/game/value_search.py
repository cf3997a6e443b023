# SPDX-License-Identifier: Apache-2.0
"""The first two stages of a solve: the least value, and the sites that decide it.

A program finds the least value at the known sites (``value``). With a reach, the sites of the map
that its strategies violate most are added, until there are none.
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
# Gap of a program in potentials that only decides where a network is refined [tolerances].
ROUGH_GAP = 0.5
# Rounds of separation before the distribution is sought; there are more while the value is 0. From
# the last of these on, sites may be as close to each other as they come.
SWEEPS = 3
# Rounds of separation before a program over routes is solved precisely.
ROUGH_SWEEPS = 2


def find_value(problem: SearchProblem, rough: bool = False) -> Search:
    """Find the least value within the budgets, and an ambusher's strategy that nearly certifies it.

    A ``rough`` search is less precise, until ``tighten``.
    """
    search = Search(problem, _program(problem, ROUGH_GAP if rough else POTENTIAL_GAP))
    find_sites(search)
    return search


def _program(problem: SearchProblem, gap: float) -> Program:
    """Choose the program for the value; one in potentials ends at the ``gap`` [tolerances]."""
    legs, tolerance = problem.legs, problem.search_tolerance
    if len(legs.games) > 1 and legs.no_reentry:
        return EdgeFlows(legs, EDGES_GAP * tolerance)
    if len(legs.games) == 1:
        faces = make_faces(legs.games[0])
        if faces and faces.same_both_ways(legs.budgets[0].cost):
            return Potential(legs, faces, gap * tolerance, problem.first_value)
    return Routes(legs, ROUTES_GAP * tolerance)


def find_value_by_max_flow(problem: SearchProblem) -> Search | None:
    """Find the value of a leg without a reach by a maximum flow, if that keeps the budget."""
    legs = problem.legs
    if not legs.no_reentry or len(legs.games) > 1:
        return None
    program = EdgeFlows(legs, EDGES_GAP * problem.search_tolerance)
    return Search(problem, program) if program.solve_by_max_flow() else None


def tighten(search: Search) -> None:
    """Make a rough search precise."""
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
        spacing = ROUTES.site_spacing if sweep < sweeps - 1 else 0.0
        threshold = max(ceiling(program.bound, search.tolerance), program.value)
        found = search.add_violated_sites(program_law(search), threshold, spacing)
        if found is None and not rough:
            break


def program_law(search: Search) -> Law:
    """Return the law of the program's strategies."""
    if isinstance(search.program, Routes):
        return search.program.mixture
    return flow_law(search)


def flow_law(search: Search) -> MarkovChain:
    """Return the chain of the program's flow."""
    networks = [game.network for game in search.legs.games]
    return chain_of_legs(networks, search.program.flow, search.legs.first)

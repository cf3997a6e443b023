# SPDX-License-Identifier: Apache-2.0
"""The ambush game on a network, and its solution. Read the modules in this order.

The game: ``discs`` finds the edges that enter an ambush's disc, ``game`` has the playable edges,
the sites and their losses, ``budget`` limits the length of routes, and ``legs`` joins the games of
a trip. ``hits`` computes the probability that a site hits a drawn route, from the routes' law: a
Markov chain (``distribution.chain``) or a mixture of whole routes. ``route_sampler`` draws routes.

The records: ``ambusher`` and ``strategy`` hold both sides' mixed strategies; ``certificate``
computes value and lower bound from these alone.

The solution: ``solver`` runs four stages, whose state is ``search``.

1. Value: ``value_search`` chooses a program (``value``) for the least value and an ambusher's
   strategy that certifies the bound: a maximum flow (``cut``), potentials of ``faces``
   (``potential``), column generation over whole routes (``routes``), or an LP in the edges of all
   legs (``edge_flows``). The paper's LPs (``linear_program``) are another choice.
2. Sites: violated sites of the map are added to the program, which is solved again (separation).
3. Distribution: ``distribution_search`` finds the law of greatest entropy within the ``tolerance``
   of the bound, a Gibbs distribution on an acyclic subnetwork (``distribution``).
4. Certificate: ``proof`` recomputes value and bound.

Afterwards, ``revaluation`` computes values and bounds in other games, and ``bottleneck`` finds the
sites that decide the value. Other rooms use ``solve`` and the records of ``strategy``.
"""

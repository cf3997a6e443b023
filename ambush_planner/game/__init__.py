# SPDX-License-Identifier: Apache-2.0
"""The ambush game on a network, and its solution.

The game: ``discs`` says which edges enter an ambush's reach, ``game`` who may wait where and what
it costs, ``budget`` how long routes may be, ``legs`` what a trip's legs are together. ``hits`` are
what an ambush does to routes, however these are drawn: by a chain or as whole routes
(``distribution.chain``, ``route_sampler``).

The record: ``ambusher``, ``certificate`` and ``strategy`` hold both sides' strategies, value and
lower bound, which follow from these alone.

The solution, ``solver``, has four stages:

1. ``value_search`` finds the least value by a program of ``value``: a maximum flow, potentials of
   ``faces``, or whole routes; ``search`` is its state.
2. It adds the sites that cost the program's strategies most, and goes on.
3. ``distribution_search`` finds the law of greatest entropy within the ``tolerance`` of the bound
   (``distribution``).
4. ``proof`` computes value and bound again, by ``certificate``.

Afterwards, ``revaluation`` has values and bounds in other games, ``bottleneck`` the sites that
decide the value. From outside, use ``solve`` of ``solver``, and ``strategy``: the record and its
options.
"""

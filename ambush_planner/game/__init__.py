# SPDX-License-Identifier: Apache-2.0
"""The ambush game on a network, and its solution.

``game`` has the ambush sites and losses, ``discs`` the edges that enter an ambush's reach.
``certificate`` bounds the value from both sides. ``cut`` and ``least_risk`` find the value,
``gibbs``, ``entropy_search`` and ``entropy_stage`` the most unpredictable strategy that attains
it. Use ``strategy`` from outside: the record ``Strategy``, its options, and ``solve``.
"""

"""The ambush game on a network, and its solution.

``game`` says who may wait where, ``discs`` whom an ambush with a reach hits. ``certificate`` judges
any pair of strategies. ``cut`` and ``least_risk`` find the value, ``gibbs`` and ``entropy_search``
the most unpredictable strategy that attains it; ``strategy`` is the record, with ``solve``.
"""

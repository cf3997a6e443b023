"""The pure core, numpy and scipy only. In reading order:

1. ``errors``, ``arrays``, ``options``: what all share.
2. ``risk_map``, ``obstacles``, ``sampling``, ``connectivity``, ``layout``, ``passages``,
   ``construction``: from a map to a ``network``.
3. ``paths``, ``discs``, ``game``: who drives where, who may wait where, what it costs.
4. ``certificate``: what a strategy costs, and what no strategy can do better.
5. ``acyclic``, ``cut``, ``flow_program`` (by ``highs``), ``least_risk``: the least value and the
   ambusher's strategy.
6. ``gibbs`` (by ``triangular``), ``most_entropy``, ``max_entropy``: of the best strategies, the
   most unpredictable.
7. ``linear_program``: the paper's solvers. ``strategy``: the record, and ``solve``.
8. ``routes``, ``corridors`` (by ``room``), ``refitted``, ``taut_string``, ``driven_path``: drawing
   a route, and the path that is driven; ``day``: routes that do not share their middle.
9. ``judged``, ``evaluation``, ``bottleneck``, ``frontier``: what is said about a strategy.
10. ``planner`` (with ``cover``), ``trip``, ``batch``: the whole story, once, by way of stops, and
    many times.
"""

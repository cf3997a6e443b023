"""How much route entropy the acyclic part keeps, against mixtures of all simple routes.

The games are so small that all simple routes can be listed. The most entropy that a mixture of them
has within the same limits is the minimum of the dual function, which is an upper bound even if
the search ends early.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp

from ambush_planner import GameOptions, Network, StrategyOptions, solve

sys.path.append(str(Path(__file__).parent.parent / 'test'))
from games import terrain_network
from test_reach import planar_network, routes_of

GAMES, MOST_NODES = 300, 11
# (max_detour, risk_slack)
LIMITS = (1.2, 0.01), (1.2, 0.1), (1.5, 0.01), (np.inf, 0.01)


def tiny_network(seed: int) -> Network:
    """Every other network is Delaunay's of random points, the others lie on terrain."""
    if seed % 2:
        return planar_network(seed, inside=seed % 4 == 1)
    while len((network := terrain_network(seed, cells=5)).points) > MOST_NODES:
        seed += 10_000
    return network


def share_kept(network: Network, detour: float, slack: float) -> float:
    """Route entropy over the most that a mixture of simple routes has; NaN without a choice."""
    found = solve(network, GameOptions(), StrategyOptions(max_detour=detour, risk_slack=slack))
    if found.value == 0.0:
        return np.nan
    routes = routes_of(network)
    uses = np.zeros((len(routes), len(network.edges)))
    for row, route in zip(uses, routes, strict=True):
        row[route] = 1.0
    site_limits = (1.0 + slack) * found.lower_bound / found.game.loss[found.game.sites]
    limits = np.append(site_limits, found.length_budget)
    costs = np.c_[uses @ found.game.hits.T.toarray(), uses @ network.lengths] / limits
    most = minimize(lambda v: logsumexp(-costs @ v) + v.sum(), np.ones(len(limits)),
                    bounds=[(0.0, None)] * len(limits)).fun
    return found.route_entropy / most if most > 1e-3 else np.nan


if __name__ == '__main__':
    for detour, slack in LIMITS:
        kept = np.array([share_kept(tiny_network(seed), detour, slack) for seed in range(GAMES)])
        chosen = kept[np.isfinite(kept)]
        median, low = np.quantile(chosen, (0.5, 0.05))
        print(f'max_detour {detour:g}, risk_slack {slack:g}, {len(chosen)} games with a choice: '
              f'median {median:.2f}, 5 % quantile {low:.2f}, least {chosen.min():.2f}')

# SPDX-License-Identifier: Apache-2.0
"""Several ambushers: how they share the sites if no budget binds.

With one ambusher, q is spread over the cheapest set of sites that every route meets, a cut, in
proportion to 1 / alpha. Several ambushers hold some sites of the set for certain, and the others
move on to further sets. A linear program over sets finds the best shares. Its duals are the loss
that each site may cause, and these price the next set, until no set is cheap enough to join
(docs/theory.md, Proposition 2.4).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray, IndexArray
from ...errors import SolverFailed

# A set joins if it costs less than this; 1 would prove the value.
CHEAP = 1.0 - 1e-7
# Least loss that a site may cause, as a share of the value.
MIN_LEVEL = 1e-9
# Most sets that join.
MAX_SETS = 200


class SharedSites(NamedTuple):
    """Value, q (S,) of the sites, and the ``level`` (S,): mean loss that each site may cause.

    q sums to less than the number of ambushers if more of them would not add to the value.
    """

    value: float
    q: FloatArray
    level: FloatArray


def share_sites(loss: FloatArray, ambushers: int,
                cheapest: Callable[[FloatArray], IndexArray | None]) -> SharedSites | None:
    """Find q for sites with losses (S,); None if some route meets no site.

    ``cheapest`` finds the set of sites that every route meets whose costs (S,) have the least sum.
    """
    from scipy.optimize import linprog  # slow to load, see entropy_search

    sets: list[FloatArray] = []
    level = np.full(len(loss), loss.max())
    while len(sets) < MAX_SETS:
        chosen = cheapest(level / loss)
        if chosen is None:
            return None
        newest = np.zeros(len(loss))
        newest[chosen] = 1.0 / loss[chosen]
        if sets and float(newest @ level) >= CHEAP or any((newest == each).all() for each in sets):
            break
        sets.append(newest)
        total = np.array([each.sum() for each in sets])
        shares = np.array(sets).T / total  # q for one ambusher on each set
        unit = 1.0 / total[0]
        if len(sets) == 1 and ambushers * shares.max() <= 1.0:
            return SharedSites(ambushers * unit, ambushers * shares[:, 0],
                               np.full(len(loss), unit))
        met = np.flatnonzero(shares.any(axis=1))
        rows = np.vstack((shares[met], np.ones(len(sets))))
        limits = np.append(np.ones(len(met)), float(ambushers))
        found = linprog(-1.0 / (total * unit), rows, limits, method='highs-ds')
        if found.status != 0:
            raise SolverFailed(f'the program over sets of sites: {found.message}')
        level = np.full(len(loss), max(-found.ineqlin.marginals[-1], -MIN_LEVEL * found.fun))
        level[met] -= found.ineqlin.marginals[:-1]
        level *= unit
    return SharedSites(float(-found.fun) * unit, shares @ found.x, level)

# SPDX-License-Identifier: Apache-2.0
"""A plan for other Python libraries: tables of geometries, comparisons."""

import numpy as np
import pytest
from games import plain_options

from ambush_planner import GameOptions, InvalidOption, PlanningOptions, RiskMap, plan_trip

OPTIONS = PlanningOptions(network=plain_options(spacing=20.0),
                          game=GameOptions(ambush_radius=20.0))


@pytest.fixture(scope='module')
def plan():
    ground = RiskMap(np.ones((20, 30)), np.zeros((20, 30), bool), 10.0, (4e5, 4e6, 0.0),
                     'EPSG:32616')
    return plan_trip(ground, (4e5 + 25.0, 4e6 + 95.0), (4e5 + 275.0, 4e6 + 95.0), OPTIONS)


def test_tables_of_edges_and_sites(plan):
    pytest.importorskip('geopandas', reason='tables of geometries take the extra "gis"')
    edges, sites = plan.edges(), plan.sites()
    assert edges.crs == sites.crs == 'EPSG:32616'
    assert (edges.length * edges['probability']).sum() == pytest.approx(
        plan.strategy.expected_length, rel=1e-4)
    assert sites['probability'].sum() == pytest.approx(1.0, abs=1e-3)


def test_paths_are_shorter_than_routes_and_their_number_is_checked(plan):
    straight = 250.0
    assert straight <= plan.driven_length < plan.strategy.expected_length
    for n in (-1, 1.5):
        with pytest.raises(InvalidOption, match='n must be a whole number'):
            plan.paths(n)

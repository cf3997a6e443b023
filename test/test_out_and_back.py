# SPDX-License-Identifier: Apache-2.0
"""A trip out and back over the same ground: a site of both legs is shown once, with its total."""

from dataclasses import replace

import numpy as np
import pytest
from audit_samples import GOAL, SECURED, SPACING, START, occupancy
from rclpy.serialization import deserialize_message
from ros_harness import header
from visualization_msgs.msg import MarkerArray

from ambush_planner.game.game import GameOptions
from ambush_planner.maps.occupancy import risk_from_occupancy
from ambush_planner.network.construction import NetworkOptions
from ambush_planner.planning.options import PlanningOptions
from ambush_planner.planning.trip import plan_trip
from ambush_planner.recordings import report_data
from ambush_planner.ros.markers import ambush_sites


@pytest.fixture(scope='module')
def plan():
    """The plan of a way there and back, with an ambusher who waits for both legs everywhere."""
    options = PlanningOptions(network=NetworkOptions(spacing=1.6 * SPACING),
                              game=GameOptions(secured_radius=SECURED, ambushers=2))
    risk_map = risk_from_occupancy(occupancy(), 5.0)
    made = plan_trip(risk_map, START, START, options, stops=[GOAL])
    ambusher = made.strategy.ambusher
    both = np.tile(ambusher.q / 2.0, (2, 1))
    return replace(made, strategy=replace(made.strategy, ambusher=replace(ambusher, by_leg=both)))


@pytest.fixture
def total(plan):
    """Each place's share of both legs (K,)."""
    strategy = plan.strategy
    out, back = strategy.ambusher.by_leg
    return strategy.game.at_places(out + back)


def test_shares_of_places_add_up_to_the_number_of_ambushers(plan, total):
    np.testing.assert_allclose(plan.strategy.ambush_at_places, total, atol=1e-12)
    assert total.sum() == pytest.approx(plan.strategy.game.ambushers)


def test_markers_and_report_show_each_site_once(plan, total):
    strategy = plan.strategy
    points = strategy.network.points[strategy.network.representatives]
    (marker,) = deserialize_message(ambush_sites(strategy, header()), MarkerArray).markers
    np.testing.assert_array_equal([(point.x, point.y) for point in marker.points],
                                  points[total >= 1e-4 * total.max()])
    reported, often = report_data._sites(strategy), total > 1e-3 * total.max()
    np.testing.assert_array_equal(reported[:, :2], points[often])
    np.testing.assert_allclose(reported[:, 2], total[often] / total.max())
    assert len(plan.bottleneck.sites) == (total > 1e-6 * total.max()).sum()

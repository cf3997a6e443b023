# SPDX-License-Identifier: Apache-2.0
"""Markers tell what the strategy says: one marker a topic, as many points as colours."""

from dataclasses import replace

import numpy as np
import pytest
from audit_samples import GOAL, SECURED, SPACING, START, occupancy
from rclpy.serialization import deserialize_message
from ros_harness import risk_grid
from visualization_msgs.msg import Marker, MarkerArray

from ambush_planner.game.game import GameOptions
from ambush_planner.game.solver import solve
from ambush_planner.maps.occupancy import risk_from_occupancy
from ambush_planner.maps.ros_messages import occupancy_from_ros
from ambush_planner.network.construction import NetworkOptions
from ambush_planner.planning.options import PlanningOptions
from ambush_planner.planning.trip import plan_trip
from ambush_planner.recordings import report_data
from ambush_planner.ros.markers import (
    ambush_sites,
    edge_probabilities,
    mean_direction,
    network_lines,
)

ALL = (edge_probabilities, mean_direction, ambush_sites)


@pytest.fixture(scope='module')
def strategy():
    risk_map = risk_from_occupancy(*occupancy_from_ros(risk_grid()))
    options = PlanningOptions(network=NetworkOptions(spacing=1.0))
    return plan_trip(risk_map, (1.5, 5.5), (8.5, 5.5), options).strategy


def only(serialised):
    (marker,) = deserialize_message(serialised, MarkerArray).markers
    return marker


def positions(marker):
    assert all(point.z == 0.0 for point in marker.points)
    return np.array([(point.x, point.y) for point in marker.points])


def assert_near(found, wanted, edge=1.0):
    """To a 64th of the edges' length, in numbers whose last bits are 0."""
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=edge / 64)
    assert (np.array(found) * 128 % 1 == 0).all()


def alphas(marker):
    return np.array([colour.a for colour in marker.colors])


@pytest.mark.parametrize('build', ALL)
def test_one_marker_with_a_colour_a_point(strategy, build):
    marker = only(build(strategy, 'map', 0))
    assert (marker.ns, marker.id, marker.action) == (build.__name__, 0, Marker.ADD)
    assert marker.header.frame_id == 'map'
    assert marker.pose.orientation.w == 1.0
    assert len(marker.points) == len(marker.colors) > 0
    assert marker.scale.x > 0.0
    assert ((alphas(marker) > 0.0) & (alphas(marker) <= 1.0)).all()


def test_edges_in_use_are_drawn_from_tail_to_head(strategy):
    marker = only(edge_probabilities(strategy, 'map', 0))
    assert marker.type == Marker.LINE_LIST
    network, p = strategy.network, strategy.edge_probability
    used = network.edges[p >= 1e-3]
    assert_near(positions(marker), network.points[used.ravel()])


def test_arrows_start_at_nodes_and_point_along_the_mean_direction(strategy):
    strokes = positions(only(mean_direction(strategy, 'map', 0))).reshape(-1, 6, 2)
    visited = (strategy.visit_probability >= 1e-3) & (np.hypot(*strategy.mean_direction().T) > 1e-6)
    assert_near(strokes[:, 0], strategy.network.points[visited])
    shafts, wanted = strokes[:, 1] - strokes[:, 0], strategy.mean_direction()[visited]
    cosine = (shafts * wanted).sum(axis=1) / np.hypot(*shafts.T) / np.hypot(*wanted.T)
    np.testing.assert_allclose(cosine, 1.0, atol=1e-3)


def test_sites_are_where_the_ambusher_waits(strategy):
    marker = only(ambush_sites(strategy, 'map', 0))
    q = strategy.ambush_probability
    assert_near(positions(marker), strategy.network.points[q >= 1e-3 * q.max()])
    reaching = solve(strategy.network, GameOptions(ambush_radius=1.2))
    scale = only(ambush_sites(reaching, 'map', 0)).scale
    assert (scale.x, scale.y) == (2.4, 2.4), 'as wide as the ambush reaches'


def test_network_draws_each_pair_once(strategy):
    marker = only(network_lines(strategy, 'map', 0))
    pairs = {frozenset(edge) for edge in strategy.network.edges.tolist()}
    ends = positions(marker).reshape(-1, 4)
    assert len(np.unique(ends, axis=0)) == len(ends) == len(pairs)
    assert 0.0 < marker.color.a < 1.0


# A trip out and back over the same ground: a site of both legs is shown once, with its total.


@pytest.fixture(scope='module')
def plan():
    """A round trip whose ambusher waits at each of his sites equally often on both legs."""
    options = PlanningOptions(network=NetworkOptions(spacing=1.6 * SPACING),
                              game=GameOptions(secured_radius=SECURED))
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


def test_shares_of_places_add_up_to_1(plan, total):
    np.testing.assert_allclose(plan.strategy.ambush_at_places, total, atol=1e-12)
    assert total.sum() == pytest.approx(1.0)


def test_markers_and_report_show_each_site_once(plan, total):
    strategy = plan.strategy
    points = strategy.network.points[strategy.network.representatives]
    (marker,) = deserialize_message(ambush_sites(strategy, 'map', 0), MarkerArray).markers
    assert_near([(point.x, point.y) for point in marker.points],
                points[total >= 1e-3 * total.max()], np.median(strategy.network.lengths))
    reported, often = report_data._sites(strategy), total > 1e-3 * total.max()
    np.testing.assert_array_equal(reported[:, :2], points[often])
    np.testing.assert_allclose(reported[:, 2], total[often] / total.max())
    assert len(plan.bottleneck.sites) == (total > 1e-6 * total.max()).sum()

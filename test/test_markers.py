# SPDX-License-Identifier: Apache-2.0
"""Markers tell what the strategy says: one marker a topic, as many points as colours."""

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
from ambush_planner.ros.markers import (
    ambush_sites,
    edge_probabilities,
    mean_direction,
    network_lines,
)

ALL = (edge_probabilities, mean_direction, ambush_sites)


@pytest.fixture(scope='module')
def trip():
    risk_map = risk_from_occupancy(*occupancy_from_ros(risk_grid()))
    options = PlanningOptions(network=NetworkOptions(spacing=1.0))
    return plan_trip(risk_map, (1.5, 5.5), (8.5, 5.5), options).trip


@pytest.fixture(scope='module')
def strategy(trip):
    return trip.legs[0]


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
def test_one_marker_with_a_colour_a_point(trip, build):
    marker = only(build(trip, 'map', 0))
    assert (marker.ns, marker.id, marker.action) == (build.__name__, 0, Marker.ADD)
    assert marker.header.frame_id == 'map'
    assert marker.pose.orientation.w == 1.0
    assert len(marker.points) == len(marker.colors) > 0
    assert marker.scale.x > 0.0
    assert ((alphas(marker) > 0.0) & (alphas(marker) <= 1.0)).all()


def test_edges_in_use_are_drawn_from_tail_to_head(trip, strategy):
    marker = only(edge_probabilities(trip, 'map', 0))
    assert marker.type == Marker.LINE_LIST
    network, p = strategy.network, strategy.edge_probability
    used = network.edges[p >= 1e-3]
    assert_near(positions(marker), network.points[used.ravel()])


def test_arrows_start_at_nodes_and_point_along_the_mean_direction(trip, strategy):
    strokes = positions(only(mean_direction(trip, 'map', 0))).reshape(-1, 6, 2)
    visited = (strategy.visit_probability >= 1e-3) & (np.hypot(*strategy.mean_direction().T) > 1e-6)
    assert_near(strokes[:, 0], strategy.network.points[visited])
    shafts, wanted = strokes[:, 1] - strokes[:, 0], strategy.mean_direction()[visited]
    cosine = (shafts * wanted).sum(axis=1) / np.hypot(*shafts.T) / np.hypot(*wanted.T)
    np.testing.assert_allclose(cosine, 1.0, atol=1e-3)


def test_sites_are_where_the_ambusher_waits(trip, strategy):
    marker = only(ambush_sites(trip, 'map', 0))
    q = trip.ambusher.q
    assert_near(positions(marker), strategy.network.points[q >= 1e-3 * q.max()])
    reaching = solve(strategy.network, GameOptions(ambush_radius=1.2)).alone
    scale = only(ambush_sites(reaching, 'map', 0)).scale
    assert (scale.x, scale.y) == (2.4, 2.4), 'as wide as the ambush reaches'


def test_network_draws_each_pair_once(trip, strategy):
    marker = only(network_lines(trip, 'map', 0))
    pairs = {frozenset(edge) for edge in strategy.network.edges.tolist()}
    ends = positions(marker).reshape(-1, 4)
    assert len(np.unique(ends, axis=0)) == len(ends) == len(pairs)
    assert 0.0 < marker.color.a < 1.0


@pytest.fixture(scope='module')
def round_trip():
    """A trip out and back over the same ground."""
    options = PlanningOptions(network=NetworkOptions(spacing=1.6 * SPACING),
                              game=GameOptions(secured_radius=SECURED))
    risk_map = risk_from_occupancy(occupancy(), 5.0)
    return plan_trip(risk_map, START, START, options, stops=[GOAL]).trip


def test_markers_show_each_site_of_both_legs_once(round_trip):
    network, q = round_trip.game.network, round_trip.ambusher.q
    assert q.sum() == pytest.approx(1.0)
    assert_near(positions(only(ambush_sites(round_trip, 'map', 0))),
                network.points[q >= 1e-3 * q.max()], np.median(network.lengths))


def test_edges_of_both_legs_are_shown_with_their_sum(round_trip):
    edges, uses = round_trip.ground_uses
    length = sum(leg.expected_length for leg in round_trip.legs)
    ends = round_trip.game.network.points[edges]
    assert uses @ np.hypot(*(ends[:, 0] - ends[:, 1]).T) == pytest.approx(length)
    marker = only(edge_probabilities(round_trip, 'map', 0))
    assert len(marker.points) == 2 * (uses >= 1e-3).sum()
    arrows = positions(only(mean_direction(round_trip, 'map', 0))).reshape(-1, 6, 2)
    assert len(arrows) == sum(
        ((leg.visit_probability >= 1e-3) & (np.hypot(*leg.mean_direction().T) > 1e-6)).sum()
        for leg in round_trip.legs)

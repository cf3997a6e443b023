# SPDX-License-Identifier: Apache-2.0
"""Networks on maps: positions of nodes, joined pairs, and repeatability."""

import itertools

import numpy as np
import pytest
from games import METHODS, examples, random_map
from hypothesis import assume, given
from hypothesis import strategies as st

from ambush_planner import (
    GoalBlocked,
    InvalidNetwork,
    InvalidOption,
    NetworkOptions,
    NoRoute,
    RiskMap,
    StartBlocked,
    build_network,
)
from ambush_planner.errors import GoalOutsideMap, StartOutsideMap
from ambush_planner.maps.obstacles import ObstacleField
from ambush_planner.network.shortest_paths import distances_from


def open_map(rows=6, columns=8, origin=(0.0, 0.0, 0.0)) -> RiskMap:
    alpha = 1.0 + np.arange(rows * columns).reshape(rows, columns)
    return RiskMap(alpha, np.zeros((rows, columns), bool), 1.0, origin)


def build(risk_map, start, goal, method='uniform_delaunay', **options):
    """Start and goal in map axes."""
    ends = risk_map.to_world(np.array([start, goal], float))
    return build_network(risk_map, *ends, NetworkOptions(method=method, **options))


def joined(network) -> set[tuple[int, int]]:
    return {tuple(sorted(edge)) for edge in network.edges.tolist()}


def lattice_pairs(network) -> set:
    """Pairs of nodes by (column, row) of a lattice of spacing 1, start and goal by their cells."""
    place = [tuple(int(c) for c in np.floor(point)) for point in network.points]
    return {frozenset((place[i], place[j])) for i, j in joined(network)}


@st.composite
def random_networks(draw):
    """A map, the options and the network between two free points, on any of the methods."""
    cells = draw(st.integers(4, 9))
    risk_map = random_map(draw(st.integers(0, 10**6)), cells, 0.12, draw(st.floats(-4, 4)))
    place = st.tuples(*[st.floats(0.35, cells - 0.35)] * 2)
    options = NetworkOptions(
        method=draw(st.sampled_from(METHODS)), spacing=draw(st.sampled_from((0.7, 1.0, 1.3, 1.7))),
        clearance=draw(st.sampled_from((0.0, 0.3))), seed=draw(st.integers(0, 9)),
    )
    ends = risk_map.to_world(np.array(draw(st.tuples(place, place))))
    try:
        return risk_map, options, build_network(risk_map, *ends, options), ends
    except (StartBlocked, GoalBlocked, NoRoute, InvalidNetwork):
        assume(False)


@examples(25)
@given(random_networks())
def test_laws(built):
    risk_map, options, network, ends = built
    s, t = network.source, network.target
    assert np.array_equal(network.points[[s, t]], ends)
    assert network.alpha[s] == network.alpha[t] == 0.0
    assert s not in network.heads and t not in network.tails
    uv = risk_map.to_map_axes(network.points)
    cells = risk_map.cells(uv)
    inner = np.setdiff1d(np.arange(len(uv)), (s, t))
    assert np.array_equal(network.alpha[inner], risk_map.alpha[cells][inner])
    assert not risk_map.obstacles[cells].any()
    field = ObstacleField(risk_map)
    assert field.clear_points(uv, options.clearance - 1e-9 if options.clearance else 0.0).all()
    a, b = uv[network.tails], uv[network.heads]
    assert field.clear_segments(a, b, max(options.clearance - 1e-9, 0.0)).all()
    both = {tuple(edge) for edge in network.edges.tolist()}
    assert all((j, i) in both for i, j in both if i != s and j != t)
    again = build_network(risk_map, *ends, options)
    for name in ('points', 'edges', 'alpha'):
        assert getattr(network, name).tobytes() == getattr(again, name).tobytes()


@pytest.mark.parametrize('method', METHODS[1:3])
def test_lattice_nodes_lie_at_half_spacings_and_ends_replace_the_nearest(method):
    network = build(open_map(), (0.6, 0.7), (7.2, 5.9), method, spacing=1.0)
    expected = set(itertools.product(np.arange(8) + 0.5, np.arange(6) + 0.5))
    expected -= {(0.5, 0.5), (7.5, 5.5)}
    assert {tuple(point) for point in network.points[:-2].tolist()} == expected
    assert network.points[-2:].tolist() == [[0.6, 0.7], [7.2, 5.9]]


def test_herringbone_rising_in_even_rows_falling_in_odd_rows():
    network = build(open_map(), (0.5, 0.5), (7.5, 5.5), 'lattice_delaunay', spacing=1.0)
    found = lattice_pairs(network)
    expected = set()
    for c, r in itertools.product(range(8), range(6)):
        expected.add(frozenset(((c, r), (c + 1, r))))
        expected.add(frozenset(((c, r), (c, r + 1))))
        rising = ((c, r), (c + 1, r + 1)) if r % 2 == 0 else ((c, r + 1), (c + 1, r))
        expected.add(frozenset(rising))
    inside = {pair for pair in expected if all(c < 8 and r < 6 for c, r in pair)}
    assert found == inside


def test_grid8_joins_each_node_to_its_eight_neighbours():
    found = lattice_pairs(build(open_map(), (0.5, 0.5), (7.5, 5.5), 'uniform_grid8', spacing=1.0))
    cells = list(itertools.product(range(8), range(6)))
    near = {frozenset((a, b)) for a, b in itertools.combinations(cells, 2)
            if max(abs(a[0] - b[0]), abs(a[1] - b[1])) == 1}
    assert found == near


@pytest.mark.parametrize('method, worst', [('uniform_delaunay', 1.11), ('uniform_grid8', 1.09)])
def test_routes_are_nearly_straight_in_all_directions(method, worst):
    side = 61
    risk_map = RiskMap(np.ones((side, side)), np.zeros((side, side), bool), 1.0)
    for start in 26.0 + 9.0 * np.random.default_rng(5).random((3, 2)):
        network = build(risk_map, start, (60.2, 60.3), method, spacing=1.0)
        lengths = distances_from(network.edges, network.lengths, len(network.points),
                                 network.source)
        straight = np.hypot(*(network.points - network.points[network.source]).T)
        far = (straight > 18) & (straight < 24)
        assert (lengths[far] / straight[far]).max() <= worst


@pytest.mark.parametrize(('method', 'clear_of_edge'), [
    ('uniform_grid8', True), ('uniform_delaunay', False), ('gradient_delaunay', False)])
def test_nothing_lies_on_the_outer_edge_of_the_map(method, clear_of_edge):
    """A map 50.1 m high at a spacing of 0.6 m has lattice nodes exactly on its edge."""
    risk_map = RiskMap(np.ones((167, 40)), np.zeros((167, 40), bool), 0.3, (5.0, -3.0, 0.4))
    network = build(risk_map, (1, 1), (11, 49), method, spacing=0.6, clearance=0.4,
                    clear_of_edge=clear_of_edge)
    uv = risk_map.to_map_axes(network.points)
    margin = 0.4 if clear_of_edge else 0.0
    assert (uv > margin).all() and (uv < np.array(risk_map.size) - margin).all()
    assert clear_of_edge or (uv < 0.4).any()


@pytest.mark.parametrize(('ends', 'spacing'), [
    (((0.5, 0.1), (13.5, 0.1)), 1.3), (((0.2, 0.2), (0.2, 13.9)), 0.7)])
def test_no_long_edge_runs_along_the_border(ends, spacing):
    network = build(open_map(14, 14), *ends, spacing=spacing)
    assert network.lengths.max() < 3 * spacing


@pytest.mark.parametrize('method', METHODS)
def test_narrow_maps(method):
    for rows, columns in ((1, 2), (9, 1), (2, 9)):
        far = (columns - 0.5, rows - 0.5)
        network = build(open_map(rows, columns), (0.5, 0.5), far, method, spacing=1.0)
        assert len(network.points) == rows * columns


@pytest.mark.parametrize(('method', 'spacing', 'count'), [
    ('lattice_delaunay', 1.0, 7), ('uniform_delaunay', 7.0, 2)])
def test_all_nodes_on_one_line_far_from_the_edge_of_the_map(method, spacing, count):
    """They have no triangles, and no mirror images that would make some."""
    obstacles = np.ones((60, 60), bool)
    obstacles[30, 27:34] = False
    risk_map = RiskMap(np.ones((60, 60)), obstacles, 1.0)
    network = build(risk_map, (27.5, 30.5), (33.5, 30.5), method, spacing=spacing)
    assert (len(network.points), len(joined(network))) == (count, count - 1)


def test_a_spacing_of_zero_aims_at_the_number_of_nodes_never_below_the_resolution():
    network = build(random_map(0, 40, 0.0), (1, 1), (39, 39), target_nodes=400)
    assert 350 <= len(network.points) <= 450
    assert len(build(open_map(), (0.5, 0.5), (7.5, 5.5)).points) == 48


# Inputs that build_network rejects.


def blocked_map() -> RiskMap:
    obstacles = np.zeros((5, 5), bool)
    obstacles[:, 2] = True
    return RiskMap(np.ones((5, 5)), obstacles, 2.0, (100.0, 50.0, 0.0))


@pytest.mark.parametrize('method', METHODS[1:3])
def test_no_route_names_both_ends_and_the_spacing(method):
    with pytest.raises(NoRoute, match=r'\(101\.000, 51\.000\) to \(109\.000, 51\.000\).* 2 m'):
        build_network(blocked_map(), (101, 51), (109, 51),
                      NetworkOptions(method=method, spacing=2.0))


@pytest.mark.parametrize('start, goal, error, words', [
    ((105, 51), (109, 51), StartBlocked, r'start \(105\.000, 51\.000\)'),
    ((101, 51), (105, 51), GoalBlocked, r'goal \(105\.000, 51\.000\)'),
    ((104, 51), (101, 51), StartBlocked, r'start \(104\.000'),  # on the obstacle's rim
    ((103.5, 51), (101, 59), StartBlocked, r'clearance 1 m'),
    ((99, 51), (101, 51), StartOutsideMap, r'start \(99\.000.*x from 100 to 110'),
    ((101, 51), (101, 61), GoalOutsideMap, r'goal \(101\.000, 61\.000\)'),
    ((np.nan, 51), (101, 51), StartBlocked, 'start'),
    ((101, 51), (np.inf, 51), GoalBlocked, 'goal'),
    ((101, 51, 0), (101, 52), StartBlocked, r'start .*\(3,\)'),
    (('x', 51), (101, 52), StartBlocked, "start .*'x'"),
    ((101, 51), (10**400, 52), GoalBlocked, 'goal'),
    ((101, 51), (101, 51), InvalidNetwork, 'same position'),
])
def test_rejects_invalid_ends(start, goal, error, words):
    clearance = 1.0 if 'clearance' in words else 0.0
    with pytest.raises(error, match=words):
        build_network(blocked_map(), start, goal, NetworkOptions(spacing=2.0, clearance=clearance))


def test_rejects_a_spacing_that_would_exhaust_memory():
    with pytest.raises(InvalidOption, match=r'spacing 1e-05 m on a map of 8 m x 6 m'):
        build(open_map(), (0.5, 0.5), (7.5, 5.5), spacing=1e-5)

"""Inputs that ``build_network`` rejects: invalid ends, no route, options out of range."""

from __future__ import annotations

import numpy as np
import pytest
from games import METHODS

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


def blocked_map() -> RiskMap:
    obstacles = np.zeros((5, 5), bool)
    obstacles[:, 2] = True
    return RiskMap(np.ones((5, 5)), obstacles, 2.0, (100.0, 50.0, 0.0))


@pytest.mark.parametrize('method', METHODS)
def test_no_route_names_both_ends_and_the_spacing(method):
    with pytest.raises(NoRoute, match=r'\(101\.000, 51\.000\) to \(109\.000, 51\.000\).* 2 m'):
        build_network(blocked_map(), (101, 51), (109, 51), NetworkOptions(method, 2.0))


@pytest.mark.parametrize(
    'start, goal, error, words',
    [
        ((105, 51), (109, 51), StartBlocked, r'start \(105\.000, 51\.000\) lies in an obstacle'),
        ((101, 51), (105, 51), GoalBlocked, r'goal \(105\.000, 51\.000\) lies in an obstacle'),
        ((104, 51), (101, 51), StartBlocked, r'start \(104\.000'),
        ((99, 51), (101, 51), StartOutsideMap, r'start \(99\.000.* outside .*10 m x 10 m'),
        ((101, 51), (101, 61), GoalOutsideMap, r'goal \(101\.000, 61\.000\) is outside'),
        ((np.nan, 51), (101, 51), StartBlocked, 'start must be finite'),
        ((101, 51), (np.inf, 51), GoalBlocked, 'goal must be finite'),
        ((101, 51, 0), (101, 52), StartBlocked, r'start must be a position.*\(3,\)'),
        (('x', 51), (101, 52), StartBlocked, "start must be a position .*'x'"),
        ((101, 51), (10**400, 52), GoalBlocked, 'goal must be a position .*too large'),
        ((101, 51), (101, 51), InvalidNetwork, 'same position'),
    ],
)
def test_rejects_invalid_ends(start, goal, error, words):
    with pytest.raises(error, match=words):
        build_network(blocked_map(), start, goal, NetworkOptions(spacing=2.0))


def test_ends_must_keep_the_clearance():
    options = NetworkOptions('uniform_grid8', spacing=2.0, clearance=1.0)
    with pytest.raises(StartBlocked, match=r'clearance 1 m'):
        build_network(blocked_map(), (103.5, 51), (101, 59), options)


@pytest.mark.parametrize(
    'options',
    [
        {'method': 'hexagons'}, {'spacing': -1.0}, {'spacing': np.nan}, {'spacing': np.inf},
        {'clearance': -0.1}, {'clearance': np.nan}, {'seed': -1}, {'target_nodes': 1},
    ],
)
def test_rejects_options_out_of_range(options):
    (name, value), = options.items()
    with pytest.raises(InvalidOption, match=name) as caught:
        NetworkOptions(**options)
    assert str(value) in str(caught.value)


def test_rejects_a_spacing_that_would_exhaust_memory():
    with pytest.raises(InvalidOption, match=r'spacing 1e-05 m on a map of 8 m x 6 m'):
        build_network(
            RiskMap(np.ones((6, 8)), np.zeros((6, 8), bool), 1.0), (0.5, 0.5), (7.5, 5.5),
            NetworkOptions(spacing=1e-5),
        )

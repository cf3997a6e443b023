# SPDX-License-Identifier: Apache-2.0
"""What a plan's value says about itself, in words."""

import numpy as np
import pytest
from plain import plain_options

from ambush_planner.game.game import GameOptions
from ambush_planner.maps.risk_map import RiskMap
from ambush_planner.planning.concerns import concerns
from ambush_planner.planning.options import DriveOptions, PlanningOptions
from ambush_planner.planning.trip import plan_trip

START, GOAL = (4.0, 10.0), (26.0, 10.0)


def plan(radius, held, alpha=1.0, tolerance=0.0, obstacles=None):
    """A plan across open ground of 30 m x 20 m."""
    cells = np.full((20, 30), alpha)
    risk_map = RiskMap(cells, np.zeros(cells.shape, bool) if obstacles is None else obstacles, 1.0)
    options = PlanningOptions(network=plain_options(spacing=1.5),
                              game=GameOptions(ambush_radius=radius, secured_radius=held),
                              drive=DriveOptions(start_tolerance=tolerance))
    return plan_trip(risk_map, START, GOAL, options)


@pytest.mark.parametrize('alpha', [1.0, 7.0])
def test_names_a_place_that_covers_every_way_out(alpha):
    (text,) = concerns(plan(3.0, 0.5, alpha))
    assert text.startswith(('one place covers every way out of the start: an ambush there always ',
                            'one place covers every way into the goal: an ambush there always '))
    assert 'hold 3.3 m there (game.secured_radius -1), or ' in text


def test_a_chosen_radius_leaves_no_place_that_covers_every_way_out():
    """By default it is the reach, tube and start tolerance, so the value is below certainty."""
    for tolerance in (0.0, np.inf):
        found = plan(3.0, None, tolerance=tolerance)
        assert found.strategy.game.options.held_radius == 3.3
        assert found.strategy.value < 0.9
        assert not any('covers every way' in text for text in concerns(found))


def test_names_a_passage_far_from_the_ends():
    wall = np.zeros((20, 30), bool)
    wall[:, 15] = True
    wall[9:11, 15] = False
    (text,) = concerns(plan(2.0, None, obstacles=wall))
    assert 'hits every route' in text and 'hold' not in text

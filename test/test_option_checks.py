# SPDX-License-Identifier: Apache-2.0
"""Options of a wrong type or out of range: an error of ours that names them."""

from pathlib import Path

import numpy as np
import pytest

from ambush_planner import GameOptions, InvalidOption, NetworkOptions, StrategyOptions
from ambush_planner.commands import plan
from ambush_planner.commands.inputs import options_of
from ambush_planner.gone import check_none_gone
from ambush_planner.maps import InvalidTerrain, OccupancyOptions, TerrainOptions, ViewOptions

RECORDS = (NetworkOptions, GameOptions, StrategyOptions)
WRONG = (None, '2', [1.0], True, 1j, np.nan, -2)


def numbers(record) -> list[str]:
    """Names of the fields of a record that take numbers."""
    defaults = {name: getattr(record(), name) for name in record.__dataclass_fields__}
    # Rounds of refinement may be None: as many as pay.
    return [name for name, value in defaults.items()
            if type(value) in (int, float) and name != 'refine']


@pytest.mark.parametrize('record', RECORDS)
@pytest.mark.parametrize('value', WRONG, ids=repr)
def test_every_number_of_every_record_is_checked(record, value):
    for name in numbers(record):
        with pytest.raises(InvalidOption, match=name) as caught:
            record(**{name: value})
        assert str(value) in str(caught.value)

YARD = str(Path(__file__).parents[1] / 'docs' / 'yard.yaml')


def test_an_option_that_went_is_refused_with_the_remedy(capsys):
    for flag in '--equal', '--load', '--order':
        with pytest.raises(SystemExit) as ended:
            plan.main([YARD, '--start', '1', '1', '--goal', '2', '2', '-o', 'r.csv', flag])
        assert ended.value.code == 2 and f'{flag} was removed: ' in capsys.readouterr().err
    for name, without in (('game.ambushers', 1), ('game.loads', ()), ('trip.order', 'given'),
                          ('strategy.max_exposure', np.inf)):
        with pytest.raises(InvalidOption, match=f'^{name} was removed: '):
            options_of([f'{name}=2'])
        with pytest.raises(InvalidOption, match=f'^{name} was removed: '):
            check_none_gone({name: 2})
        check_none_gone({name: without})  # as in a recording that did not use it


@pytest.mark.parametrize('record', RECORDS)
def test_numpy_numbers_are_accepted(record):
    for name in numbers(record):
        default = getattr(record(), name)
        kind = np.int32 if isinstance(default, int) else np.float32
        assert getattr(record(**{name: kind(default)}), name) == default or kind is np.float32


@pytest.mark.parametrize('record, name, values', [
    (StrategyOptions, 'solver', ['magic', None]), (StrategyOptions, 'max_detour', [0.99]),
    (StrategyOptions, 'risk_slack', [-0.1, np.inf]),
    (StrategyOptions, 'length_weight', [-0.1, 1.0]), (StrategyOptions, 'time_limit', [0.0]),
    (GameOptions, 'ambush_radius', [np.inf]), (GameOptions, 'secured_radius', [-0.1]),
    (GameOptions, 'ambush_in_obstacles', ['yes']),
    (NetworkOptions, 'method', ['hexagons']), (NetworkOptions, 'spacing', [-1.0, np.inf]),
    (NetworkOptions, 'clearance', [-0.1]), (NetworkOptions, 'target_nodes', [1]),
    (OccupancyOptions, 'alpha_min', [-1.0, np.nan, 1e-310]),
    (OccupancyOptions, 'alpha_max', [0.5, np.inf, 1e291]),
    (OccupancyOptions, 'obstacle_threshold', [0, 102]),
    (OccupancyOptions, 'unknown_alpha', [np.nan, 1e291]),
    (TerrainOptions, 'slope_limit', [0.0]),
    (TerrainOptions, 'weights', [(0.0,) * 4, (1.0, -1.0, 1.0, 1.0), (1.0, 1.0)]),
    (ViewOptions, 'weapon_range', [0.0]), (ViewOptions, 'vehicle_height', [-1.0]),
    (ViewOptions, 'person_height', [np.nan]), (ViewOptions, 'rays', [7]),
])
def test_values_out_of_range_are_named(record, name, values):
    for value in values:
        with pytest.raises((InvalidOption, InvalidTerrain), match=name) as caught:
            record(**{name: value})
        # Of several numbers, the one that is out of range.
        named = min(value) if np.size(value) == 4 and min(value) < 0.0 else value
        assert str(named) in str(caught.value)

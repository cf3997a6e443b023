# SPDX-License-Identifier: Apache-2.0
"""Strategy files: read back whole, their certificates computed from the probabilities."""

from io import BytesIO

import numpy as np
import pytest
from games import terrain_network

from ambush_planner import GameOptions, StrategyOptions, arrays, solve
from ambush_planner.recordings.attachments import NUMBERS, strategy_file, strategy_from_file


def test_a_file_that_would_fill_the_memory_is_refused_and_no_other_arrays_are_read(monkeypatch):
    monkeypatch.setattr(arrays, 'MAX_BYTES', 10**6)
    stream = BytesIO()
    np.savez_compressed(stream, points=np.zeros(10**6), other=np.zeros(10**6), alpha=np.ones(3))
    assert stream.tell() < 10**5
    with pytest.raises(ValueError, match=r'points would take 8e\+06 bytes'):
        strategy_from_file(stream.getvalue(), GameOptions())
    stream.seek(0)
    assert arrays.arrays_in(stream, ('alpha', 'absent')).keys() == {'alpha'}


@pytest.mark.parametrize(('solver', 'radius'), [('max_entropy', 1.0), ('simplex', 0.0)])
def test_a_strategy_comes_back_whole(solver, radius):
    network = terrain_network(3)
    theirs = solve(network, GameOptions(ambush_radius=radius), StrategyOptions(solver=solver))
    ours, stated = strategy_from_file(strategy_file(theirs), GameOptions(ambush_radius=radius))
    for name in ('points', 'alpha', 'edges', 'source', 'target', 'places', 'leg'):
        assert np.array_equal(getattr(ours.network, name), getattr(theirs.network, name))
    for name in ('edge_probability', 'ambush_probability', 'visit_probability'):
        assert np.array_equal(getattr(ours, name), getattr(theirs, name))
    assert stated == {name: getattr(theirs, name) for name in NUMBERS}
    for name in NUMBERS:
        assert getattr(ours, name) == pytest.approx(stated[name], rel=1e-9, abs=1e-12)
    rngs = np.random.default_rng(4), np.random.default_rng(4)
    assert np.array_equal(*(each.sample_route(rng) for each, rng in zip(
        (ours, theirs), rngs, strict=True)))

# SPDX-License-Identifier: Apache-2.0
"""Route sheets: what is written is read again, and files that are none are refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from ambush_planner.planning.route_sheet import (
    InvalidRouteSheet,
    RouteSheet,
    read_route_sheet,
    sheet_bytes,
    sheet_route,
)


def sheet(crs=None, shares=(0.75, 0.25), slots=(('08:00', 0.25), ('09:30', 0.75))):
    paths = [np.array([(0.0, 0.0, 0.0), (30.0, y, 0.1), (60.0, 0.0, 0.2)]) for y in (40.0, -40.0)]
    routes = tuple(sheet_route(k, share, path, crs)
                   for k, (share, path) in enumerate(zip(shares, paths, strict=True), start=1))
    return RouteSheet(Path('maps/yard.yaml'), crs, (0.0, 0.0), (60.0, 0.0), ((30.0, 0.0),), 2.0,
                      1.5, 0.5, 0.4, routes, slots)


@pytest.mark.parametrize('crs', [None, 'EPSG:32616'])
def test_round_trip(tmp_path, crs):
    written = sheet(crs)
    file = tmp_path / 'two.json'
    file.write_bytes(sheet_bytes(written, Path()))
    read = read_route_sheet(file)
    assert read.map == tmp_path / 'maps/yard.yaml'
    for name in ('crs', 'start', 'goal', 'stops', 'held_radius', 'reach', 'value', 'lower_bound',
                 'slots'):
        assert getattr(read, name) == getattr(written, name), name
    for one, other in zip(read.routes, written.routes, strict=True):
        assert (one.number, one.share, one.length) == (other.number, other.share, 100.0)
        assert np.array_equal(one.path, other.path)
        assert (one.lat_lon is None) == (crs is None)
        if crs:
            assert np.allclose(one.lat_lon, other.lat_lon, rtol=0.0, atol=1e-8)


def test_draws_follow_the_shares():
    rng = np.random.default_rng(0)
    drawn = [(route.number, slot) for route, slot in (sheet().draw(rng) for _ in range(1600))]
    for route, slot, share in ((1, '08:00', 3), (1, '09:30', 9), (2, '08:00', 1), (2, '09:30', 3)):
        assert abs(drawn.count((route, slot)) / 1600 - share / 16) < 0.05  # four deviations
    assert sheet(slots=()).draw(rng)[1] is None


@pytest.mark.parametrize('change', [
    lambda content: content.pop('value'),
    lambda content: content.update(format='another'),
    lambda content: content.update(extra=1),
    lambda content: content['routes'][0].update(path=[1.0, 2.0]),
    lambda content: content['routes'][0].update(share=0.9),
    lambda content: content.update(slots=[['08:00', 0.9]]),
    lambda content: content.pop('slots'),
])
def test_other_files_are_refused(tmp_path, change):
    content = json.loads(sheet_bytes(sheet(), Path()))
    change(content)
    file = tmp_path / 'two.json'
    for text in (json.dumps(content), '[]', 'no JSON'):
        file.write_text(text)
        with pytest.raises(InvalidRouteSheet, match='two.json: '):
            read_route_sheet(file)

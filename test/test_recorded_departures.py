"""Departures of a folder: their order, and copies count once."""

import shutil

import pytest
from audit_samples import START_NS, departure, drawn, record, sample_plan

from ambush_planner.recordings import recordings_in
from ambush_planner.recordings.recorded_departures import read_departures


@pytest.fixture(scope='module')
def a_plan():
    return sample_plan()


def read(folder):
    errors = []
    return read_departures(recordings_in(folder), errors.append), errors


def test_departures_come_in_order_of_time_then_number_and_copies_count_once(tmp_path, a_plan):
    routes = drawn(a_plan, 4)
    stamps = [START_NS + 5, START_NS, START_NS, START_NS + 9]
    paths = record(tmp_path, [
        departure(a_plan, route, number, stamp_ns=stamp)
        for route, number, stamp in zip(routes, (7, 3, 2, 1), stamps, strict=True)
    ])
    shutil.copy(paths[0], tmp_path / 'copy_0.mcap')
    found, errors = read(tmp_path)
    assert not errors and [each.number for each in found] == [2, 3, 7, 1]

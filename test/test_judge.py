# SPDX-License-Identifier: Apache-2.0
"""Judged trips: laws of their values, what counts as a trip, files of tracks, and the command."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from games import examples, plain_options
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip('geopandas', reason='files of tracks take the extra "gis"')
pytest.importorskip('matplotlib', reason='the picture needs matplotlib')

import geopandas
import shapely
from audit_samples import record_drawn, sample_plan
from commands import run_here
from gpxpy import gpx

from ambush_planner import GameOptions, PlanningOptions, RiskMap
from ambush_planner.commands import judge as command
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.maps.risk_map_file import npz_bytes
from ambush_planner.maps.track_file import InvalidFeatures, Track, read_tracks
from ambush_planner.operations.judge import MIN_DETOUR, find_trips, judge
from ambush_planner.operations.path_mixtures import MAX_GAP

# A driver with habits in docs/yard.yaml.
START, GOAL = (4.0, 20.0), (56.0, 20.0)
NORTH_OF_HALL = [(34.0, 22.0), (36.5, 30.5), (48.5, 30.5)]
SOUTH_OF_HALL = [(36.0, 16.0), (48.0, 16.0)]
ROUTES = {
    'short': [(30.0, 18.5), (33.0, 18.0), *SOUTH_OF_HALL],
    'north': [(26.0, 24.0), (30.0, 34.5), (34.0, 34.5), (49.0, 31.0)],
    'hall': [(30.0, 19.5), (33.0, 20.0), *NORTH_OF_HALL],
    'south': [(15.0, 14.0), (30.0, 5.0), (33.0, 5.0), (50.0, 13.0)],
}
HABIT = ('hall', 'hall', 'north', 'hall', 'short', 'hall', 'hall', 'north')
CRS = 'EPSG:32616'
ORIGIN = np.array([740000.0, 4050000.0])
REACH, NEAR = 2.0, 2.6
OPTIONS = PlanningOptions(network=plain_options(spacing=2.5),
                          game=GameOptions(ambush_radius=REACH))
ENDS = np.array(START), np.array(GOAL)
find = partial(find_trips, start=ENDS[0], goal=ENDS[1], near=NEAR, reach=REACH)


def driven(name, rng, step=3.5, noise=0.25):
    """Positions (L, 2) of a receiver on one of ``ROUTES``, a step apart [m]."""
    corners = np.array([START, *ROUTES[name], GOAL])
    along = np.append(0.0, np.hypot(*np.diff(corners, axis=0).T).cumsum())
    at = np.append(np.arange(0.0, along[-1] - 0.5 * step, step), along[-1])
    line = np.column_stack([np.interp(at, along, axis) for axis in corners.T])
    return line + rng.normal(0.0, noise, line.shape)


def habit(weeks, seed=0):
    """Tracks of trips on ``HABIT``, week by week, the last one by the south gate."""
    rng = np.random.default_rng(seed)
    return [driven(name, rng) for name in (*HABIT * weeks, 'south')]


def ground(seed=0):
    alpha = np.random.default_rng(seed).uniform(1.0, 5.0, (40, 60))
    obstacles = np.zeros((40, 60), dtype=bool)
    obstacles[14:26, 28:32] = True
    return RiskMap(alpha, obstacles, 1.0, (0.0, 0.0, 0.0))


IN_UTM = replace(ground(), origin=(*ORIGIN, 0.0), crs=CRS)


def tracks_of(lines, times=None):
    return [Track(f'track {k}', line, times) for k, line in enumerate(lines, start=1)]


@examples(2)
@given(st.integers(0, 10**6))
def test_habits_cost_at_least_their_best_shares(seed):
    trips, left_out = find(tracks_of(habit(1, seed)))
    assert not left_out
    found = judge(ground(seed), trips, OPTIONS)
    plan, mean = found.plan, found.lengths.mean()
    low, high = found.interval
    assert low <= found.driven.value <= high
    assert found.driven.value >= found.best.value * (1.0 - MAX_GAP)
    assert found.best.shares @ found.lengths <= mean * (1.0 + 1e-6)
    budget = max(mean, MIN_DETOUR * plan.strategy.shortest_length)
    assert plan.strategy.length_budget == pytest.approx(budget)
    # The other way round, from the goal, everything is the same but the network.
    back, _ = find_trips(tracks_of([trip.xy[::-1] for trip in trips]), *ENDS[::-1], NEAR, REACH)
    assert judge(ground(seed), back, OPTIONS).driven.value == pytest.approx(
        found.driven.value, rel=0.02)


def test_the_interval_is_that_of_drawn_resamples():
    trips, _ = find(tracks_of(habit(2)))
    found, rng = judge(ground(), trips, OPTIONS), np.random.default_rng(0)
    losses = found.driven.hit * found.driven.value / found.driven.hit.mean()
    means = rng.choice(losses, (20_000, len(trips))).mean(axis=1)
    assert found.interval == pytest.approx(np.quantile(means, (0.025, 0.975)), rel=1e-9)


LINE = driven('north', np.random.default_rng(0))
SPIKES = np.insert(LINE, [4, 9, 9], [(400.0, 10.0), (-90.0, 300.0), (-95.0, 310.0)], axis=0)
BEFORE, AFTER = np.array([(-9.0, 8.0), (-4.0, 14.0)]), np.array([(60.0, 25.0), (64.0, 29.0)])


@pytest.mark.parametrize('line', [
    np.repeat(LINE, 3, axis=0),
    SPIKES,
    np.concatenate((BEFORE, LINE, AFTER)),
    np.concatenate((LINE[:4], LINE[3::-1], LINE, LINE[:-6:-1])),  # he had forgotten something
    np.concatenate((LINE[::-1], BEFORE, LINE)),
], ids=['standing', 'outliers', 'longer', 'approaches', 'out and back'])
def test_the_same_trip_is_found_in_another_track(line):
    trips, left_out = find(tracks_of([line]))
    assert not left_out and len(trips) == 1
    (expected,), _ = find(tracks_of([LINE]))
    np.testing.assert_array_equal(trips[0].xy, expected.xy)
    np.testing.assert_array_equal(trips[0].xy[[0, -1]], ENDS)


def test_a_track_of_a_day_has_several_trips():
    trips, _ = find(tracks_of([np.concatenate((LINE, LINE[::-1], driven(
        'south', np.random.default_rng(1))))]))
    assert [trip.name for trip in trips] == ['trip 1 of track 1', 'trip 2 of track 1']


@pytest.mark.parametrize(('tracks', 'reason'), [
    ([LINE + (0.0, 9.0)], 'track 1 never comes within 2.6 m of the start'),
    ([LINE[:9]], 'track 1 never comes within 2.6 m of the goal'),
    ([LINE[::-1]], 'track 1 leads from the goal to the start'),
    ([np.delete(LINE, np.s_[5:14], axis=0)], 'track 1 has a jump of 2'),
    ([LINE, LINE], 'track 2 is a copy of track 1'),
])
def test_tracks_that_are_left_out_are_named_with_the_reason(tracks, reason):
    trips, left_out = find(tracks_of(tracks))
    assert len(left_out) == 1 and str(left_out[0]).startswith(reason)
    assert len(trips) == len(tracks) - 1


def test_times_tell_trips_apart():
    times = np.arange(len(LINE)) * 2.0
    first = Track('a', LINE, times)
    some = [*range(0, len(LINE) - 1, 2), -1]
    convoy = Track('b', LINE[some] + 0.2, times[some] + 4.0)
    again = Track('c', LINE, times + 86400.0)
    elsewhere = driven('south', np.random.default_rng(1))
    other = Track('d', elsewhere, np.arange(len(elsewhere)) * 2.0)
    backwards = Track('e', LINE, np.insert(times[:-1], 5, 0.0))
    trips, left_out = find([first, convoy, again, other, backwards])
    assert [trip.name for trip in trips] == ['a', 'c', 'd']
    assert [*map(str, left_out)] == ['b is the same trip as a',
                                     'e goes back in time after position 5']


def gpx_text(lines):
    """Tracks of two segments each, in latitude and longitude."""
    file = gpx.GPX()
    for line in lines:
        track = gpx.GPXTrack()
        for half in np.array_split(Coordinates(CRS).to_lat_lon(line), 2):
            track.segments.append(gpx.GPXTrackSegment([gpx.GPXTrackPoint(*at) for at in half]))
        file.tracks.append(track)
    return file.to_xml()


def write_tracks(path, lines):
    """Write lines in the coordinates of a map in ``CRS`` as the suffix says."""
    if path.suffix.lower() == '.gpx':
        path.write_text(gpx_text(lines))
    elif path.suffix == '.csv':
        degrees = [Coordinates(CRS).to_lat_lon(line) for line in lines]
        path.write_text('lat,lon,track\n' + ''.join(
            f'{lat:.9f}, {lon:.9f}, {k}\n' for k, line in enumerate(degrees, start=1)
            for lat, lon in line))
    else:
        halves = [shapely.MultiLineString([line[:5], line[5:]]) for line in lines]
        frame = geopandas.GeoDataFrame(geometry=halves, crs=CRS)
        (frame.to_crs('EPSG:4326') if path.suffix == '.geojson' else frame).to_file(path)


@pytest.mark.parametrize('suffix', ['gpx', 'csv', 'geojson', 'gpkg'])
def test_tracks_are_read_as_they_were_written(suffix, tmp_path):
    lines = [line + ORIGIN for line in habit(1)[-2:]]
    write_tracks(tmp_path / f'a.{suffix}', lines)
    tracks = read_tracks(str(tmp_path / f'a.{suffix}'), IN_UTM)
    assert [track.name for track in tracks] == [f'track {k} of a.{suffix}' for k in (1, 2)]
    for track, line in zip(tracks, lines, strict=True):
        np.testing.assert_allclose(track.xy, line, atol=1e-3, rtol=0.0)
        assert track.times is None


def test_times_are_read(tmp_path):
    (tmp_path / 'a.csv').write_text('x,y,time\n1,2,2026-01-01T00:00:10Z\n3,4,2026-01-01 00:00:12\n')
    (tmp_path / 'b.csv').write_text('x,y,time\n1,2,1.7e9\n3,4,1700000002.5\n')
    (a,) = read_tracks(str(tmp_path / 'a.csv'), ground())
    assert np.diff(a.times) == 2.0
    with pytest.raises(InvalidFeatures, match=r"time has '1.7e9': dates must be ISO 8601"):
        read_tracks(str(tmp_path / 'b.csv'), ground())
    text = gpx_text([LINE[:2] + ORIGIN]).replace('</trkpt>', '<time>2026-01-01T00:00:10Z</time>'
                                                 '</trkpt>').replace('/>', '></trkpt>')
    (tmp_path / 'c.gpx').write_text(text)
    assert read_tracks(str(tmp_path / 'c.gpx'), IN_UTM)[0].times is None  # they are equal
    (tmp_path / 'c.gpx').write_text(text.replace('10Z', '12Z', 1))
    assert read_tracks(str(tmp_path / 'c.gpx'), IN_UTM)[0].times.tolist() == [*a.times[::-1]]


@pytest.mark.parametrize(('name', 'text', 'reason'), [
    ('a.gpx', gpx_text([]), 'there is no track in it'), ('a.gpx', 'no', 'a.gpx'),
    ('a.gpx', None, 'No such file'), ('a.geojson', None, 'no such file'),
    ('a.csv', '', 'an empty file'), ('a.csv', 'x,y\n', 'there is no track in it'),
    ('a.csv', 'x,z\n1,2\n', 'the columns x and y .* there are x, z'),
    ('a.csv', 'x,y\n1,\n2,b\n', "no row has numbers of a position, .* y has ''"),
    ('a.csv', 'lat,lon\n1,2\n', 'coordinate system of the map is unknown'),
])
def test_unusable_files_are_refused(name, text, reason, tmp_path):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises((InvalidFeatures, OSError), match=reason):
        read_tracks(str(tmp_path / name), IN_UTM if name == 'a.gpx' else ground())


PLACES = ('--start', *START, '--goal', *GOAL)
QUICK = ('--reach', REACH, '--set', 'network.spacing=2.5', 'network.refine=0')


def run(tmp_path, *arguments):
    return run_here(command, tmp_path / 'map.npz', *arguments, '-o', tmp_path / 'judge.png')


def write_ground(folder, **changes):
    (folder / 'map.npz').write_bytes(npz_bytes(replace(ground(), **changes)))


def test_a_file_is_judged_like_its_arrays(tmp_path):
    write_ground(tmp_path, origin=(*ORIGIN, 0.0), crs=CRS)
    write_tracks(tmp_path / 'a.gpx', [line + ORIGIN for line in habit(1)])
    places = '--start', *(ORIGIN + START), '--goal', *(ORIGIN + GOAL)
    done = run(tmp_path, tmp_path / 'a.gpx', *places, *QUICK, '--json')
    assert done.code == 0, done.err
    result, expected = json.loads(done.out), judge(ground(), find(tracks_of(habit(1)))[0], OPTIONS)
    assert result['trips'] == len(HABIT) + 1
    assert result['driven']['value'] == pytest.approx(expected.driven.value, rel=1e-3)
    assert result['reweighted']['value'] == pytest.approx(expected.best.value, rel=2e-3)
    assert result['optimal']['value'] == pytest.approx(expected.plan.strategy.value, rel=0.02)
    assert sum(each['share'] for each in result['shares']) == pytest.approx(1.0, abs=0.02)
    at = Coordinates(CRS).from_lat_lon(result['driven']['worst_lat_lon'])
    np.testing.assert_allclose(at, result['driven']['worst_xy'], atol=0.2)
    assert (tmp_path / 'judge.png').read_bytes().startswith(b'\x89PNG')
    assert (tmp_path / 'judge.png').stat().st_mode & 0o077 == 0


def test_recordings_are_judged(tmp_path):
    plan = sample_plan()
    record_drawn(tmp_path / 'runs', 3)
    risk_map, (start, goal) = plan.risk_map, plan.network.points[
        [plan.network.source, plan.network.target]]
    (tmp_path / 'map.npz').write_bytes(npz_bytes(risk_map))
    done = run(tmp_path, tmp_path / 'runs', '--start', *start, '--goal', *goal,
               '--reach', 2 * risk_map.resolution, '--set', 'network.target_nodes=200',
               'network.refine=0')
    assert done.code == 0, done.err
    assert done.out.startswith('3 trips within')


def test_a_folder_is_judged_and_each_reason_is_one_line(tmp_path):
    write_ground(tmp_path, origin=(*ORIGIN, 0.0), crs=CRS)
    folder = tmp_path / 'old tracks'
    (folder / 'may').mkdir(parents=True)
    there, back = [line + ORIGIN for line in habit(1)], [LINE[::-1] + ORIGIN + k for k in range(3)]
    write_tracks(folder / 'a.GPX', there[:4])
    write_tracks(folder / 'may' / 'b.gpx', [*there[4:], *back])
    write_tracks(folder / 'c.csv', [LINE[[0, -1]] + ORIGIN])
    (folder / 'notes.txt').write_text('left alone')
    places = '--start', *(ORIGIN + START), '--goal', *(ORIGIN + GOAL)
    done = run(tmp_path, folder, *places, *QUICK)
    assert done.code == 0, done.err
    said = [' '.join(each.split()) for each in done.out.replace('\n  ', ' ').splitlines()]
    assert said[:3] == [
        '9 trips within 2.6 m of start and goal',
        'left out: track 1 of c.csv has a jump of 52.17 m, more than 31.2 m',
        'left out: 2 tracks, such as track 6 of b.gpx, which leads from the goal to the start: the '
        'return trip is planned separately']
    (tmp_path / 'empty').mkdir()
    done = run(tmp_path, tmp_path / 'empty', *places, *QUICK)
    assert done.code == 3 and 'no .gpx, .csv or .mcap file in this folder' in done.err


def test_tracks_without_a_trip_are_named(tmp_path):
    write_ground(tmp_path)
    (tmp_path / 'a.csv').write_text('x,y\n' + ''.join(f'{x},{y + 9.0}\n' for x, y in LINE))
    done = run(tmp_path, tmp_path / 'a.csv', *PLACES, *QUICK)
    assert done.code == 4 and not (tmp_path / 'judge.png').exists()
    assert done.out + done.err == (
        '0 trips within 2.6 m of start and goal\n'
        'left out: track 1 of a.csv never comes within 2.6 m of the start\n'
        'ambush judge: no track has a trip from start to goal\n')

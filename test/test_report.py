"""The report: one whole page, safe against what files may hold, with the right numbers."""

import hashlib
import json
import re
import zlib
from base64 import b64decode, b64encode
from html.parser import HTMLParser

import numpy as np
import pytest
from audit_samples import START, departure, drawn, parameters, record, sample_plan
from commands import documented_keys
from hypothesis import strategies as st
from ros_harness import stage
from scipy.spatial import cKDTree
from test_driven_certificate import dense

from ambush_planner.commands import cli, report, report_words
from ambush_planner.maps.risk_map import RiskMap
from ambush_planner.planning.evaluation import evaluate
from ambush_planner.recordings import recordings_in
from ambush_planner.recordings.recorded_departures import read_departures
from ambush_planner.recordings.report_data import (
    OBSTACLE,
    map_cells,
    map_data,
    sections_of,
)

HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(2)>&amp;\'\u202e'
SHAPES = st.tuples(st.integers(1, 9), st.integers(1, 9))


class Page(HTMLParser):
    """Checks that tags are closed in their order; collects elements, attributes, text."""

    def __init__(self, html):
        super().__init__()
        self.html, self.open, self.tags, self.attributes, self.words = html, [], [], [], []
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [(tag, *attribute) for attribute in attributes]
        if tag not in ('meta', 'img', 'input'):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {'style', 'script'} & set(self.open):
            self.words.append(data)

    @property
    def text(self):
        return re.sub(r'\s+', ' ', ' '.join(self.words))

    @property
    def scripts(self):
        """How many scripts would run; data do not."""
        data = self.attributes.count(('script', 'type', 'application/json'))
        return self.tags.count('script') - data


@pytest.fixture(scope='module')
def a_plan():
    return sample_plan()


def page_of(folder, *departures, code=0, arguments=()):
    if departures:
        record(folder / 'in', departures)
    arguments = [str(folder / 'in'), '-o', str(folder / 'out'), '--replace', *arguments]
    assert report.main(arguments) == code
    return Page((folder / 'out' / 'report.html').read_text())


@pytest.fixture(scope='module')
def made(tmp_path_factory, a_plan):
    """The page of twelve departures, and the section that it was made from."""
    folder = tmp_path_factory.mktemp('report')
    page = page_of(folder, *(
        departure(a_plan, route, k + 1) for k, route in enumerate(drawn(a_plan, 12))
    ))
    (section,) = sections_of(read_departures(recordings_in(folder / 'in'), pytest.fail))
    return page, section


def test_the_page_is_whole_and_needs_nothing_else(made):
    page, _ = made
    assert page.html.startswith('<!DOCTYPE html>') and ('html', 'lang', 'en') in page.attributes
    assert not {'link', 'iframe', 'object', 'form', 'a', 'base', 'img'} & set(page.tags)
    assert not [name for _, name, _ in page.attributes
                if name in ('src', 'href') or name.startswith('on')]
    assert not re.search(r'url\(|@import|https?://', page.html)
    assert len(page.html) < 1_000_000 and 'Secret.' in page.text


def test_the_policy_names_the_only_script(made):
    page, _ = made
    (script,) = re.findall(r'(?s)<script>(.*?)</script>', page.html)
    assert page.scripts == 1 and script == cli.resource('report_map.js')
    digest = b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'" in [
        value for _, name, value in page.attributes if name == 'content'
    ]


def test_the_numbers_are_those_of_the_strategy(made, a_plan):
    page, section = made
    strategy = a_plan.strategy
    for number in (strategy.value, strategy.lower_bound):
        assert f'{number:.4f}' in page.text
    assert '40 m from start and goal' in page.text
    assert f'{strategy.route_entropy:.4g} nats' in page.text
    for row, cells in zip(evaluate(strategy).values(),
                          report_words.measures(section.strategy)[1:], strict=True):
        assert cells[1] == report_words.distance(row.expected_length)
        assert cells[4] == f'{row.v_repeated:.3f}'
        assert all(cell in page.text for cell in cells)


def test_departures_and_settings_are_listed_without_routes_and_seeds(made):
    page, section = made
    assert '2023-11-15 22:13:20 UTC' in page.text and 'game.secured_radius' in page.text
    assert 'frame of the map' in page.text
    assert 'seed' not in dict(report_words.settings(section))
    for each in section.departures:
        assert each.id in page.text
        assert str(each.route_entropy_source[0]) not in page.html
        assert ', '.join(map(str, each.route[:4].tolist())) not in page.text


def test_the_driven_paths_are_drawn_not_the_nodes(made):
    _, section = made
    data = map_data(section)
    drawn = np.frombuffer(zlib.decompress(b64decode(data['routes'])), '<f4').reshape(-1, 2)
    paths = np.split(drawn + data['origin'], np.cumsum(data['counts'])[:-1])
    for path, each in zip(paths, section.departures, strict=True):
        near = cKDTree(dense(path, 0.01)).query(each.path_poses[:, :2])[0]
        assert near.max() <= 0.11 * data['cell'] and len(path) <= len(each.path_poses)


def test_a_fixed_seed_and_an_unusable_system_are_warned_about(tmp_path, a_plan, made):
    entries = {'parameters': parameters(seed=77123, **{'map.crs': 'nonsense'})}
    page = page_of(tmp_path, departure(a_plan, drawn(a_plan, 1)[0], entries=entries))
    assert 'fixed seed' in page.text and '77123' not in page.html
    assert 'No latitude and longitude at the pointer: ' in page.text
    assert 'fixed seed' not in made[0].text


def test_text_from_files_is_escaped(tmp_path, a_plan):
    entries = {'departure_id': HOSTILE, 'frame': HOSTILE,
               'parameters': parameters(**{'recording.directory': HOSTILE})}
    page = page_of(tmp_path, departure(a_plan, drawn(a_plan, 1)[0], entries=entries))
    assert page.scripts == 1 and 'img' not in page.tags and '<script>alert' not in page.html
    assert page.text.count('alert(1)') >= 3


def test_maps_and_trips_have_sections(tmp_path, a_plan):
    """Departures whose start moves a little are on one trip, with several strategies."""
    other, rows = sample_plan(hill=90), []
    for k in range(3):
        start = START[0] + 0.02 * k, START[1]
        moved = sample_plan(start=start)
        rows.append(departure(moved, drawn(moved, 1, k)[0], k + 1, start=start))
    rows += [departure(other, r, k + 9, hill=90) for k, r in enumerate(drawn(other, 2))]
    entries = {'parameters': parameters(**{'recording.compression': 'none'})}
    rows.append(departure(other, drawn(other, 1)[0], 20, hill=90, entries=entries))
    page = page_of(tmp_path, *rows)
    assert 'Trip 1 of 2: 3 departures' in page.text and 'Trip 2 of 2: 3 departures' in page.text
    assert page.tags.count('canvas') == 2 and page.tags.count('section') == 2
    assert page.text.count('3 strategies were computed for this trip') == 1
    assert 'recording.compression differs between departures' in page.text


def test_it_says_verified_only_if_it_verified(tmp_path, made):
    assert 'Not verified' in made[0].text and 'Verified:' not in made[0].text
    with stage(tmp_path / 'in') as running:
        assert running.give().call('new_route').success
    assert 'Not verified' in page_of(tmp_path).text
    text = page_of(tmp_path, arguments=['--verify']).text
    assert 'Verified: all 1 recordings' in text
    assert 'Not enough data: at least 5 departures' in text


def test_failed_verification_and_the_audit_are_on_the_page(tmp_path, a_plan):
    """These recordings say one thing and hold another; their routes are all the same."""
    (route,) = drawn(a_plan, 1)
    rows = [departure(a_plan, route, k + 1) for k in range(5)]
    page = page_of(tmp_path, *rows, code=1, arguments=['--verify'])
    assert 'VERIFICATION FAILED for 5 of 5 recordings' in page.text
    assert 'The audit has a finding: the convoy used some stretches far more' in page.text
    assert 'An observer who learns from each departure' in page.text


def test_unreadable_files_are_named_and_counted(tmp_path, a_plan, capsys):
    paths = record(tmp_path / 'in', [departure(a_plan, r, k)
                                     for k, r in enumerate(drawn(a_plan, 2))])
    paths[0].write_bytes(b'nothing')
    page = page_of(tmp_path, code=3)
    assert 'Not shown, because unreadable: 1 recording.' in page.text
    assert paths[0].name in capsys.readouterr().err
    paths[1].write_bytes(b'nothing')
    assert report.main([str(tmp_path / 'in'), '-o', str(tmp_path / 'none'), '--json']) == 3
    result = json.loads(capsys.readouterr().out)
    assert set(result) == documented_keys(report) and result['page'] is None
    assert not (tmp_path / 'none').exists()


def test_output_is_required_private_and_replaced_only_if_requested(tmp_path, a_plan, capsys):
    record(tmp_path / 'in', [departure(a_plan, drawn(a_plan, 1)[0])])
    out = tmp_path / 'out'
    assert report.main([str(tmp_path / 'in'), '-o', str(out)]) == 0
    assert out.stat().st_mode & 0o777 == 0o700
    assert (out / 'report.html').stat().st_mode & 0o777 == 0o600
    for arguments, said in (([], '-o/--output'), (['-o', str(out)], '--replace')):
        with pytest.raises(SystemExit) as stop:
            report.main([str(tmp_path / 'in'), *arguments])
        assert stop.value.code == 2 and said in capsys.readouterr().err


def test_blocks_of_a_large_map_show_the_worst_loss():
    rng = np.random.default_rng(2)
    alpha, obstacles = rng.integers(1, 50, (3, 4001)) / 5.0, rng.random((3, 4001)) < 0.6
    cells, levels, cell = map_cells(RiskMap(alpha, obstacles, 2.0))
    assert cells.shape == (1, 1334) and cell == 6.0
    for k in (0, 1, 700, 1333):
        block = np.s_[:, 3 * k:3 * k + 3]
        free = alpha[block][~obstacles[block]]
        assert cells[0, k] == OBSTACLE if not len(free) else levels[cells[0, k]] == free.max()

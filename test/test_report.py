# SPDX-License-Identifier: Apache-2.0
"""The report: one whole page, safe against what files may hold, with the right numbers."""

import json
import re
from base64 import b64decode
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
import pytest
from audit_samples import START, departure, drawn, parameters, record, record_drawn, sample_plan
from commands import documented_keys
from drive_samples import dense
from scipy.spatial import cKDTree

from ambush_planner import words
from ambush_planner.commands import report, report_words
from ambush_planner.planning.evaluation import evaluate
from ambush_planner.planning.plan import path_lengths
from ambush_planner.recordings.recorded_departures import read_departures, recordings_in
from ambush_planner.recordings.report_data import sections_of

HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(2)>&amp;\'\u202e'

class Page(HTMLParser):
    """Checks that tags are closed in their order; collects tags, attributes and text."""

    def __init__(self, folder):
        super().__init__()
        self.folder, self.html = folder, (folder / 'report.html').read_text()
        self.open, self.tags, self.attributes, self.text = [], [], [], ''
        self.feed(self.html)
        self.close()
        assert not self.open
        self.text = re.sub(r'\s+', ' ', self.text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += attributes
        if tag not in ('meta', 'img', 'input', 'br'):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if 'style' not in self.open:
            self.text += f' {data}'

    def values(self, attribute):
        return [value for name, value in self.attributes if name == attribute]


def page_of(folder, code=0, arguments=()):
    """The page of the recordings in the folder ``in``."""
    arguments = [str(folder / 'in'), '-o', str(folder / 'out'), '--replace', *arguments]
    assert report.main(arguments) == code
    assert (folder / 'out' / 'report.html').stat().st_mode & 0o777 == 0o600
    return Page(folder / 'out')


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """The page of twelve departures, and the section that it was made from."""
    folder = tmp_path_factory.mktemp('report')
    record_drawn(folder / 'in', 12)
    page = page_of(folder)
    (section,) = sections_of(read_departures(recordings_in(folder / 'in'), pytest.fail))
    return page, section


def test_the_page_needs_nothing_else_and_its_policy_lets_no_script_run(made):
    page, _ = made
    assert page.html.startswith('<!DOCTYPE html>') and 'Secret.' in page.text
    assert not {'link', 'iframe', 'object', 'form', 'base', 'script'} & set(page.tags)
    assert not [name for name, _ in page.attributes if name.startswith('on')]
    (picture,) = page.values('src')
    kind, _, data = picture.partition(',')
    assert kind == 'data:image/png;base64' and b64decode(data)[1:4] == b'PNG'
    assert not re.search(r'url\(|@import|https?://', page.html) and len(page.html) < 1_000_000
    assert "default-src 'none'; img-src data:; style-src 'unsafe-inline'" in page.values('content')


def test_the_numbers_are_those_of_the_strategy(made):
    page, section = made
    (strategy,) = section.trip.legs
    rows = evaluate(strategy)
    numbers = [number for number, _ in report_words.tiles(section)]
    assert [float(numbers[k].split()[0]) for k in (0, 2, 3)] == pytest.approx(
        [strategy.value, 12, np.mean(path_lengths([each.path_poses for each in
                                                   section.departures]))], rel=0.05)
    hits = strategy.game.loss * strategy.visit_probability
    worst = int(hits.argmax())
    assert numbers[1] == f'1 of {int(1.0 / strategy.visit_probability[worst])} departures'
    x, y = strategy.network.points[worst]
    assert f'at ({x:.1f}, {y:.1f})' in report_words.tiles(section)[1][1]
    ratio = f'{strategy.expected_length / strategy.shortest_length:.3g} times the shortest'
    assert ratio in report_words.tiles(section)[3][1]
    texts = [*report_words.certificate(section), *(text for _, text in report_words.tiles(section)),
             *(cell for row in report_words.measures(section) for cell in row)]
    assert all(text in page.text for text in texts)
    assert f'{rows["energy_efficient"].v_repeated:.3g}' in report_words.tiles(section)[0][1]
    assert f'{strategy.value:.3g}' in texts[0] and f'{strategy.lower_bound:.3g}' in texts[1]
    assert 'At whichever node' in texts[0] and 'within 40 m of start and goal' in texts[2]


@pytest.mark.parametrize(('metres', 'said'), [
    (0.0, '0 m'), (2.3248, '2.32 m'), (637.4, '637 m'), (999.7, '1000 m'), (1844.0, '1.84 km'),
    (40061.0, '40.1 km'), (1234567.0, '1230 km'),
])
def test_lengths_have_three_digits_and_no_exponent(metres, said):
    assert words.distance(metres) == said


def test_departures_link_their_recordings_and_hold_neither_routes_nor_seeds(made):
    page, section = made
    links = [(page.folder / unquote(link)).resolve() for link in page.values('href')]
    assert links == [each.path.resolve() for each in section.departures]
    assert '2023-11-15 22:13:20 UTC' in page.text
    for each in section.departures:
        assert f'departure {each.metadata.departure_id}' in page.values('title')
        assert str(each.metadata.route_entropy_source[0]) not in page.html
        assert ', '.join(map(str, each.route[0][:4].tolist())) not in page.text


def off(points, line):
    """How far points lie from a line at most."""
    return cKDTree(dense(line, 0.01)).query(points)[0].max()


def test_a_fixed_seed_is_warned_about(tmp_path, made):
    entries = {'parameters': parameters(seed=77123)}
    record_drawn(tmp_path / 'in', 1, entries=entries)
    page = page_of(tmp_path, code=1, arguments=['--verify'])
    assert 'Not enough data' in page.text and 'What 1 departure can show' in page.text
    assert 'fixed seed' in page.text and '77123' not in page.html
    assert 'fixed seed' not in made[0].text
    assert 'Not verified' in made[0].text and 'Verified:' not in made[0].text


def test_text_from_files_is_escaped(tmp_path):
    record_drawn(tmp_path / 'in', 1, entries={'departure_id': HOSTILE})
    page = page_of(tmp_path)
    assert page.tags.count('script') == 0 and page.tags.count('img') == 1
    assert '<script>alert' not in page.html
    assert f'departure {HOSTILE}' in page.values('title')


def test_maps_and_trips_have_sections(tmp_path):
    """Departures whose start moves a little are on one trip, with several strategies."""
    other, rows = sample_plan(hill=90), []
    for k in range(3):
        start = START[0] + 0.02 * k, START[1]
        moved = sample_plan(start=start)
        rows.append(departure(moved, drawn(moved, 1, k)[0], k + 1, start=start))
    rows += [departure(other, r, k + 9, hill=90) for k, r in enumerate(drawn(other, 2))]
    rows.append(departure(other, drawn(other, 1)[0], 20, hill=90))
    record(tmp_path / 'in', rows)
    page = page_of(tmp_path)
    assert 'Trip 1 of 2: 3 departures' in page.text and 'Trip 2 of 2: 3 departures' in page.text
    assert page.tags.count('img') == 2 and page.text.count('3 strategies were computed') == 1
    assert page.text.count('time (UTC) length mean loss') == 1


def test_failed_verification_and_the_audit_are_on_the_page(tmp_path):
    """These recordings say one thing and hold another; their routes are all the same."""
    (route,) = drawn(sample_plan(), 1)
    rows = [departure(sample_plan(), route, k + 1) for k in range(5)]
    record(tmp_path / 'in', rows)
    text = page_of(tmp_path, code=1, arguments=['--verify']).text
    assert 'VERIFICATION FAILED for 5 of 5 recordings' in text and 'Verified:' not in text
    assert 'The audit found: the convoy used some stretches far more' in text
    assert '1 of 5 departures took different routes' in text
    assert 'What 5 departures can show' in text and 'in nine cases of ten' in text


def test_unreadable_files_are_named_and_counted(tmp_path, capsys):
    paths = record_drawn(tmp_path / 'in', 2)
    paths[0].write_bytes(b'nothing')
    page = page_of(tmp_path, code=3)
    assert 'Not shown, because unreadable: 1 recording.' in page.text
    assert paths[0].name in capsys.readouterr().err
    paths[1].write_bytes(b'nothing')
    assert report.main([str(tmp_path / 'in'), '-o', str(tmp_path / 'none'), '--json']) == 3
    result = json.loads(capsys.readouterr().out)
    assert set(result) == documented_keys(report) and result['page'] is None
    assert not (tmp_path / 'none').exists()

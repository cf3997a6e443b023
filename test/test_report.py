"""The report: one whole page, safe against what files may hold, with the right numbers."""

import dataclasses
import hashlib
import re
from base64 import b64encode
from html.parser import HTMLParser

import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from audit_samples import START, departure, drawn, parameters, record, sample_plan
from forging import Forger
from ros_harness import stage

from ambush_planner.commands import report, report_map, report_words
from ambush_planner.commands.report_sections import Section, sections_of
from ambush_planner.planning.evaluation import evaluate
from ambush_planner.recordings import recordings_in
from ambush_planner.recordings.recorded_departures import read_departures

HOSTILE = '"><script>alert(1)</script><img src=x onerror=alert(2)>&amp;\'\u202e'
VOID = {'meta', 'img', 'input'}


class Page(HTMLParser):
    """Checks that tags are closed in their order; collects elements, attributes, text."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.attributes, self.words = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [(tag, *attribute) for attribute in attributes]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {'style', 'script'} & set(self.open):
            self.words.append(data)

    @property
    def text(self):
        return re.sub(r'\s+', ' ', ' '.join(self.words))


def scripts(page):
    """How many scripts would run; data are none."""
    data = page.attributes.count(('script', 'type', 'application/json'))
    return page.tags.count('script') - data


@pytest.fixture(scope='module')
def a_plan():
    return sample_plan()


@pytest.fixture(scope='module')
def made(tmp_path_factory, a_plan):
    """The page of twelve departures, its text, and the section that it was made from."""
    folder = tmp_path_factory.mktemp('report')
    record(folder / 'in', [departure(a_plan, route, k + 1)
                           for k, route in enumerate(drawn(a_plan, 12))])
    assert report.main([str(folder / 'in'), '-o', str(folder / 'out')]) == 0
    (section,) = sections_of(read_departures(recordings_in(folder / 'in'), pytest.fail))
    html = (folder / 'out' / 'report.html').read_text()
    return html, Page(html), section


def page_of(tmp_path, *departures):
    record(tmp_path / 'in', departures)
    assert report.main([str(tmp_path / 'in'), '-o', str(tmp_path / 'out')]) == 0
    html = (tmp_path / 'out' / 'report.html').read_text()
    return html, Page(html)


def test_the_page_is_whole_and_needs_nothing_else(made):
    html, page, _ = made
    assert html.startswith('<!DOCTYPE html>') and ('html', 'lang', 'en') in page.attributes
    assert not {'link', 'iframe', 'object', 'form', 'a', 'base', 'img'} & set(page.tags)
    assert not [name for _, name, _ in page.attributes if name in ('src', 'href')]
    assert not re.search(r'url\(|@import|https?://', html)
    assert not [name for _, name, _ in page.attributes if name.startswith('on')]
    assert len(html) < 1_000_000


def test_the_policy_names_the_one_script(made):
    html, page, _ = made
    assert scripts(page) == 1
    (script,) = re.findall(r'(?s)<script>(.*?)</script>', html)
    assert script == report_map.script()
    digest = b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'" in [
        value for tag, name, value in page.attributes if name == 'content'
    ]


def test_the_numbers_are_those_of_the_strategy(made, a_plan):
    _, page, section = made
    strategy = a_plan.strategy
    assert f'more than {strategy.value:.4f} a departure' in page.text
    assert f'less than {strategy.lower_bound:.4f} on this network' in page.text
    rows = evaluate(strategy)
    for row, cells in zip(rows.values(), report_words.measures(section.strategy)[1:],
                          strict=True):
        assert cells[1:] == (report_words.distance(row.expected_length),
                             report_words.percent(row.p_first),
                             report_words.percent(row.p_repeated), f'{row.v_repeated:.3f}')
        for cell in cells:
            assert cell in page.text
    assert f'{strategy.route_entropy:.4g} nats' in page.text


def test_the_promise_names_the_ground_that_has_to_be_held(made):
    page, _, _ = made
    assert 'No ambusher that waits over 40 m from start and goal' in page
    assert 'Nobody waits within 40 m of start or goal: where that ground is not held' in page


def test_departures_settings_and_the_warning_are_there(made):
    _, page, section = made
    for record_ in section.departures:
        assert record_.id in page.text
    assert 'Secret.' in page.text
    assert 'game.secured_radius' in page.text and 'uniform_delaunay' in page.text
    assert '2023-11-15 22:13 UTC' in page.text and '1.26.4' in page.text


def test_routes_and_seeds_are_not_spelled_out(made):
    html, page, section = made
    assert 'route_entropy_source' not in html
    assert not [value for name, value in report_words.settings(section) if name == 'seed']
    for record_ in section.departures:
        assert ', '.join(map(str, record_.route[:4].tolist())) not in page.text


def test_a_fixed_seed_is_warned_about(tmp_path, a_plan, made):
    entries = {'parameters': parameters(seed=77123)}
    html, page = page_of(tmp_path, departure(a_plan, drawn(a_plan, 1)[0], entries=entries))
    assert 'fixed seed' in page.text and '77123' not in html
    assert 'fixed seed' not in made[1].text


@pytest.mark.parametrize('key', ['departure_id', 'frame'])
def test_what_comes_from_files_is_escaped(tmp_path, a_plan, key):
    html, page = page_of(
        tmp_path, departure(a_plan, drawn(a_plan, 1)[0], entries={key: HOSTILE})
    )
    assert scripts(page) == 1 and 'img' not in page.tags
    assert 'alert(1)' in page.text
    assert '<script>alert' not in html
    assert not [n for _, n, _ in page.attributes if n == 'onerror']


def test_hostile_parameters_and_versions_are_escaped(tmp_path, a_plan):
    entries = {'parameters': parameters(**{'recording.directory': HOSTILE}),
               'versions': {HOSTILE: HOSTILE, 'numpy': '<b>'}}
    html, page = page_of(tmp_path, departure(a_plan, drawn(a_plan, 1)[0], entries=entries))
    assert scripts(page) == 1 and 'b' not in page.tags[page.tags.index('h2') + 10:]
    assert 'alert(1)' in page.text


def test_one_departure_makes_a_page(tmp_path, a_plan):
    (path,) = record(tmp_path / 'in', [departure(a_plan, drawn(a_plan, 1)[0])])
    assert report.main([str(path), '-o', str(tmp_path / 'out')]) == 0
    page = Page((tmp_path / 'out' / 'report.html').read_text())
    assert '1 departure,' in page.text and '1 departures' not in page.text


def test_several_maps_share_a_page(tmp_path, a_plan):
    other = sample_plan(hill=90)
    html, page = page_of(
        tmp_path,
        *(departure(a_plan, r, k) for k, r in enumerate(drawn(a_plan, 2))),
        *(departure(other, r, k + 9, hill=90) for k, r in enumerate(drawn(other, 3))),
    )
    assert 'Trip 1 of 2: 2 departures' in page.text
    assert 'Trip 2 of 2: 3 departures' in page.text
    assert page.tags.count('canvas') == 2 and page.tags.count('section') == 2


def test_what_could_not_be_read_is_said_on_the_page(tmp_path, a_plan, capsys):
    paths = record(tmp_path / 'in', [departure(a_plan, r, k)
                                     for k, r in enumerate(drawn(a_plan, 2))])
    paths[0].write_bytes(b'nothing')
    assert report.main([str(tmp_path / 'in'), '-o', str(tmp_path / 'out')]) == 3
    page = Page((tmp_path / 'out' / 'report.html').read_text())
    assert 'could not be read and are missing here: 1.' in page.text
    assert paths[0].name in capsys.readouterr().err


def test_settings_that_differ_are_said_to(tmp_path, a_plan):
    routes = drawn(a_plan, 2)
    entries = {'parameters': parameters(**{'recording.compression': 'none'})}
    _, page = page_of(tmp_path, departure(a_plan, routes[0]),
                      departure(a_plan, routes[1], 2, entries=entries))
    assert 'recording.compression differs between departures' in page.text


def test_distances_and_shares_are_readable():
    assert report_words.distance(404.3) == '404 m'
    assert report_words.distance(31_240.0) == '31.2 km'
    assert report_words.percent(0.1064) == '10.6 %'


def test_where_no_ambush_costs_anything_nobody_waits(made):
    _, _, section = made
    free = dataclasses.replace(section.strategy, value=0.0)
    calm = Section([dataclasses.replace(section.departures[-1], strategy=free)])
    assert 'the best ambusher waits' in report_map.map_figure(section)
    assert 'the best ambusher waits' not in report_map.map_figure(calm)
    words = dict(report_words.quantities(free))
    assert words['places where the best ambusher waits'] == 'none: no ambush costs anything'


def test_routes_on_the_map_have_the_colours_of_the_table(made):
    html, page, section = made
    colours = section.colours()
    data = report_map.map_data(section)
    assert data['colours'] == [colours.get(k) for k in range(12)]
    assert sorted(colours) == list(range(4, 12)) and len(set(colours.values())) == 8
    for number, colour in colours.items():
        assert f'{number + 1}&nbsp;<span style="color:{colour}">' in html
        assert f'<option value="{number}">{number + 1}: ' in html


def test_a_start_that_moves_makes_one_section(tmp_path):
    """One section for a map and a pair of places, however many strategies."""
    rows = []
    for k in range(4):
        start = START[0] + 0.02 * k, START[1]
        each = sample_plan(start=start)
        rows.append(departure(each, drawn(each, 1, k)[0], k + 1, start=start))
    html, page = page_of(tmp_path, *rows)
    assert page.tags.count('section') == 1 and page.tags.count('canvas') == 1
    assert '4 strategies were worked out for this trip' in page.text


def test_it_says_verified_only_where_it_verified(tmp_path, made):
    _, page, _ = made
    assert 'Not verified' in page.text and 'Verified:' not in page.text
    with stage(tmp_path / 'in') as running:
        assert running.give().call('new_route').success
    for arguments, code, said in (
        ([], 0, 'Not verified'), (['--verify'], 0, 'Verified: all 1 recordings'),
    ):
        out = tmp_path / said[:4]
        assert report.main([str(tmp_path / 'in'), '-o', str(out), *arguments]) == code
        assert said in Page((tmp_path / said[:4] / 'report.html').read_text()).text
    (path,) = recordings_in(tmp_path / 'in')
    forger = Forger(path)
    forger.entries['route_entropy_source'] = [2**255]
    forger.save(path)
    assert report.main([str(path), '-o', str(tmp_path / 'forged'), '--verify']) == 1
    text = Page((tmp_path / 'forged' / 'report.html').read_text()).text
    assert 'VERIFICATION FAILED for 1 of 1' in text and 'route: ' in text

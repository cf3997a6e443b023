"""The report in a real browser: its map works, it fits, and it requests nothing."""

import re

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

import report_browser
from audit_samples import departure, drawn, parameters, record, sample_plan

from ambush_planner.commands import report
from ambush_planner.commands.figures import AMBUSHER, ROUTES

MAP = 'figure.map'

pytestmark = pytest.mark.skipif(
    report_browser.BINARY is None, reason='no Chromium here; on Debian: apt install chromium'
)


@pytest.fixture(scope='module')
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp('page')
    a_plan = sample_plan()
    record(folder / 'in', [departure(a_plan, route, k + 1)
                           for k, route in enumerate(drawn(a_plan, 12))])
    assert report.main([str(folder / 'in'), '-o', str(folder / 'out')]) == 0
    return folder / 'out' / 'report.html'


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    with report_browser.Browser(tmp_path_factory.mktemp('profile')) as browser:
        yield browser


def opened(browser, page, width=1100):
    """Open the page and wait until its maps are drawn."""
    browser.load(page, width)
    browser.evaluate('maps')
    browser.evaluate(f'window.map = document.querySelector("{MAP}").view, 0')
    settle(browser)


def settle(browser):
    twice = 'requestAnimationFrame(() => requestAnimationFrame(done))'
    browser.evaluate(f'new Promise(done => {twice})')


def near(browser, colour, tolerance=12):
    """How many pixels of the map have this colour."""
    red, green, blue = (int(colour[k:k + 2], 16) for k in (1, 3, 5))
    settle(browser)
    return browser.evaluate(
        '(() => { const c = map.canvas, d = map.pen.getImageData(0, 0, c.width, c.height).data;'
        'let n = 0; for (let k = 0; k < d.length; k += 4)'
        f'n += Math.max(Math.abs(d[k] - {red}), Math.abs(d[k + 1] - {green}), '
        f'Math.abs(d[k + 2] - {blue})) <= {tolerance}; return n; }})()'
    )


def state(browser):
    return browser.evaluate('[map.x, map.y, map.zoom]')


def readout(browser):
    return browser.evaluate(f'document.querySelector("{MAP} .readout").textContent')


@pytest.mark.parametrize('width', [390, 1100], ids=['phone', 'desk'])
def test_the_page_fits_and_requests_nothing(browser, page, width):
    opened(browser, page, width)
    assert browser.requests() == [page.resolve().as_uri()] and browser.complaints() == []
    assert browser.evaluate('document.documentElement.scrollWidth') <= width
    assert near(browser, AMBUSHER) > 100 and near(browser, '#ffd92f') > 50
    shown = browser.evaluate('map.canvas.getBoundingClientRect().toJSON()')
    assert 0.8 * min(width, 900) < shown['width'] <= width
    # Legend and controls are large enough to read and to touch.
    sizes = browser.evaluate(
        f'[...document.querySelectorAll("{MAP} .legend li, {MAP} label, {MAP} button")].map('
        'e => [parseFloat(getComputedStyle(e).fontSize), e.getBoundingClientRect().height])'
    )
    assert len(sizes) >= 12 and all(font >= 15 and high >= 24 for font, high in sizes)


@pytest.mark.parametrize('reach', [0.0, 25.0])
def test_the_numbers_at_the_pointer_are_those_of_the_game(browser, tmp_path, reach):
    """An ambush at each site costs what the planner's core says, by the page's own sums."""
    entries = {'parameters': parameters(**{'game.ambush_radius': reach})}
    a_plan = sample_plan(reach=reach)
    record(tmp_path / 'in', [departure(a_plan, drawn(a_plan, 1)[0], entries=entries)])
    assert report.main([str(tmp_path / 'in'), '-o', str(tmp_path / 'out')]) == 0
    opened(browser, tmp_path / 'out' / 'report.html')
    game, p = a_plan.strategy.game, a_plan.strategy.edge_probability
    at = a_plan.network.points[game.sites].round(9).tolist()
    found = browser.evaluate(f'{at}.map(([x, y]) => map.measure(x, y))')
    assert len(at) > 50 and not any(each['held'] for each in found)
    costs = np.array([each['cost'] for each in found])
    np.testing.assert_allclose(costs, game.site_losses(p), rtol=1e-4, atol=1e-4)
    assert costs.max() == pytest.approx(a_plan.strategy.value, rel=1e-4)
    ends = a_plan.network.points[[a_plan.network.source, a_plan.network.target]].tolist()
    assert all(browser.evaluate(f'map.measure({x}, {y}).held') for x, y in ends)


def test_layers_can_be_switched_by_clicking(browser, page):
    opened(browser, page)
    for layer, colour in (('sites', AMBUSHER), ('routes', ROUTES[3]), ('risk', '#a0a0a0')):
        shown = near(browser, colour)
        browser.click(f'{MAP} [data-layer={layer}]')
        assert shown > 100 and near(browser, colour) < 0.05 * shown
        browser.click(f'{MAP} [data-layer={layer}]')
        assert near(browser, colour) == shown
    browser.click(f'{MAP} [data-layer=routes]')
    browser.click(f'{MAP} [data-layer=sites]')
    shown = near(browser, '#1146b0', 40)
    browser.click(f'{MAP} [data-layer=chances]')
    assert shown > 500 and near(browser, '#1146b0', 40) == 0


def test_the_mouse_moves_zooms_and_tells(browser, page):
    opened(browser, page)
    x, y = browser.centre(f'{MAP} canvas')
    before = browser.evaluate('map.place(map.width / 2 + 50, map.height / 2)')
    browser.mouse('mouseWheel', x + 50, y, deltaX=0, deltaY=-200)
    settle(browser)
    assert state(browser)[2] == 1, 'the wheel scrolls the page until the map is clicked'
    x, y = browser.centre(f'{MAP} canvas')
    browser.click(f'{MAP} canvas')
    browser.mouse('mouseWheel', x + 50, y, deltaX=0, deltaY=-400)
    settle(browser)
    assert state(browser)[2] == pytest.approx(np.e, rel=1e-3)
    after = browser.evaluate('map.place(map.width / 2 + 50, map.height / 2)')
    assert after == pytest.approx(before, abs=1.0), 'what is under the pointer stays there'
    place = browser.evaluate('map.place(map.width / 2, map.height / 2)')
    browser.mouse('mousePressed', x, y)
    browser.mouse('mouseMoved', x + 60, y + 30)
    browser.mouse('mouseReleased', x + 60, y + 30)
    moved = browser.evaluate('map.place(map.width / 2 + 60, map.height / 2 + 30)')
    assert moved == pytest.approx(place, abs=1.0), 'the map follows the hand'
    assert re.search(r'^x [\d.]+ m, y [\d.]+ m: (loss [\d.]+|impassable)\. [\d.]+ % of departures',
                     readout(browser))
    for name, zoom in (('in', np.e * 1.5), ('out', np.e), ('all', 1.0)):
        browser.click(f'{MAP} [data-zoom={name}]')
        assert state(browser)[2] == pytest.approx(zoom, rel=1e-3)


def test_keyboard_and_fingers_move_and_zoom(browser, page):
    opened(browser, page)
    browser.evaluate(f'document.querySelector("{MAP} [data-zoom=all]").focus()')
    browser.key('Tab')
    assert browser.evaluate('document.activeElement === map.canvas')
    x, y, _ = state(browser)
    before = readout(browser)
    browser.key('+', '+')
    assert state(browser) == [x, y, 1.5] and readout(browser) != before
    browser.key('ArrowRight')
    browser.key('ArrowUp')
    assert state(browser)[0] > x and state(browser)[1] > y
    browser.key('0', '0')
    assert state(browser) == [x, y, 1.0]
    opened(browser, page, 390)
    x, y = browser.centre(f'{MAP} canvas')
    browser.touch('touchStart', (x - 30, y), (x + 30, y))
    browser.touch('touchMove', (x - 60, y), (x + 60, y))
    browser.touch('touchEnd')
    assert state(browser)[2] == pytest.approx(2.0, rel=0.05)


def test_the_policy_stops_scripts_and_pictures_from_elsewhere(browser, page, tmp_path):
    """A page without the policy asks for the picture and runs the script; this one does not."""
    hostile = '<img src="http://elsewhere.invalid/pixel.png"><script>x = 7</script></body>'
    changed = tmp_path / 'changed.html'
    changed.write_text(hostile)
    browser.load(changed, 800)
    assert 'http://elsewhere.invalid/pixel.png' in browser.requests()
    assert browser.evaluate('x') == 7
    changed.write_text(page.read_text().replace('</body>', hostile))
    browser.load(changed, 800)
    assert browser.evaluate('typeof x') == 'undefined'
    assert browser.evaluate('document.images[0].naturalWidth') == 0
    assert len(browser.complaints()) >= 2
    # The page's own script runs unchanged or not at all.
    changed.write_text(page.read_text().replace("'use strict';", "'use strict'; var x = 7;"))
    browser.load(changed, 800)
    assert browser.evaluate('typeof maps + typeof x') == 'undefinedundefined'

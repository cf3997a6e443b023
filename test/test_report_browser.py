# SPDX-License-Identifier: Apache-2.0
"""The report in headless Chromium: its map works, it fits, and it requests nothing."""

import re

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from audit_samples import parameters, record_drawn, sample_plan

from ambush_planner.colours import AMBUSHER, ENDS, PROBABILITY, ROUTES
from ambush_planner.commands import report
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.planning.ambush_costs import cost_raster

HEIGHT = 800  # of the window


@pytest.fixture(scope='module')
def file(tmp_path_factory):
    folder = tmp_path_factory.mktemp('page')
    return written(folder, 12)


def written(folder, count, *plan, **options):
    """The page of departures, drawn and recorded in a folder."""
    record_drawn(folder / 'in', count, *plan, **options)
    assert report.main([str(folder / 'in'), '-o', str(folder / 'out')]) == 0
    return folder / 'out' / 'report.html'


def opened(browser, path, width=1200):
    """Open the page, wait until its maps are drawn, and return it with all that was logged."""
    page = browser.new_page(viewport={'width': width, 'height': HEIGHT}, is_mobile=width < 600,
                            has_touch=width < 600)
    page.logged = []
    page.on('request', lambda asked: page.logged.append(asked.url))
    for kind in ('console', 'pageerror'):
        page.on(kind, lambda said: page.logged.append(str(said)))
    page.goto(path.resolve().as_uri())
    page.evaluate('maps')
    page.evaluate('window.map = document.querySelector("figure").view, 0')
    settle(page)
    return page


def boxes(page, selector):
    """The edges (left, top, right, bottom) of elements in the window."""
    return page.evaluate(
        f'[...document.querySelectorAll("{selector}")].map(each => {{ const r ='
        'each.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; })')


def centre(page, selector):
    """Bring an element into view and return its centre in the window."""
    page.evaluate(f'document.querySelector("{selector}").scrollIntoView({{block: "center"}})')
    left, top, right, bottom = boxes(page, selector)[0]
    return (left + right) / 2, (top + bottom) / 2


def settle(page):
    twice = 'requestAnimationFrame(() => requestAnimationFrame(done))'
    page.evaluate(f'new Promise(done => {twice})')


def near(page, colour):
    """How many pixels of the map have this colour."""
    red, green, blue = (int(colour[k:k + 2], 16) for k in (1, 3, 5))
    settle(page)
    return page.evaluate(
        '(() => { const c = map.canvas, d = map.pen.getImageData(0, 0, c.width, c.height).data;'
        'let n = 0; for (let k = 0; k < d.length; k += 4)'
        f'n += Math.max(Math.abs(d[k] - {red}), Math.abs(d[k + 1] - {green}), '
        f'Math.abs(d[k + 2] - {blue})) <= 12; return n; }})()')


def state(page):
    settle(page)
    return page.evaluate('[map.x, map.y, map.zoom]')


@pytest.mark.parametrize('width', [400, 1200], ids=['phone', 'desk'])
def test_the_page_fits_and_requests_nothing(browser, file, width):
    page = opened(browser, file, width)
    assert [each for each in page.logged if not each.startswith('data:')] == [
        file.resolve().as_uri()]
    assert near(page, AMBUSHER) > 100 and near(page, ENDS) > 50
    page.evaluate('document.querySelectorAll("details").forEach(each => each.open = true)')
    assert page.evaluate('document.documentElement.scrollWidth') <= width
    tiles = boxes(page, '.tiles li')
    assert len({left for left, *_ in tiles}) == len({top for _, top, *_ in tiles}) == 2
    if width > 400:
        assert all(bottom <= HEIGHT for *_, bottom in [*tiles, *boxes(page, 'canvas')])
    sizes = page.evaluate(
        '[...document.querySelectorAll(".legend li, .legend label, button")].map('
        'e => [parseFloat(getComputedStyle(e).fontSize), e.getBoundingClientRect().height])')
    assert len(sizes) >= 20 and all(font >= 14 and high >= 24 for font, high in sizes)


@pytest.mark.parametrize('reach', [0.0, 25.0])
def test_the_numbers_at_the_pointer_are_those_of_the_game(browser, tmp_path, reach):
    """An ambush at each site costs what the core says, and nobody waits in held places."""
    held = [(200.0, 200.0, 30.0)]
    crs = 'datum -33.9 18.4 0.3' if reach else ''
    entries = {'parameters': parameters(**{'game.ambush_radius': reach, 'map.crs': crs,
                                           'game.held_places': held})}
    a_plan = sample_plan(reach=reach, held=tuple(held))
    page = opened(browser, written(tmp_path, 1, a_plan, entries=entries))
    costs = cost_raster(a_plan.trip, a_plan.risk_map, 160).cost
    rows, columns = np.nonzero(costs > 0.01 * a_plan.value)
    at = (5.0 * np.column_stack((columns, rows)) + (1.0, 4.0)).tolist()  # in these cells
    said = page.evaluate(f'{at}.map(([x, y]) => map.words(x, y))')
    found = [float(re.search(r'costs ([\d.]+) on average', text)[1]) for text in said]
    # Two digits, and 250 shades.
    np.testing.assert_allclose(found, costs[rows, columns], rtol=0.06, atol=0.003 * a_plan.value)
    assert len(found) > 300 and all(f'costs {a_plan.value:.3g}\n' in text for text in said)
    ends = a_plan.network.points[[a_plan.network.source, a_plan.network.target]].tolist()
    for x, y in [*ends, (200.0, 200.0), (200.0, 222.0)]:
        assert 'nobody can wait' in page.evaluate(f'map.words({x}, {y})')
    black = near(page, '#000000')
    page.evaluate('map.data.discs.pop(), map.draw(), new Promise(requestAnimationFrame)')
    assert near(page, '#000000') < black - 50, 'the held place was drawn'
    shown = re.search(r'\n(-33\.\d{5}), (18\.\d{5})$', page.evaluate('map.words(200, 100)'))
    assert bool(shown) == bool(crs)
    if crs:
        pytest.importorskip('pyproj')
        expected = Coordinates(crs).to_lat_lon([200.0, 100.0])
        assert [float(text) for text in shown.groups()] == pytest.approx(expected, abs=6e-6)


@pytest.mark.parametrize(('layer', 'colour'), [
    ('risk', '#a0a0a0'), ('chances', PROBABILITY[2]), ('sites', AMBUSHER), ('routes', ROUTES[3])])
def test_layers_can_be_switched_by_clicking(browser, file, layer, colour):
    page = opened(browser, file)
    shown = near(page, colour)
    page.click(f'[data-layer={layer}]')
    assert shown > 100 and near(page, colour) < 0.2 * shown
    page.click(f'[data-layer={layer}]')
    assert near(page, colour) == shown


def test_a_row_selects_its_route_by_mouse_and_keyboard(browser, file):
    """The last departure alone; then, by the keyboard, all again."""
    page = opened(browser, file)
    mine, other = ROUTES[11 % len(ROUTES)], ROUTES[10 % len(ROUTES)]
    before = near(page, mine), near(page, other)
    assert min(before) > 50
    page.click('.departures tr:last-child td')
    assert near(page, mine) > before[0] and near(page, other) == 0
    page.press('[aria-pressed=true]', 'Enter')
    assert (near(page, mine), near(page, other)) == before


def test_the_mouse_moves_and_zooms(browser, file):
    page = opened(browser, file)
    x, y = centre(page, 'canvas')
    page.mouse.move(x + 50, y)
    page.mouse.wheel(0, -200)
    assert state(page)[2] == 1, 'the wheel scrolls the page until the map is clicked'
    page.click('canvas')
    x, y = centre(page, 'canvas')
    below = 'map.place(map.width / 2 + 50, map.height / 2)'
    before = page.evaluate(below)
    page.mouse.move(x + 50, y)
    page.mouse.wheel(0, -400)
    page.wait_for_function('map.zoom > 1')
    assert state(page)[2] == pytest.approx(np.e, rel=1e-3)
    assert page.evaluate(below) == pytest.approx(before, abs=1.0), 'that stays at the pointer'
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y + 30)
    page.mouse.up()
    moved = page.evaluate('map.place(map.width / 2 + 110, map.height / 2 + 30)')
    assert moved == pytest.approx(before, abs=1.0), 'the map follows the hand'
    for name, zoom in (('in', np.e * 1.5), ('out', np.e), ('all', 1.0)):
        page.click(f'[data-zoom={name}]')
        assert state(page)[2] == pytest.approx(zoom, rel=1e-3)


def test_keyboard_and_fingers_move_and_zoom(browser, file):
    page = opened(browser, file)
    page.keyboard.press('Tab')
    assert page.evaluate('document.activeElement === map.canvas')
    x, y, _ = state(page)
    page.keyboard.press('+')
    assert state(page) == [x, y, 1.5] and not page.evaluate('map.reading.hidden')
    page.keyboard.press('ArrowRight')
    page.keyboard.press('ArrowUp')
    assert state(page)[0] > x and state(page)[1] > y
    page.keyboard.press('0')
    assert state(page) == [x, y, 1.0]
    page = opened(browser, file, 400)
    x, y = centre(page, 'canvas')
    protocol = page.context.new_cdp_session(page)
    for what, apart in (('touchStart', 30), ('touchMove', 60)):
        fingers = [{'x': x + k * apart, 'y': y, 'id': k} for k in (-1, 1)]
        protocol.send('Input.dispatchTouchEvent', {'type': what, 'touchPoints': fingers})
    assert state(page)[2] == pytest.approx(2.0, rel=0.05)

# SPDX-License-Identifier: Apache-2.0
"""The report in headless Chromium: its map works, it fits, and it requests nothing.

The browser is controlled by its DevTools protocol over pipes.
"""

import json
import os
import re
import shutil
import subprocess
from contextlib import closing

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from audit_samples import parameters, record_drawn, sample_plan

from ambush_planner.colours import AMBUSHER, ENDS, PROBABILITY, ROUTES
from ambush_planner.commands import report
from ambush_planner.maps.coordinates import Coordinates
from ambush_planner.planning.ambush_costs import cost_raster

BINARY = next(
    filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome'))), None
)
HEIGHT = 800  # of the window

pytestmark = pytest.mark.skipif(
    BINARY is None, reason='no Chromium here; on Debian: apt install chromium'
)


class Browser:
    """Loads one page after the other and reports what it shows and what it requested."""

    def __init__(self, folder):
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        # Chromium has its own libraries, not those of ROS from Python wheels.
        environment = {key: each for key, each in os.environ.items() if key != 'LD_LIBRARY_PATH'}
        # It reads commands from descriptor 3 and answers on 4.
        self._process = subprocess.Popen(
            ['sh', '-c', f'exec "$@" 3</dev/fd/{theirs_in} 4>/dev/fd/{theirs_out}', 'sh',
             BINARY, '--headless', '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage',
             '--no-first-run', '--disable-background-networking', '--remote-debugging-pipe',
             '--hide-scrollbars', '--host-resolver-rules=MAP * ~NOTFOUND',
             f'--user-data-dir={folder}'],
            pass_fds=(theirs_in, theirs_out), env=environment, stderr=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._buffer, self._number, self._session, self._events = b'', 0, None, []

    def close(self):
        self._process.kill()
        self._process.wait()
        os.close(self._in)
        os.close(self._out)

    def load(self, path, width):
        """Open a file in a window of this width and wait until all of it is there."""
        self._session = None
        target = self.ask('Target.createTarget', url='about:blank')['targetId']
        attached = self.ask('Target.attachToTarget', targetId=target, flatten=True)
        self._session = attached['sessionId']
        for domain in ('Network', 'Page', 'Log'):
            self.ask(f'{domain}.enable')
        self.ask('Emulation.setDeviceMetricsOverride', width=width, height=HEIGHT,
                 deviceScaleFactor=1, mobile=width < 600)
        self._events.clear()
        self.ask('Page.navigate', url=path.resolve().as_uri())
        while not self.events('Page.loadEventFired'):
            self._receive()

    def evaluate(self, expression):
        """Return the value of a JavaScript expression in the page; promises are waited for."""
        answer = self.ask('Runtime.evaluate', expression=expression, returnByValue=True,
                          awaitPromise=True)
        assert 'exceptionDetails' not in answer, answer['exceptionDetails']
        return answer['result'].get('value')

    def boxes(self, selector):
        """Return the edges (left, top, right, bottom) of elements in the window."""
        return self.evaluate(
            f'[...document.querySelectorAll("{selector}")].map(each => {{ const r ='
            'each.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; })')

    def centre(self, selector):
        """Bring an element into view and return its centre in the window."""
        self.evaluate(f'document.querySelector("{selector}").scrollIntoView({{block: "center"}})')
        left, top, right, bottom = self.boxes(selector)[0]
        return (left + right) / 2, (top + bottom) / 2

    def click(self, selector):
        """Click an element as a mouse does."""
        for what in ('mousePressed', 'mouseReleased'):
            self.mouse(what, *self.centre(selector))

    def mouse(self, what, x, y, **more):
        """Let the mouse do something at a place of the window."""
        button = 'none' if what == 'mouseWheel' else 'left'
        self.ask('Input.dispatchMouseEvent', type=what, x=x, y=y, button=button, clickCount=1,
                 buttons=int(what == 'mousePressed'), **more)

    def key(self, key, text='', code=0):
        """Press a key by its DOM name; ``code`` is for those without a text."""
        for what in ('keyDown', 'keyUp'):
            self.ask('Input.dispatchKeyEvent', type=what, key=key, windowsVirtualKeyCode=code,
                     **({'text': text} if what == 'keyDown' else {}))

    def requests(self):
        """Return the addresses that the page has asked for, also such as were blocked."""
        return [each['request']['url'] for each in self.events('Network.requestWillBeSent')]

    def events(self, method):
        """Return the parameters of the events of a kind since the page was loaded."""
        return [event['params'] for event in self._events if event['method'] == method]

    def ask(self, method, **parameters):
        """Return the answer to a command of the DevTools protocol."""
        self._number += 1
        command = {'id': self._number, 'method': method, 'params': parameters}
        if self._session:
            command['sessionId'] = self._session
        os.write(self._out, json.dumps(command).encode() + b'\0')
        while (answer := self._receive()).get('id') != self._number:
            pass
        assert 'error' not in answer, answer
        return answer['result']

    def _receive(self):
        """Return the next message; events are kept."""
        while b'\0' not in self._buffer:
            self._buffer += os.read(self._in, 1 << 20)
        text, _, self._buffer = self._buffer.partition(b'\0')
        message = json.loads(text)
        if 'method' in message:
            self._events.append(message)
        return message


@pytest.fixture(scope='module')
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp('page')
    return written(folder, 12)


def written(folder, count, *plan, **options):
    """The page of departures, drawn and recorded in a folder."""
    record_drawn(folder / 'in', count, *plan, **options)
    assert report.main([str(folder / 'in'), '-o', str(folder / 'out')]) == 0
    return folder / 'out' / 'report.html'


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    with closing(Browser(tmp_path_factory.mktemp('profile'))) as browser:
        yield browser


def opened(browser, page, width=1200):
    """Open the page and wait until its maps are drawn."""
    browser.load(page, width)
    browser.evaluate('maps')
    browser.evaluate('window.map = document.querySelector("figure").view, 0')
    settle(browser)


def settle(browser):
    twice = 'requestAnimationFrame(() => requestAnimationFrame(done))'
    browser.evaluate(f'new Promise(done => {twice})')


def near(browser, colour):
    """How many pixels of the map have this colour."""
    red, green, blue = (int(colour[k:k + 2], 16) for k in (1, 3, 5))
    settle(browser)
    return browser.evaluate(
        '(() => { const c = map.canvas, d = map.pen.getImageData(0, 0, c.width, c.height).data;'
        'let n = 0; for (let k = 0; k < d.length; k += 4)'
        f'n += Math.max(Math.abs(d[k] - {red}), Math.abs(d[k + 1] - {green}), '
        f'Math.abs(d[k + 2] - {blue})) <= 12; return n; }})()')


def state(browser):
    settle(browser)
    return browser.evaluate('[map.x, map.y, map.zoom]')


@pytest.mark.parametrize('width', [400, 1200], ids=['phone', 'desk'])
def test_the_page_fits_and_requests_nothing(browser, page, width):
    opened(browser, page, width)
    others = [each for each in browser.requests() if not each.startswith('data:')]
    assert others == [page.resolve().as_uri()] and not browser.events('Log.entryAdded')
    assert near(browser, AMBUSHER) > 100 and near(browser, ENDS) > 50
    browser.evaluate('document.querySelectorAll("details").forEach(each => each.open = true)')
    assert browser.evaluate('document.documentElement.scrollWidth') <= width
    tiles = browser.boxes('.tiles li')
    assert len({left for left, *_ in tiles}) == len({top for _, top, *_ in tiles}) == 2
    if width > 400:
        assert all(bottom <= HEIGHT for *_, bottom in [*tiles, *browser.boxes('canvas')])
    sizes = browser.evaluate(
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
    opened(browser, written(tmp_path, 1, a_plan, entries=entries))
    costs = cost_raster(a_plan.trip, a_plan.risk_map, 160).cost
    rows, columns = np.nonzero(costs > 0.01 * a_plan.value)
    at = (5.0 * np.column_stack((columns, rows)) + (1.0, 4.0)).tolist()  # in these cells
    said = browser.evaluate(f'{at}.map(([x, y]) => map.words(x, y))')
    found = [float(re.search(r'costs ([\d.]+) on average', text)[1]) for text in said]
    # Two digits, and 250 shades.
    np.testing.assert_allclose(found, costs[rows, columns], rtol=0.06, atol=0.003 * a_plan.value)
    assert len(found) > 300 and all(f'costs {a_plan.value:.3g}\n' in text for text in said)
    ends = a_plan.network.points[[a_plan.network.source, a_plan.network.target]].tolist()
    for x, y in [*ends, (200.0, 200.0), (200.0, 222.0)]:
        assert 'nobody can wait' in browser.evaluate(f'map.words({x}, {y})')
    black = near(browser, '#000000')
    browser.evaluate('map.data.discs.pop(), map.draw(), new Promise(requestAnimationFrame)')
    assert near(browser, '#000000') < black - 50, 'the held place was drawn'
    shown = re.search(r'\n(-33\.\d{5}), (18\.\d{5})$', browser.evaluate('map.words(200, 100)'))
    assert bool(shown) == bool(crs)
    if crs:
        pytest.importorskip('pyproj')
        expected = Coordinates(crs).to_lat_lon([200.0, 100.0])
        assert [float(text) for text in shown.groups()] == pytest.approx(expected, abs=6e-6)


@pytest.mark.parametrize(('layer', 'colour'), [
    ('risk', '#a0a0a0'), ('chances', PROBABILITY[2]), ('sites', AMBUSHER), ('routes', ROUTES[3])])
def test_layers_can_be_switched_by_clicking(browser, page, layer, colour):
    opened(browser, page)
    shown = near(browser, colour)
    browser.click(f'[data-layer={layer}]')
    assert shown > 100 and near(browser, colour) < 0.2 * shown
    browser.click(f'[data-layer={layer}]')
    assert near(browser, colour) == shown


def test_a_row_selects_its_route_by_mouse_and_keyboard(browser, page):
    """The last departure alone; then, by the keyboard, all again."""
    opened(browser, page)
    mine, other = ROUTES[11 % len(ROUTES)], ROUTES[10 % len(ROUTES)]
    before = near(browser, mine), near(browser, other)
    assert min(before) > 50
    browser.click('.departures tr:last-child td')
    assert near(browser, mine) > before[0] and near(browser, other) == 0
    browser.evaluate('document.querySelector("[aria-pressed=true]").focus()')
    browser.key('Enter', '\r', 13)
    assert (near(browser, mine), near(browser, other)) == before


def test_the_mouse_moves_and_zooms(browser, page):
    opened(browser, page)
    x, y = browser.centre('canvas')
    browser.mouse('mouseWheel', x + 50, y, deltaX=0, deltaY=-200)
    assert state(browser)[2] == 1, 'the wheel scrolls the page until the map is clicked'
    browser.click('canvas')
    x, y = browser.centre('canvas')
    below = 'map.place(map.width / 2 + 50, map.height / 2)'
    before = browser.evaluate(below)
    browser.mouse('mouseWheel', x + 50, y, deltaX=0, deltaY=-400)
    assert state(browser)[2] == pytest.approx(np.e, rel=1e-3)
    assert browser.evaluate(below) == pytest.approx(before, abs=1.0), 'that stays at the pointer'
    browser.mouse('mousePressed', x, y)
    browser.mouse('mouseMoved', x + 60, y + 30)
    browser.mouse('mouseReleased', x + 60, y + 30)
    moved = browser.evaluate('map.place(map.width / 2 + 110, map.height / 2 + 30)')
    assert moved == pytest.approx(before, abs=1.0), 'the map follows the hand'
    for name, zoom in (('in', np.e * 1.5), ('out', np.e), ('all', 1.0)):
        browser.click(f'[data-zoom={name}]')
        assert state(browser)[2] == pytest.approx(zoom, rel=1e-3)


def test_keyboard_and_fingers_move_and_zoom(browser, page):
    opened(browser, page)
    browser.key('Tab', code=9)
    assert browser.evaluate('document.activeElement === map.canvas')
    x, y, _ = state(browser)
    browser.key('+', '+')
    assert state(browser) == [x, y, 1.5] and not browser.evaluate('map.reading.hidden')
    browser.key('ArrowRight', code=39)
    browser.key('ArrowUp', code=38)
    assert state(browser)[0] > x and state(browser)[1] > y
    browser.key('0', '0')
    assert state(browser) == [x, y, 1.0]
    opened(browser, page, 400)
    x, y = browser.centre('canvas')
    for what, apart in (('touchStart', 30), ('touchMove', 60)):
        fingers = [{'x': x + k * apart, 'y': y, 'id': k} for k in (-1, 1)]
        browser.ask('Input.dispatchTouchEvent', type=what, touchPoints=fingers)
    assert state(browser)[2] == pytest.approx(2.0, rel=0.05)

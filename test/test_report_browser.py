"""The report in headless Chromium: its map works, it fits, and it requests nothing.

The browser is controlled by its DevTools protocol over pipes.
"""

import json
import os
import re
import select
import shutil
import subprocess
import time

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from audit_samples import departure, drawn, parameters, record, sample_plan

from ambush_planner.colours import AMBUSHER, ROUTES
from ambush_planner.commands import report
from ambush_planner.game.hits import hit_probabilities
from ambush_planner.maps.coordinates import Coordinates

MAP = 'figure.map'
BINARY = next(
    filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome'))), None
)
SECONDS = 60.0
KEYS = {'Tab': 9, 'ArrowLeft': 37, 'ArrowUp': 38, 'ArrowRight': 39, 'ArrowDown': 40, ' ': 32}

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
        self._buffer, self._number, self._session = b'', 0, None
        self.events = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self._ask('Browser.close')
            self._process.wait(SECONDS)
        finally:
            self._process.kill()
            self._process.wait()
            os.close(self._in)
            os.close(self._out)

    def load(self, path, width):
        """Open a file in a window of this width and wait until all of it is there."""
        self._session = None
        target = self._ask('Target.createTarget', url='about:blank')['targetId']
        attached = self._ask('Target.attachToTarget', targetId=target, flatten=True)
        self._session = attached['sessionId']
        for domain in ('Network', 'Page', 'Log'):
            self._ask(f'{domain}.enable')
        self._ask('Emulation.setDeviceMetricsOverride', width=width, height=900,
                  deviceScaleFactor=1, mobile=width < 600)
        self.events.clear()
        self._ask('Page.navigate', url=path.resolve().as_uri())
        deadline = time.monotonic() + SECONDS
        while not any(event['method'] == 'Page.loadEventFired' for event in self.events):
            self._receive(deadline)

    def evaluate(self, expression):
        """Return the value of a JavaScript expression in the page; promises are waited for."""
        answer = self._ask('Runtime.evaluate', expression=expression, returnByValue=True,
                           awaitPromise=True)
        assert 'exceptionDetails' not in answer, answer['exceptionDetails']
        return answer['result'].get('value')

    def centre(self, selector):
        """Bring an element into view and return its centre in the window."""
        return self.evaluate(
            f'(() => {{ const e = document.querySelector({json.dumps(selector)});'
            'e.scrollIntoView({block: "center"}); const r = e.getBoundingClientRect();'
            'return [r.x + r.width / 2, r.y + r.height / 2]; })()'
        )

    def click(self, selector):
        """Click an element as a mouse does."""
        x, y = self.centre(selector)
        self.mouse('mousePressed', x, y)
        self.mouse('mouseReleased', x, y)

    def mouse(self, what, x, y, **more):
        """Let the mouse do something at a place of the window."""
        button = 'none' if what == 'mouseWheel' else 'left'
        self._ask('Input.dispatchMouseEvent', type=what, x=x, y=y, button=button, clickCount=1,
                  buttons=0 if what in ('mouseReleased', 'mouseWheel') else 1, **more)

    def key(self, key, text=''):
        """Press and release a key by its DOM name."""
        for what in ('keyDown', 'keyUp'):
            self._ask('Input.dispatchKeyEvent', type=what, key=key, code=key,
                      text=text if what == 'keyDown' else '',
                      windowsVirtualKeyCode=KEYS.get(key, 0))

    def requests(self):
        """Return the addresses that the page has asked for, also such as were blocked."""
        return [event['params']['request']['url'] for event in self.events
                if event['method'] == 'Network.requestWillBeSent']

    def complaints(self):
        """Return what the browser has written to the page's console."""
        return [event['params']['entry']['text'] for event in self.events
                if event['method'] == 'Log.entryAdded']

    def _ask(self, method, **parameters):
        self._number += 1
        command = {'id': self._number, 'method': method, 'params': parameters}
        if self._session:
            command['sessionId'] = self._session
        os.write(self._out, json.dumps(command).encode() + b'\0')
        deadline = time.monotonic() + SECONDS
        while True:
            answer = self._receive(deadline)
            if answer.get('id') == self._number:
                assert 'error' not in answer, answer
                return answer['result']

    def _receive(self, deadline):
        """Return the next message; events are kept."""
        while b'\0' not in self._buffer:
            left = deadline - time.monotonic()
            assert left > 0.0 and select.select([self._in], [], [], left)[0], 'no answer in time'
            data = os.read(self._in, 1 << 20)
            assert data, 'the browser has ended'
            self._buffer += data
        text, _, self._buffer = self._buffer.partition(b'\0')
        message = json.loads(text)
        if 'method' in message:
            self.events.append(message)
        return message


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
    with Browser(tmp_path_factory.mktemp('profile')) as browser:
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


def test_the_numbers_at_the_pointer_are_those_of_the_game(browser, tmp_path):
    """An ambush at each site costs what the planner's core says, by the page's own sums."""
    reach, crs = 25.0, 'datum -33.9 18.4 0.3'
    entries = {'parameters': parameters(**{'game.ambush_radius': reach, 'map.crs': crs})}
    a_plan = sample_plan(reach=reach)
    record(tmp_path / 'in', [departure(a_plan, drawn(a_plan, 1)[0], entries=entries)])
    assert report.main([str(tmp_path / 'in'), '-o', str(tmp_path / 'out')]) == 0
    opened(browser, tmp_path / 'out' / 'report.html')
    game, p = a_plan.strategy.game, a_plan.strategy.edge_probability
    at = a_plan.network.points[game.sites].round(9).tolist()
    found = browser.evaluate(f'{at}.map(([x, y]) => map.measure(x, y))')
    assert len(at) > 50 and not any(each['held'] for each in found)
    costs = np.array([each['cost'] for each in found])
    wanted = game.loss[game.sites] * hit_probabilities(game, p)
    np.testing.assert_allclose(costs, wanted, rtol=1e-4, atol=1e-4)
    assert costs.max() == pytest.approx(a_plan.strategy.value, rel=1e-4)
    ends = a_plan.network.points[[a_plan.network.source, a_plan.network.target]].tolist()
    assert all(browser.evaluate(f'map.measure({x}, {y}).held') for x, y in ends)
    browser.evaluate('map.tell(200, 100)')
    shown = re.search(r' m \((-33\.\d{6}), (18\.\d{6})\): ', readout(browser))
    pytest.importorskip('pyproj')
    expected = Coordinates(crs).to_lat_lon(browser.evaluate('map.place(200, 100)'))
    assert [float(text) for text in shown.groups()] == pytest.approx(expected, abs=6e-7)


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
    assert re.search(r'^x [\d.]+ m, y [\d.]+ m: (loss|obstacle)', readout(browser))
    for name, zoom in (('in', np.e * 1.5), ('out', np.e), ('all', 1.0)):
        browser.click(f'{MAP} [data-zoom={name}]')
        assert state(browser)[2] == pytest.approx(zoom, rel=1e-3)


def test_the_keyboard_moves_and_zooms(browser, page):
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

"""A real browser for the tests: headless Chromium, asked by its DevTools protocol over pipes."""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import time

BINARY = next(
    filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome'))), None
)
SECONDS = 60.0
KEYS = {'Tab': 9, 'ArrowLeft': 37, 'ArrowUp': 38, 'ArrowRight': 39, 'ArrowDown': 40, ' ': 32}


def _environment():
    """The environment without what ROS from Python wheels adds: Chromium has its own libraries."""
    return {name: value for name, value in os.environ.items() if name != 'LD_LIBRARY_PATH'}


class Browser:
    """Loads one page after the other and tells what it shows and what it asked the net for."""

    def __init__(self, folder):
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        # Chromium reads commands from descriptor 3 and answers on 4.
        self._process = subprocess.Popen(
            ['sh', '-c', f'exec "$@" 3</dev/fd/{theirs_in} 4>/dev/fd/{theirs_out}', 'sh',
             BINARY, '--headless',
             '--no-sandbox', '--disable-gpu', '--disable-dev-shm-usage', '--no-first-run',
             '--disable-background-networking', '--remote-debugging-pipe', '--hide-scrollbars',
             '--host-resolver-rules=MAP * ~NOTFOUND', f'--user-data-dir={folder}'],
            pass_fds=(theirs_in, theirs_out), env=_environment(), stderr=subprocess.DEVNULL,
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

    def touch(self, what, *places):
        """Put fingers on the screen, move or lift them."""
        points = [{'x': x, 'y': y, 'id': k} for k, (x, y) in enumerate(places)]
        self._ask('Input.dispatchTouchEvent', type=what, touchPoints=points)

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

# SPDX-License-Identifier: Apache-2.0
"""The output of a command: results, progress, errors, and numbers in words."""

from __future__ import annotations

import json
import os
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from textwrap import fill
from typing import Any, TypeVar

from ..errors import shown

WIDTH = 99  # columns of wrapped text
_Item = TypeVar('_Item')


class Console:
    """Print results on standard output, progress and errors on standard error."""

    def __init__(self, program: str, *, as_json: bool, quiet: bool) -> None:
        self._program, self._json, self._quiet = program, as_json, quiet
        self._begin = time.monotonic()
        self.result: dict[str, Any] = {}
        self.words: Callable[[str], str] = str

    @property
    def seconds(self) -> float:
        """Time since the command began [s]."""
        return time.monotonic() - self._begin

    def line(self, text: str = '') -> None:
        """Print a line of the result."""
        if not (self._json or self._quiet):
            print(_printable(text), flush=True)

    def item(self, text: str, indent: int = 7, hang: int = 2) -> None:
        """Print wrapped text, by default as details of the line before."""
        self.line(fill(text, WIDTH, initial_indent=' ' * indent, break_long_words=False,
                       subsequent_indent=' ' * (indent + hang), break_on_hyphens=False))

    def say(self, text: str) -> None:
        """Print a progress message."""
        if not self._quiet:
            print(_printable(self.words(text)), file=sys.stderr, flush=True)

    def warn(self, text: str) -> None:
        """Print a warning, a sentence without its full stop."""
        self.say(f'Warning: {text}.')

    def secret(self, paths: Iterable[Path], what: str = '') -> list[str]:
        """Print which files were written, and with what, and who can read them."""
        paths = list(paths)
        files = [place(path) for path in paths]
        shared = [path for path in paths if path.stat().st_mode & stat.S_IRGRP]
        readers = f'the group {shared[0].group()}' if shared else 'this user'
        self.line(f'{", ".join(files)}: {what}secret, so only {readers} can read '
                  f'{"it" if len(files) == 1 else "them"}.')
        return files

    def fact(self, name: str, text: str) -> None:
        """Print a named fact of the result."""
        self.item(f'{name:<15} {self.words(text)}', indent=0, hang=16)

    def step(self, text: str) -> None:
        """Print the time so far and the next step."""
        self.say(f'{self.seconds:5.1f} s  {text}')

    def error(self, text: object) -> None:
        """Print an error, even if quiet."""
        print(_printable(f'{self._program}: {self.words(str(text))}'), file=sys.stderr,
              flush=True)

    def progress(self, items: Sequence[_Item], what: str) -> Iterator[_Item]:
        """Yield the items, and print how many are done as ``waiting`` does."""
        with self.waiting(what) as tell:
            for done, item in enumerate(items):
                tell(f'{done} of {len(items)}')
                yield item

    @contextmanager
    def waiting(self, what: str) -> Iterator[Callable[[str], None]]:
        """After two seconds, print what is still running; repeat at doubling intervals.

        Yields a function that takes how far it is.
        """
        done, so_far = threading.Event(), ['']

        def tell() -> None:
            pause = 2.0
            while not done.wait(pause):
                self.step(f'{what} ... {so_far[0]}'.rstrip())
                pause *= 2.0

        thread = threading.Thread(target=tell, daemon=True)
        thread.start()
        try:
            yield lambda text: so_far.__setitem__(0, text)
        finally:
            done.set()
            thread.join()

    def result_as_json(self, verdict: str) -> None:
        """Print the verdict and the result as JSON if requested."""
        if self._json:
            print(json.dumps({'verdict': verdict, **self.result}, indent=1, default=str))
        sys.stdout.flush()


def _printable(text: str) -> str:
    """Return lines whose control characters, which may come from a file, are escaped."""
    return '\n'.join(map(shown, text.split('\n')))


def place(path: Path) -> str:
    """Return a printable path, relative to the current folder if it lies below it."""
    absolute, here = Path(os.path.abspath(path)), Path.cwd()
    return shown(absolute.relative_to(here) if absolute.is_relative_to(here) else absolute)


def when(stamp_ns: int) -> str:
    """Return a time as date and second, UTC."""
    return f'{datetime.fromtimestamp(stamp_ns // 10**9, timezone.utc):%Y-%m-%d %H:%M:%S UTC}'

"""Tables in Markdown, and the marked blocks of a file in which they stand."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

RESULTS = Path(__file__).with_name('results.md')


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown table."""
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join('| ' + ' | '.join(line) + ' |' for line in lines)


def conditions(*libraries: str) -> str:
    """One line: what the numbers were measured with, and how busy the machine was.

    A load over the number of cores, as processes that want to run, makes all times longer.
    """
    python = f'Python {platform.python_version()}'
    versions = [f'{name} {version(name)}' for name in ('numpy', 'scipy', *libraries)]
    load = f'load {os.getloadavg()[0]:.1f}'
    return ', '.join([python, *versions, f'{os.cpu_count()} cores', load])


def write_block(path: Path, name: str, text: str) -> None:
    """Put text between the file's marks ``name``; add the marks at its end if it has none."""
    first, last = f'<!-- {name}: begin -->', f'<!-- {name}: end -->'
    old = path.read_text() if path.exists() else ''
    if first not in old:
        old += f'\n{first}\n{last}\n'
    before, rest = old.split(first, 1)
    after = rest.split(last, 1)[1]
    path.write_text(f'{before}{first}\n{text}\n{last}{after}')

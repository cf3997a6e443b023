# SPDX-License-Identifier: Apache-2.0
"""Command lines of the benchmarks, and the tables that they write into results.md."""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).with_name('results.md')


def new_parser(description: str | None) -> argparse.ArgumentParser:
    """A command line with the option ``--results``."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument(
        '--results', type=Path, default=RESULTS, help="file in which the script's block is replaced"
    )
    return parser


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join('| ' + ' | '.join(line) + ' |' for line in lines)


def quantiles(numbers: Sequence[float], high: float = 0.95) -> str:
    """Median, high quantile and largest."""
    return ' / '.join(f'{number:.3g}' for number in np.quantile(numbers, [0.5, high, 1.0]))


def conditions(*libraries: str) -> str:
    """Versions, number of cores and load of the machine; a high load makes all times longer."""
    python = f'Python {platform.python_version()}'
    versions = [f'{name} {version(name)}' for name in ('numpy', 'scipy', *libraries)]
    load = f'load {os.getloadavg()[0]:.1f}'
    return ', '.join([python, *versions, f'{os.cpu_count()} cores', load])


def publish(path: Path, block: str, text: str) -> None:
    """Print the text and put it between the marks of a block; append a missing block."""
    print(text)
    first, last = f'<!-- {block}: begin -->', f'<!-- {block}: end -->'
    old = path.read_text() if path.exists() else ''
    if first not in old:
        old += f'\n{first}\n{last}\n'
    before, rest = old.split(first, 1)
    after = rest.split(last, 1)[1]
    path.write_text(f'{before}{first}\n{text}\n{last}{after}')

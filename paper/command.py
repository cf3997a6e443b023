# SPDX-License-Identifier: Apache-2.0
"""``python -m paper``: the paper's tables and figures, repeated on a stated environment.

E. Boidot and E. Feron, *Planning Random path distributions for ambush games in unstructured
environments*. See ``paper.environment`` for the environment and docs/paper.md for the result.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import scipy

from ambush_planner.errors import AmbushPlannerError, InvalidOption

from . import environment
from .report import Comparison, compare, report
from .results import DRAWS, Results, Say, compute

EPILOG = """\
The folder then contains results.json, tables.md and the figures 2 to 7 of the paper with one of our
own strategy. On the paper's 8-node network numbers can be compared; on the map, which it does not
publish, only their order can. Takes about 20 s.
Exit code: 0 all comparisons hold, or docs/paper.md says why one differs; 1 one does not hold;
2 wrong usage; 3 a file is unusable.
"""
BEGIN, END = '<!-- paper: begin -->', '<!-- paper: end -->'


def main(arguments: Sequence[str] | None = None) -> int:
    """Repeat the paper; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='python -m paper', epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Repeat the paper's tables and figures on a stated environment.",
    )
    parser.add_argument(
        '-o', '--output', type=Path, default=Path('out/paper'), metavar='FOLDER',
        help='folder of the results (default: %(default)s)',
    )
    parser.add_argument(
        '--docs', type=Path, metavar='FILE',
        help='also update the tables in this Markdown file, between its marks',
    )
    options = parser.parse_args(arguments)
    begin = time.monotonic()

    def say(text: str) -> None:
        print(f'{time.monotonic() - begin:5.1f} s  {text}', file=sys.stderr, flush=True)

    try:
        comparisons = _run(options.output, options.docs, say)
    except ModuleNotFoundError as error:
        print(f'paper: {error}; try: make paper', file=sys.stderr)
        return 3
    except (AmbushPlannerError, OSError) as error:
        print(f'paper: {error}', file=sys.stderr)
        return 3
    failed = [each.statement for each in comparisons if not (each.holds or each.explained)]
    for statement in failed:
        print(f'paper: does not hold: {statement}', file=sys.stderr)
    return 1 if failed else 0


def _run(folder: Path, docs: Path | None, say: Say) -> list[Comparison]:
    from .figures import draw_all  # --help needs no matplotlib

    folder.mkdir(parents=True, exist_ok=True)
    if docs is not None:
        with_tables(docs.read_text(), '')  # fails before the computation
    results, comparisons = _compute(folder, say)
    tables = report(results)
    (folder / 'tables.md').write_text(tables)
    if docs is not None:
        docs.write_text(with_tables(docs.read_text(), tables))
    draw_all(results, folder, say)
    print(f'{tables}\n{folder}: results.json, tables.md and the figures')
    return comparisons


def _compute(folder: Path, say: Say) -> tuple[Results, list[Comparison]]:
    """Run the experiments and write the numbers."""
    results = compute(environment.make_risk_map(), say)
    comparisons = compare(results)
    (folder / 'results.json').write_text(_as_json(results, comparisons))
    return results, comparisons


def with_tables(document: str, tables: str) -> str:
    """Put the tables between the marks of a document.

    Raises
    ------
    InvalidOption
        The document does not contain both marks in order.
    """
    before, begin, rest = document.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise InvalidOption(f'the document needs the lines {BEGIN} and {END}')
    return f'{before}{BEGIN}\n\n{tables}\n{END}{after}'


def _as_json(results: Results, comparisons: Sequence[Comparison]) -> str:
    stated = {
        name.lower(): getattr(environment, name)
        for name in dir(environment)
        if name.isupper()
    }
    content = {
        'environment': stated,
        'draws': DRAWS,
        'versions': {
            'python': platform.python_version(),
            'numpy': np.__version__,
            'scipy': scipy.__version__,
        },
        **results.rows(),
        'comparisons': [asdict(comparison) for comparison in comparisons],
    }
    return json.dumps(content, indent=2, allow_nan=False) + '\n'

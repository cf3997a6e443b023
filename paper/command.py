"""``ambush_paper``: the paper's tables and figures, repeated on an environment that is stated.

E. Boidot and E. Feron, *Planning Random path distributions for ambush games in unstructured
environments*. See ``paper.environment`` for the environment and docs/paper.md for the result.
"""

from __future__ import annotations

import argparse
import json
import platform
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import scipy

from ambush_planner.commands import cli
from ambush_planner.errors import InvalidOption

from . import environment
from .report import Comparison, compare, report
from .results import DRAWS, Results, Say, compute

EPILOG = """\
The folder then holds results.json, tables.md and the figures 2 to 7 of the paper with one of our
own strategy. The paper's numbers stand beside ours; on its 8-node network they can be compared
themselves, on the map, which it does not publish, only their order can. Takes about a minute.
A comparison that fails is a finding.
--json: {"verdict", "folder", "failed": [statements], "seconds"}
""" + cli.EXIT_CODES
BEGIN, END = '<!-- ambush_paper: begin -->', '<!-- ambush_paper: end -->'


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser(
        'paper', "Repeat the paper's tables and figures on an environment that is stated.", EPILOG
    )
    made.add_argument(
        '-o', '--output', type=Path, default=Path('out/paper'), metavar='FOLDER',
        help='where the results go; made if missing (default: %(default)s)',
    )
    made.add_argument(
        '--docs', type=Path, metavar='FILE',
        help='also renew the tables in this Markdown file, between its marks',
    )
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> int:
    from .figures import draw_all  # --help needs no matplotlib

    options.output.mkdir(parents=True, exist_ok=True)
    results, comparisons = _compute(options.output, options.docs, console.step)
    draw_all(results, options.output, console.step)
    console.line(report(results))
    console.line(f'{cli.place(options.output)}: results.json, tables.md and the figures')
    failed = [comparison.statement for comparison in comparisons if not comparison.holds]
    for statement in failed:
        console.error(f'does not hold: {statement}')
    console.result = {
        'folder': cli.place(options.output), 'failed': failed,
        'seconds': round(console.seconds, 1),
    }
    return cli.Exit.FINDING if failed else cli.Exit.HOLDS


def _compute(folder: Path, docs: Path | None, say: Say) -> tuple[Results, list[Comparison]]:
    """Run the experiments and write the numbers."""
    if docs is not None:
        with_tables(docs.read_text(), '')  # fails now, not when all is done
    results = compute(environment.make_risk_map(), say)
    comparisons = compare(results)
    (folder / 'results.json').write_text(_as_json(results, comparisons))
    tables = report(results)
    (folder / 'tables.md').write_text(tables)
    if docs is not None:
        docs.write_text(with_tables(docs.read_text(), tables))
    return results, comparisons


def with_tables(document: str, tables: str) -> str:
    """Put the tables between the marks of a document.

    Raises
    ------
    InvalidOption
        The document does not hold both marks, one after the other.
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


main = cli.command(parser, _work)

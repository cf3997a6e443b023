# SPDX-License-Identifier: Apache-2.0
"""The paper's reproduction: environment, laws of the results, and the tables in docs/paper.md."""

import json
import re

import pytest
from commands import ROOT, run_here

from ambush_planner import solve
from paper import command as paper
from paper import environment
from paper.report import NAMES
from paper.results import SOLVERS, distinct_routes

DOCUMENT = ROOT / 'docs' / 'paper.md'
NUMBER = re.compile(r'\d+(?:\.\d+)?')
# Where HiGHS' interior point method stops depends on its version.
THEIRS, OURS = 0.05, 0.01


@pytest.fixture(scope='module')
def done(tmp_path_factory):
    """The folder of a full run."""
    pytest.importorskip('matplotlib', reason='the paper has figures')
    folder = tmp_path_factory.mktemp('paper') / 'new folder'
    done = run_here(paper, '-o', folder)
    assert done.code == 0, done.out + done.err
    assert 'NOT ok' not in done.out
    assert (folder / 'tables.md').read_text() in done.out
    return folder


@pytest.fixture(scope='module')
def results(done):
    return json.loads((done / 'results.json').read_text())


def test_the_example_has_seven_routes():
    assert distinct_routes(solve(environment.make_example()), 500) == 7


def test_unusable_files_are_refused_before_the_computation(tmp_path, capsys):
    pytest.importorskip('matplotlib', reason='the paper has figures')
    (tmp_path / 'file').write_text('')
    assert paper.main(['-o', str(tmp_path / 'file')]) == 3
    assert capsys.readouterr().err.startswith('paper: ')
    assert paper.main(['-o', str(tmp_path), '--docs', str(tmp_path / 'missing.md')]) == 3
    assert 'missing.md' in capsys.readouterr().err


@pytest.mark.slow
def test_all_solvers_find_one_value(results):
    for network in ('8 nodes', *environment.METHODS):
        rows = [row for row in results['table_2'] if row['network'] == network]
        assert [row['solver'] for row in rows] == list(SOLVERS)
        centre, vertex, ours = [row['value'] for row in rows]
        assert centre == pytest.approx(vertex, rel=2e-6)
        assert ours == pytest.approx(vertex, rel=1e-5)
    example = results['table_2'][0]
    assert example['value'] == pytest.approx(1 / 3, rel=1e-6)


@pytest.mark.slow
def test_every_comparison_holds(results):
    assert len(results['comparisons']) >= 15
    assert all(row['holds'] or row['explained'] for row in results['comparisons'])
    assert sum(not row['holds'] for row in results['comparisons']) == 4
    assert sum(row['exact'] for row in results['comparisons']) == 5


@pytest.mark.slow
def test_every_figure_exists_and_is_not_blank(done):
    from matplotlib.image import imread

    pictures = list(done.glob('*.png'))
    assert len(pictures) == 9
    for path in pictures:
        picture = imread(path)
        assert picture.shape[0] > 400 and picture.shape[1] >= 800
        assert picture.std() > 0.05


@pytest.mark.slow
def test_the_document_shows_what_a_fresh_run_prints(done):
    document = DOCUMENT.read_text()
    shown = document.split(paper.BEGIN)[1].split(paper.END)[0].strip().splitlines()
    fresh = (done / 'tables.md').read_text().strip().splitlines()
    assert len(shown) == len(fresh)
    for theirs, ours in zip(shown, fresh, strict=True):
        check_line(theirs, ours)


def check_line(shown: str, fresh: str) -> None:
    """The same words, and numbers within the tolerance that docs/paper.md states."""
    a, b = cells(shown), cells(fresh)
    assert [NUMBER.sub('#', cell) for cell in a] == [NUMBER.sub('#', cell) for cell in b]
    ours = b[0].startswith('ours, max_detour') or NAMES['max_entropy'] in b
    for x, y in zip(NUMBER.findall(shown), NUMBER.findall(fresh), strict=True):
        last_place = 10.0 ** -len(y.partition('.')[2])
        tolerance = max((OURS if ours else THEIRS) * abs(float(y)), 1.01 * last_place)
        assert abs(float(x) - float(y)) <= tolerance, (shown, fresh)


def cells(line: str) -> list[str]:
    """The cells of a table's row without their padding; rules differ in length only."""
    return [re.sub('-+', '-', cell.strip()) for cell in line.strip('|').split('|')]

"""docs/gis.md and docs/tour.ipynb: everything in them runs, and leaves what they promise."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip('geopandas', reason='routes in files take the extra "gis"')
pytest.importorskip('gpxpy', reason='GPX takes the extra "gis"')
pytest.importorskip('matplotlib', reason='pictures need matplotlib')

from audit_samples import departure, drawn, parameters, record, sample_plan
from test_rooms import NO_ROS

DOCS = Path(__file__).resolve().parent.parent / 'docs'
BLOCKS = re.findall(r'(?ms)^```(sh|python)\n(.*?)^```$', (DOCS / 'gis.md').read_text())
# The commands take a minute of processor time, and more on a loaded machine [s].
TIMEOUT = 800
CELLS = json.loads((DOCS / 'tour.ipynb').read_text())['cells']


def sources(kind):
    return [''.join(cell['source']) for cell in CELLS if cell['cell_type'] == kind]


@pytest.mark.slow
@pytest.mark.timeout(TIMEOUT + 20)
def test_every_command_of_the_page_works(tmp_path):
    a_plan = sample_plan()
    entries = {'parameters': parameters(**{'map.crs': 'datum 36.6 -84.3 0.0'})}
    record(tmp_path / 'runs', [departure(a_plan, drawn(a_plan, 1)[0], entries=entries)])
    assert sum(kind == 'sh' for kind, _ in BLOCKS) == 6
    script = '\n'.join(f"python - <<'END'\n{text}END" if kind == 'python' else text
                       for kind, text in BLOCKS)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])
    done = subprocess.run(['bash', '-ec', script], cwd=tmp_path, capture_output=True, text=True,
                          env={**os.environ, 'PATH': path}, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    assert 'reprojected from EPSG:4326 to EPSG:32616' in done.stderr
    told = re.search(r'(?m)^card.html: .*$', (DOCS / 'gis.md').read_text())[0]
    assert re.search(re.sub(r'\d+', r'\\d+', told), done.stdout), done.stdout
    files = set(re.findall(r'\b(?:routes|quick|robot|driven|map|card)\.\w+', ' '.join(
        text for kind, text in BLOCKS if kind == 'sh')))
    assert len(files) == 11 and all((tmp_path / file).stat().st_size for file in files)


@pytest.mark.slow
@pytest.mark.timeout(TIMEOUT + 20)
def test_the_notebook_runs_without_ros(tmp_path):
    """Each cell runs, and its last expression has the representation that a notebook shows."""
    assert len(CELLS) == 10
    cells = [source.rstrip(';') for source in sources('code')]
    script = NO_ROS + 'import matplotlib\nmatplotlib.use("Agg")\n' + '\n'.join(cells) + (
        "\nfor each in (plan, plan.strategy):"
        "\n    assert '<th>value</th>' in each._repr_html_() and len(repr(each)) < 300"
        "\nassert plan.strategy.plot().collections and len(routes) == 20"
        "\nassert routes.crs.to_epsg() == 32616")
    done = subprocess.run([sys.executable, '-c', script], cwd=tmp_path, capture_output=True,
                          text=True, timeout=TIMEOUT)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / 'routes.gpx').stat().st_size > 100_000


def test_the_notebook_was_saved_with_its_pictures():
    outputs = [output for cell in CELLS for output in cell.get('outputs', ())]
    assert sum('image/png' in output.get('data', ()) for output in outputs) == 2
    assert not any(output['output_type'] == 'error' for output in outputs)


def test_the_page_and_the_notebook_make_the_same_terrain():
    assert next(text for kind, text in BLOCKS if kind == 'python').strip() == sources('code')[0]

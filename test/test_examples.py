# SPDX-License-Identifier: Apache-2.0
"""Each script in examples runs and prints its results; the one for Nav2 asks a real node."""

import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from ros_harness import free_domain, stage

EXAMPLES = Path(__file__).resolve().parents[1] / 'examples'
PRINTED = {
    '01_map_to_routes': 'no strategy can promise less',
    '02_terrain_to_gpx': 'departure',
    '03_roads': 'fastest',
    '04_nav2': 'poses in map',
    '05_own_tracks': '300 drawn',
    '06_ros_client': 'departure 2',
}
pytestmark = pytest.mark.slow


@pytest.mark.parametrize('script', sorted(path.stem for path in EXAMPLES.glob('*.py')))
def test_it_runs(script, tmp_path):
    environment = dict(os.environ)
    with ExitStack() as stack:
        if script == '02_terrain_to_gpx':
            pytest.importorskip('geopandas', reason='it takes the extra "gis"')
        if script in ('04_nav2', '06_ros_client'):
            domain = stack.enter_context(free_domain())
            running = stack.enter_context(stage(domain=domain))
            if script == '04_nav2':
                running.give()
            environment['ROS_DOMAIN_ID'] = str(domain)
        # With more time, for a machine that does other things.
        file = EXAMPLES / f'{script}.py'
        text = file.read_text().replace(
            'Options(game=', 'Options(strategy=StrategyOptions(time_limit=1e3), game=').replace(
            'import GameOptions', 'import StrategyOptions, GameOptions')
        done = subprocess.run([sys.executable, '-c', f'__file__ = {str(file)!r}\n{text}'],
                              cwd=tmp_path, env=environment, capture_output=True, text=True,
                              check=False)
    assert done.returncode == 0, done.stderr
    assert PRINTED[script] in done.stdout and done.stdout.count('waiting') < 2
    for file in tmp_path.iterdir():
        assert file.name == 'routes.gpx' and file.stat().st_mode & 0o777 == 0o600

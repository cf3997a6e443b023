"""The tutorial from its first command to its last, in one shell, with a real node."""

import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip('matplotlib', reason='the report and the audit need matplotlib')

from ros_harness import free_domain

HERE = Path(__file__).resolve().parent
BLOCKS = re.findall(r'(?ms)^```(.*?)\n(.*?)^```$', (HERE.parent / 'docs/tutorial.md').read_text())
SECONDS = 600


def test_every_block_is_run_and_the_views_are_there():
    assert {kind for kind, _ in BLOCKS} == {'sh'}
    files = re.findall(r'`(config/\S+)`', (HERE.parent / 'docs/tutorial.md').read_text())
    assert len(files) == 2 and all((HERE.parent / file).is_file() for file in files)


@pytest.mark.slow
@pytest.mark.timeout(SECONDS + 60)
def test_every_command_works(tmp_path):
    standin = tmp_path / 'bin' / 'ros2'
    standin.parent.mkdir()
    standin.write_text(f'#!/bin/sh\nexec {sys.executable} {HERE}/ros2_standin.py "$@"\n')
    standin.chmod(0o755)
    script = '\n'.join(text for _, text in BLOCKS)
    with free_domain() as domain:
        environment = {
            **os.environ, 'HOME': str(tmp_path), 'ROS_DOMAIN_ID': str(domain),
            'PATH': os.pathsep.join(
                [str(standin.parent), str(Path(sys.executable).parent), os.environ['PATH']]
            ),
        }
        # The wheels' bootstrap: for this process, not for those that it starts.
        environment.pop('_ROS_WHEELS_BOOTSTRAP_COMPLETE', None)
        environment.pop('LD_LIBRARY_PATH', None)
        # A file has an end, whoever of the background still holds it.
        with (tmp_path / 'told').open('w') as output:
            process = subprocess.Popen(
                ['bash', '-ec', script], cwd=tmp_path, env=environment, stdout=output,
                stderr=subprocess.STDOUT, start_new_session=True,
            )
            try:
                process.wait(SECONDS)
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                told = (tmp_path / 'told').read_text()
                print(told)
    assert process.returncode in (0, 128 + signal.SIGTERM), told
    assert told.count('success=True') == 6, told
    folder = tmp_path / 'ambush_tutorial'
    assert 'Verified: all 6 recordings' in (folder / 'report' / 'report.html').read_text()
    for name in ('frontier.png', 'audit/audit.png'):
        assert (folder / name).stat().st_size > 0, told
    assert len(list(folder.glob('runs/*/*.mcap'))) == 6, told

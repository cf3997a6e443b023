"""What processes that were killed leave behind: their children, and shared memory of Fast DDS."""

import os
import signal
import time
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

# Each process inherits it: so they are found, whoever started them.
NAME = 'AMBUSH_PLANNER_TEST_RUN'
SHARED = Path('/dev/shm')


def mark_processes():
    """Mark all that this process starts from now on, and what those start; return the mark."""
    mark = uuid4().hex
    # A run inside another keeps the other's mark.
    os.environ[NAME] = os.environ.get(NAME, '') + mark
    return mark


def marked(mark):
    """Process ids of all others that bear the mark."""
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            words = (folder / 'environ').read_bytes().split(b'\0')
        except OSError:  # it has just ended, or is somebody else's
            continue
        if any(word.startswith(NAME.encode()) and mark.encode() in word for word in words):
            found.append(int(folder.name))
    return [pid for pid in found if pid != os.getpid()]


def end_processes(mark, seconds=5.0):
    """Kill them, and those that they start meanwhile, and see them off."""
    end = time.monotonic() + seconds
    while (found := marked(mark)) and time.monotonic() < end:
        for pid in found:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.05)


def remove_shared_memory(since):
    """Remove what Fast DDS has made since then, if no process maps it any more."""
    found = [path for path in SHARED.glob('fastrtps_*')
             if not path.name.endswith(('_el', '_sl')) and _is_ours(path, since)]
    if unused := set(found) - _mapped():
        time.sleep(0.5)  # another run may be about to map it
        unused -= _mapped()
    for path in unused:
        beside = [f'{path.name}_el', f'{path.name}_sl', f'sem.{path.name}_mutex']
        for each in (path, *map(path.with_name, beside)):
            each.unlink(missing_ok=True)


def _mapped():
    found = set()
    for maps in Path('/proc').glob('[0-9]*/maps'):
        try:
            lines = maps.read_text().splitlines()
        except OSError:
            continue
        found.update(Path(line.split()[5]) for line in lines if f' {SHARED}/' in line)
    return found


def _is_ours(path, since):
    with suppress(FileNotFoundError):
        found = path.stat()
        return found.st_uid == os.getuid() and found.st_ctime >= since
    return False

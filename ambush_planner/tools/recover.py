"""``ambush_recover``: saves what is whole in broken recordings."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..recording.recovery import Recovered

EPILOG = """\
It takes recordings that were cut off, have changed bits, or were left as temporary files by a
crash, and saves every whole message, metadata record and attachment in a valid file beside the
input (NAME.recovered.mcap; a folder becomes NAME.recovered). The input is not changed and nothing
is overwritten. A recording that is whole needs no copy and gets one only with -o.
Exit code: 0 if nothing was lost, 1 if something was, or could not be read or written, 2 for a
wrong command line.
"""
_MOST_LOSSES = 20
_PROGRESS_SECONDS = 2.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Recover a file or a folder and return the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        # Here, so that --help and the message below need no ROS.
        from ..core.errors import AmbushPlannerError
        from ..recording.recovery import recover_file, recover_folder
    except ModuleNotFoundError as error:
        package = str(error.name).partition('.')[0]
        return _fail(f"{package} is not installed; try: pip install 'ambush_planner[jazzy]'")
    if options.output and (options.output.exists() or options.output.is_symlink()):
        parser.error(f'{options.output} is already there; name another output')
    try:
        if options.input.is_dir():
            done = recover_folder(options.input, options.output, _Progress())
        else:
            done = [recover_file(options.input, options.output, _Progress())]
    except AmbushPlannerError as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        return _fail('interrupted')
    for recovered in done:
        print('\n'.join(_report(recovered)))
    return 1 if any(recovered.found.losses for recovered in done) else 0


def _report(recovered: Recovered) -> list[str]:
    """What was saved and lost of a file, in numbers; never what it says."""
    found = recovered.found
    content = found.content
    stated = '' if found.stated_messages is None else f' of {found.stated_messages}'
    lines = [
        f'{recovered.source}: messages {len(content.messages)}{stated}, '
        f'metadata records {len(content.metadata)}, attachments {len(content.attachments)}'
    ]
    if recovered.target is not None:
        lines.append(f'  saved in {recovered.target}')
    else:
        lines.append('  nothing could be saved' if found.losses else '  nothing to recover')
    if found.is_whole:
        lines.append('  the file is whole')
    if found.rebuilt:
        lines.append(f'  rebuilt: {found.rebuilt}')
    if found.unverified:
        lines.append(f'  unverified: {found.unverified} of the messages, from damaged chunks')
    lines += [f'  lost: {loss}' for loss in found.losses[:_MOST_LOSSES]]
    if len(found.losses) > _MOST_LOSSES:
        lines.append(f'  lost: {len(found.losses) - _MOST_LOSSES} more')
    return lines


class _Progress:
    """Tells on stderr how far it is, when it takes long."""

    def __init__(self) -> None:
        self._next = time.monotonic() + _PROGRESS_SECONDS

    def __call__(self, path: Path, fraction: float) -> None:
        now = time.monotonic()
        if now >= self._next:
            self._next = now + _PROGRESS_SECONDS
            print(f'ambush_recover: {path.name}: {fraction:.0%}', file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='ambush_recover',
        description='Save what is whole in broken recordings.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        'input',
        type=Path,
        metavar='FILE_OR_FOLDER',
        help='a recording, a session folder, or a folder of session folders',
    )
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        metavar='OUTPUT',
        help='the new file (for a folder: the new folder); must not be there yet',
    )
    return parser


def _fail(message: str) -> int:
    print(f'ambush_recover: {message}', file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())

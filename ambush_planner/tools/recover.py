"""``ambush_recover``: saves what is whole in broken recordings."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from .command_line import exit_code

if TYPE_CHECKING:
    from ..recording.recovery import Recovered

EPILOG = """\
It takes recordings that were cut off, have changed bits, or were left as temporary files by a
crash, and saves every whole message, metadata record and attachment in a valid file beside the
input (NAME.recovered.mcap; a folder becomes NAME.recovered). The input is not changed and nothing
is overwritten. A single recording that is whole needs no copy and gets one only with -o; a folder
is saved whole, what is not broken in it as a copy. A run that is
interrupted leaves whole files; remove them, or name another output, before it is repeated.
Exit code: 0 if nothing was lost, 1 if something was, or could not be read or written, 2 for a
wrong command line.
"""
_MOST_LOSSES = 20
_PROGRESS_SECONDS = 2.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Recover a file or a folder and return the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.output and (options.output.exists() or options.output.is_symlink()):
        parser.error(f'{options.output} is already there; remove it, or name another output')
    return exit_code('ambush_recover', 'jazzy', lambda: _recover(options.input, options.output))


def _recover(source: Path, output: Path | None) -> bool:
    """Recover a file or a folder, tell of each file when it is done; whether nothing was lost."""
    from ..recording.recovery import recover_file, recover_folder

    if not source.is_dir():
        return _tell(recover_file(source, output, _Progress()))
    nothing_lost = True
    with closing(recover_folder(source, output, _Progress())) as done:
        for recovered in done:
            nothing_lost &= _tell(recovered)
    return nothing_lost


def _tell(recovered: Recovered) -> bool:
    print('\n'.join(_report(recovered)), flush=True)
    return not recovered.losses


def _report(recovered: Recovered) -> list[str]:
    """What was saved and lost of a file, in numbers; never what it says."""
    stated = '' if recovered.stated_messages is None else f' of {recovered.stated_messages}'
    lines = [
        f'{recovered.source}: messages {recovered.messages}{stated}, '
        f'metadata records {recovered.metadata}, attachments {recovered.attachments}'
    ]
    if recovered.target is not None:
        lines.append(f'  saved in {recovered.target}')
    else:
        lines.append('  nothing could be saved' if recovered.losses else '  nothing to recover')
    if recovered.is_whole:
        lines.append('  the file is whole')
    if recovered.rebuilt:
        lines.append(f'  rebuilt: {recovered.rebuilt}')
    if recovered.unverified:
        lines.append(f'  unverified: {recovered.unverified} of the messages, from damaged chunks')
    lines += [f'  lost: {loss}' for loss in recovered.losses[:_MOST_LOSSES]]
    if len(recovered.losses) > _MOST_LOSSES:
        lines.append(f'  lost: {len(recovered.losses) - _MOST_LOSSES} more')
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


if __name__ == '__main__':
    sys.exit(main())

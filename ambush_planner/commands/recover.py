"""``ambush_recover``: saves what is whole in broken recordings."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..recordings.durable_files import make_private_folders, write_durably
from ..recordings.mcap_file import Content, encode, whole_part
from ..recordings.reader import is_session, natural_order, read_bytes
from ..recordings.recording_errors import UnreadableRecording, reading_from
from ..recordings.repair import list_files
from . import cli

EPILOG = """\
It takes recordings that were cut off, have changed bits, or were left as temporary files by a
crash, and saves all whole records up to the first fault in a valid file beside the input
(NAME.recovered.mcap; a folder becomes NAME.recovered). What comes after the fault is not looked
at: `mcap recover` of the mcap command line does more. The input is not changed and nothing is
overwritten. A single recording that is whole needs no copy; a folder is saved whole, what is not
broken in it as a copy of its bytes.
--json: {"verdict", "files": [{"file", "saved", "messages", "metadata", "attachments", "lost"}]}
""" + cli.EXIT_CODES.replace('1 a finding', '1 something was lost')
# What the recorder and its crashes leave.
_LEFT = '.mcap', '.mcap.tmp'


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.reader_parser('recover', 'Save what is whole in broken recordings.', EPILOG)
    made.add_argument(
        '-o', '--output', type=Path, metavar='OUTPUT',
        help='the new file (for a folder: the new folder); must not be there yet',
    )
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> int:
    source, output = options.recordings, options.output
    with reading_from(source):
        jobs = list(_jobs(source, output))
    if not jobs:
        raise UnreadableRecording(source, 'there is no recording in this folder; name another one')
    folders = {target.parent for _, target in jobs} if source.is_dir() else set()
    for folder in folders:
        make_private_folders(folder)
    codes, results = [], []
    for path, target in console.progress(jobs, 'recovered'):
        try:
            # A single recording that is whole needs no copy, unless one is asked for.
            result = _recover(path, target, source.is_dir() or output is not None)
            codes.append(cli.Exit.FINDING if result['lost'] else cli.Exit.HOLDS)
            _tell(result, console)
        except UnreadableRecording as error:
            console.error(error)
            result = {'file': cli.place(path), 'lost': str(error)}
            codes.append(cli.Exit.UNREADABLE)
        results.append(result)
    for folder in folders:
        list_files(folder)
    console.result = {'files': results}
    # Something lost goes before something that cannot be read.
    return min(set(codes) - {cli.Exit.HOLDS}, default=cli.Exit.HOLDS)


def _jobs(source: Path, output: Path | None) -> Iterator[tuple[Path, Path]]:
    """The file, or the files of a folder and of session folders in it, and where each is saved."""
    if not source.is_dir():
        target = output or source.with_name(f'{_stem(source)}.recovered.mcap')
        if output:
            _refuse_existing(target)
        yield source, target
        return
    base = output or source.resolve().with_name(f'{source.resolve().name}.recovered')
    _refuse_existing(base)
    inner = sorted((each for each in source.iterdir() if is_session(each)), key=natural_order)
    for folder in (source, *inner):
        target = base if folder is source else base / folder.name
        for path in sorted(folder.iterdir(), key=natural_order):
            if path.name.endswith(_LEFT) and path.is_file():
                yield path, target / f'{_stem(path)}.mcap'


def _recover(path: Path, target: Path, copies: bool) -> dict[str, Any]:
    """Save a file, and return what was saved and lost in numbers; never what it says."""
    data = read_bytes(path)
    content, fault = whole_part(data)
    saved = (copies or bool(fault)) and any(
        (content.messages, content.metadata, content.attachments)
    )
    if saved:
        _refuse_existing(target)
        write_durably(target, encode(_plain(content)) if fault else data)
    return {
        'file': cli.place(path), 'saved': cli.place(target) if saved else None,
        'messages': len(content.messages), 'metadata': len(content.metadata),
        'attachments': len(content.attachments), 'lost': fault or None,
    }


def _refuse_existing(target: Path) -> None:
    if os.path.lexists(target):
        raise cli.UsageError(f'{cli.place(target)} is already there; name another output with -o')


def _tell(result: dict[str, Any], console: cli.Console) -> None:
    counts = ', '.join(f'{name} {result[name]}' for name in ('messages', 'metadata', 'attachments'))
    console.line(f'{result["file"]}: {counts}')
    lost = result['lost']
    console.item(f'lost: what follows; {lost}' if lost else 'the file is whole')
    if result['saved']:
        console.item(f'saved in {result["saved"]}')
    elif lost:
        console.item('nothing could be saved')


def _plain(content: Content) -> Content:
    """What can be written anew: messages whose channel and schema were read."""
    known = {
        number for number, channel in content.channels.items()
        if channel.schema_id in content.schemas
    }
    content.messages = [each for each in content.messages if each.channel_id in known]
    content.profile = content.profile or 'ros2'
    return content


def _stem(path: Path) -> str:
    """The name of the copy, without its end: that of a temporary file keeps its .tmp."""
    temporary = path.stem.removesuffix('.mcap') + path.suffix
    return temporary if path.suffix == '.tmp' else path.stem


main = cli.command(parser, _work)

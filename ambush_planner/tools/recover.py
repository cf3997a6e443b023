"""``ambush_recover``: saves what is whole in broken recordings."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..recording.durable import make_private_folder, write_durably
from ..recording.errors import UnreadableRecording, reading_from
from ..recording.mcap_file import BadFile, Content, decode, encode, whole_part
from ..recording.reader import is_session, natural_order, read_bytes
from ..recording.repair import list_files
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
# What the recorder and its crashes leave: x.mcap, x.mcap.tmp, x.mcap.broken-2 ...
_NAME = re.compile(r'(?P<stem>.+?)\.mcap(\.tmp|\.broken)*(-\d+)?(\.broken)?')


def main(arguments: Sequence[str] | None = None) -> int:
    """Recover a file or a folder and return the exit code."""
    return cli.run(parser(), _work, arguments)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('recover', 'Save what is whole in broken recordings.', EPILOG)
    cli.add_recordings(made)
    made.add_argument(
        '-o', '--output', type=Path, metavar='OUTPUT',
        help='the new file (for a folder: the new folder); must not be there yet',
    )
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> int:
    source, output = options.recordings, options.output
    if output is not None and os.path.lexists(output):
        raise cli.UsageError(f'{cli.place(output)} is already there; name another output')
    with reading_from(source):
        jobs = list(_jobs(source, output)) if source.is_dir() else [(source, output)]
    codes, results = [cli.Exit.HOLDS], []
    folders = list(dict.fromkeys(target.parent for _, target in jobs if target and source.is_dir()))
    for folder in folders:
        _make_folders(folder)
    for path, target in console.progress(jobs, 'recovered'):
        try:
            code, result = _recover(path, target, source.is_dir(), console)
        except UnreadableRecording as error:
            console.error(error)
            code, result = cli.Exit.UNREADABLE, {'file': cli.place(path), 'lost': str(error)}
        codes.append(code)
        results.append(result)
    for folder in folders:
        list_files(folder)
    code = next(
        each for each in (cli.Exit.FINDING, cli.Exit.UNREADABLE, cli.Exit.HOLDS) if each in codes
    )
    console.result = {'verdict': code.name.lower(), 'files': results}
    return code


def _jobs(source: Path, output: Path | None) -> Iterator[tuple[Path, Path]]:
    """The files of a folder and of session folders in it, and where they are saved."""
    base = output or source.resolve().with_name(f'{source.resolve().name}.recovered')
    if os.path.lexists(base):
        raise cli.UsageError(f'{cli.place(base)} is already there; name another output with -o')
    inner = sorted((each for each in source.iterdir() if is_session(each)), key=natural_order)
    taken: set[Path] = set()
    for folder in (source, *inner):
        target = base if folder is source else base / folder.name
        for path in sorted(folder.iterdir(), key=natural_order):
            match = _NAME.fullmatch(path.name)
            if match and path.is_file():
                wanted, number = target / f'{match["stem"]}.mcap', 2
                while wanted in taken:
                    wanted = target / f'{match["stem"]}-{number}.mcap'
                    number += 1
                taken.add(wanted)
                yield path, wanted
    if not taken:
        raise UnreadableRecording(source, 'there is no recording in this folder; name another one')


def _make_folders(folder: Path) -> None:
    for each in (folder.parent, folder):
        if not each.exists():
            make_private_folder(each)


def _recover(
    path: Path, target: Path | None, copies: bool, console: cli.Console
) -> tuple[cli.Exit, dict[str, object]]:
    """Save a file, and tell what was saved and lost in numbers; never what it says."""
    data = read_bytes(path)
    content, fault = whole_part(data)
    if not fault:
        fault = _index_fault(data)
    saved = None
    if copies or fault or target:
        if content.messages or content.metadata or content.attachments:
            saved = target or _beside(path)
            write_durably(saved, encode(_plain(content)) if fault else data)
    counts = {
        'messages': len(content.messages), 'metadata': len(content.metadata),
        'attachments': len(content.attachments),
    }
    said = ', '.join(f'{name} {number}' for name, number in counts.items())
    console.line(f'{cli.place(path)}: {said}')
    console.item('the file is whole' if not fault else f'lost: what follows; {fault}')
    if saved:
        console.item(f'saved in {cli.place(saved)}')
    elif fault:
        console.item('nothing could be saved')
    result = {
        'file': cli.place(path), 'saved': cli.place(saved) if saved else None, **counts,
        'lost': fault or None,
    }
    return cli.Exit.FINDING if fault else cli.Exit.HOLDS, result


def _index_fault(data: bytes) -> str:
    try:
        decode(data)
    except BadFile as error:
        return str(error)
    return ''


def _plain(content: Content) -> Content:
    """What can be written anew: messages whose channel and schema were read."""
    known = {
        number for number, channel in content.channels.items()
        if channel.schema_id in content.schemas
    }
    content.messages = [each for each in content.messages if each.channel_id in known]
    content.profile = content.profile or 'ros2'
    return content


def _beside(path: Path) -> Path:
    match = _NAME.fullmatch(path.name)
    stem = match['stem'] if match else path.stem
    target = path.with_name(f'{stem}.recovered.mcap')
    if os.path.lexists(target):
        raise cli.UsageError(f'{cli.place(target)} is already there; name another output with -o')
    return target


if __name__ == '__main__':
    sys.exit(main())

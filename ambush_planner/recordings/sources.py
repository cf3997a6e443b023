# SPDX-License-Identifier: Apache-2.0
"""The files that a plan was made from, by name and hash, and which of them have changed.

Names are relative to the plan's folder, so that a plan can be moved, copied and sent together with
its sources, and tells nothing of the machine that made it.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

MAP, ROADS, LAYER = 'map', 'roads', 'layer'
# The list of the files that a map was made from, next to it, by its name without the suffix.
SUFFIX = '.sources.json'
# Files that belong to one with another suffix.
_TOGETHER = {'.shp': ('.dbf',)}


@dataclass(frozen=True)
class Source:
    """A file by its ``role`` in the plan, its name, and the SHA-256 of its content."""

    role: str
    name: str
    digest: str


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file; raises OSError."""
    digest = hashlib.sha256()
    with path.open('rb') as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def sources_of(folder: Path, map_file: Path | None, roads: Any = None) -> tuple[Source, ...]:
    """Return the sources of a plan in a folder: map, roads, and the layers of the map.

    ``roads`` are no source if they are not a file. Raises OSError.
    """
    files = [(MAP, path) for path in files_of_map(map_file)] if map_file else []
    if isinstance(roads, str | Path):
        path = Path(str(roads).partition('|')[0]).expanduser()
        files += [(ROADS, each) for each in _with_others(path)]
    found = [Source(role, _name(path, folder), digest_of(path)) for role, path in files]
    layers = _layers_of(map_file) if map_file else []
    return (*found, *(Source(LAYER, _name(path, folder), digest) for path, digest in layers
                      if _is_near(path, folder)))


def files_of_map(path: Path) -> list[Path]:
    """The files of a map: of map_server's, the YAML file and its image."""
    if path.suffix.lower() not in ('.yaml', '.yml'):
        return [path]
    with suppress(OSError, ValueError, LookupError, TypeError, yaml.YAMLError):
        return [path, path.parent / yaml.safe_load(path.read_text('utf-8'))['image']]
    return [path]


def list_sources(made: Sequence[Path], of: Iterable[Path]) -> Path:
    """Write the files ``of`` which the files of a map were ``made``, next to these."""
    path = made[0].with_suffix(SUFFIX)
    path.write_text(json.dumps({
        'made': {each.name: digest_of(each) for each in made},
        'of': [{'name': _name(each, path.parent), 'digest': digest_of(each)} for each in of
               if _is_near(each, path.parent)],
    }, indent=1), encoding='utf-8')
    return path


def changes(sources: Iterable[Source], folder: Path) -> list[str]:
    """Say which sources of a plan in a folder have changed or are gone."""
    found = []
    for each in sources:
        try:
            same = digest_of(folder / each.name) == each.digest
        except FileNotFoundError:
            found.append(f'{each.name} is gone, the {each.role} that the plan was made from')
        except OSError as error:
            found.append(f'{each.name}, the {each.role} that the plan was made from, cannot be '
                         f'read: {error.strerror}')
        else:
            if not same:
                found.append(f'{each.name} has changed, the {each.role} that the plan was made '
                             'from')
    return found


def layer_files(description: Mapping[str, Any], folder: Path) -> list[Path]:
    """The files that the layers of a description of ``ambush risk`` name."""
    lines = [line for line in description.get('layers') or () if isinstance(line, Mapping)]
    paths = [folder / Path(str(next(iter(line.values())))).expanduser() for line in lines if line]
    return [file for path in paths if path.is_file() for file in _with_others(path)]


def _layers_of(map_file: Path) -> list[tuple[Path, str]]:
    """The files that a map was made from, and their hashes then, if the map is still that one."""
    path = map_file.with_suffix(SUFFIX)
    with suppress(OSError, ValueError, LookupError, TypeError):
        listed = json.loads(path.read_text('utf-8'))
        if listed['made'][map_file.name] == digest_of(map_file):
            return [(path.parent / each['name'], each['digest']) for each in listed['of']]
    return []


def _with_others(path: Path) -> list[Path]:
    """A file, and those that belong to it."""
    others = (path.with_suffix(each) for each in _TOGETHER.get(path.suffix.lower(), ()))
    return [path, *(each for each in others if each.is_file())]


def _name(path: Path, folder: Path) -> str:
    """The path from a folder if it is near, else the name alone."""
    return os.path.relpath(path, folder) if _is_near(path, folder) else path.name


def _is_near(path: Path, folder: Path) -> bool:
    """Return whether a file is below a folder, or below that folder's parent.

    So names tell nothing of the folders of users.
    """
    folder = Path(os.path.abspath(folder))
    above, home = folder.parent, Path.home()
    if above == above.parent or (home.is_relative_to(above) and home != above):
        above = folder
    return Path(os.path.abspath(path)).is_relative_to(above)

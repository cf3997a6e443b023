# SPDX-License-Identifier: Apache-2.0
"""``ambush views``: RViz and Foxglove layouts for a map of any size.

The two templates next to this file, installed in share/ambush_planner/config, fit the example map
of 10 m x 8 m. The path is at height 0, line markers are below it and discs above it. Foxglove draws
transparent lines last, the higher ones in front.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import Any

import yaml

from ..maps.occupancy import OccupancyOptions
from ..maps.risk_map import RiskMap
from ..maps.risk_map_file import read_risk_map
from ..recordings import read_departure, recordings_in
from . import cli
from .inputs import MAP_HELP

RVIZ, FOXGLOVE = 'ambush_planner.rviz', 'ambush_planner_foxglove.json'
POSES = ('start_pose', 'goal_pose', 'initialpose')
TOPICS = ('alpha_map', 'path', *POSES)
EPILOG = f"""\
RECORDING_OR_MAP is a recording, a folder of recordings (the last departure counts, with its topic
names), or a MAP.
{MAP_HELP}
The files are ambush_planner.rviz (rviz2 -d FILE) and ambush_planner_foxglove.json (Layouts, Import
from file): the whole map in view, lines of visible width, start and goal tools, a departure button.
--json: {{"verdict", "files", "frame", "centre", "size"}}
""" + cli.EXIT_CODES
# Size of RViz's map view [px], and width over height of Foxglove's 3D panel on a wide screen.
_RVIZ_VIEW, _PANEL_ASPECT = (900, 700), 1.2
# Widths and arrow sizes as shares of the map's larger side.
_LINE = 0.008
_ARROW = {'Shaft Length': 0.05, 'Shaft Radius': 0.005, 'Head Length': 0.025, 'Head Radius': 0.0125}
# Maximum height of the path in RViz [m], whose camera is at 500 m.
_MAX_HEIGHT = 200.0
_UPDATES = '_updates'


@dataclass(frozen=True)
class Scene:
    """A map's bounding box, (x, y) [m], its frame, and the full names of topics and of the node."""

    centre: tuple[float, float]
    size: tuple[float, float]
    frame: str = 'map'
    topics: Mapping[str, str] = field(default_factory=dict)
    node: str = '/ambush_planner'


def scene_of(risk_map: RiskMap, **more: Any) -> Scene:
    """Return the scene of a map, which may be rotated; ``more`` are other fields of Scene."""
    low, high = risk_map.bounds
    return Scene(tuple(((low + high) / 2).tolist()), tuple((high - low).tolist()), **more)


def rviz_text(scene: Scene) -> str:
    """Return the file for ``rviz2 -d``."""
    text = cli.resource(RVIZ)
    header = ''.join(takewhile(lambda line: line.startswith('#'), text.splitlines(True)))
    config = _renamed(yaml.safe_load(text), scene)
    manager, scale = config['Visualization Manager'], max(scene.size)
    manager['Global Options']['Fixed Frame'] = scene.frame
    zoom = min(_RVIZ_VIEW[0] / scene.size[0], _RVIZ_VIEW[1] / scene.size[1])
    x, y = map(_short, scene.centre)
    manager['Views']['Current'].update({'Scale': _short(zoom), 'X': x, 'Y': y})
    for display in manager['Displays']:
        if 'Line Width' in display:
            display['Line Width'] = _short(_LINE * scale)
            display['Offset']['Z'] = _short(min(0.02 * scale, _MAX_HEIGHT))
        for name in _ARROW.keys() & display.keys():
            display[name] = _short(_ARROW[name] * scale)
    return header + yaml.safe_dump(config, sort_keys=False, width=100)


def foxglove_text(scene: Scene) -> str:
    """Return the layout for Foxglove and Lichtblick."""
    layout = _renamed(json.loads(cli.resource(FOXGLOVE)), scene)
    panel = layout['configById']['3D!planner']
    panel['followTf'] = scene.frame
    # The visible height of the panel equals the camera's distance.
    distance = 1.1 * max(scene.size[1], scene.size[0] / _PANEL_ASPECT)
    panel['cameraState'].update({'distance': _short(distance),
                                 'targetOffset': [*map(_short, scene.centre), 0],
                                 'near': _short(0.01 * distance), 'far': _short(10.0 * distance)})
    line, arrow = (_short(share * max(scene.size)) for share in (_LINE, _ARROW['Shaft Length']))
    for topic in panel['topics'].values():
        if 'lineWidth' in topic:
            topic['lineWidth'] = line
        if 'arrowScale' in topic:
            topic['arrowScale'] = [arrow, 0.2 * arrow, 0.2 * arrow]
    return json.dumps(layout, indent=2) + '\n'


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('views', 'Make RViz and Foxglove layouts for a map or a recording.',
                          EPILOG)
    made.add_argument('source', type=Path, metavar='RECORDING_OR_MAP', help='what to show')
    cli.add_output(made, f'{RVIZ}, {FOXGLOVE}')
    made.add_argument('--inputs', default='', metavar='NAMESPACE', help='namespace of '
                      'start_pose, goal_pose and initialpose, such as `ambush` with Nav2')
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> cli.Exit:
    folder = options.output or Path('.')
    cli.refuse_existing(folder, (RVIZ, FOXGLOVE), options.replace)
    scene = _scene(options.source, options.inputs)
    files = {RVIZ: rviz_text(scene).encode(), FOXGLOVE: foxglove_text(scene).encode()}
    cli.write_private(folder, files)
    written = [cli.place(folder / name) for name in files]
    for file in written:
        console.line(file)
    console.result = {'files': written, 'frame': scene.frame, 'centre': scene.centre,
                      'size': scene.size}
    return cli.Exit.HOLDS


def _scene(source: Path, namespace: str) -> Scene:
    topics = {name: f'/{namespace}/{name}'.replace('//', '/') for name in POSES}
    if source.suffix.lower() in ('.yaml', '.yml', '.npz', '.tif', '.tiff'):
        return scene_of(read_risk_map(source, OccupancyOptions()), topics=topics)
    path = recordings_in(source)[-1]
    departure = read_departure(path)
    said = departure.metadata
    roles = {'alpha_map': 'map', 'path': 'path', 'start_pose': 'start', 'goal_pose': 'goal'}
    return scene_of(departure.risk_map, frame=said.frame,
                    topics=topics | {name: said.topics[role] for name, role in roles.items()},
                    node=said.call.service.rpartition('/')[0])


def _renamed(value: Any, scene: Scene) -> Any:
    """Replace names of topics and of the node in a part of a template."""
    if isinstance(value, dict):
        return {_renamed(key, scene): _renamed(each, scene) for key, each in value.items()}
    if isinstance(value, list):
        return [_renamed(each, scene) for each in value]
    if not isinstance(value, str):
        return value
    topic, updates = value.removesuffix(_UPDATES), value.endswith(_UPDATES) * _UPDATES
    if topic.startswith('/') and topic[1:] in TOPICS:
        return scene.topics.get(topic[1:], topic) + updates
    return value.replace('ambush_planner', scene.node.lstrip('/'))


def _short(number: float) -> float:
    """Round to four digits."""
    return float(f'{number:.4g}')


main = cli.command(parser, _work)

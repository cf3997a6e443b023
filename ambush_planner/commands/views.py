"""``ambush_views``: what RViz and Foxglove show, set up for a map of any size.

The two files beside this one, which are installed in share/ambush_planner/config, are those of the
example map of 10 m x 8 m; others are made from them. Heights: the path is at 0, as it is driven;
markers of lines lie below it and discs above, see ``ros.markers``. Foxglove draws lines that are
not opaque after all else, the higher ones in front, and a map that is not opaque hides nothing
below it.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from itertools import takewhile
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from ..maps.occupancy import OccupancyOptions
from ..maps.risk_map import RiskMap
from . import cli
from .frontier import read_risk_map

if TYPE_CHECKING:
    from ..recordings import RecordingFile

RVIZ, FOXGLOVE = 'ambush_planner.rviz', 'ambush_planner_foxglove.json'
MARKERS = ('network', 'edge_probabilities', 'mean_direction', 'ambush_sites', 'stops')
_POSES = ('start_pose', 'goal_pose', 'initialpose')
TOPICS: Mapping[str, str] = MappingProxyType({
    name: f'/{name}' for name in ('alpha_map', 'path', *MARKERS, *_POSES)
})
EPILOG = """\
RECORDING_OR_MAP is a recording or a folder of them (the last departure counts, and topics have the
names that they had there), or a map: a YAML file that map_server reads, or an npz file with the
fields of RiskMap. Written are ambush_planner.rviz (rviz2 -d FILE) and
ambush_planner_foxglove.json (Layouts, Import from file), with the whole map in view, lines as wide
as the map wants them, start and goal, and a button that departs.
--json: {"verdict", "files", "frame", "centre", "size"}
""" + cli.EXIT_CODES
# Pixels of RViz' own window that are left for the map, beside its panels.
_RVIZ_VIEW = 900, 700
# Foxglove's 3D panel: as much of the width as its layout gives it, on a wide screen.
_PANEL_ASPECT = 1.2
# Of the larger side of the map.
_LINE = 0.008
_ARROW = {
    'Shaft Length': 0.05, 'Shaft Radius': 0.005, 'Head Length': 0.025, 'Head Radius': 0.0125,
}
# RViz looks down from 500 m.
_HIGHEST = 200.0
_UPDATES = '_updates'


@dataclass(frozen=True)
class Scene:
    """What is looked at: the box around a map, centre and size (x, y) [m], and its frame.

    ``topics`` are full names by our own, ``node`` is the planner's full name.
    """

    centre: tuple[float, float]
    size: tuple[float, float]
    frame: str = 'map'
    topics: Mapping[str, str] = field(default_factory=lambda: TOPICS)
    node: str = '/ambush_planner'

    @property
    def scale(self) -> float:
        """The larger side [m]."""
        return max(self.size)


def scene_of(risk_map: RiskMap, **more: Any) -> Scene:
    """Return the scene around a map, which may be rotated; ``more`` are other fields of it."""
    (width, height), (x, y, yaw) = risk_map.size, risk_map.origin
    corners = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    low, high = (extreme((corners @ turn + (x, y)), axis=0) for extreme in (np.min, np.max))
    return Scene(tuple(((low + high) / 2).tolist()), tuple((high - low).tolist()), **more)


def rviz_text(scene: Scene) -> str:
    """Return the file for ``rviz2 -d``."""
    text = _template(RVIZ)
    header = ''.join(takewhile(lambda line: line.startswith('#'), text.splitlines(True)))
    found = _renamed(yaml.safe_load(text), scene)
    shown, (width, height) = found['Visualization Manager'], scene.size
    shown['Global Options']['Fixed Frame'] = scene.frame
    zoom = min(_RVIZ_VIEW[0] / width, _RVIZ_VIEW[1] / height)
    x, y = map(_short, scene.centre)
    shown['Views']['Current'].update({'Scale': _short(zoom), 'X': x, 'Y': y})
    for display in shown['Displays']:
        if 'Line Width' in display:
            display['Line Width'] = _short(_LINE * scene.scale)
            display['Offset']['Z'] = _short(min(0.02 * scene.scale, _HIGHEST))
        for name in _ARROW.keys() & display.keys():
            display[name] = _short(_ARROW[name] * scene.scale)
    return header + yaml.safe_dump(found, sort_keys=False, width=100)


def foxglove_text(scene: Scene) -> str:
    """Return the layout for Foxglove and Lichtblick."""
    found = _renamed(json.loads(_template(FOXGLOVE)), scene)
    panel = found['configById']['3D!planner']
    panel['followTf'] = scene.frame
    # From above the panel shows as much of the height as the camera is away.
    away = 1.1 * max(scene.size[1], scene.size[0] / _PANEL_ASPECT)
    panel['cameraState'].update({
        'distance': _short(away), 'targetOffset': [*map(_short, scene.centre), 0],
        'near': _short(0.01 * away), 'far': _short(10.0 * away),
    })
    size = _short(_ARROW['Shaft Length'] * scene.scale)
    for topic in panel['topics'].values():
        if 'lineWidth' in topic:
            topic['lineWidth'] = _short(_LINE * scene.scale)
        if 'arrowScale' in topic:
            topic['arrowScale'] = [size, 0.2 * size, 0.2 * size]
    return json.dumps(found, indent=2) + '\n'


def _template(name: str) -> str:
    """The file for the example map."""
    return resources.files(__package__).joinpath(name).read_text('utf-8')


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = cli.new_parser('views', 'RViz and Foxglove, set up for a map or a recording.', EPILOG)
    made.add_argument('source', type=Path, metavar='RECORDING_OR_MAP', help='what to look at')
    cli.add_output(made, f'{RVIZ}, {FOXGLOVE}')
    made.add_argument(
        '--inputs', default='', metavar='NAMESPACE',
        help='where start_pose, goal_pose and initialpose are, as in `ambush` beside Nav2',
    )
    return made


def _work(options: argparse.Namespace, console: cli.Console) -> int:
    folder = options.output or Path('.')
    cli.refuse_existing(folder, (RVIZ, FOXGLOVE), options.replace)
    scene = _scene(options.source, options.inputs)
    files = {RVIZ: rviz_text(scene).encode(), FOXGLOVE: foxglove_text(scene).encode()}
    cli.write_private(folder, files)
    for name in files:
        console.line(cli.place(folder / name))
    console.result = {
        'files': [cli.place(folder / name) for name in files], 'frame': scene.frame,
        'centre': scene.centre, 'size': scene.size,
    }
    return cli.Exit.HOLDS


def _scene(source: Path, namespace: str) -> Scene:
    where = f'/{namespace.strip("/")}' if namespace.strip('/') else ''
    topics = {**TOPICS, **{name: f'{where}/{name}' for name in _POSES}}
    if source.suffix in ('.yaml', '.yml', '.npz'):
        return scene_of(read_risk_map(source, OccupancyOptions()), topics=topics)
    from ..recordings import read_departure, read_recording, recordings_in

    path = recordings_in(source)[-1]
    departure = read_departure(path)
    return scene_of(
        departure.risk_map, frame=departure.frame,
        topics=topics | _recorded_topics(read_recording(path)),
        node=departure.call['service'].rpartition('/')[0],
    )


def _recorded_topics(file: RecordingFile) -> dict[str, str]:
    """The names that a recording has for topics, by our own."""
    drawn = ((each, file.decoded(each).markers) for each in file.messages
             if each.type == 'visualization_msgs/msg/MarkerArray')
    named = {markers[0].ns: each.topic for each, markers in drawn if markers}
    inputs = file.entries['topics']
    roles = {'alpha_map': 'map', 'path': 'path', 'start_pose': 'start', 'goal_pose': 'goal'}
    return {**{name: named[name] for name in MARKERS if name in named},
            **{name: inputs[role] for name, role in roles.items()}}


def _renamed(value: Any, scene: Scene) -> Any:
    """A part of a template with the scene's names for topics and node."""
    if isinstance(value, dict):
        return {_renamed(key, scene): _renamed(each, scene) for key, each in value.items()}
    if isinstance(value, list):
        return [_renamed(each, scene) for each in value]
    if not isinstance(value, str):
        return value
    topic, updates = value.removesuffix(_UPDATES), value.endswith(_UPDATES) * _UPDATES
    if (name := topic.removeprefix('/')) in scene.topics and topic != name:
        return scene.topics[name] + updates
    return value.replace('ambush_planner', scene.node.lstrip('/'))


def _short(number: float) -> float:
    return float(f'{number:.4g}')


main = cli.command(parser, _work)

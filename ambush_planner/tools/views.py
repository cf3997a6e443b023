"""``ambush_views``: what RViz and Foxglove show, set up for a map of any size.

The files in config/ are those of the example map of 10 m x 8 m. Heights: the path is at 0, as it is
driven; markers of lines lie below it and discs above, see ``ros.markers``. Foxglove draws lines
that are not opaque after all else, the higher ones in front, and a map that is not opaque hides
nothing below it.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml

from ..core.risk_map import OccupancyOptions, RiskMap
from . import cli
from .frontier import read_risk_map

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
_HEADER = """\
# RViz of ROS 2 Jazzy, from above:
#
#   rviz2 -d $(ros2 pkg prefix --share ambush_planner)/config/ambush_planner.rviz
#
# "2D Pose Estimate" sets the start, "2D Goal Pose" the goal. Fixed Frame is the map's frame.
# Made by ambush_views, which makes one for any map.
#
# Beside Nav2 start and goal need names of their own, as the launch file gives them: Nav2's
# bt_navigator takes what comes on goal_pose as its own goal, and the robot drives its own plan, the
# same every day; AMCL takes what comes on initialpose for where the robot is. For an RViz started
# by hand add
#
#   --ros-args -r /goal_pose:=/ambush/goal_pose -r /start_pose:=/ambush/start_pose \
#       -r /initialpose:=/ambush/initialpose
#
# or write the names into the file: ambush_views --inputs ambush.
"""
# Pixels of RViz' own window that are left for the map, beside its panels.
_RVIZ_WINDOW, _RVIZ_VIEW = (1300, 850), (900, 700)
# Foxglove's 3D panel: as much of the width as its layout gives it, on a wide screen.
_PANEL_ASPECT = 1.2
# Of the larger side of the map.
_LINE, _ARROW = 0.008, 0.05
# RViz looks down from 500 m.
_HIGHEST = 200.0


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
    (cx, cy), (sx, sy) = ((low + high) / 2).tolist(), (high - low).tolist()
    return Scene((cx, cy), (sx, sy), **more)


def rviz_text(scene: Scene) -> str:
    """Return the file for ``rviz2 -d``."""
    return _HEADER + yaml.safe_dump(_rviz(scene), sort_keys=False, width=100)


def foxglove_text(scene: Scene) -> str:
    """Return the layout for Foxglove and Lichtblick."""
    return json.dumps(_foxglove(scene), indent=2) + '\n'


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
        'verdict': 'holds', 'files': [cli.place(folder / name) for name in files],
        'frame': scene.frame, 'centre': scene.centre, 'size': scene.size,
    }
    return cli.Exit.HOLDS


def _scene(source: Path, namespace: str) -> Scene:
    where = f'/{namespace.strip("/")}' if namespace.strip('/') else ''
    topics = {**TOPICS, **{name: f'{where}/{name}' for name in _POSES}}
    if source.suffix in ('.yaml', '.yml', '.npz'):
        return scene_of(read_risk_map(source, OccupancyOptions()), topics=topics)
    # Maps need no ROS, which reading recordings does.
    from ..recording import read_departure, recordings_in
    from ..review.case import Case

    case = Case(read_departure(recordings_in(source)[-1]))
    return scene_of(
        case.risk_map(), frame=case.metadata.frame, topics=topics | _recorded_topics(case),
        node=case.metadata.call.service.rpartition('/')[0],
    )


def _recorded_topics(case: Any) -> dict[str, str]:
    """The names that a recording has for topics, by our own."""
    from visualization_msgs.msg import MarkerArray

    drawn = ((each, case.decode(each).markers) for each in case.of_type(MarkerArray))
    named = {markers[0].ns: each.topic for each, markers in drawn if markers}
    inputs = case.metadata.inputs
    roles = {'alpha_map': 'map', 'path': 'path', 'start_pose': 'start', 'goal_pose': 'goal'}
    return {**{name: named[name] for name in MARKERS if name in named},
            **{name: inputs[role] for name, role in roles.items()}}


def _rviz(scene: Scene) -> dict[str, Any]:
    zoom = min(_RVIZ_VIEW[0] / scene.size[0], _RVIZ_VIEW[1] / scene.size[1])
    width, height = _RVIZ_WINDOW
    return {
        'Panels': [
            {'Class': 'rviz_common/Displays', 'Name': 'Displays', 'Help Height': 0,
             'Tree Height': 400},
            {'Class': 'rviz_common/Tool Properties', 'Name': 'Tool Properties'},
            {'Class': 'rviz_common/Views', 'Name': 'Views'},
        ],
        'Visualization Manager': {
            'Class': '',
            'Displays': _rviz_displays(scene),
            'Enabled': True,
            'Global Options': {'Background Color': '48; 48; 48', 'Fixed Frame': scene.frame,
                               'Frame Rate': 30},
            'Name': 'root',
            'Tools': _rviz_tools(scene),
            'Transformation': {'Current': {'Class': 'rviz_default_plugins/TF'}},
            'Value': True,
            'Views': {'Current': {
                'Class': 'rviz_default_plugins/TopDownOrtho', 'Name': 'Current View', 'Angle': 0,
                'Scale': _short(zoom), 'X': _short(scene.centre[0]), 'Y': _short(scene.centre[1]),
                'Target Frame': '<Fixed Frame>', 'Near Clip Distance': 0.01,
                'Value': 'TopDownOrtho (rviz_default_plugins)',
            }},
        },
        'Window Geometry': {'Height': height, 'Width': width},
    }


def _rviz_displays(scene: Scene) -> list[dict[str, Any]]:
    topics, scale = scene.topics, scene.scale
    titles = {
        'network': 'Network', 'edge_probabilities': 'How likely each edge is driven',
        'mean_direction': 'Mean direction', 'ambush_sites': 'Where the ambusher waits',
        'stops': 'Stops',
    }
    length = _short(_ARROW * scale)
    arrow = {
        'Shape': 'Arrow', 'Shaft Length': length, 'Shaft Radius': _short(0.1 * length),
        'Head Length': _short(0.5 * length), 'Head Radius': _short(0.25 * length),
    }
    pose = 'rviz_default_plugins/Pose'
    estimate = {'Covariance': {'Value': False, 'Position': {'Value': False},
                               'Orientation': {'Value': False}}}
    return [
        _display('Risk map', 'rviz_default_plugins/Map', topics['alpha_map'], **{
            'Alpha': 1, 'Color Scheme': 'map', 'Draw Behind': True, 'Use Timestamp': False,
            'Update Topic': _topic(f'{topics["alpha_map"]}_updates', 'Volatile', 5),
        }),
        *(_display(title, 'rviz_default_plugins/MarkerArray', topics[name],
                   enabled=name != 'network', Namespaces={}) for name, title in titles.items()),
        _display('Last departure', 'rviz_default_plugins/Path', topics['path'], **{
            'Color': '25; 255; 0', 'Line Style': 'Billboards', 'Line Width': _short(_LINE * scale),
            'Offset': {'X': 0, 'Y': 0, 'Z': _short(min(0.02 * scale, _HIGHEST))},
            'Buffer Length': 1, 'Pose Style': 'None', 'Alpha': 1,
        }),
        _display('Start', pose, topics['start_pose'], 'Volatile', Color='25; 255; 0', **arrow),
        _display('Start, by estimate', 'rviz_default_plugins/PoseWithCovariance',
                 topics['initialpose'], 'Volatile', Color='25; 255; 0', **arrow, **estimate),
        _display('Goal', pose, topics['goal_pose'], 'Volatile', Color='255; 80; 80', **arrow),
    ]


def _display(
    name: str, kind: str, topic: str, durability: str = 'Transient Local', enabled: bool = True,
    **more: Any,
) -> dict[str, Any]:
    return {'Class': kind, 'Name': name, 'Enabled': enabled, **more,
            'Topic': _topic(topic, durability, 1), 'Value': enabled}


def _topic(name: str, durability: str, depth: int) -> dict[str, Any]:
    return {'Depth': depth, 'Durability Policy': durability, 'History Policy': 'Keep Last',
            'Reliability Policy': 'Reliable', 'Value': name}


def _rviz_tools(scene: Scene) -> list[dict[str, Any]]:
    start, goal = (
        _topic(scene.topics[name], 'Volatile', 5) for name in ('initialpose', 'goal_pose')
    )
    plain = ('MoveCamera', 'Select', 'FocusCamera', 'Measure')
    return [
        *({'Class': f'rviz_default_plugins/{name}'} for name in plain),
        {'Class': 'rviz_default_plugins/SetInitialPose', 'Topic': start},
        {'Class': 'rviz_default_plugins/SetGoal', 'Topic': goal},
    ]


def _foxglove(scene: Scene) -> dict[str, Any]:
    name = scene.node.lstrip('/')
    panels = {
        '3D!planner': _scene_panel(scene),
        'CallService!new_route': {
            'serviceName': f'{scene.node}/new_route', 'requestPayload': '{}',
            'layout': 'vertical', 'buttonText': 'New route',
            'buttonTooltip': 'A departure: draws a route and publishes it on /path',
            'editingMode': False, 'timeoutSeconds': 65, 'foxglovePanelTitle': 'Depart',
        },
        'DiagnosticStatusPanel!planner': {
            'topicToRender': '/diagnostics', 'selectedHardwareId': '',
            'selectedName': name,
        },
        'StateTransitions!planner': {
            'isSynced': True, 'paths': [_value(name, key) for key in ('state', 'code')],
        },
        'Plot!value': {
            'paths': [{**_value(name, key), 'enabled': True} for key in ('value', 'lower_bound')],
            'xAxisVal': 'timestamp', 'showXAxisLabels': True, 'showYAxisLabels': True,
            'showLegend': True, 'legendDisplay': 'floating', 'showPlotValuesInLegend': True,
            'isSynced': True, 'sidebarDimension': 240,
            'foxglovePanelTitle': 'Value and lower bound',
        },
    }
    # The button takes 30 % of the height: in less it is hidden below the panel's edge.
    splits = (('row', 68), ('column', 30), ('column', 50), ('column', 45))
    layout: Any = 'Plot!value'
    for panel, (direction, percentage) in zip(
        ('StateTransitions!planner', 'DiagnosticStatusPanel!planner', 'CallService!new_route',
         '3D!planner'), reversed(splits), strict=True,
    ):
        layout = {'first': panel, 'second': layout, 'direction': direction,
                  'splitPercentage': percentage}
    return {'configById': panels, 'globalVariables': {}, 'userNodes': {},
            'playbackConfig': {'speed': 1}, 'layout': layout}


def _scene_panel(scene: Scene) -> dict[str, Any]:
    """The 3D panel. From above it shows as much of the height as it is away."""
    topics, scale = scene.topics, scene.scale
    away = 1.1 * max(scene.size[1], scene.size[0] / _PANEL_ASPECT)
    size = _short(_ARROW * scale)
    arrow = {'visible': True, 'type': 'arrow', 'arrowScale': [size, 0.2 * size, 0.2 * size]}
    # Not quite opaque, a line is drawn after map and discs, which would cover it.
    green, red = '#19ff00fa', '#ff5050ff'
    shown = {name: {'visible': name != 'network'} for name in MARKERS} | {
        # Opaque, it would hide the lines below it.
        'alpha_map': {'visible': True, 'colorMode': 'map', 'alpha': 0.8},
        'path': {'visible': True, 'type': 'line', 'lineWidth': _short(_LINE * scale),
                 'gradient': [green, green]},
        'start_pose': {**arrow, 'color': green},
        'initialpose': {**arrow, 'color': green, 'showCovariance': False},
        'goal_pose': {**arrow, 'color': red},
    }
    return {
        'cameraState': {
            'perspective': False, 'distance': _short(away), 'phi': 0, 'thetaOffset': 0,
            'target': [0, 0, 0], 'targetOffset': [*map(_short, scene.centre), 0],
            'targetOrientation': [0, 0, 0, 1], 'fovy': 45,
            'near': _short(0.01 * away), 'far': _short(10.0 * away),
        },
        'followMode': 'follow-none', 'followTf': scene.frame,
        'scene': {}, 'transforms': {}, 'layers': {}, 'imageMode': {},
        'topics': {topics[name]: settings for name, settings in shown.items()},
        'publish': {
            'type': 'pose', 'poseTopic': topics['goal_pose'], 'pointTopic': '/clicked_point',
            'poseEstimateTopic': topics['initialpose'], 'poseEstimateXDeviation': 0.5,
            'poseEstimateYDeviation': 0.5, 'poseEstimateThetaDeviation': 0.26179939,
        },
    }


def _value(name: str, key: str) -> dict[str, str]:
    """One value of the diagnostics of the planner called ``name``, as Foxglove writes it."""
    path = f'/diagnostics.status[:]{{name=="{name}"}}.values[:]{{key=="{key}"}}.value'
    return {'label': key.replace('_', ' '), 'value': path, 'timestampMethod': 'receiveTime'}


def _short(number: float) -> float:
    return float(f'{number:.4g}')


main = cli.command(parser, _work)

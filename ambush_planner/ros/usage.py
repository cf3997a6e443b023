"""What `ambush_planner --help` says; arguments that are not ROS's are refused."""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress
from textwrap import fill

from rclpy.utilities import remove_ros_args

from ..planning.parameters import PARAMETERS

# What others see of the node: kind, name, type, what it is.
INTERFACE = (
    ('sub', 'alpha_map', 'nav_msgs/OccupancyGrid', 'the risk map; reliable, transient local'),
    ('sub', 'alpha_map_updates', 'map_msgs/OccupancyGridUpdate', 'cells of it that have changed'),
    ('sub', 'start_pose', 'geometry_msgs/PoseStamped', 'where the next departure begins'),
    ('sub', 'initialpose', 'geometry_msgs/PoseWithCovarianceStamped', 'the same, from RViz'),
    ('sub', 'goal_pose', 'geometry_msgs/PoseStamped', 'where the next departure leads'),
    ('sub', 'via_poses', 'geometry_msgs/PoseArray', 'stops on the way; an empty one clears them'),
    ('pub', 'path', 'nav_msgs/Path', 'the route of the last departure'),
    ('pub', 'edge_probabilities', 'visualization_msgs/MarkerArray', 'how likely each edge is used'),
    ('pub', 'mean_direction', 'visualization_msgs/MarkerArray', 'where convoys go on average'),
    ('pub', 'ambush_sites', 'visualization_msgs/MarkerArray', 'where the best ambusher waits'),
    ('pub', 'network', 'visualization_msgs/MarkerArray', 'where convoys may go'),
    ('pub', 'stops', 'visualization_msgs/MarkerArray', 'where convoys stop on the way'),
    ('pub', '/diagnostics', 'diagnostic_msgs/DiagnosticArray', 'the state, and what is wrong'),
    ('srv', '~/new_route', 'std_srvs/Trigger', 'a departure: draws and publishes a route'),
    ('srv', '~/get_plan', 'nav_msgs/GetPlan', 'a departure between the poses of the request'),
    ('srv', '~/replan', 'std_srvs/Trigger', 'solves anew, without a departure'),
    ('srv', '~/cancel', 'std_srvs/Trigger', 'ends all solves'),
    ('act', '~/compute_path_to_pose', 'nav2_msgs/ComputePathToPose', 'a departure, for Nav2'),
)


def check_arguments(arguments: list[str] | None) -> None:
    """Print the help and exit if it is asked for; exit with 2 at what is no argument of ROS."""
    given = sys.argv if arguments is None else ['', *arguments]
    with suppress(RuntimeError):  # malformed ones of ROS: rclpy.init says what is wrong with them
        _parser().parse_args(remove_ros_args(given)[1:])


def _parser() -> argparse.ArgumentParser:
    return argparse.ArgumentParser(
        prog='ambush_planner',
        usage='ros2 run ambush_planner ambush_planner [--help] [--ros-args ...]',
        description='Draws a fresh route for every departure of a convoy from the optimal mixed '
                    'strategy against an ambusher who knows everything but the draw.',
        epilog=f'{_interface()}\n\n{_parameters()}\n\n{_EXAMPLE}',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


_EXAMPLE = """example:
  ros2 run ambush_planner ambush_planner --ros-args -r alpha_map:=/map -p network.clearance:=0.5
  ros2 service call /ambush_planner/new_route std_srvs/srv/Trigger"""


def _interface() -> str:
    rows = [
        f'  {kind}  {name:23} {type_name:41} {text}' for kind, name, type_name, text in INTERFACE
    ]
    head = 'topics, services and actions (of map_msgs and nav2_msgs where these are installed):'
    return '\n'.join((head, *rows))


def _parameters() -> str:
    lines = ['parameters, with their defaults (-p NAME:=VALUE, or --params-file FILE):']
    for name, each in PARAMETERS.items():
        choices = f' One of {", ".join(each.choices)}.' if each.choices else ''
        text = fill(
            each.description + choices, 96, initial_indent=' ' * 6, subsequent_indent=' ' * 6,
            break_on_hyphens=False,
        )
        lines += [f'  {name} = {each.default!r}', text]
    return '\n'.join(lines)

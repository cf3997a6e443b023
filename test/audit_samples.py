"""Recordings of departures for the tests of the tools, written as the format says."""

import hashlib
import io
import json
from dataclasses import replace
from functools import cache

import numpy as np
from ambush_planner.recordings.metadata import Link, chain_text, metadata_texts
from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from recording_samples import encoded_departure, new_route_call
from std_msgs.msg import Header

from ambush_planner.game.game import GameOptions
from ambush_planner.game.strategy import StrategyOptions
from ambush_planner.maps.occupancy import OccupancyOptions, risk_map_from_occupancy
from ambush_planner.network.construction import NetworkOptions
from ambush_planner.planning.parameters import PARAMETERS
from ambush_planner.planning.plan import PlanningOptions, plan
from ambush_planner.recordings import Attachment, RecordedMessage
from ambush_planner.ros.conversions import occupancy_to_ros, path_to_ros, pose_to_ros

START_NS = 1_700_000_000_000_000_000
DAY_NS = 86_400_000_000_000
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
HEADER = Header(frame_id='map')
START, GOAL = (12.5, 147.5), (387.5, 152.5)
SPACING, SECURED = 20.0, 40.0
NUMBERS = ('value', 'lower_bound', 'length_budget', 'length_price', 'shortest_length',
           'expected_length', 'expected_exposure', 'least_exposure', 'exposure_budget',
           'exposure_price', 'edge_entropy', 'route_entropy')


def occupancy(hill=60):
    """A hill in the middle that cannot be crossed, bad ground around it, 40 x 60 cells of 5 m."""
    row, column = np.mgrid[:60, :80]
    away = np.hypot(row - 30, column - 40)
    values = np.clip(95 - 3 * away, 0, 95) + 2 * ((row + column) % 3)
    values[away < 8] = 100
    values[(row > 45) & (column > 30)] += hill // 10
    return np.clip(values, 0, 100).astype(np.int8)


def parameters(**changes):
    values = {name: declaration.default for name, declaration in PARAMETERS.items()}
    values |= {'network.spacing': SPACING, 'game.secured_radius': SECURED}
    return values | changes


@cache
def sample_plan(solver='max_entropy', hill=60, start=START, reach=0.0):
    risk_map = risk_map_from_occupancy(occupancy(hill), 5.0, options=OccupancyOptions())
    options = PlanningOptions(
        NetworkOptions(spacing=SPACING), GameOptions(reach, SECURED),
        StrategyOptions(solver),
    )
    return plan(risk_map, start, GOAL, options)


def strategy_arrays(strategy):
    network = strategy.network
    return {
        'points': network.points, 'alpha': network.alpha, 'edges': network.edges,
        'source': network.source, 'target': network.target, 'legs': network.legs,
        'edge_probability': strategy.edge_probability,
        'ambush_probability': strategy.ambush_probability,
        'reach': strategy.game.ambush_radius,
        'start': np.empty(0),
        **{name: getattr(strategy, name) for name in NUMBERS},
    }


def npz(arrays):
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def departure(a_plan, route, number=1, hill=60, strategy=None, texts=(), stamp_ns=None,
              start=START, changes=b''):
    """Messages, metadata and attachments of one departure; ``texts`` replace metadata entries.

    ``changes`` are the bytes of a map_changes.npz.

    Hashes are those of what is recorded, changed entries too.
    """
    strategy = npz(strategy_arrays(a_plan.strategy)) if strategy is None else strategy
    stamp = START_NS + number * DAY_NS if stamp_ns is None else stamp_ns
    poses = np.column_stack((a_plan.network.points[route], np.zeros(len(route))))
    ends = [PoseStamped(header=HEADER, pose=pose_to_ros(*xy)) for xy in (start, GOAL)]
    roles = {
        'map': ('/alpha_map', occupancy_to_ros(occupancy(hill), 5.0, (0.0, 0.0, 0.0), HEADER)),
        'start': ('/start_pose', ends[0]),
        'goal': ('/goal_pose', ends[1]),
        'path': ('/path', path_to_ros(poses, ends[0].pose, ends[1].pose, HEADER)),
    }
    messages = {
        role: RecordedMessage(topic, _type(message), serialize_message(message), LATCHED, stamp)
        for role, (topic, message) in roles.items()
    }
    entries = metadata_texts(
        inputs={role: topic for role, (topic, _) in roles.items()},
        contents={**{role: message.data for role, message in messages.items()},
                  'strategy': strategy, 'map_changes': changes},
        json_entries={
            'versions': {'python': '3.12.3', 'numpy': '1.26.4'}, 'parameters': parameters(),
            'route_entropy_source': [source(number)],
            'route': [int(node) for node in route],
            'trip': {'start': list(start), 'goal': list(GOAL), 'stops': [], 'tolerance': 0.0},
            'ends': [list(start), list(GOAL)],
            'call': new_route_call(stamp),
        },
        texts={
            'planner_version': '0.1.0', 'service': 'new_route', 'departure': str(number),
            'departure_id': f'00000000-0000-4000-8000-{number:012d}', 'frame': 'map',
        },
    )
    metadata = corrected({**entries, **dict(texts)}) if texts else entries
    files = {'strategy.npz': strategy, 'map_changes.npz': changes}
    return [*messages.values()], metadata, [
        Attachment(name, 'application/zip', data) for name, data in files.items() if data
    ]


def source(number):
    """256 random bits."""
    return int.from_bytes(np.random.default_rng(number).bytes(32), 'big') | 2**255


def corrected(metadata):
    """The hashes of the entries as they are now, unless they are said themselves."""
    try:
        hashes = json.loads(metadata['sha256'])
        for key in ('parameters', 'route_entropy_source', 'route', 'trip', 'ends'):
            hashes[key] = hashlib.sha256(metadata[key].encode()).hexdigest()
    except (ValueError, TypeError):
        return metadata
    return {**metadata, 'sha256': json.dumps(hashes)}


def record(folder, departures):
    """Write departures as one session, whatever is in them, and return their files."""
    folder.mkdir(parents=True, exist_ok=True)
    link, paths = Link(), []
    for k, (messages, metadata, files) in enumerate(departures):
        path = folder / f'run_{k}.mcap'
        chain = {'chain': chain_text(Link(path.name, link.file, link.sha256))}
        path.write_bytes(encoded_departure(messages, {**chain, **metadata}, files, 'zstd'))
        link = Link(path.name, sha256=hashlib.sha256(path.read_bytes()).hexdigest())
        paths.append(path)
    return paths


def drawn(a_plan, count, seed=1):
    rng = np.random.default_rng(seed)
    return [a_plan.strategy.sample_route(rng) for _ in range(count)]


def without(messages, topic):
    return [message for message in messages if message.topic != topic]


def restamped(messages, stamp_ns):
    return [replace(message, stamp_ns=stamp_ns) for message in messages]


def _type(message):
    package, kind = type(message).__module__.split('.')[:2]
    return f'{package}/{kind}/{type(message).__name__}'

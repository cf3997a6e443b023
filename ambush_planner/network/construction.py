# SPDX-License-Identifier: Apache-2.0
"""Construction of a network on a risk map (the paper's section III, table I)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IndexArray
from ..errors import InvalidNetwork, InvalidOption, NoRoute
from ..maps.obstacles import ObstacleField, nearest_free_cell
from ..maps.risk_map import RiskMap
from ..maps.road_file import ROAD_OPTIONS, RoadGraph, read_roads
from ..option_checks import allowed, check_options, length
from .grading import Grading
from .layout import FreeSpace, connect_nodes
from .network import Network
from .node_sampling import SAMPLES
from .passages import MAX_NODE_DISTANCE, pass_nodes, passage_nodes, widest_cell_path
from .road_network import road_length, road_trip_graph, roads_on_map
from .shortest_way import GroundLengths
from .trip_graph import Position, TripGraph, position_errors, position_text

METHODS = ('uniform_delaunay', 'lattice_delaunay', 'uniform_grid8', *SAMPLES, 'graph')


@dataclass(frozen=True, kw_only=True)
class NetworkOptions:
    """Options of the network: sampling, spacing, clearance, or roads.

    Parameters
    ----------
    method
        'uniform_delaunay' (an isotropic lattice), 'lattice_delaunay' (a square lattice, the paper's
        Method 3), 'uniform_grid8' (Method 2), 'random_delaunay' (Method 1), 'gradient_delaunay'
        (the paper's outlook), or 'graph' (the roads of ``graph``).
    spacing
        Distance of lattice nodes [m]; random sampling draws as many nodes as the lattice has. On
        roads, the largest distance between nodes; all junctions and bends are nodes as well.
        None: chosen for about ``target_nodes`` nodes, never below the map's resolution.
    clearance
        Minimum distance of nodes and edges from obstacle cells [m]; 0: they do not touch any.
    clear_of_edge
        Also keep the clearance from the map's outer edge. No node or edge ever touches the edge.
    seed
        Seed of random sampling. It affects node positions, never which route is drawn.
    target_nodes
        Number of nodes to aim for if ``spacing`` is None.
    graph
        Roads for the method 'graph': a file or a GeoDataFrame of lines, as ``read_roads`` takes
        them, or a ``RoadGraph``.
    node_crossings
        Join roads also where they cross without a shared vertex, except at bridges and tunnels.
    road_column, all_lines_are_roads, two_way
        Needed if the columns of a file are not known (``select_roads``): which lines are roads
        (COLUMN=VALUE,VALUE or all), and that all roads are two-way.
    join_distance
        Largest distance of start, stops and goal from the nearest road [m].
    refine
        Maximum number of rounds in which a plan with a reach refines its graded network around the
        ambusher's sites; 0: a plain network. None: until a round gains little, or the network is
        large. Only for 'uniform_delaunay'.

    Raises
    ------
    InvalidOption
        A value is out of range or of another type.
    """

    method: str = allowed('uniform_delaunay', choices=METHODS)
    spacing: float | None = length(None, automatic=0.0)
    clearance: float = length()
    seed: int = allowed(0)
    target_nodes: int = allowed(2500, low=2, high=1_000_000)
    clear_of_edge: bool = allowed(True)
    graph: str | RoadGraph | Any = allowed(None, str, automatic='')
    node_crossings: bool = allowed(False)
    road_column: str = allowed('')
    all_lines_are_roads: bool = allowed(False)
    two_way: bool = allowed(False)
    join_distance: float = length(50.0)
    refine: int | None = allowed(None, int, high=20, automatic=-1)

    def __post_init__(self) -> None:
        check_options(self)
        if self.method == 'graph' and not isinstance(self.graph, RoadGraph):
            given = '' if self.graph is None else self.graph
            object.__setattr__(self, 'graph', read_roads(
                given, **{name: getattr(self, name) for name in ROAD_OPTIONS}))

    @property
    def roads(self) -> RoadGraph | None:
        """The roads of the method 'graph'; None for all others."""
        return self.graph if isinstance(self.graph, RoadGraph) and self.method == 'graph' else None


# Maximum number of lattice nodes; more suggest a mistyped spacing.
MAX_CANDIDATES = 20_000_000
# Distance within which errors name the nearest free place [cells].
HINT_DISTANCE = 50


def build_network(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                  options: NetworkOptions | None = None) -> Network:
    """Build the network for driving from start to goal; positions are in the world frame [m].

    Start and goal are nodes at exactly the given positions; each replaces its nearest lattice node
    or random sample. Every pair of joined nodes gives two directed edges, except into the source
    and out of the target. Where the mesh is too coarse for a narrow passage of the map, nodes are
    added. The same inputs, options and seed give the same network, bit for bit.

    Returns
    -------
    Network
        From the start, its source, to the goal, its target.

    Raises
    ------
    StartBlocked, GoalBlocked
        The position is not finite, off the map, or within the clearance of an obstacle.
    InvalidNetwork
        Start and goal are equal.
    InvalidOption
        The spacing requires more than ``MAX_CANDIDATES`` nodes.
    NoRoute
        No route leads from start to goal.

    Examples
    --------
    >>> import numpy as np
    >>> from ambush_planner import NetworkOptions, RiskMap, build_network
    >>> risk_map = RiskMap(np.ones((12, 24)), np.zeros((12, 24), bool), resolution=1.0)
    >>> network = build_network(risk_map, (2.0, 6.0), (22.0, 6.0), NetworkOptions(spacing=3.0))
    >>> network.points[[network.source, network.target]].tolist()
    [[2.0, 6.0], [22.0, 6.0]]
    """
    return build_trip_graph(risk_map, start_xy, goal_xy, options or NetworkOptions()).networks()[0]


def build_trip_graph(risk_map: RiskMap, start_xy: npt.ArrayLike, goal_xy: npt.ArrayLike,
                     options: NetworkOptions, stops: Iterable[npt.ArrayLike] = (),
                     grading: Grading | None = None) -> TripGraph:
    """Place and join the nodes of a trip's ground; raises as ``build_network``.

    A graded network has nodes in all passes that are wide enough for the clearance, or if it is a
    trip's first one, in those on shortest ways. Its length budgets are multiples of the shortest
    way over the ground.
    """
    field = ObstacleField(risk_map, options.clear_of_edge)
    named_ends = _checked_ends(risk_map, field, [start_xy, *stops, goal_xy], options)
    positions = list(named_ends.values())
    # Distinct positions, start and goal last.
    places = list(dict.fromkeys([positions[-1], *positions[:1], *positions[-2:0:-1]]))[::-1]
    ends = np.array(places)
    uv_ends = risk_map.to_map_axes(ends)
    if options.roads:
        return road_trip_graph(risk_map, field, options.roads, named_ends,
                               chosen_spacing(risk_map, options), options.clearance,
                               options.join_distance)
    space = FreeSpace(risk_map, field, uv_ends, places.index(positions[0]),
                      chosen_spacing(risk_map, options), options, grading)
    passes = np.empty((0, 2))
    if grading:
        passes = pass_nodes(risk_map, field, options.clearance, space.spacing_at)
        passes = passes[field.clear_points(passes, options.clearance)]
    uv, edges, unreachable = connect_nodes(space, passes)
    if len(passes) and unreachable:
        # Triangles of pass nodes can cut the lattice's only way, which matters more.
        passes = passes[:0]
        uv, edges, unreachable = connect_nodes(space, passes)
    if unreachable:
        uv, edges = _add_passage_nodes(space, unreachable)
    refined = grading.refined if grading else None
    ground = GroundLengths(field, options.clearance, uv, edges) if grading else None
    if ground and refined is None and len(passes):
        numbers = [places.index(position) - len(places) for position in positions]
        driven = np.concatenate([ground.way(*pair) for pair in pairwise(numbers)])
        last = len(uv) - len(ends)  # passes come before the ends
        needed = np.isin(np.arange(last - len(passes), last), driven)
        thinned, thinned_edges, unreachable = connect_nodes(space, passes[needed])
        uv, edges = (uv, edges) if unreachable else (thinned, thinned_edges)
    points = risk_map.to_world(uv)
    points[-len(ends):] = ends
    first = len(uv) - len(ends)
    alpha = risk_map.alpha[risk_map.cells(uv)]
    alpha[first:] = 0.0
    visits = tuple(first + places.index(position) for position in positions)
    return TripGraph(points, alpha, edges, visits, None, refined, ground)


def _add_passage_nodes(space: FreeSpace,
                       unreachable: list[int]) -> tuple[FloatArray, IndexArray]:
    """Add nodes in narrow passages on paths over cells from the start to unreachable ends.

    Raises NoRoute if no such path exists or the added nodes do not connect the ends.
    """
    options, nodes = space.options, np.empty((0, 2))
    for end in unreachable:
        path, margin = _cell_path_to(space, end)
        if options.method != 'uniform_grid8':  # a grid has no place for further nodes
            nodes = np.concatenate((nodes, passage_nodes(path, margin, space.spacing)))
            nodes = np.unique(nodes, axis=0)
    nodes = nodes[space.field.clear_points(nodes, options.clearance)]
    uv, edges, unreachable = connect_nodes(space, nodes)
    if not unreachable:
        return uv, edges
    _, margin = _cell_path_to(space, unreachable[0])
    finer = max(float(margin.min()) / MAX_NODE_DISTANCE, space.risk_map.resolution / 2)
    raise NoRoute(
        f'{_no_route_text(space, unreachable[0])} keeps clear of the obstacles at a spacing of '
        f'{space.spacing:g} m; the map has one, which a spacing of '
        f'{min(finer, space.spacing / 2):.3g} m would find'
    )


def _no_route_text(space: FreeSpace, end: int) -> str:
    ends = space.risk_map.to_world(space.uv_ends[[space.start, end]])
    return 'no route from ({:.3f}, {:.3f}) to ({:.3f}, {:.3f})'.format(*ends[0], *ends[1])


def _cell_path_to(space: FreeSpace, end: int) -> tuple[FloatArray, FloatArray]:
    """Widest path over cells from the start to an end, with its margins; raises NoRoute."""
    options, ends = space.options, space.uv_ends[[space.start, end]]
    path, margin = widest_cell_path(space.risk_map, space.field, ends, options.clearance)
    if len(path) == 0:
        clearance = f' at a clearance of {options.clearance:g} m' if options.clearance else ''
        raise NoRoute(
            f'{_no_route_text(space, end)}: obstacles separate them{clearance}; a spacing '
            f'other than {space.spacing:g} m does not help'
        )
    return path, margin


def chosen_spacing(risk_map: RiskMap, options: NetworkOptions) -> float:
    """Return the spacing of the options [m], or one that gives about ``target_nodes`` nodes."""
    spacing, roads = options.spacing, options.roads
    length = road_length(roads_on_map(roads, risk_map)) if roads else 0.0
    if spacing is None:
        free_area = np.count_nonzero(~risk_map.obstacles) * risk_map.resolution**2
        spacing = length / options.target_nodes if roads else math.sqrt(
            free_area / options.target_nodes)
        spacing = max(risk_map.resolution, spacing)
    width, height = risk_map.size
    if (length / spacing if roads else width / spacing * height / spacing) > MAX_CANDIDATES:
        raise InvalidOption(
            f'spacing {spacing} m on a map of {width:g} m x {height:g} m asks for more than '
            f'{MAX_CANDIDATES} nodes; choose a larger spacing'
        )
    return spacing


def _checked_ends(risk_map: RiskMap, field: ObstacleField, given: list[npt.ArrayLike],
                  options: NetworkOptions) -> dict[str, Position]:
    """Check the positions of start, goal and then stops; return them by name, in driving order."""
    last = len(given) - 1
    names = ['start', *(f'stop {k}' for k in range(1, last)), 'goal']
    for k in (0, last, *range(1, last)):
        _check_position(risk_map, field, given[k], names[k], options)
    positions = [(float(x), float(y)) for x, y in np.asarray(given, dtype=np.float64)]
    ends = dict(zip(names, positions, strict=True))
    for (one, a), (other, b) in pairwise(ends.items()):
        if a == b:
            raise InvalidNetwork(f'{one} and {other} are the same position, '
                                 f'({a[0]:.3f}, {a[1]:.3f})')
    return ends


def _check_position(risk_map: RiskMap, field: ObstacleField, xy: npt.ArrayLike, name: str,
                    options: NetworkOptions) -> None:
    off_map, blocked = position_errors(name)
    try:
        position = np.asarray(xy, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as cause:
        raise blocked(f'{name} must be a position (x, y): {cause}') from cause
    if position.shape != (2,):
        raise blocked(f'{name} must be a position (x, y), got shape {position.shape}')
    if not np.isfinite(position).all():
        raise blocked(f'{name} must be finite, got ({position[0]}, {position[1]})')
    where = position_text(name, (position[0], position[1]))
    uv = risk_map.to_map_axes(position)
    if not risk_map.contains(uv):
        (left, bottom), (right, top) = np.round(risk_map.bounds, 3).tolist()
        raise off_map(f'{where} is outside the map, which has x from {left:.10g} to {right:.10g} '
                      f'and y from {bottom:.10g} to {top:.10g} [m]')
    clearance = options.clearance
    if not field.clear_points(uv[None], clearance)[0]:
        edge = " or of the map's edge" if options.clear_of_edge else ''
        near = f' or within the clearance {clearance:g} m of one{edge}' if clearance else ''
        lower = ', or lower the clearance' if clearance else ''
        free = nearest_free_cell(risk_map, (position[0], position[1]),
                                 HINT_DISTANCE * risk_map.resolution, clearance,
                                 options.clear_of_edge)
        place = f' to ({free[0]:.3f}, {free[1]:.3f})' * (tuple(position) != free)
        unknown = risk_map.unknown is not None and risk_map.unknown[risk_map.cells(uv)]
        ground = ('on unknown ground, an obstacle unless map.unknown_alpha gives it a loss'
                  if unknown else f'in an obstacle{near}')
        raise blocked(f'{where} lies {ground}; move it{place}{lower}')

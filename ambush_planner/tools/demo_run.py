"""The demo step by step: real ground, the real node, departures over DDS, pictures, a table."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from nav_msgs.msg import OccupancyGrid

from ..core.construction import NetworkOptions
from ..core.errors import AmbushPlannerError
from ..core.evaluation import energy_efficient_route, evaluate, risk_avoiding_route
from ..core.frontier import frontier
from ..core.game import GameOptions
from ..core.planner import Plan, PlanningOptions, plan
from ..core.risk_map import FloatArray, OccupancyOptions, RiskMap
from ..core.strategy import StrategyOptions
from ..recording.durable import write_durably
from ..ros.conversions import path_from_ros, risk_map_from_ros
from .demo_client import DemoClient, NoAnswer
from .demo_figures import routes_figure, strategy_figure
from .demo_ground import GOAL, RESOLUTION, START, load_ground
from .figures import FixedRoute
from .frontier_run import write_frontier
from .node_process import NodeFailed, NodeProcess, free_domain

# Four cells: about 6000 nodes.
SPACING = 360.0
# Own troops hold the ground around the start and the goal.
SECURED_RADIUS = 2000.0
MAX_DETOUR = 1.3
# What the frontier shows beside them, and the time for each of its strategies.
DETOURS, SLACKS, SWEEP_SECONDS = (1.05, 1.15, MAX_DETOUR, 1.5), (0.03, 0.1, 0.3), 60.0
# The diagnostics give nine digits.
SAME_VALUE = 1e-6


class DemoFailed(Exception):
    """What the demo left is not what it should be."""


FAILURES = (DemoFailed, NodeFailed, NoAnswer, AmbushPlannerError, OSError)


class Progress:
    """Prints what is going on and when it began."""

    def __init__(self) -> None:
        self._begin = time.monotonic()

    @property
    def seconds(self) -> float:
        """Time since the beginning [s]."""
        return time.monotonic() - self._begin

    def say(self, text: str) -> None:
        """Print one line."""
        print(f"{self.seconds:5.1f} s  {text}", flush=True)


def run_demo(folder: Path, departures: int) -> None:
    """Leave recordings, three pictures and the node's log in ``folder``, and print a table.

    Raises
    ------
    DemoFailed, NodeFailed, NoAnswer, AmbushPlannerError, OSError
        What went wrong, in words for the user.
    """
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    before = set(folder.rglob("*.mcap"))
    progress = Progress()
    progress.say("making the risk map from the elevation model")
    values = load_ground().values
    grid, paths, status, seconds = _departures(values, folder, departures, progress)
    recordings = sorted(set(folder.rglob("*.mcap")) - before)
    if len(recordings) != departures:
        raise DemoFailed(f"{departures} departures left {len(recordings)} recordings in {folder}")
    progress.say("planning again here, for the pictures, and comparing with the node")
    risk_map = risk_map_from_ros(grid, OccupancyOptions())
    planned = _same_plan(risk_map, status)
    progress.say("drawing strategy.png and routes.png")
    _draw(risk_map, planned, paths, folder)
    progress.say("frontier.png: what another length budget, or more risk, would buy")
    _sweep(planned, folder)
    progress.say("done")
    print(table(status, planned, paths, [*seconds, progress.seconds]))
    print(f"\n{folder}: strategy.png, routes.png, frontier.png, frontier.csv, node.log and the "
          "recordings")
    for recording in recordings:
        print(f"  {recording.relative_to(folder)}")


def _departures(
    values: np.ndarray, folder: Path, count: int, progress: Progress
) -> tuple[OccupancyGrid, list[FloatArray], dict[str, str], list[float]]:
    """Return the map's message, paths (L, 3), last diagnostics, and each departure's seconds."""
    # Read by the middleware in this process, and inherited by the node's.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    domain = free_domain()
    progress.say(f"starting the node in ROS domain {domain}")
    node = NodeProcess(_node_parameters(folder), domain, folder / "node.log")
    with node, DemoClient(domain, node.check) as client:
        client.wait_for_node()
        rows, columns = values.shape
        progress.say(f"publishing the map ({columns} x {rows} cells), start and goal")
        grid = client.publish_inputs(values, RESOLUTION, START, GOAL)
        paths, seconds = [], []
        for k in range(count):
            progress.say(f"departure {k + 1} of {count}" + (": solving the game" * (k == 0)))
            begin = time.monotonic()
            paths.append(path_from_ros(client.depart()))
            seconds.append(time.monotonic() - begin)
        status = client.status_after(count)
        progress.say("stopping the node")
    progress.say(f"the node ended with exit code 0 after {node.seconds_to_stop:.1f} s")
    return grid, paths, status, seconds


def _node_parameters(folder: Path) -> dict[str, object]:
    return {
        "network.spacing": SPACING,
        "game.secured_radius": SECURED_RADIUS,
        "strategy.max_detour": MAX_DETOUR,
        "recording.enabled": True,
        "recording.directory": str(folder),
    }


def _same_plan(risk_map: RiskMap, status: Mapping[str, str]) -> Plan:
    """Plan on the same map with the same options: same inputs, same network and value."""
    options = PlanningOptions(
        NetworkOptions(spacing=SPACING),
        GameOptions(secured_radius=SECURED_RADIUS),
        StrategyOptions(max_detour=MAX_DETOUR),
    )
    planned = plan(risk_map, START, GOAL, options)
    for name in ("value", "edge_entropy", "route_entropy", "expected_length"):
        theirs, ours = float(status[name]), float(getattr(planned.strategy, name))
        if abs(theirs - ours) > SAME_VALUE * abs(ours):
            raise DemoFailed(f"{name}: the node says {theirs}, planning again gives {ours}")
    return planned


def _draw(
    risk_map: RiskMap, planned: Plan, paths: Sequence[FloatArray], folder: Path
) -> None:
    _save(strategy_figure(risk_map, planned, SECURED_RADIUS), folder / "strategy.png")
    routes = [path[:, :2] for path in paths]
    figure = routes_figure(risk_map, planned, routes, fixed_routes(planned), SECURED_RADIUS)
    _save(figure, folder / "routes.png")


def _sweep(planned: Plan, folder: Path) -> None:
    """Other budgets on the same network, to choose by looking."""
    options = StrategyOptions(max_detour=MAX_DETOUR, time_limit=SWEEP_SECONDS)
    rows = frontier(
        planned.network, GameOptions(secured_radius=SECURED_RADIUS), DETOURS, SLACKS, options
    )
    write_frontier(folder / "frontier.csv", rows, options.max_detour, options.risk_slack)


def _save(figure: Figure, path: Path) -> None:
    """Write a picture (mode 0600): it shows secret routes."""
    stream = BytesIO()
    figure.savefig(stream, format="png")
    write_durably(path, stream.getvalue())


def fixed_routes(planned: Plan) -> list[FixedRoute]:
    """The shortest and the safest route, each with its worst ambush, once it is known."""
    game, points = planned.strategy.game, planned.network.points
    measures = evaluate(planned.strategy)
    routes = []
    for name, row, route in (
        ("shortest route", measures["energy_efficient"], energy_efficient_route(game)),
        ("safest route", measures["risk_avoidance"], risk_avoiding_route(game)),
    ):
        worst = route[np.argmax(game.loss[route])]
        label = f"{name} ({row.expected_length / 1000:.1f} km, loss {row.v_repeated:.2f})"
        routes.append(FixedRoute(label, points[route], points[worst]))
    return routes


def table(
    status: Mapping[str, str], planned: Plan, paths: Sequence[FloatArray], seconds: Sequence[float]
) -> str:
    """What the node says about its strategy, and how the departures went.

    ``seconds``: of each departure, and last of the whole demo.
    """
    known = {name: float(status[name]) for name in ("value", "lower_bound", "gap", "edge_entropy",
             "route_entropy", "expected_length", "shortest_length", "solve_seconds")}
    measures = evaluate(planned.strategy)
    length, shortest = known["expected_length"] / 1000, known["shortest_length"] / 1000
    *each, total = seconds
    later = f", {1000 * float(np.median(each[1:])):.0f} ms a further departure" * (len(each) > 1)
    rows = [
        ("value", f"{known['value']:.6f}", "mean loss by the best ambush, the strategy known"),
        ("lower bound", f"{known['lower_bound']:.6f}", "no strategy of this length has less"),
        ("gap", f"{known['gap']:.1e}", ""),
        ("fixed shortest route", f"{measures['energy_efficient'].v_repeated:.2f}",
         "loss once it is known"),
        ("fixed safest route", f"{measures['risk_avoidance'].v_repeated:.2f}",
         "loss once it is known"),
        ("edge entropy", f"{known['edge_entropy']:.1f}", "nats"),
        ("route entropy", f"{known['route_entropy']:.1f}", "nats"),
        ("expected length", f"{length:.1f} km",
         f"{length / shortest:.2f} times the shortest, {shortest:.1f} km"),
        ("network", f"{status['nodes']} nodes", f"{status['edges']} edges"),
        ("different routes", f"{count_different(paths)} of {len(paths)}", ""),
        ("seconds", f"{total:.1f}", f"{known['solve_seconds']:.1f} to plan{later}"),
    ]
    return "\n" + "\n".join(f"{a:<21} {b:>12}   {c}".rstrip() for a, b, c in rows)


def count_different(paths: Sequence[FloatArray]) -> int:
    """Number of paths (L, 3) that no earlier one equals."""
    return len({np.ascontiguousarray(path).tobytes() for path in paths})

# SPDX-License-Identifier: Apache-2.0
"""The paper's figures 2 to 7, and our strategies in the same style."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch
from scipy.sparse import csr_matrix

from ambush_planner.arrays import FloatArray
from ambush_planner.figures import PROBABILITY, draw_ends, draw_segments, probability_scale
from ambush_planner.game.strategy import Strategy
from ambush_planner.map_figures import LOSS, OBSTACLE, WIDTH, draw_risk_map, draw_scale_bar, frame
from ambush_planner.maps.risk_map import RiskMap

from .environment import EXAMPLE, METHODS, SECURED_RADIUS, SPACING
from .report import NAMES
from .results import METHOD_3, SECURED, SOLVERS, WEIGHTED, Results, Say

# Share of the busiest square's visits below which a square gets no arrow.
MIN_SHARE = 2e-3

DOTS_PER_INCH = 190
SITES = Line2D([], [], linestyle='none', marker='s', markersize=8, color='white',
               markeredgecolor='black', label='ambush site')
LEGEND = {'loc': 'outside lower center', 'ncols': 2, 'frameon': False}
CONNECTIVITY = {
    'Method 1': 'random samples, Delaunay triangulation',
    'Method 2': 'lattice, 8-connected',
    'Method 3': 'lattice, Delaunay triangulation',
}
# Thresholds of figure 7: a moderate one, and one with a bottleneck.
SHOWN_THRESHOLDS = (7.0, 5.0)


def draw_all(results: Results, folder: Path, say: Say) -> None:
    """Write every figure into the folder."""
    for name, figure in (
        ('figure_2_interior_point', _example(results, 'interior_point', 'interior point')),
        ('figure_3_interior_point', _methods(results, 'interior_point', 'interior point')),
        ('figure_4_simplex', _example(results, 'simplex', 'simplex')),
        ('figure_5_simplex', _methods(results, 'simplex', 'simplex')),
        ('figure_6_energy', _energy(results)),
        ('figure_7_threshold', _thresholds(results)),
        ('figure_ours', _methods(results, 'max_entropy', 'max_entropy')),
        ('figure_ours_secured_area', _secured_area(results)),
        ('figure_solvers', _solvers(results)),
    ):
        say(f'drawing {name}.png')
        figure.savefig(folder / f'{name}.png', bbox_inches='tight', pad_inches=0.12)


def _methods(results: Results, solver: str, name: str) -> Figure:
    rows = [
        (f'{method}, {name}\n{CONNECTIVITY[method]}', results.strategies[method, solver])
        for method in METHODS
    ]
    return _rows(results.risk_map, rows)


def _solvers(results: Results) -> Figure:
    """Figure 3 c, figure 5 c and our own strategy below each other."""
    rows = [(f'{METHOD_3}: {NAMES[s]}', results.strategies[METHOD_3, s]) for s in SOLVERS]
    return _rows(results.risk_map, rows)


def _energy(results: Results) -> Figure:
    title = f'{METHOD_3}, interior point\n0.99 z + 0.01 E minimised'
    return _rows(results.risk_map, [(title, results.variants[WEIGHTED])])


def _secured_area(results: Results) -> Figure:
    title = f'{METHOD_3}, max_entropy\nsecured area: {SECURED_RADIUS:g} m around the ends'
    figure = _rows(results.risk_map, [(title, results.variants[SECURED])])
    _draw_sites(figure.axes[0], results.variants[SECURED])
    figure.legend(handles=[OBSTACLE, SITES], **LEGEND)
    return figure


def _thresholds(results: Results) -> Figure:
    """A row for each threshold: the whole map, and the goal with the ambush sites."""
    strategies = [results.thresholds[threshold] for threshold in SHOWN_THRESHOLDS]
    figure, axes, scale = _panels(strategies)
    for panels, threshold, strategy in zip(axes, SHOWN_THRESHOLDS, strategies, strict=True):
        titles = (
            f'Nodes with alpha over {threshold:g} discarded\nvalue {strategy.value:.2f}',
            'around the goal',
        )
        for panel, title in zip(panels, titles, strict=True):
            frame(panel, results.risk_map, title)
            risk = draw_risk_map(panel, results.risk_map)
            lines = _draw_uses(panel, strategy, scale)
            _draw_sites(panel, strategy)
            draw_ends(panel, strategy.as_trip)
            if panel is panels[1]:
                panel.set(xlim=(22.0, 31.0), ylim=(7.0, 16.0))
            draw_scale_bar(panel)
    _scales(figure, axes, lines, risk)
    figure.legend(handles=[OBSTACLE, SITES], **LEGEND)
    return figure


def _rows(risk_map: RiskMap, rows: Sequence[tuple[str, Strategy]]) -> Figure:
    """A row for each strategy: expected uses of each edge, and the mean direction."""
    figure, axes, scale = _panels([strategy for _, strategy in rows])
    for (left, right), (title, strategy) in zip(axes, rows, strict=True):
        frame(left, risk_map, title)
        frame(right, risk_map, 'mean direction')
        lines = _draw_uses(left, strategy, scale)
        draw_mean_direction(right, _without_two_way_traffic(strategy), SPACING)
        for panel in (left, right):
            risk = draw_risk_map(panel, risk_map)
            draw_ends(panel, strategy.as_trip)
            draw_scale_bar(panel)
    _scales(figure, axes, lines, risk)
    return figure


def _panels(strategies: Sequence[Strategy]) -> tuple[Figure, np.ndarray, LogNorm]:
    """A figure, a row of two panels for each strategy, and one colour scale for all."""
    rows = len(strategies)
    figure = Figure((WIDTH, 3.7 * rows + 1.2), dpi=DOTS_PER_INCH, layout='compressed')
    scale = probability_scale(np.concatenate([each.edge_probability for each in strategies]))
    return figure, figure.subplots(rows, 2, squeeze=False), scale


def _scales(figure: Figure, axes: np.ndarray, lines: LineCollection, risk: AxesImage) -> None:
    """The two colour scales below the panels."""
    layout = {'location': 'bottom', 'pad': 0.02, 'aspect': 30, 'shrink': 0.9}
    figure.colorbar(lines, ax=axes[:, 0], label='expected uses of each edge', format='%g', **layout)
    figure.colorbar(risk, ax=axes[:, 1], label=LOSS, **layout)


def _draw_uses(axes: Axes, strategy: Strategy, scale: LogNorm) -> LineCollection:
    segments = strategy.network.points[strategy.network.edges]
    return draw_segments(axes, segments, strategy.edge_probability, scale, (0.3, 3.2))


def _without_two_way_traffic(strategy: Strategy) -> Strategy:
    """Cancel opposite traffic on the same edge.

    Solutions of the linear programs use most edges in both directions. The mean direction of all
    traffic would show the network's asymmetry; that of the net traffic shows the journey.
    """
    network, p = strategy.network, strategy.edge_probability
    uses = csr_matrix((p, network.edges.T), shape=(len(network.points),) * 2)
    back = np.asarray(uses[network.heads, network.tails]).ravel()
    return replace(strategy, edge_probability=np.maximum(p - back, 0.0))


def _draw_sites(axes: Axes, strategy: Strategy) -> None:
    """The paper's little white squares."""
    q = strategy.ambush_probability
    sites = strategy.network.points[q > 1e-3 * q.max()]
    axes.scatter(*sites.T, s=60, marker='s', color='white', edgecolors='black', zorder=9)


def _example(results: Results, solver: str, name: str) -> Figure:
    """The 8-node network; wider arrows are likelier edges, dotted ones are unused."""
    strategy = results.strategies[EXAMPLE, solver]
    network = strategy.network
    figure = Figure(figsize=(WIDTH, 4.2), dpi=DOTS_PER_INCH, layout='constrained')
    axes = figure.subplots()
    for (tail, head), p in zip(network.edges, strategy.edge_probability, strict=True):
        _draw_arrow(axes, network.points[tail], network.points[head], float(p))
    axes.scatter(*network.points.T, s=620, color='white', edgecolors='black', zorder=3)
    for node, x in enumerate(strategy.visit_probability):
        label = {network.source: 'A', network.target: 'B'}.get(node, f'{x:.2f}')
        axes.annotate(label, network.points[node], ha='center', va='center', fontsize=9, zorder=4)
    axes.set(xlim=(-0.25, 3.25), ylim=(-0.3, 2.3), aspect='equal')
    axes.set_axis_off()
    axes.set_title(
        f'8 nodes, {name}: edge entropy {strategy.edge_entropy:.2f}\n'
        'numbers: expected uses of each edge and node',
        fontsize='medium',
    )
    return figure


def _draw_arrow(axes: Axes, tail: np.ndarray, head: np.ndarray, p: float) -> None:
    used = p > 1e-6
    axes.add_patch(FancyArrowPatch(
        tail,
        head,
        arrowstyle='-|>',
        mutation_scale=10.0 + 25.0 * p,
        linewidth=0.8 + 16.0 * p if used else 0.8,
        linestyle='-' if used else ':',
        color=PROBABILITY(0.25 + 2.0 * p) if used else '0.6',
        shrinkA=13.0,
        shrinkB=13.0,
        zorder=2 if used else 1,
    ))
    if used:
        x, y = tail + 0.36 * (head - tail)
        axes.annotate(f'{p:.2f}', (x, y), ha='center', va='center', fontsize=9, zorder=5,
                      bbox={'boxstyle': 'round,pad=0.15', 'color': 'white', 'alpha': 0.85})


def binned_directions(
    points: FloatArray, direction: FloatArray, weight: FloatArray, size: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Average mean directions over squares of edge ``size`` [m].

    Returns, for each square with weight, the centre of weight (K, 2), the weighted mean direction
    (K, 2) and the weight relative to the largest (K,).
    """
    used = weight > 0.0
    points, direction, weight = points[used], direction[used], weight[used]
    if len(points) == 0:
        return np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
    square = np.floor(points / size).astype(np.int64)
    _, index = np.unique(square, axis=0, return_inverse=True)
    index = index.reshape(-1)
    total = np.bincount(index, weights=weight)

    def mean(values: FloatArray) -> FloatArray:
        sums = [np.bincount(index, weights=weight * column) for column in values.T]
        return np.stack(sums, axis=1) / total[:, None]

    return mean(points), mean(direction), total / total.max()


def draw_mean_direction(axes: Axes, strategy: Strategy, size: float) -> None:
    """Draw the mean direction of travel in squares of edge ``size`` [m].

    Long arrows mean a certain direction, dark ones many visits.
    """
    places, directions, share = binned_directions(
        strategy.network.points, strategy.mean_direction(), strategy.visit_probability, size
    )
    shown = share >= MIN_SHARE
    often = LogNorm(5.0 * MIN_SHARE, 1.0, clip=True)(share)
    axes.quiver(
        *places[shown].T,
        *(directions[shown] * size * 1.15).T,
        np.asarray(often)[shown],
        cmap=PROBABILITY,
        clim=(0.0, 1.0),
        angles='xy',
        scale_units='xy',
        scale=1.0,
        pivot='mid',
        units='xy',
        width=size * 0.13,
        headwidth=3.6,
        headlength=3.6,
        headaxislength=3.2,
        zorder=3,
    )

"""The audit's picture: where the convoy should have driven and where it did, order, learning."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from scipy.special import bdtr

from ..maps.risk_map import RiskMap
from ..recordings.audit_departures import Audit
from ..recordings.audit_learning import LEARNT
from .figures import (
    AMBUSHER,
    draw_risk_map,
    draw_segments,
    frame,
    probability_scale,
)

# Height of the comparisons below the maps [inches].
PLOTS = 4.6
DRAWN, BAND = '#1146b0', '#c9d8ee'
# This part of the dots lies in the band.
INSIDE = 0.99
PERCENT = FuncFormatter(lambda share, _: f'{100.0 * share:.3g} %')
PERCENTS = (0.0, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 1.0)


def audit_figure(risk_map: RiskMap, audit: Audit) -> Figure:
    """Above: published beside recorded frequencies, on the latest map. Below: comparisons."""
    width, height = risk_map.size
    high = float(np.clip(7.0 * height / width, 2.5, 12.0)) + 1.6
    figure = Figure(figsize=(15.0, high + PLOTS), layout='constrained')
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.1)
    maps, plots = figure.subfigures(2, 1, height_ratios=(high, PLOTS))
    published, recorded = maps.subplots(1, 2)
    expected, driven = audit.expected / audit.departures, audit.passages / audit.departures
    scale = probability_scale(expected)
    for axes, probability, title in (
        (published, expected, 'Published: how likely the convoy drives where'),
        (recorded, driven, f'Recorded: how often it did, of {audit.departures} departures'),
    ):
        frame(axes, risk_map, title)
        draw_risk_map(axes, risk_map)
        edges = draw_segments(axes, audit.segments, probability, scale)
    maps.colorbar(
        edges,
        ax=[published, recorded],
        location='bottom',
        label='share of the departures that drive here',
        format=PERCENT,
        shrink=0.5,
        aspect=50,
    )
    frequency, order, learning = plots.subplots(1, 3)
    draw_frequencies(frequency, expected, audit)
    draw_order(order, audit)
    draw_learning(learning, audit)
    return figure


def draw_frequencies(axes: Axes, probability: np.ndarray, audit: Audit) -> None:
    """Draw each edge as a dot: published probability across, share driven up; with a band."""
    n = audit.departures
    shown = (probability > 0.0) | (audit.passages > 0)
    largest = min(1.0, float(probability.max()) * 1.1)
    across = np.linspace(0.0, np.sqrt(largest), 400) ** 2
    low, high = (quantile(q, n, across) / n for q in (0.5 - 0.5 * INSIDE, 0.5 + 0.5 * INSIDE))
    band = f'{INSIDE:.0%} of the dots belong here'
    axes.fill_between(across, low, high, color=BAND, linewidth=0.0, label=band)
    axes.plot(across, across, color='grey', linewidth=1.0)
    axes.scatter(probability[shown], audit.passages[shown] / n, s=9, color=DRAWN, alpha=0.5,
                 linewidths=0.0, label='a stretch of the way', zorder=3)
    for axis, set_scale, limit in (
        (axes.xaxis, axes.set_xscale, axes.set_xlim),
        (axes.yaxis, axes.set_yscale, axes.set_ylim),
    ):
        # Roots spread the many small shares and keep 0.
        set_scale('function', functions=(lambda x: np.sqrt(np.maximum(x, 0.0)), np.square))
        axis.set_ticks([tick for tick in PERCENTS if tick <= 1.0])
        axis.set_major_formatter(PERCENT)
        limit(0.0, None)
    axes.set_xlim(0.0, largest)
    axes.set_ylim(0.0, min(1.0, max(float(high.max()), audit.passages.max() / n) * 1.15))
    axes.set_xlabel('published probability')
    axes.set_ylabel('share of the departures')
    _finish(axes, 'Is each stretch driven as often as published?', 'upper left')


def quantile(q: float, n: int, probability: np.ndarray) -> np.ndarray:
    """How many of ``n`` there are at most with a chance of ``q``; scipy.stats is slow to import."""
    return (bdtr(np.arange(n)[:, None], n, probability) < q).sum(axis=0)


def draw_order(axes: Axes, audit: Audit) -> None:
    """Draw the ground that departures k apart share, and what chance allows."""
    order = audit.order
    lags = np.arange(1, len(order.by_lag) + 1)
    # The share of all departures is for the other tests: the band goes with it.
    centre = order.expected - order.expected.mean() + order.mean
    axes.fill_between(lags, centre - order.band, centre + order.band, color=BAND,
                      linewidth=0.0, label='chance leaves this once in 100 times')
    axes.plot(lags, centre, color='grey', linewidth=1.0)
    axes.plot(lags, order.by_lag, 'o-', color=DRAWN, label='recorded')
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.yaxis.set_major_formatter(PERCENT)
    axes.set_xlabel('departures apart (1: the next one)')
    axes.set_ylabel('ground that both cross')
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.25 * (high - low))
    _finish(axes, 'Do routes follow a rhythm?', 'upper left')


def draw_learning(axes: Axes, audit: Audit) -> None:
    """Draw what watching so many departures brings an ambusher."""
    learning = audit.learning
    count = np.arange(1, audit.departures + 1)
    axes.axhline(learning.fixed_loss, color='black', linestyle='--', linewidth=1.6,
                 label='if the same route were driven every time')
    axes.axhline(learning.value, color='grey', linewidth=1.6,
                 label='if he knew the whole strategy')
    axes.plot(count, learning.loss_after, color=AMBUSHER, linewidth=2.0, drawstyle='steps-post',
              label='after watching so many departures')
    axes.set_ylim(0.0, max(learning.fixed_loss, learning.value, LEARNT) * 1.45)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel('departures watched')
    axes.set_ylabel('mean loss by his best ambush')
    _finish(axes, 'What does an observer gain?', 'upper left')


def _finish(axes: Axes, title: str, place: str) -> None:
    axes.set_title(title, loc='left', fontsize='large')
    axes.legend(loc=place, fontsize='small', framealpha=0.9)
    axes.spines[['top', 'right']].set_visible(False)

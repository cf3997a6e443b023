# SPDX-License-Identifier: Apache-2.0
"""The picture of a report's map, for browsers, printers and previews that run no scripts."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure

from .. import figures, map_figures
from ..colours import ROUTES
from ..recordings.report_data import Section

# Width [inches], and dots per inch.
WIDTH, DOTS_PER_INCH = 7.5, 120
# Share of the picture that the map takes; the script leaves the same margin.
FILLED = 0.97


def map_picture(section: Section, ratio: float) -> bytes:
    """Draw map, strategy and routes as a JPEG file whose width is ``ratio`` times its height."""
    trip, risk_map = section.trip, section.risk_map
    figure = Figure((WIDTH, WIDTH / ratio))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    low, high = risk_map.bounds
    height = max(high[1] - low[1], (high[0] - low[0]) / ratio) / FILLED
    middle, half = (low + high) / 2.0, (height * ratio / 2.0, height / 2.0)
    axes.set(xlim=(middle[0] - half[0], middle[0] + half[0]),
             ylim=(middle[1] - half[1], middle[1] + half[1]))
    axes.set_axis_off()
    map_figures.draw_risk_map(axes, risk_map)
    figures.draw_network(axes, trip)
    paths = [each.path_poses[:, :2] for each in section.departures]
    for path in paths[: -len(ROUTES)]:
        axes.plot(*path.T, color=ROUTES[0], linewidth=0.8, zorder=3)
    first = max(len(paths) - len(ROUTES), 0)
    figures.draw_stripes(axes, paths[first:], [
        {'color': ROUTES[k % len(ROUTES)], 'path_effects': map_figures.HALO}
        for k in range(first, len(paths))])
    if trip.value > 0.0:
        figures.draw_sites(axes, trip)
    figures.draw_ends(axes, trip)
    map_figures.draw_scale_bar(axes, figures.places_of(trip))
    stream = BytesIO()
    figure.savefig(stream, format='jpeg', dpi=DOTS_PER_INCH, pil_kwargs={'quality': 80})
    return stream.getvalue()

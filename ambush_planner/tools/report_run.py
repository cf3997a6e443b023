"""The report step by step: read, draw, put the page together, write it."""

from __future__ import annotations

from pathlib import Path

from ..review.departures import Campaign
from .audit_files import read_all, refuse_existing, say, write_private
from .report_figures import as_png, ground_figure, routes_figure, strategy_figure
from .report_page import page

PAGE = "report.html"


def run_report(place: Path, output: Path, replace: bool) -> bool:
    """Write the page for the recordings that ``place`` stands for; print where it is.

    Returns whether every recording could be read; the page is of those that could.

    Raises
    ------
    AmbushPlannerError, OSError
        What went wrong, in words for the user.
    """
    refuse_existing(output, [PAGE], replace)
    campaigns, unreadable = read_all(place)
    for error in unreadable:
        say(f"ambush_report: {error}")
    if not campaigns:
        say("ambush_report: no recording could be read, so there is no report")
        return False
    drawn = [(campaign, _pictures(campaign)) for campaign in campaigns]
    html = page(drawn, len(unreadable))
    write_private(output, {PAGE: html.encode()})
    print(f"{output / PAGE}\nIt shows secret routes; only this user can read it.")
    return not unreadable


def _pictures(campaign: Campaign) -> list[bytes]:
    say(f"drawing strategy {campaign.sha256[:8]} and its {len(campaign.departures)} departures")
    risk_map, strategy = campaign.risk_map, campaign.strategy
    secured = campaign.departures[0].parameters.planning.game.secured_radius
    routes = [strategy.network.points[record.route] for record in campaign.departures]
    figures = (
        ground_figure(risk_map, strategy, secured),
        strategy_figure(risk_map, strategy, secured),
        routes_figure(risk_map, strategy, routes, secured),
    )
    return [as_png(figure) for figure in figures]

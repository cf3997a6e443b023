"""The audit step by step: read, test strategy by strategy, draw, write, tell."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from textwrap import fill

from ..core.audit import FEWEST_DEPARTURES, Audit, audit
from ..core.audit_draws import NotAuditable, recorded_steps
from ..review.departures import Campaign
from .audit_figures import audit_figure
from .audit_files import read_all, refuse_existing, say, write_private
from .audit_text import findings, impossible_steps, learning_lines, passages_csv, table, title
from .report_figures import as_png

TEXT, NUMBERS = "audit.txt", "audit.csv"
COLUMNS = 100
HEAD = ("strategy", "departures", "check", "recorded", "by_chance", "p_value", "finding")


@dataclass(frozen=True, eq=False)
class Audited:
    """One strategy's departures, and what came out: an audit, or why there is none."""

    campaign: Campaign
    name: str  # Its files' names begin with it.
    audit: Audit | None
    reason: str = ""
    impossible: bool = False

    @property
    def suspicious(self) -> bool:
        """Whether there is a finding, or there could be none."""
        if self.audit is None:
            return self.impossible
        return self.audit.blind or bool(self.audit.findings)


def run_audit(place: Path, output: Path, rate: float, replace: bool) -> bool:
    """Audit all recordings below ``place``; print and write the result.

    Returns whether all could be read and audited, or are too few to tell, and nothing was found.

    Raises
    ------
    AmbushPlannerError, OSError
        What went wrong, in words for the user.
    """
    campaigns, unreadable = read_all(place)
    # The rate holds for the whole folder: an equal part for each strategy.
    enough = [c for c in campaigns if len(c.departures) >= FEWEST_DEPARTURES]
    names = _names(campaigns)
    files = [
        f"{name}{end}" for name, campaign in zip(names, campaigns, strict=True)
        if campaign in enough for end in (".png", "_passages.csv")
    ]
    refuse_existing(output, [TEXT, NUMBERS, *files], replace)
    audited = [
        _audited(campaign, name, rate / len(enough))
        if campaign in enough
        else _too_few(campaign, name)
        for name, campaign in zip(names, campaigns, strict=True)
    ]
    texts = ["\n".join(_lines(each)) for each in audited]
    if len(enough) > 1:
        texts.append(f"All strategies together: at most {100.0 * rate:g} % of audits.")
    texts += [f"UNREADABLE, and no part of the audit: {error}" for error in unreadable]
    text = "\n\n\n".join(texts)
    # Names of unreadable files need not be UTF-8.
    data = f"{text}\n".encode(errors="backslashreplace")
    write_private(output, {TEXT: data, NUMBERS: _numbers(audited).encode()})
    pictures = [each for each in audited if each.audit is not None]
    for each in pictures:
        write_private(output, _details(each, each.audit))
    more = ", pictures and passages" if pictures else ""
    print(f"{text}\n\nIn {output}: {TEXT}, {NUMBERS}{more}. They are secret.")
    failed = unreadable or not campaigns
    refused = any(each.audit is None and each.campaign in enough for each in audited)
    return not (failed or refused or any(each.suspicious for each in audited))


def _audited(campaign: Campaign, name: str, rate: float) -> Audited:
    say(f"auditing {len(campaign.departures)} departures of strategy {campaign.sha256[:8]}")
    strategy = campaign.strategy
    routes = [departure.route for departure in campaign.departures]
    try:
        result = audit(strategy.game, strategy.edge_probability, routes, rate)
    except NotAuditable as error:
        return Audited(campaign, name, None, f"Not audited: {error}.")
    return Audited(campaign, name, result)


def _too_few(campaign: Campaign, name: str) -> Audited:
    """What can be said of any number of departures: whether they can have been drawn at all."""
    strategy = campaign.strategy
    routes = [departure.route for departure in campaign.departures]
    _, impossible = recorded_steps(strategy.network, strategy.edge_probability, routes)
    reason = f"Too few to tell: at least {FEWEST_DEPARTURES} are needed."
    if impossible:
        reason = f"FINDING (impossible): {impossible_steps(impossible)}\n{reason}"
    return Audited(campaign, name, None, reason, impossible > 0)


def _lines(audited: Audited) -> list[str]:
    lines = [f"{title(audited.campaign)} ({audited.name})", ""]
    if audited.audit is None:
        return [*lines, audited.reason]
    strategy = audited.campaign.strategy
    said = [*findings(audited.audit, strategy), "", *learning_lines(audited.audit, strategy)]
    return [*lines, table(audited.audit), "", *(fill(line, COLUMNS) for line in said)]


def _details(audited: Audited, result: Audit) -> dict[str, bytes]:
    say(f"drawing strategy {audited.campaign.sha256[:8]}")
    campaign = audited.campaign
    figure = audit_figure(campaign.risk_map, campaign.strategy, result)
    return {
        f"{audited.name}.png": as_png(figure),
        f"{audited.name}_passages.csv": passages_csv(result, campaign.strategy).encode(),
    }


def _numbers(audited: Sequence[Audited]) -> str:
    stream = StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(HEAD)
    for each in audited:
        if each.audit is None:
            continue
        begin = each.campaign.sha256, each.audit.departures
        impossible = each.audit.impossible
        writer.writerow((*begin, "impossible", impossible, 0, "", impossible > 0))
        for name, verdict in each.audit.tests.items():
            writer.writerow((
                *begin, name, f"{verdict.observed:.9g}", f"{verdict.expected:.9g}",
                f"{verdict.p_value:.9g}", verdict.finding,
            ))
    return stream.getvalue()


def _names(campaigns: Sequence[Campaign]) -> list[str]:
    """Begins of file names; one strategy with several sets of options gets running numbers."""
    taken: Counter[str] = Counter()
    names = []
    for begin in (f"audit_{campaign.sha256[:8]}" for campaign in campaigns):
        taken[begin] += 1
        names.append(begin if taken[begin] == 1 else f"{begin}_{taken[begin]}")
    return names

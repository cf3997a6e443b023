"""What `solver.py` measured, as Markdown: ratios first, then seconds, then whether all agree."""

from __future__ import annotations

from typing import Any

from report import table

Answers = dict[str, dict[str, Any]]
Measured = dict[int, Answers]

# (ours, other, title, {nodes across: times faster to reach}).
COMPARISONS = (
    ("strategy", "interior_point", "strategy : HiGHS interior point, value alone",
     {100: 3.0, 200: 8.0}),
    ("strategy", "conic", "strategy : Clarabel, the same entropy problem", {100: 2.5, 200: 2.5}),
    ("strategy", "interior_point_budget",
     "strategy : HiGHS interior point, value alone, with the length budget", {}),
    ("value", "simplex", "value by cut : HiGHS dual simplex", {200: 300.0}),
    ("value", "interior_point", "value by cut : HiGHS interior point", {200: 300.0}),
)
# Seconds for the network of a million candidate points.
NETWORK_TARGET = 10.0

# Called so, an answer is as good as the solver was asked for.
FULLY_SOLVED = ("Optimal", "Solved")
NOT_MET = "**no**"

TASK_TITLES = {
    "build": "network",
    "value": "value by cut",
    "strategy": "**strategy, all stages**",
    "simplex": "HiGHS dual simplex, value within the length budget",
    "interior_point": "HiGHS interior point without crossover, value",
    "interior_point_budget": "the same, value within the length budget",
    "conic": "Clarabel, entropy",
}


def report(measured: Measured, network: dict[str, Any], conditions: str) -> str:
    """All tables and the conditions they were measured under."""
    sections = (
        ("How many times faster", ratios(measured)),
        ("Targets", targets(measured, network)),
        ("Processor seconds (peak memory of the process in MB)", seconds(measured)),
        ("Sizes and iterations", sizes(measured)),
        ("The answers agree", answers(measured)),
    )
    text = "\n\n".join(f"### {title}\n\n{content}" for title, content in sections)
    return f"One thread for every solver, medians of processor seconds. {conditions}.\n\n{text}"


def ratios(measured: Measured) -> str:
    """A row a comparison, a column a size."""
    rows = [
        [title] + [f"**{_ratio(size[ours], size[other])}**" for size in measured.values()]
        for ours, other, title, _ in COMPARISONS
    ]
    return table(_head("times", measured), rows)


def targets(measured: Measured, network: dict[str, Any]) -> str:
    """What was to be reached, what was, and whether that will do."""
    rows = []
    for ours, other, title, wanted in COMPARISONS:
        for nodes in wanted.keys() & measured.keys():
            size = measured[nodes]
            rows.append(
                [f"{title}, {nodes} across", f"{wanted[nodes]:g}x", _ratio(size[ours], size[other]),
                 _met(size[ours], size[other], wanted[nodes])]
            )
    points = f"{network['nodes']} nodes, {network['edges']} edges left"
    rows.append(
        [f"network of a million candidate points ({points})", f"< {NETWORK_TARGET:g} s",
         f"{network['seconds']:.1f} s", "yes" if network["seconds"] < NETWORK_TARGET else NOT_MET]
    )
    return table(("target", "wanted", "reached", "met"), sorted(rows))


def seconds(measured: Measured) -> str:
    """A row a solver, a column a size."""
    rows = [
        [title] + [_time_and_memory(size[task]) for size in measured.values()]
        for task, title in TASK_TITLES.items()
    ]
    return table(_head("s (MB)", measured), rows)


def sizes(measured: Measured) -> str:
    """What the networks have, and how often each solver iterates."""
    rows = [
        ("nodes", "build", "nodes"),
        ("directed edges", "build", "edges"),
        ("edges of the acyclic strategy", "strategy", "acyclic_edges"),
        ("iterations: strategy", "strategy", "iterations"),
        ("iterations: HiGHS dual simplex", "simplex", "iterations"),
        ("iterations: HiGHS interior point", "interior_point", "iterations"),
        ("iterations: the same, within the length budget", "interior_point_budget", "iterations"),
        ("iterations: Clarabel", "conic", "iterations"),
    ]
    return table(_head("", measured), _lines(measured, rows, "d"))


def answers(measured: Measured) -> str:
    """The same value by all, the same entropy by both."""
    rows = [
        ("value by cut", "value", "value"),
        ("value of the strategy", "strategy", "value"),
        ("its gap to the lower bound", "strategy", "gap"),
        ("value: HiGHS dual simplex", "simplex", "value"),
        ("value: HiGHS interior point", "interior_point", "value"),
        ("value: the same, within the length budget", "interior_point_budget", "value"),
        ("edge entropy of the strategy [nats]", "strategy", "entropy"),
        ("edge entropy: Clarabel [nats]", "conic", "entropy"),
        ("route entropy of the strategy [nats]", "strategy", "route_entropy"),
    ]
    return table(_head("", measured), _lines(measured, rows, ".9g"))


def _lines(
    measured: Measured, rows: list[tuple[str, str, str]], form: str
) -> list[list[str]]:
    return [
        [title] + [_entry(size[task], key, form) for size in measured.values()]
        for title, task, key in rows
    ]


def _entry(answer: dict[str, Any], key: str, form: str) -> str:
    if key not in answer:
        return "-"
    return f"{answer[key]:.1e}" if key == "gap" else f"{answer[key]:{form}}"


def _head(corner: str, measured: Measured) -> list[str]:
    return [corner, *(f"{nodes} across" for nodes in measured)]


def _least(answer: dict[str, Any]) -> float:
    """Seconds that a run took, or took at least."""
    return float(answer.get("seconds", answer.get("limit")))


def _ratio(ours: dict[str, Any], other: dict[str, Any]) -> str:
    if "failed" in other:
        return "failed"
    ratio = _least(other) / ours["seconds"]
    return ("> " if "limit" in other else "") + (f"{ratio:.1f}x" if ratio < 20 else f"{ratio:.0f}x")


def _time_and_memory(answer: dict[str, Any]) -> str:
    if "limit" in answer:
        return f"> {answer['limit']}"
    status = answer.get("status", FULLY_SOLVED[0])
    doubt = "" if status in FULLY_SOLVED else f", {status}"
    if "failed" in answer:
        doubt = f", **failed** ({status})"
    return f"{answer['seconds']:.3g} ({answer['peak']:.0f}){doubt}"


def _met(ours: dict[str, Any], other: dict[str, Any], wanted: float) -> str:
    if "failed" not in other and _least(other) >= wanted * ours["seconds"]:
        return "yes"
    no_answer = "failed" in other or "limit" in other
    return "not known: the other gave no answer" if no_answer else NOT_MET

"""What `solver.py` measured, as Markdown: ratios first, then seconds, then whether all agree."""

from __future__ import annotations

from typing import Any

import numpy as np
from report import table

Answers = dict[str, dict[str, Any]]
Measured = dict[int, Answers]

# (ours, other, title, {nodes across: times faster to reach}).
COMPARISONS = (
    ('strategy', 'interior_point', 'strategy : HiGHS interior point, value alone', {200: 30.0}),
    ('strategy', 'conic', 'strategy : Clarabel, the same route-entropy problem',
     {100: 8.0, 200: 12.0}),
    ('value', 'simplex', 'value by cut : HiGHS dual simplex', {200: 300.0}),
    ('value', 'interior_point', 'value by cut : HiGHS interior point', {}),
)
# Further problems (problems.py): seconds to reach.
HARD = {
    'reach-hills:52': 3.0, 'reach-block:50': 3.0, 'reach-hills:106': 20.0, 'reach-block:103': 20.0,
    **{f'{ground}:{detour}': 3.0
       for ground in ('terrain', 'city') for detour in ('1.05', '1.1', '1.15', '1.2')},
}
# A million nodes, network to strategy: seconds, MB. From so many nodes on it is a million.
MILLION, MILLION_SECONDS, MILLION_MEMORY = 900_000, 90.0, 4096.0

# Called so, an answer is as good as the solver was asked for.
FULLY_SOLVED = ('Optimal', 'Solved')
NOT_MET = '**no**'

TASK_TITLES = {
    'build': 'network',
    'value': 'value by cut',
    'strategy': '**strategy, all stages**',
    'simplex': 'HiGHS dual simplex, value within the length budget',
    'interior_point': 'HiGHS interior point without crossover, value',
    'conic': 'Clarabel, route entropy',
}


def report(
    measured: Measured, hard: Answers, growth: list[dict[str, Any]], conditions: str
) -> str:
    """All tables and the conditions they were measured under."""
    sections = (
        ('How many times faster', ratios(measured)),
        ('Targets', targets(measured, hard, growth)),
        ('Processor seconds (peak memory of the process in MB)', seconds(measured)),
        ('Sizes and iterations', sizes(measured)),
        ('The answers agree', answers(measured)),
        ('A reach of 4 spacings, and budgets that raise the value', hard_problems(hard)),
        ('From ten thousand to a million nodes', growth_table(growth)),
    )
    text = '\n\n'.join(f'### {title}\n\n{content}' for title, content in sections)
    return f'One thread for every solver, medians of processor seconds. {conditions}.\n\n{text}'


def ratios(measured: Measured) -> str:
    """A row a comparison, a column a size."""
    rows = [
        [title] + [f'**{_ratio(size[ours], size[other])}**' for size in measured.values()]
        for ours, other, title, _ in COMPARISONS
    ]
    return table(_head('times', measured), rows)


def targets(measured: Measured, hard: Answers, growth: list[dict[str, Any]]) -> str:
    """What was to be reached, what was, and whether that will do."""
    rows = []
    for ours, other, title, wanted in COMPARISONS:
        for nodes in (nodes for nodes in wanted if nodes in measured):
            size = measured[nodes]
            rows.append(
                [f'{title}, {nodes} across', f'{wanted[nodes]:g}x', _ratio(size[ours], size[other]),
                 _met(size[ours], size[other], wanted[nodes])]
            )
    rows.sort()
    for name in (name for name in HARD if name in hard):
        answer, limit = hard[name], HARD[name]
        met = 'failed' not in answer and answer['seconds'] < limit
        rows.append([f"`{name}`, {answer['nodes']} nodes", f'< {limit:g} s',
                     f"{answer['seconds']:.1f} s", 'yes' if met else NOT_MET])
    for answer in growth:
        if answer['nodes'] >= MILLION:
            met = answer['seconds'] < MILLION_SECONDS and answer['peak'] < MILLION_MEMORY
            rows.append(
                [f"{answer['nodes']} nodes, network to strategy",
                 f'< {MILLION_SECONDS:g} s, {MILLION_MEMORY:g} MB',
                 f"{answer['seconds']:.0f} s, {answer['peak']:.0f} MB", 'yes' if met else NOT_MET]
            )
    return table(('target', 'wanted', 'reached', 'met'), rows)


def hard_problems(hard: Answers) -> str:
    """A row a problem."""
    head = ('', 'nodes', 'seconds (MB)', 'value', 'gap', 'route entropy', 'length : shortest',
            'the budget raises the value', 'evaluations')
    rows = [
        [f'`{name}`', str(each['nodes']), _time_and_memory(each), _entry(each, 'value', '.6g'),
         _entry(each, 'gap', '.1e'), _entry(each, 'route_entropy', '.2f'),
         _entry(each, 'length', '.3f'), 'yes' if each.get('price', 0.0) > 0.0 else 'no',
         _entry(each, 'iterations', 'd')]
        for name, each in hard.items()
    ]
    return table(head, rows)


def growth_table(growth: list[dict[str, Any]]) -> str:
    """Seconds by size, and the exponent of their growth."""
    rows = [
        [str(each['nodes']), str(each['edges']), f"{each['seconds']:.2f}", f"{each['peak']:.0f}",
         f"{1e6 * each['seconds'] / each['nodes']:.1f}", str(each['iterations'])]
        for each in growth
    ]
    text = table(
        ('nodes', 'edges', 'network and strategy [s]', 'MB', 'microseconds a node', 'evaluations'),
        rows,
    )
    if len(growth) < 2:
        return text
    logs = np.log([[each['nodes'], each['seconds']] for each in growth])
    exponent = np.polyfit(*logs.T, 1)[0]
    return f'{text}\n\nSeconds grow like nodes to the power of {exponent:.2f}.'


def seconds(measured: Measured) -> str:
    """A row a solver, a column a size."""
    rows = [
        [title] + [_time_and_memory(size[task]) for size in measured.values()]
        for task, title in TASK_TITLES.items()
    ]
    return table(_head('s (MB)', measured), rows)


def sizes(measured: Measured) -> str:
    """What the networks have, and how often each solver iterates."""
    rows = [
        ('nodes', 'build', 'nodes'),
        ('directed edges', 'build', 'edges'),
        ('edges of the acyclic strategy', 'strategy', 'acyclic_edges'),
        ('evaluations: strategy', 'strategy', 'iterations'),
        ('iterations: HiGHS dual simplex', 'simplex', 'iterations'),
        ('iterations: HiGHS interior point', 'interior_point', 'iterations'),
        ('iterations: Clarabel', 'conic', 'iterations'),
    ]
    return table(_head('', measured), _lines(measured, rows, 'd'))


def answers(measured: Measured) -> str:
    """The same value by all, the same entropy by both."""
    rows = [
        ('value by cut', 'value', 'value'),
        ('value of the strategy', 'strategy', 'value'),
        ('its gap to the lower bound', 'strategy', 'gap'),
        ('value: HiGHS dual simplex', 'simplex', 'value'),
        ('value: HiGHS interior point', 'interior_point', 'value'),
        ('route entropy of the strategy [nats]', 'strategy', 'route_entropy'),
        ('route entropy: Clarabel [nats]', 'conic', 'route_entropy'),
    ]
    return table(_head('', measured), _lines(measured, rows, '.9g'))


def _lines(
    measured: Measured, rows: list[tuple[str, str, str]], form: str
) -> list[list[str]]:
    return [
        [title] + [_entry(size[task], key, form) for size in measured.values()]
        for title, task, key in rows
    ]


def _entry(answer: dict[str, Any], key: str, form: str) -> str:
    if key not in answer:
        return '-'
    return f'{answer[key]:.1e}' if key == 'gap' else f'{answer[key]:{form}}'


def _head(corner: str, measured: Measured) -> list[str]:
    return [corner, *(f'{nodes} across' for nodes in measured)]


def _least(answer: dict[str, Any]) -> float:
    """Seconds that a run took, or took at least."""
    return float(answer.get('seconds', answer.get('limit')))


def _ratio(ours: dict[str, Any], other: dict[str, Any]) -> str:
    if 'failed' in other:
        return 'failed'
    ratio = _least(other) / ours['seconds']
    return ('> ' if 'limit' in other else '') + (f'{ratio:.1f}x' if ratio < 20 else f'{ratio:.0f}x')


def _time_and_memory(answer: dict[str, Any]) -> str:
    if 'limit' in answer:
        return f"> {answer['limit']}"
    status = answer.get('status', FULLY_SOLVED[0])
    doubt = '' if status in FULLY_SOLVED else f', {status}'
    if 'failed' in answer:
        doubt = f', **failed** ({status})'
    return f"{answer['seconds']:.3g} ({answer['peak']:.0f}){doubt}"


def _met(ours: dict[str, Any], other: dict[str, Any], wanted: float) -> str:
    if 'failed' not in other and _least(other) >= wanted * ours['seconds']:
        return 'yes'
    no_answer = 'failed' in other or 'limit' in other
    return 'not known: the other gave no answer' if no_answer else NOT_MET

# SPDX-License-Identifier: Apache-2.0
"""Public names are listed, formulas parse, examples run, and docstrings begin with what they do."""

import ast
import doctest
import re

import pytest
from commands import ROOT

import ambush_planner

SOURCES = sorted(path for folder in ('ambush_planner', 'examples', 'paper')
                 for path in ROOT.joinpath(folder).rglob('*.py'))
CLAUSE = re.compile(r'(What|Who|Whoever|How|Whether|Where|When|Which|If|He)\b')
DOCUMENTS = sorted(path for folder in ('.', 'docs', 'examples')
                   for path in ROOT.joinpath(folder).glob('*.md'))


def test_the_reference_lists_every_public_name_with_its_file():
    found = re.findall(r'(?m)^\* \[`(\w+)`\]\((.+)\)$', (ROOT / 'docs/reference.md').read_text())
    names = [name for name, _ in found]
    errors = ast.parse((ROOT / 'ambush_planner/errors.py').read_text()).body
    wanted = {*ambush_planner.__all__,
              *(each.name for each in errors if isinstance(each, ast.ClassDef))}
    assert wanted <= set(names) and len(names) == len(set(names))
    for name, file in found:
        source = (ROOT / 'docs' / file).read_text()
        assert re.search(rf'(?m)^(class|def) {name}\b', source), name


def test_docstrings_begin_with_a_verb_or_a_noun():
    """None is a clause that its reader has to finish, or somebody's question."""
    found = {f'{path.relative_to(ROOT)}:{node.lineno}' if hasattr(node, 'lineno') else path.name
             for path in SOURCES for node in ast.walk(ast.parse(path.read_text()))
             if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
             and CLAUSE.match(ast.get_docstring(node) or '')}
    assert not found


def test_prose_is_free_of_words_that_send_readers_back():
    found = {(path.name, word) for path in [*SOURCES, *DOCUMENTS]
             for word in re.findall(r'(?i)\b(?:whoever|anew|so many)\b', path.read_text())}
    assert not found


def test_formulas_parse():
    converter = pytest.importorskip('latex2mathml.converter',
                                    reason='no latex2mathml: it lacks a rosdep key')
    for document in DOCUMENTS:
        text = document.read_text()
        formulas = re.findall(r'(?ms)^ *```math\n(.*?)^ *```$', text)
        text = re.sub(r'(?ms)^ *```.*?^ *```$', '', text)
        for formula in [*formulas, *re.findall(r'\$`([^`\n]+)`\$', text)]:
            assert '\\' not in converter.convert(formula), f'unknown command in {formula}'
            assert r'\operatorname' not in formula, f'GitHub refuses \\operatorname: {formula}'
            bare = re.sub(r'\\[{}]', '', formula)
            assert bare.count('{') == bare.count('}'), formula
        plain = re.sub(r'(?<!\w)\$`[^`\n]+`\$|`[^`\n]*`', '', text)
        assert '$' not in plain, f'{document}: formulas are written $`...`$ or in ```math'


@pytest.mark.parametrize('name', [
    name for name in ambush_planner.__all__
    if '>>>' in (getattr(ambush_planner, name).__doc__ or '')])
def test_examples_of_the_api_run(name):
    found = doctest.DocTestFinder(recurse=False).find(getattr(ambush_planner, name), name)
    result = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(found[0])
    assert not result.failed

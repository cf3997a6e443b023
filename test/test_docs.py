"""Links lead somewhere, modules that are named exist, formulas parse, and examples run."""

import ast
import doctest
import re
from pathlib import Path

import pytest

import ambush_planner

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = sorted(path for folder in ('.', 'docs', 'examples')
                   for path in ROOT.joinpath(folder).glob('*.md'))


def anchors(document):
    """Return the anchors of a document's headings, as GitHub makes them."""
    text = re.sub(r'(?ms)^```.*?^```', '', document.read_text())
    headings = re.findall(r'(?m)^#+ (.*)$', text)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document):
    for link in re.findall(r'\]\(([^)\s]+)\)', document.read_text()):
        if '://' in link:
            continue
        name, _, anchor = link.partition('#')
        target = document.parent / name if name else document
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_the_modules_of_the_contributors_tables_exist():
    package = ROOT / 'ambush_planner'
    text = (ROOT / 'CONTRIBUTING.md').read_text()
    rooms, solving = (text.split(head)[1].split('\n\n')[0].splitlines()[2:]
                      for head in ('| room | ', '| solving the game | '))
    found = [(row.split('`')[1], row.split('|')[3]) for row in rooms]
    found += [('game', row.split('|')[2]) for row in solving]
    assert sorted({room for room, _ in found}) == sorted(
        path.parent.name for path in package.glob('*/__init__.py'))
    for room, names in found:
        for name in re.findall(r'`([\w/]+)`', names):
            assert (package / room / f'{name}.py').is_file(), name


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


def test_the_theorys_statements_are_numbered_in_order_and_references_exist():
    text = (ROOT / 'docs/theory.md').read_text()
    made = re.findall(r'(?m)^\*\*(?:Definition|Proposition|Corollary) (\d+)\.(\d+)', text)
    for section in {first for first, _ in made}:
        numbers = [int(second) for first, second in made if first == section]
        assert numbers == list(range(1, len(numbers) + 1)), section
        assert re.search(rf'(?m)^## {section}\. ', text)
    prose = re.sub(r'(?ms)^```math.*?^```$|\$`[^`\n]+`\$', '', text)
    named = re.findall(r'(?:Definition|Proposition|Corollary) (\d+\.\d+)|\((\d\.\d+)[ )]', prose)
    assert {a or b for a, b in named} <= {'.'.join(each) for each in made}
    sections = re.findall(r'[Ss]ections? (\d+)', prose)
    assert all(re.search(rf'(?m)^## {each}\. ', text) for each in sections)


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_formulas_parse(document):
    converter = pytest.importorskip('latex2mathml.converter', reason='it has no rosdep key')
    text = document.read_text()
    formulas = re.findall(r'(?ms)^ *```math\n(.*?)^ *```$', text)
    text = re.sub(r'(?ms)^ *```.*?^ *```$', '', text)
    formulas += re.findall(r'\$`([^`\n]+)`\$', text)
    for formula in formulas:
        assert '\\' not in converter.convert(formula), f'unknown command in {formula}'
        assert r'\operatorname' not in formula, f'GitHub refuses \\operatorname: {formula}'
        bare = re.sub(r'\\[{}]', '', formula)
        assert bare.count('{') == bare.count('}'), formula
    plain = re.sub(r'(?<!\w)\$`[^`\n]+`\$|`[^`\n]*`', '', text)
    assert '$' not in plain, 'formulas are written $`...`$, on one line, or in ```math'


@pytest.mark.parametrize('name', [
    name for name in ambush_planner.__all__
    if '>>>' in (getattr(ambush_planner, name).__doc__ or '')])
def test_examples_of_the_api_run(name):
    found = doctest.DocTestFinder(recurse=False).find(getattr(ambush_planner, name), name)
    result = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(found[0])
    assert not result.failed

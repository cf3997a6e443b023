"""Links and references in the documents lead somewhere, and formulas parse."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = [*sorted(ROOT.glob('*.md')), *sorted(ROOT.glob('docs/*.md'))]


def anchors(document):
    """Return the anchors of a document's headings, as GitHub makes them."""
    text = re.sub(r'(?ms)^```.*?^```', '', document.read_text())
    headings = re.findall(r'(?m)^#+ (.*)$', text)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


def test_links_lead_somewhere():
    for document in DOCUMENTS:
        for link in re.findall(r'\]\(([^)\s]+)\)', document.read_text()):
            name, _, anchor = link.partition('#')
            target = document.parent / name if name else document
            assert '://' in link or target.exists(), (document, link)
            assert '://' in link or not anchor or anchor in anchors(target), (document, link)


def test_references_to_the_theorys_statements_and_sections_exist():
    text = (ROOT / 'docs/theory.md').read_text()
    made = re.findall(r'(?m)^\*\*(?:Definition|Proposition|Corollary) (\d+\.\d+)', text)
    prose = re.sub(r'(?ms)^```math.*?^```$|\$`[^`\n]+`\$', '', text)
    named = re.findall(r'(?:Definition|Proposition|Corollary) (\d+\.\d+)', prose)
    assert len(made) == len(set(made)) and set(named) <= set(made)
    sections = re.findall(r'[Ss]ections? (\d+)', prose)
    assert all(re.search(rf'(?m)^## {each}\. ', text) for each in sections)


def test_formulas_parse():
    converter = pytest.importorskip('latex2mathml.converter', reason='it has no rosdep key')
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

"""Links in the documents lead somewhere."""

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


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document):
    for link in re.findall(r'\]\(([^)\s]+)\)', document.read_text()):
        if '://' in link:
            continue
        name, _, anchor = link.partition('#')
        target = document.parent / name if name else document
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link

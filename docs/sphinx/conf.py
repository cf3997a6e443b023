# SPDX-License-Identifier: Apache-2.0
"""Sphinx: the pages that GitHub shows, as a site with the reference of the Python API.

The source folder is the checkout's root, so that all links are those of GitHub. docs itself has no
conf.py: rosdoc2, which makes its own site of docs, would take it for its own.
"""

import re

from docutils import nodes
from latex2mathml.converter import convert
from pygments.lexers.special import TextLexer

import ambush_planner

project = 'ambush_planner'
version = release = ambush_planner.__version__
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
root_doc = 'README'
include_patterns = ['*.md', 'CHANGELOG.rst', 'docs/*.md', 'benchmarks/*.md', 'examples/*.md']
html_theme = 'furo'
html_title = 'ambush_planner'
html_math_renderer = 'mathml'
myst_fence_as_directive = ['math']
myst_heading_anchors = 4
autodoc_default_options = {'members': True}
autodoc_typehints = 'none'  # the docstrings have shapes and units
napoleon_use_ivar = True  # else attributes that are properties are documented twice
napoleon_use_rtype = False
# Where docstrings have types, they have shapes and words, too.
nitpick_ignore_regex = [('py:class', r'(?!ambush_planner).*')]


def read_page(app, page, source):
    """Translate GitHub's formulas, and the reference's list of names into their docstrings."""
    source[0] = re.sub(r'\$`([^`\n]+)`\$', r'{math}`\1`', source[0])
    if page == root_doc:
        order = re.findall(r'\((\w+)\.md\)', (app.srcdir / 'docs/README.md').read_text())
        pages = ['docs/README', *(f'docs/{each}' for each in order),
                 'examples/*', 'benchmarks/*', '*']
        source[0] += '\n```{toctree}\n:hidden:\n:glob:\n' + '\n'.join(pages) + '\n```\n'
    if page == 'docs/reference':
        source[0] = re.sub(r'(?m)^\* \[`(\w+)`\]\(\.\./(.*)\.py\)$', documented, source[0])


def documented(line):
    """Return the directive that documents the name in a line of the reference."""
    name, file = line.groups()
    module = 'ambush_planner' if name in ambush_planner.__all__ else file.replace('/', '.')
    kind = ('function' if name.islower() else
            'exception' if file == 'ambush_planner/errors' else 'class')
    return f'```{{eval-rst}}\n.. auto{kind}:: {module}.{name}\n```'


def keep_sentence(app, what, name, thing, options, lines):
    """Keep napoleon from taking the words before a property's first colon for its type."""
    if what == 'property':
        lines.insert(0, '')


def draw_formula(translator, node):
    """Write a formula as MathML, which browsers draw without a script."""
    display = 'block' if isinstance(node, nodes.math_block) else 'inline'
    translator.body.append(convert(node.astext(), display=display))
    raise nodes.SkipNode


def setup(app):
    """Connect the functions above."""
    app.connect('source-read', read_page)
    app.connect('autodoc-process-docstring', keep_sentence, priority=400)  # before napoleon
    app.add_html_math_renderer('mathml', (draw_formula, None), (draw_formula, None))
    app.add_lexer('mermaid', TextLexer)  # diagrams stay text: mermaid.js is not on the index

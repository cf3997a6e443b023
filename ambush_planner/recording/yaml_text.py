"""YAML from files that may hold anything."""

from __future__ import annotations

import json
import re
from typing import Any

import yaml

MOST_CHARACTERS = 2**20
# The characters that an entry of a long text must have on average: tiny ones take longest.
_LEAST_ENTRY = 16
# Levels of nesting that no parser runs out of stack for.
_HARMLESS = 150
# In base 60 ("1:59:59"), what a number takes to read grows with the square of its length.
_LONG_NUMBER = re.compile(r'[0-9a-fA-FxX_:]{101}')
_WHOLE_NUMBERS = re.compile(r'\[[0-9, ]*\]')


class BadYaml(ValueError):
    """The text is not the YAML that was expected."""


# libyaml's bindings where PyYAML has them: some ten times as fast.
class _Loader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):
    """Refuses mappings in which a key comes twice: readers differ in which value they take."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping = super().construct_mapping(node, deep)
        if len(mapping) < len(node.value):
            raise BadYaml('YAML with a key that comes twice')
        return mapping


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):
    """Writes an object that is met twice out twice: ``load_yaml`` takes no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def load_yaml(text: str, most: int = MOST_CHARACTERS) -> Any:
    """Return the document in ``text``, which has no anchors, aliases and tags.

    Args:
        text: Anything.
        most: How many characters it may have; a megabyte takes up to a second.

    Raises:
        BadYaml: It is not YAML, longer than ``most``, has too many entries, numbers of more than
            100 digits, a key twice in a mapping or what is said above, or is nested so deeply
            that parsers (also that in C) run out of stack.
    """
    if len(text) > most:
        raise BadYaml(f'{len(text)} characters where at most {most} are read')
    if _LONG_NUMBER.search(text):
        raise BadYaml('a number of more than 100 digits')
    try:
        if _WHOLE_NUMBERS.fullmatch(text):
            return _whole_numbers(text)
        if text.count(',') + text.count('\n') > most // _LEAST_ENTRY:
            raise BadYaml('too many entries')
        _check_events(text)
        return yaml.load(text, _Loader)
    except BadYaml:
        raise
    except (
        yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError, ArithmeticError,
        RecursionError, MemoryError,
    ) as error:
        # What PyYAML's constructors raise on texts like "2001-99-99". The text itself is not
        # repeated (nor chained): it may hold a route.
        raise BadYaml(f'not YAML ({type(error).__name__})') from None


def dump_yaml(document: Any) -> str:
    """Return ``document`` as YAML, with the keys in their order and no string over two lines."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, width=2**20)


def _whole_numbers(text: str) -> Any:
    """A list of whole numbers, such as a route: some hundred times as fast as YAML."""
    try:
        return json.loads(text)
    except ValueError:  # "[1, 2,]" and "[007]" are YAML only
        return yaml.load(text, _Loader)


def _check_events(text: str) -> None:
    # A level takes a column of its line, or a bracket: most texts need no closer look.
    brackets = text.count('[') + text.count('{')
    is_flat = brackets + max(map(len, text.splitlines()), default=0) <= _HARMLESS
    if is_flat and not any(mark in text for mark in '&*!'):
        return
    depth = 0
    for event in yaml.parse(text, _Loader):
        # An alias of a few bytes may stand for gigabytes.
        if isinstance(event, yaml.AliasEvent) or getattr(event, 'anchor', None):
            raise BadYaml('it has anchors or aliases')
        if getattr(event, 'tag', None):
            raise BadYaml('it has tags')
        if isinstance(event, (yaml.SequenceStartEvent, yaml.MappingStartEvent)):
            depth += 1
            if depth > _HARMLESS:
                raise BadYaml('nested too deeply')
        elif isinstance(event, (yaml.SequenceEndEvent, yaml.MappingEndEvent)):
            depth -= 1

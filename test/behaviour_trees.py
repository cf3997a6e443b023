# SPDX-License-Identifier: Apache-2.0
"""Behaviour trees without Nav2: PyPI, Debian and npm have no engine with its control nodes.

In 154 trips like those of test_behaviour_trees.py, these did what those of BehaviorTree.CPP 4.9.0
and Nav2 1.3.13 do, tick by tick.
"""

import xml.etree.ElementTree as ElementTree

RUNNING, SUCCESS, FAILURE = 'RUNNING', 'SUCCESS', 'FAILURE'


class Node:
    """A node with its children; ``status`` is '' while it is idle.

    Each kind has a ``step``, which ticks the children and returns the status.
    """

    def __init__(self, tree, element):
        self.tree, self.element, self.status = tree, element, ''
        self.children = [tree.build(child) for child in element]
        self.reset()

    def reset(self):
        """Forget everything, to begin again."""

    def tick(self):
        self.status = self.step()
        return self.status

    def finish(self, status):
        """Begin again at the next tick; return the status."""
        for child in self.children:
            child.halt()
        self.reset()
        return status

    def halt(self):
        """Become idle; what does not run has begun again already."""
        if self.status == RUNNING:
            self.finish('')
        self.status = ''


class Leaf(Node):
    """A function of the tree's ``leaves`` begins the work; what it returns gives each status."""

    def step(self):
        if self.status != RUNNING:
            self.work = self.tree.leaves[self.element.tag](self.element.attrib)
        return self.work()

    def halt(self):
        if self.status == RUNNING:
            getattr(self.work, 'halt', lambda: None)()
        self.status = ''


class Script(Node):
    """Numbers of the blackboard: a := b + 1; c := 2, or a condition."""

    def step(self):
        numbers = self.tree.numbers
        for part in self.element.get('code').split(';'):
            name, assigned, value = part.rpartition(':=')
            result = eval(value.replace('&&', 'and'), {'__builtins__': {}}, numbers)
            if not assigned:
                return SUCCESS if result else FAILURE
            numbers[name.strip()] = result
        return SUCCESS


class Sequence(Node):
    """Goes on with the child that runs; ends with the first ``stop`` of a child."""

    stop, end = FAILURE, SUCCESS

    def reset(self):
        self.at = 0

    def step(self):
        while self.at < len(self.children):
            status = self.children[self.at].tick()
            if status == RUNNING:
                return status
            if status == self.stop:
                return self.finish(status)
            self.at += 1
        return self.finish(self.end)


class Fallback(Sequence):
    stop, end = SUCCESS, FAILURE


class ReactiveFallback(Fallback):
    """Asks all children again at each tick."""

    def step(self):
        for child in self.children:
            status = child.tick()
            if status == RUNNING:
                for other in self.children:
                    if other is not child:
                        other.halt()
                return status
            if status == self.stop:
                return self.finish(status)
        return self.finish(self.end)


class ReactiveSequence(ReactiveFallback):
    stop, end = FAILURE, SUCCESS


class PipelineSequence(Sequence):
    """Ticks all children up to the last one that has run, whether or not the former still run."""

    def step(self):
        for number, child in enumerate(self.children):
            status = child.tick()
            if status == FAILURE:
                return self.finish(status)
            if status == RUNNING and number >= self.at:
                self.at = number
                return status
        return self.finish(SUCCESS)


class RecoveryNode(Node):
    """Tries the first child again after the second, which helps."""

    def reset(self):
        self.at, self.retries = 0, 0

    def step(self):
        while True:
            status = self.children[self.at].tick()
            if status == RUNNING:
                return status
            given_up = self.at == 0 and self.retries == int(self.element.get('number_of_retries'))
            if given_up or (status == SUCCESS) == (self.at == 0):
                return self.finish(status)
            self.children[self.at].halt()
            self.retries += self.at
            self.at = 1 - self.at


class RoundRobin(Node):
    """Goes on with the next child after a success, too."""

    def reset(self):
        self.at = 0

    def step(self):
        for _ in self.children:
            status = self.children[self.at].tick()
            if status == RUNNING:
                return status
            self.at = (self.at + 1) % len(self.children)
            if status == SUCCESS:
                return status
        return self.finish(FAILURE)


class Decorator(Node):
    """The child's status as ``becomes`` says."""

    becomes = {}

    def step(self):
        status = self.children[0].tick()
        if status != RUNNING:
            self.finish(status)
        return self.becomes.get(status, status)


class Inverter(Decorator):
    becomes = {SUCCESS: FAILURE, FAILURE: SUCCESS}


class ForceSuccess(Decorator):
    becomes = {FAILURE: SUCCESS}


class KeepRunningUntilFailure(Decorator):
    becomes = {SUCCESS: RUNNING}


class RateController(Decorator):
    """Ticks the child while it runs, and again a period after its success."""

    def step(self):
        now = self.tree.clock()
        if not self.status:
            self.due = now
        if self.children[0].status != RUNNING and now < self.due:
            return RUNNING
        status = self.children[0].tick()
        if status == SUCCESS:
            self.due = now + 1.0 / float(self.element.get('hz'))
        return status


class Timeout(Decorator):
    """Halts a child that has run for ``msec``; the next tick fails."""

    def step(self):
        if self.status != RUNNING:
            self.end = self.tree.clock() + float(self.element.get('msec')) / 1e3
        if self.tree.clock() >= self.end:
            return self.finish(FAILURE)
        return super().step()


# Children of each control node, None for any number from 1 on.
CONTROLS = {each.__name__: (each, count) for each, count in (
    (Sequence, None), (Fallback, None), (ReactiveFallback, None), (ReactiveSequence, None),
    (PipelineSequence, None), (RoundRobin, None), (RecoveryNode, 2), (Inverter, 1),
    (Timeout, 1), (ForceSuccess, 1), (KeepRunningUntilFailure, 1), (RateController, 1))}
CONTROLS |= {'Script': (Script, 0), 'ScriptCondition': (Script, 0)}


class Tree:
    """A tree from XML; ``leaves`` make the work of leaves from their attributes.

    ``clock`` is in seconds.
    """

    def __init__(self, text, leaves, clock):
        self.leaves, self.clock, self.numbers = leaves, clock, {}
        root = ElementTree.fromstring(text)
        (main,) = [each for each in root.iter('BehaviorTree')
                   if each.get('ID') == root.get('main_tree_to_execute')]
        assert root.get('BTCPP_format') == '4'
        (first,) = main
        self.root = self.build(first)

    def build(self, element):
        """The node of an element; its kind and the number of its children must be right."""
        if element.tag in CONTROLS:
            kind, count = CONTROLS[element.tag]
            assert len(element) == count if count is not None else len(element), element.tag
            return kind(self, element)
        assert element.tag in self.leaves and not len(element), element.tag
        return Leaf(self, element)

    def tick(self):
        """Tick the root; return its status, and become idle if it has ended."""
        status = self.root.tick()
        if status != RUNNING:
            self.root.status = ''
        return status

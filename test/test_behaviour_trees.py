# SPDX-License-Identifier: Apache-2.0
"""The behaviour trees of config: what they report, by a robot on a line; without ROS."""

import re
import xml.etree.ElementTree as ElementTree

import pytest
from behaviour_trees import FAILURE, RUNNING, SUCCESS, Tree
from commands import ROOT

POSE = (ROOT / 'config/ambush_tree.xml').read_text()
POSES = (ROOT / 'config/ambush_tree_through_poses.xml').read_text()
TICK, SPEED = 2.0**-6, 2.0  # s, m/s
OCCUPIED, NO_PATH, STUCK = 206, 208, 105


class World:
    """A robot on a line, a planner that takes ``solve`` s, and a controller: the leaves of a tree.

    ``fails`` are codes by goal that the planner fails with; it never answers what it was ``killed``
    at. The controller is stuck beyond ``wall``, and drives past all stops of the first paths that
    it ``cuts``; the path is invalid from ``blocked_at`` s on.
    """

    def __init__(self, solve=3.0):
        self.solve, self.now, self.place, self.goals = solve, 0.0, 0.0, []
        self.path, self.fails, self.wall, self.blocked_at = [], {}, 1e9, 1e9
        self.killed, self.cuts, self.compared, self.known = [], 0, [], {}
        self.codes = {'planner': 0, 'controller': 0}
        self.asked, self.followed, self.helped = [], 0, []

    def clock(self):
        return self.now

    def leaf(self, name):
        return getattr(self, re.sub(r'(?<!^)([A-Z])', r'_\1', name).lower())

    def away(self, goal):
        return abs(goal - self.place)

    def global_updated_goal(self, ports):
        name = ports.get('goals', '{goals}').strip('{}')

        def work():
            before, now = self.known.get(name), list(getattr(self, name))
            self.known[name] = now
            return SUCCESS if before != now else FAILURE
        return work

    def goal_updated(self, ports):
        return lambda: FAILURE

    def is_path_valid(self, ports):
        return lambda: SUCCESS if self.path and self.now < self.blocked_at else FAILURE

    def remove_passed_goals(self, ports):
        def work():
            left, radius = list(self.goals), ports['radius'].strip('{}')
            while len(left) > 1 and self.away(left[0]) <= float(self.numbers.get(radius, radius)):
                left.pop(0)
            setattr(self, ports.get('output_goals', '{goals}').strip('{}'), left)
            return SUCCESS
        return work

    def compute_path_to_pose(self, ports):
        goals, due = list(self.goals), self.now + self.solve
        self.asked.append(goals)

        def work():
            if self.now < due or goals in self.killed:
                return RUNNING
            self.codes['planner'] = self.fails.get(goals[-1], 0)
            self.path = [] if self.codes['planner'] else list(goals)
            self.blocked_at = 1e9 if self.now > self.blocked_at else self.blocked_at
            return FAILURE if self.codes['planner'] else SUCCESS

        work.halt = lambda: setattr(self, 'path', [])
        return work

    compute_path_through_poses = compute_path_to_pose

    def follow_path(self, ports):
        self.followed += 1
        ahead = list(self.path)

        def work():
            if self.path and self.path != ahead:
                ahead[:] = self.path
            if self.cuts and len(ahead) > 1:
                self.cuts, self.path[:-1], ahead[:-1] = self.cuts - 1, [], []
            step = max(-SPEED * TICK, min(SPEED * TICK, ahead[0] - self.place))
            if self.place + step > self.wall:
                self.codes['controller'] = STUCK
                return FAILURE
            self.place += step
            if self.place == ahead[0]:
                ahead.pop(0)
                self.path = list(ahead) or self.path
            self.codes['controller'] = 0
            return RUNNING if ahead else SUCCESS
        return work

    def would_a_planner_recovery_help(self, ports):
        return lambda: SUCCESS if self.codes['planner'] in (200, 207, 208) else FAILURE

    def would_a_controller_recovery_help(self, ports):
        return lambda: SUCCESS if self.codes['controller'] in (100, 104, 105, 106) else FAILURE

    def help(self, name, seconds):
        def start(ports):
            end = self.now + seconds
            self.helped.append(ports.get('service_name', name).partition('/')[0])
            return lambda: RUNNING if self.now < end else SUCCESS
        return start

    @property
    def leaves(self):
        names = ('GlobalUpdatedGoal', 'GoalUpdated', 'IsPathValid', 'RemovePassedGoals',
                 'ComputePathToPose', 'ComputePathThroughPoses', 'FollowPath',
                 'WouldAPlannerRecoveryHelp', 'WouldAControllerRecoveryHelp')
        return {name: self.leaf(name) for name in names} | {
            'ClearEntireCostmap': self.help('clear', 0.0), 'Wait': self.help('wait', 5.0),
            'BackUp': self.help('back up', 2.0)}

    def run(self, text, goals, then=(), until=60.0):
        """Navigate; ``then`` are (s, new goals). Return the tree's status in the end."""
        self.goals, waiting = list(goals), sorted(then)
        tree = Tree(text, self.leaves, self.clock)
        self.numbers = tree.numbers
        while self.now < until:
            while waiting and waiting[0][0] <= self.now:
                self.goals = list(waiting.pop(0)[1])
            status = tree.tick()
            if status != RUNNING:
                return status
            self.now += TICK
        return RUNNING


TREES = pytest.mark.parametrize('tree', [POSE, POSES], ids=['pose', 'poses'])


@TREES
def test_a_goal_is_driven_to_and_asked_for_once(tree):
    world = World()
    assert world.run(tree, [10.0]) == SUCCESS
    assert (world.place, world.asked, world.followed) == (10.0, [[10.0]], 1)
    assert world.now == pytest.approx(3.0 + 5.0, abs=0.1)


@TREES
@pytest.mark.parametrize('solve', [0.0, 0.3, 1.0, 3.0])
def test_success_is_reported_only_at_the_newest_goal(tree, solve):
    """Whenever it comes: before, while and after the end of the path to the one before."""
    ends = solve + 5.0
    for at in (0.0, 0.5 * solve, ends - 4.0, ends - 1.5, ends - 1.0, ends - 0.5, ends - 0.02):
        world = World(solve)
        assert world.run(tree, [10.0], [(at, [30.0])]) == SUCCESS
        assert world.place == 30.0, at
        assert world.asked[-1] == [30.0] and len(world.asked) <= 2
        world = World(solve)
        assert world.run(tree, [10.0], [(at, [-5.0]), (at + 0.7, [4.0])]) == SUCCESS
        assert world.place == 4.0, at


def test_stops_are_passed_and_left_out_of_later_requests():
    world = World(0.1)
    assert world.run(POSES, [4.0, 2.0, 10.0]) == SUCCESS
    assert world.place == 10.0
    assert world.asked == [[4.0, 2.0, 10.0], [2.0, 10.0], [10.0]]
    world = World()
    assert world.run(POSES, [4.0, 8.0], [(4.0, [6.0, -3.0])]) == SUCCESS
    assert world.place == -3.0 and world.asked[-1] == [-3.0]


def test_no_success_while_a_stop_remains():
    """A controller may go on where the path comes near later; the tree asks again, not for ever."""
    world = World(0.1)
    world.cuts = 2
    assert world.run(POSES, [-3.0, 10.0]) == SUCCESS
    assert world.asked == [[-3.0, 10.0]] * 3 + [[10.0]]
    world = World(0.1)
    world.cuts = 100
    assert world.run(POSES, [-3.0, 10.0]) == FAILURE
    assert world.place == 10.0 and len(world.asked) == 11


def test_a_stop_that_is_passed_on_the_path_to_an_older_goal_stays():
    world = World()
    assert world.run(POSES, [20.0], [(4.0, [6.0, 30.0])]) == SUCCESS
    assert world.asked == [[20.0], [6.0, 30.0], [30.0]]


@TREES
def test_a_killed_planner_is_waited_for_a_minute_or_until_a_newer_goal(tree):
    world = World()
    world.killed = [[10.0]]
    assert world.run(tree, [10.0], until=100.0) == FAILURE
    assert world.now == pytest.approx(60.0, abs=0.1) and world.helped == []
    world = World()
    world.killed = [[10.0]]
    assert world.run(tree, [10.0], [(5.0, [30.0])]) == SUCCESS
    assert world.asked == [[10.0], [30.0]] and world.now == pytest.approx(5 + 3 + 15, abs=0.1)


@TREES
def test_the_failure_of_an_older_goal_does_not_count(tree):
    for solve in (0.1, 3.0):
        for at in (0.0, 0.5 * solve, solve - TICK, solve):
            world = World(solve)
            world.fails = {10.0: OCCUPIED}
            found = world.run(tree, [10.0], [(at, [30.0])])
            assert (found, world.place) == (SUCCESS, 30.0), at


@TREES
def test_a_recovery_is_tried_only_if_it_helps(tree):
    world = World(0.1)
    world.fails = {10.0: OCCUPIED}
    assert world.run(tree, [10.0]) == FAILURE
    assert world.now < 0.2 and world.helped == [] and len(world.asked) == 1
    world = World(0.1)
    world.fails = {10.0: NO_PATH}
    assert world.run(tree, [10.0], until=100.0) == FAILURE
    assert world.helped[:3] == ['global_costmap', 'local_costmap', 'global_costmap']
    assert {'wait', 'back up'} < set(world.helped)
    world = World(0.1)
    world.wall = 5.0
    assert world.run(tree, [10.0], until=100.0) == FAILURE
    assert world.place <= 5.0 and world.helped[0] == 'local_costmap'
    world = World(0.1)
    world.fails = {30.0: OCCUPIED}
    assert world.run(tree, [10.0], [(2.0, [30.0])]) == FAILURE, 'not as if it were the old goal'


@TREES
def test_a_path_that_becomes_invalid_is_asked_for_again_on_the_way(tree):
    world = World(0.5)
    world.blocked_at = 2.2
    assert world.run(tree, [10.0]) == SUCCESS
    assert (world.place, len(world.asked), world.followed) == (10.0, 2, 1)


@TREES
def test_the_same_goal_again_is_a_new_request(tree):
    """The tree and its blackboard outlive a goal; a path of yesterday is not followed again."""
    world = World(0.1)
    nav = Tree(tree, world.leaves, world.clock)
    world.numbers = nav.numbers
    for _ in range(2):
        world.place, world.goals = 0.0, [10.0]
        while nav.tick() == RUNNING:
            world.now += TICK
        assert world.place == 10.0
    assert world.asked == [[10.0], [10.0]]


# The ports that the trees set, of Nav2's nav2_tree_nodes.xml (1.3.13) and of BehaviorTree.CPP.
PORTS = {
    'RecoveryNode': 'number_of_retries', 'RateController': 'hz', 'Script': 'code',
    'ScriptCondition': 'code', 'Wait': 'wait_duration', 'BackUp': 'backup_dist backup_speed',
    'IsPathValid': 'path server_timeout', 'ClearEntireCostmap': 'service_name', 'Timeout': 'msec',
    'FollowPath': 'path controller_id server_timeout error_code_id',
    'RemovePassedGoals': 'input_goals output_goals radius',
    'WouldAPlannerRecoveryHelp': 'error_code', 'WouldAControllerRecoveryHelp': 'error_code',
    'ComputePathToPose': 'goal path planner_id server_name server_timeout error_code_id',
    'ComputePathThroughPoses': 'goals path planner_id server_name server_timeout error_code_id',
}


@TREES
def test_the_trees_set_ports_that_their_nodes_have(tree):
    for node in ElementTree.fromstring(tree).find('BehaviorTree').iter():
        ports = set(node.keys()) - {'name', 'ID'}
        assert ports == set(PORTS.get(node.tag, '').split()) or (
            node.tag == 'GlobalUpdatedGoal' and ports == {'goals'}), node.tag


@TREES
def test_behaviortree_cpp_reads_the_trees(tree):
    """The real parser, if it is installed; Nav2's control nodes go by the names of its own."""
    bt = pytest.importorskip('behaviortreepy')
    factory, world = bt.BehaviorTreeFactory(), World()
    for name in world.leaves:
        factory.register_simple_action(name, lambda *_: bt.NodeStatus.SUCCESS)
    factory.register_simple_decorator('RateController', lambda status, *_: status)
    tree = re.sub(r'(RecoveryNode|PipelineSequence|RoundRobin)(?=[ />])', 'Sequence', tree)
    factory.register_behavior_tree_from_text(tree)
    assert len(factory.registered_behavior_trees()) == 1
    with pytest.raises(Exception, match='Invert'):
        factory.register_behavior_tree_from_text(tree.replace('Inverter', 'Invert'))

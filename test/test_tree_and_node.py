# SPDX-License-Identifier: Apache-2.0
"""The behaviour trees of config with a real node: a robot drives and asks as they say.

Time passes by ticks, and no tick begins before the node knows where the robot is.
"""

import math
import time
from importlib import import_module

import numpy as np
import pytest
from behaviour_trees import FAILURE, RUNNING, SUCCESS, Tree
from nav_msgs.msg import Path
from robots import ROBOT, Robot
from ros_harness import pose, stage
from test_behaviour_trees import POSE, POSES, World
from test_compute_path import Goals
from waiting import answer_of

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures('nav2')]
SPEED, PERIOD, REACHED = 4.0, 0.02, 0.25  # m/s, s, m: Nav2's goal checker
FAR = np.full((40, 40), 10, dtype=np.int8)
QUICK = {'network.spacing': 2.0, 'strategy.max_gap': 1.0, 'route.path_spacing': 0.1}


class Drive(World):
    """A robot on the plane; the leaves that ask call the node, the others are as on a line."""

    def __init__(self, running, xy, values=FAR):
        super().__init__()
        self.client, self.robot = running.client, Robot(running)
        self.place, self.path_message, self.answers = np.array(xy), Path(), []
        self.to_pose, self.through_poses = Goals(running), Goals(running, 'poses')
        self.validity = self.client.node.create_client(
            import_module('nav2_msgs.srv').IsPathValid, 'ambush_planner/is_path_valid')
        self.robot.is_at(*xy)
        running.know(values)

    def away(self, goal):
        return math.dist(self.place, goal)

    def is_path_valid(self, ports):
        def work():
            request = self.validity.srv_type.Request(path=self.path_message)
            return SUCCESS if answer_of(self.validity, request).is_valid else FAILURE
        return work

    def compute_path_to_pose(self, ports):
        return self.compute(self.to_pose, goal=pose(*self.goals[-1]))

    def compute_path_through_poses(self, ports):
        return self.compute(self.through_poses, goals=[pose(*each) for each in self.goals])

    def compute(self, planner, **fields):
        result = planner.result_of(handle := planner.send(start=None, **fields))

        def work():
            if not result.done():
                return RUNNING
            answer = result.result().result
            self.codes['planner'], self.path_message = answer.error_code, answer.path
            self.answers.append(next((each for each in ('continued', 'diverted', 'arrived')
                                      if each in answer.error_msg), 'new'))
            self.path = [(each.pose.position.x, each.pose.position.y) for each in answer.path.poses]
            return SUCCESS if self.path else FAILURE

        work.halt = lambda: planner.cancel(handle)
        return work

    def follow_path(self, ports):
        followed, ahead = [], []

        def work():
            nonlocal followed, ahead
            if self.path is not followed:  # it goes on from where the robot is by now
                near = [self.away(each) for each in self.path[:100]]
                followed, ahead = self.path, self.path[near.index(min(near)):]
            left = SPEED * PERIOD
            while ahead and left > 0.0:
                step = self.away(ahead[0])
                self.place = self.place + (ahead[0] - self.place) * min(1.0, left / max(step, 1e-9))
                left -= step
                ahead = ahead[left >= 0.0:]
            return SUCCESS if self.away(followed[-1]) <= REACHED else RUNNING
        return work

    def drive(self, text, goals, then=lambda: None):
        """Navigate; ``then()`` may return new goals. Return the tree's status in the end."""
        self.goals = list(goals)
        tree = Tree(text, self.leaves, self.clock)
        self.numbers = tree.numbers
        while True:
            self.robot.is_at(*self.place)
            self.goals = list(then() or self.goals)
            if (status := tree.tick()) != RUNNING:
                return status
            self.now += PERIOD
            time.sleep(PERIOD)


def test_a_new_goal_shortly_before_the_old_one_is_driven_to():
    first, second = (11.5, 10.0), (18.0, 3.0)
    with stage(parameters={**ROBOT, **QUICK}) as running:
        drive = Drive(running, (1.5, 10.0))
        assert drive.drive(POSE, [first], lambda: drive.away(first) < 1.0 and [second]) == SUCCESS
        assert drive.away(second) <= REACHED
        assert drive.answers[0] == 'new' and 'new' in drive.answers[1:]


# As Nav2's tree does: it asks every three seconds, takes stops off only then, and ends with the
# controller.
SELDOM = """<root BTCPP_format="4" main_tree_to_execute="Nav2"><BehaviorTree ID="Nav2">
<PipelineSequence><RateController hz="0.333"><Sequence><RemovePassedGoals radius="0.7"/>
<ComputePathThroughPoses/></Sequence></RateController><FollowPath/></PipelineSequence>
</BehaviorTree></root>"""


@pytest.mark.parametrize('tree', [POSES, SELDOM], ids=['ours', 'as in Nav2'])
def test_each_tour_is_one_departure(tree):
    """Also if the last requests still name stops, and if the next tour begins at once."""
    stops, ends = [(8.0, 16.0), (14.0, 8.0)], [(2.0, 6.0), (18.0, 12.0)]
    with stage(parameters={**ROBOT, **QUICK}) as running:
        drive = Drive(running, (1.5, 12.0))
        for tour, end in enumerate(ends, 1):
            assert drive.drive(tree, [*stops, end]) == SUCCESS
            assert drive.away(end) <= REACHED
            drive.client.diagnostics(departures=str(tour))
        assert drive.answers.count('new') == len(ends), drive.answers
        assert tree == SELDOM or drive.goals == [ends[-1]], 'the stops have been passed'

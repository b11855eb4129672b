"""Postures of an arm with its tool upright: where the tip is, how far they reach, and what is between the nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.small_tasks import joints_at, shipped

from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.geometry.postures import STEP, halved, postures_of
from oimppi_warp.geometry.reach import reach_of, tip_rates


@pytest.mark.parametrize("name", ["task01", "arm7_01", "point01"])
def test_a_posture_has_its_tip_at_its_node_and_its_tool_upright(name: str):
    robot = shipped(name).robot
    found = postures_of(robot, 0.08)
    nodes = np.argwhere(found.reached)
    for node in nodes[:: max(len(nodes) // 60, 1)]:
        rotation, tip = tip_frame(robot, found.joints[tuple(node)])
        wanted = found.origin + STEP * node
        if name == "point01":  # cannot lift its tool
            wanted[2] = tip[2]
        np.testing.assert_allclose(tip, wanted, atol=1.1e-3)
        np.testing.assert_allclose(rotation[:, 2], [0.0, 0.0, -1.0], atol=2e-3)


def test_postures_reach_as_far_as_the_arm():
    robot = shipped("task01").robot
    found = postures_of(robot, 0.08)
    nodes = found.origin[:2] + STEP * np.argwhere(found.reached[:, :, 0])
    assert np.hypot(*nodes.T).max() == pytest.approx(reach_of(robot).radius, abs=1.5 * STEP)
    assert found.reached[:, :, 0].mean() > 0.6


def test_postures_keep_the_joints_within_their_limits():
    robot = shipped("task01").robot
    tight = replace(robot, joints=tuple(replace(j, lower=max(j.lower, -1.2), upper=1.2) for j in robot.joints))
    found = postures_of(tight, 0.08)
    joints = found.joints[found.reached]
    assert 0 < len(joints) < postures_of(robot, 0.08).reached.sum()
    assert (np.abs(joints) <= 1.2 + 1e-9).all()


def test_between_nodes_a_posture_is_off_by_half_a_millimetre():
    robot = shipped("task01").robot
    found = postures_of(robot, 0.08)
    fine, reached = halved(found.joints, jump=1.5), halved(found.reached[..., None].astype(float))[..., 0] == 1.0
    nodes = np.argwhere(reached)
    radius = np.hypot(*(found.origin[:2, None] + 0.5 * STEP * nodes.T[:2]))
    nodes = nodes[(radius > 0.25) & (radius < 0.65)]
    off = np.array(
        [
            np.linalg.norm(tip_frame(robot, fine[tuple(node)])[1] - found.origin - 0.5 * STEP * node)
            for node in nodes[:: len(nodes) // 1000]
        ]
    )
    # On the far side, where the first joint's two half turns meet, the posture between is that of one of the nodes.
    assert np.quantile(off, 0.98) < 6e-4 and off.max() < 0.012


def test_the_effort_is_what_the_joints_do_for_a_speed_of_the_tip():
    robot = shipped("task01").robot
    found = postures_of(robot, 0.08)
    joints = joints_at(robot, (0.46, 0.12, 0.02))
    node = tuple(np.round((np.array([0.46, 0.12, 0.02]) - found.origin) / STEP).astype(int))
    inverse = np.linalg.pinv(np.vstack(tip_rates(robot, joints)))
    np.testing.assert_allclose(found.effort[node], np.linalg.norm(inverse[:, :2], axis=1), rtol=0.02, atol=1e-3)


def test_what_lies_between_two_turns_of_a_joint_is_not_interpolated():
    values = np.array([3.0, -3.0, -2.0]).reshape(3, 1, 1, 1)
    np.testing.assert_array_equal(halved(values, jump=1.5).ravel(), [3.0, 3.0, -3.0, -2.5, -2.0])


def test_a_start_at_the_edge_of_reach_has_postures():
    robot = shipped("point01").robot
    edge = np.array([joint.upper for joint in robot.joints])
    assert postures_of(replace(robot, start=edge), 0.05).reached.any()


def test_without_a_posture_the_joints_are_those_of_the_nearest_node():
    found = postures_of(shipped("task01").robot, 0.05)
    assert not found.reached.all()
    jumps = np.abs(np.diff(found.joints[:, :, 0], axis=1)).max(axis=-1)
    assert np.mean(jumps > 1.5) < 0.02, "only where the first joint's two half turns meet"

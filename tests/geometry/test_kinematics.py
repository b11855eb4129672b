"""The arm on the host against its twin and finite differences, and the spheres that stand for its links."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import reference
from support.small_tasks import joints_at, shipped, straight

from oimppi_warp.geometry.footprint import collider_mesh
from oimppi_warp.geometry.kinematics import collider_spheres, link_frames, pack_arm, tip_frame, tip_jacobian
from oimppi_warp.scene import Collider

RANDOM = np.random.default_rng(11)
ROBOT = shipped("task01").robot
TABLED = [
    # joints [rad], position of the flange [m], quaternion xyzw: the published figures of the xArm6
    ([0, 0, 0, 0, 0, 0], [0.207, 0, 0.112], [1, 0, 0, 0]),
    ([0, -0.5, -0.5, 0, 1, 0], [0.316631342, 0, 0.325481967], [1, 0, 0, 0]),
    (
        [0.3, -0.7, -0.9, 0.4, 1.2, -0.6],
        [0.28448602, 0.113628607, 0.551744586],
        [-0.879594496, -0.387392031, -0.221779591, 0.16448328],
    ),
]


def random_joints() -> np.ndarray:
    return RANDOM.uniform([joint.lower for joint in ROBOT.joints], [joint.upper for joint in ROBOT.joints])


@pytest.mark.parametrize(("joints", "position", "quaternion"), TABLED)
def test_the_flange_is_where_the_xarm6s_tables_have_it(joints, position, quaternion):
    rotations, positions = link_frames(ROBOT, np.array(joints, dtype=float))
    np.testing.assert_allclose(positions[-1], position, atol=1e-6)
    np.testing.assert_allclose(rotations[-1], Rotation.from_quat(quaternion).as_matrix(), atol=1e-6)


def test_link_and_tip_frames_are_their_twins():
    for _ in range(20):
        joints = random_joints()
        rotations, positions = link_frames(ROBOT, joints)
        for rotation, position, frame in zip(rotations, positions, reference.link_frames(ROBOT, joints), strict=True):
            np.testing.assert_allclose(rotation, frame[:3, :3], atol=1e-12)
            np.testing.assert_allclose(position, frame[:3, 3], atol=1e-12)
        rotation, position = tip_frame(ROBOT, joints)
        np.testing.assert_allclose(rotation, reference.tip_frame(ROBOT, joints)[:3, :3], atol=1e-12)
        np.testing.assert_allclose(position, reference.tip_frame(ROBOT, joints)[:3, 3], atol=1e-12)


def test_the_tips_jacobian_is_its_finite_difference():
    for _ in range(10):
        joints = random_joints()
        jacobian = tip_jacobian(ROBOT, joints)
        for j, step in enumerate(1e-6 * np.eye(ROBOT.dof)):
            after, before = (reference.tip_frame(ROBOT, joints + sign * step) for sign in (1.0, -1.0))
            linear = (after[:3, 3] - before[:3, 3]) / 2e-6
            angular = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec() / 2e-6
            np.testing.assert_allclose(jacobian[:, j], [*linear, *angular], atol=1e-7)


def test_the_packed_arm_has_the_robots_limits_and_frames(device: str):
    speed = np.linspace(0.1, 0.6, ROBOT.dof)
    arm = pack_arm(ROBOT, speed, device)
    np.testing.assert_allclose(arm.speed.numpy(), speed, rtol=1e-6)
    np.testing.assert_allclose(arm.lower.numpy(), [joint.lower for joint in ROBOT.joints], rtol=1e-6)
    np.testing.assert_allclose(arm.upper.numpy(), [joint.upper for joint in ROBOT.joints], rtol=1e-6)
    first = arm.first_sphere.numpy()
    assert first[0] == 0
    assert first[-1] == len(arm.sphere.numpy())
    for link, start, end in zip(ROBOT.links, first[:-1], first[1:], strict=True):
        expected = sum(len(collider_spheres(collider)) for collider in link.colliders)
        assert end - start == expected, link.path


def capsule(radius: float, half: float) -> Collider:
    turn = Rotation.from_euler("xy", [0.4, -0.9]).as_quat()
    return Collider("/c", "capsule", np.array([0.1, -0.2, 0.3, *turn]), (radius, half))


@pytest.mark.parametrize(("radius", "half"), [(0.045, 0.06), (0.03, 0.005), (0.008, 0.08)])
def test_a_capsules_spheres_lie_in_it_and_leave_no_gap(radius, half):
    shape = capsule(radius, half)
    spheres = collider_spheres(shape)
    np.testing.assert_allclose(spheres[:, 3], radius)
    axis = Rotation.from_quat(shape.transform[3:]).apply([0.0, 0.0, 1.0])
    along = (spheres[:, :3] - shape.transform[:3]) @ axis
    np.testing.assert_allclose([along.min(), along.max()], [-half, half], atol=1e-9)
    np.testing.assert_allclose(spheres[:, :3], shape.transform[:3] + np.outer(along, axis), atol=1e-9)
    assert np.diff(np.sort(along)).max(initial=0.0) <= max(radius, 0.03) + 1e-9


@pytest.mark.parametrize("kind", ["box", "cylinder"])
def test_a_long_shapes_spheres_cover_its_middle(kind):
    size = (0.02, 0.03, 0.15) if kind == "box" else (0.03, 0.15)
    shape = Collider("/c", kind, np.array([0, 0, 0.2, 0, 0, 0, 1.0]), size)
    spheres = collider_spheres(shape)
    inside = np.asarray(collider_mesh(shape).sample(400, seed=1))
    middle = inside[np.abs(inside[:, 2] - 0.2) < 0.10]
    covered = np.linalg.norm(middle[:, None] - spheres[None, :, :3], axis=2) <= spheres[:, 3] + 0.005
    assert covered.any(axis=1).all()


def test_the_arm_keeps_clear_of_the_table_at_its_start():
    for name in ("task01", "task03"):
        spheres = reference.arm_spheres(shipped(name).robot, shipped(name).robot.start)
        assert (spheres[:, 2] - spheres[:, 3]).min() > 0.0, name


def test_the_arm_moves_its_tip_straight_on():
    joints = joints_at(ROBOT, (0.4, -0.2, 0.05))
    for control in straight(ROBOT, joints, (0.0, 0.1, 0.0), 20):
        joints = joints + 0.05 * control
    np.testing.assert_allclose(tip_frame(ROBOT, joints)[1], [0.4, -0.1, 0.05], atol=2e-3)
    np.testing.assert_allclose(tip_frame(ROBOT, joints)[0][:, 2], [0.0, 0.0, -1.0], atol=5e-3)

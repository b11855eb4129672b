"""The arm's kinematics on the host (forward kinematics and Jacobian in float64), and its packing for the kernels."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import warp as wp

from oimppi_warp.geometry.footprint import core_points, rotation_matrix
from oimppi_warp.kernels.kinematics import Arm
from oimppi_warp.scene import Collider, Link, Robot

SPHERE_SPACING = 0.03
"""Smallest spacing of the spheres that approximate a link [m]."""
_TOUCHING = 1e-3
"""Height below which a link's shapes touch the table [m]."""
ROUNDED_ANGLE = 0.01
"""Angle below which axes count as parallel [rad]: people round the angles in a robot's file, as in 3.14 or 1.57."""
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]
"""Cyclic successors of the axes x, y and z, and theirs."""


def link_frames(robot: Robot, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the frames of all links.

    Args:
        robot: The arm.
        joints: Joint positions, shape [..., dof] [rad; m for a prismatic joint].

    Returns:
        Rotations [..., dof, 3, 3] and positions [..., dof, 3] in the world frame [m]; read-only for a single posture.
    """
    if np.ndim(joints) == 1:
        return _frames_at(robot, np.asarray(joints, dtype=float).tobytes())
    return _frames(robot, joints)


@lru_cache(maxsize=8)
def _frames_at(robot: Robot, joints: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Returns the frames at a posture; a control step asks for those of its posture several times."""
    frames = _frames(robot, np.frombuffer(joints))
    for part in frames:
        part.flags.writeable = False
    return frames


def _frames(robot: Robot, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Computes the frames of all links; see :func:`link_frames`."""
    rest, step, revolute = _rest_transforms(robot), np.zeros((*np.shape(joints), 4, 4)), revolute_joints(robot)
    angles = np.where(revolute, joints, 0.0)
    c, s = np.cos(angles), np.sin(angles)
    step[..., 0, 0], step[..., 0, 1], step[..., 1, 0], step[..., 1, 1] = c, -s, s, c
    step[..., 2, 2] = step[..., 3, 3] = 1.0
    step[..., 2, 3] = np.where(revolute, 0.0, joints)
    frames = rest @ step
    for j in range(1, robot.dof):
        frames[..., j, :, :] = frames[..., j - 1, :, :] @ frames[..., j, :, :]
    return frames[..., :3, :3], frames[..., :3, 3]


@lru_cache(maxsize=8)
def revolute_joints(robot: Robot) -> np.ndarray:
    """Returns whether each joint is revolute (otherwise it is prismatic), shape [dof]."""
    return np.array([joint.kind == "revolute" for joint in robot.joints])


@lru_cache(maxsize=8)
def _rest_transforms(robot: Robot) -> np.ndarray:
    """Returns the transform of each joint's frame in its parent's at position zero, shape [dof, 4, 4] [m]."""
    rest = np.tile(np.eye(4), (robot.dof, 1, 1))
    for transform, joint in zip(rest, robot.joints, strict=True):
        transform[:3, :3] = rotation_matrix(joint.parent_transform[3:])
        transform[:3, 3] = joint.parent_transform[:3]
    return rest


def tip_frame(robot: Robot, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns rotation, shape [3, 3], and position, shape [3] [m], of the tool's tip in the world frame; read-only.

    Args:
        robot: The arm.
        joints: Joint positions, shape [dof] [rad; m for a prismatic joint].
    """
    return _tip_at(robot, np.asarray(joints, dtype=float).tobytes())


@lru_cache(maxsize=8)
def _tip_at(robot: Robot, joints: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Returns the tip's frame at a posture; like :func:`_frames_at`."""
    rotations, positions = _frames_at(robot, joints)
    found = rotations[-1] @ _tip_rotation(robot), positions[-1] + rotations[-1] @ robot.tip[:3]
    for part in found:
        part.flags.writeable = False
    return found


@lru_cache(maxsize=8)
def _tip_rotation(robot: Robot) -> np.ndarray:
    """Returns the rotation of the tip in the last link's frame, shape [3, 3]."""
    return rotation_matrix(robot.tip[3:])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the cross products of vectors, shape [..., 3]: ``np.cross`` at a fraction of its overhead."""
    return a[..., _NEXT] * b[..., _AFTER] - a[..., _AFTER] * b[..., _NEXT]


def tip_jacobian(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Returns the Jacobian of the tip's linear and angular velocity in the world frame, shape [6, dof].

    Args:
        robot: The arm.
        joints: Joint positions, shape [dof] [rad; m for a prismatic joint].
    """
    rotations, positions = link_frames(robot, joints)
    tip = positions[-1] + rotations[-1] @ robot.tip[:3]
    axes, revolute = rotations[:, :, 2], revolute_joints(robot)[:, None]
    linear = np.where(revolute, cross(axes, tip - positions), axes)
    return np.concatenate([linear, np.where(revolute, axes, 0.0)], axis=1).T


@lru_cache(maxsize=8)
def is_level(robot: Robot) -> np.ndarray:
    """Returns which links no joint raises, lowers or tilts, such as a turret on a vertical axis, shape [dof].

    They are the first links, as long as revolute axes are vertical and prismatic ones horizontal, up to
    :data:`ROUNDED_ANGLE`.
    """
    axes = link_frames(robot, np.zeros(robot.dof))[0][:, :, 2]
    upright, flat = parallel(axes, np.array([0.0, 0.0, 1.0])), np.abs(axes[:, 2]) < np.sin(ROUNDED_ANGLE)
    return np.logical_and.accumulate(np.where(revolute_joints(robot), upright, flat))


def parallel(axes: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Returns which unit vectors, shape [..., 3], are parallel to another or opposite, up to :data:`ROUNDED_ANGLE`."""
    return np.linalg.norm(np.cross(axes, axis), axis=-1) < np.sin(ROUNDED_ANGLE)


def link_heights(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Returns the height of the lowest point of each link's shapes, shape [dof] [m]; infinite without shapes.

    Args:
        robot: The arm.
        joints: Joint positions, shape [dof] [rad; m for a prismatic joint].
    """
    rotations, positions = link_frames(robot, joints)
    heights = np.full(robot.dof, np.inf)
    for number, link in enumerate(robot.links):
        for collider in link.colliders:
            points, radius = core_points(collider)
            low = positions[number][2] + (points @ rotations[number][2]).min() - radius
            heights[number] = min(heights[number], low)
    return heights


@lru_cache(maxsize=8)
def touching_turret(robot: Robot) -> tuple[Link, ...]:
    """Returns the links that no joint can lower (:func:`is_level`) and whose shapes reach down to the table, at z = 0.

    They turn where they stand. A flat robot, whose links are all of this kind, has none.
    """
    low = is_level(robot) & (link_heights(robot, robot.start) < _TOUCHING)
    return tuple(link for link, touches in zip(robot.links, low, strict=True) if touches and not is_level(robot).all())


def collider_spheres(collider: Collider) -> np.ndarray:
    """Returns spheres (centre, radius) that cover a shape along its longest axis, shape [n, 4] [m].

    The centres are in the frame of the shape's body.
    """
    points, radius = core_points(collider)
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
    along = (points - middle) @ axes[0]
    across = np.linalg.norm(points - middle - np.outer(along, axes[0]), axis=1)
    radius = radius + float(across.max())
    ends = (along.min(), along.max()) if collider.kind == "capsule" else (along.min() + radius, along.max() - radius)
    if ends[1] <= ends[0]:
        return np.array([[*middle, max(radius, float(np.abs(along).max()))]])
    count = int(np.ceil((ends[1] - ends[0]) / max(radius, SPHERE_SPACING))) + 1
    centers = middle + np.outer(np.linspace(*ends, count), axes[0])
    return np.column_stack([centers, np.full(count, radius)])


def pack_arm(robot: Robot, speed: np.ndarray, device: str) -> Arm:
    """Packs the arm for the kernels.

    Args:
        robot: The arm.
        speed: Joint velocity limits to plan with, shape [dof] [rad/s; m/s for a prismatic joint].
        device: Warp device.
    """
    spheres = [np.concatenate([np.zeros((0, 4)), *map(collider_spheres, link.colliders)]) for link in robot.links]
    arm = Arm()
    rest = _rest_transforms(robot)
    arm.rotation = wp.array(rest[:, :3, :3].copy(), dtype=wp.mat33, device=device)
    arm.position = wp.array(rest[:, :3, 3].copy(), dtype=wp.vec3, device=device)
    arm.lower = wp.array([joint.lower for joint in robot.joints], dtype=float, device=device)
    arm.upper = wp.array([joint.upper for joint in robot.joints], dtype=float, device=device)
    arm.speed = wp.array(np.asarray(speed, dtype=np.float32), dtype=float, device=device)
    arm.tip_position = wp.vec3(*robot.tip[:3])
    arm.tip_rotation = wp.mat33(*rotation_matrix(robot.tip[3:]).ravel())
    arm.sphere = wp.array(np.concatenate(spheres), dtype=wp.vec4, device=device)
    arm.first_sphere = wp.array(np.cumsum([0, *map(len, spheres)]), dtype=int, device=device)
    arm.turret = int(is_level(robot).sum())
    arm.hull = wp.array(np.array([enclosing_sphere(balls) for balls in spheres]), dtype=wp.vec4, device=device)
    return arm


def enclosing_sphere(spheres: np.ndarray) -> np.ndarray:
    """Returns a small sphere (centre, radius) that encloses all given ones, shape [4] [m]; all zero without spheres.

    Args:
        spheres: Centres and radii, shape [n, 4] [m].
    """
    if not len(spheres):
        return np.zeros(4)
    centers, radii = spheres[:, :3], spheres[:, 3]
    # Its centre is that of the bounding box, or that of the two spheres furthest apart, whichever is tighter.
    low, high = (centers - radii[:, None]).min(axis=0), (centers + radii[:, None]).max(axis=0)
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1)
    ends = centers[list(np.unravel_index(np.argmax(apart), apart.shape))]
    candidates = np.array([(low + high) / 2, ends.mean(axis=0)])
    reach = (np.linalg.norm(candidates[:, None] - centers, axis=-1) + radii).max(axis=1)
    best = int(np.argmin(reach))
    return np.append(candidates[best], reach[best])

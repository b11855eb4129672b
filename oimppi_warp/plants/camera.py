"""What a camera above the table sees: an object is seen unless the arm is in the line of sight."""

from __future__ import annotations

import numpy as np

from oimppi_warp.geometry.footprint import footprint, height_range, outline, planar_points, transform_points
from oimppi_warp.geometry.kinematics import collider_spheres, link_frames
from oimppi_warp.scene import Collider, Robot, Scene

SEEN_SHARE = 0.5
"""Share of an object's points that must be in sight for it to be recognised."""
_POINTS = 12
"""Points of the outline of an object's top that are looked for."""


class Camera:
    """A camera with the table in its field of view.

    Args:
        scene: The task.
        position: Of the camera [m].
    """

    def __init__(self, scene: Scene, position: tuple[float, float, float]) -> None:
        self._robot = scene.robot
        self._position = np.array(position)
        self._capsules = [arm_capsules(colliders) for colliders in _by_link(scene.robot)]
        rim = outline(footprint(scene.object.colliders)).convex_hull.boundary
        along = (np.arange(_POINTS) + 0.5) / _POINTS
        ring = np.array([rim.interpolate(share, normalized=True).coords[0] for share in along])
        self._ring = np.concatenate([ring, ring.mean(axis=0, keepdims=True)])
        self._height = scene.object.rest_height + height_range(scene.object.colliders)[1]

    def sees(self, joints: np.ndarray, pose: np.ndarray) -> bool:
        """Whether enough of the object at a planar pose [3] is in sight past the arm at joint positions [dof] [rad]."""
        return self.share_seen(joints, pose) >= SEEN_SHARE

    def share_seen(self, joints: np.ndarray, pose: np.ndarray) -> float:
        """Share of the points of the object's top, its outline and its middle, with no part of the arm before them."""
        top = planar_points(pose, self._ring)
        points = np.column_stack([top, np.full(len(top), self._height)])
        ends, radii = self._placed(joints)
        gaps = segment_distances(self._position, points, ends[:, 0], ends[:, 1])
        return float((gaps > radii).all(axis=1).mean())

    def _placed(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The arm's capsules in the world: ends [n, 2, 3] and radii [n] [m]."""
        rotations, positions = link_frames(self._robot, joints)
        rotations, positions = np.concatenate([np.eye(3)[None], rotations]), np.vstack([np.zeros(3), positions])
        ends, radii = [], []
        for (local, radius), rotation, position in zip(self._capsules, rotations, positions, strict=True):
            ends.append(local @ rotation.T + position)
            radii.append(radius)
        return np.concatenate(ends), np.concatenate(radii)


def arm_capsules(colliders: tuple[Collider, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Capsules that stand for colliders, in their frame.

    Capsules are taken as they are, other shapes as the spheres along their longest axis.

    Returns:
        Ends of the axes [n, 2, 3] and radii [n] [m].
    """
    ends, radii = [np.zeros((0, 2, 3))], [np.zeros(0)]
    for collider in colliders:
        if collider.kind == "capsule":
            radius, half = collider.size
            axis = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
            ends.append(transform_points(collider.transform, axis)[None])
            radii.append(np.array([radius]))
        else:
            balls = collider_spheres(collider)
            ends.append(np.repeat(balls[:, None, :3], 2, axis=1))
            radii.append(balls[:, 3])
    return np.concatenate(ends), np.concatenate(radii)


def segment_distances(eye: np.ndarray, points: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Distances of lines of sight and segments.

    Args:
        eye: Where the lines of sight begin, shape [3] [m].
        points: Where they end, shape [m, 3].
        begins, ends: Of the segments, shape [n, 3] each.

    Returns:
        Shape [m, n] [m].
    """
    sight, axis = (points - eye)[:, None], (ends - begins)[None]
    offset = (eye - begins)[None]
    a, e = (sight * sight).sum(-1), (axis * axis).sum(-1)
    b, c, f = (sight * axis).sum(-1), (sight * offset).sum(-1), (axis * offset).sum(-1)
    # The closest points of two segments: the best place along one, clamped, then along the other, and back once more.
    slack = a * e - b * b
    s = np.clip(np.divide(b * f - c * e, slack, out=np.zeros_like(slack), where=slack > 1e-12), 0.0, 1.0)
    t = np.clip(np.divide(b * s + f, e, out=np.zeros_like(s), where=e > 1e-12), 0.0, 1.0)
    s = np.clip((b * t - c) / np.maximum(a, 1e-12), 0.0, 1.0)
    return np.linalg.norm(offset + s[..., None] * sight - t[..., None] * axis, axis=-1)


def _by_link(robot: Robot) -> list[tuple[Collider, ...]]:
    """Colliders of the base and of each moving link."""
    return [robot.base.colliders, *(link.colliders for link in robot.links)]

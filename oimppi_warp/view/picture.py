"""The data displayed for one moment of an episode."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from oimppi_warp.observation import planar_transform
from oimppi_warp.scene import Scene


def _none(*shape: int) -> np.ndarray:
    return np.zeros(shape)


@dataclass(frozen=True, eq=False)
class Picture:
    """A snapshot of an episode, live or recorded.

    Attributes:
        scene: The task.
        time: Time since the start of the episode [s].
        joints: Joint positions, shape [dof] [rad].
        object_transform: Transform of the object's frame, shape [7].
        reference: Object poses that the robot level tracks, shape [n, 3].
        tips: Tool tip along the plan, shape [n, 3] [m].
        sampled: Tool paths of some samples, shape [k, n, 3] [m], the cheapest first.
        weights: Their weights relative to the largest one, shape [k].
        contact_points: Contact points, and the forces on the touched bodies, shape [n, 6] [m, N].
        kept_apart: Nearest points of shapes that the safety filter keeps apart, shape [n, 2, 3] [m].
        terms: Weighted cost terms of the cheapest sample, by name.
        figures: Values plotted over time, by name and unit.
        status: A one-line status message.
    """

    scene: Scene
    time: float
    joints: np.ndarray
    object_transform: np.ndarray
    reference: np.ndarray = field(default_factory=lambda: _none(0, 3))
    tips: np.ndarray = field(default_factory=lambda: _none(0, 3))
    sampled: np.ndarray = field(default_factory=lambda: _none(0, 0, 3))
    weights: np.ndarray = field(default_factory=lambda: _none(0))
    contact_points: np.ndarray = field(default_factory=lambda: _none(0, 6))
    kept_apart: np.ndarray = field(default_factory=lambda: _none(0, 2, 3))
    terms: dict[str, float] = field(default_factory=dict)
    figures: dict[str, float] = field(default_factory=dict)
    status: str = ""

    @classmethod
    def of_start(cls, scene: Scene) -> Picture:
        """Returns a picture of arm and object where the scene has them at the start."""
        transform = planar_transform(scene.start, scene.object.rest_height)
        return cls(scene, 0.0, scene.robot.start, transform)

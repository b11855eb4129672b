"""Estimation of the object's pose from detections and, between them, from the arm's measured motion.

Predictions use the planner's model, a quasi-static push along the tool's measured path. A detection refers to a past
time: it corrects the prediction at that time, and the corrected pose is rolled forward along the recorded joint
positions to the present. A detection that contradicts the prediction is rejected, unless the next one confirms it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import warp as wp

from oimppi_warp.config.settings import Config
from oimppi_warp.geometry.fields import build_geometry, from_center, to_center
from oimppi_warp.geometry.footprint import wrap_angle
from oimppi_warp.geometry.kinematics import pack_arm
from oimppi_warp.kernels.tracking import make_track_object
from oimppi_warp.observation import (
    BEYOND_LIMITS,
    FARTHEST_OBJECT,
    Observation,
    beyond_limits,
    check_shapes,
    planar_transform,
)
from oimppi_warp.planning.engines.dynamics import control_type
from oimppi_warp.planning.engines.packing import environment, object_model, velocity_bound
from oimppi_warp.scene import Scene

_CAPACITY = 1024
"""Number of joint positions that are kept."""
_AHEAD = 256
"""Number of steps of a prediction of the future: enough for two of the longest control periods."""
_STEP = 0.0125
"""Length of these steps [s]."""

Event = Literal["none", "first", "accepted", "rejected", "recovered"]
"""Result of processing a detection: there was none, it awaits confirmation by another, it corrected the prediction, it
was rejected, or it replaced the prediction together with the detection before."""


@dataclass(eq=False)
class _Track:
    """One estimate of the object's pose, at each kept joint position.

    Attributes:
        poses: Poses of the friction centre, [_CAPACITY].
        gaps: Gaps between tool and object [m], [_CAPACITY].
        spread: Standard deviation of the error, in position [m] and yaw [rad], shape [_CAPACITY, 2].
        first, count: Entries from ``first`` up to, not including, ``count`` are known.
    """

    poses: wp.array
    gaps: wp.array
    spread: np.ndarray
    first: int
    count: int


class Estimator:
    """Estimates the object's pose, for a planner, from the observations of a plant.

    Args:
        scene: The task.
        config: All settings.

    Attributes:
        event: Result of processing the newest detection, if the latest observation contained one.
    """

    def __init__(self, scene: Scene, config: Config) -> None:
        self._scene = scene
        self._config = config.estimator
        self._counts_yaw = math.isfinite(scene.tolerance.yaw)
        geometry = build_geometry(scene, "cpu")
        self._surface = geometry.surface
        self._arm = pack_arm(scene.robot, velocity_bound(scene, config.robot), "cpu")
        self._model = object_model(geometry, tool_friction=scene.object.tool_friction)
        self._environment = environment(scene, geometry, config.cost)
        self._contact_steps = config.robot.contact_steps
        self._kernel = make_track_object(scene.robot.chain)
        vec = control_type(scene.robot.dof)
        self._joints = wp.zeros(_CAPACITY, dtype=vec, device="cpu")
        self._range = wp.zeros(2, dtype=int, device="cpu")
        self._ahead = wp.zeros(_AHEAD, dtype=vec, device="cpu")
        self._ahead_track = self._new_track(_AHEAD)
        self._roll(self._ahead_track, self._ahead, 0, 1)  # compiles the kernel now, not during an episode
        self.reset()

    def reset(self) -> None:
        """Discards the estimate and all recorded data."""
        self.event: Event = "none"
        self._times = np.zeros(_CAPACITY)
        self._count = 0
        self._seen = math.nan
        self._believed: _Track | None = None
        self._rival: _Track | None = None

    def update(self, observation: Observation) -> Observation | None:
        """Updates the estimate with an observation.

        Args:
            observation: The plant's report; if its ``object_time`` is ``None``, it has the exact pose of the object,
                which becomes the estimate.

        Returns:
            The observation with the estimated pose in place of the reported one, or ``None`` while there is no
            estimate: the object has not been seen, no two detections have agreed, or joint positions are implausible.

        Raises:
            ObservationError: An array has the wrong length.
        """
        check_shapes(observation, self._scene.robot.dof)
        self.event = "none"
        if not self._plausible(observation.joint_position):
            return None  # sensor error: the arm's effect on the object is unknown
        self._record(observation)
        if not self._count:
            return None
        seen = observation.object_time
        if seen is None:
            self._reset_to(to_center(self._surface, observation.object_pose))
            return observation
        if not math.isnan(seen) and seen != self._seen:
            self._seen = seen
            if np.isfinite(observation.object_pose).all() and np.hypot(*observation.object_pose[:2]) < FARTHEST_OBJECT:
                self._process(seen, to_center(self._surface, observation.object_pose))
            else:
                self.event = "rejected"
        if self._believed is None:
            return None
        return self._with_pose(observation, self._believed.poses.numpy()[self._count - 1])

    def predict(self, observation: Observation, pending: Sequence[tuple[float, np.ndarray]]) -> Observation:
        """Predicts the observation after a motion of the arm that is already decided.

        Args:
            observation: The current estimate, from :meth:`update`.
            pending: The motion, as pairs of duration [s] and joint velocities, shape [dof] [rad/s; m/s for a prismatic
                joint].
        """
        durations = np.array([duration for duration, _ in pending])
        velocities = np.array([velocity for _, velocity in pending])
        total = float(durations.sum())
        if total == 0.0:
            return observation
        ends = np.concatenate([[0.0], np.cumsum(durations)])
        path = observation.joint_position + np.vstack(
            [0.0 * velocities[:1], np.cumsum(durations[:, None] * velocities, axis=0)]
        )
        at = np.linspace(0.0, total, math.ceil(total / _STEP - 1e-9) + 1)
        joints = np.column_stack([np.interp(at, ends, positions) for positions in path.T])
        track = self._ahead_track
        self._ahead.numpy()[: len(joints)] = joints
        track.poses.numpy()[0] = to_center(self._surface, observation.object_pose)
        self._roll(track, self._ahead, 0, len(joints))
        moved = replace(
            observation,
            time=observation.time + total,
            joint_position=joints[-1],
            joint_velocity=velocities[-1],
        )
        return self._with_pose(moved, track.poses.numpy()[len(joints) - 1])

    @property
    def spread(self) -> tuple[float, float]:
        """Returns the standard deviation of the estimated pose, in position [m] and yaw [rad]."""
        if self._believed is None:
            return math.inf, math.inf
        position, yaw = self._believed.spread[self._count - 1]
        return float(position), float(yaw)

    def _record(self, observation: Observation) -> None:
        """Stores the new joint positions and rolls the tracks forward."""
        rows = observation.trail
        if not len(rows):
            rows = np.concatenate([[observation.time], observation.joint_position])[None]
        rows = rows[np.isfinite(rows[:, 0]) & self._plausible(rows[:, 1:])]
        rows = rows[rows[:, 0] > self._times[self._count - 1]] if self._count else rows
        if self._count + len(rows) > _CAPACITY:
            self._forget(rows[-1, 0] - self._config.memory)
        fresh = slice(self._count, self._count + len(rows))
        self._times[fresh] = rows[:, 0]
        self._joints.numpy()[fresh] = rows[:, 1:]
        self._count += len(rows)
        for track in (self._believed, self._rival):
            if track is not None:
                self._follow(track, track.count - 1)

    def _plausible(self, joint_position: np.ndarray) -> np.ndarray:
        """Returns whether joint positions [..., dof] are plausible, shape [...]."""
        finite = np.isfinite(joint_position).all(axis=-1)
        within = (beyond_limits(self._scene.robot, joint_position) <= BEYOND_LIMITS).all(axis=-1)
        return np.logical_and(finite, within)

    def _forget(self, before: float) -> None:
        """Drops entries older than a time [s]."""
        first = int(np.searchsorted(self._times[: self._count], before))
        first = max(first, self._count - _CAPACITY // 2)
        kept = self._count - first
        arrays = [self._times, self._joints.numpy()]
        for track in (self._believed, self._rival):
            if track is not None:
                arrays += [track.poses.numpy(), track.gaps.numpy(), track.spread]
                track.first, track.count = max(track.first - first, 0), track.count - first
        for array in arrays:
            array[:kept] = array[first : self._count].copy()
        self._count = kept

    def _reset_to(self, pose: np.ndarray) -> None:
        """Resets the estimate to a planar pose of the friction centre, shape [3] [m, m, rad], at the current time."""
        at = self._count - 1
        if self._believed is None:
            self._believed = self._new_track(_CAPACITY)
        self._believed.first, self._believed.count = at, self._count
        self._believed.poses.numpy()[at] = pose
        self._believed.spread[at] = 0.0

    def _process(self, seen: float, pose: np.ndarray) -> None:
        """Processes a detection: the pose of the friction centre, shape [3] [m, m, rad], at the time ``seen`` [s]."""
        at = int(np.argmin(np.abs(self._times[: self._count] - seen)))
        if seen < self._times[0] - 1e-6:
            at = 0 if self._believed is None else -1  # older than all entries: only usable as the first detection
        if at < 0:
            return
        if self._believed is not None and self._agrees(self._believed, at, pose):
            self._correct(self._believed, at, pose)
            self._rival, self.event = None, "accepted"
        elif self._rival is not None and self._agrees(self._rival, at, pose):
            self.event = "accepted" if self._believed is None else "recovered"
            self._believed, self._rival = self._rival, None
            self._correct(self._believed, at, pose)
        else:
            self.event = "first" if self._believed is None else "rejected"
            self._rival = self._start_track(at, pose)

    def _agrees(self, track: _Track, at: int, pose: np.ndarray) -> bool:
        """Returns whether a detection agrees with a track, within the uncertainty of both."""
        if at < track.first:
            return False
        off = pose - track.poses.numpy()[at]
        allowed = self._config.gate * np.hypot(track.spread[at], self._detection_spread)
        near = bool(np.hypot(off[0], off[1]) <= allowed[0])
        return near and (not self._counts_yaw or bool(abs(wrap_angle(off[2])) <= allowed[1]))

    def _start_track(self, at: int, pose: np.ndarray) -> _Track:
        """Returns a track that starts from one detection."""
        track = self._new_track(_CAPACITY)
        track.first, track.count = at, at + 1
        track.poses.numpy()[at] = pose
        track.spread[at] = self._detection_spread
        self._follow(track, at)
        return track

    def _correct(self, track: _Track, at: int, pose: np.ndarray) -> None:
        """Corrects a track by a detection at its entry, and rolls the track forward to the present."""
        poses = track.poses.numpy()
        spread, noise = track.spread[at] ** 2, self._detection_spread**2
        gain = spread / np.maximum(spread + noise, 1e-18)
        off = pose - poses[at]
        off[2] = wrap_angle(off[2])
        poses[at] += off * gain[[0, 0, 1]]
        track.spread[at] = np.sqrt(spread * (1.0 - gain))
        track.first = at
        self._follow(track, at)

    def _follow(self, track: _Track, begin: int) -> None:
        """Rolls a track forward from entry ``begin`` to the newest joint positions."""
        if begin + 1 < self._count:
            self._roll(track, self._joints, begin, self._count)
            config, poses, gaps = self._config, track.poses.numpy(), track.gaps.numpy()
            for i in range(begin + 1, self._count):
                moved = poses[i] - poses[i - 1]
                drift = (config.position_drift * math.hypot(moved[0], moved[1]), config.yaw_drift * abs(moved[2]))
                near = config.touch_drift**2 * (self._times[i] - self._times[i - 1]) * (gaps[i] < config.touch)
                lever = max(self._surface.radius, 1e-3)
                track.spread[i] = np.sqrt((track.spread[i - 1] + drift) ** 2 + near * np.array([1.0, 1.0 / lever**2]))
        track.count = self._count

    def _roll(self, track: _Track, joints: wp.array, begin: int, end: int) -> None:
        """Fills a track's poses and gaps after entry ``begin`` and before ``end``."""
        self._range.numpy()[:] = (begin, end)
        inputs = [self._arm, self._model, self._environment, joints, self._range, self._contact_steps]
        wp.launch(self._kernel, dim=1, inputs=inputs, outputs=[track.poses, track.gaps], device="cpu")

    def _new_track(self, size: int) -> _Track:
        poses = wp.zeros(size, dtype=wp.vec3, device="cpu")
        return _Track(poses, wp.zeros(size, dtype=float, device="cpu"), np.zeros((size, 2)), 0, 0)

    @property
    def _detection_spread(self) -> np.ndarray:
        return np.array([self._config.position_noise, self._config.yaw_noise])

    def _with_pose(self, observation: Observation, center: np.ndarray) -> Observation:
        """Returns an observation with another pose of the object, given by its friction centre."""
        x, y, yaw = from_center(self._surface, center.astype(float))
        transform = planar_transform((x, y, yaw), self._scene.object.rest_height)
        return replace(observation, object_pose=np.array([x, y, yaw]), object_transform=transform)

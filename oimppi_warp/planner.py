"""MPPI, SOI and CLOI: who replans when, and what the robot tracks (the paper's Algorithms 1 to 3).

All three are one robot-level MPPI that tracks a reference of object poses; they differ in where the reference comes
from. MPPI's is the goal itself, SOI's a plan made once before the robot moves, CLOI's a plan renewed every step.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from oimppi_warp.clearance import Geometry, build_geometry, from_center, to_center
from oimppi_warp.config import Config, Method, validate
from oimppi_warp.device import pick_device
from oimppi_warp.dynamics.object import ObjectDynamics
from oimppi_warp.dynamics.quasistatic import QuasistaticDynamics
from oimppi_warp.errors import ConfigError
from oimppi_warp.footprint import wrap_angle
from oimppi_warp.kernels import navigation
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.kinematics import tip_jacobian
from oimppi_warp.mppi import Mppi, Update
from oimppi_warp.navigation import build_to_go, descend
from oimppi_warp.plant import Observation
from oimppi_warp.scene import Scene

METHODS: tuple[Method, ...] = ("mppi", "soi", "cloi")
ENGINES = ("quasistatic",)

_ARRIVED = 0.01
"""Distance from the goal, turning counted, at which SOI's object plan is complete [m]."""
_DAMPING = 0.05
"""Damping of the Jacobian's pseudo-inverse: singular values below it are not inverted [m/rad]."""


@dataclass(frozen=True, eq=False)
class Plan:
    """One control step's plan.

    Attributes:
        command: Joint velocities to apply now, shape [dof] [rad/s].
        update: What the robot level found.
        object_update: What the object level found, if it planned.
        object_seconds: Wall time that the object level took [s].
        terms: Weighted cost terms of the robot's nominal, summed over the horizon.
        tips: Tool tip along the nominal, shape [horizon + 1, 3] [m].
        object_poses: The object along it, shape [horizon + 1, 3].
        reference: The object plan that was tracked, from the object's present pose on, shape [n, 3].
    """

    command: np.ndarray
    update: Update
    object_update: Update | None
    object_seconds: float
    terms: np.ndarray
    tips: np.ndarray
    object_poses: np.ndarray
    reference: np.ndarray


class ObjectLevel:
    """The object-level MPPI; all poses are of the object's friction centre."""

    def __init__(self, geometry: Geometry, goal: np.ndarray, config: Config, *, device: str, seed: int) -> None:
        self._dynamics = ObjectDynamics(
            geometry, config.object, config.object_cost, goal=goal, dt=config.control_period, device=device
        )
        self._mppi = Mppi(self._dynamics, config.object.mppi, seed=seed)
        self._level = config.object
        self._goal = goal
        self.setup_seconds = self._dynamics.setup_seconds

    def improve(self, pose: np.ndarray) -> tuple[Update, np.ndarray]:
        """One update from a pose [3], and the path [horizon + 1, 3] that the nominal then takes."""
        left = _difference(self._goal, pose) * [1.0, 1.0, self._level.yaw_length]
        share = 1.0
        if self._level.noise_range > 0.0:
            share = float(np.clip(np.linalg.norm(left) / self._level.noise_range, 0.1, 1.0))
        self._mppi.set_noise(np.diag(share * self._level.noise * self._dynamics.bound))
        self._dynamics.set_state(pose)
        update = self._mppi.step()
        path = self._dynamics.trace(self._mppi.nominal)
        self._mppi.shift()
        return update, path

    def reset(self) -> None:
        """Forgets the nominal."""
        self._mppi.reset()


class Planner:
    """Plain MPPI, and what SOI and CLOI have in common.

    Args:
        scene: The task.
        config: All settings.
        device: Warp device.
        seed: Of all noise; the same seed gives the same plans (on the CPU to the bit).
    """

    method: Method = "mppi"

    def __init__(self, scene: Scene, config: Config, *, device: str, seed: int) -> None:
        config = _for_task(config, scene)
        self.scene = scene
        self.config = config
        self.device = device
        self.geometry = build_geometry(scene, device)
        self.goal = to_center(self.geometry.surface, np.array(scene.goal))
        self.dynamics = QuasistaticDynamics(
            scene, self.geometry, config.robot, config.cost, dt=config.control_period, device=device
        )
        self.mppi = Mppi(self.dynamics, config.robot.mppi, seed=2 * seed + 1)

    def warm_up(self) -> None:
        """Compiles and loads every kernel, so that the first plan is as fast as the others."""
        start = np.array(self.scene.start)
        joints = self.scene.robot.start
        transform = np.array([*start[:2], self.scene.object.rest_height, 0.0, 0.0, 0.0, 1.0])
        self.plan(Observation(0.0, joints, np.zeros_like(joints), start, transform))

    def start(self, observation: Observation) -> float:
        """Prepares for an episode that begins with ``observation``; returns the wall time that planning took [s]."""
        self.mppi.reset()
        return 0.0

    def plan(self, observation: Observation) -> Plan:
        """Plans from an observation; each call is one control step."""
        pose = to_center(self.geometry.surface, observation.object_pose)
        began = time.perf_counter()
        object_update, reference = self._reference(pose)
        object_seconds = time.perf_counter() - began

        joints = observation.joint_position
        self.dynamics.set_state(joints, pose, self.goal, _fitted(reference, self.dynamics.reference_length))
        self.mppi.set_noise(self._noise(joints))
        update = self.mppi.step()
        command = self.mppi.nominal.numpy()[0].astype(float)
        trace = self.dynamics.trace(self.mppi.nominal)
        self.mppi.shift()
        surface = self.geometry.surface
        return Plan(
            command=command,
            update=update,
            object_update=object_update,
            object_seconds=object_seconds,
            terms=trace.terms,
            tips=trace.tips,
            object_poses=from_center(surface, trace.poses),
            reference=from_center(surface, reference),
        )

    def _reference(self, pose: np.ndarray) -> tuple[Update | None, np.ndarray]:
        """The object poses to track from now, of the friction centre, shape [n, 3], and what planning them found."""
        return None, self.goal[None]

    def _noise(self, joints: np.ndarray) -> np.ndarray:
        """A square root of the noise's covariance in joint space, shape [dof, dof]."""
        robot = self.config.robot
        if robot.noise_space == "joint":
            return robot.joint_noise * np.eye(self.scene.robot.dof)
        jacobian = tip_jacobian(self.scene.robot, joints)
        inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + _DAMPING**2 * np.eye(6))
        root = inverse * np.asarray(robot.tool_noise)
        if root.shape[0] != root.shape[1]:
            root = np.linalg.cholesky(root @ root.T + 1e-8 * np.eye(len(root)))
        return root


class SequentialPlanner(Planner):
    """SOI-MPPI (Algorithm 3): one object plan to the goal before the robot moves, then tracked."""

    method: Method = "soi"

    def __init__(self, scene: Scene, config: Config, *, device: str, seed: int) -> None:
        super().__init__(scene, config, device=device, seed=seed)
        self._object = ObjectLevel(self.geometry, self.goal, self.config, device=device, seed=2 * seed + 2)
        self._path = self.goal[None]
        self._progress = 0
        self._to_go: PoseField | None = None

    def warm_up(self) -> None:
        """Compiles and loads every kernel, so that the first plan is as fast as the others."""
        super().warm_up()
        self._object.improve(self._path[0])
        wp.load_module(navigation, device="cpu")

    def start(self, observation: Observation) -> float:
        """Plans the object's whole way; returns the wall time that took, the cost-to-go included [s]."""
        super().start(observation)
        began = time.perf_counter()
        self._object.reset()
        self._progress = 0
        self._path = self._whole_way(to_center(self.geometry.surface, observation.object_pose))
        if self.config.reference == "progress" and self.config.soi.off_plan > 0.0:
            self._to_go = build_to_go(
                self.geometry.clearance,
                self._path[::-3][::-1],
                yaw_length=self.config.object.yaw_length,
                reach=self.config.object_cost.reach,
                device=self.device,
            )
        return time.perf_counter() - began + self._object.setup_seconds

    def _whole_way(self, pose: np.ndarray) -> np.ndarray:
        """The object's way to the goal, as the object level would drive it in closed loop."""
        way = [pose]
        for _ in range(self.config.object.plan_steps):
            _, path = self._object.improve(way[-1])
            way.append(path[1])
            left = _difference(self.goal, way[-1]) * [1.0, 1.0, self.config.object.yaw_length]
            if np.linalg.norm(left) < _ARRIVED:
                break
        return np.array([*way, self.goal])

    def _reference(self, pose: np.ndarray) -> tuple[Update | None, np.ndarray]:
        if self.config.reference == "time":
            reference = self._path[self._progress :]
            self._progress = min(self._progress + 1, len(self._path) - 1)
            return None, reference
        soi = self.config.soi
        first = max(self._progress - soi.look_back, 0)
        window = self._path[first : self._progress + soi.look_ahead]
        error = _difference(window, pose)
        distance = np.linalg.norm(error * [1.0, 1.0, self.config.object.yaw_length], axis=1)
        nearest = int(np.argmin(distance))
        self._progress = first + nearest
        if self._to_go is not None and distance[nearest] > soi.off_plan:
            return None, self._way_back(pose)
        # What the object is off by fades out along the plan.
        reference = self._path[self._progress :].copy()
        share = np.clip(1.0 - np.arange(len(reference)) / max(soi.return_steps, 1), 0.0, 1.0)
        reference -= share[:, None] * error[nearest]
        return None, reference

    def _way_back(self, pose: np.ndarray) -> np.ndarray:
        """A free way to the rest of the plan, shape [n, 3]: down the cost-to-go that was made with the plan."""
        assert self._to_go is not None
        step = self.config.object.speed_limit[0] * self.config.control_period
        way = descend(
            self._to_go, pose, yaw_length=self.config.object.yaw_length, step=step, steps=self.dynamics.reference_length
        )
        way[:, 2] = pose[2] + wrap_angle(way[:, 2] - pose[2])
        return way


class ClosedLoopPlanner(Planner):
    """CLOI-MPPI (Algorithm 2): the object plan is renewed from every observation."""

    method: Method = "cloi"

    def __init__(self, scene: Scene, config: Config, *, device: str, seed: int) -> None:
        super().__init__(scene, config, device=device, seed=seed)
        self._object = ObjectLevel(self.geometry, self.goal, self.config, device=device, seed=2 * seed + 2)

    def start(self, observation: Observation) -> float:
        """Prepares for an episode that begins with ``observation``; returns the wall time of the cost-to-go [s]."""
        self._object.reset()
        return super().start(observation) + self._object.setup_seconds

    def _reference(self, pose: np.ndarray) -> tuple[Update | None, np.ndarray]:
        return self._object.improve(pose)


def make_planner(
    scene: Scene,
    config: Config,
    *,
    method: Method = "cloi",
    engine: str = "quasistatic",
    device: str = "auto",
    seed: int = 0,
) -> Planner:
    """A planner for a scene.

    Args:
        scene: The task.
        config: All settings.
        method: ``"mppi"``, ``"soi"`` or ``"cloi"``.
        engine: Rollout engine of the robot level.
        device: Warp device; ``"auto"`` takes the first GPU, or the CPU where there is none.
        seed: Of all noise.

    Raises:
        ConfigError: Unknown method or engine, or a setting that cannot be used.
        DeviceError: The device is not there.
    """
    validate(config)
    planners = {kind.method: kind for kind in (Planner, SequentialPlanner, ClosedLoopPlanner)}
    if method not in planners:
        raise ConfigError(f"method {method!r} does not exist\n  allowed: {', '.join(METHODS)}")
    if engine not in ENGINES:
        raise ConfigError(f"engine {engine!r} does not exist\n  allowed: {', '.join(ENGINES)}")
    return planners[method](scene, config, device=pick_device(device), seed=seed)


def _for_task(config: Config, scene: Scene) -> Config:
    """The settings for a task: where every yaw is allowed, none is asked for."""
    if np.isfinite(scene.tolerance.yaw):
        return config
    return replace(
        config,
        object=replace(config.object, turn=False),
        cost=replace(config.cost, w_theta=0.0),
        object_cost=replace(config.object_cost, w_theta=0.0),
    )


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``a - b`` of planar poses [..., 3], the yaw in [-pi, pi)."""
    difference = a - b
    difference[..., 2] = wrap_angle(difference[..., 2])
    return difference


def _fitted(reference: np.ndarray, length: int) -> np.ndarray:
    """The reference cut or held at its end to ``length`` poses."""
    return reference[np.minimum(np.arange(length), len(reference) - 1)]

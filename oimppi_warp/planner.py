"""MPPI, SOI and CLOI: who replans when, and what the robot tracks (the paper's Algorithms 1 to 3).

All three are one robot-level MPPI that tracks a reference of object poses; they differ in where the reference comes
from. MPPI's is the goal itself, SOI's a plan made once before the robot moves, CLOI's a plan renewed every step.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from oimppi_warp.choice import choose, median_seconds
from oimppi_warp.clearance import Geometry, build_geometry, from_center, pose_field_at, to_center
from oimppi_warp.compute import Compute, Launch, Stopwatch
from oimppi_warp.config import Config, Method, validate
from oimppi_warp.dynamics.engines import ENGINES, make_dynamics
from oimppi_warp.dynamics.object import ObjectDynamics
from oimppi_warp.errors import ConfigError
from oimppi_warp.footprint import wrap_angle
from oimppi_warp.kernels import navigation
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.kernels.object import follow_path
from oimppi_warp.kinematics import tip_frame, tip_jacobian
from oimppi_warp.mppi import Mppi, Update
from oimppi_warp.navigation import build_to_go
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.regrasp import Regrasping
from oimppi_warp.scene import Scene
from oimppi_warp.uncertainty import draw

METHODS: tuple[Method, ...] = ("mppi", "soi", "cloi")

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
        object_seconds: Wall time that the object level took [s]; NaN where it did not plan, or where nobody can tell
            because the whole step is one CUDA graph.
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
    """The object-level MPPI; all poses are of the object's friction centre.

    Attributes:
        launches: One update and the path that the nominal then takes, as launches.
        path: That path, an output of shape [horizon + 1].
        to_go: The cost-to-go; ``None`` where the level goes without.
        setup_seconds: Wall time of making or reading the cost-to-go [s].
    """

    def __init__(self, geometry: Geometry, goal: np.ndarray, config: Config, *, compute: Compute, seed: int) -> None:
        self._dynamics = ObjectDynamics(
            geometry, config.object, config.object_cost, goal=goal, dt=config.control_period, compute=compute
        )
        self.mppi = Mppi(self._dynamics, config.object.mppi, seed=seed)
        self._level = config.object
        self._goal = goal
        self.path = self._dynamics.path
        self.to_go = self._dynamics.to_go if config.object_cost.w_to_go > 0.0 else None
        self.launches = [*self.mppi.improve, self._dynamics.trace(self.mppi.nominal), self.mppi.shift]
        self.setup_seconds = self._dynamics.setup_seconds

    def set_state(self, pose: np.ndarray) -> None:
        """Where the object is: pose [3]."""
        left = _difference(self._goal, pose) * [1.0, 1.0, self._level.yaw_length]
        share = 1.0
        if self._level.noise_range > 0.0:
            share = float(np.clip(np.linalg.norm(left) / self._level.noise_range, 0.1, 1.0))
        self.mppi.noise.host[0] = np.diag(share * self._level.noise * self._dynamics.bound)
        self._dynamics.set_state(pose)

    def to_go_from(self, pose: np.ndarray) -> float:
        """What the object still has to go from a pose [3]: the cost-to-go, or without one the straight distance [m]."""
        to_go = self._dynamics.to_go_at(pose)
        if to_go is not None:
            return to_go
        left = _difference(self._goal, pose) * [1.0, 1.0, self._level.yaw_length]
        return float(np.linalg.norm(left))


class Planner:
    """Plain MPPI, and what SOI and CLOI have in common.

    A control step is: inputs written, one :meth:`Compute.step`, outputs read.

    Args:
        scene: The task.
        config: All settings.
        engine: Rollout engine of the robot level.
        compute: Where to compute.
        seed: Of all noise; the same seed gives the same plans (on the CPU to the bit).

    Attributes:
        engine: Name of the rollout engine.
        engine_reason: Why it was chosen, if it was not asked for by name.
        geometry: Shapes of the scene.
        goal: The scene's, of the friction centre.
        dynamics: The engine.
        mppi: The robot level.
    """

    method: Method = "mppi"

    def __init__(self, scene: Scene, config: Config, *, engine: str, compute: Compute, seed: int) -> None:
        config = _for_task(config, scene)
        self.scene = scene
        self.config = config
        self.engine = engine
        self.engine_reason = ""
        self.compute = compute
        self.geometry = build_geometry(scene, compute.device)
        self.goal = to_center(self.geometry.surface, np.array(scene.goal))
        level = config.robot
        draws = draw(level.uncertainty, samples=level.mppi.samples, seed=seed)
        self.dynamics = make_dynamics(
            engine, scene, self.geometry, level, config.cost, dt=config.control_period, compute=compute, draws=draws
        )
        self.mppi = Mppi(self.dynamics, level.mppi, seed=2 * seed + 1)
        robot = [*self.mppi.improve, self.dynamics.trace(self.mppi.nominal, self.mppi.costs), self.mppi.shift]
        self._regrasping = Regrasping(
            scene, self.geometry, config.regrasp, height=config.cost.height, period=config.control_period
        )
        self._tracked = self.goal[None]
        self._step = compute.step([*self._object_launches(seed), *robot], one_graph=self.dynamics.one_graph)

    def warm_up(self) -> None:
        """Compiles and loads every kernel, so that the first plan is as fast as the others."""
        start = np.array(self.scene.start)
        joints = self.scene.robot.start
        transform = planar_transform(self.scene.start, self.scene.object.rest_height)
        self.plan(Observation(0.0, joints, np.zeros_like(joints), start, transform))

    def start(self, observation: Observation) -> float:
        """Prepares for an episode that begins with ``observation``; returns the wall time that planning took [s]."""
        self.mppi.reset()
        self._regrasping.reset()
        return 0.0

    def plan(self, observation: Observation) -> Plan:
        """Plans from an observation; each call is one control step."""
        pose = to_center(self.geometry.surface, observation.object_pose)
        tip = tip_frame(self.scene.robot, observation.joint_position)[1]
        guide = self._regrasping.guide(tip, pose, self._reference(), self._to_go_from(pose))
        self.dynamics.guide.host[0] = guide
        self.dynamics.set_state(observation, self.goal)
        self.mppi.noise.host[0] = self._noise(observation.joint_position, lifting=guide[3] > 0.0)
        self._set_reference(pose)
        began = time.perf_counter()
        self._step()
        trace = self.dynamics.traced()
        surface = self.geometry.surface
        return Plan(
            command=self.mppi.command.host[0].astype(float),
            update=self.mppi.found(),
            object_update=self._object_update(),
            object_seconds=self._object_done() - began,
            terms=trace.terms,
            tips=trace.tips,
            object_poses=from_center(surface, trace.poses),
            reference=from_center(surface, self._reference()),
        )

    def _object_launches(self, seed: int) -> list[Launch]:
        """What a step does before the robot level."""
        return []

    def _set_reference(self, pose: np.ndarray) -> None:
        """Prepares the reference for the object's pose [3] (friction centre)."""
        self._track(self.goal[None])

    def _track(self, reference: np.ndarray) -> None:
        """Gives the robot level the reference [n, 3]; its last pose is held."""
        host = self.dynamics.reference.host
        self._tracked = reference
        host[:] = reference[np.minimum(np.arange(len(host)), len(reference) - 1)]

    def _reference(self) -> np.ndarray:
        """The reference that was tracked in the latest step, of the friction centre, shape [n, 3]."""
        return self._tracked

    def _to_go_from(self, pose: np.ndarray) -> float:
        """What the object still has to go from a pose [3], turning counted [m]."""
        left = _difference(self.goal, pose) * [1.0, 1.0, self.config.object.yaw_length]
        return float(np.linalg.norm(left))

    def _object_update(self) -> Update | None:
        """What the object level found in this step, if it planned."""
        return None

    def _object_done(self) -> float:
        """When the object level was done with this step, by ``time.perf_counter``; NaN if nobody knows."""
        return math.nan

    def _noise(self, joints: np.ndarray, *, lifting: bool = False) -> np.ndarray:
        """A square root of the noise's covariance in joint space, shape [dof, dof]."""
        robot = self.config.robot
        if robot.noise_space == "joint":
            return robot.joint_noise * np.eye(self.scene.robot.dof)
        jacobian = tip_jacobian(self.scene.robot, joints)
        inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + _DAMPING**2 * np.eye(6))
        noise = np.array(robot.tool_noise)
        if lifting:  # up and down as freely as sideways
            noise[2] = max(noise[:3])
        root = inverse * noise
        if root.shape[0] != root.shape[1]:
            root = np.linalg.cholesky(root @ root.T + 1e-8 * np.eye(len(root)))
        return root


class SequentialPlanner(Planner):
    """SOI-MPPI (Algorithm 3): one object plan to the goal before the robot moves, then tracked.

    By time, the reference is the plan as it was made. By progress, it is the way from the object's pose down a
    cost-to-go that is made once, with the plan: along the plan, and where a push went astray a free way back to it.
    """

    method: Method = "soi"

    def __init__(self, scene: Scene, config: Config, *, engine: str, compute: Compute, seed: int) -> None:
        super().__init__(scene, config, engine=engine, compute=compute, seed=seed)
        # Its plan is made before the robot moves: a step of its own, with inputs and outputs of its own.
        alone = Compute(compute.device, threads=compute.threads)
        self._object = ObjectLevel(self.geometry, self.goal, self.config, compute=alone, seed=2 * seed + 2)
        self._object_step = alone.step(self._object.launches)
        self._path = self.goal[None]
        self._step_of_path = 0

    def warm_up(self) -> None:
        """Compiles and loads every kernel, so that the first plan is as fast as the others."""
        super().warm_up()
        self._improve(self._path[0])
        wp.load_module(navigation, device="cpu")

    def start(self, observation: Observation) -> float:
        """Plans the object's whole way; returns the wall time that took, the cost-to-go included [s]."""
        super().start(observation)
        began = time.perf_counter()
        self._object.mppi.reset()
        self._step_of_path = 0
        self._path = self._whole_way(to_center(self.geometry.surface, observation.object_pose))
        if self.config.reference == "progress":
            level = self.config.object
            found = build_to_go(
                self.geometry.clearance,
                self._path[::-3][::-1],
                yaw_length=level.yaw_length,
                reach=self.config.object_cost.reach,
                bound=self._object.to_go,
                device=self.compute.device,
            )
            wp.copy(self._to_go.values, found.values)
            self._to_go_values = found.values.numpy()
        return time.perf_counter() - began + self._object.setup_seconds

    def _object_launches(self, seed: int) -> list[Launch]:
        if self.config.reference == "time":
            return []
        clearance, level = self.geometry.clearance, self.config.object
        self._to_go = PoseField()
        self._to_go.values = wp.zeros_like(clearance.values)
        self._to_go_values = self._to_go.values.numpy()
        self._to_go.origin, self._to_go.inv_step = clearance.origin, clearance.inv_step
        self._to_go.inv_yaw_step = clearance.inv_yaw_step
        self._start = self.compute.input(1, wp.vec3)
        reference = self.dynamics.reference
        self._way = self.compute.output((1, len(reference.host)), wp.vec3)
        goal = wp.array(self.goal[None].astype(np.float32), dtype=wp.vec3, device=self.compute.device)
        step = level.speed_limit[0] * self.config.control_period
        inputs = [self._to_go, self._start.array, goal, level.yaw_length, step]
        down = self.compute.launch(navigation.follow_down, 1, inputs, [self._way.array])
        hand_over = self.compute.launch(follow_path, len(reference.host), [self._way.array], [reference.array])
        return [down, hand_over]

    def _whole_way(self, pose: np.ndarray) -> np.ndarray:
        """The object's way to the goal, as the object level would drive it in closed loop."""
        way = [pose]
        for _ in range(self.config.object.plan_steps):
            way.append(self._improve(way[-1])[1])
            left = _difference(self.goal, way[-1]) * [1.0, 1.0, self.config.object.yaw_length]
            if np.linalg.norm(left) < _ARRIVED:
                break
        return np.array([*way, self.goal])

    def _improve(self, pose: np.ndarray) -> np.ndarray:
        """One update of the object plan from a pose [3], and the path [horizon + 1, 3] that it then takes."""
        self._object.set_state(pose)
        self._object_step()
        return self._object.path.host[0].astype(float)

    def _set_reference(self, pose: np.ndarray) -> None:
        if self.config.reference == "progress":
            self._start.host[0] = pose
            return
        self._track(self._path[self._step_of_path :])
        self._step_of_path = min(self._step_of_path + 1, len(self._path) - 1)

    def _reference(self) -> np.ndarray:
        return self._way.host[0].astype(float) if self.config.reference == "progress" else self._tracked

    def _to_go_from(self, pose: np.ndarray) -> float:
        if self.config.reference == "time":
            return super()._to_go_from(pose)
        return pose_field_at(self._to_go, pose, self._to_go_values)


class ClosedLoopPlanner(Planner):
    """CLOI-MPPI (Algorithm 2): the object plan is renewed from every observation."""

    method: Method = "cloi"

    def start(self, observation: Observation) -> float:
        """Prepares for an episode that begins with ``observation``; returns the wall time of the cost-to-go [s]."""
        self._object.mppi.reset()
        return super().start(observation) + self._object.setup_seconds

    def _object_launches(self, seed: int) -> list[Launch]:
        self._object = ObjectLevel(self.geometry, self.goal, self.config, compute=self.compute, seed=2 * seed + 2)
        reference = self.dynamics.reference
        hand_over = self.compute.launch(follow_path, len(reference.host), [self._object.path.array], [reference.array])
        self._watch = Stopwatch()
        return [*self._object.launches, hand_over, self._watch]

    def _set_reference(self, pose: np.ndarray) -> None:
        self._object.set_state(pose)

    def _reference(self) -> np.ndarray:
        return self._object.path.host[0].astype(float)

    def _object_update(self) -> Update | None:
        return self._object.mppi.found()

    def _object_done(self) -> float:
        return self._watch.take()

    def _to_go_from(self, pose: np.ndarray) -> float:
        return self._object.to_go_from(pose)


def make_planner(
    scene: Scene,
    config: Config,
    *,
    method: Method = "cloi",
    engine: str = "auto",
    device: str = "auto",
    threads: int | None = None,
    seed: int = 0,
) -> Planner:
    """A planner for a scene.

    Args:
        scene: The task.
        config: All settings.
        method: ``"mppi"``, ``"soi"`` or ``"cloi"``.
        engine: Rollout engine of the robot level: ``"quasistatic"``, ``"newton"``, or ``"auto"`` for the best one that
            keeps up with the control period on this machine (a few plans are timed).
        device: Warp device; ``"auto"`` takes the first GPU, or the CPU where there is none.
        threads: Threads on the CPU; default: as many as the cores that the process may use.
        seed: Of all noise.

    Raises:
        ConfigError: Unknown method or engine, or a setting that cannot be used.
        DeviceError: The device is not there.
    """
    validate(config)
    planners = {kind.method: kind for kind in (Planner, SequentialPlanner, ClosedLoopPlanner)}
    if method not in planners:
        raise ConfigError(f"method {method!r} does not exist\n  allowed: {', '.join(METHODS)}")
    if engine not in (*ENGINES, "auto"):
        raise ConfigError(f"engine {engine!r} does not exist\n  allowed: auto, {', '.join(ENGINES)}")

    def make(engine: str) -> Planner:
        return planners[method](scene, config, engine=engine, compute=Compute(device, threads=threads), seed=seed)

    if engine != "auto":
        return make(engine)
    made: dict[str, Planner] = {}

    def plan_seconds(engine: str) -> float:
        made[engine] = make(engine)
        return median_seconds(made[engine].warm_up)

    choice = choose(method, config.control_period, plan_seconds)
    planner = made[choice.engine]
    planner.engine_reason = choice.reason
    return planner


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

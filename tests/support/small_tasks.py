"""Small tasks made from a shipped one, arms put where a test wants them, and rollouts of the engines under test."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
import warp as wp
from scipy.spatial.transform import Rotation
from support import reference
from support.device import DEVICE, run

from oimppi_warp.compute.step import Compute
from oimppi_warp.config.settings import Config, ObjectCost, ObjectLevel, RobotCost, RobotLevel, Safety
from oimppi_warp.geometry.fields import Geometry, build_geometry, from_center
from oimppi_warp.geometry.footprint import footprint, outline, planar_points
from oimppi_warp.geometry.kinematics import tip_frame, tip_jacobian
from oimppi_warp.geometry.tipping import tipping_speed
from oimppi_warp.kernels.costs.stage_costs import TERMS, terms_vector
from oimppi_warp.observation import Observation
from oimppi_warp.planning.engines.dynamics import RolloutTask, control_type
from oimppi_warp.planning.engines.object import ObjectDynamics
from oimppi_warp.planning.engines.packing import environment, velocity_bound
from oimppi_warp.planning.engines.quasistatic import QuasistaticDynamics
from oimppi_warp.planning.engines.uncertainty import CERTAIN, Draws
from oimppi_warp.planning.resolve import resolve
from oimppi_warp.planning.stance import build_stance
from oimppi_warp.planning.upright import build_upright
from oimppi_warp.scene import Collider, Obstacle, PushedObject, Robot, Scene, Table
from oimppi_warp.usd import load_scene

DT = 0.05
"""Control period [s]."""


def rollout_task(
    scene: Scene,
    *,
    level: RobotLevel | None = None,
    cost: RobotCost | None = None,
    geometry: Geometry | None = None,
    device: str = DEVICE,
    threads: int | None = None,
    draws: Draws = CERTAIN,
    upright: bool = False,
) -> RolloutTask:
    """Returns the rollout task of an engine under test; with ``upright``, its controls are velocities of the tip."""
    geometry, level, cost = (
        geometry or build_geometry(scene, device),
        level or RobotLevel(),
        cost or effective_cost(scene),
    )
    arm = None
    if upright:
        around, limits = environment(scene, geometry, cost), velocity_bound(scene, level)
        arm = build_upright(
            scene, geometry, around, level, limits=limits, most_change=Safety().most_change(DT), height=cost.height,
            device=device,
        )  # fmt: skip
    return RolloutTask(
        scene=scene,
        geometry=geometry,
        level=level,
        cost=cost,
        dt=DT,
        compute=Compute(device, threads=threads),
        draws=draws,
        upright=arm,
    )


@lru_cache
def shipped(name: str) -> Scene:
    return load_scene(name)


def box(x: float, y: float, size: tuple[float, float, float], *, yaw: float = 0.0) -> Collider:
    """A box on the table by its centre and whole size [m]."""
    turn = (0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Collider("/box", "box", np.array([x, y, size[2] / 2, *turn]), half)


def post(x: float, y: float, radius: float, height: float) -> Collider:
    """An upright cylinder on the table [m]."""
    return Collider("/post", "cylinder", np.array([x, y, height / 2, 0, 0, 0, 1.0]), (radius, height / 2))


def block(size: tuple[float, float, float] = (0.10, 0.06, 0.05), *, tool_friction: float = 0.3) -> PushedObject:
    """A box to push, its frame in its middle."""
    shape = Collider("/o/box", "box", np.array([0, 0, 0, 0, 0, 0, 1.0]), (size[0] / 2, size[1] / 2, size[2] / 2))
    return PushedObject("/o", 0.5, 0.4, tool_friction, np.zeros(3), (shape,), size[2] / 2)


def task(*obstacles: Collider, pushed: PushedObject | None = None, table: float | None = None) -> Scene:
    """The open table of task 01 with these obstacles, this object, this half width of the table [m]."""
    scene = shipped("task01")
    if table is not None:
        scene = replace(scene, table=Table("/table", (-table, -table), (table, table)))
    return replace(
        scene,
        object=pushed or scene.object,
        obstacles=tuple(Obstacle(f"/obstacle{i}", (shape,)) for i, shape in enumerate(obstacles)),
    )


def turned(scene: Scene, angle: float) -> Scene:
    """The scene with everything but robot and table turned about the robot's axis; the robot's first joint follows."""

    def pose(old: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y = planar_points((0.0, 0.0, angle), np.array(old[:2]))[0]
        return (x, y, old[2] + angle)

    def shape(collider: Collider) -> Collider:
        frame = reference.homogeneous([0, 0, 0, 0, 0, *reference.half_turn(angle)])
        frame = frame @ reference.homogeneous(collider.transform)
        quaternion = Rotation.from_matrix(frame[:3, :3]).as_quat()
        return replace(collider, transform=np.array([*frame[:3, 3], *quaternion]))

    return replace(
        scene,
        obstacles=tuple(Obstacle(o.path, tuple(shape(c) for c in o.colliders)) for o in scene.obstacles),
        robot=replace(scene.robot, start=scene.robot.start + angle * np.eye(scene.robot.dof)[0]),
        start=pose(scene.start),
        goal=pose(scene.goal),
    )


def observe(scene: Scene, *, joints: np.ndarray | None = None, pose: np.ndarray | None = None) -> Observation:
    """The scene's start as a plant would report it."""
    joints = scene.robot.start if joints is None else joints
    pose = np.array(scene.start) if pose is None else pose
    transform = np.array([pose[0], pose[1], scene.object.rest_height, 0, 0, *reference.half_turn(pose[2])])
    return Observation(0.0, joints, np.zeros(scene.robot.dof), pose, transform)


def joints_at(robot: Robot, tip: tuple[float, float, float]) -> np.ndarray:
    """Joint positions that put the tip there with the tool straight down, by damped least squares."""
    joints = robot.start + (np.arctan2(tip[1], tip[0]) - robot.start[0]) * np.eye(robot.dof)[0]
    error = np.full(6, np.inf)
    for _ in range(200):
        rotation, position = tip_frame(robot, joints)
        error = np.concatenate([np.array(tip) - position, np.cross(rotation[:, 2], [0.0, 0.0, -1.0])])
        jacobian = tip_jacobian(robot, joints)
        joints = joints + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-4 * np.eye(6), error)
    assert np.linalg.norm(error) < 1e-4, f"the tip does not reach {tip}"
    return joints


def straight(robot: Robot, joints: np.ndarray, velocity: tuple[float, float, float], steps: int) -> np.ndarray:
    """Joint velocities [steps, dof] that move the tip straight on, upright, from ``joints``."""
    controls = []
    for _ in range(steps):
        jacobian = tip_jacobian(robot, joints)
        twist = np.array([*velocity, 0.0, 0.0, 0.0])
        controls.append(jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(6), twist))
        joints = joints + DT * controls[-1]
    return np.array(controls)


@dataclass(frozen=True, eq=False)
class Rollouts:
    """What K control sequences led to: costs [K], terms [K, term], tips and poses [K, horizon + 1, 3]."""

    costs: np.ndarray
    terms: np.ndarray
    tips: np.ndarray
    poses: np.ndarray

    def term(self, name: str) -> np.ndarray:
        return self.terms[:, TERMS.index(name)]


@dataclass(frozen=True, eq=False)
class Pushing:
    """The robot level on a scene: object poses are of the friction centre.

    Attributes:
        scene, geometry: The task and its shapes.
        config: Settings of the planner.
        dynamics: The engine under test.
    """

    scene: Scene
    geometry: Geometry
    config: Config
    dynamics: QuasistaticDynamics

    @classmethod
    def on(cls, scene: Scene, config: Config | None = None, *, upright: bool = False, **cost: Any) -> Pushing:
        config = config or Config()
        config = resolve(replace(config, cost=replace(config.cost, **cost)), scene).config
        geometry = build_geometry(scene, DEVICE)
        made = rollout_task(scene, level=config.robot, cost=config.cost, geometry=geometry, upright=upright)
        dynamics = QuasistaticDynamics(made)
        return cls(scene, geometry, config, dynamics)

    def twin(self) -> reference.World:
        """The same for the engine's twin."""
        weights = self.config.cost
        return reference.World(
            robot=self.scene.robot,
            speed=velocity_bound(self.scene, self.config.robot),
            body=reference.Body.of(self.dynamics._model),
            obstacles=self.geometry.space,
            top=self.geometry.space_top,
            weights=weights,
            dt=DT,
            contact_steps=self.config.robot.contact_steps,
            topple_speed=weights.rush * tipping_speed(self.scene.object),
            size=self.geometry.size,
            stance=build_stance(self.scene, self.geometry, weights.w_theta, DEVICE) if weights.w_stance > 0.0 else None,
        )

    def roll(self, joints: np.ndarray, pose: np.ndarray, controls: np.ndarray, *, goal: np.ndarray | None = None,
             reference: np.ndarray | None = None) -> Rollouts:  # fmt: skip
        """Rolls out control sequences [K, horizon, dof or 3] with the engine."""
        goal = np.array(self.scene.goal) if goal is None else goal
        if reference is None:
            reference = goal
        seen = from_center(self.geometry.surface, pose)
        self.dynamics.set_state(observe(self.scene, joints=joints, pose=seen), goal)
        self.dynamics.reference.host[:] = reference
        samples, horizon, dof = controls.shape
        costs = wp.zeros(samples, dtype=float, device=DEVICE)
        terms = wp.zeros(samples, dtype=terms_vector(), device=DEVICE)
        tips, poses = (wp.zeros((samples, horizon + 1), dtype=wp.vec3, device=DEVICE) for _ in range(2))
        packed = wp.array(controls.astype(np.float32), dtype=control_type(dof), device=DEVICE)
        roll = self.dynamics.launch(packed, costs, terms, tips, poses, self.dynamics._worlds)
        run(self.dynamics.compute, roll)
        return Rollouts(costs.numpy(), terms.numpy(), tips.numpy().astype(float), poses.numpy().astype(float))

    def gaps(self, rolled: Rollouts) -> np.ndarray:
        """Exact distance of the tool's surface to the object's outline at each step, shape [K, horizon + 1] [m]."""
        center = self.geometry.surface.center
        shape = outline(footprint(self.scene.object.colliders))
        out = np.zeros(rolled.tips.shape[:2])
        for index in np.ndindex(out.shape):
            tip, pose = rolled.tips[index], rolled.poses[index]
            local = reference_point(pose, tip[:2]) + center
            point = shapely.Point(local)
            inside = shapely.contains(shape, point)
            out[index] = -shapely.distance(point, shapely.boundary(shape)) if inside else shapely.distance(point, shape)
        return out - self.scene.robot.tool_radius


def reference_point(pose: np.ndarray, point: np.ndarray) -> np.ndarray:
    """A point of the world in the frame of a planar pose."""
    return reference.planar_rotation(pose[2]).T @ (point - pose[:2])


def object_level(
    scene: Scene, *, goal: np.ndarray | None = None, level: ObjectLevel | None = None, **cost: Any
) -> tuple[ObjectDynamics, ObjectCost, Geometry]:
    """The object level on a scene, its weights and the scene's shapes."""
    weights = replace(Config().object_cost, **cost)
    geometry = build_geometry(scene, DEVICE)
    goal = np.array(scene.goal) if goal is None else goal
    dynamics = ObjectDynamics(geometry, level or ObjectLevel(), weights, goal=goal, dt=DT, compute=Compute(DEVICE))
    return dynamics, weights, geometry


def roll_wrenches(dynamics: ObjectDynamics, pose: np.ndarray, wrenches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Costs [K] and poses [K, horizon + 1, 3] of wrench sequences [K, horizon, 3]."""
    dynamics.set_state(pose)
    costs = wp.zeros(len(wrenches), dtype=float, device=DEVICE)
    poses = wp.zeros((wrenches.shape[0], wrenches.shape[1] + 1), dtype=wp.vec3, device=DEVICE)
    packed = wp.array(wrenches.astype(np.float32), dtype=wp.vec3, device=DEVICE)
    run(dynamics.compute, dynamics.launch(packed, costs, poses))
    return costs.numpy(), poses.numpy().astype(float)


def effective_cost(scene: Scene) -> RobotCost:
    """The default weights as they take effect on a scene."""
    return resolve(Config(), scene).config.cost


def robot_weights(**cost: float) -> RobotCost:
    """The default weights with some changed."""
    return replace(RobotCost(), **cost)

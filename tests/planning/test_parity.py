"""The quasi-static engine against the plant: the same controls move the object to about the same place."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import warp as wp
from support import small_tasks
from support.device import run
from support.pushes import SPEED, tip_before

from oimppi_warp.config.settings import RobotLevel
from oimppi_warp.geometry.fields import build_geometry, from_center
from oimppi_warp.geometry.footprint import planar_points, wrap_angle
from oimppi_warp.physics.world import World
from oimppi_warp.planning.engines.dynamics import control_type
from oimppi_warp.planning.engines.quasistatic import QuasistaticDynamics
from oimppi_warp.plants.plant import SimulatedPlant

STEPS = 25
"""Length of a push: 1.25 s."""

MEDIAN = (0.010, 0.10)
"""Bounds of the median disagreement in position [m] and yaw [rad] after a push of about 0.1 m and 0.4 rad."""
MOST = (0.030, 0.30)
"""Bounds of its 90th percentile."""
TRAVEL_RATIO = (0.95, 1.05)
"""Bounds of the median ratio of how far the object's friction centre travels, engine over plant."""


@pytest.fixture(scope="module")
def pushes(device: str) -> np.ndarray:
    """Random pushes: friction centre at first, at last in the plant, and at last in the engine; shape [n, 3, 3]."""
    scene = small_tasks.shipped("task01")
    geometry = build_geometry(scene, device)
    level = RobotLevel(optimizer=replace(RobotLevel().optimizer, horizon=STEPS))
    engine = QuasistaticDynamics(small_tasks.rollout_task(scene, level=level, geometry=geometry))
    world = World(scene)
    rng = np.random.default_rng(5)
    found = []
    while len(found) < 30:
        center = np.array([rng.uniform(0.35, 0.45), rng.uniform(-0.15, 0.15), rng.uniform(-np.pi, np.pi)])
        pose = from_center(geometry.surface, center)
        way = rng.uniform(-np.pi, np.pi)
        tip = tip_before(scene, pose, center, way, aside=rng.uniform(-0.06, 0.06))
        if not 0.25 < np.hypot(*tip) < 0.6:
            continue
        joints = small_tasks.joints_at(scene.robot, (tip[0], tip[1], 0.02))
        controls = small_tasks.straight(scene.robot, joints, (SPEED * np.cos(way), SPEED * np.sin(way), 0.0), STEPS)
        if np.abs(controls).max() > 1.0:
            continue
        plant = SimulatedPlant(world, start=tuple(pose))
        plant.data.qpos[world.mujoco.joint_qpos] = joints
        mujoco.mj_forward(plant.model, plant.data)
        for control in controls:
            plant.apply(control)
        engine.set_state(small_tasks.observe(scene, joints=joints, pose=pose), center)
        nominal = wp.array(controls.astype(np.float32), dtype=control_type(6), device=device)
        run(engine.compute, engine.trace(nominal, wp.zeros(1, dtype=float, device=device)))
        trace = engine.traced()
        # The plant's object compared at its friction centre, where the limit surface has it.
        last = plant.observe().object_pose
        last[:2] = planar_points(last, geometry.surface.center[None])[0]
        found.append([center, last, trace.poses[-1]])
    return np.array(found)


def disagreement(pushes: np.ndarray) -> np.ndarray:
    """Position [m] and yaw [rad] between engine and plant, shape [n, 2]."""
    difference = pushes[:, 2] - pushes[:, 1]
    return np.column_stack([np.hypot(difference[:, 0], difference[:, 1]), np.abs(wrap_angle(difference[:, 2]))])


def travel(pushes: np.ndarray, which: int) -> np.ndarray:
    """How far the friction centre went [m], shape [n]."""
    return np.linalg.norm(pushes[:, which, :2] - pushes[:, 0, :2], axis=1)


def test_the_pushes_move_the_object(pushes: np.ndarray):
    assert np.median(travel(pushes, 1)) > 0.05


def test_the_engine_has_the_object_where_the_plant_has_it(pushes: np.ndarray):
    off = disagreement(pushes)
    assert (np.median(off, axis=0) < MEDIAN).all(), np.median(off, axis=0)
    assert (np.quantile(off, 0.9, axis=0) < MOST).all(), np.quantile(off, 0.9, axis=0)


def test_the_object_travels_as_far_in_the_engine_as_in_the_plant(pushes: np.ndarray):
    moved = travel(pushes, 1) > 0.03
    ratio = np.median(travel(pushes, 2)[moved] / travel(pushes, 1)[moved])
    assert TRAVEL_RATIO[0] < ratio < TRAVEL_RATIO[1], ratio

"""The Newton engines as tests use them: made for a scene, and rolled out."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import warp as wp
from support import small_tasks
from support.device import DEVICE, run

from oimppi_warp.config.settings import RobotLevel
from oimppi_warp.geometry.fields import from_center, to_center
from oimppi_warp.observation import Observation
from oimppi_warp.physics.world import World
from oimppi_warp.planning.engines.dynamics import control_type
from oimppi_warp.planning.engines.newton import NewtonDynamics
from oimppi_warp.planning.engines.newton_threads import NewtonThreads
from oimppi_warp.planning.engines.uncertainty import CERTAIN, Draws
from oimppi_warp.plants.plant import SimulatedPlant
from oimppi_warp.scene import Scene

STEPS = 25


def make(
    engine: type[NewtonDynamics],
    scene: Scene,
    samples: int,
    *,
    steps: int = STEPS,
    substeps: int = 4,
    threads: int = 2,
    draws: Draws = CERTAIN,
    **more: int,
) -> NewtonDynamics:
    """An engine on a scene; MuJoCo's C threads are on the CPU whatever device is tested."""
    mppi = replace(RobotLevel().optimizer, samples=samples, horizon=steps)
    level = RobotLevel(optimizer=mppi, substeps=substeps)
    device = device_of(engine)
    return engine(small_tasks.rollout_task(scene, level=level, device=device, threads=threads, draws=draws), **more)


def device_of(engine: type) -> str:
    """Returns the device on which an engine is tested."""
    return "cpu" if engine is NewtonThreads else DEVICE


def roll(engine: NewtonDynamics, seen: Observation, controls: np.ndarray) -> np.ndarray:
    """Costs [sample] of joint velocities [sample, horizon, dof]; the rest is left in the engine."""
    device = engine.compute.device
    costs = wp.zeros(len(controls), dtype=float, device=device)
    packed = wp.array(controls.astype(np.float32), dtype=control_type(controls.shape[2]), device=device)
    rollout = engine.rollout(packed, costs)
    goal = to_center(engine.task.geometry.surface, np.array(engine.task.scene.goal))
    engine.set_state(seen, goal)
    engine.reference.host[:] = goal
    run(engine.compute, rollout)
    return costs.numpy()


def ends(engine: NewtonDynamics) -> np.ndarray:
    """Returns the final pose of the object's frame, shape [rollout, 3]."""
    return from_center(engine.task.geometry.surface, engine.poses.numpy()[:, -1].astype(float))


def plant_at(scene: Scene, seen: Observation) -> SimulatedPlant:
    """The plant in a state at rest."""
    plant = SimulatedPlant(World(scene), start=tuple(seen.object_pose))
    plant.data.qpos[plant._map.joint_qpos] = seen.joint_position
    plant.data.qpos[plant._map.object_qpos] = seen.object_transform[[0, 1, 2, 6, 3, 4, 5]]
    mujoco.mj_forward(plant.model, plant.data)
    return plant

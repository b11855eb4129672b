"""The plant ``pusht``: the benchmark Push-T itself, as gym-pusht 0.1.8 implements it (`docs/own_plant.md`).

A disc, the agent, pushes a T without friction; the T stands still as soon as nothing pushes it. The environment has its
own starts (``reset(seed=...)``), reward, time limit and success: the T covers more than 95 % of its place.

Lengths are in pixels there, with y downwards; here a pixel is a millimetre, the origin is the lower left corner of the
window, and y points up.
"""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
import shapely

from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError, missing_package
from oimppi_warp.geometry.footprint import footprint, outline
from oimppi_warp.observation import Observation, planar_transform
from oimppi_warp.plants.plant import Verdict
from oimppi_warp.scene import Scene

_WINDOW = 512
"""Side of the window [px]."""
_PIXEL = 1e-3
"""Length of a pixel [m]."""
_RADIUS = 15
"""Radius of the agent [px]."""
_T = shapely.union(shapely.box(-60, 0, 60, 30), shapely.box(-15, 30, 15, 120))
"""The T in its frame [px]."""
_CENTER = (0.0, 45.0)
"""Centre of gravity of the T in its frame [px]."""


class PushT:
    """Push-T, as a plant.

    Joint velocities are those of the agent along x and y. The environment takes targets instead, which a PD controller
    approaches; the target is chosen such that the agent is where the velocity leads it at the end of the control
    period, or as near as a target within the window allows.

    Args:
        scene: The task; its T and its tool must be those of Push-T. Its goal is used, and so is its centre of mass.
        config: Not used.
        seed: Seed of the start.
        damping: Share of the T's velocity that is left after a second without a push; gym-pusht's default is 0.

    Attributes:
        environment: The environment.

    Raises:
        ConfigError: gym-pusht is not installed, or the scene is another task.
    """

    own_world = True
    control_period = 0.1

    def __init__(self, scene: Scene, config: Config, *, seed: int, damping: float = 0.0) -> None:
        _check(scene)
        if not 0.0 <= damping <= 1.0:
            raise ConfigError(f"--plant-options damping={damping:g}: not a share\n  allowed: 0 to 1")
        x, y = (scene.object.center_of_mass[:2] * (1.0, -1.0) / _PIXEL).round(6).tolist()
        center = None if (x, y) == _CENTER else (x, y)
        self.environment = _make(block_cog=center, damping=damping or None)
        self._height = scene.object.rest_height
        self._inner: Any = self.environment.unwrapped
        _, info = self.environment.reset(seed=seed)
        self._inner.goal_pose = _pixels(np.array(scene.goal))
        self._time = 0.0
        self._velocity = np.zeros(2)
        self._over = False
        self._read(info)
        self._coverage = float(self._inner._get_coverage())
        self._reward = min(self._coverage / self._inner.success_threshold, 1.0)
        self._gains = _response(self._inner)

    def observe(self) -> Observation:
        """Returns the exact state. Joint velocities are means over the last control period."""
        x, y, yaw = self._pose.tolist()
        return Observation(
            time=self._time,
            joint_position=self._agent.copy(),
            joint_velocity=self._velocity.copy(),
            object_pose=self._pose.copy(),
            object_transform=planar_transform((x, y, yaw), self._height),
        )

    def truth(self) -> Observation:
        """Returns the exact state, for the record; the same as the observation."""
        return self.observe()

    def apply(self, joint_velocity: np.ndarray) -> None:
        """Moves the agent at a velocity along x and y, shape [2] [m/s], for one control period of 0.1 s.

        Once the environment has ended the episode, nothing moves any more.

        Raises:
            ValueError: The velocity is not finite.
        """
        velocity = np.asarray(joint_velocity, dtype=float)
        if not np.isfinite(velocity).all():
            raise ValueError(f"joint velocities must be finite, got {velocity}")
        self._time += self.control_period
        if self._over:
            return
        before = self._agent
        of_position, of_velocity, of_target = self._gains
        position, speed = np.array(self._inner.agent.position), np.array(self._inner.agent.velocity)
        wanted = position + self.control_period * velocity * (1.0, -1.0) / _PIXEL
        target = (wanted - of_position * position - of_velocity * speed) / of_target
        action = np.clip(target, 0.0, _WINDOW).astype(np.float32)
        _, reward, terminated, truncated, info = self.environment.step(action)
        self._over = bool(terminated or truncated)
        self._coverage, self._reward = float(info["coverage"]), float(reward)
        self._read(info)
        self._velocity = (self._agent - before) / self.control_period

    @property
    def verdict(self) -> Verdict:
        """Returns what the environment says: success is a coverage above 95 %, and the episode ends after 300 steps."""
        success = self._coverage > self._inner.success_threshold
        return Verdict(success, self._over, {"coverage": self._coverage, "reward": self._reward})

    def _read(self, info: dict[str, Any]) -> None:
        x, y = info["pos_agent"]
        self._agent = _PIXEL * np.array([x, _WINDOW - y])
        x, y, angle = info["block_pose"]
        self._pose = np.array([_PIXEL * x, _PIXEL * (_WINDOW - y), -angle])


def _make(**options: Any) -> Any:
    """Makes the environment.

    Raises:
        ConfigError: gym-pusht is not installed.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    try:
        import gym_pusht  # noqa: F401  # pyright: ignore[reportMissingImports]
        import gymnasium
    except ImportError as error:
        raise missing_package("the plant pusht", str(error.name), "pusht") from None
    return gymnasium.make("gym_pusht/PushT-v0", obs_type="state", disable_env_checker=True, **options)


def _check(scene: Scene) -> None:
    """Raises ConfigError if a scene is not Push-T, apart from its goal and its centre of mass."""
    flipped = shapely.transform(_T, lambda points: points * (_PIXEL, -_PIXEL))
    same_object = shapely.area(shapely.symmetric_difference(outline(footprint(scene.object.colliders)), flipped)) < 1e-7
    same_robot = scene.robot.chain == "PP" and math.isclose(scene.robot.tool_radius, _RADIUS * _PIXEL, rel_tol=1e-6)
    if not (same_object and same_robot and not scene.obstacles):
        raise ConfigError(
            f"the plant pusht cannot run {scene.name}: it has a T, a tool and a table of its own\n"
            "  allowed: pusht, and scenes that differ from it in the goal or the centre of mass only"
        )


def _pixels(pose: np.ndarray) -> np.ndarray:
    """Converts a planar pose [m, m, rad] to Push-T's frame, shape [3] [px, px, rad]."""
    return np.array([pose[0] / _PIXEL, _WINDOW - pose[1] / _PIXEL, -pose[2]])


def _response(environment: Any) -> tuple[float, float, float]:
    """Returns how the agent's position after a control period depends on position, velocity [s] and target."""

    def after(position: float, velocity: float, target: float) -> float:
        for _ in range(round(PushT.control_period / environment.dt)):
            velocity += (environment.k_p * (target - position) - environment.k_v * velocity) * environment.dt
            position += velocity * environment.dt
        return position

    return after(1.0, 0.0, 0.0), after(0.0, 1.0, 0.0), after(0.0, 0.0, 1.0)

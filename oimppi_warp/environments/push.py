"""A task as a Gymnasium environment: the simulated arm and object, behind the same limits as with our planners."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np

from oimppi_warp.config.presets import best
from oimppi_warp.config.settings import Config
from oimppi_warp.environments import CONTROL_PERIOD
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.feasibility import check_task, sample_start
from oimppi_warp.geometry.footprint import limit_surface
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.observation import Observation
from oimppi_warp.physics.world import World
from oimppi_warp.planning.engines.packing import velocity_bound
from oimppi_warp.planning.resolve import resolve
from oimppi_warp.planning.upright import ToolServo
from oimppi_warp.plants.drive import Drive
from oimppi_warp.plants.plant import LONGEST_STEP, SimulatedPlant
from oimppi_warp.plants.safety_filter import SafetyFilter
from oimppi_warp.record.metrics import hold_steps, pose_error
from oimppi_warp.runtime.control import filtered_command
from oimppi_warp.runtime.episode import has_fallen
from oimppi_warp.runtime.request import prepare_scene
from oimppi_warp.scene import PlanarPose, Scene

Actions = Literal["joint", "tool"]

_RISE = 4.0
"""Rate at which the tip returns to its height while the tool is moved [1/s]."""
_FASTEST_RISE = 0.1
"""Largest vertical velocity meanwhile [m/s]."""


class PushEnvironment(gymnasium.Env[np.ndarray, np.ndarray]):
    """Push the object to its goal pose.

    The observation is a vector of 32-bit floats: joint positions [rad; m for a prismatic joint] and velocities, the
    tip's position [m], and x [m], y [m], cos(yaw) and sin(yaw) of the object and of its goal.

    The action is either joint velocities [rad/s; m/s] or, with ``actions="tool"``, the horizontal velocity of the tip
    [m/s], while a servo holds the tool upright and brings the tip to the height at which the planners push. Commands
    pass the safety filter, and their acceleration and jerk are limited, as in an episode of a planner.

    The reward of a step is the amount by which the object came closer to its goal [m], where a radian of yaw counts as
    the radius of the object's limit surface, plus 1 for success.

    An episode terminates with success when the object has stayed within the tolerance for the hold time of the settings
    (half a second), and without when it tips over or falls off the table. As registered, it is truncated after 40 s.

    ``reset(seed=N)`` starts where ``oimppi run --seed N`` does. The options of ``reset`` are ``start`` and ``goal``,
    planar poses of the object (x [m], y [m], yaw [rad]).

    Args:
        scene: A USD file, or the name of a shipped scene.
        actions: Kind of action.
        tolerance: Tolerance for success, position [m] and yaw [rad]; ``None``: the scene's.
        control_period: Duration of a step [s].
        config: All settings, of which ``safety``, ``cost.height``, ``episode.hold_seconds`` and the velocity limits of
            ``robot`` are used; ``None``: the preset ``best``.
        render_mode: ``"rgb_array"`` for pictures from above.

    Attributes:
        config: All settings, resolved for the scene.

    Raises:
        SceneError: The scene cannot be read.
        ConfigError: A setting is invalid.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(1.0 / CONTROL_PERIOD)}  # noqa: RUF012

    def __init__(
        self,
        scene: str | Path,
        *,
        actions: Actions = "joint",
        tolerance: tuple[float, float] | None = None,
        control_period: float = CONTROL_PERIOD,
        config: Config | None = None,
        render_mode: str | None = None,
    ) -> None:
        if actions not in ("joint", "tool"):
            raise ConfigError(f"actions = {actions!r} cannot be used\n  allowed: joint, tool")
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"render_mode = {render_mode!r} cannot be used\n  allowed: rgb_array")
        self.render_mode = render_mode
        loaded = prepare_scene(scene, start=0)
        self._task = loaded if tolerance is None else loaded.with_tolerance(*tolerance)
        self.config = resolve(config or best(), loaded, control_period=control_period).config
        self._world = World(loaded)
        self._period = control_period
        robot, limits = loaded.robot, velocity_bound(loaded, self.config.robot)
        self._servo = ToolServo(robot, limits=limits, period=control_period) if actions == "tool" else None
        self._yaw_length = limit_surface(loaded.object).radius if math.isfinite(loaded.tolerance.yaw) else 0.0
        speed = np.full(2, self.config.robot.tip_speed_limit) if self._servo is not None else limits
        most = speed.astype(np.float32)
        self._most = most.astype(float)
        self.action_space = gymnasium.spaces.Box(-most, most)
        count = 2 * robot.dof + 3 + 4 + 4
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (count,), np.float32)
        self._safety = self.config.safety
        self._guard = SafetyFilter(loaded, self._safety, control_period) if self._safety.filter else None
        self._needed = hold_steps(self.config.episode.hold_seconds, control_period)
        self._begin(self._task)

    @property
    def scene(self) -> Scene:
        """Returns the task, with the start and the goal of the present episode."""
        return self._task

    @property
    def state(self) -> Observation:
        """Returns the exact state of the plant."""
        return self._plant.truth()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins an episode, from a start that is drawn from the scene's spread unless ``options`` give one.

        Raises:
            SceneError: The task cannot be done with this start and goal.
        """
        super().reset(seed=seed)
        options = options or {}
        drawn = int(self.np_random.integers(2**32)) if seed is None else seed
        start, goal = (_pose(options.get(name)) for name in ("start", "goal"))
        task = self._task if goal is None else self._task.with_goal(goal)
        task = task.with_start(sample_start(self._first, drawn) if start is None else start)
        if start is not None or goal is not None:
            check_task(task)
        self._begin(task)
        return self._observation(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Moves for one control period; see the class for action and reward.

        Raises:
            ValueError: The action is not finite.
            FloatingPointError: The simulation diverged.
        """
        seen = self._plant.observe()
        wanted = np.clip(np.asarray(action, dtype=float), -self._most, self._most)
        command = wanted if self._servo is None else self._followed(self._servo, seen, wanted)
        self._drive.apply(filtered_command(self._guard, self._drive, seen, command).joint_velocity)
        self._trail.append(self._tip())
        before, self._left = self._left, self._distance()
        info, tolerance = self._info(), self._task.tolerance
        inside = info["position_error"] <= tolerance.position and info["yaw_error"] <= tolerance.yaw
        self._held = self._held + 1 if inside else 0
        success = self._held >= self._needed
        reward = before - self._left + float(success)
        info["is_success"] = success
        return self._observation(), reward, success or has_fallen(self.state), False, info

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Returns a picture from above, shape [height, width, 3], if the render mode is ``"rgb_array"``."""
        if self.render_mode is None:
            return None
        from oimppi_warp.plots.film import picture_from_above

        state, task = self.state, self._task
        image = picture_from_above(
            task,
            pose=state.object_pose,
            tips=np.array(self._trail[-20:]),
            goal=np.array(task.goal),
            tolerance=task.tolerance.position,
            in_view=np.array([task.start, task.goal]),
            plan=np.zeros((0, 3)),
            title=f"{task.name}\n{state.time:.1f} s",
        )
        return np.asarray(image)

    def _begin(self, task: Scene) -> None:
        """Places arm and object where a task has them."""
        self._task = task
        substeps = math.ceil(self._period / LONGEST_STEP - 1e-6)
        self._plant = SimulatedPlant(self._world, start=task.start, control_period=self._period, substeps=substeps)
        self._drive = Drive(self._plant, task.robot.dof, self._safety)
        self._held, self._left = 0, self._distance()
        self._trail = [self._tip()]

    @property
    def _first(self) -> Scene:
        """Returns the task with the start in its file, around which starts are drawn."""
        return replace(self._task, start=self._world.scene.start)

    def _followed(self, servo: ToolServo, seen: Observation, velocity: np.ndarray) -> np.ndarray:
        """Returns joint velocities that move the tip horizontally, upright, and towards the height for pushing."""
        height = float(tip_frame(self._task.robot, seen.joint_position)[1][2])
        rise = np.clip(_RISE * (self.config.cost.height - height), -_FASTEST_RISE, _FASTEST_RISE)
        return servo.joint_velocity(servo.rates(seen.joint_position), np.array([*velocity, rise]))

    def _tip(self) -> np.ndarray:
        return tip_frame(self._task.robot, self._plant.observe().joint_position)[1]

    def _distance(self) -> float:
        """Returns the object's distance to its goal, yaw included [m]."""
        position_error, yaw_error = pose_error(self.state.object_pose, self._task.goal)
        return math.hypot(position_error, self._yaw_length * yaw_error)

    def _observation(self) -> np.ndarray:
        return vector_of(self.state, self._tip(), self._task.goal)

    def _info(self) -> dict[str, Any]:
        position_error, yaw_error = pose_error(self.state.object_pose, self._task.goal)
        contacts = self._plant.contacts
        return {
            "is_success": False,
            "time": self.state.time,
            "position_error": position_error,
            "yaw_error": yaw_error,
            "force_tool_object": contacts.tool_object,
            "force_object_obstacle": contacts.object_obstacle,
            "force_robot_obstacle": contacts.robot_obstacle,
        }


def vector_of(state: Observation, tip: np.ndarray, goal: PlanarPose) -> np.ndarray:
    """Returns the observation of :class:`PushEnvironment` as a vector, shape [2 dof + 11].

    Args:
        state: The exact state.
        tip: Position of the tip, shape [3] [m].
        goal: The goal of the object.
    """
    poses = (np.array([x, y, math.cos(yaw), math.sin(yaw)]) for x, y, yaw in (state.object_pose, goal))
    return np.concatenate([state.joint_position, state.joint_velocity, tip, *poses]).astype(np.float32)


def _pose(given: Any) -> PlanarPose | None:
    """Converts an option of ``reset`` to a pose; raises ConfigError if it is none."""
    if given is None:
        return None
    pose = np.asarray(given, dtype=float)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise ConfigError(f"{given!r} is not a pose\n  allowed: x [m], y [m], yaw [rad]")
    x, y, yaw = pose.tolist()
    return x, y, yaw

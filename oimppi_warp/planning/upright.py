"""The arm with its tool upright: its fields for the kernels, and the servo that follows velocities of the tip.

Controls are velocities of the tip in two dimensions (in three while the tool is lifted over the object). The rollouts
predict how far the tip follows them (``kernels/upright_step.py``): it keeps its height, slides along obstacles and does
not press. What is predicted of the first control is the velocity that the arm is given, which :class:`ToolServo`
converts to joint velocities by resolved-rate control.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

from oimppi_warp.compute.cache import cached, content_of_data, source_content
from oimppi_warp.config.settings import RobotLevel
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.fields import Geometry, multilinear
from oimppi_warp.geometry.kinematics import pack_arm, tip_frame
from oimppi_warp.geometry.postures import STEP, Postures, halved, postures_of
from oimppi_warp.geometry.reach import can_lift, tip_rates
from oimppi_warp.geometry.tipping import tipping_height
from oimppi_warp.kernels.geometry import SpaceField
from oimppi_warp.kernels.joint_controls import SEAM
from oimppi_warp.kernels.kinematics import Environment
from oimppi_warp.kernels.upright import UprightArm, make_upright_clearance
from oimppi_warp.planning.engines.packing import no_field, table_within
from oimppi_warp.scene import Robot, Scene

_ABOVE = 0.06
"""Height of the fields above the object's top [m]."""
_OUTSIDE = -0.2
"""Clearance of tip positions outside the fields [m]."""
_BOTTOMLESS = 1e3
"""Depth of a table that nothing comes near [m]."""
_ON_TABLE = 1e-3
"""Amount by which a link has to be closer to the table than the tip for the table to count [m]."""
_SLOWEST = 0.02
"""Least speed of the tip in the fields [m/s], where a joint's velocity limit would allow almost none."""
_HIGHER, _HIGHER_SHARE = 0.008, 0.3
"""Height above that for pushing at which the tip may still touch the object: at most so much [m], and at most this
share of the height at which a push tips the object over."""
_TILT_RATE = 4.0
"""Rate at which the servo reduces the tool's tilt [1/s]."""
_HOME_RATE = 0.5
"""Rate at which the servo brings a redundant arm to its start posture [1/s]."""
_DAMPING = 1e-5
"""Damping of the servo's pseudo-inverse, in squared units of the Jacobian."""


@dataclass(frozen=True, eq=False)
class UprightModel:
    """The arm with its tool upright.

    Attributes:
        packed: Its fields, for the kernels.
        postures: Joint positions over tip positions.
    """

    packed: UprightArm
    postures: Postures

    def clearance_at(self, positions: np.ndarray) -> np.ndarray:
        """Returns the clearance of arm and tool with the tip at positions [n, 2] at the height of pushing [n] [m].

        It is at most the distance to the border of the tip's reach, and negative beyond.
        """
        field = self.packed.clearance
        at = np.column_stack([positions, np.full(len(positions), self.packed.height)])
        at = (at - np.array(field.origin)) * field.inv_step
        inside = ((at >= 0.0) & (at <= np.array(self._clearance_values.shape) - 1.0)).all(axis=-1)
        return np.where(inside, multilinear(self._clearance_values, at), field.outside)

    @cached_property
    def _clearance_values(self) -> np.ndarray:
        """Returns the values of the clearance's nodes on the host."""
        return self.packed.clearance.values.numpy()


def build_upright(
    scene: Scene,
    geometry: Geometry,
    environment: Environment,
    level: RobotLevel,
    *,
    limits: np.ndarray,
    most_change: float,
    height: float,
    device: str,
) -> UprightModel:
    """Computes the fields of an arm that holds its tool upright.

    Args:
        scene: The task.
        geometry: Shapes of the scene.
        environment: Obstacles and table, on the device.
        level: Settings of the robot level.
        limits: Joint velocity limits to plan with, shape [dof] [rad/s; m/s for a prismatic joint].
        most_change: Largest change of a joint's velocity per control step [rad/s; m/s for a prismatic joint].
        height: Height of the tip while pushing [m].
        device: Warp device.

    Raises:
        ConfigError: The arm cannot hold its tool upright.
    """
    postures = postures_of(scene.robot, geometry.top + _ABOVE)
    if not postures.reached.any():
        raise ConfigError(
            f"robot.controls = tool: {scene.robot.path} cannot hold its tool upright near its start\n"
            "  to do:   --set robot.controls=joint, or start the robot with its tool pointing down"
        )
    packed = UprightArm()
    packed.clearance = _clearance(scene, postures, environment, limits, device)
    speed = (limits / np.maximum(postures.effort, 1e-6)).min(axis=-1)
    speed = np.maximum(np.where(postures.reached, speed, 0.0), _SLOWEST)
    packed.speed = _field(speed, postures, STEP, outside=_SLOWEST, device=device)
    packed.agility = most_change / float(limits.max())
    packed.height = height
    packed.highest = height + min(_HIGHER, _HIGHER_SHARE * tipping_height(scene.object))
    packed.arm_margin, packed.object_margin = level.arm_margin, level.object_margin
    packed.touch_speed = level.touch_speed
    packed.object_clearance = geometry.clearance
    packed.within_lower, packed.within_upper = (wp.vec2(*corner) for corner in table_within(scene, geometry))
    return UprightModel(packed, postures)


def no_upright(device: str) -> UprightArm:
    """Returns an empty model, for a kernel that takes one but does not read it with these settings."""
    field = SpaceField()
    field.values = wp.zeros((0, 0, 0), dtype=float, device=device)
    packed = UprightArm()
    packed.clearance = packed.speed = field
    packed.object_clearance = no_field(device)
    return packed


def _clearance(
    scene: Scene, postures: Postures, environment: Environment, limits: np.ndarray, device: str
) -> SpaceField:
    """Returns the clearance of arm and tool over tip positions [m], from the cache if it is stored there."""
    around = environment.obstacles
    numbers = (*around.origin, around.inv_step, around.outside)
    numbers += (environment.top, environment.near, environment.tool_radius, environment.table)
    content = content_of_data(
        source_content("kernels", "geometry", "planning/upright.py"),
        scene.robot,
        postures.origin,
        postures.reached,
        around.values.numpy(),
        tuple(float(number) for number in numbers),
    )
    values = cached("clearance", content, lambda: _compute_clearance(scene, postures, environment, limits, device))
    return _field(values, postures, 0.5 * STEP, outside=_OUTSIDE, device=device)


def _compute_clearance(
    scene: Scene, postures: Postures, environment: Environment, limits: np.ndarray, device: str
) -> np.ndarray:
    """Computes the clearance of arm and tool over tip positions, twice as fine as the postures [m].

    The tool's own distance to the table does not count: the servo keeps its height, and it would hide obstacles that
    are not yet as near. The clearance is at most the distance to the border of the reach, where the arm is singular;
    beyond, minus that distance.
    """
    robot = scene.robot
    joints = halved(postures.joints, jump=SEAM)
    reached = halved(postures.reached[..., None].astype(float))[..., 0] > 1.0 - 1e-6
    shape = joints.shape[:3]
    vec = wp.types.vector(length=robot.dof, dtype=float)
    flat = wp.array(joints.reshape(-1, robot.dof).astype(np.float32), dtype=vec, device=device)
    arm = pack_arm(robot, limits, device)

    def clearance_to(around: Environment) -> np.ndarray:
        values = wp.zeros(len(flat), dtype=float, device=device)
        kernel = make_upright_clearance(robot.chain)
        wp.launch(kernel, len(flat), inputs=[arm, around, flat], outputs=[values], device=device)
        return values.numpy().reshape(shape)

    clearance = clearance_to(environment)
    without_table = copy(environment)
    without_table.table = -_BOTTOMLESS
    free = clearance_to(without_table)
    height = postures.origin[2] + 0.5 * STEP * np.arange(shape[2])
    clearance = np.where(clearance < np.minimum(free, height) - _ON_TABLE, clearance, free)
    for layer in range(shape[2]):
        inside, outside = (0.5 * STEP * _distances(where[..., layer]) for where in (reached, ~reached))
        # The border lies beyond the last node that is reached, one does not know how far.
        inside = np.minimum(clearance[..., layer], inside - 0.5 * STEP)
        clearance[..., layer] = np.where(reached[..., layer], inside, -outside)
    return clearance.astype(np.float32)


def _distances(where: np.ndarray) -> np.ndarray:
    """Returns the distance of each marked node, shape [nx, ny], to the nearest that is not, in grid steps."""
    # What lies around the grid is not marked either.
    from scipy.ndimage import distance_transform_edt

    return np.asarray(distance_transform_edt(np.pad(where, 1)))[1:-1, 1:-1]


def _field(values: np.ndarray, postures: Postures, step: float, *, outside: float, device: str) -> SpaceField:
    """Packs values over tip positions for the kernels."""
    field = SpaceField()
    field.values = wp.array(values.astype(np.float32), dtype=float, device=device)
    field.origin = wp.vec3(*postures.origin)
    field.inv_step = 1.0 / step
    field.outside = outside
    return field


@dataclass(frozen=True, eq=False)
class TipRates:
    """Jacobian of the tip at a posture, and the joint velocities that move the tip or hold the tool.

    Attributes:
        axis: The tool's z axis in the world frame, shape [3].
        linear: Jacobian of the tip's position, shape [3, dof] [m/rad].
        hold: Joint velocities per rate of the height and of the axis's x and y, shape [dof, n].
        move: Joint velocities per horizontal velocity of the tip that change neither, shape [dof, 2] [rad/m].
        home: Joint velocities towards the start posture that change neither, nor move the tip, shape [dof] [rad/s].
        fastest: Largest horizontal speed of the tip within the joints' velocity limits [m/s].
        follow: Joint velocities per velocity of the tip with the axis held, shape [dof, 3] [rad/m]; the last column is
            zero for an arm that cannot lift its tool.
    """

    axis: np.ndarray
    linear: np.ndarray
    hold: np.ndarray
    move: np.ndarray
    home: np.ndarray
    fastest: float
    follow: np.ndarray


class ToolServo:
    """Resolved-rate control of the arm: follows velocities of the tip, and holds the tool upright.

    Height and tilt have priority: near a singular posture, or at the joints' velocity limits, the tip moves more slowly
    across the table, but does not sink.

    Args:
        robot: The arm.
        limits: Joint velocity limits, shape [dof] [rad/s; m/s for a prismatic joint].
        period: Control period [s].
    """

    def __init__(self, robot: Robot, *, limits: np.ndarray, period: float) -> None:
        self._robot = robot
        self._held = slice(0 if can_lift(robot) else 1, None)  # a robot that cannot lift its tool holds no height
        self._limits, self._period = limits, period

    def rates(self, joints: np.ndarray) -> TipRates:
        """Returns the Jacobian and its inverses at joint positions, shape [dof] [rad; m for a prismatic joint]."""
        linear, tilting = tip_rates(self._robot, joints)
        held = np.vstack([linear[2], tilting])[self._held]
        hold = _damped_inverse(held)
        free = np.eye(self._robot.dof) - hold @ held
        axis = tip_frame(self._robot, joints)[0][:, 2]
        move = _damped_inverse(linear[:2] @ free)
        lift = hold[:, 0] if self._held.start == 0 else np.zeros(len(joints))
        follow = np.column_stack([move, lift - move @ linear[:2] @ lift])
        home = (free - move @ linear[:2] @ free) @ (_HOME_RATE * (self._robot.start - joints))
        fastest = float((self._limits / np.maximum(np.linalg.norm(move, axis=1), 1e-6)).min())
        return TipRates(axis, linear, hold, move, home, fastest, follow)

    def joint_velocity(self, rates: TipRates, velocity: np.ndarray) -> np.ndarray:
        """Returns the joint velocities that follow a velocity of the tip, within their limits, shape [dof] [rad/s].

        Args:
            rates: Jacobian and inverses at the present joint positions.
            velocity: Velocity of the tip, shape [3] [m/s].
        """
        hold, move, linear = rates.hold, rates.move, rates.linear
        speed = np.array(velocity[:2])
        speed *= min(1.0, max(rates.fastest, _SLOWEST) / max(float(np.hypot(*speed)), 1e-9))
        upright = -min(_TILT_RATE, 1.0 / self._period) * rates.axis[:2]
        holding = hold @ np.array([velocity[2], *upright])[self._held]
        moving = move @ (speed - linear[:2] @ holding) + rates.home
        # Height and tilt come first: what the joints have left is for the motion across the table.
        holding /= max(1.0, float(np.abs(holding / self._limits).max()))
        left = (self._limits - np.abs(holding)) / np.maximum(np.abs(moving), 1e-9)
        return holding + min(1.0, float(left.min())) * moving


def _damped_inverse(jacobian: np.ndarray) -> np.ndarray:
    """Returns the damped pseudo-inverse of a Jacobian [n, dof], shape [dof, n]."""
    return jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + _DAMPING * np.eye(len(jacobian)))

"""Packing of a task into the structs that every engine's kernels read."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from oimppi_warp.config.settings import ObjectCost, RobotCost, RobotLevel
from oimppi_warp.geometry.fields import NEAR, Geometry
from oimppi_warp.geometry.reach import object_bounds
from oimppi_warp.geometry.tipping import tipping_speed
from oimppi_warp.kernels.costs.terms import RobotWeights
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.kernels.kinematics import Environment
from oimppi_warp.kernels.pushing import ObjectModel
from oimppi_warp.scene import Scene


def object_model(geometry: Geometry, *, tool_friction: float, slack: float = 0.0, edge: bool = False) -> ObjectModel:
    """Packs the pushed object for the kernels.

    Args:
        geometry: The object's shapes and limit surface.
        tool_friction: Coulomb coefficient between tool and object; not used at the object level, which has no tool.
        slack: Clearance that the object keeps to obstacles in the model [m].
        edge: Whether the table's edge counts as an obstacle. It stops no object, but an object plan keeps away from it.
    """
    model = ObjectModel()
    model.force = geometry.surface.force
    model.radius = geometry.surface.radius
    model.tool_friction = tool_friction
    model.top = geometry.top
    model.size = geometry.size
    model.clearance = geometry.clearance if edge else geometry.obstruction
    model.body = geometry.body
    model.slack = slack
    model.center = wp.vec2(*geometry.surface.center)
    return model


def no_field(device: str) -> PoseField:
    """Returns an empty field, for a kernel that takes a field but does not read it with these settings."""
    field = PoseField()
    field.values = wp.zeros((0, 0, 0), dtype=float, device=device)
    return field


def velocity_bound(scene: Scene, level: RobotLevel) -> np.ndarray:
    """Returns the largest joint velocities to plan with, shape [dof] [rad/s; m/s for a prismatic joint]."""
    return np.minimum([joint.velocity_limit for joint in scene.robot.joints], level.joint_velocity_limit)


def tip_bound(level: RobotLevel) -> np.ndarray:
    """Returns the largest velocity of the tip to plan with along each axis, shape [3] [m/s]."""
    return np.full(3, level.tip_speed_limit)


def environment(scene: Scene, geometry: Geometry, cost: RobotCost) -> Environment:
    """Packs the obstacles and the table, which the arm must keep clear of, for the kernels."""
    packed = Environment()
    packed.obstacles = geometry.space
    packed.top = geometry.space_top
    packed.near = max(cost.arm_clearance, NEAR)
    packed.tool_radius = scene.robot.tool_radius
    return packed


def table_within(scene: Scene, geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Returns the corners of the rectangle in which the object's centre keeps it on the table and within reach [m]."""
    lower, upper = object_bounds(scene)
    return lower + geometry.size, upper - geometry.size


def robot_weights(scene: Scene, geometry: Geometry, cost: RobotCost) -> Any:
    """Packs the weights of the robot level (``RobotWeights``) for the kernels."""
    weights = pack_weights(cost, table_within(scene, geometry))
    weights.topple_speed = cost.rush * tipping_speed(scene.object)
    weights.size = geometry.size
    return weights


def pack_weights(cost: RobotCost, edge: tuple[np.ndarray, np.ndarray]) -> Any:
    """Packs the weights of the robot level (``RobotWeights``) for the kernels.

    Args:
        cost: The weights.
        edge: The rectangle of :func:`table_within`.
    """
    weights = RobotWeights()
    fill_weights(weights, cost)
    weights.edge_lower, weights.edge_upper = wp.vec2(*edge[0]), wp.vec2(*edge[1])
    return weights


def fill_weights(weights: Any, cost: RobotCost | ObjectCost) -> None:
    """Writes settings into their struct, made by :func:`oimppi_warp.kernels.costs.terms.weights_struct`."""
    for name, value in vars(cost).items():
        if hasattr(weights, name) and isinstance(value, int | float | tuple):
            setattr(weights, name, wp.vec2(*value) if isinstance(value, tuple) else value)

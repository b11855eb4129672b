"""Cost-to-go of the object over the grid of phi_2: lengths of the shortest free paths."""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from oimppi_warp.compute.cache import cached, content_of
from oimppi_warp.geometry.fields import pose_field_at
from oimppi_warp.geometry.footprint import wrap_angle
from oimppi_warp.geometry.pose_grid import STEP
from oimppi_warp.kernels.fields import cost_to_go as kernels
from oimppi_warp.kernels.geometry import PoseField

_SWEEPS = 200
"""Largest number of sweeps; a few dozen usually suffice."""
_SETTLED = 1e-4
"""Improvement in all 8 directions below which the sweeps have converged [m]."""
_UNKNOWN = 1e3
_COMFORT = 0.02
"""Clearance below which a metre costs more [m]: two cells of phi_2."""
_CROWDED = 10.0
"""Additional cost of a metre at zero clearance: a detour of eleven times the length is preferred to touching."""
_OUT_OF_REACH = 10.0
"""Cost of a metre where the arm pushes badly: crossed only if there is no other path."""
_BLOCKED = 120.0
"""Cost of a metre inside an obstacle: more than any free path, but finite, so that there is a path out of it."""
_ALONG = 0.5
"""Cost of a metre along a known path: the cost-to-go leads onto it, and stays on it past a shorter path beside it."""
_NEAR = 4.0 * STEP
"""Distance from the known path within which the straight distance is used [m]."""


def build_to_go(
    clearance: PoseField,
    way: np.ndarray,
    *,
    yaw_length: float,
    push_ring: tuple[float, float] = (0.0, np.inf),
    bound: PoseField | None = None,
    device: str,
) -> PoseField:
    """Builds the cost-to-go: the length of the shortest free path to a goal, or to a path that leads there [m].

    A metre along a known path costs 0.5. Elsewhere it costs 1, up to 11 close to obstacles, 10 where the arm pushes
    badly, and 120 inside obstacles, so that there is a path out of them. The field is computed
    on the CPU by fast sweeping; the one to a goal alone is kept in the cache.

    Args:
        clearance: phi_2.
        way: Known path: poses [n, 3] of the friction centre, of which the last is the goal; one pose is the goal alone.
        yaw_length: Length that a radian of yaw counts as [m].
        push_ring: Distances from the base's axis between which the arm can push well [m]; widened to the goal.
        bound: The cost-to-go to the goal alone, if known: an initial bound that saves most sweeps.
        device: Warp device of the result.
    """
    way = np.atleast_2d(way)
    host = PoseField()
    host.values = clearance.values.to("cpu")
    host.origin, host.inv_step, host.inv_yaw_step = clearance.origin, clearance.inv_step, clearance.inv_yaw_step
    travel = kernels.TravelCost()
    travel.yaw_length, travel.comfort, travel.crowded, travel.blocked = yaw_length, _COMFORT, _CROWDED, _BLOCKED
    at_goal = float(np.hypot(*way[-1, :2]))
    travel.ring_inner, travel.ring_outer = min(push_ring[0], at_goal), max(min(push_ring[1], 1e3), at_goal)
    travel.far = _OUT_OF_REACH

    def compute() -> np.ndarray:
        to_go = wp.full(host.values.shape, _UNKNOWN, dtype=float, device="cpu")
        if bound is not None:
            wp.copy(to_go, bound.values)
        left = _ALONG * np.concatenate([np.cumsum(path_lengths(way, yaw_length)[::-1])[::-1], [0.0]])
        for pose, length in zip(way, left, strict=True):
            first, size = _box_around(host, pose, yaw_length)
            inputs = [host, travel, wp.vec3(*pose), _NEAR, float(length), wp.vec3i(*first)]
            wp.launch(kernels.seed_to_go, dim=size, inputs=inputs, outputs=[to_go], device="cpu")
        stale = wp.full(host.values.shape, 1, dtype=wp.uint8, device="cpu")
        change = wp.zeros(1, dtype=float, device="cpu")
        improvement = np.full(8, np.inf)
        for sweep in range(_SWEEPS):
            inputs = [host, travel, sweep % 8]
            wp.launch(kernels.sweep_to_go, dim=1, inputs=inputs, outputs=[to_go, stale, change], device="cpu")
            improvement[sweep % 8] = change.numpy()[0]
            if improvement.max() < _SETTLED:
                break
        return to_go.numpy()

    numbers = [*host.origin, host.inv_step, travel.yaw_length, travel.comfort, travel.crowded, travel.blocked]
    numbers += [travel.ring_inner, travel.ring_outer, travel.far, _NEAR, _SETTLED, _SWEEPS]
    content = content_of(host.values.numpy(), way, numbers)
    field = PoseField()
    # A goal recurs, a planned path does not.
    values = cached("togo", content, compute) if len(way) == 1 else compute()
    field.values = wp.array(values, dtype=float, device=device)
    field.origin, field.inv_step, field.inv_yaw_step = clearance.origin, clearance.inv_step, clearance.inv_yaw_step
    return field


def to_go_at(field: PoseField, values: np.ndarray, pose: np.ndarray, goal: np.ndarray, yaw_length: float) -> float:
    """Looks up a cost-to-go on the host, as the kernels do [m]: close to the goal it is the straight distance.

    Args:
        field: The cost-to-go.
        values: Its values on the host.
        pose: A planar pose, shape [3] [m, m, rad].
        goal: The goal, likewise.
        yaw_length: Length that a radian of yaw counts as [m].
    """
    x, y, yaw = (goal - pose).tolist()
    straight = math.hypot(x, y, yaw_length * wrap_angle(yaw))
    share = min(max(straight / kernels.NEAR_GOAL - 1.0, 0.0), 1.0)
    return (1.0 - share) * straight + share * pose_field_at(field, pose, values)


def path_lengths(path: np.ndarray, yaw_length: float) -> np.ndarray:
    """Returns the lengths of the steps of a path of poses, shape [n - 1] [m]; a radian counts as ``yaw_length`` [m]."""
    steps = np.diff(path, axis=0)
    steps[:, 2] = yaw_length * wrap_angle(steps[:, 2])
    return np.linalg.norm(steps, axis=1)


def _box_around(field: PoseField, pose: np.ndarray, yaw_length: float) -> tuple[list[int], list[int]]:
    """Returns the first node and the size (yaw, x, y) of a box with all nodes within ``_NEAR`` of a planar pose."""
    turns = field.values.shape[0]
    half = np.array([_NEAR / yaw_length * field.inv_yaw_step, _NEAR * field.inv_step, _NEAR * field.inv_step])
    at = np.array(
        [
            pose[2] * field.inv_yaw_step,
            (pose[0] - field.origin[0]) * field.inv_step,
            (pose[1] - field.origin[1]) * field.inv_step,
        ]
    )
    first = np.floor(at - half).astype(int)
    size = np.ceil(at + half).astype(int) - first + 1
    size[0] = min(size[0], turns)
    first[0] %= turns
    return first.tolist(), size.tolist()

"""Comparisons of physics models."""

from __future__ import annotations

import mujoco
import newton
import numpy as np
import pytest
import warp as wp

from oimppi_warp.geometry.footprint import rotation_matrix, transform_points
from oimppi_warp.geometry.kinematics import link_frames
from oimppi_warp.observation import planar_transform
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World
from oimppi_warp.scene import Collider, Scene


def assert_shapes_agree(scene: Scene) -> None:
    """MuJoCo has every collider of a scene, with its role, size and place, and no other."""
    mapped = World(scene).mujoco
    model = mapped.model
    data = mujoco.MjData(model)
    data.qpos[mapped.joint_qpos] = scene.robot.start
    data.qpos[mapped.object_qpos] = planar_transform(scene.start, scene.object.rest_height)[[0, 1, 2, 6, 3, 4, 5]]
    mujoco.mj_kinematics(model, data)
    placed = list(_placed(scene))
    assert model.ngeom == len(placed) + 1  # and the table
    names = [model.geom(geom).name for geom in range(model.ngeom)]
    for role, collider, rotation, position in placed:
        (geom,) = (i for i, name in enumerate(names) if name.rpartition("_")[0] == collider.path)
        assert ROLES[mapped.roles[geom]] == role
        expected = transform_points(collider.transform, _support(collider)) @ rotation.T + position
        actual = _geom_support(model, geom, collider) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        for axis in np.vstack([np.eye(3), -np.eye(3), np.ones(3)]):
            assert np.max(actual @ axis) == pytest.approx(np.max(expected @ axis), abs=1e-5)


def link_transforms(world: World, joint_position: np.ndarray) -> np.ndarray:
    """Position and quaternion xyzw [dof, 7] of the arm's moving links by Newton's forward kinematics (float32)."""
    model = world.newton.model
    coords = model.joint_q.numpy().copy()
    coords[world.newton.joint_coords] = joint_position
    state, still = model.state(), wp.zeros(model.joint_dof_count, dtype=float, device="cpu")
    newton.eval_fk(model, wp.array(coords, dtype=float, device="cpu"), still, state)
    return state.body_q.numpy()[world.newton.link_bodies]


def _placed(scene: Scene):
    """Role, collider, and pose of the frame that it is given in, of every collider at the start."""
    rotations, positions = link_frames(scene.robot, scene.robot.start)
    tool = scene.robot.tool_path.rpartition("/")[0]
    for link, rotation, position in zip(scene.robot.links, rotations, positions, strict=True):
        for collider in link.colliders:
            yield "tool" if collider.path.startswith(tool) else "arm", collider, rotation, position
    still = np.eye(3), np.zeros(3)
    yield from (("base", collider, *still) for collider in scene.robot.base.colliders)
    yield from (("obstacle", collider, *still) for obstacle in scene.obstacles for collider in obstacle.colliders)
    pose = planar_transform(scene.start, scene.object.rest_height)
    yield from (("object", collider, rotation_matrix(pose[3:]), pose[:3]) for collider in scene.object.colliders)


def _support(collider: Collider) -> np.ndarray:
    """Points that show a collider's size and direction, in its own frame, shape [n, 3]."""
    if collider.kind == "mesh":
        return collider.vertices
    if collider.kind == "box":
        return np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * collider.size
    radius, half = (*collider.size, 0.0)[:2]
    return np.array([(radius, 0, half), (radius, 0, -half), (-radius, 0, half), (-radius, 0, -half)])


def _geom_support(model: mujoco.MjModel, geom: int, collider: Collider) -> np.ndarray:
    """The same points of a geom, from MuJoCo's sizes."""
    if collider.kind == "mesh":
        mesh = model.mesh(model.geom_dataid[geom])
        return model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
    sizes = model.geom_size[geom][: len(collider.size)]
    return _support(Collider(collider.path, collider.kind, collider.transform, tuple(sizes)))

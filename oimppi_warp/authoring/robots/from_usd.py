"""Reads a robot from a simulator's USD file, without this package's schemas: its tree of links, in Newton's builder."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import networkx as nx
import numpy as np
from pxr import UsdPhysics

from oimppi_warp.authoring.robots.articulation import Articulation, matrix_of
from oimppi_warp.authoring.robots.chain import Chain, Kind, Limits, TreeJoint, serial_chain
from oimppi_warp.errors import SceneError
from oimppi_warp.usd.stage import SceneStage

if TYPE_CHECKING:
    import newton

_UNLIMITED = 1e6
"""Newton's value for no limit; larger values are also treated as unlimited."""


def read_usd(file: Path, *, flange: str = "") -> tuple[Chain, Articulation]:
    """Reads the chain in a USD articulation, with the properties of its links and joints, by prim path.

    Args:
        file: The USD file.
        flange: Path or name of the link that carries the stick; other moving links are then ignored. Empty: the end of
            the only chain.

    Raises:
        SceneError: The file cannot be read, does not give its units, floats, branches or has joints that cannot be
            driven.
    """
    scene = SceneStage(file)
    _check(scene)
    import newton

    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    try:
        found = builder.add_usd(scene.stage, load_visual_shapes=True, enable_self_collisions=False)
    except Exception as error:  # Newton's importer raises many kinds of exceptions
        raise SceneError(f"the file cannot be read ({error})", file=file, allowed="a USD articulation") from error
    bodies, joints = found["path_body_map"], found["path_joint_map"]
    tree, base = _tree(builder, bodies, joints, file)
    chain = serial_chain(tree, file=file, flange=_path_of(flange, bodies))
    return chain, Articulation(builder, bodies=bodies, joints=joints, file=file, base=base)


def _check(scene: SceneStage) -> None:
    """Raises SceneError unless the stage has exactly one robot."""
    roots = [prim for prim in scene.prims() if prim.HasAPI(UsdPhysics.ArticulationRootAPI)]
    if len(roots) != 1:
        fix = "apply PhysicsArticulationRootAPI to one prim"
        raise scene.error(f"the file has {len(roots)} articulations", allowed="one robot", fix=fix)


def _tree(
    builder: newton.ModelBuilder, bodies: dict[str, int], joints: dict[str, int], file: Path
) -> tuple[nx.DiGraph, np.ndarray]:
    """Builds a graph of the links and the joints between them, and returns the pose of the base in the world."""
    import newton

    kinds: dict[int, Kind] = {
        newton.JointType.REVOLUTE: "turns",
        newton.JointType.PRISMATIC: "slides",
        newton.JointType.FIXED: "fixed",
    }
    names = {index: path for path, index in bodies.items()}
    tree, base = nx.DiGraph(), None
    tree.add_nodes_from(bodies)
    for path, joint in joints.items():
        parent, child, kind = builder.joint_parent[joint], builder.joint_child[joint], builder.joint_type[joint]
        if kind not in kinds:
            what = f"the joint is of type {newton.JointType(kind).name.lower()}"
            allowed = "PhysicsRevoluteJoint, PhysicsPrismaticJoint, PhysicsFixedJoint"
            raise SceneError(what, file=file, prim=path, allowed=allowed)
        if parent >= 0:
            limits = None if kinds[kind] == "fixed" else _limits(builder, joint)
            tree.add_edge(
                names[parent],
                names[child],
                joint=TreeJoint(path, kinds[kind], limits, losses=_has_losses(builder, joint, kinds[kind])),
            )
        elif kinds[kind] == "fixed":
            base = matrix_of(builder.joint_X_p[joint]) @ np.linalg.inv(matrix_of(builder.joint_X_c[joint]))
    if base is None:
        fix = "add one PhysicsFixedJoint with only physics:body1 set"
        raise SceneError("the robot's base is not fixed to the world", file=file, allowed="a fixed base", fix=fix)
    return tree, base


def _has_losses(builder: newton.ModelBuilder, joint: int, kind: Kind) -> bool:
    """Returns whether a joint has friction or damping, apart from its drive's."""
    at = builder.joint_qd_start[joint]
    return kind != "fixed" and bool(builder.joint_friction[at] or builder.joint_damping[at])


def _limits(builder: newton.ModelBuilder, joint: int) -> Limits:
    at = builder.joint_qd_start[joint]
    arrays = builder.joint_limit_lower, builder.joint_limit_upper, builder.joint_effort_limit
    values = [float(array[at]) for array in (*arrays, builder.joint_velocity_limit)]
    return Limits(*(math.copysign(math.inf, value) if abs(value) >= _UNLIMITED else value for value in values))


def _path_of(flange: str, bodies: dict[str, int]) -> str:
    """Returns the path of a link given by its path or its name."""
    named = [path for path in bodies if path.rpartition("/")[2] == flange]
    return named[0] if len(named) == 1 and flange not in bodies else flange

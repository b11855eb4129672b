"""Writes a recorded episode as a bag: its record, and what Foxglove and RViz display of its scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.config import ros2_topics as names
from oimppi_warp.observation import planar_transform
from oimppi_warp.record.bag import BagWriter
from oimppi_warp.record.bag_record import stamps_of, write_log
from oimppi_warp.view.posed_scene import PosedScene
from oimppi_warp.view.replay import Replay

GOAL_FRAME = "goal"
"""Frame of the object at its goal."""

_GHOST = 0.3
"""Opacity of the object at its goal."""


@dataclass(frozen=True, eq=False)
class _Shape:
    """A visible shape.

    Attributes:
        label: Path of its prim.
        body: Index of its body; -1 for the world.
        transform: Its transform in the frame of its body, shape [7].
        kind: Name of the type of marker.
        scale: Size of the marker along its axes, shape [3] [m].
        color: Red, green and blue, shape [3].
        points: Corners of the triangles, shape [n, 3] [m]; empty for other markers.
    """

    label: str
    body: int
    transform: np.ndarray
    kind: str
    scale: np.ndarray
    color: np.ndarray
    points: np.ndarray


def write_bag(replay: Replay, folder: Path) -> Path:
    """Writes an episode with all of its control steps; simulated time begins at the epoch.

    Args:
        replay: The episode.
        folder: Folder to write; it must not exist yet.

    Returns:
        The MCAP file in the folder.

    Raises:
        ConfigError: The package rosbags is not installed.
    """
    scene, log = replay.scene, replay.log
    began, stamps = stamps_of(log)
    with BagWriter(folder) as bag:
        posed = PosedScene(scene)
        frames = _frames(posed, scene.object.path)
        fixed = _fixed(posed)
        goal = planar_transform(scene.goal, scene.object.rest_height)
        still = {frames[body]: posed.state.body_q.numpy()[body] for body in fixed} | {GOAL_FRAME: goal}
        bag.write(names.TF_STATIC, began, bag.transforms(began, still), latched=True)
        bag.write(names.MARKERS, began, _markers(bag, began, posed, frames, scene.object.path), latched=True)
        write_log(bag, log, [joint.name for joint in scene.robot.joints], scene.object.rest_height)
        for row, stamp in enumerate(stamps.tolist()):
            picture = replay.picture(row)
            posed.pose(picture.joints, picture.object_transform)
            where = posed.state.body_q.numpy()
            moved = {name: where[body] for body, name in enumerate(frames) if body not in fixed}
            bag.write(names.TF, stamp, bag.transforms(stamp, moved))
    return bag.file


def _frames(posed: PosedScene, object_path: str) -> list[str]:
    """Returns the frame of each body: the last part of its path, or the whole path where that is not unique."""
    paths = list(posed.model.body_label)
    short = [path.rpartition("/")[2] for path in paths]
    taken = [*short, names.WORLD_FRAME, names.OBJECT_FRAME, GOAL_FRAME]
    frames = [last if taken.count(last) == 1 else path.strip("/") for path, last in zip(paths, short, strict=True)]
    return [names.OBJECT_FRAME if path == object_path else frame for path, frame in zip(paths, frames, strict=True)]


def _fixed(posed: PosedScene) -> set[int]:
    """Returns the bodies that are fixed to the world, directly or through others."""
    import newton

    model = posed.model
    kinds, parents, children = (
        array.numpy().tolist()  # pyright: ignore[reportOptionalMemberAccess]
        for array in (model.joint_type, model.joint_parent, model.joint_child)
    )
    fixed = {-1}
    for kind, parent, child in zip(kinds, parents, children, strict=True):  # parents come first
        if kind == newton.JointType.FIXED and parent in fixed:
            fixed.add(child)
    return fixed - {-1}


def _shapes(posed: PosedScene) -> Iterator[_Shape]:
    """Yields every visible shape."""
    import newton

    kinds = newton.GeoType
    primitives = {
        kinds.BOX: ("CUBE", lambda a, b, c: (2 * a, 2 * b, 2 * c)),
        kinds.SPHERE: ("SPHERE", lambda a, b, c: (2 * a, 2 * a, 2 * a)),
        kinds.ELLIPSOID: ("SPHERE", lambda a, b, c: (2 * a, 2 * b, 2 * c)),
        kinds.CYLINDER: ("CYLINDER", lambda a, b, c: (2 * a, 2 * a, 2 * b)),
    }
    model = posed.model
    arrays = (model.shape_transform, model.shape_scale, model.shape_color, model.shape_body, model.shape_type)
    transform, scale, color, body, kind = (array.numpy() for array in arrays)  # pyright: ignore
    visible = model.shape_flags.numpy() & newton.ShapeFlags.VISIBLE  # pyright: ignore
    for i in np.flatnonzero(visible).tolist():
        common = model.shape_label[i], int(body[i]), transform[i]
        mesh = model.shape_source[i]
        if kind[i] == kinds.CAPSULE:
            radius, half = map(float, scale[i][:2])
            mesh = newton.Mesh.create_capsule(radius, half, up_axis=newton.Axis.Z, compute_inertia=False)
        if isinstance(mesh, newton.Mesh):
            stretch = np.ones(3) if kind[i] == kinds.CAPSULE else scale[i]
            points = np.asarray(mesh.vertices)[np.asarray(mesh.indices).reshape(-1)] * stretch
            yield _Shape(*common, "TRIANGLE_LIST", np.ones(3), color[i], points)
        elif kind[i] in primitives:
            name, size = primitives[kind[i]]
            yield _Shape(*common, name, np.array(size(*map(float, scale[i]))), color[i], np.zeros((0, 3)))


def _markers(bag: BagWriter, stamp: int, posed: PosedScene, frames: list[str], object_path: str) -> Any:
    """Returns a visualization_msgs/MarkerArray: each visible shape in the frame of its body, and the object's goal."""
    markers = []
    for shape in _shapes(posed):
        frame = names.WORLD_FRAME if shape.body < 0 else frames[shape.body]
        markers.append(_marker(bag, stamp, shape, frame, shape.label.strip("/"), len(markers), 1.0))
        if shape.body >= 0 and posed.model.body_label[shape.body] == object_path:
            markers.append(_marker(bag, stamp, shape, GOAL_FRAME, GOAL_FRAME, len(markers), _GHOST))
    return bag.make("visualization_msgs/msg/MarkerArray", markers=markers)


def _marker(bag: BagWriter, stamp: int, shape: _Shape, frame: str, group: str, number: int, opacity: float) -> Any:
    """Returns a visualization_msgs/Marker that moves with its frame."""
    make = bag.make
    sx, sy, sz = map(float, shape.scale)
    red, green, blue = map(float, shape.color)
    header = bag.header(stamp, frame)
    nothing = np.zeros(0, dtype=np.uint8)
    kind = bag.types["visualization_msgs/msg/Marker"]
    return make(
        "visualization_msgs/msg/Marker",
        header=header,
        ns=group,
        id=number,
        type=getattr(kind, shape.kind),
        action=kind.ADD,
        pose=bag.pose(shape.transform),
        scale=make("geometry_msgs/msg/Vector3", x=sx, y=sy, z=sz),
        color=make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=opacity),
        lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=True,
        points=[make("geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y, z in shape.points.tolist()],
        colors=[],
        texture_resource="",
        texture=make("sensor_msgs/msg/CompressedImage", header=header, format="", data=nothing),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )

"""Writes a recorded episode as a bag: its record, and what Foxglove and RViz display of its scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.config import ros2_topics as names
from oimppi_warp.observation import planar_transform
from oimppi_warp.record.bag import BagWriter
from oimppi_warp.record.bag_record import stamps_of, write_log
from oimppi_warp.scene import Scene
from oimppi_warp.view.replay import Replay
from oimppi_warp.view.shapes import Shape, body_frames, visible_shapes

GOAL_FRAME = "goal"
"""Frame of the object at its goal."""

_GHOST = 0.3
"""Opacity of the object at its goal."""
_MARKERS: dict[str, tuple[str, Callable[..., tuple[float, float, float]]]] = {
    "box": ("CUBE", lambda x, y, z: (2.0 * x, 2.0 * y, 2.0 * z)),
    "sphere": ("SPHERE", lambda radius: (2.0 * radius, 2.0 * radius, 2.0 * radius)),
    "cylinder": ("CYLINDER", lambda radius, half: (2.0 * radius, 2.0 * radius, 2.0 * half)),
}
"""Type of marker, and its scale by the shape's size, of some kinds of shapes; others are lists of triangles."""


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
    start = planar_transform(scene.start, scene.object.rest_height)
    at_start = body_frames(scene, scene.robot.start, start)
    names_of, base = _names(list(at_start), scene.object.path), scene.robot.base
    fixed = {base.path, *(part.path for part in base.welded)}
    goal = planar_transform(scene.goal, scene.object.rest_height)
    with BagWriter(folder) as bag:
        still = {names_of[path]: at_start[path] for path in fixed} | {GOAL_FRAME: goal}
        bag.write(names.TF_STATIC, began, bag.transforms(began, still), latched=True)
        bag.write(names.MARKERS, began, _markers(bag, began, scene, names_of), latched=True)
        write_log(bag, log, [joint.name for joint in scene.robot.joints], scene.object.rest_height)
        for row, stamp in enumerate(stamps.tolist()):
            picture = replay.picture(row)
            frames = body_frames(scene, picture.joints, picture.object_transform)
            moved = {names_of[path]: frame for path, frame in frames.items() if path not in fixed}
            bag.write(names.TF, stamp, bag.transforms(stamp, moved))
    return bag.file


def _names(paths: list[str], object_path: str) -> dict[str, str]:
    """Returns the name of each body's frame: the last part of its path, or the whole path where that is not unique."""
    short = [path.rpartition("/")[2] for path in paths]
    taken = [*short, names.WORLD_FRAME, names.OBJECT_FRAME, GOAL_FRAME]
    own = {path: last if taken.count(last) == 1 else path.strip("/") for path, last in zip(paths, short, strict=True)}
    return own | {object_path: names.OBJECT_FRAME, "": names.WORLD_FRAME}


def _markers(bag: BagWriter, stamp: int, scene: Scene, names_of: dict[str, str]) -> Any:
    """Returns a visualization_msgs/MarkerArray: each visible shape in the frame of its body, and the object's goal."""
    markers = []
    for shape in visible_shapes(scene):
        markers.append(_marker(bag, stamp, shape, names_of[shape.body], shape.path.strip("/"), len(markers), 1.0))
        if shape.body == scene.object.path:
            markers.append(_marker(bag, stamp, shape, GOAL_FRAME, GOAL_FRAME, len(markers), _GHOST))
    return bag.make("visualization_msgs/msg/MarkerArray", markers=markers)


def _marker(bag: BagWriter, stamp: int, shape: Shape, frame: str, group: str, number: int, opacity: float) -> Any:
    """Returns a visualization_msgs/Marker that moves with its frame."""
    name, size = _MARKERS.get(shape.kind, ("TRIANGLE_LIST", lambda *_: (1.0, 1.0, 1.0)))
    points = shape.vertices[shape.faces.reshape(-1)] if shape.kind not in _MARKERS else np.zeros((0, 3))
    make = bag.make
    sx, sy, sz = size(*shape.size)
    red, green, blue = map(float, shape.color)
    header = bag.header(stamp, frame)
    nothing = np.zeros(0, dtype=np.uint8)
    kind = bag.types["visualization_msgs/msg/Marker"]
    return make(
        "visualization_msgs/msg/Marker",
        header=header,
        ns=group,
        id=number,
        type=getattr(kind, name),
        action=kind.ADD,
        pose=bag.pose(shape.transform),
        scale=make("geometry_msgs/msg/Vector3", x=sx, y=sy, z=sz),
        color=make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=opacity * shape.opacity),
        lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=True,
        points=[make("geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y, z in points.tolist()],
        colors=[],
        texture_resource="",
        texture=make("sensor_msgs/msg/CompressedImage", header=header, format="", data=nothing),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )

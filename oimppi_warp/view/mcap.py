"""Writes a recorded episode in Foxglove's schemas: shapes and their transforms, the reference, and plotted values."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
from foxglove.channels import FrameTransformsChannel, SceneUpdateChannel
from foxglove.messages import (
    Color,
    FrameTransform,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)

from oimppi_warp.view.posed_scene import PosedScene
from oimppi_warp.view.replay import Replay

_WORLD = "world"


def write_mcap(replay: Replay, file: Path, rows: Iterable[int]) -> None:
    """Writes an episode, with simulated time starting at zero.

    Args:
        replay: The episode.
        file: File to write; it must not exist yet.
        rows: Control steps to write.
    """
    posed = PosedScene(replay.scene)
    context = foxglove.Context()
    transforms = FrameTransformsChannel("/tf", context=context)
    scene = SceneUpdateChannel("/scene", context=context)
    figures = foxglove.Channel("/figures", message_encoding="json", context=context)
    with foxglove.open_mcap(file, context=context):
        for n, row in enumerate(rows):
            picture = replay.picture(row)
            posed.pose(picture.joints, picture.object_transform)
            nanoseconds = round(1e9 * picture.time)
            stamp = Timestamp(sec=nanoseconds // 10**9, nsec=nanoseconds % 10**9)
            frames = [_transform(f"body{i}", q, stamp) for i, q in enumerate(posed.state.body_q.numpy())]
            transforms.log(FrameTransforms(transforms=frames), log_time=nanoseconds)
            entities = [*_shapes(posed, stamp)] if n == 0 else []
            entities.append(_reference(picture.reference, stamp))
            scene.log(SceneUpdate(entities=entities), log_time=nanoseconds)
            known = {name: value for name, value in picture.figures.items() if np.isfinite(value)}
            figures.log(known, log_time=nanoseconds)


def _transform(child: str, q: np.ndarray, stamp: Timestamp) -> FrameTransform:
    x, y, z, qx, qy, qz, qw = map(float, q)
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id=_WORLD,
        child_frame_id=child,
        translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )


def _shapes(posed: PosedScene, stamp: Timestamp) -> Iterable[SceneEntity]:
    """Yields every visible shape as triangles in the frame of its body."""
    import newton

    model = posed.model
    arrays = (model.shape_transform, model.shape_scale, model.shape_color)
    transform, scale, color = (array.numpy() for array in arrays)  # pyright: ignore
    body, kind, flags = model.shape_body.numpy(), model.shape_type.numpy(), model.shape_flags.numpy()  # pyright: ignore
    for i in range(model.shape_count):
        source = model.shape_source[i]
        if not flags[i] & newton.ShapeFlags.VISIBLE:
            continue
        mesh = source if isinstance(source, newton.Mesh) else _solid(int(kind[i]), scale[i])
        if mesh is None:
            continue
        stretch = scale[i] if mesh is source else np.ones(3)
        points = np.asarray(mesh.vertices)[np.asarray(mesh.indices).reshape(-1)] * stretch
        x, y, z, qx, qy, qz, qw = map(float, transform[i])
        triangles = TriangleListPrimitive(
            pose=Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw)),
            points=[Point3(x=float(p[0]), y=float(p[1]), z=float(p[2])) for p in points],
            color=Color(r=float(color[i][0]), g=float(color[i][1]), b=float(color[i][2]), a=1.0),
        )
        frame = _WORLD if body[i] < 0 else f"body{body[i]}"
        yield SceneEntity(timestamp=stamp, frame_id=frame, id=f"shape{i}", triangles=[triangles])


def _solid(kind: int, scale: np.ndarray) -> Any:
    """Converts a primitive shape to a mesh."""
    import newton

    a, b, c = map(float, scale)
    makers = {
        newton.GeoType.BOX: lambda: newton.Mesh.create_box(a, b, c, duplicate_vertices=False, compute_inertia=False),
        newton.GeoType.SPHERE: lambda: newton.Mesh.create_sphere(a, compute_inertia=False),
        newton.GeoType.CYLINDER: lambda: newton.Mesh.create_cylinder(
            a, b, up_axis=newton.Axis.Z, compute_inertia=False
        ),
        newton.GeoType.CAPSULE: lambda: newton.Mesh.create_capsule(a, b, up_axis=newton.Axis.Z, compute_inertia=False),
    }
    maker = makers.get(newton.GeoType(kind))
    return None if maker is None else maker()


def _reference(path: np.ndarray, stamp: Timestamp) -> SceneEntity:
    line = LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        pose=Pose(position=Vector3(x=0.0, y=0.0, z=0.0), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)),
        thickness=0.006,
        color=Color(r=0.95, g=0.6, b=0.1, a=1.0),
        points=[Point3(x=float(x), y=float(y), z=0.06) for x, y, _ in path],
    )
    return SceneEntity(timestamp=stamp, frame_id=_WORLD, id="reference", lines=[line])

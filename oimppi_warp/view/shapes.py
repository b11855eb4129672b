"""The visible shapes of a scene, as Newton's USD import finds them, and the frames of its bodies.

The shapes of a file are cached by its content: to find them again would import Newton, which takes seconds. An object
or obstacle that was only moved keeps its appearance; one that is new, or has another shape, is drawn as its colliders.
"""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from zipfile import BadZipFile

import numpy as np

from oimppi_warp.compute.cache import cache_folder, content_of_data, source_content, store_arrays, touch
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import collider_mesh, quaternion_product, transform_points
from oimppi_warp.scene import Collider, Joint, Scene
from oimppi_warp.view.display import Color

if TYPE_CHECKING:
    import newton
    import trimesh

GHOSTS = r"/[^/]+/Goal(/.*)?"
"""Prims of a file that are not displayed: the ghost at the goal is drawn at the current goal instead."""
_NEUTRAL = (0.46, 0.46, 0.46)
"""Colour of shapes without one."""
_STILL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2}
"""Number of dimensions of each kind of shape but meshes; in capitals, these are Newton's names."""
_SHARP = np.radians(30.0)
"""Angle between two faces beyond which their common edge is drawn sharp [rad]."""
_ENDLESS = 10.0
"""Drawn side of a plane without end [m]."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A visible shape.

    Attributes:
        path: Prim path.
        body: Prim path of the body that it moves with; empty for the world.
        transform: Position [m] and quaternion xyzw in the frame of the body, shape [7].
        kind: Type of shape.
        size: Dimensions [m], as those of :class:`oimppi_warp.scene.Collider`.
        color: Red, green and blue from 0 to 1, as displayed (sRGB), shape [3].
        opacity: From 0 to 1.
        vertices: Vertices of the surface in the shape's frame, shape [n, 3] [m]; doubled where an edge is sharp.
        faces: Its triangles, shape [m, 3].
        textured: The surface with its texture, as a glTF binary; empty without a texture.
    """

    path: str
    body: str
    transform: np.ndarray
    kind: Literal["box", "sphere", "cylinder", "capsule", "mesh"]
    size: tuple[float, ...]
    color: Color
    opacity: float
    vertices: np.ndarray
    faces: np.ndarray
    textured: bytes = b""


def body_frames(scene: Scene, joints: np.ndarray, object_transform: np.ndarray) -> dict[str, np.ndarray]:
    """Returns the frame of each body: position [m] and quaternion xyzw in the world, shape [7], by its prim path.

    Args:
        scene: The task.
        joints: Joint positions, shape [dof] [rad; m for a prismatic joint].
        object_transform: The object's frame, shape [7].
    """
    robot, frame, frames = scene.robot, _STILL, {}
    at_rest = [_STILL, *(joint.parent_transform for joint in robot.joints)]
    motions = [_STILL, *(_motion_of(joint, position) for joint, position in zip(robot.joints, joints, strict=True))]
    for link, rest, motion in zip((robot.base, *robot.links), at_rest, motions, strict=True):
        frame = frames[link.path] = placed(placed(frame, rest), motion)
        for part in link.welded:
            frames[part.path] = placed(frame, part.transform)
    return frames | {scene.object.path: np.asarray(object_transform, dtype=float)}


def _motion_of(joint: Joint, position: float) -> np.ndarray:
    """Returns the transform of a joint's frame from position zero to another [rad, or m], shape [7]."""
    if joint.kind == "prismatic":
        return np.array([0.0, 0.0, position, 0.0, 0.0, 0.0, 1.0])
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.sin(position / 2.0), np.cos(position / 2.0)])


def placed(frame: np.ndarray, transform: np.ndarray) -> np.ndarray:
    """Returns in the world a transform that is given in a frame; position [m] and quaternion xyzw, shape [7] each."""
    position = transform_points(frame, transform[:3])[0]
    return np.concatenate([position, quaternion_product(frame[3:], transform[3:])])


def visible_shapes(scene: Scene) -> tuple[Shape, ...]:
    """Returns the visible shapes of a scene.

    Raises:
        SceneError: The scene's file can no longer be read.
    """
    return FileShapes(scene).of(scene)


class FileShapes:
    """The visible shapes of a scene's file, and of the scenes that are made from it.

    The file is read once: what is drawn does not change when the file is edited meanwhile.

    Args:
        scene: A scene from the file.

    Attributes:
        file: The file.

    Raises:
        SceneError: The file can no longer be read.
    """

    def __init__(self, scene: Scene) -> None:
        from oimppi_warp.usd import load_scene

        self.file = scene.file
        content, shared = _content(scene.file)
        stored = cache_folder() / f"shapes-{content}.npz"
        self._original = scene
        if not shared:  # what is open in this process may differ from the file
            with suppress(OSError, ValueError, KeyError, EOFError, BadZipFile):  # missing or truncated: find it again
                self._shapes, things = _load(stored)
                if things != _things(scene):
                    self._original = load_scene(scene.file)
                return
        self._original = load_scene(scene.file)
        self._shapes = tuple(_find(self._original))
        gc.collect()  # Newton's import leaves the stage in a cycle; while it is there, OpenUSD reads no newer file
        if not shared and _content(scene.file)[0] == content:  # it was not saved meanwhile
            with suppress(OSError):  # an unwritable cache costs time, but not the view
                _save(self._shapes, _things(self._original), stored)

    def of(self, scene: Scene) -> tuple[Shape, ...]:
        """Returns the visible shapes of a scene that was made from the file's."""
        if _things(scene) == _things(self._original):
            return self._shapes
        return tuple(_edited(self._shapes, scene, self._original))


def collider_shapes(
    colliders: tuple[Collider, ...], body: str, color: Color, *, opacity: float = 1.0
) -> Iterator[Shape]:
    """Yields colliders in the frame of a body as visible shapes, all of the same colour."""
    for collider in colliders:
        surface = _smooth(collider_mesh(replace(collider, transform=_STILL)))
        yield Shape(
            path=collider.path,
            body=body,
            transform=collider.transform,
            kind=collider.kind,
            size=collider.size,
            color=color,
            opacity=opacity,
            vertices=surface.vertices,
            faces=surface.faces,
        )


def _edited(shapes: tuple[Shape, ...], scene: Scene, original: Scene) -> Iterator[Shape]:
    """Yields the shapes of a file as they are in a scene that was made from it."""
    from oimppi_warp.usd.editing import rigid_motion

    known = {each.path: each for each in (original.object, *original.obstacles)}
    by_thing: dict[str, list[Shape]] = {path: [] for path in ("", *known)}
    for shape in shapes:  # a thing may be below another one
        by_thing[max((path for path in known if _is_below(shape, path)), key=len, default="")].append(shape)
    yield from by_thing[""]
    for each in (scene.object, *scene.obstacles):
        before, old = known.get(each.path), by_thing.get(each.path, [])
        motion = None if before is None else rigid_motion(before.colliders, each.colliders)
        if motion is not None:
            yield from (replace(shape, transform=placed(motion, shape.transform)) for shape in old)
        else:
            body = each.path if each is scene.object else ""
            yield from collider_shapes(each.colliders, body, old[0].color if old else _NEUTRAL)


def _is_below(shape: Shape, path: str) -> bool:
    return f"{shape.path}/".startswith(f"{path}/")


def _content(file: Path) -> tuple[str, bool]:
    """Returns a hash of a file, of all that it refers to, of the code here, and of the packages that read it.

    Returns:
        The hash, and whether any of these files is open in this process, so that OpenUSD would not read it again.

    Raises:
        SceneError: The file can no longer be read.
    """
    from pxr import Ar, Sdf, Tf, UsdUtils

    from oimppi_warp.usd.stage import file_of

    silenced = UsdUtils.CoalescingDiagnosticDelegate()  # keeps USD's own warnings out of the terminal
    open_already = {layer.realPath for layer in Sdf.Layer.GetLoadedLayers()}
    try:
        layers, assets, _ = UsdUtils.ComputeAllDependencies(str(file))
        parts = [*map(file_of, layers), *(Path(Ar.SplitPackageRelativePathOuter(asset)[0]) for asset in assets)]
        contents = tuple(hashlib.sha256(part.read_bytes()).digest() for part in parts)
    except (OSError, Tf.ErrorException) as error:
        raise SceneError("the scene can no longer be read", file=file, fix="restore the file") from error
    finally:
        del silenced
    sources = source_content("view/shapes.py", "usd", "geometry", "scene.py")
    packages = tuple(version(name) for name in ("newton", "usd-core", "trimesh"))
    return content_of_data(sources, packages, contents), any(layer.realPath in open_already for layer in layers)


def _things(scene: Scene) -> str:
    """Returns a hash of what can be moved, added and removed in a scene."""
    return content_of_data(scene.object, scene.obstacles)


def _find(scene: Scene) -> Iterator[Shape]:
    """Yields the visible shapes of a scene's file, as Newton imports them."""
    import newton

    from oimppi_warp.compute.loading import quick_compilation
    from oimppi_warp.usd.stage import SceneStage

    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    with quick_compilation():  # of the kernels that compute the inertia of meshes
        stage = SceneStage(scene.file).stage
        builder.add_usd(stage, load_visual_shapes=True, enable_self_collisions=False, ignore_paths=[GHOSTS])
    for i in range(builder.shape_count):
        kind, scale = newton.GeoType(builder.shape_type[i]), np.array(builder.shape_scale[i], dtype=float)
        surface = _surface(kind, scale, builder.shape_source[i])
        if surface is None or not builder.shape_flags[i] & newton.ShapeFlags.VISIBLE:
            continue
        name: Any = kind.name.lower()
        number = builder.shape_body[i]
        body = "" if number < 0 else builder.body_label[number]
        place = np.array(builder.shape_transform[i], dtype=float)
        if body == scene.robot.base.path:  # whose frame is the world's in a scene
            place = placed(np.array(builder.body_q[number], dtype=float), place)
        red, green, blue = np.clip(builder.shape_color[i], 0.0, 1.0).tolist()
        opacity = float(np.clip(builder.shape_opacity[i], 0.0, 1.0))
        yield Shape(
            path=builder.shape_label[i],
            body=body,
            transform=place,
            kind=name if name in _SIZES else "mesh",
            size=tuple(scale[: _SIZES.get(name, 0)].tolist()),
            color=(red, green, blue),
            opacity=opacity,
            vertices=np.asarray(surface.vertices, dtype=np.float32),
            faces=np.asarray(surface.faces, dtype=np.uint32),
            textured=_textured(builder.shape_source[i], surface, opacity),
        )


def _surface(kind: newton.GeoType, scale: np.ndarray, source: Any) -> trimesh.Trimesh | None:
    """Returns the surface of one of Newton's shapes; ``None`` for a kind of which no surface is drawn."""
    import newton
    import trimesh

    if isinstance(source, newton.Mesh):
        corners = np.asarray(source.indices).reshape(-1, 3)
        return trimesh.Trimesh(np.asarray(source.vertices) * scale, corners, process=False)
    name: Any = kind.name.lower()
    if name in _SIZES:
        return _smooth(collider_mesh(Collider("", name, _STILL, tuple(scale[: _SIZES[name]].tolist()))))
    if kind == newton.GeoType.CONE:
        cone = trimesh.creation.cone(radius=scale[0], height=2.0 * scale[1], sections=32)
        cone.apply_translation((0.0, 0.0, -scale[1]))
        return _smooth(cone)
    if kind == newton.GeoType.PLANE:
        x, y = np.where(scale[:2] > 0.0, scale[:2], _ENDLESS) / 2.0
        corners = [(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)]
        return trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)
    return None


def _smooth(surface: trimesh.Trimesh) -> trimesh.Trimesh:
    """Returns a surface with doubled vertices along its sharp edges, so that they are drawn as edges."""
    import trimesh

    return trimesh.graph.smooth_shade(surface, angle=_SHARP)


def _textured(source: Any, surface: trimesh.Trimesh, opacity: float) -> bytes:
    """Returns the surface of one of Newton's meshes with its texture, as a glTF binary; empty without a texture."""
    from newton.utils import load_texture

    uvs = getattr(source, "uvs", None)
    image = load_texture(getattr(source, "texture", None))  # None if it cannot be read
    if image is None or uvs is None or len(uvs) != len(surface.vertices):
        return b""
    from PIL import Image
    from trimesh.visual.material import PBRMaterial
    from trimesh.visual.texture import TextureVisuals

    uvs = np.asarray(uvs, dtype=float)
    if source.texture_transform is not None:
        uvs = np.column_stack([uvs, np.ones(len(uvs))]) @ np.asarray(source.texture_transform, dtype=float).T
    clear = opacity < 1.0 or (image.shape[-1] == 4 and bool((image[..., 3] < 255).any()))
    material = PBRMaterial(
        baseColorTexture=Image.fromarray(image),
        baseColorFactor=(255, 255, 255, round(255 * opacity)),
        metallicFactor=0.0,
        roughnessFactor=1.0,
        alphaMode="BLEND" if clear else "OPAQUE",
    )
    shown = surface.copy()
    shown.visual = TextureVisuals(uv=uvs, material=material)
    return shown.export(file_type="glb")  # pyright: ignore[reportReturnType]  (glTF is bytes)


def _save(shapes: tuple[Shape, ...], things: str, file: Path) -> None:
    """Writes the shapes of a scene's file, and the hash of its object and obstacles, to one file."""
    arrays: dict[str, Any] = {"things": np.array(things), "count": np.array(len(shapes))}
    for number, shape in enumerate(shapes):
        for field in fields(shape):
            value = getattr(shape, field.name)
            arrays[f"{number}.{field.name}"] = np.frombuffer(value, np.uint8) if field.name == "textured" else value
    store_arrays(file, arrays)


def _load(file: Path) -> tuple[tuple[Shape, ...], str]:
    """Reads a file written by :func:`_save`: the shapes, and the hash."""
    with np.load(file) as saved:
        arrays = dict(saved)
    touch(file)
    names = [field.name for field in fields(Shape)]
    shapes = []
    for number in range(int(arrays["count"])):
        values: dict[str, Any] = {name: arrays[f"{number}.{name}"] for name in names}
        for name in ("path", "body", "kind"):
            values[name] = str(values[name])
        for name in ("size", "color"):
            values[name] = tuple(values[name].tolist())
        shapes.append(Shape(**values | {"opacity": float(values["opacity"]), "textured": values["textured"].tobytes()}))
    return tuple(shapes), str(arrays["things"])

"""A page in the browser, served by viser to this machine only unless asked otherwise, on which pictures are drawn."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

import numpy as np

from oimppi_warp.network import page_url
from oimppi_warp.scene import Collider, Scene, Table
from oimppi_warp.view.display import Color
from oimppi_warp.view.shapes import FileShapes, Shape, body_frames, collider_shapes

Point = tuple[float, float, float]

EYE, TARGET = (1.7, -0.95, 1.15), (0.42, 0.12, 0.05)
"""Position of the camera, and the point it looks at [m], for the table of the shipped arms."""
_CENTER, _SIDE = np.array([0.375, 0.0, 0.0]), 1.6
"""Centre and longer side of that table [m]."""
_FIELD_OF_VIEW = np.radians(45.0)
"""Vertical field of view of the camera [rad]."""
_COLLIDER, _COLLIDER_OPACITY = (1.0, 0.55, 0.1), 0.45
"""Colour and opacity of colliders."""


def view_of(table: Table, *, eye: Point = EYE, target: Point = TARGET) -> tuple[np.ndarray, np.ndarray]:
    """Returns where the camera stands and looks, shape [3] each [m]: at a smaller table, it stands nearer.

    Args:
        table: The table.
        eye, target: Where the camera stands and looks for the table of the shipped arms.
    """
    lower, upper = np.array([*table.lower, 0.0]), np.array([*table.upper, 0.0])
    share = min(0.2 + 0.8 * float((upper - lower).max()) / _SIDE, 1.0)  # the robot's height does not shrink as much
    center = 0.5 * (lower + upper) if share < 1.0 else _CENTER
    return center + share * (np.array(eye) - _CENTER), center + share * (np.array(target) - _CENTER)


class Page:
    """A page in the browser, and a :class:`oimppi_warp.view.display.Display`.

    Args:
        table: The table that the camera looks at.
        host: Address to listen on.
        port: First port to try; if it is taken, the next free one is used.

    Attributes:
        server: The :class:`viser.ViserServer`, which is listening.
        url: Address of the page.
        open: Whether the page stays open; once it does not, views end.
    """

    def __init__(self, table: Table, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        import viser

        logging.getLogger("websockets").setLevel(logging.WARNING)
        with redirect_stdout(io.StringIO()):  # hides viser's banner; the caller prints the address if needed
            self.server = viser.ViserServer(host=host, port=port, label="oimppi", verbose=False)
        self.url = page_url(host, self.server.get_port())
        self.open = True
        camera = self.server.initial_camera
        camera.position, camera.look_at = view_of(table)
        camera.fov = _FIELD_OF_VIEW
        self.server.scene.add_light_ambient("/ambient")
        self.server.scene.configure_environment_map(hdri=None)
        self._notice = self.server.gui.add_markdown("", order=-20.0, visible=False)
        self._file: FileShapes | None = None
        self._scene: Scene | None = None
        self._visible: list[Any] = []
        self._colliders: list[Any] = []
        self._shown = True, False
        self._drawn: dict[str, Any] = {}
        self._latest: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def close(self) -> None:
        """Ends the server."""
        self.open = False
        with redirect_stdout(io.StringIO()):  # hides that viser says so
            self.server.stop()

    @contextmanager
    def saying(self, doing: str) -> Iterator[None]:
        """Says on the page that something is being done, such as ``loading kernels``."""
        self._notice.content = f"**{doing[0].upper()}{doing[1:]} ...**"
        self._notice.visible = True
        try:
            yield
        finally:
            self._notice.visible = False

    @property
    def watched(self) -> bool:
        """Returns whether a browser shows the page."""
        return bool(self.server.get_clients())

    @contextmanager
    def frame(self, time: float) -> Iterator[None]:
        """Shows at once what is drawn within the block, whatever its time."""
        with self.server.atomic():
            yield
        self.server.flush()

    def load(self, scene: Scene) -> None:
        """Replaces the scene.

        Raises:
            SceneError: The scene's file can no longer be read; the old scene stays.
        """
        if self._file is None or self._file.file != scene.file:
            self._file = FileShapes(scene)
        shapes = self._file.of(scene)
        if self._scene is not None:
            self._root.remove()  # and everything below it
        self._scene = scene
        # Numbers as names: a body or shape may be below another one in the file, but moves by itself here.
        self._root = self.server.scene.add_frame("/bodies", show_axes=False)
        paths = ["", *body_frames(scene, scene.robot.start, np.zeros(7))]
        self._bodies = {
            path: self.server.scene.add_frame(f"/bodies/{number}", show_axes=False) for number, path in enumerate(paths)
        }
        self._visible = [self._add(shape, f"visible{n}", self._shown[0]) for n, shape in enumerate(shapes)]
        self._colliders = []
        self._add_colliders()

    def show_shapes(self, *, visible: bool, colliders: bool) -> None:
        """Shows what is visible of a scene, and the colliders of arm, object and obstacles, or hides them."""
        if (visible, colliders) == self._shown:
            return
        self._shown = visible, colliders
        self._add_colliders()
        for handles, shown in zip((self._visible, self._colliders), self._shown, strict=True):
            for handle in handles:
                handle.visible = shown

    def pose(self, joints: np.ndarray, object_transform: np.ndarray) -> None:
        """Moves arm and object; see :meth:`oimppi_warp.view.display.Display.pose`."""
        assert self._scene is not None, "a scene has been loaded"
        for path, frame in body_frames(self._scene, joints, object_transform).items():
            self._bodies[path].position = frame[:3]
            self._bodies[path].wxyz = np.roll(frame[3:], 1)

    def lines(self, name: str, segments: np.ndarray, colors: np.ndarray, width: float) -> None:
        """Draws line segments; see :meth:`oimppi_warp.view.display.Display.lines`."""
        before = self._latest.get(name)
        if before is not None and before[0] is segments and before[1] is colors:
            return
        self._latest[name] = segments, colors
        points = np.asarray(segments, dtype=np.float32)
        shades = np.repeat(_bytes(colors)[:, None], 2, axis=1)
        drawn = self._drawn.get(name)
        if drawn is not None and len(drawn.points) == len(points):
            drawn.points, drawn.colors = points, shades
        else:  # replaces those of the same name
            self._drawn[name] = self.server.scene.add_line_segments(
                f"/lines/{name}", points, shades, thickness=width, thickness_units="screen"
            )

    def points(self, name: str, points: np.ndarray, radius: float, color: Color) -> None:
        """Draws points of one colour; see :meth:`oimppi_warp.view.display.Display.points`."""
        drawn = self._drawn.get(name)
        if drawn is not None and len(drawn.points) == len(points):
            drawn.points = np.asarray(points, dtype=np.float32)
        else:
            self._drawn[name] = self.server.scene.add_point_cloud(
                f"/points/{name}",
                np.asarray(points, dtype=np.float32),
                tuple(_bytes(np.array(color)).tolist()),
                point_size=radius,
                point_shape="circle",
            )

    def _add_colliders(self) -> None:
        """Adds the colliders once they are wanted."""
        if self._scene is None or not self._shown[1] or self._colliders:
            return
        shapes = [
            shape
            for body, colliders in _colliders(self._scene)
            for shape in collider_shapes(colliders, body, _COLLIDER, opacity=_COLLIDER_OPACITY)
        ]
        self._colliders = [self._add(shape, f"collider{n}", True) for n, shape in enumerate(shapes)]

    def _add(self, shape: Shape, name: str, visible: bool) -> Any:
        """Adds a shape to its body, and returns viser's handle."""
        name = f"{self._bodies[shape.body].name}/{name}"
        given: dict[str, Any] = {
            "position": shape.transform[:3],
            "wxyz": np.roll(shape.transform[3:], 1),
            "visible": visible,
        }
        if shape.textured:
            return self.server.scene.add_glb(name, shape.textured, **given)
        return self.server.scene.add_mesh_simple(
            name,
            shape.vertices,
            shape.faces,
            color=tuple(_bytes(np.array(shape.color)).tolist()),
            opacity=None if shape.opacity == 1.0 else shape.opacity,
            **given,
        )


def _colliders(scene: Scene) -> Iterator[tuple[str, tuple[Collider, ...]]]:
    """Yields the body, or an empty path for the world, and the colliders of each obstacle, link and the object."""
    for obstacle in scene.obstacles:
        yield "", obstacle.colliders
    for link in (scene.robot.base, *scene.robot.links):
        yield link.path, link.colliders
    yield scene.object.path, scene.object.colliders


def _bytes(color: np.ndarray) -> np.ndarray:
    """Returns colours from 0 to 1 as bytes."""
    return np.rint(255.0 * np.clip(color, 0.0, 1.0)).astype(np.uint8)

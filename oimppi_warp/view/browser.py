"""Opens Newton's browser viewer with the package's defaults: local access only, and a camera aimed at the table."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

import numpy as np

from oimppi_warp.network import page_url
from oimppi_warp.scene import Table

Point = tuple[float, float, float]

EYE, TARGET = (1.7, -0.95, 1.15), (0.42, 0.12, 0.05)
"""Position of the camera, and the point it looks at [m], for the table of the shipped arms."""
_CENTER, _SIDE = np.array([0.375, 0.0, 0.0]), 1.6
"""Centre and longer side of that table [m]."""
_FIELD_OF_VIEW = np.radians(45.0)
"""Vertical field of view of the camera [rad]; the default of Newton's own window."""


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
    """A page in the browser that says what is being loaded until a viewer draws on it.

    Args:
        table: The table that the camera looks at.
        host: Address to listen on.
        port: First port to try; if it is taken, the next free one is used.

    Attributes:
        server: The :class:`viser.ViserServer`, which is listening.
        url: Address of the page.
    """

    def __init__(self, table: Table, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        import viser

        logging.getLogger("websockets").setLevel(logging.WARNING)
        with redirect_stdout(io.StringIO()):  # hides viser's banner; the caller prints the address if needed
            self.server = viser.ViserServer(host=host, port=port, label="oimppi", verbose=False)
        self.url = page_url(host, self.server.get_port())
        camera = self.server.initial_camera
        camera.position, camera.look_at = view_of(table)
        camera.fov = _FIELD_OF_VIEW
        self._notice = self.server.gui.add_markdown("", order=-20.0, visible=False)

    @contextmanager
    def saying(self, doing: str) -> Iterator[None]:
        """Says on the page that something is being done, such as ``loading kernels``."""
        self._notice.content = f"**{doing[0].upper()}{doing[1:]} ...**"
        self._notice.visible = True
        try:
            yield
        finally:
            self._notice.visible = False

    def viewer(self, *, paused: bool = False) -> Any:
        """Returns a :class:`newton.viewer.ViewerViser` that draws on this page.

        Args:
            paused: Whether the viewer starts paused.
        """
        import viser
        from newton.viewer import ViewerViser

        class Viewer(ViewerViser):
            """Newton's viewer, but the page's camera stays; it would move everybody's to its own default.

            Moving a visitor's camera there and back is no way out: viser sends nothing for a camera that it
            believes to be there already, and the page may just have told it so.
            """

            def _reset_camera_to_default(self, up_axis: int) -> None:
                pass

        new, viser.ViserServer = viser.ViserServer, lambda **_options: self.server  # instead of another server
        try:
            viewer = Viewer(paused=paused, verbose=False)
        finally:
            viser.ViserServer = new
        viewer.picking_enabled = False  # picking applies forces to Newton's state; here the plant moves the bodies
        return viewer


def open_viewer(table: Table, *, host: str = "127.0.0.1", port: int = 8080, paused: bool = False) -> Any:
    """Opens a :class:`newton.viewer.ViewerViser` on a page of its own; the arguments are those of :class:`Page`."""
    return Page(table, host=host, port=port).viewer(paused=paused)

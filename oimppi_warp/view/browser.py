"""Opens Newton's browser viewer with the package's defaults: local access only, and a camera aimed at the table."""

from __future__ import annotations

import io
import logging
from contextlib import redirect_stdout
from typing import Any

EYE, TARGET = (1.7, -0.95, 1.15), (0.42, 0.12, 0.05)
"""Position of the camera, and the point it looks at [m]."""


def open_viewer(*, host: str = "127.0.0.1", port: int = 8080, paused: bool = False) -> Any:
    """Opens a :class:`newton.viewer.ViewerViser`, on the next free port if the given one is taken.

    Args:
        host: Address to listen on.
        port: First port to try.
        paused: Whether the viewer starts paused.
    """
    from newton.viewer import ViewerViser

    logging.getLogger("websockets").setLevel(logging.WARNING)
    with redirect_stdout(io.StringIO()):  # hides viser's banner; the caller prints the address if needed
        viewer = ViewerViser(host=host, port=port, paused=paused, label="oimppi", verbose=False)
    viewer.picking_enabled = False  # picking applies forces to Newton's state, but here the plant moves the bodies
    camera = viewer.server.initial_camera
    camera.position, camera.look_at, camera.up = EYE, TARGET, (0.0, 0.0, 1.0)
    viewer._camera_request = None  # the initial camera is the one above
    return viewer

"""Newton's viewer in the browser, as everything here uses it: on this machine alone, with a camera on the table."""

from __future__ import annotations

import io
import logging
from contextlib import redirect_stdout
from typing import Any

EYE, TARGET = (1.7, -0.95, 1.15), (0.42, 0.12, 0.05)
"""Where the camera stands and what it looks at [m]."""


def open_viewer(*, host: str = "127.0.0.1", port: int = 8080, paused: bool = False) -> Any:
    """A :class:`newton.viewer.ViewerViser` that is listening; the next free port is taken if that one is not.

    Args:
        host: Address that it listens at.
        port: Where to begin looking for a free one.
        paused: Whether it begins paused.
    """
    from newton.viewer import ViewerViser

    logging.getLogger("websockets").setLevel(logging.WARNING)
    with redirect_stdout(io.StringIO()):  # viser's banner: who opens a viewer says where it is, if anybody should know
        viewer = ViewerViser(host=host, port=port, paused=paused, label="oimppi", verbose=False)
    viewer.picking_enabled = False  # its springs pull at Newton's state; here the plant moves things
    camera = viewer.server.initial_camera
    camera.position, camera.look_at, camera.up = EYE, TARGET, (0.0, 0.0, 1.0)
    viewer._camera_request = None  # the initial camera is the one above
    return viewer

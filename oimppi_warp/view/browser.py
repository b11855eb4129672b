"""Opens Newton's browser viewer with the package's defaults: local access only, and a camera aimed at the table."""

from __future__ import annotations

import io
import logging
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from oimppi_warp.scene import Table

Point = tuple[float, float, float]

EYE, TARGET = (1.7, -0.95, 1.15), (0.42, 0.12, 0.05)
"""Position of the camera, and the point it looks at [m], for the table of the shipped arms."""
_CENTER, _SIDE = np.array([0.375, 0.0, 0.0]), 1.6
"""Centre and longer side of that table [m]."""


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


def open_viewer(table: Table, *, host: str = "127.0.0.1", port: int = 8080, paused: bool = False) -> Any:
    """Opens a :class:`newton.viewer.ViewerViser`, on the next free port if the given one is taken.

    Args:
        table: The table that the camera looks at.
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
    camera.position, camera.look_at = view_of(table)
    camera.up = (0.0, 0.0, 1.0)
    viewer._camera_request = None  # the initial camera is the one above
    return viewer

"""Shows sessions and records in Rerun: it has no controls, but keeps the whole past, which can be scrubbed through.

Rerun's server is a process of its own: it listens at the requested address only, and its page stays smooth while this
process plans.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import socket
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from oimppi_warp.errors import ConfigError
from oimppi_warp.network import free_port, page_url
from oimppi_warp.scene import Table
from oimppi_warp.signals import check_interrupted
from oimppi_warp.view.browser import view_of
from oimppi_warp.view.canvas import Canvas
from oimppi_warp.view.controls import FPS
from oimppi_warp.view.newton_display import NewtonDisplay
from oimppi_warp.view.picture import Picture
from oimppi_warp.view.replay import Replay
from oimppi_warp.view.session import Session

if TYPE_CHECKING:
    from newton.viewer import ViewerBase

TIMELINE = "episode"
"""Name of the time from the start of the episode."""
_PATIENCE = 20.0
"""Time within which Rerun's server must listen [s]."""


class RerunServer:
    """Rerun's server and its page.

    Args:
        host: Address to listen on.
        port: Port of the page, or the next free one; the data have another port after it.

    Raises:
        ConfigError: The server did not start.
    """

    def __init__(self, host: str, port: int) -> None:
        import rerun_cli

        self.port = free_port(host, port)
        data = free_port(host, self.port + 1)
        program = str(Path(str(rerun_cli.__file__)).with_name("rerun"))
        ports = ["--port", str(data), "--web-viewer-port", str(self.port)]
        self._process = subprocess.Popen(
            [program, "--serve-web", "--bind", host, *ports],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C ends this process, which then ends the server
        )
        here = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        self.address = _data_url(page_url(here, data))
        self.url = f"{page_url(host, self.port)}/?url={quote(_data_url(page_url(host, data)), safe='')}"
        end = time.monotonic() + _PATIENCE
        while not all(_listens(here, each) for each in (data, self.port)):
            if self._process.poll() is not None or time.monotonic() > end:
                self.close()
                raise ConfigError(
                    f"Rerun's server did not start at {host}\n  to do:   try `rerun --serve-web` by itself"
                )
            time.sleep(0.05)

    def close(self) -> None:
        """Ends the server."""
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=5.0)


def open_rerun(table: Table, address: str) -> ViewerBase:
    """Opens a :class:`newton.viewer.ViewerRerun` that sends to a server and keeps the past.

    Args:
        table: The table that the camera looks at.
        address: Where Rerun's server takes data.
    """
    import rerun as rr
    import rerun.blueprint as rrb
    from newton.viewer import ViewerRerun

    position, target = view_of(table)

    class Viewer(ViewerRerun):
        """Newton's viewer with time in seconds from the start of the episode, and with our plots."""

        def begin_frame(self, time: float) -> None:
            self.time = time
            rr.set_time(TIMELINE, duration=time)

        def _get_blueprint(self) -> Any:
            eye = rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 0.0, 1.0))
            plots = [rrb.TimeSeriesView(origin=f"/{name}", name=name) for name in ("figures", "costs")]
            scene = rrb.Spatial3DView(origin="/", name="scene", eye_controls=eye)
            return rrb.Blueprint(
                rrb.Horizontal(scene, rrb.Vertical(*plots), column_shares=[2, 1]),
                rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
                collapse_panels=True,
            )

    viewer = Viewer(app_id="oimppi", address=address, keep_historical_data=True)
    rr.reset_time()  # Newton's own timeline, which has points in time instead of durations
    rr.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    return viewer


class RerunView:
    """Sends pictures, each at its time, with its figures and the cost terms of its cheapest sample.

    Args:
        viewer: The viewer, such as that of :func:`open_rerun`.
    """

    def __init__(self, viewer: ViewerBase) -> None:
        self._viewer: Any = viewer
        self._display = NewtonDisplay(viewer)
        self._canvas = Canvas(self._display)

    def send(self, picture: Picture) -> None:
        """Sends one picture."""
        with self._display.frame(picture.time):
            self._canvas.draw(picture)
            for folder, values in (("figures", picture.figures), ("costs", picture.terms)):
                for name, value in values.items():
                    self._viewer.log_scalar(f"/{folder}/{_path(name)}", value)

    def show(self, shown: Session | Replay) -> None:
        """Starts a session and sends what happens, or sends a whole record at once; runs until it is interrupted."""
        if isinstance(shown, Replay):
            for row in range(len(shown)):
                check_interrupted()
                self.send(shown.picture(row))
        else:
            shown.watched = True
            shown.start()
        sent: Picture | None = None
        while self._viewer.is_running():
            check_interrupted()
            if isinstance(shown, Session) and (picture := shown.latest) is not sent:
                self.send(picture)
                sent = picture
            time.sleep(1.0 / FPS)


def _listens(host: str, port: int) -> bool:
    """Returns whether something listens on a port."""
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0):
        return True
    return False


def _data_url(page: str) -> str:
    """Returns the address at which Rerun's data are served, from the URL that a page there would have."""
    return f"rerun+{page}/proxy"


def _path(name: str) -> str:
    """Returns a name without what is special in Rerun's paths, such as ``yaw_error_rad``."""
    return "_".join("".join(each if each.isalnum() else " " for each in name).split())

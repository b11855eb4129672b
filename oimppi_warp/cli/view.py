"""The commands ``oimppi view`` and ``oimppi export``."""

from __future__ import annotations

import importlib.util
import io
import os
import sys
import webbrowser
from contextlib import ExitStack, nullcontext, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from oimppi_warp.cli.options import REAL, TaskOptions, busy, notices
from oimppi_warp.errors import ConfigError, missing_package
from oimppi_warp.network import check_listening

if TYPE_CHECKING:
    from rich.console import Console

    from oimppi_warp.scene import Table
    from oimppi_warp.view.browser import Page
    from oimppi_warp.view.canvas import Canvas
    from oimppi_warp.view.picture import Picture
    from oimppi_warp.view.session import Session


@dataclass(frozen=True)
class View(TaskOptions):
    """Watch planning and pushing in a browser and change the task while it runs, or replay a record.

    Closing the browser does not stop the run (a real arm it does); Ctrl-C does. Exit status: 0, or 2 for bad input.
    """

    scene: Annotated[Positional[str], arg(metavar="[SCENE]")] = "task02"
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    replay: Annotated[Path | None, arg(metavar="DIR|BAG", help_behavior_hint="")] = None
    """Record to replay: a folder written by `oimppi run --record` or by a trial of `oimppi bench`,
    or a bag written by `oimppi export --to mcap` or `--to rosbag2`."""

    viewer: Literal["browser", "rerun"] = "browser"
    """Page to watch on. browser: with controls that change the run. rerun: Rerun (extra rerun), which has no such
    controls but keeps the past, so that one can go back while the run goes on; not with a real arm."""

    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Network address to listen on; 0.0.0.0 allows connections from other machines."""

    port: Annotated[int, arg(metavar="N")] = 8080
    """Port to listen on; if this port is in use, the next free one is used."""

    paused: bool = False
    """Pause before the first control step or frame."""

    open: bool = True
    """Open the page in this machine's browser, if there is one."""

    def execute(self) -> int:
        """Serves the view until Ctrl-C and returns the exit status."""
        if not 1 <= self.port <= 65535:
            raise ConfigError(f"--port {self.port} cannot be used\n  allowed: 1 to 65535")
        check_listening(self.host, self.port)
        if self.viewer == "rerun":
            return self._rerun()
        with ExitStack() as stack:
            if self.replay is not None:
                self._replay(self.replay, stack)
            elif self.run.plant in REAL:
                self._real(stack)
            else:
                self._simulated(stack)
        return 0

    def _replay(self, record: Path, stack: ExitStack) -> None:
        """Shows a record until Ctrl-C."""
        from oimppi_warp.view.replay import Replay, ReplayView

        replay = Replay(record)
        page = self._open(replay.scene.table, stack)
        canvas = self._draw(page, replay.picture(0), notices())
        ReplayView(page, canvas, replay, paused=self.paused).run()

    def _real(self, stack: ExitStack) -> None:
        """Shows a real arm until Ctrl-C; the page opens last, since the push begins when somebody opens it."""
        setup, console = self.prepare()
        with busy(console, "loading the planner"):
            from oimppi_warp.view.session import Session

            session = Session(setup)
            stack.callback(session.close)
        page = self._open(setup.scene.table, stack)
        stack.callback(session.close)  # before the page is closed, which may take seconds
        self._show(page, self._draw(page, session.latest, console), session)

    def _simulated(self, stack: ExitStack) -> None:
        """Shows a simulation until Ctrl-C; the browser loads the page while all else is prepared."""
        scene = self.read()
        from oimppi_warp.usd.stage import SCENES

        own = scene.file.parent != SCENES or self.start is not None or self.goal is not None
        # What may well be refused is checked before there is a page.
        prepared = self.prepare(scene) if own or self.run.device not in ("auto", "cpu") else None
        page = self._open(scene.table, stack)
        with page.saying("checking the task"):
            setup, console = prepared or self.prepare(scene)
        from oimppi_warp.compute.device import kernels_are_cached
        from oimppi_warp.view.picture import Picture

        compiled = kernels_are_cached()
        # Compiling goes on while the scene is drawn; loading what is compiled would only delay it.
        with nullcontext() if compiled else setup.loading_kernels():
            canvas = self._draw(page, Picture.of_start(setup.scene), console)
            with busy(console, "loading the planner"), page.saying("loading the planner"):
                from oimppi_warp.view.session import Session

                session = Session(setup)
                stack.callback(session.close)
        if not compiled:  # the address has scrolled away
            print(f"The planner is ready: {page.url}", flush=True)
        self._show(page, canvas, session)

    def _open(self, table: Table, stack: ExitStack) -> Page:
        """Opens a page and prints its address.

        Args:
            table: The table that the camera looks at.
            stack: Closes the page at the end; from here on, it takes Ctrl-C for the end of the view, not for an error.
        """
        from oimppi_warp.view.browser import Page

        page = Page(table, host=self.host, port=self.port)
        stack.callback(page.close)
        self._tell(page.url, page.server.get_port())
        stack.enter_context(suppress(KeyboardInterrupt))
        return page

    def _draw(self, page: Page, first: Picture, console: Console) -> Canvas:
        """Draws the first picture on a page."""
        with busy(console, "drawing the scene"), page.saying("drawing the scene"):
            from oimppi_warp.view.canvas import Canvas

            canvas = Canvas(page)
            canvas.show(first)
        return canvas

    def _show(self, page: Page, canvas: Canvas, session: Session) -> None:
        """Shows a session until Ctrl-C."""
        from oimppi_warp.view.live import LiveView

        LiveView(page, canvas, session, paused=self.paused).run()

    def _rerun(self) -> int:
        """Shows the run or the record in Rerun until Ctrl-C, and returns the exit status."""
        if importlib.util.find_spec("rerun") is None:
            raise missing_package("--viewer rerun", "rerun-sdk", "rerun")
        if self.paused:
            raise ConfigError("--paused: Rerun has no button to go on\n  to do:   --viewer browser")
        if self.replay is None and self.run.plant in REAL:
            raise ConfigError(
                f"--viewer rerun: the plant {self.run.plant} is a real arm, which closing Rerun's page would not stop\n"
                "  to do:   --viewer browser"
            )
        with ExitStack() as stack:
            if self.replay is not None:
                console = notices()
                from oimppi_warp.view.replay import Replay

                shown = Replay(self.replay)
                table = shown.scene.table
            else:
                setup, console = self.prepare()
                from oimppi_warp.view.session import Session

                with busy(console, "loading kernels"):
                    shown = Session(setup)
                stack.callback(shown.close)
                table = setup.scene.table
            from oimppi_warp.view.rerun_viewer import RerunServer, RerunView, open_rerun

            with busy(console, "starting Rerun"):
                server = RerunServer(self.host, self.port)
                stack.callback(server.close)
                viewer = open_rerun(table, server.address)
                stack.callback(viewer.close)
            self._tell(server.url, server.port)
            with suppress(KeyboardInterrupt):
                RerunView(viewer).show(shown)
        return 0

    def _tell(self, url: str, port: int) -> None:
        """Prints the address of a page, and opens it if that is wanted."""
        if port != self.port:
            print(f"port {self.port} is in use; using the next free one", file=sys.stderr)
        print(f"Open {url} in a browser; press Ctrl-C to stop.", flush=True)
        if self.open:
            open_page(url)


def open_page(url: str) -> bool:
    """Opens a page in this machine's browser; returns whether there is one on a screen, and somebody to look at it."""
    if not sys.stdout.isatty() or not (sys.platform != "linux" or os.environ.keys() & {"DISPLAY", "WAYLAND_DISPLAY"}):
        return False
    with suppress(webbrowser.Error):
        return webbrowser.open(url)
    return False


@dataclass(frozen=True)
class Export:
    """Export a record as a web page, a USD animation, a video, or a ROS 2 bag."""

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """Folder of the record, as written by `oimppi run --record` or by a trial of `oimppi bench`, or its bag."""

    to: Literal["html", "usd", "mp4", "mcap", "rosbag2"] = "html"
    """Format: self-contained web page (html), USD animation (usd), video from above (mp4),
    ROS 2 bag as one file, for Foxglove and `ros2 bag` (mcap), or as a folder with metadata.yaml (rosbag2)."""

    output: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: in the record's folder)")] = None
    """File to write; with rosbag2, folder to write."""

    def execute(self) -> int:
        """Writes the export and returns the exit status."""
        console = notices()
        from oimppi_warp.view.export import export

        with busy(console, f"writing {self.to}"), redirect_stdout(io.StringIO()):  # hides what viewers print
            file = export(self.folder, self.to, self.output)
        print(file)
        return 0

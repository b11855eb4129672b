"""The commands ``oimppi view`` and ``oimppi export``."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from oimppi_warp.cli.options import TaskOptions, notices
from oimppi_warp.errors import ConfigError


@dataclass(frozen=True)
class View(TaskOptions):
    """Watch it plan and push in the browser, and change things while it runs; or replay a record.

    Closing the browser ends nothing, Ctrl-C ends all. Exit status: 0, or 2 for bad input.
    """

    scene: Annotated[Positional[str], arg(metavar="SCENE")] = "task02"
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    replay: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Scrub through the record in this folder, which --record of `run` or a trial of `bench` wrote."""

    host: str = "127.0.0.1"
    """Address to listen at: 0.0.0.0 lets other machines in."""

    port: Annotated[int, arg(metavar="N")] = 8080
    """Port to listen at; if it is taken, the next free one."""

    paused: bool = False
    """Begin paused."""

    def execute(self) -> int:
        """Serve until Ctrl-C; returns the exit status."""
        if not 1 <= self.port <= 65535:
            raise ConfigError(f"--port {self.port}: cannot be used\n  allowed: 1 to 65535")
        if self.replay is not None:
            notices()
            from oimppi_warp.view.browser import open_viewer
            from oimppi_warp.view.replay import Replay, ReplayView

            replay = Replay(self.replay)
            viewer = open_viewer(host=self.host, port=self.port, paused=self.paused)
            return _serve(viewer, self.port, ReplayView(viewer, replay).run, None)
        setup, console = self.prepare()
        from oimppi_warp.view.browser import open_viewer
        from oimppi_warp.view.live import LiveView
        from oimppi_warp.view.session import Session

        with console.status("loading kernels"):
            session = Session(setup)
        viewer = open_viewer(host=self.host, port=self.port, paused=self.paused)
        return _serve(viewer, self.port, LiveView(viewer, session).run, session.close)


@dataclass(frozen=True)
class Export:
    """Export a record: a web page, a USD animation, a video, or a log for Foxglove."""

    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """What --record of `run` or a trial of `bench` wrote."""

    to: Literal["html", "usd", "mp4", "mcap"] = "html"
    """A self-contained page, a USD file with time samples, a video from above, or an MCAP file."""

    output: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Where to write it, if not into the record's folder."""

    def execute(self) -> int:
        """Write it; returns the exit status."""
        notices()
        from oimppi_warp.view.export import export

        with redirect_stdout(io.StringIO()):  # what viewers print of ports and temporary files
            file = export(self.folder, self.to, self.output)
        print(file)
        return 0


def _serve(viewer: Any, port: int, run: Callable[[], None], close: Callable[[], None] | None) -> int:
    """Say where, serve until Ctrl-C, and clean up."""
    if viewer.server.get_port() != port:
        print(f"port {port} is taken", file=sys.stderr)
    print(f"Open http://{viewer.server.get_host()}:{viewer.server.get_port()} in a browser; Ctrl-C ends.", flush=True)
    try:
        with suppress(KeyboardInterrupt):
            run()
    finally:
        if close is not None:
            close()
        viewer.close()
    return 0

"""Exports a recorded episode as a web page, a USD animation, a video or a ROS 2 bag."""

from __future__ import annotations

import io
import os
import shutil
import tempfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from oimppi_warp.errors import ConfigError, missing_package
from oimppi_warp.record.log import write_atomically
from oimppi_warp.signals import check_interrupted
from oimppi_warp.view.canvas import Canvas
from oimppi_warp.view.replay import Replay

FPS = 20
"""Frames per second of the page, animation and video."""


def rows_of(replay: Replay, fps: float = FPS, speed: float = 1.0) -> list[int]:
    """Returns the control steps to show at a frame rate, including the last one."""
    time = replay.log["time"]
    wanted = np.arange(time[0], time[-1] + 1e-9, speed / fps)
    rows = np.minimum(np.searchsorted(time, wanted - 1e-9), len(time) - 1).tolist()
    return rows if rows[-1] == len(time) - 1 else [*rows, len(time) - 1]


def export_html(replay: Replay, file: Path) -> None:
    """Writes a single page with viser's player and the whole episode; it needs neither a server nor a network."""
    from oimppi_warp.view.browser import Page

    page = Page(replay.scene.table)
    try:
        record = page.server.get_scene_serializer()
        canvas = Canvas(page)
        for row in rows_of(replay):
            check_interrupted()
            canvas.show(replay.picture(row))
            record.insert_sleep(1.0 / FPS)
        write_atomically(file, record.as_html().encode())
    finally:
        page.close()


def export_usd(replay: Replay, file: Path) -> None:
    """Writes a USD stage with time samples, for usdview, Blender or Omniverse."""
    from newton.viewer import ViewerUSD

    from oimppi_warp.view.newton_display import NewtonDisplay

    with tempfile.TemporaryDirectory() as folder:
        partial = Path(folder) / file.name
        viewer = ViewerUSD(output_path=str(partial), fps=FPS, up_axis="Z", num_frames=None)
        display = NewtonDisplay(viewer)
        canvas = Canvas(display)
        for frame, row in enumerate(rows_of(replay)):
            check_interrupted()
            with display.frame(frame / FPS):
                canvas.draw(replay.picture(row))
        viewer.close()
        write_atomically(file, partial.read_bytes())


def export_mp4(replay: Replay, file: Path) -> None:
    """Writes a top-view video, without needing a display."""
    av = _import_optional("av", "mp4")
    from oimppi_warp.plots.film import frames

    packed = io.BytesIO()
    with av.open(packed, mode="w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(FPS))
        stream.pix_fmt = "yuv420p"
        for n, image in enumerate(frames(replay.log, replay.scene, rows_of(replay))):
            if n == 0:  # the format requires even dimensions
                stream.width, stream.height = image.width // 2 * 2, image.height // 2 * 2
            picture = av.VideoFrame.from_image(image.crop((0, 0, stream.width, stream.height)))
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    write_atomically(file, packed.getvalue())


def export_mcap(replay: Replay, file: Path) -> None:
    """Writes an MCAP file with ROS 2 messages, for Foxglove, ``ros2 bag`` and :func:`oimppi_warp.record.bag_record`."""
    from oimppi_warp.view.bag import write_bag

    with tempfile.TemporaryDirectory() as folder:
        write_atomically(file, write_bag(replay, Path(folder) / "episode").read_bytes())


def export_rosbag2(replay: Replay, folder: Path) -> None:
    """Writes a rosbag2 folder: the MCAP file, and the ``metadata.yaml`` that older versions of ``ros2 bag`` need."""
    from oimppi_warp.view.bag import write_bag

    if folder.exists():
        raise ConfigError(f"--output {folder}: exists already\n  to do:   remove it, or choose another path")
    partial = folder.with_name(f".{folder.name}.{os.getpid()}") / folder.name
    try:
        write_bag(replay, partial)
        partial.rename(folder)
    finally:
        shutil.rmtree(partial.parent, ignore_errors=True)


EXPORTS: dict[str, Callable[[Replay, Path], None]] = {
    "html": export_html,
    "usd": export_usd,
    "mp4": export_mp4,
    "mcap": export_mcap,
    "rosbag2": export_rosbag2,
}
"""Export formats of an episode."""


def export(folder: Path, to: str, output: Path | None = None) -> Path:
    """Exports a record.

    Args:
        folder: A record's folder, as written by ``--record``, or a bag that was exported from one.
        to: One of :data:`EXPORTS`.
        output: File to write, or the folder with ``rosbag2``; ``None``: ``episode`` with the format's suffix, in the
            record's folder, or the bag's name with that suffix, beside the bag.

    Returns:
        The file or folder that was written.

    Raises:
        LogError: There is no record.
        ConfigError: The export cannot be written, or a package is missing.
    """
    replay = Replay(folder)
    suffix = {"usd": ".usdc", "rosbag2": ""}.get(to, f".{to}")
    beside = folder / "episode" if folder.is_dir() else folder.with_suffix("")
    file = beside.with_name(beside.name + suffix) if output is None else output
    if to == "usd" and file.suffix not in (".usd", ".usda", ".usdc"):
        raise ConfigError(f"--output {file}: not a USD file name\n  allowed: names ending in .usd, .usda or .usdc")
    try:
        file.absolute().parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--output {file}: {error}\n  allowed: a file in a folder that can be created") from error
    if (file.is_dir() and to != "rosbag2") or not os.access(file.absolute().parent, os.W_OK):
        raise ConfigError(f"--output {file}: cannot be written\n  allowed: a file in a writable folder")
    EXPORTS[to](replay, file)
    return file


def _import_optional(module: str, to: str) -> Any:
    """Imports an optional dependency of an export."""
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise missing_package(f"--to {to}", module, "export") from error

"""Measures the time from the command ``oimppi view`` to an arm that moves in Chromium, with cold and with warm caches.

Chromium is open before the command is given, as a user's browser would be; it draws without a GPU. Requires Debian's
``chromium`` package and Playwright (the extra ``dev``)::

    python tools/bench_view.py
"""

from __future__ import annotations

import base64
import io
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tyro
from gallery import FLAGS
from PIL import Image

SIZE = (1000, 700)
"""Size of the page [pixels]."""
SEEN = 600
"""Width of the part of the page that the panel does not cover [pixels]."""
MOVED = 150
"""Pixels that have to change for the arm, or its plan, to count as moving."""
MOVES, APART = 3, 2.0
"""Number of such changes in a row, and longest time from one to the next [s]; a single one only completes a picture."""
PATIENCE = 120.0
"""Time without a new frame after which the measurement is given up [s]."""


@dataclass(frozen=True)
class BenchView:
    """Measure the time from the command to an arm that moves in Chromium."""

    scene: str = "task02"
    """Scene to view."""

    warm: int = 3
    """Number of runs with warm caches, after the one with cold caches."""


@dataclass
class Command:
    """``oimppi view`` in a process of its own, and what it printed when.

    Attributes:
        began: When the command was given [s since the epoch].
        lines: Time since then [s] and text of each line.
    """

    scene: str
    caches: Path
    lines: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        caches = {"WARP_CACHE_PATH": str(self.caches / "warp"), "OIMPPI_CACHE": str(self.caches / "fields")}
        words = [sys.executable, "-m", "oimppi_warp", "view", self.scene, "--no-open", "--device", "cpu"]
        self.began = time.time()
        self._process = subprocess.Popen(
            words, env=os.environ | caches, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.lines.append((self.elapsed(), line.rstrip()))

    def elapsed(self) -> float:
        """Returns the time since the command was given [s]."""
        return time.time() - self.began

    def url(self) -> str:
        """Waits for the address of the page."""
        while True:
            for _, line in list(self.lines):
                if found := re.search(r"Open (\S+) in a browser", line):
                    return found[1]
            if self._process.poll() is not None:
                raise RuntimeError("\n".join(line for _, line in self.lines))
            time.sleep(0.01)

    def end(self) -> None:
        """Ends the process."""
        self._process.terminate()
        self._process.wait()


class Screen:
    """The frames that Chromium displays of a page, without what the panel covers.

    Args:
        page: The page, of Playwright.

    Attributes:
        frames: Time of display [s since the epoch] and picture, shape [height, width, 3], of each frame.
    """

    def __init__(self, page: Any) -> None:
        self._page = page
        self.frames: list[tuple[float, np.ndarray]] = []
        self._chromium = page.context.new_cdp_session(page)
        self._chromium.on("Page.screencastFrame", self._take)
        self._chromium.send("Page.startScreencast", {"format": "jpeg", "quality": 80})

    def _take(self, frame: dict[str, Any]) -> None:
        content = base64.b64decode(frame["data"])
        image = np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)
        self.frames.append((frame["metadata"]["timestamp"], image[:, :SEEN]))
        self._chromium.send("Page.screencastFrameAck", {"sessionId": frame["sessionId"]})

    def close(self) -> None:
        """Takes no more frames."""
        self._chromium.remove_listener("Page.screencastFrame", self._take)
        self._chromium.send("Page.stopScreencast")

    def next(self) -> tuple[float, np.ndarray]:
        """Waits for the next frame."""
        known, end = len(self.frames), time.monotonic() + PATIENCE
        while len(self.frames) == known:
            if time.monotonic() > end:
                raise TimeoutError(f"the page has not changed for {PATIENCE:g} s")
            self._page.wait_for_timeout(10)  # frames arrive meanwhile
        return self.frames[known]


def measure(scene: str, caches: Path, page: Any) -> None:
    """Prints how long one run takes to address, page, first picture and moving arm, and its longest silence."""
    command = Command(scene, caches)
    try:
        url = command.url()
        printed = command.elapsed()
        screen = Screen(page)
        page.goto(url)
        loaded = command.elapsed()
        while True:
            at, first = screen.next()
            if _is_drawn(first):
                break
        drawn = at - command.began
        changes: list[float] = []
        while len(changes) < MOVES:
            at, image = screen.next()
            if np.sum(np.abs(image - first).sum(axis=-1) > 60) > MOVED:
                if changes and at - changes[-1] > APART:  # the picture was completed, and stood still again
                    changes.clear()
                changes.append(at)
                first = image
        moving = changes[0] - command.began
        screen.close()
        times = [0.0, *(each for each, _ in command.lines if each <= drawn), drawn]
        silence = max(np.diff(times))
        print(
            f"address {printed:.1f} s, page loaded {loaded:.1f} s, first picture {drawn:.1f} s, "
            f"moving arm {moving:.1f} s, longest silence of the terminal up to the picture {silence:.1f} s",
            flush=True,
        )
        for at, line in command.lines:
            print(f"    {at:5.1f} s  {line}", flush=True)
    finally:
        command.end()


def _is_drawn(image: np.ndarray) -> bool:
    """Returns whether a picture shows more than a background."""
    pixels = image.reshape(-1, 3)
    return bool(np.mean(np.abs(pixels - pixels[0]).sum(axis=1) > 30) > 0.05)


def main(options: BenchView) -> None:
    """Measures one run with cold caches, and some with warm ones."""
    from playwright.sync_api import sync_playwright

    with TemporaryDirectory() as caches, sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        for number in range(1 + options.warm):
            print("cold caches:" if number == 0 else "warm caches:", end=" ", flush=True)
            page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
            measure(options.scene, Path(caches), page)
            page.close()
        browser.close()


if __name__ == "__main__":
    main(tyro.cli(BenchView, description=__doc__))

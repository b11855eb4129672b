"""Measures the time from the command ``oimppi view`` to an arm that moves in Chromium, with cold and with warm caches.

Chromium is open before the command is given, as a user's browser would be; it draws without a GPU. Requires Debian's
``chromium`` package and Playwright (the extra ``dev``)::

    python tools/bench_view.py
"""

from __future__ import annotations

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
SCENE = {"x": 0, "y": 0, "width": 600, "height": 700}
"""Part of the page that the panel does not cover [pixels]."""
MOVED = 150
"""Pixels that have to change between two screenshots for the arm to count as moving."""


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
        lines: Time since the start [s] and text of each line.
    """

    scene: str
    caches: Path
    lines: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        caches = {"WARP_CACHE_PATH": str(self.caches / "warp"), "OIMPPI_CACHE": str(self.caches / "fields")}
        words = [sys.executable, "-m", "oimppi_warp", "view", self.scene, "--no-open", "--device", "cpu"]
        self._began = time.perf_counter()
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
        return time.perf_counter() - self._began

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


def measure(scene: str, caches: Path, page: Any) -> None:
    """Prints how long one run takes to address, page, first picture and moving arm, and its longest silence."""
    command = Command(scene, caches)
    try:
        url = command.url()
        printed = command.elapsed()
        page.goto(url)
        loaded = command.elapsed()
        before, drawn = _picture(page), None
        while True:
            now = _picture(page)
            if drawn is None and _is_drawn(now):
                drawn = command.elapsed()
            if drawn is not None and np.sum(np.abs(now - before).sum(axis=-1) > 60) > MOVED:
                break
            before = now
        moving = command.elapsed()
        times = [0.0, *(each for each, _ in command.lines if each <= printed)]
        silence = max(np.diff(times))
        print(
            f"address {printed:.1f} s, page loaded {loaded:.1f} s, first picture {drawn:.1f} s, "
            f"moving arm {moving:.1f} s, "
            f"longest silence before the address {silence:.1f} s",
            flush=True,
        )
        for at, line in command.lines:
            print(f"    {at:5.1f} s  {line}", flush=True)
    finally:
        command.end()


def _picture(page: Any) -> np.ndarray:
    """Returns what the page shows beside the panel, shape [height, width, 3]."""
    content = page.screenshot(clip=SCENE, timeout=120_000)
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)


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

"""Takes pictures of the viewer in a headless Chromium: one of each shipped scene in mid-push, and an animation.

Usage: ``python tools/gallery.py [--scenes task02 ...] [--out docs/images/view] [--film task02]``. Requires Debian's
``chromium`` package and Playwright (the extra ``dev``).
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from oimppi_warp.config.presets import best
from oimppi_warp.runtime.request import prepare_scene
from oimppi_warp.runtime.setup import Setup
from oimppi_warp.usd import shipped_scenes
from oimppi_warp.view.browser import Page, view_of
from oimppi_warp.view.canvas import Canvas
from oimppi_warp.view.session import Session

SIZE = (720, 450)
"""Size of a picture [pixels]."""
EYE, LOOK_AT, FIELD = (1.2, -0.71, 0.84), (0.3, -0.02, 0.15), 0.85
"""Position of the camera, the point it looks at [m] (with the panel hidden), and its vertical field of view [rad]."""
SHARE = 0.45
"""Fraction of its initial distance to the goal that the object has covered in a picture of a scene."""
STRIDE = 5
"""Control steps between frames of the film."""
FLAGS = ["--no-sandbox", "--disable-background-networking", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
BARE = ".mantine-Paper-root, .mantine-Notifications-root { display: none !important }"
"""Style that hides the panel and notices."""


class Stage:
    """A session that this script steps, displayed in a page of which it takes screenshots."""

    def __init__(self, page: Any, scene: str) -> None:
        self._page = page
        self.session = Session(Setup(prepare_scene(scene, start=1), best("cloi")), speed=float("inf"))
        self.session.paused = self.session.watched = True
        self.session.start()
        table = self.session.running.scene.table
        self._served = Page(table, port=8500)
        camera = self._served.server.initial_camera
        camera.position, camera.look_at = view_of(table, eye=EYE, target=LOOK_AT)
        camera.fov = FIELD
        self._canvas = Canvas(self._served)
        self._draw()
        page.goto(self._served.url)
        page.add_style_tag(content=BARE)

    def close(self) -> None:
        """Close session and viewer."""
        self.session.close()
        self._served.close()

    def steps(self) -> Iterator[float]:
        """Run to the end of the episode, and yield the distance to the goal [m] after each step."""
        while True:
            before = self.session.latest.time
            self.session.step()
            while self.session.latest.time == before:
                if self.session.over:
                    return
                time.sleep(0.002)
            yield self.session.latest.figures.get("position error [m]", float("inf"))

    def photo(self) -> Image.Image:
        """Take a screenshot of the current state, once two successive screenshots are identical."""
        self._draw()
        last, image = None, np.zeros(0)
        while last is None or not np.array_equal(last, image):
            time.sleep(0.3)
            last, image = image, np.asarray(Image.open(io.BytesIO(self._page.screenshot(timeout=120_000))))
        return Image.fromarray(image).convert("RGB")

    def _draw(self) -> None:
        self._canvas.show(self.session.latest)


@contextmanager
def chromium() -> Iterator[Any]:
    """Open a page in a headless Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        page.set_default_timeout(120_000)
        yield page
        browser.close()


def picture(page: Any, scene: str) -> Image.Image:
    """Take a picture of a scene in the middle of a push."""
    stage = Stage(page, scene)
    try:
        first = next(distances := stage.steps())
        for distance in distances:
            if distance < (1.0 - SHARE) * first:
                break
        return stage.photo()
    finally:
        stage.close()


def film(page: Any, scene: str) -> list[Image.Image]:
    """Film a whole push."""
    stage = Stage(page, scene)
    try:
        frames = [stage.photo()]
        for step, _ in enumerate(stage.steps(), start=1):
            if step % STRIDE == 0:
                frames.append(stage.photo())
        return [*frames, stage.photo()]
    finally:
        stage.close()


def main() -> int:
    """Take the pictures, and return exit status 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="*", default=[scene.name for scene in shipped_scenes()])
    parser.add_argument("--film", nargs="*", default=["task02"])
    parser.add_argument("--out", type=Path, default=Path("docs/images/view"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with chromium() as page:
        for scene in options.scenes:
            picture(page, scene).quantize(128).save(file := options.out / f"{scene}.png", optimize=True)
            print(f"{file}: {file.stat().st_size / 1e3:.0f} kB")
        for scene in options.film:
            first, *others = [frame.resize((560, 350)).quantize(64) for frame in film(page, scene)]
            times = [100] * len(others) + [2000]
            file = options.out / f"{scene}.gif"
            first.save(file, save_all=True, append_images=others, duration=times, loop=0, optimize=True)
            print(f"{file}: {len(times)} frames, {file.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())

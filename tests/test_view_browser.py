"""The viewer in a real browser: headless Chromium, through Playwright; screenshots are kept in ``OIMPPI_ARTEFACTS``."""

import io
import os
import shutil
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from oimppi_warp.episode import Episode
from oimppi_warp.presets import best
from oimppi_warp.settings import set_option
from oimppi_warp.usd import load_scene
from oimppi_warp.view.browser import open_viewer
from oimppi_warp.view.export import export
from oimppi_warp.view.live import LiveView
from oimppi_warp.view.session import Session, Setup

playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium: apt-get install chromium")
FLAGS = ["--no-sandbox", "--disable-background-networking", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def small():
    config = set_option(set_option(best("cloi"), "robot.mppi.samples=64"), "object.mppi.samples=64")
    return replace(config, episode=replace(config.episode, max_sim_seconds=600.0, hold_seconds=600.0))


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came to that"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as started:
        made = started.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield made
        made.close()


@pytest.fixture
def page(browser):
    made = browser.new_page(viewport={"width": 1000, "height": 700})
    made.set_default_timeout(60_000)
    made.problems = []
    made.on("pageerror", lambda error: made.problems.append(str(error)))
    made.on("console", lambda line: line.type == "error" and made.problems.append(line.text))
    yield made
    made.close()


def picture_of(page, name):
    """What the page shows, as an array; kept as an artefact of the run."""
    content = page.screenshot(timeout=120_000)
    if folder := os.environ.get("OIMPPI_ARTEFACTS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        Path(folder, f"{name}.png").write_bytes(content)
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)


def scene_is_drawn(image):
    """Whether the left part, which the panel does not cover, shows more than a background."""
    left = image[:, :600].reshape(-1, 3)
    return np.mean(np.abs(left - left[0]).sum(axis=1) > 30) > 0.05


class Served:
    """A view that is drawn by a thread, as the command's main thread would."""

    def __init__(self, viewer, view):
        self.viewer, self.view = viewer, view
        self.url = f"http://127.0.0.1:{viewer.server.get_port()}"
        self.thread = threading.Thread(target=view.run, daemon=True)
        self.thread.start()

    def close(self):
        self.viewer._running = False
        self.thread.join()
        self.viewer.close()


@pytest.fixture
def live(tmp_path):
    setup = Setup(load_scene("task02"), small(), engine="quasistatic", device="cpu", threads=1)
    session = Session(setup)
    viewer = open_viewer(port=8470)
    served = Served(viewer, LiveView(viewer, session, tmp_path))
    served.session = session
    yield served
    session.close()
    served.close()


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    folder = tmp_path_factory.mktemp("record")
    config = replace(small(), episode=replace(small().episode, max_sim_seconds=2.0))
    Episode(load_scene("task02"), config, engine="quasistatic", device="cpu").run().save(folder)
    return folder


def test_the_exported_page_works_from_disk(record, page):
    file = export(record, "html")
    page.goto(file.as_uri())
    page.wait_for_selector("canvas")
    until(lambda: scene_is_drawn(picture_of(page, "exported")))
    assert page.problems == []


def test_two_browsers_see_the_same_and_closing_one_ends_nothing(live, browser, page):
    other = browser.new_page()
    for one in (page, other):
        one.goto(live.url)
        one.wait_for_selector("canvas")
    until(lambda: len(live.viewer.server.get_clients()) == 2)
    other.close()
    until(lambda: len(live.viewer.server.get_clients()) == 1)
    now = live.session.latest.time
    until(lambda: live.session.latest.time > now + 0.5)

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
from scipy import ndimage
from scipy.spatial.transform import Rotation

from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.runtime.setup import Setup
from oimppi_warp.usd import load_scene
from oimppi_warp.view.browser import Page, view_of
from oimppi_warp.view.canvas import Canvas
from oimppi_warp.view.export import export
from oimppi_warp.view.live import LiveView
from oimppi_warp.view.picture import Picture
from oimppi_warp.view.replay import Replay, ReplayView
from oimppi_warp.view.session import Session

playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium: apt-get install chromium")
FLAGS = ["--no-sandbox", "--disable-background-networking", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def small():
    config = set_option(set_option(best("cloi"), "robot.optimizer.samples=64"), "object.optimizer.samples=64")
    return replace(config, episode=replace(config.episode, max_sim_seconds=600.0, hold_seconds=600.0))


def until(condition, seconds=120.0):
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


def messages_to(client):
    """The messages that a client is sent from now on, as a list that grows."""
    sent, send = [], client._websock_connection.queue_message

    def record(message):
        sent.append(message)
        send(message)

    client._websock_connection.queue_message = record
    return sent


class Served:
    """A view that is drawn by a thread, as the command's main thread would."""

    def __init__(self, page, view):
        self.page, self.view = page, view
        self.url = page.url
        self.thread = threading.Thread(target=view.run, daemon=True)
        self.thread.start()

    def close(self):
        self.page.open = False
        self.thread.join()
        self.page.close()


@pytest.fixture
def live(device: str):
    setup = Setup(load_scene("task02"), small(), RunSpec(engine="quasistatic", device=device, threads=1))
    session = Session(setup)
    page = Page(setup.scene.table, port=8470)
    served = Served(page, LiveView(page, Canvas(page), session))
    served.session = session
    yield served
    session.close()
    served.close()


@pytest.fixture(scope="module")
def record(tmp_path_factory, device):
    folder = tmp_path_factory.mktemp("record")
    config = replace(small(), episode=replace(small().episode, max_sim_seconds=2.0))
    Episode(load_scene("task02"), config, engine="quasistatic", device=device).run().save(folder)
    return folder


def opened(page, served):
    """The view in the browser, drawn, with the session paused."""
    page.goto(served.url)
    pause = page.get_by_label("Pause", exact=True)

    def paused():
        """A click can come before the page is connected, and is lost then."""
        pause.uncheck()
        pause.check()
        time.sleep(1.0)
        return served.session.paused

    until(paused)
    until(lambda: scene_is_drawn(picture_of(page, "opened")))


def slider(page, name, *folders):
    """The thumb of a slider by its label, below folders that are opened on the way."""
    number = page.locator("label").filter(has_text=name).first.get_attribute("for")
    thumb = page.locator(f"[id='{number}'] [role=slider]")
    headings = [page.get_by_text(folder, exact=True).first for folder in folders]
    for heading, content in zip(headings, [*headings, thumb][1:], strict=True):
        unfold(heading, content)
    thumb.scroll_into_view_if_needed()
    return thumb


def unfold(heading, content):
    """Opens a folder; a page that moves under the mouse may miss a click, so it is clicked again, as by a user."""

    def opened():
        if not content.is_visible():
            heading.click()
        try:
            content.wait_for(timeout=10_000)
        except playwright.TimeoutError:
            return False
        return True

    until(opened)


def on_screen(served, point):
    """Pixel of a point [m] in the picture of the only client."""
    (client,) = served.page.server.get_clients().values()
    camera = client.camera
    seen = Rotation.from_quat(np.roll(camera.wxyz, -1)).inv().apply(np.asarray(point) - camera.position)
    scale = camera.image_height / 2 / np.tan(camera.fov / 2)
    return np.array([camera.image_width, camera.image_height]) / 2 + scale * seen[:2] / seen[2]


def test_the_page_is_drawn_without_an_error_and_says_what_goes_on(live, page):
    page.goto(live.url)
    until(lambda: scene_is_drawn(picture_of(page, "live")))
    page.get_by_text("pushing", exact=True).wait_for()
    page.get_by_text("Cost terms of the best sample").wait_for()
    assert page.problems == []


def test_a_page_without_a_scene_says_what_it_waits_for_and_then_shows_it_from_the_usual_place(page):
    scene = load_scene("task02")
    waiting = Page(scene.table, port=8490)
    notice = page.get_by_text("Drawing the scene ...", exact=True)
    try:
        with waiting.saying("drawing the scene"):
            page.goto(waiting.url)
            notice.wait_for()
            until(lambda: waiting.server.get_clients())
            (client,) = waiting.server.get_clients().values()
            sent = messages_to(client)
            Canvas(waiting).show(Picture.of_start(scene))
        until(lambda: scene_is_drawn(picture_of(page, "from_the_start")))
        until(lambda: np.allclose(client.camera.position, view_of(scene.table)[0], atol=0.01))
        assert not [it for it in sent if "Camera" in type(it).__name__], "a camera that is moved may not come back"
        notice.wait_for(state="hidden")
        assert page.problems == []
    finally:
        waiting.close()


def test_pause_pauses_and_step_goes_one_step(live, page):
    opened(page, live)
    page.get_by_text("paused", exact=True).wait_for()
    before = live.session.latest.time
    drawn, pose = [], live.page.pose
    live.page.pose = lambda *where: (drawn.append(where), pose(*where))
    time.sleep(1.0)
    assert not drawn, "nothing moves"
    assert live.session.latest.time == before
    page.get_by_role("button", name="Step", exact=True).click()
    until(lambda: live.session.latest.time > before)
    time.sleep(0.5)
    assert live.session.latest.time == pytest.approx(before + 0.05)
    assert drawn, "what moves is drawn"
    page.get_by_label("Pause", exact=True).uncheck()
    until(lambda: live.session.latest.time > before + 0.3)


def test_a_slider_changes_the_planners_weight_and_one_click_takes_it_back(live, page):
    opened(page, live)
    thumb = slider(page, "w_theta", "Settings", "cost")
    default = live.session.running.config.cost.w_theta
    for _ in range(3):
        thumb.press("ArrowRight")
    until(lambda: live.session.running.config.cost.w_theta > default)
    picture_of(page, "slider")
    page.get_by_role("button", name="Reset cost.w_theta to").click()
    until(lambda: live.session.running.config.cost.w_theta == default)
    assert page.problems == []


def blue_parts(served, page):
    """Pixels (x, y) of the blue parts of the goal's handle: the square, which moves it, and the ring, to turn it."""
    page.mouse.move(20, 680)  # a part under the mouse is yellow
    time.sleep(0.5)
    x, y, _ = served.session.running.scene.goal
    middle = on_screen(served, (x, y, 0.06))
    image = picture_of(page, "handles")
    blue = (image[..., 2] > 180) & (image[..., 0] < 80) & (image[..., 1] < 170)
    blue[:, 650:] = False  # the panel
    named, count = ndimage.label(blue, np.ones((3, 3)))
    parts = [np.argwhere(named == number + 1)[:, ::-1] for number in range(count)]
    near = [part for part in parts if len(part) > 10 and np.hypot(*(part.mean(axis=0) - middle)) < 45]
    return sorted(near, key=lambda part: -len(part) / np.prod(np.ptp(part, axis=0) + 1))


def drag(page, start, way):
    """Drags with the mouse from a pixel along a way."""
    x, y = (float(value) for value in start)
    page.mouse.move(x, y)
    page.mouse.down()
    for share in np.linspace(0.2, 1.0, 5):
        page.mouse.move(x + share * way[0], y + share * way[1])
        time.sleep(0.2)
    page.mouse.up()
    time.sleep(1.0)


def test_dragging_the_goal_changes_the_plan(live, page):
    opened(page, live)
    page.get_by_label("Show handles", exact=True).check()
    before = live.session.running.scene.goal

    def goal():
        return live.session.running.scene.goal

    def dragged():
        """Drags the square; a busy page may miss part of a drag, so that a person would drag again."""
        if not (parts := blue_parts(live, page)):
            return False
        drag(page, parts[0].mean(axis=0), (-12, -15))
        return np.hypot(*np.subtract(goal(), before)[:2]) > 0.03

    def at_rest():
        """The page of a busy machine sends the rest of a drag when the mouse is up already."""
        before = goal()
        time.sleep(3.0)
        return goal() == before and live.session.latest.status == "paused"

    until(dragged)
    until(at_rest)
    x, y, yaw = goal()
    live.session.move_object((x - 0.08, y, yaw))  # so near that the object's plan gets there
    page.get_by_label("Pause", exact=True).uncheck()
    until(lambda: any(np.hypot(*(way[:2] - goal()[:2])) < 0.04 for way in live.session.latest.reference[-1:]))
    picture_of(page, "dragged")
    assert page.problems == []


@pytest.mark.slow
def test_the_ring_of_a_handle_turns_the_goal(live, page):
    opened(page, live)
    page.get_by_label("Show handles", exact=True).check()
    before = live.session.running.scene.goal

    def turned():
        if len(parts := blue_parts(live, page)) < 2:
            return False
        ring = parts[-1]
        drag(page, ring[np.argmin(np.abs(ring[:, 1] - np.median(ring[:, 1])))], (6, 22))
        return abs(live.session.running.scene.goal[2] - before[2]) > 0.1

    until(turned)
    assert live.session.running.scene.goal[:2] == pytest.approx(before[:2], abs=1e-6)
    assert page.problems == []


def test_the_control_loop_keeps_its_rate_with_a_slow_browser(live, page):
    """A dialog holds the page's only thread, so that it reads nothing any more."""

    def steps_a_second(seconds=3.0):
        before, began = len(live.session.running.log), time.perf_counter()
        time.sleep(seconds)
        return (len(live.session.running.log) - before) / (time.perf_counter() - began)

    live.session.start()
    until(lambda: len(live.session.running.log) > 10)
    alone = steps_a_second()
    page.goto(live.url)
    until(lambda: live.session.latest.sampled.size)
    page.on("dialog", lambda dialog: None)
    page.evaluate("() => { setTimeout(() => alert('held'), 0) }")
    # Whatever else the machine does may hold up one of them, a planner that waits would be late in each.
    assert any(steps_a_second() > 0.95 * alone for _ in range(4))


def test_a_replay_scrubs(record, page):
    replay = Replay(record)
    shown = Page(replay.scene.table, port=8480)
    view = ReplayView(shown, Canvas(shown), replay, paused=True)
    served = Served(shown, view)
    try:
        page.goto(served.url)
        until(lambda: scene_is_drawn(picture_of(page, "replay")))
        thumb = slider(page, "Step")
        thumb.press("End")
        until(lambda: view.row == len(Replay(record)) - 1)
        until(lambda: "2.0" in page.get_by_text("from the goal;").inner_text())
        for _ in range(5):
            thumb.press("ArrowLeft")
        until(lambda: view.row == len(Replay(record)) - 6)
        page.get_by_role("button", name="Reset", exact=True).click()
        until(lambda: view.row == 0)
        assert page.problems == []
    finally:
        served.close()


def test_the_exported_page_works_from_disk(record, page):
    file = export(record, "html")
    page.goto(file.as_uri())
    until(lambda: scene_is_drawn(picture_of(page, "exported")))
    assert page.problems == []


@pytest.mark.slow
def test_two_browsers_see_the_same_and_closing_one_ends_nothing(live, browser, page):
    opened(page, live)
    other = browser.new_page(viewport={"width": 1000, "height": 700})
    other.goto(live.url)

    def difference():
        both = [picture_of(one, f"browser_{number}")[160:600, :600] for number, one in enumerate((page, other))]
        return np.mean(np.abs(both[0] - both[1]).sum(axis=-1) > 30)

    until(lambda: difference() < 0.002)
    before = live.session.latest.time
    other.get_by_label("Pause", exact=True).uncheck()
    until(lambda: live.session.latest.time > before + 0.5)
    other.close()
    until(lambda: len(live.page.server.get_clients()) == 1)
    now = live.session.latest.time
    until(lambda: live.session.latest.time > now + 0.5)

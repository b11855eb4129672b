"""The viewer's session with a real arm: what it may not change, and what ends it."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from support import small_tasks
from support.emulated_lab import COMMAND_PORT, POSE_PORT, OtherClient, emulated
from support.pushing import REST, speed, time_to_rest, wait_until

from oimppi_warp import signals
from oimppi_warp.config.presets import lab
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.plants.xarm.emulator import LabEmulator
from oimppi_warp.plants.xarm.protocol import Register
from oimppi_warp.record.log import EpisodeLog
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.runtime.setup import Setup
from oimppi_warp.view import live
from oimppi_warp.view.live import LiveView
from oimppi_warp.view.session import Session

pytestmark = pytest.mark.realtime


@pytest.fixture
def made() -> Iterator[LabEmulator]:
    with emulated() as lab_made:
        yield lab_made


@pytest.fixture
def session(made) -> Iterator[Session]:
    options = (f"robot_address={made.host}:{COMMAND_PORT}", f"pose_address={made.host}:{POSE_PORT}", "yes=true")
    spec = RunSpec(plant="xarm", plant_options=options, device="cpu", engine="quasistatic")
    started = Session(Setup(small_tasks.shipped("lab01"), lab(), spec))
    try:
        yield started
    finally:
        started.close()


class Watched:
    """A page that a browser shows or not."""

    def __init__(self) -> None:
        self.watched = self.open = True


def test_closing_the_last_browser_stops_the_arm(made, session, monkeypatch):
    page = Watched()
    view = LiveView.__new__(LiveView)
    view._page, view._session = page, session  # pyright: ignore
    view._settings = SimpleNamespace(add_folder=lambda: False)  # pyright: ignore
    ticks: list[float] = []

    def tick(_view: LiveView) -> None:
        ticks.append(time.monotonic())
        assert ticks[-1] - ticks[0] < 60.0, f"the arm does not move: {session.latest.status}, {session.problem}"
        if speed(made) > 0.05 and page.watched:
            page.watched = False
            page.closed = time.monotonic()  # pyright: ignore
        page.open = page.watched or time.monotonic() < page.closed + 1.0  # pyright: ignore

    monkeypatch.setattr(LiveView, "tick", tick)
    view.run()
    assert time_to_rest(made) < REST
    assert made.controller.snapshot().state == 4
    assert session.over
    assert live._UNWATCHED <= 0.25


def test_a_session_with_an_arm_cannot_be_changed_and_ends_at_rest(made, session):
    session.start()
    wait_until(lambda: speed(made) > 0.05, 30.0)
    session.change(method="soi")
    assert "real arm" in session.problem
    assert session.wanted.spec.method == "cloi"
    session.paused = True
    assert time_to_rest(made) < 0.3
    session.paused = False
    wait_until(lambda: speed(made) > 0.05, 30.0)
    session.close()
    assert made.controller.snapshot().state == 4
    assert time_to_rest(made) < 0.3


def test_an_exception_in_the_middle_of_a_push_stops_the_arm(made):
    options = (f"robot_address={made.host}:{COMMAND_PORT}", f"pose_address={made.host}:{POSE_PORT}", "yes=true")
    scene = small_tasks.shipped("lab01")
    episode = Episode(scene, lab(), plant="xarm", plant_options=options, device="cpu", engine="quasistatic")
    assert episode.spec.mode == "realtime"

    def fail(_log: EpisodeLog) -> None:
        if speed(made) > 0.05:
            raise ValueError("somebody's mistake")

    with pytest.raises(ValueError, match="somebody's mistake"):
        episode.run(on_step=fail)
    assert made.controller.snapshot().state == 4
    wait_until(lambda: speed(made) < 1e-3)
    assert len(episode.log) > 0, "the log is whole"


def test_an_interrupt_before_the_first_step_stops_the_arm(made, monkeypatch):
    options = (f"robot_address={made.host}:{COMMAND_PORT}", f"pose_address={made.host}:{POSE_PORT}", "yes=true")
    scene = small_tasks.shipped("lab01")
    episode = Episode(scene, lab(), plant="xarm", plant_options=options, device="cpu", engine="quasistatic")
    monkeypatch.setattr(signals, "_came", [signal.SIGTERM])  # its exception was dropped
    log = episode.run()
    assert len(log) == 0 and log.header["ended"] == "interrupted"
    assert made.controller.snapshot().state == 4


def test_go_on_in_the_viewer(made, session):
    session.start()
    wait_until(lambda: speed(made) > 0.05, 30.0)
    made.controller.raise_error(31)
    wait_until(lambda: "C31" in session.latest.status, 10.0)
    assert not session.over, "somebody can ask to go on"
    client = OtherClient(made.host)
    client.command(Register.CLEAR_ERROR)
    client.close()
    time.sleep(1.2)
    session.go_on()
    wait_until(lambda: speed(made) > 0.05, 30.0)

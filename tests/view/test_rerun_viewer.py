"""Rerun as a viewer: what is sent, and when it is refused. Where Rerun is installed, its server is started, too."""

from __future__ import annotations

import importlib.util
import threading
import urllib.request
from dataclasses import replace

import numpy as np
import pytest
from newton.viewer import ViewerNull

from oimppi_warp.cli.main import main
from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.runtime.setup import Setup
from oimppi_warp.usd import load_scene
from oimppi_warp.view.replay import Replay
from oimppi_warp.view.rerun_viewer import RerunServer, RerunView, open_rerun
from oimppi_warp.view.session import Session

HAS_RERUN = importlib.util.find_spec("rerun") is not None


class FakeViewer(ViewerNull):
    """A viewer that keeps what it is sent, and closes itself after some frames."""

    def __init__(self, frames: int) -> None:
        super().__init__(num_frames=10**9)
        self.frames, self.times, self.lines, self.scalars = frames, [], {}, {}

    def begin_frame(self, time):
        self.times.append(time)

    def log_lines(self, name, starts, ends, colors, width=0.01, hidden=False):
        self.lines[name] = self.lines.get(name, 0) + 1

    def log_scalar(self, name, value, *, clear=False, smoothing=1):
        self.scalars.setdefault(name, []).append(value)

    def is_running(self):
        return len(self.times) < self.frames


def small(seconds: float):
    config = set_option(set_option(best("cloi"), "robot.optimizer.samples=64"), "object.optimizer.samples=64")
    return replace(config, episode=replace(config.episode, max_sim_seconds=seconds))


@pytest.fixture(scope="module")
def record(tmp_path_factory, device):
    folder = tmp_path_factory.mktemp("record")
    Episode(load_scene("task02"), small(0.5), engine="quasistatic", device=device).run().save(folder)
    return folder


def test_a_whole_record_is_sent_with_its_reference_its_figures_and_its_costs(record):
    viewer, replay = FakeViewer(1), Replay(record)
    RerunView(viewer).show(replay)
    assert viewer.times == pytest.approx(replay.log["time"])
    assert viewer.lines["/oimppi/reference/way"] == len(replay)
    errors = viewer.scalars["/figures/position_error_m"]
    assert errors == pytest.approx(replay.log["position_error"])
    terms = {name: value for name, value in viewer.scalars.items() if name.startswith("/costs/")}
    assert terms and all(np.isfinite(values).all() for values in terms.values())


def test_a_running_session_is_sent_with_the_planners_samples(device):
    session = Session(Setup(load_scene("task02"), small(60.0), RunSpec(engine="quasistatic", device=device, threads=1)))
    viewer = FakeViewer(12)
    try:
        RerunView(viewer).show(session)
    finally:
        session.close()
    assert viewer.times == sorted(viewer.times) and viewer.times[-1] > 0.3
    assert viewer.lines["/oimppi/plan/samples"] > 5 and viewer.lines["/oimppi/plan/nominal"] > 5
    assert {"/figures/plan_time_ms", "/figures/yaw_error_rad"} <= viewer.scalars.keys()
    assert any(name.startswith("/costs/") for name in viewer.scalars)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--paused"], "no button to go on"),
        (["lab01", "--plant", "ros2"], "is a real arm"),
    ],
)
def test_what_rerun_cannot_do_is_refused(arguments, message, monkeypatch, capsys):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name)
    assert main(["view", *arguments, "--viewer", "rerun"]) == 2
    assert message in capsys.readouterr().err


def test_where_rerun_is_missing_the_message_says_how_to_install_it(monkeypatch, capsys):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["view", "task02", "--viewer", "rerun"]) == 2
    assert "pip install 'oimppi-warp[rerun]'" in capsys.readouterr().err


@pytest.mark.skipif(not HAS_RERUN, reason="Rerun is not installed")
def test_reruns_page_is_served_at_the_address_that_is_printed(record):
    replay, server = Replay(record), RerunServer("127.0.0.1", 8490)
    viewer = open_rerun(replay.scene.table, server.address)
    sender = threading.Thread(target=RerunView(viewer).show, args=(replay,))
    try:
        sender.start()
        assert b"Rerun" in urllib.request.urlopen(server.url).read()
    finally:
        viewer.close()
        sender.join()
        server.close()
    assert server._process.returncode is not None

"""Signals that end a program."""

import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from oimppi_warp import signals
from oimppi_warp.config.presets import best
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.usd import load_scene
from oimppi_warp.view.live import LiveView
from oimppi_warp.view.replay import ReplayView

DESTROYED = """
import signal, time
from oimppi_warp.signals import ending_like_ctrl_c

class Thing:
    def __del__(self):
        signal.raise_signal(signal.{name})

# The tests may run in the background or under `nohup`, which ignore some.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
with ending_like_ctrl_c():
    try:
        Thing()
        time.sleep(20.0)
        print("lost")
    except KeyboardInterrupt:
        print("ended")
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_counts_also_while_an_object_is_destroyed(name):
    """Python drops exceptions there; the viewer destroys arrays all the time, and lost one signal in ten."""
    done = subprocess.run([sys.executable, "-c", DESTROYED.format(name=name)], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("ended\n", "")


COMPARED = """
import enum, signal
import numpy as np
from oimppi_warp.signals import check_interrupted, ending_like_ctrl_c

class Interrupting(enum.EnumMeta):
    def __getattr__(cls, name):
        signal.raise_signal(signal.{name})
        raise AttributeError(name)

class Kind(enum.IntEnum, metaclass=Interrupting):
    CAPSULE = 1

signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
before = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
with ending_like_ctrl_c():
    check_interrupted()
    try:
        np.array([1]) == Kind.CAPSULE
        print("dropped")
        check_interrupted()
        print("lost")
    except KeyboardInterrupt:
        print("ended")
check_interrupted()
assert before == [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_counts_also_where_numpy_drops_it(name):
    """Newton's viewers compare arrays with an ``enum`` in each frame; one Ctrl-C in 150 was lost there."""
    done = subprocess.run([sys.executable, "-c", COMPARED.format(name=name)], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("dropped\nended\n", "")


@pytest.mark.parametrize("view", [LiveView, ReplayView])
def test_a_view_ends_after_a_signal_that_was_dropped(view, monkeypatch):
    monkeypatch.setattr(signals, "_came", [signal.SIGTERM])
    shown = object.__new__(view)
    shown._page = SimpleNamespace(open=True)
    with pytest.raises(KeyboardInterrupt):
        shown.run()


def test_an_episode_ends_after_a_signal_that_was_dropped(monkeypatch):
    monkeypatch.setattr(signals, "_came", [signal.SIGTERM])
    log = Episode(load_scene("task01"), best("cloi"), engine="quasistatic").run()
    assert len(log) == 0
    assert log.header["ended"] == "interrupted"


def test_an_interrupt_that_another_handler_raised_counts_while_an_object_is_destroyed():
    """IPython, for example, sets the default handler again before each cell."""
    again = "    signal.signal(signal.SIGINT, signal.default_int_handler)\n    try:\n"
    script = DESTROYED.format(name="SIGINT").replace("    try:\n", again)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("ended\n", "")

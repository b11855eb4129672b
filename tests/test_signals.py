"""Signals that end a program."""

import subprocess
import sys

import pytest

DESTROYED = """
import signal, time
from oimppi_warp.signals import end_like_ctrl_c

class Thing:
    def __del__(self):
        signal.raise_signal(signal.{name})

# The tests may run in the background or under `nohup`, which ignore some.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
end_like_ctrl_c()
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
from oimppi_warp.signals import check_interrupted, end_like_ctrl_c

class Interrupting(enum.EnumMeta):
    def __getattr__(cls, name):
        signal.raise_signal(signal.{name})
        raise AttributeError(name)

class Kind(enum.IntEnum, metaclass=Interrupting):
    CAPSULE = 1

signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
end_like_ctrl_c()
check_interrupted()
try:
    np.array([1]) == Kind.CAPSULE
    print("dropped")
    check_interrupted()
    print("lost")
except KeyboardInterrupt:
    print("ended")
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_counts_also_where_numpy_drops_it(name):
    """Newton's viewer compares arrays with an ``enum`` in each frame; one Ctrl-C in 150 was lost there."""
    done = subprocess.run([sys.executable, "-c", COMPARED.format(name=name)], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("dropped\nended\n", "")

"""Handles the signals that end a program: like Ctrl-C, and not in the middle of a block that must be completed."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_TO_END = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""The signals that ask a program to end; Windows has no SIGHUP."""

_LATER = 0.01
"""Time after which a signal that Python dropped takes effect [s]."""

_came: list[signal.Signals] = []
"""The signals that have asked this program to end."""


def end_like_ctrl_c() -> None:
    """Lets the signals that ask a program to end do what Ctrl-C does: stop the arm, and complete the record.

    Signals that the program was started to ignore, as by ``nohup``, are still ignored. One that arrives while an object
    is being destroyed, where Python drops exceptions, takes effect a moment later; one whose exception a library drops,
    when :func:`check_interrupted` is called next.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    terminals = [stream.fileno() for stream in (sys.stdout, sys.stderr) if stream.isatty()]
    _came.clear()

    def interrupt(number: int, _: FrameType | None) -> None:
        _came.append(signal.Signals(number))
        if number == getattr(signal, "SIGHUP", None):  # they are gone, so writing to them would fail
            for terminal in terminals:
                silence(terminal)
        raise KeyboardInterrupt

    for each in _TO_END:
        if signal.getsignal(each) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(each, interrupt)

    tell = sys.unraisablehook

    def send_again() -> None:
        time.sleep(_LATER)  # at once, it would be raised and dropped in the same place
        main = threading.main_thread().ident
        if hasattr(signal, "pthread_kill") and main is not None:
            signal.pthread_kill(main, _came[-1])  # so that the main thread does not go on sleeping
        else:  # on Windows
            _thread.interrupt_main(_came[-1])

    def raise_again(dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, KeyboardInterrupt):
            _thread.start_new_thread(send_again, ())  # a Timer needs locks that this thread may hold
        else:
            tell(dropped)

    sys.unraisablehook = raise_again


def check_interrupted() -> None:
    """Ends a loop that a signal should have ended; called in each of its rounds.

    NumPy, for one, drops every exception, also that of Ctrl-C, while it looks at an operand that is not an array.

    Raises:
        KeyboardInterrupt: A signal has asked the program to end.
    """
    if _came:
        raise KeyboardInterrupt


def silence(descriptor: int) -> None:
    """Lets everything that is written to a file descriptor from now on go nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Holds back Ctrl-C, and signals to end, until the block is over; then the first one takes effect.

    Python handles signals in the main thread, whichever thread the system gives them to.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {each: signal.signal(each, lambda number, _: came.append(number)) for each in _TO_END}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_DFL if handler is None else handler)
    if came:
        signal.raise_signal(came[0])

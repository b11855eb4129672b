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
"""The signals that have asked this program to end since :func:`ending_like_ctrl_c` was entered."""


@contextmanager
def ending_like_ctrl_c() -> Iterator[None]:
    """Lets the signals that ask a program to end do what Ctrl-C does: stop the arm, and complete the record.

    Signals that the program was started to ignore, as by ``nohup``, are still ignored. One that arrives while an object
    is being destroyed, where Python drops exceptions, takes effect a moment later. If a library drops the exception,
    the signal takes effect at the next call of :func:`check_interrupted`.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    terminals = [stream.fileno() for stream in (sys.stdout, sys.stderr) if stream.isatty()]

    def interrupt(number: int, _: FrameType | None) -> None:
        _came.append(signal.Signals(number))
        if number == getattr(signal, "SIGHUP", None):  # they are gone, so writing to them would fail
            for terminal in terminals:
                silence(terminal)
        raise KeyboardInterrupt

    def send_again(number: signal.Signals) -> None:
        time.sleep(_LATER)  # at once, it would be raised and dropped in the same place
        main = threading.main_thread().ident
        if hasattr(signal, "pthread_kill") and main is not None:
            signal.pthread_kill(main, number)  # so that the main thread does not go on sleeping
        else:  # on Windows
            _thread.interrupt_main(number)

    def raise_again(dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, KeyboardInterrupt):
            number = _came[-1] if _came else signal.SIGINT
            _thread.start_new_thread(send_again, (number,))  # a Timer needs locks that this thread may hold
        else:
            tell(dropped)

    before = {each: signal.getsignal(each) for each in _TO_END}
    for each, handler in before.items():
        if handler in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(each, interrupt)
    tell, sys.unraisablehook = sys.unraisablehook, raise_again
    try:
        yield
    finally:
        sys.unraisablehook = tell
        for each, handler in before.items():
            if signal.getsignal(each) is interrupt:
                signal.signal(each, handler)
        _came.clear()


def check_interrupted() -> None:
    """Raises again what a library dropped; called in every round of a loop that a signal should end.

    NumPy, for example, drops every exception, including that of Ctrl-C, while it examines an operand that is not an
    array. Outside the main thread, where Python raises none, nothing happens.

    Raises:
        KeyboardInterrupt: A signal has asked the program to end.
    """
    if _came and threading.current_thread() is threading.main_thread():
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

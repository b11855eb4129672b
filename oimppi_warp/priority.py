"""Gives threads real-time priority, and keeps the process from pausing."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

SENDER, LOOP, PLANNER = 20, 10, 1
"""Real-time priorities, of 1 to 99: of the thread that sends commands, of the control loop, and of the planner."""

_LOCK_CURRENT, _LOCK_ON_FAULT = 1, 4
"""Linux's ``MCL_CURRENT`` and ``MCL_ONFAULT``: what is mapped now is kept in memory once it is used."""


@contextmanager
def real_time_priority(level: int = LOOP) -> Iterator[bool]:
    """Gives this thread, and those that it starts meanwhile, real-time priority, where the system allows it.

    On Linux it is allowed to root, and to users with an ``rtprio`` in ``/etc/security/limits.conf``. Threads that were
    started keep the priority. Yields whether it is given.

    Args:
        level: Priority.
    """
    try:
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(level))
    except (AttributeError, OSError):
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, policy, parameters)


def lower_priority() -> None:
    """Gives this thread the planner's priority if it has inherited a higher one."""
    with suppress(AttributeError, OSError):
        if os.sched_getscheduler(0) == os.SCHED_RR:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PLANNER))


@contextmanager
def without_pauses() -> Iterator[None]:
    """Keeps this process from pausing, until the block is over.

    Two things make a thread hold up all others for 0.1 s and more, after which a controller that waits for commands
    stops its arm. Python's garbage collector scans the half million objects of Newton and MuJoCo Warp: here it leaves
    alone what exists already, and collects what is made within the block. And the system drops the code of libraries
    that were not used for a while, which is then read from disk: here it is kept in memory, where the system allows
    it (to root, and to users whose ``memlock`` in ``/etc/security/limits.conf`` is large enough).
    """
    own = gc.get_freeze_count() == 0
    gc.freeze()
    libc = ctypes.CDLL(None) if own and sys.platform == "linux" else None
    locked = libc is not None and libc.mlockall(_LOCK_CURRENT | _LOCK_ON_FAULT) == 0
    try:
        yield
    finally:
        if libc is not None and locked:
            libc.munlockall()
        if own:
            gc.unfreeze()
            gc.collect()  # it has not looked at what became garbage before and meanwhile

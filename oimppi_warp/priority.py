"""What threads need that have to keep time: priority over other programs, and a process that does not pause."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

SENDER, LOOP, PLANNER = 20, 10, 1
"""Real-time priorities, of 1 to 99: of the thread that sends commands, of the control loop, and of the planner."""


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
def short_garbage_collections() -> Iterator[None]:
    """Keeps Python's garbage collector from scanning what exists already, until the block is over.

    A scan of the half million objects of Newton and MuJoCo Warp takes 0.1 s, in which no thread of the process runs,
    and a controller that waits for commands stops its arm. What is made within the block is collected as usual.
    """
    own = gc.get_freeze_count() == 0
    gc.freeze()
    try:
        yield
    finally:
        if own:
            gc.unfreeze()

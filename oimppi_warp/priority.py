"""Priority over other programs, for threads that have to keep time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

LEVEL = 10
"""Real-time priority, of 1 to 99."""


@contextmanager
def real_time_priority() -> Iterator[bool]:
    """Gives this thread, and those that it starts meanwhile, real-time priority, where the system allows it.

    On Linux it is allowed to root, and to users with an ``rtprio`` in ``/etc/security/limits.conf``. Threads that were
    started keep the priority. Yields whether it is given.
    """
    try:
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(LEVEL))
    except (AttributeError, OSError):
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, policy, parameters)

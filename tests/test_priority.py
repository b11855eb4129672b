"""Real-time priority is taken where the system allows it, inherited by threads, and given back."""

from __future__ import annotations

import gc
import os
import re
import threading
import weakref
from pathlib import Path

import pytest

from oimppi_warp.priority import LOOP, PLANNER, lower_priority, real_time_priority, without_pauses


def test_it_is_given_back_and_threads_keep_it():
    before = os.sched_getscheduler(0)
    found: list[tuple[int, int]] = []
    ended = threading.Event()

    def look(lower: bool) -> None:
        ended.wait()
        if lower:
            lower_priority()
        found.append((os.sched_getscheduler(0), os.sched_getparam(0).sched_priority))

    with real_time_priority() as given:
        if not given:
            pytest.skip("this user may not have real-time priority")
        assert os.sched_getscheduler(0) == os.SCHED_RR
        threads = [threading.Thread(target=look, args=(lower,)) for lower in (False, True)]
        for thread in threads:
            thread.start()
    assert os.sched_getscheduler(0) == before
    ended.set()
    for thread in threads:
        thread.join()
    assert sorted(found) == [(os.SCHED_RR, PLANNER), (os.SCHED_RR, LOOP)]
    lower_priority()
    assert os.sched_getscheduler(0) == before


def test_without_permission_nothing_changes(monkeypatch):
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with real_time_priority() as given:
        assert not given


class Knot:
    """Garbage that only the collector finds: it refers to itself."""

    def __init__(self) -> None:
        self.itself = self


def test_what_exists_already_is_not_scanned_while_time_is_kept():
    before = weakref.ref(Knot())
    with without_pauses():
        meanwhile = weakref.ref(Knot())
        gc.collect()
        assert before() is not None
        assert meanwhile() is None
        with without_pauses():
            pass
        gc.collect()
        assert before() is not None
    gc.collect()
    assert before() is None
    assert gc.get_freeze_count() == 0


def test_code_is_kept_in_memory_while_time_is_kept():
    def locked() -> int:
        status = Path("/proc/self/status").read_text()
        return int(re.findall(r"VmLck:\s+(\d+) kB", status)[0])

    before = locked()
    with without_pauses():
        if locked() == before:
            pytest.skip("this user may not lock memory")
    assert locked() == before

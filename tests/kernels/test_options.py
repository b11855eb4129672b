"""Compiler options of the kernels that take most of a control step."""

from __future__ import annotations

import pytest
import warp as wp

from oimppi_warp.kernels.options import INLINE_THRESHOLD, fast, fast_module
from oimppi_warp.kernels.rollouts.quasistatic import make_upright_rollout


@pytest.mark.parametrize("own", [None, "", "-O1", "-mllvm=-inline-threshold=9000 -march=native"])
def test_flags_are_added_to_those_of_the_user(monkeypatch, own: str | None):
    monkeypatch.setattr(wp.config, "cpu_compiler_flags", own)
    flags = fast(inlined=True)["cpu_compiler_flags"].split()
    assert [flag for flag in flags if "inline-threshold" in flag] == [f"-mllvm=-inline-threshold={INLINE_THRESHOLD}"]
    assert {flag for flag in (own or "").split() if "inline" not in flag} <= set(flags)
    assert fast()["cpu_compiler_flags"].split()[:-1] == (own or "").split()


def test_a_rollout_is_compiled_with_them():
    kernel = make_upright_rollout(())
    assert kernel.module.options["cpu_compiler_flags"] == fast(inlined=True)["cpu_compiler_flags"]
    assert kernel.module.name == fast_module("upright_rollout", inlined=True)

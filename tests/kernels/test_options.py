"""Compiler options of the kernels that take most of a control step."""

from __future__ import annotations

import pytest
import warp as wp

from oimppi_warp.kernels.optimizers.sampling import make_sample_controls
from oimppi_warp.kernels.options import INLINE_THRESHOLD, fast, fast_module
from oimppi_warp.kernels.rollouts.object import object_rollout
from oimppi_warp.kernels.rollouts.quasistatic import make_upright_rollout


@pytest.mark.parametrize("own", [None, "", "-O1", "-mllvm=-inline-threshold=9000 -march=native"])
def test_flags_are_added_to_those_of_the_user(monkeypatch, own: str | None):
    monkeypatch.setattr(wp.config, "cpu_compiler_flags", own)
    flags = fast()["cpu_compiler_flags"].split()
    assert [flag for flag in flags if "inline-threshold" in flag] == [f"-mllvm=-inline-threshold={INLINE_THRESHOLD}"]
    assert {flag for flag in (own or "").split() if "inline" not in flag} <= set(flags)


def test_all_kernels_of_a_step_with_flags_of_their_own_have_the_same():
    """Otherwise another precompiled header would be made, which takes as long as compiling ten kernels."""
    kernels = [make_upright_rollout(()), object_rollout, make_sample_controls(3, 5), make_sample_controls(3, 6)]
    assert {kernel.module.options["cpu_compiler_flags"] for kernel in kernels} == {fast()["cpu_compiler_flags"]}
    assert kernels[0].module.name == fast_module("upright_rollout")

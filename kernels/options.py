"""Compiler options of the kernels that take most of a control step.

On the CPU they took a fifth off the time of a rollout.
"""

import re
from typing import Any

import warp as wp

INLINE_THRESHOLD = 60000
"""Cost up to which LLVM inlines a function: more than that of any function here."""


FAST_MATH = True
"""Whether these kernels use fast math on a GPU, which halves the instructions of a rollout.

Divisions, roots, sines and logarithms are then accurate to about 4e-7, and sines of angles beyond pi less so. It
changes nothing on the CPU.
"""


def fast() -> dict[str, Any]:
    """Returns options for ``wp.set_module_options``: no backward pass, fused products and sums, fast math on a GPU.

    On the CPU every function is inlined into its kernel, since a call copies its structs through memory. The flags are
    the same for all of these kernels: Warp makes a precompiled header for each set of flags.
    """
    flags = re.sub(r"-mllvm=-inline-threshold=\d+", "", wp.config.cpu_compiler_flags or "")
    flags = f"{flags} -mllvm=-inline-threshold={INLINE_THRESHOLD} -ffp-contract=fast"
    return {"enable_backward": False, "fast_math": FAST_MATH, "cpu_compiler_flags": flags}


def fast_module(name: str) -> str:
    """Returns the name of a kernel's own module, ``oimppi_warp.kernels.{name}``, which has the options of :func:`fast`.

    Args:
        name: The module's name within the package.
    """
    module = f"oimppi_warp.kernels.{name}"
    wp.set_module_options(fast(), module)
    return module

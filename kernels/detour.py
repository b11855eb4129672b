"""A detour of the object: a push that takes the place of the reference (``planning/reposition.py``)."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def take_detour(
    # in:
    detour: wp.array[wp.vec3],
    taken: wp.array[int],
    # out:
    reference: wp.array[wp.vec3],
):
    """Replaces the reference by a detour if it is taken. Shapes: ``detour`` [n], ``taken`` [1], ``reference`` [n]."""
    if taken[0] != 0:
        i = wp.tid()
        reference[i] = detour[i]

"""Finds what is odd about an arm in an MJCF file: angles in the wrong unit, and constraints that it does not get."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from oimppi_warp.authoring.robots.chain import Chain
from oimppi_warp.errors import SceneError

if TYPE_CHECKING:
    import mujoco

_SMALL = math.radians(7.0)
"""Angle that the joints of an arm turn by, unless their ranges in radians are read as degrees [rad]."""


def check_angles(chain: Chain, file: Path) -> None:
    """Checks that not all ranges are so small that they must be in radians, although the file has degrees.

    Raises:
        SceneError: They are.
    """
    limits = [limit for limit, kind in zip(chain.limits, chain.kinds, strict=True) if kind == "turns"]
    most = max((max(-limit.lower, limit.upper) for limit in limits), default=math.inf)
    if most < _SMALL:
        raise SceneError(
            f"no joint turns further than {math.degrees(most):.3g} degrees from zero",
            file=file,
            allowed="ranges in the unit of <compiler angle>, by default degrees",
            fix='are the angles in radians? then write <compiler angle="radian"/>',
        )


def left_out(chain: Chain, model: mujoco.MjModel, *, bodies: Sequence[str], joints: Sequence[str]) -> Iterator[str]:
    """Yields a note for each constraint and tendon that acts on a chain, which the robot does not get.

    Args:
        chain: The chain.
        model: The compiled file.
        bodies, joints: Names of the model's bodies and joints.
    """
    import mujoco

    kinds = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    moving = {link for group in chain.groups[1:] for link, _ in group}
    for equality in range(model.neq):
        if int(model.eq_type[equality]) in kinds and model.eq_active0[equality]:
            ends = [int(ids[equality]) for ids in (model.eq_obj1id, model.eq_obj2id)]
            if int(model.eq_objtype[equality]) == int(mujoco.mjtObj.mjOBJ_SITE):
                ends = [int(model.site_bodyid[end]) for end in ends]
            names = [bodies[end] for end in ends]
            if moving & set(names):
                yield f"left out: an equality that joins {names[0]} and {names[1]}"
    for tendon in range(model.ntendon):
        first = int(model.tendon_adr[tendon])
        wraps = range(first, first + int(model.tendon_num[tendon]))
        held = [wrap for wrap in wraps if int(model.wrap_type[wrap]) == int(mujoco.mjtWrap.mjWRAP_JOINT)]
        names = [joints[int(model.wrap_objid[wrap])] for wrap in held]
        if set(names) & set(chain.joints):
            yield f"left out: a tendon between the joints {', '.join(names)}, with what acts on it"

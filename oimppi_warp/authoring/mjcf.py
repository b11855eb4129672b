"""Compiles MJCF files, for robots and objects alike."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from oimppi_warp.errors import SceneError
from oimppi_warp.usd.stage import MAX_LENGTH

if TYPE_CHECKING:
    import mujoco


def compiled(file: Path) -> mujoco.MjModel:
    """Returns the model that MuJoCo compiles a file to, with every body as in the file.

    Raises:
        SceneError: MuJoCo cannot compile it (the message has MuJoCo's reason), or a number in it is not finite.
    """
    import mujoco

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what is deprecated, but still does what it says
            specification = mujoco.MjSpec.from_file(str(file))
            specification.compiler.fusestatic = False  # a robot's flange is a body of its own
            specification.compiler.discardvisual = False
            model = specification.compile()
    except Exception as error:  # ValueError, and what MuJoCo's readers of meshes raise
        reason = re.sub(r"^((XML )?Error: )+", "", " ".join(str(error).split())) or type(error).__name__
        raise SceneError(
            f"MuJoCo cannot read the file: {reason}",
            file=file,
            allowed="an MJCF model with all the files that it refers to",
            fix="correct the element that the reason concerns, or add the missing file",
        ) from None
    _check_numbers(model, file)
    return model


def _check_numbers(model: mujoco.MjModel, file: Path) -> None:
    """Raises SceneError for a body, joint, geom or site with a number that is not finite, or is too large a length.

    MuJoCo compiles such numbers without a word. Planes and height fields are not used, so their sizes do not matter.
    """
    import mujoco

    unused = np.isin(model.geom_type, [int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)])
    sizes = np.where(unused[:, None], 0.0, model.geom_size)
    lengths = {
        "body": (model.body_pos, model.body_ipos),
        "joint": (model.jnt_pos,),
        "geom": (model.geom_pos, sizes),
        "site": (model.site_pos,),
    }
    others = {
        "body": (model.body_quat, model.body_inertia, model.body_mass[:, None]),
        "joint": (model.jnt_axis, model.jnt_range),
        "geom": (model.geom_quat, model.geom_friction),
        "site": (model.site_quat,),
    }
    for kind, values in lengths.items():
        finite = np.all([np.isfinite(each).all(axis=1) for each in (*values, *others[kind])], axis=0)
        short = np.all([(np.abs(each) < MAX_LENGTH).all(axis=1) for each in values], axis=0)
        for sound, what in ((finite, "number that is not finite"), (short, f"length of {MAX_LENGTH:g} m or more")):
            if not sound.all():
                index = int(np.flatnonzero(~sound)[0])
                raise SceneError(
                    f"{kind} {getattr(model, kind)(index).name or index} has a {what}",
                    file=file,
                    allowed=f"finite numbers, and lengths below {MAX_LENGTH:g} m",
                    fix="correct its numbers",
                )

"""`scene new` with objects and robots whose files give their places in another precision than ours."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom

from oimppi_warp.authoring import Task, letter, read_object, write_object, write_task
from oimppi_warp.authoring.prims import set_planar_pose
from oimppi_warp.errors import SceneError
from oimppi_warp.usd.stage import SCENES

START, GOAL = (0.3, -0.45, 0.5), (0.5, 0.2, 1.57)


def object_with(folder: Path, **types: Sdf.ValueTypeName) -> Path:
    """A letter whose file has transform operations of these types."""
    file = write_object(letter("S"), folder)
    stage = Usd.Stage.Open(str(file))
    for name, type_name in types.items():
        attribute = stage.GetDefaultPrim().CreateAttribute(f"xformOp:{name}", type_name, custom=False)
        attribute.Set(type_name.defaultValue)
    stage.Save()
    return file


TYPES = {
    "single precision": {"translate": Sdf.ValueTypeNames.Float3, "rotateZ": Sdf.ValueTypeNames.Float},
    "double precision": {"translate": Sdf.ValueTypeNames.Double3, "rotateZ": Sdf.ValueTypeNames.Double},
}


@pytest.mark.parametrize("precision", TYPES)
def test_an_object_is_put_in_the_precision_of_its_file(tmp_path, precision):
    obj = read_object(object_with(tmp_path / "from", **TYPES[precision]))
    scene = write_task(Task("mine", "Push", obj, START, GOAL), tmp_path / "to").scene
    assert scene.start == pytest.approx(START, abs=1e-6)


@pytest.mark.parametrize("precision", TYPES)
def test_a_prim_is_put_in_the_precision_that_it_has(precision):
    stage = Usd.Stage.CreateInMemory()
    prim = UsdGeom.Xform.Define(stage, "/Thing").GetPrim()
    for name, type_name in TYPES[precision].items():
        prim.CreateAttribute(f"xformOp:{name}", type_name, custom=False).Set(type_name.defaultValue)
    set_planar_pose(prim, START, 0.02)
    frame = UsdGeom.Xformable(prim).GetLocalTransformation()
    assert tuple(frame.ExtractTranslation()) == pytest.approx((0.3, -0.45, 0.02), abs=1e-6)
    assert math.atan2(frame[0][1], frame[0][0]) == pytest.approx(0.5, abs=1e-6)
    assert [prim.GetAttribute(f"xformOp:{name}").GetTypeName() for name in TYPES[precision]] == [
        *TYPES[precision].values()
    ]


def robot_with(folder: Path, change: Callable[[str], str]) -> None:
    """The xArm6 with a change to its file, in a folder's robots."""
    robots = folder / "robots"
    robots.mkdir(parents=True)
    shutil.copy(SCENES / "robots" / "xarm6_skin.usda", robots)
    (robots / "xarm6.usda").write_text(change((SCENES / "robots" / "xarm6.usda").read_text()))


ON_THE_TIP = (0.3, -0.2, 0.0)
"""A start at which the arm cannot begin where it does."""


@pytest.mark.parametrize("precision", ["quath", "quatf", "quatd"])
def test_an_arm_is_posed_in_the_precision_of_its_file(tmp_path, precision):
    robot_with(tmp_path, lambda text: text.replace("quatf xformOp:orient", f"{precision} xformOp:orient"))
    scene = write_task(Task("mine", "Push", letter("S"), ON_THE_TIP, GOAL), tmp_path).scene
    written = Usd.Stage.Open(str(scene.file))
    assert written.GetAttributeAtPath("/World/Robot/link1.xformOp:orient").GetTypeName() == precision
    assert written.GetRootLayer().GetAttributeAtPath("/World/Robot/link1.xformOp:orient") is not None


def test_what_openusd_cannot_write_is_said_and_nothing_is_written(tmp_path):
    def spoil(text: str) -> str:
        """An attribute of the wrong type, which nothing reads."""
        text = text.replace("quatf xformOp:orient = (0.9570924, 0, 0, -0.2897829)", 'string xformOp:orient = "left"')
        return text.replace('["xformOp:translate", "xformOp:orient"]', '["xformOp:translate"]')

    robot_with(tmp_path, spoil)
    with pytest.raises(SceneError, match="OpenUSD cannot write the scene"):
        write_task(Task("mine", "Push", letter("S"), ON_THE_TIP, GOAL), tmp_path)
    assert not (tmp_path / "mine.usda").exists()

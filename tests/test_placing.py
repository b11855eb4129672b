"""`scene new` with objects and robots whose files give their places in another precision than ours."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from pxr import Sdf, Usd

from oimppi_warp.authoring import Task, letter, read_object, write_object, write_task
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
    thing = read_object(object_with(tmp_path / "from", **TYPES[precision]))
    scene = write_task(Task("mine", "Push", thing, START, GOAL), tmp_path / "to").scene
    assert scene.start == pytest.approx(START, abs=1e-6)


@pytest.mark.parametrize("precision", ["quath", "quatf", "quatd"])
def test_an_arm_is_posed_in_the_precision_of_its_file(tmp_path, precision):
    robots = tmp_path / "robots"
    robots.mkdir()
    shutil.copy(SCENES / "robots" / "xarm6_skin.usda", robots)
    text = (SCENES / "robots" / "xarm6.usda").read_text()
    (robots / "xarm6.usda").write_text(text.replace("quatf xformOp:orient", f"{precision} xformOp:orient"))
    on_the_tip = (0.3, -0.2, 0.0)  # where the arm cannot begin
    scene = write_task(Task("mine", "Push", letter("S"), on_the_tip, GOAL), tmp_path).scene
    written = Usd.Stage.Open(str(scene.file))
    assert written.GetAttributeAtPath("/World/Robot/link1.xformOp:orient").GetTypeName() == precision
    assert written.GetRootLayer().GetAttributeAtPath("/World/Robot/link1.xformOp:orient") is not None


def test_what_openusd_cannot_write_is_said_and_nothing_is_written(tmp_path):
    thing = read_object(object_with(tmp_path / "from", translate=Sdf.ValueTypeNames.String))
    with pytest.raises(SceneError, match="OpenUSD cannot write it"):
        write_task(Task("mine", "Push", thing, START, GOAL), tmp_path / "to")
    assert not (tmp_path / "to").exists()

"""Every mistake in a scene gets one clear error: what, where, what is allowed, what to do."""

from __future__ import annotations

import pytest
from pxr import Sdf, Usd, UsdShade
from support.bad_scenes import (
    IMPOSSIBLE,
    MISTAKES,
    ROBOT,
    far_reference,
    prim,
    typed,
    walls,
)
from support.variants import variant

from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.feasibility import check_task, sample_start
from oimppi_warp.usd import inspect_scene, load_scene


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_where_it_is(tmp_path, mistake):
    change, what, more = MISTAKES[mistake]
    file = variant(tmp_path, change)
    with pytest.raises(SceneError) as error:
        load_scene(file)
    message = str(error.value)
    assert what in message
    assert more in message
    assert message.startswith(str(file.resolve()))
    assert "allowed:" in message or "to do:" in message


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_once_and_without_consequences(tmp_path, mistake):
    change, what, _ = MISTAKES[mistake]
    (found,) = inspect_scene(variant(tmp_path, change)).mistakes
    assert what in found.what
    assert found.allowed
    assert found.fix


def test_a_number_in_words_is_a_mistake_whether_or_not_newtons_schemas_are_registered(tmp_path):
    """USD's registry of schemas is built once a process: what is found depends on what was imported before."""
    words = typed(f"{ROBOT}/joints/joint2", "newton:friction", Sdf.ValueTypeNames.String, "0.1")
    with pytest.raises(SceneError, match=r"newton:friction is ('0\.1'|of type string)[\s\S]*declare it") as error:
        load_scene(variant(tmp_path, words))
    assert "float" in str(error.value)


@pytest.mark.parametrize("task", IMPOSSIBLE)
def test_a_task_that_cannot_be_done_is_refused(tmp_path, task):
    change, what, more = IMPOSSIBLE[task]
    scene = load_scene(variant(tmp_path, change))
    with pytest.raises(SceneError) as error:
        check_task(scene)
    assert what in str(error.value)
    assert more in str(error.value)


def test_a_start_cannot_be_drawn_where_there_is_no_room(tmp_path):
    with pytest.raises(SceneError, match="none of 2000 starts"):
        sample_start(load_scene(variant(tmp_path, walls)), 0)


def test_a_missing_scene_is_answered_with_the_nearest_name():
    with pytest.raises(SceneError) as error:
        load_scene("tsk02")
    assert "there is no such file" in str(error.value)
    assert "did you mean task02?" in str(error.value)
    assert "task03_wide" in str(error.value)


def test_a_missing_file_is_answered_with_the_nearest_one_in_its_folder(tmp_path):
    (tmp_path / "push_s.usda").write_text("#usda 1.0")
    for name in ("push_s", "pussh_s.usda"):
        with pytest.raises(SceneError, match=rf"did you mean {tmp_path}/push_s\.usda\?"):
            load_scene(tmp_path / name)
    (tmp_path / "folder.usda").mkdir()
    for name in (tmp_path / "folder.usda", "~nobody/push_s.usda"):
        with pytest.raises(SceneError, match="there is no such file") as error:
            load_scene(name)
        assert "did you mean" not in str(error.value) or str(name) not in str(error.value).partition("to do")[2]


@pytest.mark.parametrize("text", ["not a scene at all", "#usda 1.0\n(\n    nonsense here", ""])
@pytest.mark.parametrize("name", ["scene.usda", "scene.txt", "scene.usdc"])
def test_what_is_not_usd_is_refused(tmp_path, text, name):
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(SceneError, match="cannot be read as USD"):
        load_scene(file)


@pytest.mark.parametrize("text", ["#usda 1.0", "#usda 1.0 (\n", '#usda 1.0\n(\n    upAxis = "Z"\n)\n'])
def test_a_file_that_ends_too_early_is_refused_as_such(tmp_path, text):
    file = tmp_path / "scene.usda"
    file.write_text(text)
    with pytest.raises(SceneError, match="the file has no prims"):
        load_scene(file)


def test_a_folder_is_no_scene(tmp_path):
    with pytest.raises(SceneError, match="there is no such file"):
        load_scene(tmp_path)


def test_usd_itself_stays_silent_about_what_is_wrong(tmp_path, capfd):
    file = variant(tmp_path, far_reference)
    capfd.readouterr()
    with pytest.raises(SceneError):
        load_scene(file)
    assert capfd.readouterr() == ("", "")


def test_a_material_without_physics_is_no_friction(tmp_path):
    def plain(stage: Usd.Stage) -> None:
        for path in ("/World/Object/Material", "/World/Materials/Table"):
            UsdShade.Material(prim(stage, path)).GetPrim().RemoveAppliedSchema("PhysicsMaterialAPI")

    with pytest.raises(SceneError, match="has no friction"):
        load_scene(variant(tmp_path, plain))

"""`oimppi scene new`: what it writes can be run, and what cannot be run it does not write."""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st
from pxr import Usd, UsdGeom, UsdValidation
from support.device import DEVICE
from support.meshes import bracket, saved

from oimppi_warp.authoring import Block, Pillar, StaticObject, Task, box, letter, read_object, write_object, write_task
from oimppi_warp.authoring.arm_start import inverse_kinematics_from_start
from oimppi_warp.authoring.checks.check import check_scene
from oimppi_warp.cli.main import main
from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.errors import ConfigError, SceneError
from oimppi_warp.geometry.feasibility import check_task
from oimppi_warp.geometry.footprint import height_range
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.runtime.request import prepare_scene
from oimppi_warp.scene import Scene
from oimppi_warp.usd import load_scene, shipped_scenes


def new(folder: Path, *arguments: str) -> Scene:
    """Write a task with the command, and read it."""
    assert main(["scene", "new", "mine", "--out", str(folder), *arguments]) == 0
    scene = load_scene(folder / "mine.usda")
    check_task(scene)
    return scene


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_without_options_it_is_the_t_block_on_an_open_table(tmp_path, capsys):
    scene = new(tmp_path)
    assert (scene.start, scene.obstacles) == ((0.3, -0.45, 0.0), ())
    assert scene.goal == pytest.approx((0.5, 0.3, math.pi), abs=1e-5)
    assert (scene.object.mass, scene.object.friction) == (0.5, 0.4)
    assert len(scene.starts) == 10
    assert files(tmp_path) == {"mine.usda", "objects/t_block.usda", "robots/xarm6.usda", "robots/xarm6_skin.usda"}
    out = capsys.readouterr().out
    assert "oimppi view" in out
    assert "oimppi run" in out


OBJECTS = {
    "t-block": (2, 0.5),
    "soup_can": (1, 0.349),
    "letter:s": (5, 0.18),
    "text:HI": (5, 0.35),
    "cylinder:0.033x0.101": (1, 0.22),
    "prism:5x0.05x0.05": (1, 0.19),
    "box:0.1x0.06x0.05": (1, 0.2),
}


@pytest.mark.parametrize("word", OBJECTS)
def test_every_word_for_an_object_makes_one(tmp_path, word):
    pieces, mass = OBJECTS[word]
    scene = new(tmp_path, "--object", word, "--goal", "0.5,0.2,1.57")
    assert len(scene.object.colliders) == pieces
    assert scene.object.mass == pytest.approx(mass, abs=0.02)
    assert math.isinf(scene.tolerance.yaw) == (word in ("soup_can", "cylinder:0.033x0.101"))


def test_mass_friction_thickness_and_size_are_those_asked_for(tmp_path):
    options = ["--mass", "0.33", "--friction", "0.6", "--height", "0.03", "--size", "0.2"]
    scene = new(tmp_path, "--object", "letter:H", *options)
    assert (scene.object.mass, scene.object.friction) == (0.33, 0.6)
    assert scene.object.rest_height == 0.015
    vertices = np.vstack([collider.vertices for collider in scene.object.colliders if collider.vertices is not None])
    assert np.ptp(vertices[:, 1]) == pytest.approx(0.2, abs=1e-4)


@pytest.mark.parametrize("friction", [0.001, 0.05, 0.1])
def test_a_friction_that_is_less_than_the_tables_own_is_what_was_asked_for(tmp_path, capsys, friction):
    scene = new(tmp_path, "--object", "t-block", "--friction", str(friction))
    assert scene.object.friction == pytest.approx(friction)
    assert f"friction {friction:g}," in capsys.readouterr().out
    assert check_scene(tmp_path / "mine.usda") == ()


def test_obstacles_stand_where_they_were_put(tmp_path):
    words = [
        "box:0.1,0.2,0.15@0.55,0.0,0.5",
        "cylinder:0.03x0.12@0.3,0.1",
        "letter:O@0.65,0.05,1.0",
        "soup-can@0.2,0.4",
    ]
    scene = new(tmp_path, *(part for word in words for part in ("--obstacle", word)))
    found = {obstacle.path.rsplit("/", 1)[1]: obstacle.colliders for obstacle in scene.obstacles}
    assert list(found) == ["Box", "Cylinder", "LetterO", "SoupCan"]
    (block,), (post,) = found["Box"], found["Cylinder"]
    assert (block.kind, block.size) == ("box", pytest.approx((0.05, 0.1, 0.075)))
    assert block.transform[:3] == pytest.approx((0.55, 0.0, 0.075))
    assert 2 * math.atan2(block.transform[5], block.transform[6]) == pytest.approx(0.5)
    assert (post.kind, post.size) == ("cylinder", pytest.approx((0.03, 0.06)))
    assert len(found["LetterO"]) == 4


def test_two_obstacles_of_a_kind_have_different_names(tmp_path):
    scene = new(tmp_path, "--obstacle", "box:0.1x0.1x0.1@0.5,0", "--obstacle", "box:0.1x0.1x0.1@0.3,0.4")
    assert len({obstacle.path for obstacle in scene.obstacles}) == 2


def test_obstacles_are_called_what_they_are(tmp_path):
    file = saved(bracket(), tmp_path, "3d part.stl")
    places = ["0.5,0", "0.3,0.45", "0.7,0.4", "0.15,0.4", "0.75,-0.3"]
    specs = ["soup-can", "soup-can", f"mesh:{file}", "text:AB", "letter:&"]
    words = [part for spec, at in zip(specs, places, strict=True) for part in ("--obstacle", f"{spec}@{at}")]
    scene = new(tmp_path, "--goal", "0.45,0.2,0", "--font", "DejaVu Sans", *words)
    names = [obstacle.path.rsplit("/", 1)[1] for obstacle in scene.obstacles]
    assert names == ["SoupCan", "SoupCan2", "Obstacle3DPart", "TextAb", "Letter"]


def test_a_mesh_can_be_pushed_at_once(tmp_path):
    file = saved(bracket(), tmp_path, "l.stl", scale=1000)
    scene = new(
        tmp_path / "out",
        "--object",
        f"mesh:{file}",
        "--scale",
        "mm",
        "--mass",
        "0.4",
        "--obstacle",
        "box:0.1,0.1,0.1@0.5,0",
    )
    assert [collider.kind for collider in scene.object.colliders] == ["mesh", "mesh"]
    assert scene.object.mass == 0.4


def test_what_stands_fast_is_made_as_what_is_pushed_but_for_its_mass(tmp_path):
    file = saved(bracket(), tmp_path, "l.stl", scale=1000)
    obstacles = ["--obstacle", f"mesh:{file}@0.5,0", "--obstacle", "letter:O@0.25,0.35"]
    options = ["--scale", "mm", "--height", "0.03", "--mass", "0.7"]
    scene = new(tmp_path / "out", "--object", "letter:S", *options, *obstacles)
    assert [len(obstacle.colliders) for obstacle in scene.obstacles] == [2, 4]
    assert height_range(scene.obstacles[1].colliders) == pytest.approx((0.0, 0.03), abs=1e-6)
    assert "mass = 0.7" not in (tmp_path / "out" / "objects" / "letter_o.usda").read_text()


def test_an_object_that_a_push_may_tip_over_is_said_to_be_one(tmp_path, capsys):
    new(tmp_path, "--object", "cylinder:0.03x0.15")
    assert "a push higher than 75 mm above the table tips the object over" in capsys.readouterr().out


def test_an_imported_object_is_known_by_its_name_and_by_its_file(tmp_path):
    file = saved(bracket(), tmp_path, "l.stl")
    assert main(["scene", "import", str(file), "--out", str(tmp_path), "--mass", "0.4"]) == 0
    scene = new(tmp_path, "--object", "l")
    assert scene.object.mass == 0.4
    elsewhere = new(tmp_path / "elsewhere", "--object", str(tmp_path / "objects" / "l.usda"))
    assert elsewhere.object.mass == 0.4
    assert (tmp_path / "elsewhere" / "objects" / "l.usda").is_file()


def test_a_scene_is_not_taken_for_an_object(tmp_path):
    new(tmp_path)
    with pytest.raises(SceneError, match="a complete scene, not an object"):
        read_object(tmp_path / "mine.usda")


def test_the_file_is_moved_with_its_folder(tmp_path):
    new(tmp_path / "here", "--object", "letter:R")
    shutil.move(tmp_path / "here", tmp_path / "there")
    assert load_scene(tmp_path / "there" / "mine.usda").object.mass > 0.0
    text = (tmp_path / "there" / "mine.usda").read_text()
    assert str(tmp_path) not in text
    assert all(reference.startswith("./") for reference in text.split("@")[1::2])


def test_every_attribute_of_the_task_says_what_it_is_and_its_unit(tmp_path):
    new(tmp_path)
    stage = Usd.Stage.Open(str(tmp_path / "mine.usda"))
    world = stage.GetDefaultPrim()
    for attribute in world.GetAuthoredAttributes():
        if attribute.GetNamespace() == "oimppi":
            assert len(attribute.GetDocumentation()) > 10, attribute.GetName()
    assert "[m, m, rad]" in world.GetAttribute("oimppi:goal").GetDocumentation()
    body = stage.GetPrimAtPath("/World/Object")
    assert "[degrees]" in body.GetAttribute("xformOp:rotateZ").GetDocumentation()
    assert "[kg]" in body.GetAttribute("physics:mass").GetDocumentation()
    assert "oimppi run mine.usda" in stage.GetRootLayer().documentation


def test_it_is_standard_usd(tmp_path):
    new(tmp_path, "--object", "letter:Q", "--obstacle", "cylinder:0.03,0.1@0.5,0")
    stage = Usd.Stage.Open(str(tmp_path / "mine.usda"))
    assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (1.0, "Z")
    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    errors = [e for e in context.Validate(stage) if e.GetType() == UsdValidation.ValidationErrorType.Error]
    assert [e.GetErrorAsString() for e in errors] == []


def test_usd_without_our_schemas_opens_it_and_finds_all_of_it(tmp_path):
    """As usdview, Blender and Omniverse do: in a process that knows nothing of us."""
    new(tmp_path, "--object", "letter:S", "--obstacle", "box:0.1,0.1,0.1@0.5,0.05")
    code = f"""
from pxr import Usd, UsdGeom, UsdPhysics
stage = Usd.Stage.Open({str(tmp_path / "mine.usda")!r})
assert not stage.GetCompositionErrors()
box = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"])
size = box.ComputeWorldBound(stage.GetPrimAtPath("/World/Object")).ComputeAlignedRange().GetSize()
assert abs(size[1] - 0.103) < 1e-4 and abs(size[2] - 0.05) < 1e-4, size
assert stage.GetPrimAtPath("/World/Object").HasAPI(UsdPhysics.RigidBodyAPI)
assert [prim.GetName() for prim in stage.GetPrimAtPath("/World/Obstacles").GetChildren()] == ["Box"]
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


def test_nothing_is_overwritten_without_force(tmp_path, capsys):
    new(tmp_path)
    before = (tmp_path / "mine.usda").read_bytes()
    assert main(["scene", "new", "mine", "--out", str(tmp_path), "--object", "letter:S"]) == 2
    assert "--force" in capsys.readouterr().err
    assert (tmp_path / "mine.usda").read_bytes() == before
    assert "objects/letter_s.usda" not in files(tmp_path)
    assert new(tmp_path, "--object", "letter:S", "--force").object.mass < 0.3


def test_a_task_leaves_the_objects_and_robots_of_others_alone(tmp_path):
    write_object(letter("S", mass=0.5), tmp_path)
    before = (tmp_path / "objects" / "letter_s.usda").read_bytes()
    scene = new(tmp_path, "--object", "letter:S", "--mass", "0.1", "--obstacle", "letter:S@0.6,-0.1")
    assert scene.object.mass == 0.1
    assert (tmp_path / "objects" / "letter_s.usda").read_bytes() == before
    assert {"objects/letter_s_mine.usda", "objects/letter_s_mine_2.usda"} <= files(tmp_path)
    robot = tmp_path / "robots" / "xarm6.usda"
    robot.write_text(robot.read_text().replace("maxForce = 50", "maxForce = 40"))
    scene = new(tmp_path, "--force")
    assert scene.robot.joints[0].effort_limit == 40.0


def test_the_arm_starts_elsewhere_if_its_own_start_is_taken(tmp_path):
    here = new(tmp_path / "free")
    scene = new(tmp_path / "taken", "--start", "0.3,-0.2,0", "--obstacle", "cylinder:0.04x0.3@0.3,-0.05")
    assert np.array_equal(here.robot.start, load_scene("task01").robot.start)
    assert not np.allclose(scene.robot.start, here.robot.start)
    rotation, tip = tip_frame(scene.robot, scene.robot.start)
    assert rotation[:, 2] == pytest.approx((0, 0, -1), abs=1e-3)
    assert tip[2] == pytest.approx(0.05, abs=1e-3)


@pytest.mark.parametrize("place", [(0.4, 0.2), (0.2, -0.3), (0.6, 0.0), (-0.1, 0.4)])
def test_the_arm_is_led_to_any_place_within_reach(place):
    robot = load_scene("task01").robot
    joints = inverse_kinematics_from_start(robot, np.array([*place, 0.05]))
    assert joints is not None
    assert tip_frame(robot, joints)[1] == pytest.approx((*place, 0.05), abs=1e-4)
    assert inverse_kinematics_from_start(robot, np.array([2.0, 0.0, 0.05])) is None


def test_where_there_is_little_room_starts_are_drawn_from_less(tmp_path):
    walls = ["--obstacle", "box:0.5x0.02x0.1@0.3,-0.37", "--obstacle", "box:0.5x0.02x0.1@0.3,-0.53"]
    scene = new(tmp_path, "--object", "box:0.1x0.06x0.05", *walls)
    assert scene.spread == (0.0, 0.0)
    assert scene.starts.tolist() == [list(scene.start)]
    assert prepare_scene(scene.file, seed=3).start == scene.start


IMPOSSIBLE = {
    "out of reach": (["--goal", "0.9,0.3,0"], "out of reach"),
    "degrees": (["--goal", "0.5,0.3,90"], "90 degrees are 1.571"),
    "in an obstacle": (["--obstacle", "box:0.1,0.1,0.1@0.5,0.3"], "overlaps the obstacle"),
    "no pose": (["--start", "0.3,0.2"], "not a pose"),
    "no object": (["--object", "t-blok"], "did you mean t-block?"),
    "no letter": (["--object", "letter:7"], "not in the built-in alphabet"),
    "no sizes": (["--object", "box:0.1x0.1"], "3 lengths above zero"),
    "too large": (["--object", "box:3x0.1x0.1"], "out of range"),
    "no mesh": (["--object", "mesh:nowhere.stl"], "there is no such file"),
    "no place": (["--obstacle", "box:0.1,0.1,0.1"], "append a position, e.g. box:0.1,0.1,0.1@0.5,0.05"),
    "no place but a letter": (
        ["--obstacle", "box:0.1,0.1,0.1@0.5,a"],
        "--obstacle box:0.1,0.1,0.1@0.5,a: not a pose\n  allowed: OBJECT@X,Y[,YAW] in metres and radians",
    ),
    "no robot": (["--robot", "hal9000"], "no such robot"),
    "a size without letters": (["--size", "0.1"], "only with letters or words"),
    "a unit without a mesh": (["--scale", "mm"], "only with a mesh"),
    "no mass": (["--mass", "-1"], "--mass -1"),
}


@pytest.mark.parametrize("kind", IMPOSSIBLE)
def test_what_cannot_be_done_is_said_and_nothing_is_written(tmp_path, capsys, kind):
    options, reason = IMPOSSIBLE[kind]
    assert main(["scene", "new", "mine", "--out", str(tmp_path), *options]) == 2
    message = capsys.readouterr().err
    assert reason in message
    assert "allowed:" in message
    assert files(tmp_path) == set()


@pytest.mark.parametrize("name", ["../up", "a b", "", ".hidden", "x/y"])
def test_names_that_are_no_files_are_refused(tmp_path, name):
    with pytest.raises(SceneError, match="not a valid name"):
        write_task(Task(name, "Push", letter("S"), (0.3, -0.4, 0.0), (0.5, 0.2, 0.0)), tmp_path)


def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises((SceneError, ConfigError), match="the folder is not writable"):
        write_task(Task("mine", "Push", letter("S"), (0.3, -0.4, 0.0), (0.5, 0.2, 0.0)), tmp_path / "file")


def test_from_python_a_task_is_a_few_lines(tmp_path):
    task = Task(
        "three",
        "Push the box past a post, a wall and a letter",
        box(0.1, 0.06, 0.05, mass=0.3),
        start=(0.3, -0.4, 0.0),
        goal=(0.45, 0.3, 1.0),
        obstacles=(
            Block("Wall", (0.55, 0.0), (0.1, 0.1, 0.1), yaw=0.3),
            Pillar("Post", (0.3, 0.1), 0.02, 0.12),
            StaticObject("LetterX", letter("X"), (0.2, 0.35, 0.5)),
        ),
    )
    written = write_task(task, tmp_path)
    assert written.scene.title == task.title
    assert written.scene.file == (tmp_path / "three.usda").resolve()
    assert len(written.scene.obstacles) == 3
    assert shipped_scenes()


# Random tasks ------------------------------------------------------------------------------------------------------

NUMBER = st.floats(-1.0, 1.0).map(lambda v: round(v, 3))


def poses(reach: float = 0.6) -> st.SearchStrategy[str]:
    """Poses on the table, most of them within reach."""
    polar = st.tuples(st.floats(0.25, reach), st.floats(-1.6, 1.6), st.floats(-3.1, 3.1))
    return polar.map(lambda p: f"{p[0] * math.cos(p[1]):.3f},{p[0] * math.sin(p[1]):.3f},{p[2]:.2f}")


def lengths(low: float, high: float, count: int) -> st.SearchStrategy[str]:
    numbers = st.lists(st.floats(low, high), min_size=count, max_size=count)
    return numbers.map(lambda n: "x".join(f"{value:.3f}" for value in n))


ANY_OBJECT = st.one_of(
    st.sampled_from(["t-block", "lab-t", "soup-can"]),
    st.sampled_from("ABCDEFGHIJKLMNOPQRSTUVWXYZ").map("letter:{}".format),
    st.text("AEIOLTV", min_size=2, max_size=3).map("text:{}".format),
    lengths(0.03, 0.12, 3).map("box:{}".format),
    lengths(0.02, 0.08, 2).map("cylinder:{}".format),
    st.tuples(st.integers(3, 24), lengths(0.03, 0.07, 2)).map(lambda given: "prism:{}x{}".format(*given)),
)
OBSTACLES = st.one_of(
    lengths(0.03, 0.15, 3).map("box:{}".format), lengths(0.02, 0.06, 2).map("cylinder:{}".format), ANY_OBJECT
)
TASKS = st.fixed_dictionaries(
    {
        "object": ANY_OBJECT,
        "start": poses(),
        "goal": poses(),
        "mass": st.floats(0.05, 2.0),
        "friction": st.floats(0.001, 1.0),
        "robot": st.sampled_from(["xarm6", "xarm6", "arm7", "point"]),
        "obstacle": st.lists(st.tuples(OBSTACLES, poses()).map("@".join), max_size=3),
    }
)


def assert_as_asked(options: dict, scene: Scene) -> None:
    """The scene in the file is the task that was asked for, from every start that it lists."""
    assert scene.start == pytest.approx([float(v) for v in options["start"].split(",")], abs=1e-6)
    assert scene.goal == pytest.approx([float(v) for v in options["goal"].split(",")], abs=1e-6)
    assert scene.object.mass == pytest.approx(options["mass"], rel=1e-5)
    assert scene.object.friction == pytest.approx(options["friction"], rel=1e-5)
    assert len(scene.obstacles) == len(options["obstacle"])
    for start in scene.starts:
        check_task(scene.with_start(tuple(start)))


def try_task(options: dict, folder: Path) -> Scene | None:
    """Write a task with the command; ``None`` where it refuses, having written nothing."""
    words = [f"--{name}={value}" for name, value in options.items() if name != "obstacle"]
    words += [f"--obstacle={word}" for word in options["obstacle"]]
    if main(["scene", "new", "mine", "--out", str(folder), *words]) == 2:
        assert files(folder) == set()
        return None
    return load_scene(folder / "mine.usda")


def check_random_task(options: dict) -> None:
    with tempfile.TemporaryDirectory() as folder:
        scene = try_task(options, Path(folder))
        if scene is not None:
            assert_as_asked(options, scene)


def run_ten_steps(options: dict) -> None:
    with tempfile.TemporaryDirectory() as folder:
        scene = try_task(options, Path(folder))
        assume(scene is not None)
        assert [problem for problem in check_scene(scene.file) if problem.severity == "error"] == []
        config = best("cloi")
        for option in ("robot.optimizer.samples=64", "object.optimizer.samples=64", "episode.max_sim_seconds=0.5"):
            config = set_option(config, option)
        log = Episode(scene, config, method="cloi", engine="quasistatic", device=DEVICE).run()
        assert len(log) == 10
        assert np.isfinite(log["command"]).all()
        assert log["lost_samples"].max() == 0


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(TASKS)
def test_what_is_written_passes_the_check_and_is_what_was_asked_for(options):
    check_random_task(options)


@settings(max_examples=2, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))
@given(TASKS)
def test_what_is_written_can_be_run(options):
    run_ten_steps(options)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@settings(max_examples=30, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))
@given(TASKS)
def test_what_is_written_can_be_run_at_length(options):
    run_ten_steps(options)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(TASKS)
def test_what_is_written_passes_the_check_and_is_what_was_asked_for_at_length(options):
    check_random_task(options)

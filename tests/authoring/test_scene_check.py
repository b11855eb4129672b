"""`oimppi scene check`: all mistakes at once, each with its place and its cure; what may spoil a run; exit status."""

from __future__ import annotations

import gc
import json
import math

import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics
from support.bad_scenes import (
    IMPOSSIBLE,
    MISTAKES,
    START,
    TIP,
    add,
    barrier,
    drop,
    goal_to,
    object_to,
    prim,
    put,
    vast,
    walls,
    without,
)
from support.foreign_scenes import flat
from support.lint_cases import CUBE, LINT_CASES, OBJECT, ROBOT, several
from support.messages import MANUAL, manual, plain
from support.variants import variant

from oimppi_warp.authoring.checks.check import check_scene
from oimppi_warp.cli.main import main
from oimppi_warp.errors import Problem, SceneError
from oimppi_warp.usd import inspect_scene, load_scene, shipped_scenes


def found(file) -> list[tuple[str, str]]:
    """Severity and words of each problem."""
    return [(problem.severity, problem.what) for problem in check_scene(file)]


def test_the_shipped_scenes_have_no_mistakes():
    for scene in shipped_scenes():
        assert [problem for problem in check_scene(scene.name) if problem.severity == "error"] == []


def test_mistakes_in_everything_are_all_told(tmp_path):
    file = variant(
        tmp_path,
        several(
            goal_to(float("inf"), 0.0, 0.0),
            put("/World", "oimppi:tolerance", Gf.Vec2d(0.0, 0.5)),
            put("/World", "oimppi:spread", Gf.Vec2d(-0.1, 0.0)),
            put(TIP, "oimppi:radius", -1.0),
            put(f"{ROBOT}/joints/joint2", "physics:axis", "X"),
            put(f"{ROBOT}/joints/joint4", "physics:lowerLimit", 1000.0),
            drop(f"{ROBOT}/link3", "PhysicsMassAPI"),
            put("/World/Table", "xformOp:translate", Gf.Vec3d(0.375, 0.0, 0.0)),
            object_to(0.3, -0.45, 0.055),
            put(OBJECT, "physics:mass", -1.0),
            put(CUBE, "size", -1.0),
            lambda stage: UsdPhysics.CollisionAPI.Apply(UsdGeom.Sphere.Define(stage, "/World/Ball").GetPrim()),
        ),
    )
    mistakes = inspect_scene(file).mistakes
    assert [(mistake.prim.rpartition("/")[2], mistake.what.split(":")[0]) for mistake in mistakes] == [
        ("World", "oimppi"),
        ("World", "oimppi"),
        ("World", "oimppi"),
        ("tip", "oimppi"),
        ("joint2", "the joint turns about its X axis"),
        ("link3", "the body has no mass"),
        ("joint4", "the lower limit (1000 deg) is not below the upper limit (360 deg)"),
        ("Table", "the table has no flat top at z = 0; its level tops are at 0.02 m"),
        ("Object", "the mass is -1 kg"),
        ("Object", "the object is 30.0 mm above the table"),
        ("Cube", "size is -1 m"),
        ("Ball", "this prim collides or moves but has no role in the task"),
    ]
    assert all(mistake.allowed or mistake.fix for mistake in mistakes)


def test_the_loader_raises_the_first_mistake_and_says_how_to_see_the_others(tmp_path):
    file = variant(tmp_path, several(put(TIP, "oimppi:radius", 0.0), put(OBJECT, "physics:mass", -1.0)))
    with pytest.raises(SceneError) as error:
        load_scene(file)
    assert "oimppi:radius is 0" in str(error.value)
    assert f"and 1 more: `oimppi scene check {file.resolve()}` lists them all" in str(error.value)


@pytest.mark.parametrize("missing", [ROBOT, OBJECT, "/World/Table"])
def test_what_is_missing_makes_no_other_mistakes(tmp_path, missing):
    (mistake,) = inspect_scene(variant(tmp_path, without(missing))).mistakes
    assert mistake.what.startswith("the scene has no ")


def test_every_reference_that_cannot_be_followed_is_told(tmp_path):
    def change(stage: Usd.Stage) -> None:
        for name in ("a", "b"):
            stage.DefinePrim(f"/World/{name}").GetReferences().AddReference(f"./{name}.usda")

    mistakes = inspect_scene(variant(tmp_path, change)).mistakes
    assert len(mistakes) == 2
    assert "a.usda" in mistakes[0].what
    assert "b.usda" in mistakes[1].what


def test_a_wrong_start_and_a_wrong_goal_are_both_told(tmp_path):
    file = variant(tmp_path, several(object_to(0.5, 0.0), goal_to(0.8, 0.3, 0.0), put(ROBOT, START, [0.0] * 6)))
    whats = [what for severity, what in found(file) if severity == "error"]
    assert "start (0.5, 0, 0) overlaps the obstacle" in whats[0]
    assert "goal (0.8, 0.3, 0) is out of reach" in whats[1]
    assert "below the table" in whats[2]


def test_a_spread_without_room_is_a_mistake(tmp_path):
    severity, what = found(variant(tmp_path, walls))[0]
    assert severity == "error"
    assert what.startswith("none of 2000 starts drawn around (0.3, -0.45)")


def test_listed_starts_that_cannot_be_used_are_warned_of(tmp_path):
    starts = [Gf.Vec3d(0.3, -0.45, 0.0), Gf.Vec3d(0.5, 0.05, 0.0), Gf.Vec3d(0.75, -0.4, 0.0)]
    (first, what), (second, other) = found(variant(tmp_path, put("/World", "oimppi:starts", starts)))
    assert (first, second) == ("warning", "warning")
    assert what == f"the object's start 1 (0.5, 0.05, 0) overlaps the obstacle <{CUBE}>"
    assert other.startswith("the object's start 2 (0.75, -0.4, 0) is out of reach")


def test_a_scene_that_always_starts_alike_is_warned_of(tmp_path):
    change = several(put("/World", "oimppi:spread", Gf.Vec2d(0.0)), put("/World", "oimppi:starts", []))
    assert found(variant(tmp_path, change)) == [("warning", "every run starts from the same pose")]


def test_an_object_that_a_push_may_tip_is_warned_of():
    (problem,) = check_scene("lab01")
    assert problem.severity == "warning"
    assert problem.prim == OBJECT
    assert "its top is at 101 mm" in problem.what
    assert "up to 82 mm" in problem.allowed


def test_the_exit_status_tells_mistakes_from_warnings_and_from_missing_files(tmp_path, capsys):
    bad = str(variant(tmp_path, put(OBJECT, "physics:mass", -1.0)))
    assert main(["scene", "check", "task02"]) == 0
    assert main(["scene", "check", "task02", "lab01"]) == 0
    assert main(["scene", "check", "task02", "lab01", "--strict"]) == 1
    assert main(["scene", "check", "task02", bad]) == 1
    assert main(["scene", "check", bad, "nowhere.usda"]) == 2
    assert "nowhere.usda: there is no such file" in capsys.readouterr().err


def test_people_read_what_where_what_is_allowed_and_what_to_do(tmp_path, capsys):
    bad = str(variant(tmp_path, put(OBJECT, "physics:mass", -1.0)))
    main(["scene", "check", "task02", bad])
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        "task02: no problems found",
        f"{bad}: 1 error",
        f"error <{OBJECT}>",
        "found the mass is -1 kg",
        "allowed a finite mass above zero",
        "to do apply PhysicsMassAPI and set physics:mass",
    ]


def test_tools_read_the_same_as_json(tmp_path, capsys):
    bad = variant(tmp_path, put(OBJECT, "physics:mass", -1.0))
    assert main(["scene", "check", str(bad), "lab01", "--json"]) == 1
    first, second = json.loads(capsys.readouterr().out)
    assert first == {
        "file": str(bad.resolve()),
        "severity": "error",
        "prim": OBJECT,
        "what": "the mass is -1 kg",
        "allowed": "a finite mass above zero",
        "fix": "apply PhysicsMassAPI and set physics:mass",
    }
    assert second["severity"] == "warning"
    assert list(second) == [field for field in Problem.__dataclass_fields__]


def test_nothing_wrong_is_an_empty_list(capsys):
    assert main(["scene", "check", "task02", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == []


def test_no_file_at_all_is_bad_input(capsys):
    assert main(["scene", "check"]) == 2
    assert "no file to check" in capsys.readouterr().err


def test_something_that_is_no_usd_is_a_mistake_in_the_file(tmp_path):
    file = tmp_path / "scene.usda"
    file.write_text("not a scene at all")
    (problem,) = check_scene(file)
    assert "cannot be read as USD" in problem.what


def test_a_file_that_was_mended_is_read_anew(tmp_path):
    file = tmp_path / "scene.usda"
    for mass, expected in (("-1", 1), ("0.5", 0), ("-2", 1)):
        stage = flat("task02")
        stage.GetPrimAtPath(OBJECT).GetAttribute("physics:mass").Set(float(mass))
        file.write_text(stage.ExportToString())
        gc.disable()
        try:
            assert len(inspect_scene(file).mistakes) == expected
        finally:
            gc.enable()


def test_a_stage_without_anything_is_told_all_that_it_needs(tmp_path):
    def nothing(stage: Usd.Stage) -> None:
        stage.GetRootLayer().subLayerPaths.clear()
        UsdGeom.Xform.Define(stage, "/World")

    whats = [mistake.what for mistake in inspect_scene(variant(tmp_path, nothing)).mistakes]
    assert whats == [f"the scene has no {noun}" for noun in ("task", "robot", "table", "object")]
    assert not prim(Usd.Stage.Open(str(tmp_path / "variant.usda")), ROBOT)


def test_a_gap_narrower_than_the_object_is_warned_of_with_its_sides_and_by_how_much(tmp_path):
    problem = check_scene(variant(tmp_path, barrier(0.12), "task01"))[-1]
    assert problem.severity == "warning"
    assert problem.what.startswith("no free path leads to the goal from the object's start and 9 others: at (")
    assert "between the obstacle </World/Obstacles/B> and the obstacle </World/Obstacles/C>" in problem.what
    assert "which are 120 mm apart: about " in problem.what
    missing = float(
        problem.what.rpartition("apart: about ")[2].split()[0]
    )  # the T is 150 mm broad where it is narrowest
    assert missing == pytest.approx(30.0, abs=12.0)
    assert problem.what.endswith("mm less than the object needs there")


def test_a_gap_that_the_object_hardly_fits_through_is_warned_of(tmp_path):
    problem = check_scene(variant(tmp_path, barrier(0.162), "task01"))[-1]
    assert problem.what.startswith("the path to the goal is narrow: at (")
    assert problem.what.endswith("162 mm apart: about 4 mm more than the object needs there")


def test_a_gap_that_is_wide_enough_is_nothing_to_warn_of(tmp_path):
    assert found(variant(tmp_path, barrier(0.2), "task01")) == []


def test_listed_starts_without_a_way_are_warned_of(tmp_path):
    starts = [Gf.Vec3d(0.5, 0.3, 0.0), Gf.Vec3d(0.3, -0.45, 0.0), Gf.Vec3d(0.3, -0.4, 0.0)]
    at_the_goal = [put(OBJECT, "xformOp:translate", Gf.Vec3d(0.5, 0.3, 0.025)), put("/World", "oimppi:starts", starts)]
    problem = check_scene(variant(tmp_path, several(barrier(0.12), *at_the_goal), "task01"))[-1]
    assert problem.what.startswith("no free path leads to the goal from the object's start 1 and 1 other: ")


@pytest.mark.parametrize("yaw", [-170.0, 180.0])
def test_the_start_in_the_file_counts_once_though_it_is_rounded_in_the_list(tmp_path, yaw):
    starts = [Gf.Vec3d(0.3, -0.45, round(math.radians(yaw), 9) + turns * 2.0 * math.pi) for turns in (0, -1)]
    turned = put(OBJECT, "xformOp:rotateZ", yaw)
    file = variant(tmp_path, several(barrier(0.12), turned, put("/World", "oimppi:starts", starts)), "task01")
    (what,) = [what for _, what in found(file) if what.startswith("no free path")]
    assert what.startswith("no free path leads to the goal from the object's start: at (")


def test_a_goal_in_a_slot_is_warned_of(tmp_path):
    def change(stage: Usd.Stage) -> None:
        goal_to(0.505, 0.3, 3.14159265)(stage)
        for name, x in (("A", 0.352), ("B", 0.658)):
            cube = UsdGeom.Cube.Define(stage, f"/World/Obstacles/{name}")
            cube.CreateSizeAttr(0.1)
            cube.AddTranslateOp().Set(Gf.Vec3d(x, 0.3, 0.05))
            UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
            cube.GetPrim().AddAppliedSchema("OimppiObstacleAPI")

    ((severity, what),) = found(variant(tmp_path, change, "task01"))
    assert severity == "warning"
    assert what.startswith("there is hardly any room around the object's goal, next to the obstacle ")
    assert "</World/Obstacles/A>" in what
    assert "</World/Obstacles/B>" in what


def test_any_yaw_will_do_at_a_goal_without_one(tmp_path):
    change = several(barrier(0.12), put("/World", "oimppi:tolerance", Gf.Vec2d(0.1, float("inf"))))
    assert "no free path leads to the goal" in found(variant(tmp_path, change, "task01"))[-1][1]
    assert found("lab02")[1:] == []


@pytest.mark.parametrize("case", LINT_CASES)
def test_what_is_allowed_but_hardly_meant_is_warned_of(tmp_path, case):
    change, (path, what, more) = LINT_CASES[case]
    problem = check_scene(variant(tmp_path, change))[0]
    assert problem.severity == "warning"
    assert problem.prim == path
    assert problem.what.startswith(what)
    assert more in f"{problem.allowed} {problem.fix}"


def test_a_table_that_is_too_large_for_the_grid_is_a_mistake(tmp_path):
    severity, what = found(variant(tmp_path, vast, "point01"))[0]
    assert severity == "error"
    assert what == "the arm reaches 80 x 80 m of the table"


def test_the_manual_has_every_message():
    page = MANUAL.read_text()
    said = [what for _, what, _ in [*MISTAKES.values(), *IMPOSSIBLE.values()]]
    said += [what for _, (_, what, _) in LINT_CASES.values()]
    assert [what for what in said if plain(what) not in page] == []


@pytest.mark.slow
def test_the_manual_lists_the_messages_as_they_are():
    """Written anew by `python -m support.messages`."""
    assert MANUAL.read_text() == manual()


def test_a_file_in_other_units_that_is_referred_to_is_warned_of(tmp_path):
    other = Usd.Stage.CreateNew(str(tmp_path / "post.usda"))
    UsdGeom.SetStageMetersPerUnit(other, 0.01)
    other.SetDefaultPrim(UsdGeom.Cylinder.Define(other, "/Post").GetPrim())
    other.Save()

    def change(stage: Usd.Stage) -> None:
        stage.DefinePrim("/World/Decoration").GetReferences().AddReference("./post.usda")

    (problem,) = check_scene(variant(tmp_path, change))
    assert problem.what == f"metersPerUnit is 0.01 in {tmp_path.resolve()}/post.usda"
    assert problem.allowed == "1, as in the scene"


def test_warnings_help_where_a_scene_cannot_be_read(tmp_path):
    file = variant(tmp_path, several(drop("/World/Table", "OimppiTableAPI"), add("/World/Table", "OimppiTabelAPI")))
    assert found(file) == [
        ("error", "the scene has no table"),
        ("warning", "the API schema OimppiTabelAPI is unknown"),
    ]


def test_a_run_says_that_something_in_its_file_may_not_be_meant(tmp_path, capsys):
    misspelt = "oimppi:tolerence", Sdf.ValueTypeNames.Double2
    file = variant(tmp_path, lambda stage: prim(stage, "/World").CreateAttribute(*misspelt).Set(Gf.Vec2d(0.01, 0.02)))
    options = [
        "--device",
        "cpu",
        "--max-sim-seconds",
        "0.05",
        "--set",
        "robot.optimizer.samples=16",
        "object.optimizer.samples=16",
    ]
    assert main(["run", str(file), *options]) == 1
    assert f"1 warning, listed by `oimppi scene check {file}`" in capsys.readouterr().err
    assert main(["run", "task02", *options]) == 1
    assert "warning" not in capsys.readouterr().err

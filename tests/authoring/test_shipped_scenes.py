"""The shipped scenes: written by their tool, true to their figures, and fit to be run."""

from __future__ import annotations

import filecmp
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
from pxr import Usd, UsdGeom, UsdPhysics, UsdValidation

from oimppi_warp.geometry.feasibility import (
    START_CLEARANCE,
    check_task,
    fixed_outlines,
    object_outline,
    sample_beside,
    sample_start,
)
from oimppi_warp.geometry.footprint import core_points, footprint, height_range, limit_surface, outline, rotation_matrix
from oimppi_warp.geometry.kinematics import link_frames, tip_frame
from oimppi_warp.geometry.reach import can_lift, reach_of
from oimppi_warp.usd import load_scene, shipped_scenes

ROOT = Path(__file__).resolve().parents[2]
NAMES = (
    *("arm7_01", "lab01", "lab02", "point01", "pusht", "task01", "task02", "task03", "task03_wide", "task04"),
    "task05",
)

T_START, T_GOAL = (0.30, -0.45, 0.0), (0.50, 0.30, math.pi)
START_AND_GOAL = {
    "task01": (T_START, T_GOAL),
    "task02": (T_START, T_GOAL),
    "task03": (T_START, T_GOAL),
    "task03_wide": (T_START, T_GOAL),
    "task04": (T_START, T_GOAL),
    "task05": ((0.30, -0.40, 0.0), (0.50, 0.15, -math.pi / 2)),
    "arm7_01": (T_START, T_GOAL),
    "point01": (T_START, T_GOAL),
    "pusht": ((0.25, 0.262, 0.0), (0.256, 0.256, -math.pi / 4)),
    "lab01": ((0.381, 0.343, 0.0), (0.381, -0.305, 0.0)),
    "lab02": ((0.381, 0.343, 0.0), (0.381, -0.305, 0.0)),
}


@pytest.fixture(scope="module")
def scenes():
    return {name: load_scene(name) for name in NAMES}


def test_what_is_committed_is_what_the_tool_writes(tmp_path):
    subprocess.run([sys.executable, ROOT / "tools" / "make_scenes.py", tmp_path], check=True, cwd=tmp_path)
    for top, kept in (("scenes", ROOT / "scenes"), ("docs", ROOT / "docs")):
        written = sorted(path.relative_to(tmp_path / top) for path in (tmp_path / top).rglob("*") if path.is_file())
        if top == "scenes":
            assert written == sorted(path.relative_to(kept) for path in kept.rglob("*") if path.is_file())
        different = filecmp.cmpfiles(tmp_path / top, kept, [str(path) for path in written], shallow=False)[1:]
        assert different == ([], [])


def test_shipped_scenes_have_names_titles_and_files():
    listed = shipped_scenes()
    assert tuple(scene.name for scene in listed) == NAMES
    assert all(len(scene.title) > 20 and scene.path.is_file() for scene in listed)


def test_no_file_names_a_place_outside_the_scenes():
    for file in (ROOT / "scenes").rglob("*.usda"):
        references = [part.split("@")[0] for part in file.read_text().split("@")[1::2]]
        for reference in references:
            assert reference.startswith(("./", "../"))
            assert (file.parent / reference).resolve().is_relative_to(ROOT / "scenes")
            assert (file.parent / reference).is_file()


@pytest.mark.parametrize("name", NAMES)
def test_start_and_goal_are_those_of_the_paper(scenes, name):
    start, goal = START_AND_GOAL[name]
    assert scenes[name].start == pytest.approx(start, abs=1e-9)
    assert scenes[name].goal == pytest.approx(goal, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_can_be_done_from_each_of_its_ten_starts(scenes, name):
    scene = scenes[name]
    assert scene.starts.shape == (10, 3)
    assert tuple(scene.starts[0]) == pytest.approx(scene.start)
    assert len(np.unique(scene.starts, axis=0)) == 10
    for start in scene.starts:
        check_task(scene.with_start(tuple(start)))


@pytest.mark.parametrize("name", NAMES)
def test_starts_keep_to_their_spread_and_leave_room(scenes, name):
    scene = scenes[name]
    offsets = np.abs(scene.starts - scene.starts[0])
    assert (offsets <= ((0.15, 0.15, math.pi) if name == "pusht" else (0.11, 0.11, 0.45))).all()
    blocks = [outline(footprint(obstacle.colliders)) for obstacle in scene.obstacles]
    for start in scene.starts[1:]:
        shape = object_outline(scene, tuple(start))
        assert all(shapely.distance(shape, block) >= 0.045 for block in blocks)
        if scene.robot.base.colliders:
            assert shapely.distance(shape, shapely.Point(0.0, 0.0)) >= 0.09 + 0.045 - 1e-4


def test_the_same_seed_draws_the_same_start_and_another_seed_another(scenes):
    assert sample_start(scenes["task02"], 3) == sample_start(scenes["task02"], 3)
    assert len({sample_start(scenes["task02"], seed) for seed in range(10)}) == 10


def test_seeds_draw_no_start_that_the_scene_lists(scenes):
    listed = {tuple(start) for start in scenes["task02"].starts}
    assert not listed & {sample_start(scenes["task02"], seed) for seed in range(100)}


def test_a_drawn_start_leaves_room_to_the_tool(scenes):
    scene = scenes["task02"]
    tip = tip_frame(scene.robot, scene.robot.start)[1]
    for seed in range(20):
        shape = object_outline(scene, sample_start(scene, seed))
        assert shapely.distance(shape, shapely.Point(tip[:2])) >= START_CLEARANCE


@pytest.mark.parametrize("name", ["task01", "task03", "lab02"])
def test_a_start_beside_something_is_as_near_as_asked_and_can_be_pushed_from(scenes, name):
    scene, found = scenes[name], set()
    for seed in range(12):
        start = sample_beside(scene, seed, (0.001, 0.003))
        check_task(scene.with_start(start))
        shape = object_outline(scene, start)
        away = {path: shapely.distance(shape, other) for _, path, other in fixed_outlines(scene)}
        assert 0.001 <= min(away.values()) <= 0.003
        found.add(min(away, key=away.__getitem__))
        assert start == sample_beside(scene, seed, (0.001, 0.003))
    assert len(found) > 1 or name == "task01", "not only beside the base, which is all there is on task01"


def obstacle_boxes(scene):
    """(x, y, side lengths) of obstacles that are one box each."""
    boxes = {}
    for obstacle in scene.obstacles:
        (collider,) = obstacle.colliders
        boxes[obstacle.path.rsplit("/", 1)[1]] = np.array([*collider.transform[:2], *(2 * h for h in collider.size)])
        assert collider.transform[2] == pytest.approx(collider.size[2])  # stands on the table
    return boxes


def test_obstacles_have_the_sizes_and_places_of_the_paper(scenes):
    cube = (0.50, 0.05, 0.10, 0.10, 0.10)
    assert obstacle_boxes(scenes["task01"]) == {}
    assert obstacle_boxes(scenes["task02"])["Cube"] == pytest.approx(cube)
    assert obstacle_boxes(scenes["task04"])["Cube"] == pytest.approx(cube)
    assert obstacle_boxes(scenes["task04"])["SugarBox"] == pytest.approx((0.50, -0.20, 0.175, 0.095, 0.06))
    for name, gap in (("task03", 0.20), ("task03_wide", 0.30)):
        boxes = obstacle_boxes(scenes[name])
        inner = boxes["Right"][0] - boxes["Right"][2] / 2 - (boxes["Left"][0] + boxes["Left"][2] / 2)
        assert inner == pytest.approx(gap)
        assert boxes["Left"][2:] == pytest.approx((0.20, 0.25, 0.20))


def test_the_t_block_is_the_one_of_the_paper(scenes):
    body = scenes["task01"].object
    shape = outline(footprint(body.colliders))
    assert (body.mass, body.friction, body.rest_height) == (0.5, 0.4, 0.025)
    assert tuple(shapely.bounds(shape)) == pytest.approx((-0.10, -0.125, 0.10, 0.025))
    assert shapely.area(shape) == pytest.approx(0.20 * 0.05 + 0.05 * 0.10)
    assert body.center_of_mass == pytest.approx((0.0, -0.025, 0.0))


def test_the_t_of_pusht_is_that_of_gym_pusht(scenes):
    """At 1 mm per pixel, and with y upwards: two rectangles, and D = diag(1, 1, 1/3000) about (0, 45)."""
    scene = scenes["pusht"]
    bar, stem = shapely.box(-0.06, -0.03, 0.06, 0.0), shapely.box(-0.015, -0.12, 0.015, -0.03)
    shape = outline(footprint(scene.object.colliders))
    assert shapely.area(shapely.symmetric_difference(shape, shapely.union(bar, stem))) < 1e-9
    surface = limit_surface(scene.object)
    np.testing.assert_allclose(surface.center, (0.0, -0.045), atol=1e-8)
    np.testing.assert_allclose(surface.mobility / surface.mobility[0], (1.0, 1.0, 1e6 / 3000.0), rtol=1e-6)
    assert scene.object.tool_friction == 0.0 and scene.robot.tool_radius == 0.015
    assert scene.table.lower == pytest.approx((0.008, 0.008)) and scene.table.upper == pytest.approx((0.504, 0.504))


def test_letters_are_whole_and_their_pieces_do_not_overlap(scenes):
    scene = scenes["task05"]
    for colliders in (scene.object.colliders, *(obstacle.colliders for obstacle in scene.obstacles)):
        pieces = [piece.polygon() for piece in footprint(colliders)]
        shape = shapely.union_all([shapely.buffer(piece, 1e-6) for piece in pieces])
        assert shape.geom_type == "Polygon"
        assert sum(shapely.area(piece) for piece in pieces) == pytest.approx(shapely.area(shape), rel=1e-3)
        low, high = height_range(colliders)
        assert high - low == pytest.approx(0.05)
    width = shapely.bounds(outline(footprint(scene.object.colliders)))
    assert width[3] - width[1] == pytest.approx(0.103)


def test_the_empty_place_spells_iros(scenes):
    scene = scenes["task05"]
    places = {
        obstacle.path[-1]: shapely.get_y(shapely.centroid(outline(footprint(obstacle.colliders))))
        for obstacle in scene.obstacles
    } | {"S": scene.goal[1]}
    assert "".join(sorted(places, key=places.__getitem__, reverse=True)) == "IROS"


def test_forward_kinematics_agrees_with_the_published_chain(scenes):
    robot = scenes["task01"].robot
    cases = {
        (0, 0, 0, 0, 0, 0): ((0.207, 0, 0.112), (1, 0, 0, 0)),
        (0, -0.5, -0.5, 0, 1, 0): ((0.316631342, 0, 0.325481967), (1, 0, 0, 0)),
        (0.3, -0.7, -0.9, 0.4, 1.2, -0.6): (
            (0.28448602, 0.113628607, 0.551744586),
            (-0.879594496, -0.387392031, -0.221779591, 0.16448328),
        ),
    }
    for joints, (position, quaternion) in cases.items():
        rotation, tip = tip_frame(robot, np.array(joints, dtype=float))
        np.testing.assert_allclose(tip - 0.175 * rotation[:, 2], position, atol=1e-8)
        np.testing.assert_allclose(rotation, rotation_matrix(np.array(quaternion)), atol=1e-8)


def test_limits_masses_and_tool_are_those_of_the_arm(scenes):
    robot = scenes["task01"].robot
    lower = (-2 * math.pi, -2.059, -3.927, -2 * math.pi, -1.69297, -2 * math.pi)
    upper = (2 * math.pi, 2.0944, 0.19198, 2 * math.pi, math.pi, 2 * math.pi)
    assert [joint.lower for joint in robot.joints] == pytest.approx(lower, abs=1e-6)
    assert [joint.upper for joint in robot.joints] == pytest.approx(upper, abs=1e-6)
    assert [joint.effort_limit for joint in robot.joints] == [50, 50, 32, 32, 32, 20]
    assert [joint.velocity_limit for joint in robot.joints] == pytest.approx([3.14] * 6, abs=1e-6)
    assert [link.mass for link in robot.links] == pytest.approx([2.3814, 2.2675, 1.875, 1.3192, 1.33854, 0.17 + 0.05])
    assert robot.base.mass == pytest.approx(2.7)
    assert robot.tip[:3] == pytest.approx((0, 0, 0.175), abs=1e-9)
    assert robot.tool_radius == 0.008


def test_principal_inertias_make_up_the_published_tensors(scenes):
    stage = Usd.Stage.Open(str(scenes["task01"].file))
    published = {
        "link2": [[0.028315776, 0.005, 0.00066546], [0.005, 0.0058, -0.0045741], [0.00066546, -0.0045741, 0.0273447]],
        "link6": [[9.3e-5, 0, 0], [0, 5.87e-5, -3.6e-6], [0, -3.6e-6, 1.32e-4]],
    }
    for link, tensor in published.items():
        api = UsdPhysics.MassAPI(stage.GetPrimAtPath(f"/World/Robot/{link}"))
        q = api.GetPrincipalAxesAttr().Get()
        axes = rotation_matrix(np.array([*q.GetImaginary(), q.GetReal()]))
        moments = np.array(api.GetDiagonalInertiaAttr().Get())
        np.testing.assert_allclose(axes @ np.diag(moments) @ axes.T, tensor, atol=2e-8)
        assert 2 * moments.max() <= moments.sum() + 1e-9  # as of any solid body


def start_height(scene):
    """Of the tip [m]: a robot that cannot lower it starts where it pushes."""
    return 0.05 if can_lift(scene.robot) else 0.012


@pytest.mark.parametrize("name", NAMES)
def test_the_arm_starts_with_its_tool_down_and_just_above_the_table(scenes, name):
    rotation, tip = tip_frame(scenes[name].robot, scenes[name].robot.start)
    assert rotation[:, 2] == pytest.approx((0, 0, -1), abs=1e-3)
    assert tip[2] == pytest.approx(start_height(scenes[name]), abs=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_the_arm_starts_clear_of_table_and_obstacles(scenes, name):
    robot = scenes[name].robot
    rotations, positions = link_frames(robot, robot.start)
    for link, rotation, position in zip(robot.links, rotations, positions, strict=True):
        for collider in link.colliders:
            (a, b), radius = core_points(collider)
            points = (a + np.linspace(0.0, 1.0, 40)[:, None] * (b - a)) @ rotation.T + position
            assert points[:, 2].min() - radius > start_height(scenes[name]) - 0.005
            for box in (box for obstacle in scenes[name].obstacles for box in obstacle.colliders if box.kind == "box"):
                local = (points - box.transform[:3]) @ rotation_matrix(box.transform[3:])
                gap = np.linalg.norm(np.maximum(np.abs(local) - box.size, 0.0), axis=1).min() - radius
                assert gap > 0.05


@pytest.mark.parametrize("name", NAMES)
def test_usd_s_own_validators_find_nothing_wrong(scenes, name):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(scenes[name].file)))
    assert [error.GetMessage() for error in found] == []


@pytest.mark.parametrize("name", NAMES)
def test_links_are_drawn_where_the_start_puts_them(scenes, name):
    scene = scenes[name]
    stage = Usd.Stage.Open(str(scene.file))
    tip = UsdGeom.Xformable(stage.GetPrimAtPath(scene.robot.tool_path)).ComputeLocalToWorldTransform(0)
    np.testing.assert_allclose(tip.ExtractTranslation(), tip_frame(scene.robot, scene.robot.start)[1], atol=1e-6)


def test_the_arm_reaches_as_far_as_measured(scenes):
    assert reach_of(scenes["task01"].robot).radius == pytest.approx(0.71, abs=0.01)


@pytest.mark.parametrize("name", NAMES)
def test_only_what_has_a_role_collides(scenes, name):
    scene = scenes[name]
    stage = Usd.Stage.Open(str(scene.file))
    colliding = {str(prim.GetPath()) for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)}
    bodies = (scene.object, *scene.robot.links, scene.robot.base, *scene.obstacles)
    known = {collider.path for body in bodies for collider in body.colliders}
    assert colliding == known | {scene.table.path}


def test_every_shipped_scene_has_its_picture_and_its_command():
    page = (ROOT / "docs" / "scenes.md").read_text()
    for scene in shipped_scenes():
        assert f"(images/view/{scene.name}.png)" in page and f"oimppi view {scene.name} " in page
        assert (ROOT / "docs" / "images" / "view" / f"{scene.name}.png").is_file()

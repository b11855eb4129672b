"""The viewer without a browser: the control loop behind it, the record as pictures, what it exports."""

import time
from dataclasses import replace

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from support.device import DEVICE, to_the_bit
from support.drawn import Drawn

from oimppi_warp.config.overrides import set_option
from oimppi_warp.config.presets import best
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError, SceneError
from oimppi_warp.geometry.kinematics import tip_frame, tip_jacobian
from oimppi_warp.observation import planar_pose, planar_transform
from oimppi_warp.record.log import EpisodeLog, LogError
from oimppi_warp.runtime.episode import Episode
from oimppi_warp.runtime.setup import Setup
from oimppi_warp.usd import load_scene
from oimppi_warp.usd.editing import save_scene
from oimppi_warp.view.canvas import LEGEND, Canvas
from oimppi_warp.view.export import export, rows_of
from oimppi_warp.view.picture import Picture
from oimppi_warp.view.replay import Replay
from oimppi_warp.view.session import SAMPLED, Session


def small(samples: int = 64) -> Config:
    config = best("cloi")
    for level in ("robot", "object"):
        config = set_option(config, f"{level}.optimizer.samples={samples}")
    return config


def setup(**fields) -> Setup:
    given = Setup(load_scene("task02"), small(), RunSpec(engine="quasistatic", device=DEVICE, threads=1))
    return given.changed(**fields)


def until(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came to that"
        time.sleep(0.01)


@pytest.fixture
def session():
    made = Session(setup(), speed=np.inf)
    made.start()
    yield made
    made.close()


def test_the_arm_moves_and_pause_holds_it(session):
    until(lambda: session.latest.time > 0.5)
    session.paused = True
    until(lambda: session.latest.status == "paused")
    time.sleep(0.1)  # the last step may have been told of the pause already
    picture, held = session.latest, session.latest.time
    time.sleep(0.3)
    assert session.latest is picture, "the browser would draw it again and again"
    session.step()
    until(lambda: session.latest.time > held)
    until(lambda: session.latest.status == "paused")
    assert session.latest.time == pytest.approx(held + 0.05)


def test_sampled_paths_are_made_when_somebody_looks(session):
    until(lambda: session.latest.time > 0.2)
    assert not session.latest.sampled.size
    session.watched = True
    until(lambda: session.latest.sampled.size)
    picture = session.latest
    assert picture.sampled.shape == (SAMPLED, session.wanted.config.robot.optimizer.horizon + 1, 3)
    assert picture.weights[0] == pytest.approx(1.0)
    assert np.all(np.diff(picture.weights[: SAMPLED // 2]) <= 0)
    np.testing.assert_allclose(picture.sampled[:, 0], picture.sampled[:1, 0].repeat(SAMPLED, 0), atol=1e-6)
    assert picture.terms


def test_another_goal_changes_the_plan_and_things_go_on_from_where_they_are(session):
    until(lambda: session.latest.time > 0.5)
    session.paused = True  # without a limit of speed, the object may be at the first goal before the planner is ready
    until(lambda: session.latest.status == "paused")
    before = session.latest
    goal = (0.5, -0.4, 0.0)
    session.change(scene=session.wanted.scene.with_goal(goal))
    until(lambda: session.latest.scene.goal == goal)
    assert session.latest.time == pytest.approx(before.time)
    np.testing.assert_allclose(session.latest.object_transform, before.object_transform, atol=1e-6)
    session.paused = False

    def leads_there():
        way = session.latest.reference
        return len(way) and np.linalg.norm(way[-1, :2] - goal[:2]) < np.linalg.norm(way[0, :2] - goal[:2]) - 0.05

    until(leads_there)
    assert session.latest.time > before.time


def test_a_changed_weight_reaches_the_planner_and_a_bad_one_is_reported(session):
    config = set_option(session.wanted.config, "cost.w_align=7")
    session.change(config=config)
    until(lambda: session._episode.config.cost.w_align == 7.0)
    session.change(scene=session.wanted.scene.with_goal((3.0, 0.0, 0.0)))
    until(lambda: "not wholly on the table" in session.problem)
    time.sleep(0.1)
    assert session._episode.config.cost.w_align == 7.0


def test_the_object_can_be_moved_and_knocked_at(session):
    session.paused = True
    until(lambda: session.latest.status == "paused")
    session.move_object((0.35, 0.4, 1.0))
    until(lambda: np.allclose(planar_pose(session.latest.object_transform), (0.35, 0.4, 1.0), atol=1e-6))
    mass = session.wanted.scene.object.mass
    session.knock(np.array([0.0, 0.5 * mass, 0.0]))
    for _ in range(6):
        now = session.latest.time
        session.step()
        until(lambda now=now: session.latest.time > now)
    moved = planar_pose(session.latest.object_transform) - np.array([0.35, 0.4, 1.0])
    assert 0.005 < moved[1] < 0.1
    assert abs(moved[0]) < 0.01


def test_reset_begins_again_from_the_start(session):
    until(lambda: session.latest.time > 1.0)
    session.restart()
    until(lambda: session.latest.time < 0.5)
    x, y, _ = planar_pose(session.latest.object_transform)
    assert np.hypot(x - session.wanted.scene.start[0], y - session.wanted.scene.start[1]) < 0.05


def test_a_lab_is_looked_at_too():
    made = Session(setup(plant="lab"), speed=np.inf)
    made.start()
    try:
        until(lambda: made.latest.time > 1.5)
        made.change(scene=made.wanted.scene.with_goal((0.3, -0.35, 0.0)))
        until(lambda: made.latest.scene.goal == (0.3, -0.35, 0.0))
    finally:
        made.close()


@to_the_bit
def test_in_lock_step_an_episode_is_the_same_whether_it_is_looked_at_or_not():
    config = replace(small(), episode=replace(small().episode, max_sim_seconds=1.0))
    alone = setup(config=config).episode().run()
    made = Session(setup(config=config), speed=np.inf)
    made.watched = True
    made.start()
    try:
        until(lambda: made._over)
        np.testing.assert_array_equal(made._episode.log["object_pose"], alone["object_pose"])
        np.testing.assert_array_equal(made._episode.log["command"], alone["command"])
    finally:
        made.close()


def test_a_scene_is_saved_as_it_stands(tmp_path):
    scene = load_scene("task02")
    obstacle = scene.obstacles[0]
    moved = scene.with_goal((0.5, 0.2, 1.0)).with_start((0.3, -0.4, 0.5))
    moved = moved.with_obstacle_moved(obstacle.path, (0.05, -0.1, 0.3))
    held = Usd.Stage.Open(str(scene.file))
    file = save_scene(moved, tmp_path / "mine.usda")
    again = load_scene(file)
    np.testing.assert_allclose(again.goal, (0.5, 0.2, 1.0), atol=1e-9)
    np.testing.assert_allclose(again.start, (0.3, -0.4, 0.5), atol=1e-6)
    shift = again.obstacles[0].colliders[0].transform[:3] - obstacle.colliders[0].transform[:3]
    np.testing.assert_allclose(shift, (0.05, -0.1, 0.0), atol=1e-9)
    assert again.object.mass == scene.object.mass
    assert held and load_scene("task02").start == scene.start  # the shared layers of the first are as they were
    with pytest.raises(SceneError, match="not a valid name for a scene"):
        save_scene(scene, tmp_path / "mine.txt")


@pytest.mark.parametrize(("x", "gap"), [(0.30, 0.05), (0.27, 0.08), (0.78, 0.13)])
def test_a_line_shows_the_clearance_of_the_object(x, gap):
    """The bar of the T reaches 0.1 m to both sides, the cube stands at 0.45 to 0.55 m."""
    display, scene = Drawn(), load_scene("task02")
    at = planar_transform((x, 0.05, 0.0), scene.object.rest_height)
    Canvas(display).draw(Picture(scene, 0.0, scene.robot.start, at))
    (line,) = display.segments["clearance"]
    assert np.linalg.norm(line[1] - line[0]) == pytest.approx(gap, abs=1e-6)
    assert line[0, 2] > scene.object.rest_height


def test_the_legend_names_every_colour(session):
    session.watched = True
    until(lambda: session.latest.sampled.size)
    picture, display = session.latest, Drawn()
    Canvas(display).draw(replace(picture, weights=np.arange(len(picture.weights)) % 2.0))
    assert display.colors == {color for color, _ in LEGEND}


def test_what_the_safety_filter_keeps_apart_is_drawn_and_said(session, monkeypatch):
    """A planner that leads the tool into the table."""
    planner, robot = session.running.planner, session.running.scene.robot
    plan, jacobian = planner.plan, tip_jacobian(robot, robot.start)
    down = np.linalg.pinv(jacobian) @ np.array([0.0, 0.0, -0.2, 0.0, 0.0, 0.0])
    monkeypatch.setattr(planner, "plan", lambda seen: replace(plan(seen), command=down))
    until(lambda: len(session.latest.kept_apart))
    picture = session.latest
    assert picture.status.startswith("the safety filter changed") and "the tool and the table" in picture.status
    display = Drawn()
    Canvas(display).draw(picture)
    drawn = display.segments["kept_apart"]
    line = drawn[drawn[:, 0, 2] > -0.5][0]
    assert abs(line[0, 2]) < 0.1 and line[1, 2] == pytest.approx(0.0, abs=1e-6), "from the tool down to the table"
    np.testing.assert_allclose(line[0, :2], tip_frame(robot, picture.joints)[1][:2], atol=0.03)


@pytest.fixture(scope="module")
def record(tmp_path_factory, device):
    folder = tmp_path_factory.mktemp("record")
    config = replace(small(), episode=replace(small().episode, max_sim_seconds=1.0))
    scene = load_scene("task02")
    log = Episode(scene, config, method="cloi", engine="quasistatic", device=device).run()
    log.save(folder)
    return folder


def test_a_record_is_replayed_as_it_was(record):
    replay, log = Replay(record), EpisodeLog.load(record)
    assert len(replay) == 20
    picture = replay.picture(7)
    assert picture.time == log["time"][7]
    np.testing.assert_array_equal(picture.joints, log["joint_position"][7])
    np.testing.assert_allclose(planar_pose(picture.object_transform), log["object_pose"][7], atol=1e-9)
    assert picture.figures["position error [m]"] == log["position_error"][7]
    assert set(picture.terms) <= set(log.header["cost_terms"]) and picture.terms
    assert rows_of(replay)[-1] == 19


def test_a_page_has_everything_in_it(record):
    page = export(record, "html").read_text()
    assert "__VISER_EMBED_DATA__" in page
    assert len(page) > 500_000


def test_a_usd_animation_moves_the_object_and_the_arm(record, tmp_path):
    file = export(record, "usd", tmp_path / "episode.usda")
    stage = Usd.Stage.Open(str(file))
    assert stage.GetTimeCodesPerSecond() == 20
    assert stage.GetEndTimeCode() - stage.GetStartTimeCode() >= 18
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    animated = [p for p in stage.Traverse() if any(a.GetNumTimeSamples() > 5 for a in p.GetAttributes())]
    assert len(animated) > 10


def test_a_video_has_a_frame_for_each_step(record):
    av = pytest.importorskip("av")
    with av.open(str(export(record, "mp4"))) as video:
        assert sum(1 for _ in video.decode(video=0)) == len(rows_of(Replay(record)))


def test_a_folder_without_a_record_and_a_place_that_cannot_be_written_are_refused(record, tmp_path):
    with pytest.raises(LogError, match="no complete record"):
        export(tmp_path, "html")
    with pytest.raises(ConfigError, match="cannot be written"):
        export(record, "html", tmp_path)
    with pytest.raises(ConfigError, match="USD file"):
        export(record, "usd", tmp_path / "a.txt")

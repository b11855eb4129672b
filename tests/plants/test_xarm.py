"""The plant ``xarm`` on an emulated controller: the vendor's SDK, its checks, its start, and what stops it."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest
from support import small_tasks
from support.emulated_lab import (
    COMMAND_PORT,
    POSE_PORT,
    Cable,
    OtherClient,
    connected,
    emulated,
)
from support.pushing import REST, TURN, Pushing, Repeats, begun, speed, stops, time_to_rest, wait_until

from oimppi_warp.config.presets import lab
from oimppi_warp.errors import ConfigError, HardwareError
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.observation import planar_transform
from oimppi_warp.physics.world import World
from oimppi_warp.plants.drive import Drive
from oimppi_warp.plants.real import start
from oimppi_warp.plants.real.known import allowed_speed, remember
from oimppi_warp.plants.real.start_move import StartMove
from oimppi_warp.plants.xarm import arm as xarm_arm
from oimppi_warp.plants.xarm.arm import XArm, check_facts
from oimppi_warp.plants.xarm.emulator import LabEmulator
from oimppi_warp.plants.xarm.plant import XArmPlant
from oimppi_warp.plants.xarm.protocol import Register
from oimppi_warp.runtime.control import real_time
from oimppi_warp.runtime.estimator import Estimator
from oimppi_warp.runtime.watch import Watch

pytestmark = pytest.mark.realtime


@pytest.fixture
def made() -> Iterator[LabEmulator]:
    with emulated() as lab_made:
        yield lab_made


def test_the_arm_goes_to_its_start_and_follows_commands_at_their_pace(made):
    away = np.array([0.2, -0.1, -0.1, 0.0, 0.1, 0.0])
    scene = small_tasks.shipped("lab01")
    with emulated(joints=scene.robot.start + away) as other, connected(other.host) as plant:
        assert np.abs(other.state()[0] - scene.robot.start).max() < 0.02
        before = plant.observe()
        for _ in range(10):
            plant.apply(TURN)
            time.sleep(plant.control_period)
        seen = plant.observe()
        assert seen.joint_velocity[0] == pytest.approx(0.2, abs=0.03)
        assert seen.joint_position[0] > before.joint_position[0] + 0.05
        assert len(seen.trail) / np.ptp(seen.trail[:, 0]) == pytest.approx(100.0, abs=15.0), "reports at 100 Hz"
        assert seen.object_pose == pytest.approx(other.state()[2], abs=1e-4)
        assert 0.0 <= plant.now - seen.object_time < 1.0
        assert not plant.fault
    assert time_to_rest(other) < REST
    assert other.controller.snapshot().state == 4


def test_nothing_moves_without_a_yes(made, monkeypatch):
    asked = []
    monkeypatch.setattr(start, "_ask", lambda question: asked.append(question))
    with pytest.raises(HardwareError, match="--yes"), connected(made.host, yes=False):
        pass
    assert "100 % of the usual speed" in asked[0]
    assert not made.controller.snapshot().enabled
    assert made.controller.moves == 0


def test_what_happens_while_the_question_waits_is_looked_at_again(made, monkeypatch):
    def answer(_question: str) -> bool:
        made.controller.raise_error(23)
        return True

    monkeypatch.setattr(start, "_ask", answer)
    with pytest.raises(HardwareError, match="C23"), connected(made.host, yes=False):
        pass
    assert made.controller.moves == 0


def test_an_arm_that_was_moved_while_the_question_waited_goes_from_where_it_is(monkeypatch):
    scene = small_tasks.shipped("lab01")
    with emulated(joints=scene.robot.start + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])) as other:
        fastest: list[float] = []

        def answer(_question: str) -> bool:
            with other._lock:
                place = planar_transform(scene.start, scene.object.rest_height)
                other.plant.place(scene.robot.start + np.array([-0.3, 0.0, 0.0, 0.0, 0.0, 0.0]), place)
            time.sleep(0.5)
            threading.Thread(target=watch, daemon=True).start()
            return True

        def watch() -> None:
            while other.running:
                fastest.append(speed(other))
                time.sleep(0.005)

        monkeypatch.setattr(start, "_ask", answer)
        with connected(other.host, yes=False):
            assert np.abs(other.state()[0] - scene.robot.start).max() < 0.02
        assert 0.1 < max(fastest) < 1.3 * start._SPEED


def test_manual_mode_is_left_by_a_person_only(made):
    with connected(made.host) as plant:
        client = OtherClient(made.host)
        client.command(Register.SET_MODE, b"\x02\x00")
        wait_until(lambda: plant.arm.facts().mode == 2)
        with pytest.raises(HardwareError, match="manual mode"):
            plant.recover()
        assert made.controller.snapshot().mode == 2
        client.close()


def test_a_dry_run_enables_nothing(made):
    with connected(made.host, dry_run=True) as plant, Pushing(plant) as pushing:
        wait_until(lambda: len(pushing.steps) > 10)
        assert pushing.steps[-1].plan is not None
        assert pushing.steps[-1].command[0] == pytest.approx(0.2)
    assert not made.controller.snapshot().enabled
    assert made.controller.moves == made.controller.refused == 0


def test_the_way_to_the_start_is_checked():
    scene = small_tasks.shipped("lab01")
    start, away = scene.robot.start, StartMove(World(scene))
    far, near = np.array([0.3, -0.4, 0.0]), np.array([*tip_frame(scene.robot, start)[1][:2], 0.0])
    beside = start + np.array([0.9, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert len(away.path(beside, start, far)) == 2, "a straight way"
    half = start + np.array([0.45, 0.0, 0.0, 0.0, 0.0, 0.0])
    between = np.array([*tip_frame(scene.robot, half)[1][:2], 0.0])
    around = away.path(beside, start, between)
    assert len(around) > 2, "the tool is lifted over the object"
    assert min(min(away.clearance(joints, between)) for joints in around) > 0.0
    with pytest.raises(HardwareError, match="touches the object at its start"):
        away.path(beside, start, near)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"axes": 5}, "5 joints"),
        ({"firmware": (1, 7, 0)}, "firmware 1.7.0"),
        ({"error": 31}, "C31"),
        ({"mode": 2}, "manual"),
        ({"joints": np.full(7, 7.0)}, "joint 2"),
        ({"report_rate": 5.0}, "5 Hz"),
        ({"round_trip": 0.2}, "200.0 ms"),
    ],
)
def test_a_controller_that_is_not_as_needed_is_refused(facts, change, what):
    robot = small_tasks.shipped("lab01").robot
    assert all(check.good or not check.needed for check in check_facts(facts, robot))
    bad = [check for check in check_facts(replace(facts, **change), robot) if not check.good]
    assert bad
    assert all(check.remedy for check in bad)
    assert any(what in check.what and check.needed for check in bad)


@pytest.fixture(scope="module")
def facts():
    with emulated() as lab_made:
        arm = XArm(f"{lab_made.host}:{COMMAND_PORT}")
        yield arm.facts()
        arm.disconnect()


@pytest.mark.parametrize("change", [{"load": 0.0}, {"sensitivity": 0}, {"report_rate": 80.0}, {"round_trip": 0.05}])
def test_what_is_only_an_advice(facts, change):
    checks = check_facts(replace(facts, **change), small_tasks.shipped("lab01").robot)
    assert not any(check.needed for check in checks if not check.good)
    assert not all(check.good for check in checks)


def test_an_address_without_a_controller():
    with pytest.raises(HardwareError, match="no xArm controller"), connected("127.0.0.1"):
        pass
    with pytest.raises(ConfigError, match="--robot-address"):
        XArmPlant(small_tasks.shipped("lab01"), lab())


def test_no_poses_no_start(made, monkeypatch):
    monkeypatch.setattr(start, "FIRST_POSE", 0.5)
    with pytest.raises(HardwareError, match="cannot be received"), connected(made.host, pose_address="127.0.0.1:9"):
        pass


def test_an_arm_that_hides_the_object_lifts_its_tool_first(made):
    made.seeing = False
    made.poses.publish(np.array([0.4, 0.0, 0.0]), time.time())
    made.poses.publish(np.array([0.5, 0.1, 0.0]), time.time())
    heights: list[float] = []

    def see_once_lifted() -> None:
        robot = small_tasks.shipped("lab01").robot
        while not heights or heights[-1] < heights[0] + 0.1:
            heights.append(float(tip_frame(robot, made.state()[0])[1][2]))
            time.sleep(0.02)
        made.seeing = True

    watching = threading.Thread(target=see_once_lifted)
    watching.start()
    with connected(made.host) as plant:
        watching.join()
        assert not plant.fault
        assert np.abs(made.state()[0] - small_tasks.shipped("lab01").robot.start).max() < 0.02


def test_the_first_run_at_a_new_address_is_slow(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    new, here = (SimpleNamespace(place=host, simulated=host == "127.0.0.2") for host in ("192.168.1.7", "127.0.0.2"))
    assert allowed_speed(new, 0.0) == 0.1
    assert allowed_speed(new, 0.5) == 0.1
    assert "192.168.1.7 is new here" in capsys.readouterr().err
    assert allowed_speed(new, 0.05) == 0.05
    remember(new)  # after a run of some length without a fault
    assert allowed_speed(new, 0.0) == 1.0
    assert allowed_speed(here, 0.0) == 1.0


def test_a_lower_speed_scales_what_plans_may_do(made):
    with connected(made.host, speed=0.5, dry_run=True) as plant:
        usual, slow = lab(), plant.limited(lab())
    assert slow.robot.tip_speed_limit == 0.5 * usual.robot.tip_speed_limit
    assert slow.robot.joint_velocity_limit == 0.5 * usual.robot.joint_velocity_limit
    assert slow.object.speed_limit == tuple(0.5 * np.array(usual.object.speed_limit))
    assert slow.episode.max_sim_seconds == 2.0 * usual.episode.max_sim_seconds


def test_a_command_that_is_not_followed_by_another_expires(made):
    with connected(made.host) as plant:
        plant.apply(TURN)
        wait_until(lambda: speed(made) > 0.1)
        assert time_to_rest(made) < REST
        assert not plant.fault, "nothing is wrong with an arm that has nothing to do"


def test_a_planner_that_is_killed(made):
    code = (
        "import sys, time, numpy as np; sys.path.insert(0, 'tests')\n"
        "from support.emulated_lab import connected\n"
        "with connected(sys.argv[1]) as plant:\n"
        "    print('moving', flush=True)\n"
        "    while True:\n"
        "        plant.apply(np.array([0.2, 0, 0, 0, 0, 0.0])); time.sleep(plant.control_period)\n"
    )
    planner = subprocess.Popen([sys.executable, "-c", code, made.host], stdout=subprocess.PIPE, text=True)
    assert planner.stdout is not None
    assert "moving" in planner.stdout.readline()
    wait_until(lambda: speed(made) > 0.15)
    planner.kill()
    assert time_to_rest(made) < REST
    planner.wait()


def test_a_connection_that_is_cut(made):
    cable = Cable(made.host)
    with connected(cable.host) as plant, Pushing(plant) as pushing:
        begun(made)
        cable.cut = True
        stops(made, pushing, "joint report")
    cable.close()


def test_an_error_of_the_controller(made):
    with connected(made.host, resume=True) as plant, Pushing(plant) as pushing:
        begun(made)
        pushing.watch.attended = True
        made.controller.raise_error(31)
        stops(made, pushing, "C31: a collision was detected")
        time.sleep(1.5)
        assert made.controller.snapshot().error == 31, "it is never cleared from here"
        assert speed(made) < 1e-3
        OtherClient(made.host).command(Register.CLEAR_ERROR)
        time.sleep(1.5)
        assert speed(made) < 1e-3, "nobody has asked to go on"
        pushing.watch.go_on()
        wait_until(lambda: speed(made) > 0.1)
        assert pushing.said[-1] == "the arm goes on"


def test_joint_reports_that_are_frozen(made):
    with connected(made.host) as plant, Pushing(plant) as pushing:
        begun(made)
        made.server.frozen = True
        stops(made, pushing, "do not change")


def test_a_second_client_that_changes_the_mode(made):
    with connected(made.host) as plant, Pushing(plant) as pushing:
        begun(made)
        other = OtherClient(made.host)
        other.command(Register.SET_MODE, b"\0\0")
        stops(made, pushing, "another program")
        other.close()


def test_a_second_client_that_moves_the_arm(made):
    with connected(made.host) as plant:
        plant.apply(np.zeros(6))
        other = OtherClient(made.host)
        began = time.monotonic()
        while not plant.fault and time.monotonic() < began + 3.0:
            plant.apply(np.zeros(6))
            for _ in range(5):
                other.move(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.6]))
                time.sleep(0.01)
        assert "another program" in plant.fault
        other.close()
        assert time_to_rest(made) < REST


def test_a_torque_above_its_bound(made, monkeypatch):
    with connected(made.host) as plant, Pushing(plant) as pushing:
        begun(made)
        monkeypatch.setattr(xarm_arm, "TORQUES", np.full(7, 1.0))
        stops(made, pushing, "N m")


def test_perception_that_is_lost(made):
    with connected(made.host, pose_timeout=0.5) as plant, Pushing(plant) as pushing:
        begun(made)
        made.seeing = False
        wait_until(lambda: bool(pushing.said))
        assert time_to_rest(made) < REST
        assert "pose of the object" in pushing.said[0]
        assert "the run ends" in pushing.said[0]
        assert pushing.watch.given_up


def test_perception_that_comes_back(made):
    with connected(made.host, pose_timeout=0.5, resume=True) as plant, Pushing(plant) as pushing:
        begun(made)
        made.seeing = False
        wait_until(lambda: bool(pushing.said))
        time_to_rest(made)
        made.seeing = True
        wait_until(lambda: speed(made) > 0.1)
        assert pushing.said[-1] == "the arm goes on"
        assert pushing.watch.stops == 1


@pytest.mark.parametrize("hours", [-1.0, 1.0])
def test_a_camera_whose_clock_is_wrong(made, hours):
    with connected(made.host) as plant, Pushing(plant) as pushing:
        begun(made)
        made.clock_error = 3600.0 * hours
        wait_until(lambda: bool(pushing.said))
        assert time_to_rest(made) < REST
        assert "NTP" in pushing.said[0]


def test_a_detection_that_jumps(made):
    with connected(made.host) as plant, Pushing(plant) as pushing:
        begun(made)
        made.shift = np.array([0.0, 0.3, 0.0])
        wait_until(lambda: bool(pushing.said))
        assert time_to_rest(made) < REST
        assert "0.30 m from where it is believed" in pushing.said[0]


def test_a_viewer_that_hangs(made):
    with connected(made.host) as plant, Pushing(plant) as pushing:
        begun(made)
        count, pushing.stuck = len(pushing.steps), 1.0
        wait_until(lambda: pushing.stuck == 0.0 or len(pushing.steps) > count)
        assert time_to_rest(made) < REST
        assert not plant.fault


def test_poses_are_lost_and_found_again(made):
    with connected(made.host, dry_run=True) as plant:
        made.poses.close()
        wait_until(lambda: "closed the connection" in plant.blind or "cannot be received" in plant.blind)
        from oimppi_warp.perception.pose_feed import PoseServer

        server = PoseServer(made.host, POSE_PORT)
        made.poses = server
        wait_until(lambda: not plant.blind)


def test_the_first_steps_of_a_loop(made):
    """The loop itself, without a thread: its first observation has a pose, and nothing is stopped."""
    scene, config = small_tasks.shipped("lab01"), lab()
    with connected(made.host) as plant:
        drive = Drive(plant, 6, config.safety)
        watch = Watch(plant)
        steps = real_time(drive, Repeats(TURN), Estimator(scene, config), dof=6, expires=0.25, watch=watch)
        for step in islice(steps, 5):
            assert not step.halted
        steps.close()

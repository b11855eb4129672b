"""The plant ``ros2`` on a simulated lab: topics, frames, what is refused, and what stops the arm."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support import fake_rclpy, small_tasks
from support.pushing import REST, TURN, Pushing, begun, speed, stops, time_to_rest, wait_until
from support.ros2_lab import HERE, connected, new_domain, other_node, simulated

from oimppi_warp.cli.main import main
from oimppi_warp.config import ros2_topics
from oimppi_warp.config.presets import lab
from oimppi_warp.errors import ConfigError, HardwareError
from oimppi_warp.perception.pose_source import StampedPose
from oimppi_warp.plants.ros2 import messages
from oimppi_warp.plants.ros2 import plant as ros2_plant
from oimppi_warp.plants.ros2.arm import WATCHDOG
from oimppi_warp.plants.ros2.lab import Ros2Lab
from oimppi_warp.plants.ros2.link import Endpoint, Qos, why_no_messages, why_nobody_listens
from oimppi_warp.plants.ros2.messages import header
from oimppi_warp.plants.ros2.plant import Ros2Plant
from oimppi_warp.plants.ros2.poses import Ros2Poses
from oimppi_warp.plants.ros2.rclpy_link import RclpyLink

pytestmark = pytest.mark.realtime
COMMANDS = ros2_topics.NOMINAL_COMMANDS


@pytest.fixture
def made() -> Iterator[Ros2Lab]:
    with simulated() as lab_made:
        yield lab_made


def joint_state(names: list[str], positions: list[float]) -> SimpleNamespace:
    """A joint state without a stamp."""
    head = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")
    return SimpleNamespace(name=names, position=positions, header=head)


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        (COMMANDS, messages.NUMBERS),
        (f"{COMMANDS}/joint_jog", messages.JOINT_JOG),
        (f"{COMMANDS}/joint_trajectory", messages.TRAJECTORY),
    ],
)
def test_the_arm_goes_to_its_start_and_follows_commands_of_every_type(topic, kind):
    scene = small_tasks.shipped("lab01")
    away = scene.robot.start + np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    with simulated(joints=away) as made, connected(made, commands=topic, command_type=kind) as plant:
        assert np.abs(made.state()[0] - scene.robot.start).max() < 0.02
        before = plant.observe()
        for _ in range(10):
            plant.apply(TURN)
            time.sleep(plant.control_period)
        seen = plant.observe()
        assert seen.joint_velocity[0] == pytest.approx(0.2, abs=0.04)
        assert seen.joint_position[0] > before.joint_position[0] + 0.05
        assert seen.object_pose == pytest.approx(made.state()[2], abs=1e-4)
        assert 0.0 <= plant.now - seen.object_time < 1.0
        assert not plant.fault
        plant.close()
        wait_until(lambda: speed(made) < 1e-3)


def test_joints_are_found_by_name_in_any_order(made):
    with connected(made) as plant:
        order = [3, 0, 5, 1, 4, 2]
        made.frozen = True
        time.sleep(0.05)
        moved = made.state()[0] + 0.004 * np.arange(6)
        names = ["gripper", *(made.names[i] for i in order)]
        plant.arm._take(joint_state(names, [9.0, *(moved[i] for i in order)]))
        assert plant.joints() == pytest.approx(moved)
        plant.arm._take(joint_state(["gripper", "joint1"], [1.0, 2.0]))
        plant.arm._take(joint_state(["gripper"], [1.0]))
        assert plant.joints() == pytest.approx(moved), "some of the joints only"
        assert not plant.arm.fault(1, moving=False)


def test_wrong_joint_names_are_told():
    with simulated(joint_names=[f"xarm_joint{i}" for i in range(1, 7)]) as made:
        with pytest.raises(HardwareError) as caught, connected(made):
            pass
        assert "has the joints xarm_joint1" in str(caught.value)
        assert "joint_names=xarm_joint1,xarm_joint2" in str(caught.value)


def test_a_planner_that_is_killed(made):
    code = (
        "import sys, time, numpy as np; sys.path.insert(0, 'tests')\n"
        "from types import SimpleNamespace\n"
        "from support.ros2_lab import connected\n"
        "with connected(SimpleNamespace(domain=int(sys.argv[1]))) as plant:\n"
        "    print('moving', flush=True)\n"
        "    while True:\n"
        "        plant.apply(np.array([0.2, 0, 0, 0, 0, 0.0])); time.sleep(plant.control_period)\n"
    )
    planner = subprocess.Popen([sys.executable, "-c", code, str(made.domain)], stdout=subprocess.PIPE, text=True)
    assert planner.stdout is not None
    assert "moving" in planner.stdout.readline()
    wait_until(lambda: speed(made) > 0.15)
    planner.kill()
    assert time_to_rest(made) < REST
    assert made.expired == 1, "the watchdog of the receiver"
    planner.wait()


def test_an_arm_whose_joint_states_cease(made):
    with connected(made) as plant, Pushing(plant) as pushing:
        begun(made)
        made.frozen = True
        stops(made, pushing, "joint report")


def test_an_arm_that_is_gone(made):
    with connected(made) as plant, Pushing(plant) as pushing:
        begun(made)
        made.close()
        wait_until(lambda: bool(pushing.said))
        assert "joint report" in pushing.said[0] or "nothing listens" in pushing.said[0]


@pytest.mark.parametrize(("error", "words"), [(-1.0, "old by their stamps"), (1.0, "in the future by their stamps")])
def test_joint_states_with_wrong_stamps(made, error, words):
    with connected(made) as plant, Pushing(plant) as pushing:
        begun(made)
        made.stamp_error = error
        stops(made, pushing, words)


def test_joint_states_that_are_not_numbers(made):
    with connected(made) as plant, Pushing(plant) as pushing:
        begun(made)
        plant.arm._take(joint_state(made.names, [math.nan] * 6))
        stops(made, pushing, "not finite")


def test_a_second_commander(made):
    with connected(made) as plant, Pushing(plant) as pushing, other_node(made.domain) as node:
        begun(made)
        node.advertise(COMMANDS, messages.NUMBERS)
        stops(made, pushing, "another program publishes")
        with pytest.raises(HardwareError, match="another program publishes"):
            plant.recover()


def test_the_end_of_a_run_needs_no_watchdog(made):
    made.watchdog = math.inf
    plant = Ros2Plant(small_tasks.shipped("lab01"), lab(), domain=made.domain, peers=HERE, yes=True)
    plant.apply(TURN)
    wait_until(lambda: speed(made) > 0.1)
    zeros: list[float] = []
    with other_node(made.domain) as node:
        node.subscribe(COMMANDS, messages.NUMBERS, lambda message: zeros.append(max(map(abs, message.data))))
        wait_until(lambda: any(not end.own and not end.publishes for end in node.endpoints(COMMANDS)))
        plant.apply(TURN)
        plant.close()
        assert time_to_rest(made) < REST
        wait_until(lambda: len(zeros) > 10)
        assert zeros[-10:] == [0.0] * 10, "one zero could be lost"


def test_a_stop_needs_no_watchdog(made):
    with connected(made) as plant, Pushing(plant) as pushing:
        begun(made)
        made.watchdog = math.inf
        made.stamp_error = 1.0
        stops(made, pushing, "in the future")


def test_trajectories_end_at_rest_and_never_lead_back(made):
    made.watchdog = math.inf
    topic = f"{COMMANDS}/joint_trajectory"
    with connected(made, commands=topic, command_type=messages.TRAJECTORY) as plant, Pushing(plant) as pushing:
        begun(made)
        lowest = made.state()[1][0]
        made.frozen = True
        until = time.monotonic() + 1.0
        while time.monotonic() < until:
            lowest = min(lowest, made.state()[1][0])
            time.sleep(0.002)
        assert speed(made) < 1e-3
        assert lowest > -0.05, "joint states that are old lead the arm back"
        assert "joint report" in pushing.said[0]


def test_a_loop_that_hangs_is_no_fault_of_the_arm(made):
    with connected(made, resume=True) as plant, Pushing(plant) as pushing:
        begun(made)
        pushing.stuck = 1.0
        wait_until(lambda: speed(made) < 1e-3)
        wait_until(lambda: speed(made) > 0.1)
        time.sleep(1.0)
        assert not pushing.said


def test_joint_states_that_come_again_with_a_fresh_stamp(made):
    with connected(made) as plant, Pushing(plant) as pushing:
        begun(made)
        made.frozen = True
        time.sleep(0.02)
        joints = plant.joints().tolist()
        until = time.monotonic() + 1.0
        while time.monotonic() < until and not pushing.said:
            plant.arm._take(joint_state(made.names, joints))
            time.sleep(0.01)
        assert "do not change" in pushing.said[0]


def test_two_sources_of_joint_states(made):
    with connected(made) as plant, Pushing(plant) as pushing, other_node(made.domain) as node:
        begun(made)
        publish = node.advertise(ros2_topics.JOINT_STATES, messages.JOINT_STATE)
        elsewhere = {"name": made.names, "position": [0.3] * 6}
        until = time.monotonic() + 5.0
        while not pushing.said and time.monotonic() < until:
            publish(elsewhere)
            time.sleep(0.01)
        assert "more than one program" in pushing.said[0]
        assert time_to_rest(made) < REST


def test_joint_states_that_are_late_count_from_when_they_were_true(made):
    with connected(made) as plant:
        made.stamp_error = -0.1
        time.sleep(0.3)
        assert time.monotonic() - plant.arm.reports.latest()[0] > 0.1


def test_commands_beyond_a_limit_are_not_sent(made):
    with connected(made) as plant:
        plant.apply(np.full(6, 10.0))
        wait_until(lambda: bool(plant.fault))
        assert "at most" in plant.fault
        plant.recover()
        plant._limits[1, 0] = made.state()[0][0] + 0.01
        plant.apply(TURN)
        wait_until(lambda: bool(plant.fault))
        assert "beyond its limits" in plant.fault
        config = lab()
        with pytest.raises(ConfigError, match="with the filter only"):
            plant.limited(replace(config, safety=replace(config.safety, filter=False)))


def test_the_first_run_of_an_arm_that_is_not_simulated_is_slow(made, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with connected(made) as plant:
        assert plant.speed == 1.0
        assert "can stop the arm" not in capsys.readouterr().err
    monkeypatch.setattr("oimppi_warp.plants.ros2.lab.SIMULATED", "")
    with connected(made) as plant:
        assert plant.speed == 0.1
        assert "only what receives" in capsys.readouterr().err


def test_time_of_a_simulation(made):
    with connected(made, use_sim_time=True) as plant:
        assert plant.observe().object_pose == pytest.approx(made.state()[2], abs=1e-4)
    with pytest.raises(HardwareError, match="nothing publishes /clock"):
        Ros2Plant(small_tasks.shipped("lab01"), lab(), domain=new_domain(), peers=HERE, use_sim_time=True)


def test_a_check_does_not_disturb_a_run(made, capsys):
    with connected(made) as plant, Pushing(plant) as pushing:
        begun(made)
        assert main(["ros2", "check", "--plant-options", f"domain={made.domain}", f"peers={HERE}"]) in (0, 1)
        assert "another program publishes" in capsys.readouterr().out, "the run itself"
        assert not pushing.said


def test_a_receiver_that_ends(made):
    with connected(made) as plant, Pushing(plant) as pushing:
        begun(made)
        command = next(reader for reader, _ in made._link._readers if reader.topic.name == f"rt{COMMANDS}")
        command._delete(command._ref)
        stops(made, pushing, "nothing listens")


def test_nothing_on_the_topics():
    scene, domain = small_tasks.shipped("lab01"), new_domain()
    with pytest.raises(HardwareError, match="nothing publishes /joint_states in ROS domain"):
        Ros2Plant(scene, lab(), domain=domain, peers=HERE, yes=True)


def test_the_object_as_a_topic_of_unknown_type(made):
    with connected(made, object=ros2_topics.OBJECT_POSE) as plant:
        assert plant.observe().object_pose == pytest.approx(made.state()[2], abs=1e-4)


def test_a_frame_that_is_missing(made, monkeypatch):
    monkeypatch.setattr(ros2_plant, "_FRAMES", 0.2)
    from oimppi_warp.plants.real import start

    monkeypatch.setattr(start, "FIRST_POSE", 0.5)
    with pytest.raises(HardwareError) as caught, connected(made, object="sam6d_object"):
        pass
    assert "the frame sam6d_object is not connected with world" in str(caught.value)
    assert "fp_object_pose" in str(caught.value), "what there is"


def test_obstacles_are_where_their_frames_are():
    scene = small_tasks.shipped("task02")
    name = scene.obstacles[0].path.rpartition("/")[2]
    with other_node(new_domain()) as node:
        poses = Ros2Poses(node, ros2_topics.OBJECT_FRAME, world="world")
        x, y, z = scene.obstacles[0].center
        poses.tree.take(transforms(("world", "box", (x + 0.02, y - 0.03, z), 0.5)), static=True)
        moves = ros2_plant._moves(scene, {name: "box"}, poses, "world")
        assert moves[scene.obstacles[0].path] == pytest.approx((0.02, -0.03, 0.5), abs=1e-9)
    with pytest.raises(ConfigError, match="the scene has"):
        ros2_plant._obstacle_frames("tower=box", scene)


def transforms(*edges: tuple[str, str, tuple[float, float, float], float], stamp: float = 1.0):
    """A tf2_msgs/msg/TFMessage of frames turned about z."""
    return messages.build(
        messages.TRANSFORMS,
        {
            "transforms": [
                {
                    "header": header(stamp, parent),
                    "child_frame_id": child,
                    "transform": {
                        "translation": dict(zip("xyz", map(float, at), strict=True)),
                        "rotation": {"z": math.sin(0.5 * yaw), "w": math.cos(0.5 * yaw)},
                    },
                }
                for parent, child, at, yaw in edges
            ]
        },
        messages.dds_type,
    )


@pytest.fixture
def poses() -> Iterator[Ros2Poses]:
    with other_node(new_domain()) as node:
        yield Ros2Poses(node, "object", world="world", clock=lambda: 100.0)


def test_frames_are_chained_on_both_sides(poses):
    poses.tree.take(transforms(("map", "world", (1.0, 0.0, 0.0), 0.5 * math.pi)), static=True)
    poses.tree.take(transforms(("map", "camera", (1.0, 0.0, 1.0), 0.0)), static=True)
    poses._take_transforms(transforms(("camera", "object", (0.0, 0.4, -0.9), 0.0), stamp=99.5))
    seen = poses.poses[-1]
    assert seen.pose == pytest.approx([0.4, 0.0, -0.5 * math.pi])
    assert seen.age == pytest.approx(0.5)
    poses._take_transforms(transforms(("camera", "object", (0.0, 0.4, -0.9), 0.0), stamp=99.5))
    assert len(poses.poses) == 1, "repeated until it changes"


def test_frames_in_a_loop(poses):
    poses._take_transforms(transforms(("a", "object", (0.0, 0.0, 0.0), 0.0), ("object", "a", (0.0, 0.0, 0.0), 0.0)))
    assert not poses.poses
    assert "not connected" in poses.problem


def test_a_pose_that_cannot_be_used(poses):
    upside_down = transforms(("world", "object", (0.5, 0.0, 0.0), 0.0))
    upside_down.transforms[0].transform.rotation.x, upside_down.transforms[0].transform.rotation.w = 1.0, 0.0
    poses._take_transforms(upside_down)
    assert "tilted by 180 degrees" in poses.problem
    no_rotation = transforms(("world", "object", (0.5, 0.0, 0.0), 0.0))
    no_rotation.transforms[0].transform.rotation.w = 0.0
    poses._take_transforms(no_rotation)
    assert not poses.poses
    poses.tree.take(transforms(("world", "object", (0.5, 0.0, 0.0), 0.0)), static=True)
    poses._take_transforms(transforms(("world", "other", (0.5, 0.0, 0.0), 0.0)))
    assert "static" in poses.problem
    assert not poses.poses


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (messages.POSE, {"pose": {"position": {"x": 0.5, "y": 0.1}, "orientation": {"w": 1.0}}}),
        (messages.POSE_COVARIANCE, {"pose": {"pose": {"position": {"x": 0.5, "y": 0.1}, "orientation": {"w": 1.0}}}}),
        (messages.DETECTION, {"bbox": {"center": {"position": {"x": 0.5, "y": 0.1}, "orientation": {"w": 1.0}}}}),
        (
            messages.DETECTIONS,
            {
                "detections": [
                    {
                        "results": [
                            {
                                "hypothesis": {"score": 0.9},
                                "pose": {"pose": {"position": {"x": 0.5, "y": 0.1}, "orientation": {"w": 1.0}}},
                            },
                            {"hypothesis": {"score": 0.1}},
                        ]
                    }
                ]
            },
        ),
    ],
)
def test_the_object_in_messages_of_every_type(kind, values):
    with other_node(new_domain()) as node, other_node(node.number) as sender:
        poses = Ros2Poses(node, "/object", kind=kind, world="world", clock=lambda: 100.0)
        publish = sender.advertise("/object", kind)

        def sent() -> bool:
            publish({"header": header(99.0, "world"), **values})
            return bool(poses.poses)

        wait_until(sent)
        assert poses.poses[-1].pose == pytest.approx([0.5, 0.1, 0.0])
        assert poses.poses[-1].age == pytest.approx(1.0)


def test_several_objects():
    at = {"orientation": {"w": 1.0}}
    first = {"id": "mug", "bbox": {"center": {"position": {"x": 0.5, "z": 0.05}, **at}}}
    second = {"id": "can", "bbox": {"center": {"position": {"x": 0.7, "z": 0.05}, **at}}, "results": [{}]}
    values = {"header": header(99.0, "world"), "detections": [first, second]}
    message = messages.build(messages.DETECTIONS, values, messages.dds_type)
    with other_node(new_domain()) as node:
        made_of = {"kind": messages.DETECTIONS, "world": "world", "clock": lambda: 100.0}
        anything = Ros2Poses(node, "/object", **made_of)
        anything._take(message)
        assert "has 2 objects" in anything.problem
        can = Ros2Poses(node, "/object", wanted="can", **made_of)
        can._take(message)
        assert can.poses[-1].pose == pytest.approx([0.7, 0.0, 0.0]), "the box, since the hypothesis has no pose"
        box = Ros2Poses(node, "/object", wanted="box", **made_of)
        box._take(message)
        assert "has no box" in box.problem
        assert "can, mug" in box.problem
        low = Ros2Poses(node, "/object", wanted="can", height=0.0, **made_of)
        low._take(message)
        assert "0.050 m above world" in low.problem


def test_a_pose_in_a_frame_that_nobody_knows():
    with other_node(new_domain()) as node:
        poses = Ros2Poses(node, "/object", kind=messages.POSE, world="world", clock=lambda: 100.0)
        message = messages.build(messages.POSE, {"header": header(99.0, "camera")}, messages.dds_type)
        poses._take(message)
        assert "given in the frame camera" in poses.problem
        assert not poses.poses


def test_an_object_of_a_type_that_cannot_be_read():
    with other_node(new_domain()) as node, other_node(node.number) as sender:
        sender.advertise("/object", messages.NUMBERS)
        poses = Ros2Poses(node, "/object", world="world")
        wait_until(lambda: "is published as std_msgs/msg/Float64MultiArray" in poses.problem)
        with pytest.raises(ConfigError, match="object_type"):
            Ros2Poses(node, "/object", kind=messages.NUMBERS, world="world")


def test_qualities_of_service_that_do_not_match():
    with other_node(new_domain()) as node, other_node(node.number) as other:
        other.advertise("/a", messages.POSE, latched=False)
        node.subscribe("/a", messages.POSE, lambda _: None, latched=True)
        wait_until(lambda: "durability" in why_no_messages(node, "/a", messages.POSE, latched=True))
        other.subscribe("/b", messages.NUMBERS, lambda _: None, latched=True)
        wait_until(lambda: "durability" in why_nobody_listens(node, "/b", messages.NUMBERS, Qos()))
        assert "to do:" in why_nobody_listens(node, "/b", messages.NUMBERS, Qos())
        assert "expects std_msgs" in why_nobody_listens(node, "/b", messages.JOINT_JOG, Qos())
    assert "reliability" in Qos(reliable=False).lacks(Qos(reliable=True))
    assert "deadline" in Qos().lacks(Qos(deadline=0.1))
    assert not Qos(latched=True).lacks(Qos(reliable=False))


def test_the_type_hash_is_told_to_others():
    with other_node(new_domain()) as node, other_node(node.number) as other:
        node.advertise("/a", messages.POSE)
        wait_until(lambda: Endpoint(messages.POSE, Qos(), True, False) in other.endpoints("/a"))
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.qos import Policy

        _, reader, _ = other._discovery[0]
        alive = ReadCondition(reader, InstanceState.Alive | ViewState.Any | SampleState.Any)
        ends = [end for end in reader.read(100, condition=alive) if end.topic_name == "rt/a"]
        data = [policy.data for end in ends for policy in end.qos if isinstance(policy, Policy.Userdata)]
        from cyclonedds.qos import Policy as DdsPolicy

        writer = node._writers["/a", messages.POSE]
        offered = [policy for policy in writer.get_qos() if isinstance(policy, DdsPolicy.DataRepresentation)]
        assert [(each.use_cdrv0_representation, each.use_xcdrv2_representation) for each in offered] == [(True, False)]
        assert data == [f"typehash={messages.type_hash(messages.POSE)};".encode()]


def test_options_that_cannot_be_used():
    scene = small_tasks.shipped("lab01")
    with pytest.raises(ConfigError, match="0 to 232"):
        Ros2Plant(scene, lab(), domain=400, peers=HERE)
    for options, words in (
        ({"joint_names": "a,b"}, "joint_names has 2 names"),
        ({"command_type": "std_msgs/msg/String"}, "command_type"),
        ({"obstacles": "x"}, "obstacles=x"),
    ):
        with pytest.raises(ConfigError, match=words):
            Ros2Plant(scene, lab(), domain=new_domain(), peers=HERE, **options)  # pyright: ignore


def test_the_lab_refuses_what_is_no_command(made):
    made._take([math.nan] * 6)
    made._take([0.1] * 5)
    made._take_jog(SimpleNamespace(joint_names=["a"], velocities=[0.1]))
    made._take_trajectory(SimpleNamespace(joint_names=[], points=[]))
    assert made.refused == 4
    assert made.taken == 0
    assert WATCHDOG == REST


def test_the_same_through_rclpy(monkeypatch):
    fake_rclpy.install(monkeypatch)
    with simulated(link=RclpyLink(7), domain=7) as made, connected(made, domain=7, through="rclpy") as plant:
        assert "ROS domain 7" in plant.arm.address
        with Pushing(plant) as pushing:
            begun(made)
            other = RclpyLink(7)
            other.advertise(COMMANDS, messages.NUMBERS)
            stops(made, pushing, "another program publishes")
            other.close()
    with pytest.raises(ConfigError, match="install the ROS package vision_msgs"):
        RclpyLink(7).advertise("/a", messages.DETECTION)


def test_without_ros_installed():
    with pytest.raises(ConfigError, match="rclpy cannot be imported"):
        RclpyLink()


def test_the_object_from_a_source_in_this_process(made):
    class Camera:
        problem = ""
        closed = False

        @property
        def poses(self) -> list[StampedPose]:
            return [StampedPose(np.array([0.5, 0.2, 0.1]), time.monotonic(), 0.01, time.time() + i) for i in range(2)]

        def close(self) -> None:
            self.closed = True

    camera = Camera()
    with connected(made, poses=camera) as plant:
        assert plant.observe().object_pose == pytest.approx([0.5, 0.2, 0.1])
    assert camera.closed

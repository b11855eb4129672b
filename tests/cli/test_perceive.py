"""The commands `oimppi perceive`: from the sheet and the calibration to poses that are served."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import boards, rendered, small_tasks
from support.emulated_lab import address
from support.fake_realsense import FakeRealSense
from support.ros2_lab import HERE, new_domain, other_node

from oimppi_warp.cli.main import main
from oimppi_warp.perception.camera_model import load_camera
from oimppi_warp.perception.pose_feed import PoseReceiver
from oimppi_warp.perception.tags import layout_of
from oimppi_warp.perception.video import Frame, Recorder
from oimppi_warp.plants.ros2.poses import Ros2Poses

POSE = np.array([0.41, 0.08, 0.5])
PORT = 29601


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """Five images of the can, at a tenth of a second."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    scene, renderer = small_tasks.shipped("lab01"), rendered.Renderer(rendered.lab_camera(), seed=8)
    recorder = Recorder(folder)
    for number in range(5):
        can = rendered.standing(POSE, layout_of(scene.object), scene)
        recorder.write(Frame(renderer.image(can), 1000.0 + 0.1 * number))
    recorder.close()
    return folder


@pytest.fixture
def calibration(tmp_path) -> Path:
    rendered.lab_camera().save(tmp_path / "camera.toml")
    return tmp_path / "camera.toml"


def perceive(*arguments: object) -> int:
    return main(["perceive", *map(str, arguments)])


def poses_in(text: str) -> np.ndarray:
    """The poses that were printed, shape [n, 3]."""
    lines = re.findall(r"([-\d.]+) m  ([-\d.]+) m  ([-\d.]+) rad  error", text)
    return np.array(lines, dtype=float).reshape(-1, 3)


def test_recorded_images_are_worked_through_and_their_poses_printed(recording, calibration, capsys):
    picture = calibration.with_name("seen.png")
    assert perceive("run", "lab01", "--camera", recording, "--calibration", calibration, "--picture", picture) == 0
    said = capsys.readouterr().out
    found = poses_in(said)
    assert len(found) == 5 and "found in 5 of 5 images" in said and "1000.400" in said
    np.testing.assert_allclose(found - POSE, 0.0, atol=0.02)
    np.testing.assert_allclose(found[:, :2], np.tile(POSE[:2], (5, 1)), atol=0.003)
    drawn = cv2.imread(str(picture))
    plain = cv2.imread(str(recording / "000004.png"))
    assert drawn is not None and plain is not None and drawn.shape == plain.shape
    changed = (drawn != plain).any(axis=-1)
    where = rendered.lab_camera().project(np.array([[*POSE[:2], 0.101]]))[0].astype(int)
    assert changed[where[1] - 40 : where[1] + 40, where[0] - 40 : where[0] + 40].mean() > 0.02


def slowed(recording: Path, folder: Path, period: float) -> Path:
    """The recording with other times between its images [s]."""
    shutil.copytree(recording, folder)
    (folder / "stamps.json").write_text(json.dumps({f"{i:06d}.png": 1000.0 + period * i for i in range(5)}))
    return folder


def test_poses_are_served_as_the_arm_takes_them(recording, calibration, tmp_path, capsys):
    host, slow = address(), slowed(recording, tmp_path / "slow", 0.6)  # the receiver tries to connect every half second
    receiver = PoseReceiver(f"{host}:{PORT}")
    try:
        run = ("run", "lab01", "--camera", slow, "--calibration", calibration, "--host", host, "--port", PORT)
        for _ in range(5):  # on a machine that is busy with something else
            assert perceive(*run) == 0
            if receiver.latest is not None:
                break
    finally:
        receiver.close()
    assert f"served at {host}:{PORT}" in capsys.readouterr().out
    assert receiver.latest is not None
    np.testing.assert_allclose(receiver.latest.pose, POSE, atol=0.02)
    assert receiver.latest.stamp > 1e9, "replayed images have the present time"


def test_poses_are_published_as_ros_takes_them(recording, calibration, tmp_path, capsys):
    domain, slow = new_domain(), slowed(recording, tmp_path / "slow", 0.6)
    with other_node(domain) as node:
        poses = Ros2Poses(node, "fp_object_pose", world="world")
        run = ("run", "lab01", "--camera", slow, "--calibration", calibration)
        assert perceive(*run, "--ros2", "--domain", domain, "--peers", HERE) == 0
        assert f"published in ROS domain {domain}" in capsys.readouterr().out
        assert poses.poses, poses.problem
        np.testing.assert_allclose(poses.poses[-1].pose, POSE, atol=0.02)
        assert 0.0 <= poses.poses[-1].age < 5.0


def test_images_without_the_object_give_status_one_and_the_reason(calibration, tmp_path, capsys):
    folder = tmp_path / "empty"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), rendered.Renderer(rendered.lab_camera()).image([]))
    assert perceive("run", "lab01", "--camera", folder, "--calibration", calibration) == 1
    assert "no tag is seen, of apriltag36h11 0" in capsys.readouterr().out


def test_a_picture_that_cannot_be_written_is_told(recording, calibration, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    run = ("run", "lab01", "--camera", recording, "--calibration", calibration, "--images", 1)
    assert perceive(*run, "--picture", tmp_path / "file" / "seen.png") == 2
    assert "input or output failed" in capsys.readouterr().err


def test_what_was_seen_can_be_recorded_and_replayed(recording, calibration, tmp_path, capsys):
    again = tmp_path / "again"
    run = ("run", "lab01", "--calibration", calibration)
    assert perceive(*run, "--camera", recording, "--record", again, "--images", 3) == 0
    first = poses_in(capsys.readouterr().out)
    assert perceive(*run, "--camera", again) == 0
    np.testing.assert_array_equal(poses_in(capsys.readouterr().out), first)
    assert len(first) == 3


def test_a_signal_ends_it_with_a_complete_recording_and_a_summary(recording, calibration, tmp_path):
    slow, again = slowed(recording, tmp_path / "slow", 4.0), tmp_path / "again"
    run = ("run", "lab01", "--camera", slow, "--calibration", calibration, "--host", address(), "--port", "0")
    command = [sys.executable, "-m", "oimppi_warp", "perceive", *map(str, run), "--record", str(again)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        while "error" not in process.stdout.readline():  # the first image was seen
            assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        said, complained = process.communicate(timeout=60.0)
    assert process.returncode == 0 and complained == "", complained
    assert "The object was found in" in said
    written = json.loads((again / "stamps.json").read_text())
    assert 1 <= len(written) < 5 and sorted(written) == sorted(file.name for file in again.glob("*.png"))


def test_the_sheet_is_written_and_its_tags_are_those_that_are_looked_for(recording, calibration, tmp_path, capsys):
    assert perceive("sheet", "lab01", "--out", tmp_path) == 0
    assert "black square of 37 mm" in capsys.readouterr().out
    assert (tmp_path / "lab01-sheet.pdf").read_bytes().startswith(b"%PDF")
    tags = tmp_path / "lab01-tags.toml"
    run = ("run", "lab01", "--camera", recording, "--calibration", calibration)
    assert perceive(*run, "--tags", tags) == 0
    tags.write_text(tags.read_text().replace("id = 0", "id = 9"))
    assert perceive(*run, "--tags", tags) == 1
    assert "the tags 0 are seen, but none of the object's" in capsys.readouterr().out
    assert perceive("sheet", "lab01", "--out", tmp_path) == 2
    assert "--force overwrites it" in capsys.readouterr().err
    assert perceive("sheet", "lab01", "--out", tmp_path, "--force") == 0


def test_from_images_of_the_board_to_the_pose_of_the_can(recording, tmp_path, capsys):
    truth, file = rendered.lab_camera(), tmp_path / "camera.toml"
    boards.write_images(tmp_path / "lens", truth, boards.before_the_lens(truth, 18))
    assert perceive("calibrate", "lens", tmp_path / "lens", "--out", file) == 0
    assert load_camera(file).pose is None
    run = ("run", "lab01", "--camera", recording, "--calibration", file)
    assert perceive(*run) == 2, "where the camera stands is not known yet"
    assert "oimppi perceive calibrate table" in capsys.readouterr().err
    boards.write_images(tmp_path / "table", truth, [boards.board_on_table(0.28, -0.12, 0.1)])
    on_table = ("calibrate", "table", tmp_path / "table", "--calibration", file)
    assert perceive(*on_table, "--at", "0.28,-0.12,0.1") == 0
    said = capsys.readouterr().out
    assert "the camera stands at" in said and "px from where they should be" in said
    assert perceive(*run) == 0
    one_place = poses_in(capsys.readouterr().out) - POSE
    places = [(0.28, -0.12, 0.1), (0.40, 0.15, 0.8), (0.30, -0.40, -0.2), (0.45, 0.25, -0.6)]
    names = boards.write_images(tmp_path / "places", truth, [boards.board_on_table(*place) for place in places])
    rows = [f"{name},{x},{y},{yaw}" for name, (x, y, yaw) in zip(names, places, strict=True)]
    (tmp_path / "places" / "places.csv").write_text("\n".join(["image,x,y,yaw", *rows]))
    assert perceive("calibrate", "table", tmp_path / "places", "--calibration", file) == 0
    assert perceive(*run) == 0
    off = np.concatenate([one_place, poses_in(capsys.readouterr().out) - POSE])
    away, turned = np.hypot(off[:, 0], off[:, 1]).max(), np.abs(off[:, 2]).max()
    print(f"position {1e3 * away:.2f} mm, yaw {np.degrees(turned):.2f} degrees")
    assert away < 0.005 and turned < 0.03


def test_the_arm_that_holds_the_board_places_the_camera(tmp_path, capsys):
    truth, file = rendered.lab_camera(), tmp_path / "camera.toml"
    replace(truth, pose=None).save(file)
    joints, poses = boards.held_by_the_arm(truth, small_tasks.shipped("lab01").robot, 8)
    names = boards.write_images(tmp_path / "arm", truth, poses, board=boards.SMALL)
    degrees = [",".join(f"{value:.6f}" for value in row) for row in np.degrees(joints)]
    rows = [f"{name},{row}" for name, row in zip(names, degrees, strict=True)]
    header = "image,joint1,joint2,joint3,joint4,joint5,joint6"
    (tmp_path / "arm" / "joints.csv").write_text("\n".join([header, *rows]) + "\n")
    run = ("calibrate", "hand-eye", tmp_path / "arm", "--square", boards.SMALL.square, "--calibration", file)
    assert perceive(*run, "--degrees") == 0
    found = load_camera(file).pose
    assert found is not None and truth.pose is not None
    np.testing.assert_allclose(found[:3], truth.pose[:3], atol=0.004)
    assert perceive(*run) == 2, "degrees taken for radians"
    capsys.readouterr()
    (tmp_path / "arm" / "joints.csv").write_text("\n".join([header, *rows[1:]]) + "\n")
    assert perceive(*run, "--degrees") == 2
    assert "there is nothing about 00.png" in capsys.readouterr().err
    (tmp_path / "arm" / "joints.csv").write_text("image,joint1\n00.png,1\n")
    assert perceive(*run) == 2
    assert (
        "allowed: a CSV file with the columns image, joint1, joint2, joint3, joint4, joint5, joint6"
        in capsys.readouterr().err
    )


def test_a_camera_is_recorded_at_the_pace_that_was_asked_for(tmp_path, monkeypatch, capsys):
    camera = FakeRealSense()
    monkeypatch.setitem(sys.modules, "pyrealsense2", camera)
    record = ("record", tmp_path / "new", "--camera", "realsense", "--every", 0.5, "--images", 3, "--size", "320x240")
    assert perceive(*record) == 0
    assert "3 images in" in capsys.readouterr().out
    stamps = list(json.loads((tmp_path / "new" / "stamps.json").read_text()).values())
    np.testing.assert_allclose(np.diff(stamps), 0.5, atol=0.04)
    assert len(stamps) == 3 and camera.stopped and camera.asked[1:3] == (320, 240)
    assert perceive(*record) == 2
    assert "there is something in this folder" in capsys.readouterr().err
    assert perceive("record", tmp_path / "again", "--camera", tmp_path / "new") == 2
    assert "recorded already" in capsys.readouterr().err


def test_the_example_of_the_documentation_runs(recording, calibration):
    page = (Path(__file__).resolve().parents[2] / "docs" / "perception.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    for written, used in (
        ('Path("camera.toml")', f'Path("{calibration}")'),
        ('open_frames("0"', f'open_frames("{recording}"'),
    ):
        assert written in code
        code = code.replace(written, used)
    code = code.replace("poses.poses, poses.problem", "poses.wait(60.0)\nfound = poses.poses")
    names: dict = {}
    exec(code, names)
    assert len(names["found"]) == 4
    np.testing.assert_allclose(names["found"][-1].pose, POSE, atol=0.02)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("run", "lab01", "--images", "0"), "--images 0 cannot be used"),
        (("run", "lab01", "--port", "99999"), "--port 99999 cannot be used"),
        (("run", "lab01", "--picture", "seen.txt"), "allowed: .png, .jpg"),
        (("run", "lab01", "--calibration", "none.toml"), "there is no such file"),
        (("record", "out", "--size", "big"), "e.g. 640x480"),
        (("record", "out", "--every=-1"), "0 or more seconds"),
        (("sheet", "lab01", "--board", "big"), "e.g. 6x4"),
        (("sheet", "lab01", "--board", "20x4"), "3 to 14 each"),
        (("calibrate", "lens", "none"), "there is no such folder"),
        (("calibrate", "table", "none", "--at", "1,2"), "--at"),
        (("calibrate", "table", "none", "--at", "1,2,0", "--places", "p.csv"), "only one of them"),
    ],
)
def test_bad_options_are_refused_in_one_message(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert perceive(*arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("oimppi: ") and said in error and "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_help_and_the_package_do_without_opencv():
    code = (
        "import sys, oimppi_warp, oimppi_warp.cli.main; print([n for n in ('cv2', 'matplotlib') if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_without_opencv_there_is_one_message(tmp_path, monkeypatch, capsys):
    from oimppi_warp.perception import opencv

    monkeypatch.setitem(sys.modules, "cv2", None)
    opencv.load_opencv.cache_clear()
    for arguments in (("run", "lab01"), ("record", tmp_path / "new"), ("sheet", "lab01", "--out", tmp_path)):
        assert perceive(*arguments) == 2
        assert capsys.readouterr().err == (
            "oimppi: perception: OpenCV is not installed\n  to do:   pip install 'oimppi-warp[perception]'\n"
        )
    assert list(tmp_path.iterdir()) == []

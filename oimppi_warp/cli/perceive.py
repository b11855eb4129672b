"""The commands ``oimppi perceive run``, ``record`` and ``sheet``: the object's pose from a camera."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg, subcommand

from oimppi_warp.cli.calibrate import HandEye, Lens, OnTable
from oimppi_warp.errors import ConfigError

if TYPE_CHECKING:
    from oimppi_warp.perception.tag_detector import Sighting, TagDetector
    from oimppi_warp.perception.tracker import Publish
    from oimppi_warp.perception.video import Frame
    from oimppi_warp.scene import Scene

_Camera = Annotated[str, arg(metavar="N|FILE|DIR|realsense")]
_EVERY = 1.0
"""Time between two lines about what a camera sees [s]."""


@dataclass(frozen=True)
class Perceive:
    """Find the object by the tags on it, and print or serve its pose.

    A camera runs until Ctrl-C. Recorded images are worked through; with --port or --ros2, at the pace at which they
    were taken. docs/perception.md explains tags and calibration.
    """

    scene: Annotated[Positional[str], arg(metavar="SCENE")]
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    camera: _Camera = "0"
    """Number of a camera (0 is the first), a video, a folder of recorded images, or realsense."""

    calibration: Annotated[Path, arg(metavar="FILE")] = Path("camera.toml")
    """Calibration of the camera, written by `oimppi perceive calibrate`."""

    tags: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: the tag of the scene's sheet)")] = (
        None
    )
    """Tags on the object, written by `oimppi perceive sheet`."""

    port: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: not served; usual: 17501)")] = None
    """Port on which the poses are served to `oimppi run --plant xarm --pose-address HOST`."""

    host: Annotated[str, arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address on which the poses are served; 0.0.0.0 is every address of this machine."""

    ros2: FlagCreatePairsOff[bool] = False
    """Publish the poses on ROS 2: on the topic /object_pose, and as the frame fp_object_pose in /tf (extra ros2)."""

    domain: Annotated[int, arg(metavar="N", help_behavior_hint="(default: ROS_DOMAIN_ID, or 0)")] = -1
    """With --ros2: ROS domain."""

    peers: Annotated[str, arg(metavar="ADDRESS,…", help_behavior_hint="(default: multicast)")] = ""
    """With --ros2: addresses of the machines to talk to, where multicast does not work."""

    images: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: until Ctrl-C)")] = None
    """Number of images after which to stop."""

    picture: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """Image file for the latest image with what was seen in it: the tags, and the object's outline and axes."""

    record: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder to which all images are written, to be replayed with --camera DIR."""

    def execute(self) -> int:
        """Detects the object until there are no more images, and returns the exit status."""
        _check_count("--images", self.images)
        if self.port is not None and not 0 <= self.port <= 65535:
            raise ConfigError(f"--port {self.port} cannot be used\n  allowed: 1 to 65535, or 0 for a free one")
        if self.picture is not None and self.picture.suffix.lower() not in (".png", ".jpg", ".jpeg"):
            raise ConfigError(f"--picture {self.picture}: this is no image file\n  allowed: .png, .jpg")
        from oimppi_warp.perception.camera_model import load_camera
        from oimppi_warp.perception.opencv import load_opencv
        from oimppi_warp.perception.tag_detector import TagDetector

        load_opencv()
        camera = load_camera(self.calibration)
        from oimppi_warp.perception.tags import layout_of, load_layout
        from oimppi_warp.perception.tracker import CameraPoses
        from oimppi_warp.perception.video import Recorder, open_frames
        from oimppi_warp.usd import load_scene

        scene = load_scene(self.scene)
        layout = layout_of(scene.object) if self.tags is None else load_layout(self.tags)
        detector = TagDetector(camera, layout, scene.object.rest_height)
        with ExitStack() as open_things:
            recorder = None
            frames = open_frames(self.camera, size=camera.image_size)
            if self.record is not None:
                recorder = Recorder(self.record)
                open_things.callback(recorder.close)
            publishers = self._publishers(scene, open_things)
            shown = _Shown(scene, detector, self.picture, None if recorder is None else recorder.write)
            shown.every = _EVERY if frames.live or publishers else 0.0
            poses = CameraPoses(
                frames,
                detector,
                publish=publishers,
                on_sighting=shown.take,
                hurry=not publishers,
                limit=self.images,
            )
            open_things.callback(poses.close)
            with suppress(KeyboardInterrupt):
                while poses.running:
                    poses.wait(0.2)
                poses.wait()
            poses.close()
        shown.finish()
        print(f"The object was found in {poses.found} of {poses.images} images.")
        return 0 if poses.found > 0 else 1

    def _publishers(self, scene: Scene, open_things: ExitStack) -> list[Publish]:
        """Returns what the poses are sent to, and says where; ``open_things`` ends it."""
        publishers: list[Publish] = []
        if self.port is not None:
            from oimppi_warp.perception.pose_feed import PoseServer

            server = PoseServer(self.host, self.port)
            open_things.callback(server.close)
            publishers.append(server.publish)
            print(f"The poses are served at {self.host}:{server.port}; Ctrl-C ends it.", flush=True)
        if self.ros2:
            from oimppi_warp.plants.ros2.link import connect
            from oimppi_warp.plants.ros2.poses import pose_publisher

            link = connect(domain=self.domain, peers=self.peers)
            open_things.callback(link.close)
            publishers.append(pose_publisher(link, scene.object.rest_height))
            print(f"The poses are published in {link.name}; Ctrl-C ends it.", flush=True)
        return publishers


class _Shown:
    """Prints what is seen, and keeps the latest image for the picture.

    Attributes:
        every: Shortest time between two lines [s].
    """

    def __init__(
        self, scene: Scene, detector: TagDetector, picture: Path | None, write: Callable[[Frame], None] | None
    ) -> None:
        self._scene, self._detector, self._picture, self._write = scene, detector, picture, write
        self._next = 0.0
        self._latest: tuple[Frame, Sighting] | None = None
        self.every = 0.0

    def take(self, frame: Frame, sighting: Sighting) -> None:
        """Takes note of an image and of what was found in it."""
        self._latest = frame, sighting
        if self._write is not None:
            self._write(frame)
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + self.every
        print(f"{frame.stamp:.3f}  {describe(sighting)}", flush=True)
        if self.every > 0.0:
            self.finish()

    def finish(self) -> None:
        """Writes the picture of the latest image."""
        if self._picture is None or self._latest is None:
            return
        from oimppi_warp.perception.opencv import load_opencv
        from oimppi_warp.perception.picture import annotated
        from oimppi_warp.record.log import write_atomically

        frame, sighting = self._latest
        drawn = annotated(frame.image, sighting, self._detector, self._scene.object)
        self._picture.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(self._picture, load_opencv().imencode(self._picture.suffix.lower(), drawn)[1].tobytes())


def describe(sighting: Sighting) -> str:
    """Returns what was found in an image, as one line."""
    if sighting.pose is None:
        return sighting.problem
    x, y, yaw = sighting.pose
    return f"{x:.4f} m  {y:.4f} m  {yaw:.3f} rad  error {sighting.error:.2f} px"


@dataclass(frozen=True)
class Record:
    """Take images with a camera, for its calibration or to be replayed.

    Ctrl-C ends it.
    """

    out: Annotated[Positional[Path], arg(metavar="DIR")]
    """Folder for the images; a new one, or an empty one."""

    camera: _Camera = "0"
    """Number of a camera (0 is the first), or realsense."""

    every: Annotated[float, arg(metavar="S")] = 1.0
    """Time between two images in seconds; 0 takes all."""

    images: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: until Ctrl-C)")] = None
    """Number of images after which to stop."""

    size: Annotated[str | None, arg(metavar="WxH", help_behavior_hint="(default: the camera's)")] = None
    """Width and height of the images in pixels, e.g. 640x480."""

    by_hand: FlagCreatePairsOff[bool] = False
    """Take an image whenever Enter is pressed."""

    def execute(self) -> int:
        """Takes images and returns the exit status."""
        _check_count("--images", self.images)
        if not 0.0 <= self.every < 1e6:
            raise ConfigError(f"--every {self.every:g} cannot be used\n  allowed: 0 or more seconds")
        size = None if self.size is None else _parse_size(self.size)
        from oimppi_warp.perception.video import Recorder, open_frames

        frames, count = open_frames(self.camera, size=size), 0
        if not frames.live:
            raise ConfigError(f"--camera {self.camera}: these images are recorded already\n  allowed: a camera")
        try:
            recorder = Recorder(self.out)
        except ConfigError:
            frames.close()
            raise
        try:
            with suppress(KeyboardInterrupt, EOFError):
                due = -1e9
                while self.images is None or count < self.images:
                    if self.by_hand:
                        input(f"Enter takes image {count + 1}, Ctrl-C ends: ")
                        due = time.time()
                    while (frame := frames.read()) is not None and frame.stamp < due:
                        pass
                    if frame is None:
                        break
                    recorder.write(frame)
                    count, due = count + 1, frame.stamp + self.every
        finally:
            recorder.close()
            frames.close()
        print(f"{count} images in {self.out}")
        return 0 if count else 1


@dataclass(frozen=True)
class Sheet:
    """Write a sheet to print: the tag of the scene's object, and the board for calibration.

    DIR/NAME-sheet.pdf is true to scale, with a ruler to check the print; DIR/NAME-tags.toml is for --tags.
    """

    scene: Annotated[Positional[str], arg(metavar="SCENE")]
    """A USD file, or the name of a shipped scene (`oimppi scenes` lists them)."""

    out: Annotated[Path, arg(metavar="DIR")] = Path(".")
    """Folder to write to."""

    family: Literal["apriltag36h11", "apriltag25h9", "aruco5x5", "aruco6x6"] = "apriltag36h11"
    """Family of the tag."""

    size: Annotated[float | None, arg(metavar="M", help_behavior_hint="(default: as large as fits)")] = None
    """Side of the tag's black square in metres."""

    tags: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: one tag on the top)")] = None
    """Tags that are described in a file, instead of --family and --size."""

    board: Annotated[str, arg(metavar="CxR")] = "6x4"
    """Number of the board's squares, columns and rows."""

    square: Annotated[float, arg(metavar="M")] = 0.042
    """Side of the board's squares in metres."""

    paper: Literal["a4", "letter"] = "a4"
    """Size of the paper, used across."""

    force: FlagCreatePairsOff[bool] = False
    """Overwrite existing files."""

    def execute(self) -> int:
        """Writes the sheet and returns the exit status."""
        from oimppi_warp.cli.calibrate import parse_board
        from oimppi_warp.perception.sheet import board_page, object_page, save_pages
        from oimppi_warp.perception.tags import layout_of, load_layout
        from oimppi_warp.usd import load_scene

        board = parse_board(self.board, self.square)
        scene = load_scene(self.scene)
        sheet, described = (self.out / f"{scene.name}-{end}" for end in ("sheet.pdf", "tags.toml"))
        for file in (sheet, described):
            if file.exists() and not self.force and file != self.tags:
                raise ConfigError(f"{file} exists\n  to do:   --force overwrites it; --out DIR writes elsewhere")
        if self.tags is None:
            layout = layout_of(scene.object, family=self.family, size=self.size)
        else:
            layout = load_layout(self.tags)
        pages = [object_page(scene.object, layout, scene.name, paper=self.paper), board_page(board, paper=self.paper)]
        save_pages(pages, sheet)
        layout.save(described)
        for tag in layout.tags:
            x, y, _ = (1e3 * value for value in tag.position)
            print(
                f"{layout.family} {tag.id}: black square of {1e3 * tag.size:g} mm, centre {x:g} mm, {y:g} mm, "
                f"turned by {tag.yaw:g} rad in the object's frame"
            )
        print(f"{sheet} and {described} were written; print at 100 %, and measure the ruler.")
        return 0


CalibrateCommand = (
    Annotated[Lens, subcommand("lens", prefix_name=False)]
    | Annotated[OnTable, subcommand("table", prefix_name=False)]
    | Annotated[HandEye, subcommand("hand-eye", prefix_name=False)]
)
"""The subcommands of ``oimppi perceive calibrate``."""

PerceiveCommand = (
    Annotated[Perceive, subcommand("run", prefix_name=False)]
    | Annotated[Sheet, subcommand("sheet", prefix_name=False)]
    | Annotated[Record, subcommand("record", prefix_name=False)]
    | Annotated[
        CalibrateCommand,
        subcommand("calibrate", prefix_name=False, description="Calibrate a camera's lens, and find where it stands."),
    ]
)
"""The subcommands of ``oimppi perceive``."""


def _check_count(option: str, count: int | None) -> None:
    """Raises ConfigError if a number of images is not above zero."""
    if count is not None and count < 1:
        raise ConfigError(f"{option} {count} cannot be used\n  allowed: 1 or more")


def _parse_size(text: str) -> tuple[int, int]:
    """Returns width and height of an image [px]."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) > 0 and int(height) > 0):
        raise ConfigError(f"--size {text} cannot be used\n  allowed: width and height in pixels, e.g. 640x480")
    return int(width), int(height)

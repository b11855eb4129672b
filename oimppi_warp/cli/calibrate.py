"""The commands ``oimppi perceive calibrate``: the lens of a camera, and where it stands."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg

from oimppi_warp.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np

    from oimppi_warp.perception.board import Board, BoardView
    from oimppi_warp.perception.calibration import Calibration


@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """Images of the board."""

    images: Annotated[Positional[Path], arg(metavar="DIR")]
    """Folder with the images, such as `oimppi perceive record` writes."""

    board: Annotated[str, arg(metavar="CxR")] = "6x4"
    """Number of the board's squares, columns and rows."""

    square: Annotated[float, arg(metavar="M")] = 0.042
    """Side of the board's squares in metres, measured on the print."""

    def views(self) -> list[BoardView]:
        """Returns what is seen of the board in the images, and says in which it is not seen.

        Raises:
            ConfigError: There are no images, or OpenCV is not installed.
        """
        from oimppi_warp.perception.board import BoardFinder
        from oimppi_warp.perception.video import image_files, read_image

        finder, files = BoardFinder(parse_board(self.board, self.square)), image_files(self.images)
        found = {file.name: finder.find(read_image(file), file.name) for file in files}
        if without := [name for name, view in found.items() if view is None]:
            print(f"The board is not seen, or too little of it, in {', '.join(without)}.")
        return [view for view in found.values() if view is not None]

    def described(self, file: Path, columns: Sequence[str]) -> tuple[list[BoardView], np.ndarray]:
        """Returns the views, and the numbers that a file has about each.

        Args:
            file: CSV file with the column image and the following ones.
            columns: Names of the columns.

        Returns:
            The views, and the numbers, shape [view, column].

        Raises:
            ConfigError: The file cannot be read, or says nothing about an image in which the board is seen.
        """
        import numpy as np

        table = read_table(file, columns)
        views = self.views()
        for view in views:
            if view.name not in table:
                raise ConfigError(f"{file}: there is nothing about {view.name}\n  to do:   add a line for it")
        return views, np.array([table[view.name] for view in views]).reshape(-1, len(columns))


@dataclass(frozen=True, kw_only=True)
class Lens(BoardOptions):
    """Calibrate a camera's lens with images of the board: focal length, principal point and distortion.

    Take 15 to 30 images: the whole board sharp, near and far, in all parts of the image, tilted to all sides.
    """

    out: Annotated[Path, arg(metavar="FILE")] = Path("camera.toml")
    """File for the calibration."""

    force: FlagCreatePairsOff[bool] = False
    """Overwrite an existing file."""

    def execute(self) -> int:
        """Calibrates, writes the file and returns the exit status."""
        if self.out.exists() and not self.force:
            raise ConfigError(f"{self.out} exists\n  to do:   --force overwrites it; --out FILE writes elsewhere")
        from oimppi_warp.perception.calibration import calibrate_lens

        found = calibrate_lens(views := self.views())
        found.camera.save(self.out)
        fx, fy = found.camera.focal_length
        cx, cy = found.camera.principal_point
        print(f"focal length {fx:.1f}, {fy:.1f} px, principal point {cx:.1f}, {cy:.1f} px")
        _report(found, views, self.out)
        return 0


@dataclass(frozen=True, kw_only=True)
class OnTable(BoardOptions):
    """Find where the camera stands, with the board lying at known places on the table, face up.

    The place of the board's origin, its bottom left corner, is measured from the arm's base. Several places, with an
    image of each, give a more exact result.
    """

    at: Annotated[str | None, arg(metavar="X,Y,YAW", help_behavior_hint="(default: --places)")] = None
    """Pose of the board in all images: x and y of its origin in metres, and the angle from the world's x to the board's
    in radians."""

    places: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: DIR/places.csv)")] = None
    """File with the pose of the board in each image: CSV with the columns image, x, y and yaw."""

    height: Annotated[float, arg(metavar="M")] = 0.0
    """Height of the printed side above the table in metres, if the board is thick."""

    calibration: Annotated[Path, arg(metavar="FILE")] = Path("camera.toml")
    """Calibration of the lens, to which the place is added."""

    def execute(self) -> int:
        """Calibrates, writes the file and returns the exit status."""
        import numpy as np

        from oimppi_warp.runtime.request import parse_pose

        same = None if self.at is None else parse_pose("--at", self.at)
        if same is not None and self.places is not None:
            raise ConfigError("--at and --places: only one of them can be given")
        if not -0.5 < self.height < 1.0:
            raise ConfigError(f"--height {self.height:g} cannot be used\n  allowed: -0.5 to 1 m")
        from oimppi_warp.perception.calibration import board_on_table, place_by_board
        from oimppi_warp.perception.camera_model import load_camera

        camera = load_camera(self.calibration)
        if same is not None:
            views = self.views()
            boards = np.tile(board_on_table(*same, height=self.height), (len(views), 1, 1))
        else:
            views, table = self.described(self.places or self.images / "places.csv", ("x", "y", "yaw"))
            boards = np.array([board_on_table(*row, height=self.height) for row in table])
        found = place_by_board(camera, views, boards)
        found.camera.save(self.calibration)
        _report(found, views, self.calibration)
        return 0


@dataclass(frozen=True, kw_only=True)
class HandEye(BoardOptions):
    """Find where the camera stands, with the board fixed to the arm's last link (hand-eye calibration).

    The joint positions at each image come from a CSV file with the columns image, joint1, joint2 and so on; where on
    the link the board is fixed is found as well. Take 10 to 20 images, with the board turned to all sides.
    """

    scene: Annotated[str, arg(metavar="SCENE")] = "lab01"
    """A scene with the same arm."""

    joints: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: DIR/joints.csv)")] = None
    """File with the joint positions, in radians (metres for a sliding joint)."""

    degrees: FlagCreatePairsOff[bool] = False
    """The joint positions are in degrees."""

    calibration: Annotated[Path, arg(metavar="FILE")] = Path("camera.toml")
    """Calibration of the lens, to which the place is added."""

    def execute(self) -> int:
        """Calibrates, writes the file and returns the exit status."""
        import numpy as np

        from oimppi_warp.geometry.kinematics import revolute_joints
        from oimppi_warp.perception.calibration import place_by_arm
        from oimppi_warp.perception.camera_model import load_camera
        from oimppi_warp.usd import load_scene

        camera, robot = load_camera(self.calibration), load_scene(self.scene).robot
        file = self.joints or self.images / "joints.csv"
        views, joints = self.described(file, [f"joint{number}" for number in range(1, robot.dof + 1)])
        if self.degrees:
            joints = np.where(revolute_joints(robot), np.radians(joints), joints)
        found = place_by_arm(camera, views, robot, joints)
        found.camera.save(self.calibration)
        _report(found, views, self.calibration)
        return 0


def parse_board(text: str, square: float) -> Board:
    """Returns the board with a number of columns and rows, as ``CxR``, and a side of its squares [m].

    Raises:
        ConfigError: There can be no such board.
    """
    from oimppi_warp.perception.board import Board

    columns, _, rows = text.partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise ConfigError(f"--board {text} cannot be used\n  allowed: columns and rows of squares, e.g. 6x4")
    return Board(int(columns), int(rows), square)


def read_table(file: Path, columns: Sequence[str]) -> dict[str, list[float]]:
    """Reads numbers about images.

    Args:
        file: CSV file with the column image, and others.
        columns: Names of those to read.

    Returns:
        The numbers, by the name of the image.

    Raises:
        ConfigError: The file does not exist, or says something else.
    """
    allowed = f"a CSV file with the columns image, {', '.join(columns)}, and a number in each"
    try:
        with file.open(newline="") as rows:
            table = {row["image"]: [float(row[column]) for column in columns] for row in csv.DictReader(rows)}
    except FileNotFoundError:
        raise ConfigError(f"{file}: there is no such file\n  allowed: {allowed}") from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise ConfigError(f"{file}: this cannot be read\n  allowed: {allowed}") from None
    if not all(math.isfinite(value) for row in table.values() for value in row):
        raise ConfigError(f"{file}: there is a number that is not finite\n  allowed: {allowed}")
    return table


def _report(found: Calibration, views: list[BoardView], file: Path) -> None:
    """Prints how well a calibration fits."""
    if found.camera.pose is not None:
        x, y, z = found.camera.pose[:3]
        print(f"the camera stands at {x:.4f} m, {y:.4f} m, {z:.4f} m")
    worst = int(found.errors.argmax())
    print(f"{found.uncertainty}, from {len(views)} images")
    print(
        f"the corners are {found.error:.2f} px from where they should be, most in {views[worst].name} "
        f"({found.errors[worst]:.2f} px)"
    )
    print(f"{file} was written")

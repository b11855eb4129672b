"""The ChArUco board for calibration: its geometry, and its corners in images.

The board's frame has its origin at the bottom left corner of the printed squares, x to the right, y up the sheet, and z
out of it towards the viewer. The board's markers belong to a family that no object's tags belong to.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oimppi_warp.errors import ConfigError
from oimppi_warp.perception.opencv import enlarged, load_opencv, marker_parameters

MARKER_SHARE = 0.8
"""Side of a marker, relative to that of a square."""
FEWEST = 6
"""Number of corners from which on a view of the board is used."""


@dataclass(frozen=True)
class Board:
    """A board of squares with markers.

    Attributes:
        columns, rows: Number of squares along x and y.
        square: Side of a square [m].
    """

    columns: int = 6
    rows: int = 4
    square: float = 0.042

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 14 and 3 <= self.rows <= 14):
            raise ConfigError(f"the board cannot have {self.columns} x {self.rows} squares\n  allowed: 3 to 14 each")
        if not 0.005 <= self.square <= 0.5:
            raise ConfigError(f"the squares of the board cannot be {self.square:g} m large\n  allowed: 0.005 to 0.5")

    @property
    def size(self) -> tuple[float, float]:
        """Returns width and height of the printed squares [m]."""
        return self.columns * self.square, self.rows * self.square

    def pattern(self) -> Any:
        """Returns OpenCV's board."""
        aruco = load_opencv().aruco
        markers = aruco.getPredefinedDictionary(aruco.DICT_4X4_50)
        return aruco.CharucoBoard((self.columns, self.rows), self.square, MARKER_SHARE * self.square, markers)

    def image(self, pixels: int) -> np.ndarray:
        """Returns the board as grey values, the given number of pixels per square, without a margin."""
        return self.pattern().generateImage((self.columns * pixels, self.rows * pixels), marginSize=0, borderBits=1)

    def corners(self) -> np.ndarray:
        """Returns the inner corners in the board's frame, in the order of their numbers, shape [n, 3] [m]."""
        down = self.pattern().getChessboardCorners().astype(float)  # OpenCV's y points down the sheet
        return np.column_stack([down[:, 0], self.rows * self.square - down[:, 1], np.zeros(len(down))])


@dataclass(frozen=True, eq=False)
class BoardView:
    """The corners of a board that are seen in an image.

    Attributes:
        points: Corners in the board's frame, shape [n, 3] [m].
        pixels: Where they are seen, shape [n, 2] [px].
        image_size: Width and height of the image [px].
        name: Name of the image, for messages.
    """

    points: np.ndarray
    pixels: np.ndarray
    image_size: tuple[int, int]
    name: str = "an image"


@dataclass
class BoardFinder:
    """Finds a board in images.

    Attributes:
        board: The board.
    """

    board: Board
    _detector: Any = field(init=False)
    _corners: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        aruco = load_opencv().aruco
        parameters = marker_parameters(edges=False)
        self._detector = aruco.CharucoDetector(self.board.pattern(), aruco.CharucoParameters(), parameters)
        self._corners = self.board.corners()

    def find(self, image: np.ndarray, name: str = "an image") -> BoardView | None:
        """Returns what is seen of the board in an image; ``None`` if that is too little to be used.

        Args:
            image: Grey or BGR, shape [height, width] or [height, width, 3], dtype uint8.
            name: Name of the image, for messages.
        """
        cv2 = load_opencv()
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        large, zoom = enlarged(grey)
        pixels, ids, _, _ = self._detector.detectBoard(large)
        if ids is None or len(ids) < FEWEST:
            return None
        points = self._corners[ids.ravel()]
        spread = np.linalg.svd(points[:, :2] - points[:, :2].mean(axis=0), compute_uv=False)
        if spread[1] < self.board.square:  # all in one line
            return None
        pixels = (pixels.reshape(-1, 2).astype(float) + 0.5) / zoom - 0.5
        return BoardView(points, pixels, (image.shape[1], image.shape[0]), name)

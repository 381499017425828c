"""Intrinsics of a camera from images of a chessboard or ChArUco board, by OpenCV (Zhang 2000).

A view is an image with the board in a new position. A result is rejected if the views do not determine the lens.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from occlog.array_types import Floats, Ints
from occlog.errors import InputError, UsageError, option
from occlog.records.frames import Image
from occlog.records.scene import Camera, camera_fov

MIN_VIEWS, MAX_VIEWS = 6, 50
"""Number of views at least, and at most: those that differ most are used."""
MIN_CORNERS = 8
"""Corners of a ChArUco board in a view at least."""
MIN_MOVED = 0.02
"""A view differs from the one before by this share of the width of the image, as the mean of all corners."""
CELLS = (8, 6)
"""The image is divided into these cells, to count those with a corner."""
MAX_SIGMA_FOCAL, MAX_SIGMA_PRINCIPAL = 0.01, 0.02
"""Largest standard deviations of a focal length, as its share, and of the principal point, as a share of the width."""
MIN_TILT_DEG = 5.0
"""Least value of the largest angle of a board to the mean: of parallel boards standard deviations are too small."""
MAX_VIEW_RATIO = 3.0
"""A view with this many times the median residual is omitted: moved while exposed, or wrongly detected."""
K3_GAIN = 0.97
"""The third radial coefficient is estimated where it reduces the residual to this share or less."""


class Board(NamedTuple):
    """Calibration board: chessboard or ChArUco board.

    Attributes:
        columns: inner corners across a chessboard, squares across a ChArUco board.
        rows: inner corners or squares down.
        dictionary: markers of a ChArUco board, OpenCV's name without `DICT_`; empty: a chessboard.
        marker: side of a marker, as a share of that of a square.
    """

    columns: int
    rows: int
    dictionary: str = ""
    marker: float = 0.75


class BoardView(NamedTuple):
    """The board detected in one image: indices of corners (n,) in `corners_of`, and their pixels (n, 2)."""

    corner: Ints
    pixels: Floats


class BoardLens(NamedTuple):
    """Intrinsics estimated from views of a board, with residuals.

    Attributes:
        camera: camera without a pose.
        sigma_focal: (2,) standard deviations of the focal lengths [px].
        sigma_principal: (2,) standard deviations of the principal point [px].
        reprojection_px: root mean square distance of corners from their predictions [px].
        views: number of views used.
        rejected: number of views rejected for large residuals.
        coverage: share of the `CELLS` of the image that contain a corner, 0 to 1.
    """

    camera: Camera
    sigma_focal: Floats
    sigma_principal: Floats
    reprojection_px: float
    views: int
    rejected: int
    coverage: float


def board_of(size: str, dictionary: str, marker: float) -> Board:
    """Parse `size`, COLUMNSxROWS of a board; UsageError if it or the dictionary is not valid.

    Args:
        size: inner corners of a chessboard, or squares of a ChArUco board.
        dictionary: ChArUco markers, by OpenCV's name without `DICT_`; empty: a chessboard.
        marker: side of a marker over that of a square.
    """
    cells = size.lower().split("x")
    if len(cells) != 2 or not all(cell.isdecimal() and 2 <= int(cell[:3]) <= 50 and len(cell) < 3 for cell in cells):
        raise UsageError(
            f"{option('board')} {size}: expected COLUMNSxROWS of inner corners (ChArUco: "
            "squares), each of 2 to 50, as in 9x6"
        )
    if dictionary and not hasattr(cv2.aruco, f"DICT_{dictionary.upper()}"):
        raise UsageError(
            f"{option('dictionary')} {dictionary}: not a dictionary of OpenCV; for example 4X4_50, 5X5_100",
            id="unknown-name",
        )
    return Board(int(cells[0]), int(cells[1]), dictionary.upper(), marker)


def corners_of(board: Board) -> Floats:
    """(N, 3) positions of the corners on the board, row by row, z = 0, in units of a square's side."""
    columns, rows = (board.columns - 1, board.rows - 1) if board.dictionary else (board.columns, board.rows)
    x, y = np.meshgrid(np.arange(1.0, columns + 1), np.arange(1.0, rows + 1))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


class BoardDetector:
    """Detects a calibration board in images with subpixel accuracy."""

    def __init__(self, board: Board) -> None:
        """Prepare OpenCV's detector of a board's corners."""
        self.board = board
        if board.dictionary:
            markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
            drawn = cv2.aruco.CharucoBoard((board.columns, board.rows), 1.0, board.marker, markers)
            self._charuco = cv2.aruco.CharucoDetector(drawn)

    def find(self, image: Image) -> BoardView | None:
        """Detect the board in a grey or BGR image; None if it is not found, or too few corners of a ChArUco board."""
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        if self.board.dictionary:
            pixels, numbers, _, _ = self._charuco.detectBoard(grey)
            if numbers is None or len(numbers) < MIN_CORNERS:
                return None
            return BoardView(numbers.ravel().astype(np.int64), pixels.reshape(-1, 2).astype(np.float64))
        # The first pass is fast where there is no board
        size = (self.board.columns, self.board.rows)
        found, pixels = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if not found:
            return None
        return BoardView(np.arange(size[0] * size[1]), pixels.reshape(-1, 2).astype(np.float64))


def views_of(images: Iterable[Image], board: Board) -> tuple[list[BoardView], tuple[int, int], int]:
    """Distinct views of a board, width and height of the images [px], and the number of images read.

    A view differs from the one before; at most `MAX_VIEWS` are kept. InputError if the images differ in size.
    """
    detector = BoardDetector(board)
    views: list[BoardView] = []
    size, count = (0, 0), 0
    for image in images:
        count += 1
        own = (image.shape[1], image.shape[0])
        if size not in ((0, 0), own):
            raise InputError(
                f"image {count} has {own[0]} x {own[1]} px, and those before {size[0]} x {size[1]}; "
                "give images of one size",
                id="image-size-mismatch",
            )
        size = own
        found = detector.find(image)
        if found is not None and not (views and _moved(views[-1], found) < MIN_MOVED * size[0]):
            views.append(found)
    return _spread(views, size), size, count


def _moved(a: BoardView, b: BoardView) -> float:
    """Mean distance [px] between the corners common to two views; infinite without any."""
    _, i, j = np.intersect1d(a.corner, b.corner, return_indices=True)
    return float(np.linalg.norm(a.pixels[i] - b.pixels[j], axis=1).mean()) if len(i) else np.inf


def _spread(views: Sequence[BoardView], size: tuple[int, int]) -> list[BoardView]:
    """Select at most `MAX_VIEWS` views by farthest-point sampling: each differs most from those selected before.

    `size` is width and height of the images [px].
    """
    if len(views) <= MAX_VIEWS:
        return list(views)
    # Position, extent and perspective of the board
    first = [np.concatenate([v.pixels.mean(axis=0), v.pixels.std(axis=0), v.pixels[0], v.pixels[-1]]) for v in views]
    features = np.array(first) / np.tile(size, 4)
    chosen = [0]
    away = np.linalg.norm(features - features[0], axis=1)
    while len(chosen) < MAX_VIEWS:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return [views[k] for k in sorted(chosen)]


def lens_of_views(name: str, views: Sequence[BoardView], size: tuple[int, int], board: Board, images: int) -> BoardLens:
    """Estimate the intrinsics of a camera from views of a board; views with large residuals are rejected.

    Args:
        name: name of the camera.
        views: views of the board.
        size: width and height of the images [px].
        board: type and size of the board.
        images: number of images that were examined, for messages.

    Raises:
        InputError: there are too few views, or they do not determine the lens.
    """
    if len(views) < MIN_VIEWS:
        raise InputError(
            f"camera {name}: a {board.columns}x{board.rows} board in {len(views)} differing views of {images} images, "
            f"{MIN_VIEWS} at least are needed; check {option('board')}, and move the board",
            id="insufficient-data",
        )
    used = list(views)
    found = _fit(used, size, board)
    good = found.per_view <= MAX_VIEW_RATIO * np.median(found.per_view)
    if not good.all() and np.count_nonzero(good) >= MIN_VIEWS:
        used = [view for view, keep in zip(used, good, strict=True) if keep]
        found = _fit(used, size, board)
    focal, principal = np.diag(found.matrix)[:2].copy(), found.matrix[:2, 2].copy()
    sigma_focal, sigma_principal = found.sigma[:2], found.sigma[2:4]
    share = float((sigma_focal / focal).max())
    off = float(sigma_principal.max()) / size[0]
    remedy = "tilt the board by 30 to 45 degrees, both ways"
    if found.tilt_deg < MIN_TILT_DEG:
        raise InputError(
            f"camera {name}: all boards are within {found.tilt_deg:.1f} degrees of parallel (limit "
            f"{MIN_TILT_DEG:g}), so "
            f"that the focal length is undetermined; {remedy}",
            id="insufficient-data",
        )
    if not (share <= MAX_SIGMA_FOCAL and off <= MAX_SIGMA_PRINCIPAL):
        raise InputError(
            f"camera {name}: the focal length is uncertain by {share:.1%} (limit {MAX_SIGMA_FOCAL:.0%}) or the "
            f"principal point by {off:.1%} of the width (limit {MAX_SIGMA_PRINCIPAL:.0%}); {remedy}",
            id="insufficient-data",
        )
    pose = np.zeros(3), np.eye(3)
    fov = camera_fov(size, focal, principal, found.distortion, "brown", np.eye(3))
    camera = Camera(
        name, *pose, focal, principal, size, distortion=found.distortion, fov=fov, placed=False
    )  # fmt: skip
    return BoardLens(
        camera, sigma_focal, sigma_principal, found.rms, len(used), len(views) - len(used), _coverage(used, size)
    )


class _IntrinsicsFit(NamedTuple):
    """Result of a fit of a camera's intrinsics to V views of a board.

    Attributes:
        matrix: (3, 3) camera matrix.
        distortion: (5,) distortion coefficients of OpenCV.
        sigma: standard deviations of the intrinsics: fx, fy, cx, cy [px], then distortion coefficients.
        rms: root mean square residual of all views [px].
        per_view: (V,) root mean square residual of each view [px].
        tilt_deg: largest angle of a board to their mean [deg].
    """

    matrix: Floats
    distortion: Floats
    sigma: Floats
    rms: float
    per_view: Floats
    tilt_deg: float


def _fit(views: Sequence[BoardView], size: tuple[int, int], board: Board) -> _IntrinsicsFit:
    """Calibrate with two radial coefficients, or with three if these fit clearly better.

    InputError if OpenCV finds no solution. `size` is width and height of the images [px].
    """
    corners = corners_of(board)
    points = [corners[v.corner].astype(np.float32) for v in views]
    pixels = [v.pixels.astype(np.float32).reshape(-1, 1, 2) for v in views]
    fits = []
    for flags in (cv2.CALIB_FIX_K3, 0):
        try:
            rms, matrix, distortion, turns, _, sigma, _, per_view = cv2.calibrateCameraExtended(
                points, pixels, size, np.eye(3), np.zeros(5), flags=flags
            )
        except cv2.error as error:
            raise InputError(
                f"OpenCV cannot calibrate with these views of the board ({error.err}); add images of it at other "
                "angles and positions",
                id="insufficient-data",
            ) from None
        normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
        mean = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
        tilt = float(np.degrees(np.arccos(np.clip(normals @ mean, -1.0, 1.0)).max()))
        fits.append(_IntrinsicsFit(matrix, distortion.ravel()[:5], sigma.ravel(), float(rms), per_view.ravel(), tilt))
    return fits[1] if fits[1].rms <= K3_GAIN * fits[0].rms else fits[0]


def _coverage(views: Sequence[BoardView], size: tuple[int, int]) -> float:
    """Share of the cells of the image, 0 to 1, that contain a corner; `size` is its width and height [px]."""
    pixels = np.concatenate([v.pixels for v in views])
    cell = np.clip((pixels / size * CELLS).astype(np.int64), 0, np.array(CELLS) - 1)
    return len(np.unique(cell, axis=0)) / (CELLS[0] * CELLS[1])

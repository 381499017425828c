"""Lenses from boards: rendered chessboards and ChArUco boards of known lenses, and views that determine nothing."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.calibrate.boards.board import Board, BoardDetector, corners_of, lens_of_views, views_of
from occlog.cli.main import run
from occlog.core.geometry.lens import undistort
from occlog.errors import ExitCode, InputError
from occlog.io.formats.scenes.scene import read_scene

SIZE, FOCAL, PRINCIPAL = (640, 480), np.array([620.0, 625.0]), np.array([331.0, 228.0])
DISTORTION = np.array([-0.22, 0.07, 5e-4, -8e-4, 0.0])
SQUARE_PX = 40


def drawing(board: Board) -> np.ndarray:
    """The board, `SQUARE_PX` a square, with a white border of one square."""
    if board.dictionary:
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
        made = cv2.aruco.CharucoBoard((board.columns, board.rows), 1.0, board.marker, markers)
        inner = made.generateImage((board.columns * SQUARE_PX, board.rows * SQUARE_PX))
    else:
        squares = np.indices((board.rows + 1, board.columns + 1)).sum(axis=0) % 2
        inner = np.kron(255 * squares, np.ones((SQUARE_PX, SQUARE_PX))).astype(np.uint8)
    return np.pad(inner, SQUARE_PX, constant_values=255)


@cache
def lines_of_sight(fine: int) -> Floats:
    """Lines of sight of the image's pixels, `fine` times as many each way."""
    u, v = np.meshgrid(np.arange(fine * SIZE[0]), np.arange(fine * SIZE[1]))
    pixels = (np.column_stack([u.ravel(), v.ravel()]) + 0.5) / fine - 0.5
    return np.column_stack([undistort((pixels - PRINCIPAL) / FOCAL, DISTORTION, "brown"), np.ones(len(pixels))])


def rendered(board: Board, turn: Floats, shift: Floats, noise: np.random.Generator) -> np.ndarray:
    """The board in an image, by the line of sight of each quarter of a pixel; with noise of 3 grey levels."""
    fine, rays = 2, lines_of_sight(2)
    R = cv2.Rodrigues(turn)[0]
    # Points of the plane z = 0 of the board: R x + shift = depth * ray
    normal = R[:, 2]
    on_plane = (rays * (normal @ shift / (rays @ normal))[:, None] - shift) @ R
    at = (on_plane[:, :2] + 1.0) * SQUARE_PX - 0.5
    maps = at.astype(np.float32).reshape(fine * SIZE[1], fine * SIZE[0], 2)
    image = cv2.remap(drawing(board), maps, None, cv2.INTER_LINEAR, borderValue=120)
    small = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA).astype(np.float64)
    return np.clip(small + noise.normal(0.0, 3.0, small.shape), 0, 255).astype(np.uint8)


def poses(board: Board, count: int, rng: np.random.Generator, tilt: float) -> list[tuple[Floats, Floats]]:
    """Poses of the board in the camera, its middle all over the image."""
    middle = corners_of(board).mean(axis=0)
    out = []
    for _ in range(count):
        turn = np.append(rng.uniform(-tilt, tilt, 2), rng.uniform(-0.3, 0.3))
        depth = rng.uniform(11.0, 16.0)
        at = np.append(rng.uniform(-0.28, 0.28, 2) * depth * [1.0, 0.75], depth)
        out.append((turn, at - cv2.Rodrigues(turn)[0] @ middle))
    return out


@cache
def images(board: Board, count: int, seed: int, tilt: float = 0.6) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rendered(board, turn, shift, rng) for turn, shift in poses(board, count, rng, tilt)]


@pytest.mark.parametrize("board", [Board(9, 6), Board(8, 6, "4X4_50", 0.75)], ids=["chessboard", "charuco"])
def test_a_known_lens_is_found(board: Board) -> None:
    """Focal lengths within 0.5 %, the principal point within 3 px, distortion to 1 px in the corners of the image."""
    views, size, count = views_of(images(board, 10, 3), board)
    found = lens_of_views("cam", views, size, board, count)
    camera = found.camera
    assert (size, count) == (SIZE, 10)
    np.testing.assert_allclose(camera.focal_px, FOCAL, rtol=5e-3)
    np.testing.assert_allclose(camera.principal_px, PRINCIPAL, atol=3.0)
    assert found.reprojection_px < 0.3
    assert found.coverage > 0.5
    corners = np.array([[40.0, 40.0], [600.0, 440.0], [40.0, 440.0], [600.0, 40.0]])
    ours = undistort((corners - camera.principal_px) / camera.focal_px, camera.distortion, "brown")
    true = undistort((corners - PRINCIPAL) / FOCAL, DISTORTION, "brown")
    assert np.abs(ours - true).max() * FOCAL[0] < 3.0
    assert np.all(np.abs(camera.focal_px - FOCAL) < 5.0 * found.sigma_focal + 0.5)


def test_a_board_that_is_not_tilted_is_refused() -> None:
    """Views parallel to the image leave the focal length open."""
    board = Board(9, 6)
    views, size, count = views_of(images(board, 16, 4, tilt=0.0), board)
    assert len(views) >= 6
    with pytest.raises(InputError, match="focal length") as caught:
        lens_of_views("cam", views, size, board, count)
    assert len(str(caught.value)) <= 180


def test_a_board_that_stands_still_is_one_view() -> None:
    board = Board(9, 6)
    views, size, count = views_of(images(board, 1, 5) * 4, board)
    assert (len(views), count) == (1, 4)
    with pytest.raises(InputError, match="1 differing views of 4 images"):
        lens_of_views("cam", views, size, board, count)


def test_corners_are_numbered_as_they_are_rendered() -> None:
    """Pixels of corners are projections of `corners_of`, to half a pixel."""
    for board in (Board(9, 6), Board(8, 6, "4X4_50", 0.75)):
        rng = np.random.default_rng(6)
        turn = np.array([0.2, -0.25, 0.1])
        shift = np.array([0.3, -0.2, 13.0]) - cv2.Rodrigues(turn)[0] @ corners_of(board).mean(axis=0)
        view = BoardDetector(board).find(rendered(board, turn, shift, rng))
        assert view is not None
        K = np.array([[FOCAL[0], 0.0, PRINCIPAL[0]], [0.0, FOCAL[1], PRINCIPAL[1]], [0.0, 0.0, 1.0]])
        expected = cv2.projectPoints(corners_of(board)[view.corner], turn, shift, K, DISTORTION)[0].reshape(-1, 2)
        off = min(np.abs(view.pixels - e).max() for e in (expected, expected[::-1]))
        assert off < 0.5


def test_the_command_reads_images_and_writes_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "hall").mkdir()
    (tmp_path / "one").mkdir()
    for n, image in enumerate(images(Board(9, 6), 10, 3)):
        cv2.imwrite(str(tmp_path / "hall" / f"{n}.png"), image)
    cv2.imwrite(str(tmp_path / "one" / "0.png"), image)
    asked = ["calibrate", str(tmp_path / "hall"), "--board", "9x6", "-o", str(tmp_path / "lens.yaml"), "--json"]
    assert run(asked) == ExitCode.DONE
    summary = json.loads(capsys.readouterr().out)
    (camera,) = read_scene(tmp_path / "lens.yaml").cameras
    assert (camera.name, camera.placed, camera.image_size) == ("hall", False, SIZE)
    np.testing.assert_allclose(camera.focal_px, FOCAL, rtol=1e-2)
    assert summary["cameras"]["hall"]["views"] >= 6
    assert (
        run(["calibrate", str(tmp_path / "one"), "--board", "7x5", "-o", str(tmp_path / "x.yaml")])
        == ExitCode.BAD_INPUT
    )
    assert run([*asked[:2], "--board", "9", "-o", str(tmp_path / "x.yaml")]) == ExitCode.USAGE
    assert run([*asked[:4], "--focal", "-o", str(tmp_path / "x.yaml")]) == ExitCode.USAGE
    assert run([*asked[:4], "-o", str(tmp_path / "opencv.yml")]) == ExitCode.DONE
    assert not (tmp_path / "x.yaml").exists()

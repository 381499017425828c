"""Camera geometry against closed forms and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.core.geometry import camera

ANGLE = st.floats(-3.1, 3.1)
TILT = st.floats(-1.4, 1.4)


@given(ANGLE, TILT, ANGLE)
def test_an_array_is_turned_like_a_camera_with_other_axes(yaw: float, pitch: float, roll: float) -> None:
    right, down, forward = camera.rotation_from_angles(yaw, pitch, roll).T
    R = camera.array_rotation(yaw, pitch, roll)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    for axis, same in zip(R.T, (forward, -right, -down), strict=True):
        np.testing.assert_array_equal(axis, same)
    c, s = np.cos(yaw), np.sin(yaw)
    np.testing.assert_allclose(camera.array_rotation(yaw, 0.0, 0.0), [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-12)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_are_in_range_and_the_same_direction(angle: float) -> None:
    wrapped = float(camera.wrap_angle(angle))
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


def test_the_cut_belongs_to_the_negative_side() -> None:
    assert camera.wrap_angle(np.pi) == -np.pi
    assert camera.wrap_angle(np.nextafter(-np.pi, -4.0)) < np.pi


@given(ANGLE, TILT, ANGLE)
def test_angles_come_back_from_the_rotation(yaw: float, pitch: float, roll: float) -> None:
    rotation = camera.rotation_from_angles(yaw, pitch, roll)
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert camera.angles_from_rotation(rotation) == pytest.approx((yaw, pitch, roll), abs=1e-9)


def test_axes_of_a_level_camera() -> None:
    right, down, forward = camera.rotation_from_angles(0.0, 0.0, 0.0).T
    assert forward == pytest.approx([1, 0, 0])
    assert right == pytest.approx([0, -1, 0])
    assert down == pytest.approx([0, 0, -1])


def test_pitch_is_up_and_roll_is_clockwise() -> None:
    _, _, forward = camera.rotation_from_angles(0.3, 0.4, 0.0).T
    assert forward[2] == pytest.approx(np.sin(0.4))
    right, _, _ = camera.rotation_from_angles(0.3, 0.0, 0.2).T
    assert right[2] == pytest.approx(-np.sin(0.2))  # the right side of the camera goes down


def test_projection_agrees_with_opencv() -> None:
    rng = np.random.default_rng(3)
    rotation = camera.rotation_from_angles(0.4, -0.3, 0.1)
    position, focal, principal = np.array([1.0, 2.0, 1.5]), np.array([800.0, 790.0]), np.array([310.0, 250.0])
    k = np.array([-0.2, 0.05, 0.001, -0.002, 0.01])
    local = rng.uniform([-1, -1, 3], [1, 1, 8], (50, 3))
    points = local @ rotation.T + position
    ours = camera.points_to_pixels(points, position, focal, principal, k, "brown", rotation)
    matrix = np.array([[focal[0], 0, principal[0]], [0, focal[1], principal[1]], [0, 0, 1]])
    theirs, _ = cv2.projectPoints(local, np.zeros(3), np.zeros(3), matrix, k)
    assert ours == pytest.approx(theirs.reshape(-1, 2), abs=1e-6)


@pytest.mark.parametrize(
    ("model", "k"),
    [
        ("brown", [-0.2, 0.05, 0.001, -0.002, 0.01]),
        ("tsai", [0.15, 0, 0, 0, 0]),
        ("equidistant", [-0.02, 0.03, -0.02, 0.004, 0]),
        ("equidistant", [0, 0, 0, 0, 0]),
    ],
)
def test_rays_go_through_the_projected_points(model: str, k: list[float]) -> None:
    rng = np.random.default_rng(4)
    rotation = camera.rotation_from_angles(-2.0, -0.4, 0.05)
    position, focal, principal = np.array([0.0, 0.0, 2.0]), np.array([500.0, 505.0]), np.array([320.0, 240.0])
    points = rng.uniform([-2, -1.5, 4], [2, 1.5, 9], (80, 3)) @ rotation.T + position
    pixels = camera.points_to_pixels(points, position, focal, principal, np.array(k), model, rotation)
    rays = camera.pixels_to_rays(pixels, focal, principal, np.array(k), model, rotation)
    expected = (points - position) / np.linalg.norm(points - position, axis=1)[:, None]
    assert rays / np.linalg.norm(rays, axis=1)[:, None] == pytest.approx(expected, abs=1e-9)


def test_points_behind_the_camera_have_no_pixel() -> None:
    rotation = camera.rotation_from_angles(0.0, 0.0, 0.0)
    behind = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    pixels = camera.points_to_pixels(behind, np.zeros(3), np.ones(2), np.zeros(2), np.zeros(5), "brown", rotation)
    assert np.isnan(pixels).all()


@given(ANGLE, st.floats(-1.4, 1.4))
def test_offset_and_azimuth_are_inverse(yaw: float, off: float) -> None:
    azimuth = camera.wrap_angle(yaw + off)
    u = camera.azimuth_to_u(azimuth, yaw, 700.0)
    assert camera.wrap_angle(camera.u_to_azimuth(u, yaw, 700.0) - azimuth) == pytest.approx(0.0, abs=1e-9)
    assert u == pytest.approx(-700.0 * np.tan(off), abs=1e-6)  # to the left is negative


def test_paper_offsets_with_its_own_angle() -> None:
    """[Ercan] Fig. 2 with theta = yaw + pi, and z = f h / d = -u."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        yaw, c = rng.uniform(-np.pi, np.pi), rng.uniform(-5, 5, 2)
        x = rng.uniform(-50, 50, (30, 2))
        theta = yaw + np.pi
        h = np.sin(theta) * (x[:, 0] - c[0]) - np.cos(theta) * (x[:, 1] - c[1])
        d = -np.cos(theta) * (x[:, 0] - c[0]) - np.sin(theta) * (x[:, 1] - c[1])
        ours_h, ours_d = camera.planar_offsets(x, c, yaw)
        assert ours_h == pytest.approx(h)
        assert ours_d == pytest.approx(d)
        front = d > 0.1
        azimuth = np.arctan2(x[:, 1] - c[1], x[:, 0] - c[0])
        assert -camera.azimuth_to_u(azimuth, yaw, 70.0)[front] == pytest.approx((70.0 * h / d)[front])


def test_noise_variance_by_error_propagation() -> None:
    """Eq. 2 equals the first-order propagation of position, yaw and read errors, by finite differences."""
    rng = np.random.default_rng(6)
    f, sp, sy, sr, step = 70.0, 1.0, 0.01, 2.0, 1e-6

    def z(position: np.ndarray, yaw: float, x: np.ndarray) -> float:
        h, d = camera.planar_offsets(x[None], position, yaw)
        return float(f * h[0] / d[0])

    for _ in range(30):
        yaw = rng.uniform(-np.pi, np.pi)
        c = rng.uniform(-5, 5, 2)
        off, far = rng.uniform(-0.7, 0.7), rng.uniform(5, 60)
        x = c + far * np.array([np.cos(yaw + off), np.sin(yaw + off)])
        dp = [(z(c + step * e, yaw, x) - z(c - step * e, yaw, x)) / (2 * step) for e in np.eye(2)]
        dy = (z(c, yaw + step, x) - z(c, yaw - step, x)) / (2 * step)
        expected = sp**2 * (dp[0] ** 2 + dp[1] ** 2) + sy**2 * dy**2 + sr**2
        h, d = camera.planar_offsets(x[None], c, yaw)
        assert camera.noise_variance(h, d, f, sp, sy, sr)[0] == pytest.approx(expected, rel=1e-5)

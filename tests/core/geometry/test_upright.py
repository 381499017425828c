"""Which way is up, by the horizons of cameras."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.geometry.camera import is_upright, other_up_axis, turn_upright, vertical
from occlog.records.scene import camera_rotation

RNG = np.random.default_rng(1)


def rig(*angles: tuple[float, float, float]) -> np.ndarray:
    """Rotations of yaw, pitch, roll in degrees."""
    return np.array([camera_rotation(*np.radians(a)) for a in angles])


ROUND = rig((0, -20, 2), (80, -35, -4), (170, -5, 3), (250, -60, 0))


def turned(rotations: np.ndarray, axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    k = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    a = np.radians(degrees)
    return (np.eye(3) + np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross) @ rotations


def test_horizons_of_cameras_around_a_place_tell_the_vertical_whatever_their_pitch():
    found = vertical(ROUND)
    assert found.certain
    assert np.degrees(np.arccos(found.up[2])) < 4.0
    level = vertical(rig((0, -20, 0), (80, -70, 0), (170, 30, 0)))
    np.testing.assert_allclose(level.up, [0, 0, 1], atol=1e-12)
    assert level.roll == pytest.approx(0.0, abs=1e-9)


def test_a_camera_that_hangs_upside_down_among_others_does_not_turn_the_world_over():
    assert vertical(rig((0, -20, 180), (80, -35, 0), (170, -5, 0))).up[2] == pytest.approx(1.0)
    assert is_upright(rig((0, -20, 180)))
    assert is_upright(rig((0, -20, 180), (90, -30, 180)))


def test_cameras_that_look_the_same_way_leave_their_pitch_open():
    found = vertical(rig((10, -20, 0), (12, -20, 0)))
    assert not found.certain
    assert np.degrees(np.arccos(found.up[2])) == pytest.approx(20.0, abs=0.1)


def test_worlds_with_z_up_seem_upright():
    assert is_upright(np.empty((0, 3, 3)))
    for rotations in (ROUND, rig((0, -89, 0)), rig((0, 44, 0)), rig((0, 0, 29)), rig((20, -10, 0), (20, -10, 0))):
        assert is_upright(rotations)


def test_the_world_of_a_camera_of_a_board_or_with_y_up_does_not():
    assert not is_upright(np.eye(3)[None])  # its own world: the axis along z
    assert not is_upright(np.array([ROUND[1].T @ r for r in ROUND]))
    assert not is_upright(turned(ROUND, (1, 1, 0), 28))  # a board that leans
    assert not is_upright(turned(ROUND, (1, 0, 0), 90))
    assert not is_upright(turned(ROUND, (1, 0, 0), 180))  # z down
    assert not is_upright(rig((0, 46, 0)))
    assert not is_upright(rig((0, 0, 31)))


@pytest.mark.parametrize(
    ("axis", "degrees", "up"),
    [
        ((1, 0, 0), -90, "y"),
        ((1, 0, 0), 90, "-y"),
        ((0, 1, 0), 90, "x"),
        ((0, 1, 0), -90, "-x"),
        ((1, 0, 0), 180, "-z"),
    ],
)
def test_another_axis_that_is_up_in_all_images_is_named(
    axis: tuple[float, float, float], degrees: float, up: str
) -> None:
    for rotations in (ROUND, ROUND[:1], ROUND[1:3], rig((90, -20, 0)), rig((-90, -20, 0), (-80, -30, 0))):
        assert other_up_axis(turned(rotations, axis, degrees)) == up
        assert not is_upright(turned(rotations, axis, degrees))
        assert other_up_axis(rotations) is None


def test_ceiling_cameras_and_those_that_hang_upside_down_have_z_up() -> None:
    for pitch in range(-90, -75):
        assert other_up_axis(rig((90, pitch, 0))) is None
    for rotations in (rig((90, -85, 180)), rig((90, -30, 180)), rig((0, -44, 180)), rig((90, 30, 0))):
        assert other_up_axis(rotations) is None


def test_a_tilt_is_noticed_beyond_fifteen_degrees_where_horizons_agree():
    level = rig((0, -20, 0), (80, -35, 0), (170, -5, 0))
    assert is_upright(turned(level, (1, 1, 0), 14.9))
    assert not is_upright(turned(level, (1, 1, 0), 15.1))


def test_two_cameras_that_are_rolled_a_little_do_not_make_the_world_tilted():
    """Two horizons always agree on a vertical, here one 19 degrees off."""
    two = rig((0, -20, 14), (90, -35, 14))
    assert np.degrees(np.arccos(abs(vertical(two).up[2]))) > 15.0
    assert is_upright(two)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (1, 2, -3), (0, 0, -2), (1e-9, 0, -1)])
def test_the_turn_is_a_rotation_that_takes_up_to_z(up):
    R = turn_upright(np.array(up, dtype=np.float64))
    np.testing.assert_allclose(R @ up / np.linalg.norm(up), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("up", [(0, 0, 0), (np.nan, 0, 1)])
def test_no_direction_is_refused(up):
    with pytest.raises(ValueError, match="no direction"):
        turn_upright(np.array(up, dtype=np.float64))


def test_a_turned_world_is_turned_back():
    for _ in range(5):
        axis = tuple(RNG.standard_normal(3).tolist())
        wrong = turned(ROUND, axis, float(RNG.uniform(0, 180)))
        back = turn_upright(vertical(wrong).up) @ wrong
        assert is_upright(back)
        np.testing.assert_allclose(vertical(back).up, [0, 0, 1], atol=1e-9)

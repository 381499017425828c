"""Where the search starts: ground planes of single cameras, and congruent paths of pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walking_people import boxes, cameras, people

from occlog.calibrate.people import on_grid
from occlog.calibrate.starts.alignment import PairAlignment, PlanarPose, align_pair, joined
from occlog.calibrate.starts.ground_plane import ground_plane
from occlog.core.geometry.camera import angles_from_rotation


@pytest.mark.parametrize("placed", [True, False])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_ground_plane_of_one_camera(placed: bool, number: int) -> None:
    """Pitch and height from boxes alone, and from a pose that is 5 degrees and 0.5 m off."""
    camera = cameras()[number]
    _, pitch, roll = angles_from_rotation(camera.rotation)
    seen = np.concatenate(boxes(camera, np.arange(0.0, 60.0, 0.2), np.random.default_rng(1)))
    found = ground_plane(
        replace(camera, position=camera.position + np.array([0.0, 0.0, 0.5]), placed=placed), seen, 1.7
    )
    assert found is not None
    assert abs(np.degrees(found.pitch - pitch)) < 1.5
    assert abs(np.degrees(found.roll - roll)) < 1.5
    assert found.height == pytest.approx(camera.position[2], rel=0.08)


def test_ground_plane_wants_boxes() -> None:
    """29 boxes are too few."""
    assert ground_plane(cameras()[0], np.tile([100.0, 100.0, 150.0, 250.0], (29, 1)), 1.7) is None


@pytest.mark.parametrize("late", [0, 3, -2])
def test_pair_is_aligned_by_its_paths(late: int) -> None:
    """A turn of 130 degrees, a translation of 7 m and an offset of the clock, with other people in each camera."""
    pose = PlanarPose(np.radians(130.0), 6.0 - 3.5j, float(late))
    rng = np.random.default_rng(2)
    times = np.arange(0.0, 40.0, 0.25)
    xy = people(times)
    world = (xy[..., 0] + 1j * xy[..., 1]).T
    shifted = people(times - 0.25 * late)
    own = (shifted[..., 0] + 1j * shifted[..., 1]).T
    b = np.exp(-1j * pose.yaw) * (own - pose.position)
    noise = rng.normal(0.0, 0.1, (2, *world.shape, 2)) @ [1.0, 1j]
    a, b = world[:3] + noise[0][:3], b[1:] + noise[1][1:]
    found = align_pair(a, b, 0.25, 1.7, 4)
    assert found is not None
    assert abs(np.degrees(np.angle(np.exp(1j * (found[0].yaw - pose.yaw))))) < 1.5
    assert abs(found[0].position - pose.position) < 0.25
    # To a step: the adjustment finds the rest
    assert abs(found[0].late - late) <= 1
    assert found[2] > 0.4


def test_cameras_are_joined_along_pairs() -> None:
    """Three cameras by two pairs, one of them the other way round; a fourth has no pair with support."""
    first, second = PlanarPose(0.5, 1.0 + 2.0j, 1.0), PlanarPose(-0.2, 3.0j, 2.0)
    pairs = [
        PairAlignment(0, 1, first, 90.0, 0.8),
        PairAlignment(1, 2, second, 80.0, 0.8),
        PairAlignment(2, 3, first, 10.0, 0.1),
    ]
    poses = joined(4, pairs)
    assert poses[1] == PlanarPose(0.0, 0.0j, 0.0)
    assert poses[3] is None
    assert poses[0] is not None
    back = poses[0].of(first)
    assert (back.yaw, abs(back.position), back.late) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert poses[2] == second


def test_paths_on_a_grid_have_gaps() -> None:
    """Linear between samples; nothing outside of them and in gaps."""
    found = on_grid(np.array([1.0, 2.0, 5.0]), np.array([0.0, 2.0 + 1.0j, 0.0]), np.arange(0.5, 6.0), 1.5)
    np.testing.assert_array_equal(np.isfinite(found), [False, True, False, False, False, False])
    assert found[1] == 1.0 + 0.5j

"""Where targets can be in a scene without a room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from occlog.core.plane import inside_polygon, signed_area
from occlog.errors import InputError
from occlog.records.scene import (
    Camera,
    MicrophoneArray,
    Scene,
    camera_fov,
    camera_rotation,
    highest_elevation,
    sight_limit,
)


def camera(x=0.0, y=0.0, yaw=0.0, pitch=0.0, roll=0.0, z=0.0, focal=500.0, size=(640, 480), **more) -> Camera:
    rotation = camera_rotation(np.radians(yaw), np.radians(pitch), np.radians(roll))
    focal_px, principal, none = np.full(2, focal), 0.5 * np.array(size) - 0.5, np.zeros(5)
    fov = camera_fov(size, focal_px, principal, none, "brown", rotation)
    return Camera("c", np.array([x, y, z]), rotation, focal_px, principal, size, **({"fov": fov} | more))


def inside(scene: Scene, *positions: tuple[float, float]) -> list[bool]:
    return inside_polygon(np.array(positions, dtype=np.float64), scene.region).tolist()


def test_a_room_is_the_region_and_there_is_no_prior_of_views():
    room = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
    scene = Scene(cameras=(camera(),), room=room)
    assert scene.region is room
    assert scene.surroundings is room
    assert scene.views is None


def test_the_range_of_a_camera_limits_its_wedge():
    scene = Scene(cameras=(camera(range=12.0),))
    assert scene.views is not None
    assert scene.views.far.tolist() == [12.0]
    assert inside(scene, (11.9, 0.0), (12.3, 0.0), (-5.0, 0.0)) == [True, False, False]
    assert signed_area(scene.region) > 0.0


def test_without_a_range_a_person_is_seen_down_to_a_fiftieth_of_the_field_of_view():
    c = camera(fov=0.85)
    assert sight_limit(c, least=1.0, metre=1.0) == pytest.approx(1.7 / (0.02 * 0.85))
    assert sight_limit(c, least=1.0, metre=100.0) == pytest.approx(170.0 / (0.02 * 0.85))
    # At least twice the extent of all sensors
    assert sight_limit(c, least=150.0, metre=1.0) == 150.0
    # In a unit of its own half the camera's height stands for a person
    assert sight_limit(replace(c, position=np.array([0.0, 0.0, 340.0])), 1.0, None) == pytest.approx(170 / 0.017)


@pytest.mark.parametrize("roll", [0.0, 180.0])
def test_a_camera_whose_image_ends_below_the_horizon_sees_the_ground_up_to_its_upper_border(roll):
    c = camera(z=4.0, pitch=-45.0, roll=roll)
    upper = -np.arcsin(np.sqrt(0.5) * (500.0 - 240.0) / np.sqrt(320.0**2 + 240.0**2 + 500.0**2))  # of its corners
    assert highest_elevation(c) == pytest.approx(upper)
    assert sight_limit(c, 1.0, 1.0) == pytest.approx(4.0 / np.tan(-upper))
    # Height unknown (0), or not above a person: the ground says nothing
    assert sight_limit(replace(c, position=np.zeros(3)), 1.0, 1.0) > 20.0
    assert sight_limit(replace(c, position=np.array([0.0, 0.0, 1.7])), 1.0, 1.0) > 20.0
    # The horizon is in the image
    assert sight_limit(camera(z=4.0, pitch=-10.0, roll=roll), 1.0, 1.0) > 50.0
    assert highest_elevation(replace(c, image_size=None)) is None


def test_a_lens_that_bends_its_border_up_sees_farther():
    bent = camera(z=4.0, pitch=-45.0, distortion=np.array([-0.2, 0.0, 0.0, 0.0, 0.0]))
    assert sight_limit(bent, 1.0, 1.0) > sight_limit(camera(z=4.0, pitch=-45.0), 1.0, 1.0)


def test_a_camera_that_looks_straight_down_sees_all_around_but_not_far():
    scene = Scene(cameras=(camera(z=5.0, pitch=-89.9),))
    assert scene.views is not None
    assert scene.views.fov[0] == pytest.approx(2.0 * np.pi)
    assert scene.views.far[0] < 5.0
    assert inside(scene, (2.0, 2.0), (-2.0, -2.0), (9.0, 0.0)) == [True, True, False]


def test_parallel_cameras_see_far_beyond_the_box_around_them_and_facing_ones_what_is_between():
    parallel = Scene(cameras=(camera(y=0.0), replace(camera(y=2.0), name="d")))
    assert inside(parallel, (30.0, 1.0), (-5.0, 1.0)) == [True, False]
    facing = Scene(cameras=(camera(range=9.0), replace(camera(x=8.0, yaw=180.0, range=9.0), name="d")))
    assert inside(facing, (4.0, 0.0), (-1.0, 0.0), (4.0, 3.0), (4.0, 9.0)) == [True, True, True, False]


def test_arrays_hear_all_around_to_their_range_or_twenty_metres():
    scene = Scene(arrays=(MicrophoneArray("a", np.zeros(3)), MicrophoneArray("b", np.array([1.0, 0, 0]), range=5.0)))
    assert scene.views is not None
    assert scene.views.far.tolist() == [20.0, 5.0]
    assert inside(scene, (-19.9, 0.0), (0.0, 19.9), (25.0, 0.0)) == [True, True, False]
    feet = replace(scene, length_unit="ft")
    assert feet.views is not None
    assert feet.views.far[0] == pytest.approx(20.0 / 0.3048)


def test_a_camera_without_a_pose_sees_nothing():
    blind = replace(camera(yaw=180.0), name="blind", placed=False)
    alone, both = Scene(cameras=(camera(),)), Scene(cameras=(camera(), blind))
    np.testing.assert_array_equal(alone.region, both.region)
    assert both.views is not None
    assert both.views.share.tolist() == [1.0, 0.0]


def test_metres_and_feet_are_alike():
    metres, k = Scene(cameras=(camera(z=2.0), camera(x=3.0, yaw=120.0, z=2.0))), 1.0 / 0.3048
    cameras = tuple(replace(c, position=k * c.position) for c in metres.cameras)
    feet = Scene(cameras=cameras, length_unit="ft")
    assert metres.views is not None
    assert feet.views is not None
    np.testing.assert_allclose(feet.views.far, k * metres.views.far, rtol=0.02)


def test_a_simulated_world_without_a_room_is_a_box_around_the_sensors():
    scene = Scene(cameras=(camera(), camera(x=10.0, y=4.0)))
    low, high = scene.surroundings.min(axis=0), scene.surroundings.max(axis=0)
    assert low.tolist() == [-2.0, -2.0]
    assert high.tolist() == [12.0, 6.0]


def test_a_scene_with_neither_room_nor_sensor_is_refused():
    for name in ("views", "region", "surroundings"):
        with pytest.raises(InputError, match="neither a room nor a sensor"):
            getattr(Scene(), name)

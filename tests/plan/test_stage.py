"""What is planned: closed forms, probabilities of being seen by themselves, and sensors that only ever help."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.plan import rooms
from occlog.array_types import Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.core.occlusion.blocking_probability import shares
from occlog.core.occlusion.priors import polygon_priors
from occlog.errors import InputError
from occlog.plan.config import PlanConfig
from occlog.plan.filtering import FilterNoise, Motion, Reports, errors_along, square_error_in_room
from occlog.plan.sensing import hide_behind_crowd, information_of_sensor, share_below_heads, unoccluded_view
from occlog.plan.stage import (
    PreparedPlan,
    add_greedily,
    along_walls,
    expected_error,
    plan_map,
    prepare,
    rank_candidates,
    rank_removal,
)
from occlog.plan.walks import Walked
from occlog.records.scene import Camera, MicrophoneArray, Scene

ROOM = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 6.0]])
SMALL = replace(PlanConfig.in_unit("m"), cells=36, samples_per_cell=8, settling_s=3.0)


def camera(name: str, x: float, y: float, yaw_deg: float, z: float = 0.0) -> Camera:
    return Camera(
        name=name,
        position=np.array([x, y, z]),
        rotation=rotation_from_angles(math.radians(yaw_deg), 0.0, 0.0),
        focal_px=np.full(2, 160.0),
        principal_px=np.array([159.5, 119.5]),
        image_size=(320, 240),
        fov=math.radians(90.0),
    )


CORNERS = (
    camera("sw", 0.0, 0.0, 45.0),
    camera("se", 6.0, 0.0, 135.0),
    camera("ne", 6.0, 6.0, 225.0),
    camera("nw", 0.0, 6.0, 315.0),
)


def planned(*sensors: Camera, people: int = 0, config: PlanConfig = SMALL) -> PreparedPlan:
    return prepare(Scene(cameras=sensors, room=ROOM), replace(config, people=people), seed=1)


def lonely(ways: Floats) -> Walked:
    """Targets among no one."""
    none = np.zeros(len(ways), dtype=np.int64)
    return Walked(ways, np.empty((ways.shape[1], 0, 2)), none, none - 1, 0.1)


def known_at_once(walked: Walked, *sensors: MicrophoneArray) -> Floats:
    """(2, 2) covariance of a place that may be anywhere, after one report of each sensor."""
    reported = [
        information_of_sensor(s, Scene(arrays=sensors, room=ROOM), walked, SMALL, 0).information for s in sensors
    ]
    total = np.sum(reported, axis=0)
    start = np.zeros(2), 1e8 * np.eye(2)
    reports = Reports(total, np.zeros((2, *total.shape[1:])))
    found = errors_along(walked.ways, reports, start, Motion(1.2, 0.4, 0.05), FilterNoise(0.1, 0.5), 0.1)
    return found.covariance[0, 0]


def told_of(plan: PreparedPlan, sensor: Camera | MicrophoneArray):
    return information_of_sensor(sensor, plan.scene, plan.walked, plan.config, plan.seed)


def test_two_arrays_at_right_angles_tell_a_circle_as_wide_as_their_noise_at_that_distance():
    west = MicrophoneArray("west", np.array([-4.0, 0.0, 0.9]), sigma=0.05)
    south = MicrophoneArray("south", np.array([0.0, -4.0, 0.9]), sigma=0.05)
    found = known_at_once(lonely(np.zeros((1, 1, 2))), west, south)
    np.testing.assert_allclose(found, (0.05 * 4.0) ** 2 * np.eye(2), rtol=1e-6, atol=1e-8)


def test_one_array_tells_nothing_along_its_sight_line():
    west = MicrophoneArray("west", np.array([-4.0, 0.0, 0.9]), sigma=0.05)
    alone = known_at_once(lonely(np.zeros((1, 1, 2))), west)
    assert alone[0, 0] == pytest.approx(1e8)
    assert alone[1, 1] == pytest.approx(0.04)


def test_what_is_not_seen_is_somewhere_in_the_room():
    x = (np.arange(60) + 0.5) / 10.0
    floor = np.column_stack([np.tile(x, 60), np.repeat(x, 60)])
    variance = np.array([1e8, 1.0, 1e-4])
    normals = variance[:, None, None] * np.eye(2)
    middle = square_error_in_room(normals, np.full((3, 2), 3.0), floor, np.full(2, 0.1))
    # Uniform; a normal cut off at three deviations to either side; hardly cut off
    cut = 1.0 - 2.0 * 3.0 * math.exp(-4.5) / math.sqrt(2.0 * math.pi) / math.erf(3.0 / math.sqrt(2.0))
    assert middle == pytest.approx([2 * 36.0 / 12.0, 2.0 * cut, 2e-4], rel=2e-3)
    # Half of a normal at a wall
    wall = square_error_in_room(normals, np.array([[3.0, 0.0]] * 3), floor, np.full(2, 0.1))
    assert wall[1] == pytest.approx(cut + 1.0 - 2.0 / math.pi, rel=5e-3)


@pytest.mark.parametrize("people", [0, 5])
def test_more_cameras_make_the_prediction_better_everywhere(people: int):
    plan = planned(*CORNERS[:2], people=people)
    more = prepare(replace(plan.scene, cameras=CORNERS), plan.config, seed=1)
    few, many = plan_map(plan), plan_map(more)
    assert (many.rmse <= few.rmse).all()
    assert (many.unlocalised_share <= few.unlocalised_share).all()
    assert (many.seen_by_2 >= few.seen_by_2).all()
    assert many.rmse.mean() < 0.8 * few.rmse.mean()


def test_a_symmetric_room_gives_a_symmetric_map_within_its_error():
    table = plan_map(planned(*CORNERS, config=replace(SMALL, samples_per_cell=64)))
    order = np.lexsort([table.x, table.y])
    rmse, error = (v[order].reshape(6, 6) for v in (table.rmse, table.rmse_error))
    for turn in (np.fliplr, np.flipud, np.transpose):
        off = (rmse - turn(rmse)) / np.hypot(error, turn(error)).clip(0.02 * rmse)
        assert np.abs(off).max() < 5.0
    assert table.seen_by_2.min() == 1.0


def test_a_crowd_hides_as_often_as_the_exact_shares_say():
    rng = np.random.default_rng(3)
    moments, n, place = 4000, 6, np.array([4.0, 3.5])
    crowd = rng.uniform(0.0, 6.0, (moments, n, 2))
    ways = np.broadcast_to(place, (moments, 1, 2)).copy()
    walked = Walked(ways, crowd, np.arange(moments), np.full(moments, -1), 0.1)
    # Without the discs that would stand in the target itself, which are drawn again
    near = np.hypot(*(crowd - place).transpose(2, 0, 1)) < SMALL.person_diameter
    while near.any():
        crowd[near] = rng.uniform(0.0, 6.0, (int(near.sum()), 2))
        near = np.hypot(*(crowd - place).transpose(2, 0, 1)) < SMALL.person_diameter
    sensors = CORNERS[:2]
    scene = Scene(cameras=sensors, room=ROOM)
    seen = np.stack([unoccluded_view(s, scene, walked, replace(SMALL, people=n))[:, 0] for s in sensors])
    # Exact: one disc, uniform over the room without the circle about the target, hides from a set of cameras
    cameras = np.array([s.ground for s in sensors])
    whole = shares(place[0], place[1], cameras, polygon_priors([ROOM], SMALL.person_diameter), 0)
    circle = [
        place + SMALL.person_diameter * np.array([math.cos(a), math.sin(a)]) for a in np.arange(256) * math.pi / 128
    ]
    hole = shares(place[0], place[1], cameras, polygon_priors([np.array(circle)], SMALL.person_diameter), 0)
    part = math.pi * SMALL.person_diameter**2 / 36.0
    one = (whole - part * hole) / (1.0 - part)
    both = one[0] ** n
    for i, bit in enumerate((1, 2)):
        alone = (one[0] + one[3 - bit]) ** n
        assert seen[i].mean() == pytest.approx(alone, abs=4.0 * math.sqrt(alone * (1.0 - alone) / moments))
    assert seen.all(axis=0).mean() == pytest.approx(both, abs=4.0 * math.sqrt(both * (1.0 - both) / moments))


def test_a_camera_above_heads_is_hidden_from_by_people_near_the_target_lonely():
    high = camera("high", 0.0, 0.0, 45.0, z=3.0)
    config = replace(SMALL, height=1.8, target_height=0.9)
    assert share_below_heads(high, config) == pytest.approx(1.2 / 2.1)
    assert share_below_heads(high, SMALL) == 0.0
    assert share_below_heads(high, replace(config, target_height=1.9)) == 1.0
    for along, hidden in ((0.5, False), (0.6, True), (0.8, True)):
        seen, ways = np.ones((1, 1), dtype=np.bool_), np.full((1, 1, 2), 4.0)
        crowd = np.full((1, 1, 2), 4.0 * along)
        zero = np.zeros(1, dtype=np.int64)
        hide_behind_crowd(seen, ways, np.zeros(2), crowd, zero, zero - 1, 0.5, 1.2 / 2.1)
        assert bool(seen[0, 0]) is not hidden


def test_greed_finds_the_best_pair_with_its_first_and_rankings_are_those_of_single_plans():
    plan = planned(CORNERS[0], people=3)
    candidates = [*CORNERS[1:], camera("mid", 3.0, 0.0, 90.0), camera("near", 0.3, 0.0, 45.0)]
    ranked = rank_candidates(plan, candidates)
    errors = {p.sensor.name: p.rmse for p in ranked}
    own = list(plan.information.values())
    for sensor in candidates:
        assert errors[sensor.name] == pytest.approx(expected_error(plan, [*own, told_of(plan, sensor)]))
    added = list(add_greedily(plan, ranked, 2))
    pairs = {
        pair: expected_error(plan, [*own, *(told_of(plan, s) for s in pair)])
        for pair in itertools.combinations(candidates, 2)
    }
    assert added[0].rmse == min(errors.values())
    with_first = [error for pair, error in pairs.items() if added[0].sensor in pair]
    assert added[1].rmse == pytest.approx(min(with_first))
    assert added[1].rmse <= 1.25 * min(pairs.values())
    assert "near" not in {p.sensor.name for p in added}


def test_the_least_needed_camera_is_the_double_one():
    plan = planned(*CORNERS, camera("double", 0.2, 0.0, 45.0), people=3)
    assert {p.sensor.name for p in rank_removal(plan)[:2]} == {"sw", "double"}


def test_a_camera_that_detects_nothing_sees_no_one():
    blind = [replace(each, detection=0.0) for each in CORNERS]
    found = plan_map(planned(*blind))
    np.testing.assert_array_equal(found.seen_by_0, 1.0)
    np.testing.assert_array_equal(found.unlocalised_share, 1.0)


def test_places_along_walls_look_inwards():
    found = along_walls(Scene(room=ROOM), CORNERS[0], spacing=3.0)
    assert len(found) == 8
    for sensor in found:
        to = ROOM.mean(axis=0) - sensor.ground
        np.testing.assert_allclose([math.cos(sensor.yaw), math.sin(sensor.yaw)], to / np.hypot(*to), atol=1e-9)


def test_a_slow_and_unsure_camera_sees_as_often_as_it_says():
    half = replace(CORNERS[0], rate_hz=5.0, detection=0.5)
    plan = planned(half, CORNERS[1])
    seen = plan.information["sw"].seen
    assert seen[:, -1].mean() == pytest.approx(0.5, abs=0.12)
    assert not seen[:, -2].any()
    assert plan.information["se"].seen.all()


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (Scene(cameras=CORNERS), "no room"),
        (Scene(room=ROOM), "no camera with a pose and no microphone array"),
    ],
)
def test_a_scene_without_room_or_sensors_is_refused(scene: Scene, words: str):
    with pytest.raises(InputError, match=words):
        prepare(scene, SMALL, seed=0)


@pytest.mark.parametrize(
    ("config", "words"),
    [
        (replace(SMALL, people=300), "no free position found"),
        (replace(SMALL, density=1e3), "must be at most 1000"),
        (replace(SMALL, samples_per_cell=5000, cells=5000), "take fewer cells or samples"),
    ],
)
def test_what_does_not_fit_is_refused(config: PlanConfig, words: str):
    with pytest.raises(InputError, match=words):
        prepare(Scene(cameras=CORNERS, room=ROOM), config, seed=0)


def test_paths_weigh_the_floor():
    paths = np.repeat([[0.5, 0.5], [5.5, 5.5], [50.0, 50.0]], [3, 1, 7], axis=0)
    plan = prepare(Scene(cameras=CORNERS, room=ROOM), SMALL, seed=0, paths=paths)
    assert sorted(plan.weight[plan.weight > 0]) == pytest.approx([0.25, 0.75])
    with pytest.raises(InputError, match="no position of --paths is in the room"):
        prepare(Scene(cameras=CORNERS, room=ROOM), SMALL, seed=0, paths=paths[-7:])


@pytest.mark.parametrize(
    ("steps", "runs", "ideal"), [(250, 2, 12), pytest.param(400, 4, 40, marks=pytest.mark.statistics)]
)
def test_the_simulated_filter_is_as_far_off_as_was_expected(
    monkeypatch: pytest.MonkeyPatch, steps: int, runs: int, ideal: int
):
    """A few runs in a room that is seen well, and the sight of more: two of 25 s and 12, or four of 40 s and 40.

    The error bar of the ratio is about 6 %, at most 8 %.
    """
    monkeypatch.setattr(rooms, "STEPS", steps)
    monkeypatch.setattr(rooms, "DRAWS", 16 if ideal == 12 else rooms.DRAWS)
    found = rooms.compare(rooms.Room(Scene(cameras=CORNERS[:3], room=ROOM), people=2), runs, ideal)
    assert found["error"] < 0.08 * found["found"]
    assert found["expected"] == pytest.approx(found["by_sight"], rel=0.1)
    assert found["ratio"] == pytest.approx(1.0, abs=0.25)

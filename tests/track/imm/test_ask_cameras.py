from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from heard_scenes import ROOM, line, room, rows, table

from occlog.scans.grouping import BearingRows, scans_of
from occlog.track.methods.imm.camera_requests import CameraQuestion, CameraRequests
from occlog.track.methods.imm.config import ImmConfig

CONFIG = ImmConfig.in_unit("m")
SCENE = room()
NS = 1_000_000_000
HERE, THERE = (9.0, 6.0), (12.0, 9.0)


def requests(bearings, scene=SCENE, config=CONFIG):
    made = CameraRequests(scene, config)
    for scan in scans_of([bearings], scene, BearingRows(frozenset(c.name for c in scene.cameras))):
        made.put(scan)
    return made


def standing(*, labels=True, only=("c1", "c2", "c3"), places=(HERE, THERE)):
    seen = rows(SCENE, {k: line(x, y, 0, 0) for k, (x, y) in enumerate(places)}, seconds=0.0, cameras=True)
    seen = seen.take(np.isin(seen.sensor, only))
    return seen if labels else replace(seen, target_id=np.full(len(seen), -1, dtype=np.int32))


def ask(number, place, *, label=-1, sigma=1.0, cause="spread"):
    return CameraQuestion(number, (cause,), label, np.array(place, dtype=float), sigma**2 * np.eye(2))


def test_the_best_pair_is_asked_and_finds_the_target():
    (request,) = requests(standing()).ask([ask(0, HERE)], [], 0)
    assert request.frames == 2
    np.testing.assert_allclose(request.answer.position, HERE, atol=1e-9)
    assert request.answer.label == 0
    # The same by the Fisher information of every pair
    best = min((("c1", "c2"), ("c1", "c3"), ("c2", "c3")), key=lambda p: variance(p, HERE))
    assert request.cameras == best


def variance(pair, place):
    g = []
    for name in pair:
        camera = next(c for c in SCENE.cameras if c.name == name)
        away = np.array(place) - camera.position[:2]
        sigma = math.hypot(camera.sigma_yaw, camera.sigma_read_px / camera.focal_px[0]) or math.radians(1)
        g.append(np.array([-away[1], away[0]]) / (away @ away) / sigma)
    return np.trace(np.linalg.inv(np.array(g).T @ np.array(g)))


def test_a_camera_that_cannot_see_the_place_is_not_asked():
    hidden = room(ROOM.replace("yaw_deg: 45", "yaw_deg: 225"))
    (request,) = requests(standing(), hidden).ask([ask(0, HERE)], [], 0)
    assert request.cameras == ("c2", "c3")


def test_frames_of_one_time_are_counted_once():
    found = requests(standing()).ask([ask(0, HERE), ask(1, (9.3, 6.2))], [], 0)
    assert [r.frames for r in found] == [2, 0]
    assert found[0].cameras == found[1].cameras


def test_whom_else_the_frames_show_is_reported_too():
    found = requests(standing()).ask([ask(0, HERE)], [ask(4, THERE, cause="shared")], 0)
    assert [(r.answer.ask.number, r.frames) for r in found] == [(0, 2), (4, 0)]
    np.testing.assert_allclose(found[1].answer.position, THERE, atol=1e-9)
    empty = requests(standing(places=(HERE,))).ask([ask(0, HERE)], [ask(4, THERE, cause="shared")], 0)
    assert [r.answer.ask.number for r in empty] == [0]


def test_labels_go_before_distance():
    found = requests(standing()).ask([ask(0, THERE, label=0), ask(1, HERE, label=1)], [], 0)
    np.testing.assert_allclose(found[0].answer.position, HERE, atol=1e-9)
    np.testing.assert_allclose(found[1].answer.position, THERE, atol=1e-9)


def test_another_ones_label_is_no_one_elses_place():
    found = requests(standing(places=(HERE,))).ask([ask(1, HERE), ask(0, THERE, label=0)], [], 0)
    assert found[0].answer.position is None
    np.testing.assert_allclose(found[1].answer.position, HERE, atol=1e-9)


def test_candidates_without_labels_are_matched_by_distance():
    found = requests(standing(labels=False)).ask([ask(0, (12.3, 8.7)), ask(1, (8.8, 6.3))], [], 0)
    np.testing.assert_allclose(found[0].answer.position, THERE, atol=1e-9)
    np.testing.assert_allclose(found[1].answer.position, HERE, atol=1e-9)


def test_no_one_near_is_no_answer():
    (request,) = requests(standing(labels=False)).ask([ask(0, (3.0, 13.0), sigma=0.3)], [], 0)
    assert request.answer.position is None
    assert request.frames == 2


@pytest.mark.parametrize(("age_s", "frames"), [(0.4, 2), (0.6, 0)])
def test_old_frames_are_none(age_s, frames):
    (request,) = requests(standing()).ask([ask(0, HERE)], [], round(age_s * NS))
    assert request.frames == frames
    assert (request.answer.position is not None) == (frames == 2)


def test_older_frames_tell_a_place_less_well():
    fresh, old = (requests(standing()).ask([ask(0, HERE)], [], round(s * NS))[0].answer.covariance for s in (0.0, 0.4))
    np.testing.assert_allclose(old - fresh, (CONFIG.sigma_initial_velocity * 0.4) ** 2 * np.eye(2), atol=1e-12)


def test_with_one_camera_nothing_is_asked():
    (request,) = requests(standing(only=("c1",))).ask([ask(0, HERE)], [], 0)
    assert (request.cameras, request.frames, request.answer.position) == ((), 0, None)


def test_who_is_found_twice_is_the_first_ones():
    observations = [
        (0, c.name, 3, math.atan2(HERE[1] - c.position[1], HERE[0] - c.position[0]), 0.01) for c in SCENE.cameras
    ]
    found = requests(table(observations)).ask([ask(0, HERE), ask(1, (9.2, 6.1))], [], 0)
    assert [r.answer.position is not None for r in found].count(True) == 1


def deviation_ratio(place):
    """Deviation with which c1 and c3 tell a place, to that of the best two cameras."""
    pairs = (("c1", "c2"), ("c1", "c3"), ("c2", "c3"))
    return math.sqrt(variance(("c1", "c3"), place) / min(variance(p, place) for p in pairs))


@pytest.mark.parametrize(("times", "cameras", "frames"), [(1.99, ("c1", "c3"), 0), (2.01, ("c1", "c2"), 1)])
def test_cameras_asked_already_do_up_to_twice_the_best_deviation(times, cameras, frames):
    near, far = 5.0, 7.0  # y [m] at x = 7 m, where the ratio rises from 1.6 to 2.3
    for _ in range(50):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if deviation_ratio((7.0, middle)) < times else (near, middle)
    first, second = requests(standing()).ask([ask(0, (13.0, 10.0)), ask(1, (7.0, near))], [], 0)
    assert first.cameras == ("c1", "c3")
    assert (second.cameras, second.frames) == (cameras, frames)


def test_answers_that_take_their_time_are_about_older_frames():
    moving = rows(SCENE, {0: line(*HERE, 1.0, 0.0)}, seconds=2.0, cameras=True)
    slow = replace(CONFIG, answer_delay_s=1.0, max_frame_age_s=0.1)
    now = int(moving.t_ns[-1])
    (late,) = requests(moving, config=slow).ask([ask(0, HERE, label=0)], [], now)
    (early,) = requests(moving).ask([ask(0, HERE, label=0)], [], now)
    np.testing.assert_allclose(early.answer.position - late.answer.position, [1.0, 0.0], atol=1e-6)
    # ... whose covariance is widened by what the target may have walked since
    assert late.answer.covariance[0, 0] > early.answer.covariance[0, 0] + 0.5 * CONFIG.sigma_initial_velocity**2


def test_nothing_is_known_before_the_first_answer_could_have_come():
    slow = replace(CONFIG, answer_delay_s=1.0)
    (request,) = requests(standing(), config=slow).ask([ask(0, HERE)], [], 0)
    assert request.answer.position is None
    assert request.frames == 0

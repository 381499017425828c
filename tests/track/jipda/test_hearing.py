"""Directions of arrival in the same state as boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from people_boxes import box, camera

from occlog.records.scene import MicrophoneArray, Scene
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.doa_update import update_by_directions
from occlog.track.methods.jipda.filter import initial_state, step
from occlog.track.methods.jipda.interface import DirectionsOfArrival, FrameDetections, TrackSnapshot

pytestmark = pytest.mark.jit
STEP_S, SIGMA = 0.1, 0.05
ARRAYS = (MicrophoneArray("left", np.array([0.0, 10.0, 1.5])), MicrophoneArray("right", np.array([10.0, 10.0, 1.5])))
CAMERAS = tuple(camera(name, range=7.0) for name in "ab")
"""They do not show the far half of the hall."""
SCENE = Scene(cameras=CAMERAS, arrays=ARRAYS, room=np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]))


def there(k: int) -> np.ndarray:
    """A person who walks to the far side of the hall and back, at 1 m/s."""
    way = k * STEP_S
    return np.array([5.0 + 0.1 * way, 2.0 + (way if way < 7.0 else 14.0 - way)])


def observation(c: int, k: int, rng: np.random.Generator) -> FrameDetections:
    edges = box(CAMERAS[c], *there(k)) + rng.normal(0.0, 1.0, 4)
    near = np.hypot(*(there(k) - CAMERAS[c].position[:2])) < CAMERAS[c].range
    n = int(near)
    none = np.zeros(n, dtype=np.int64)
    return FrameDetections(
        round(k * STEP_S * 1e9), c, edges[None][:n], np.ones(n), none - 1, np.zeros((n, 0)), none + 2 * k + c
    )


def direction(a: int, k: int, rng: np.random.Generator) -> DirectionsOfArrival:
    away = there(k) - ARRAYS[a].position[:2]
    bearing = np.array([np.arctan2(away[1], away[0]) + rng.normal(0.0, SIGMA), rng.uniform(-np.pi, np.pi)])
    return DirectionsOfArrival(round(k * STEP_S * 1e9), a, bearing, np.full(2, SIGMA), np.arange(2))


def followed(sound: bool) -> list[TrackSnapshot]:
    rng = np.random.default_rng(1)
    state, found = initial_state(SCENE, CAMERAS, JipdaConfig()), []
    for k in range(130):
        heard = [direction(a, k, rng) for a in range(2)]
        for each in heard if sound else []:
            state = update_by_directions(state, each, ARRAYS[each.sensor])
        state, snapshot = step(state, [observation(c, k, rng) for c in range(2)])
        found.append(snapshot)
    return found


def test_who_speaks_is_followed_where_no_camera_shows_them_and_keeps_the_identity() -> None:
    heard, unheard = followed(True), followed(False)
    ids = {i for moment in heard for i in moment.ids.tolist()}
    assert len(ids) == 1
    # Where no camera shows the place: from 5.8 m on, a second and more after the last box
    hidden = range(50, 95)
    assert all(len(heard[k].ids) == 1 for k in hidden)
    off = [np.hypot(*(heard[k].mean[0, :2] - there(k))) for k in hidden]
    assert np.median(off) < 0.5
    # Without sound they are given up, and somebody new when they come back
    assert any(len(unheard[k].ids) == 0 for k in hidden)
    assert len({i for moment in unheard for i in moment.ids.tolist()}) == 2


def test_the_covariance_holds_the_error() -> None:
    heard = followed(True)
    nees = []
    for k in range(50, 95):
        error = heard[k].mean[0, :2] - there(k)
        nees.append(error @ np.linalg.solve(heard[k].covariance[0, :2, :2], error))
    assert np.mean(nees) < 4.0


def test_a_direction_of_no_person_moves_no_one() -> None:
    rng = np.random.default_rng(2)
    state = initial_state(SCENE, CAMERAS, JipdaConfig())
    for k in range(10):
        state, _ = step(state, [observation(c, k, rng) for c in range(2)])
    away = there(10) - ARRAYS[0].position[:2]
    other = DirectionsOfArrival(
        round(1e9), 0, np.array([np.arctan2(away[1], away[0]) + 1.0]), np.array([SIGMA]), np.arange(1)
    )
    after = update_by_directions(state, other, ARRAYS[0])
    np.testing.assert_allclose(after.people.mean, state.people.mean, atol=1e-9)
    silent = replace_bearings(other)
    assert update_by_directions(state, silent, ARRAYS[0]) is state


def replace_bearings(heard: DirectionsOfArrival) -> DirectionsOfArrival:
    """The same time, and nothing heard."""
    return heard._replace(bearing=np.zeros(0), sigma=np.zeros(0), row=np.zeros(0, dtype=np.int64))


def test_an_array_says_nothing_of_who_is_out_of_its_range() -> None:
    rng = np.random.default_rng(3)
    state = initial_state(SCENE, CAMERAS, JipdaConfig())
    for k in range(10):
        state, _ = step(state, [observation(c, k, rng) for c in range(2)])
    heard = direction(0, 10, rng)
    deaf = replace(ARRAYS[0], range=3.0)
    np.testing.assert_allclose(update_by_directions(state, heard, deaf).people.mean, state.people.mean, atol=1e-9)
    assert not np.allclose(update_by_directions(state, heard, ARRAYS[0]).people.mean, state.people.mean, atol=1e-6)

"""The filter in space on scans of arrays: what it says of a still target, and how it starts."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.scene import MicrophoneArray, Scene
from occlog.trackers import direct3d
from occlog.trackers.method import Scan
from occlog.trackers.space_config import Direct3dConfig

SOURCE = np.array([3.0, 2.0, 1.4])
ROOM = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]])
PLACES = [(0.0, 0.0, 1.0), (8.0, 0.0, 2.5), (4.0, 6.0, 0.5)]
SIGMA = 0.02


def room(places=PLACES, **options) -> Scene:
    arrays = tuple(MicrophoneArray(f"a{i}", np.array(p), sigma=SIGMA, **options) for i, p in enumerate(places))
    return Scene(arrays=arrays, room=ROOM, room_height=3.0)


def scan(scene: Scene, t_s: float, sensors, xyz=SOURCE, labelled=True, elevation=True) -> Scan:
    """Exact directions of a source."""
    to = xyz - np.array([scene.arrays[i].position for i in sensors])
    n, none = len(sensors), np.full(len(sensors), np.nan)
    return Scan(
        round(t_s * 1e9), np.array(sensors), np.full(n, labelled), np.ones(n, dtype=bool),
        np.arctan2(to[:, 1], to[:, 0]),
        np.full(n, SIGMA), none, none, none,
        elevation=np.arctan2(to[:, 2], np.hypot(to[:, 0], to[:, 1])) if elevation else none,
        sigma_elevation=np.full(n, SIGMA) if elevation else none,
    )  # fmt: skip


def run(scene: Scene, scans, seed=0, **settings):
    rng = np.random.default_rng(seed)
    state = direct3d.init(scene, Direct3dConfig(**settings), rng)
    for one in scans:
        state, estimate = direct3d.step(state, one, rng)
    return estimate


def place(estimate):
    return np.array([*estimate.xy, estimate.height.z])


@pytest.mark.parametrize("likelihood", ["product", "cone"])
@pytest.mark.parametrize("labelled", [True, False])
def test_exact_directions_lead_to_the_source_without_a_start(likelihood, labelled) -> None:
    scene = room()
    scans = [scan(scene, 0.1 * k, [0, 1, 2], labelled=labelled) for k in range(15)]
    estimate = run(scene, scans, likelihood=likelihood, particles=1000, start_factor=5)
    np.testing.assert_allclose(place(estimate), SOURCE, atol=0.05)
    assert estimate.height.covariance[2] < 0.05**2
    assert estimate.fallback == ""


def test_arrays_that_speak_in_turn_at_uneven_times_lead_there_too() -> None:
    scene = room()
    times = np.cumsum(np.random.default_rng(3).exponential(0.07, 60))
    estimate = run(scene, [scan(scene, t, [k % 3]) for k, t in enumerate(times)], particles=1000, start_factor=5)
    np.testing.assert_allclose(place(estimate), SOURCE, atol=0.1)


def test_azimuths_alone_leave_the_height_to_the_room() -> None:
    scene = room()
    estimate = run(scene, [scan(scene, 0.1 * k, [0, 1, 2], elevation=False) for k in range(10)], particles=2000)
    np.testing.assert_allclose(estimate.xy, SOURCE[:2], atol=0.1)
    assert np.sqrt(estimate.height.covariance[2]) > 0.5  # 0.87 when even over 3 m


def test_a_wrong_start_is_left_for_what_the_arrays_say() -> None:
    scene = room()
    scans = [scan(scene, 0.1 * k, [0, 1, 2]) for k in range(20)]
    estimate = run(scene, scans, start=(7.0, 5.0, 2.5, 0.1), particles=1000, start_factor=2)
    np.testing.assert_allclose(place(estimate), SOURCE, atol=0.2)


@pytest.mark.parametrize("start", [(1.0, 2.0), (1.0, 2.0, -1.0), (1.0,) * 5, (1.0,) * 11 + (-1.0,)])
def test_a_start_of_no_known_form_is_refused(start) -> None:
    with pytest.raises(InputError, match=r"start is .* must be X,Y,SIGMA"):
        Direct3dConfig(start=start)

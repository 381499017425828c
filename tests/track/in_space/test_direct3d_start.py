"""The filter in space on scans of arrays: what it says of a still target, and how it starts."""

from __future__ import annotations

import numpy as np
import pytest
from space_scenes import SOURCE, place, room, run, scan

from occlog.errors import InputError
from occlog.track.methods.in_space.config import Direct3dConfig

pytestmark = pytest.mark.jit


@pytest.mark.parametrize("likelihood", ["product", "cone"])
@pytest.mark.parametrize("labelled", [True, False])
def test_exact_directions_lead_to_the_source_without_a_start(likelihood, labelled) -> None:
    scene = room()
    scans = [scan(scene, 0.1 * k, [0, 1, 2], labelled=labelled) for k in range(15)]
    estimate = run(scene, scans, likelihood=likelihood, particles=1000, initial_particle_factor=5)
    np.testing.assert_allclose(place(estimate), SOURCE, atol=0.05)
    assert estimate.height.covariance[2] < 0.05**2
    assert estimate.fallback == ""


def test_arrays_that_speak_in_turn_at_uneven_times_lead_there_too() -> None:
    scene = room()
    times = np.cumsum(np.random.default_rng(3).exponential(0.07, 60))
    estimate = run(
        scene, [scan(scene, t, [k % 3]) for k, t in enumerate(times)], particles=1000, initial_particle_factor=5
    )
    np.testing.assert_allclose(place(estimate), SOURCE, atol=0.1)


def test_azimuths_alone_leave_the_height_to_the_room() -> None:
    scene = room()
    estimate = run(scene, [scan(scene, 0.1 * k, [0, 1, 2], elevation=False) for k in range(10)], particles=2000)
    np.testing.assert_allclose(estimate.xy, SOURCE[:2], atol=0.1)
    assert np.sqrt(estimate.height.covariance[2]) > 0.5  # 0.87 when even over 3 m


def test_a_wrong_start_is_left_for_what_the_arrays_say() -> None:
    scene = room()
    scans = [scan(scene, 0.1 * k, [0, 1, 2]) for k in range(20)]
    estimate = run(scene, scans, start=(7.0, 5.0, 2.5, 0.1), particles=1000, initial_particle_factor=2)
    np.testing.assert_allclose(place(estimate), SOURCE, atol=0.2)


@pytest.mark.parametrize("start", [(1.0, 2.0), (1.0, 2.0, -1.0), (1.0,) * 5, (1.0,) * 11 + (-1.0,)])
def test_a_start_of_no_known_form_is_refused(start) -> None:
    with pytest.raises(InputError, match=r"start is .* must be X,Y,SIGMA"):
        Direct3dConfig(start=start)

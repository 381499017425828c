"""Geometries that are hard for bearings: stated covariances hold, or the diagnostics say that they do not tell."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np
import pytest
from tracker_scenes import ROOM, SECOND, camera, observe, room100, walk

from occlog.array_types import Floats
from occlog.consistency.estimates import covariances
from occlog.core.metrics.errors import CHI2_95_2D, normalised_squared_errors
from occlog.records.scene import Scene
from occlog.records.tables import Diagnostics, Tracks
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask

pytestmark = pytest.mark.jit
STEPS = 100


class Found(NamedTuple):
    """How a target was tracked."""

    nees: float
    outside: float  # share of the rows outside the stated 95 % ellipse
    fallbacks: Counter[str]
    rows: int


def followed(scene: Scene, path: Floats, method: str, seed: int) -> Found:
    bearings = observe(scene, path, np.random.default_rng(seed))
    config = configure(settings_of(method).in_unit("unit"), {})
    parts = list(track([bearings], scene, TrackingTask(config, seed, method=method)))
    tracks, notes = Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)
    away = np.column_stack([tracks.x, tracks.y]) - path[np.rint(tracks.t_ns / SECOND).astype(int)]
    nees = normalised_squared_errors(away, covariances(tracks))
    return Found(float(nees.mean()), float(np.mean(nees > CHI2_95_2D)), Counter(notes.fallback.tolist()), len(tracks))


@pytest.mark.parametrize("method", ["apf", "map", "fix"])
def test_a_target_that_walks_into_a_camera_is_known_as_stated(method: str) -> None:
    rng = np.random.default_rng(2)
    path = np.linspace([90.0, 60.0], [1.5, 50.5], STEPS) + 0.07 * rng.standard_normal((STEPS, 2)).cumsum(axis=0)
    found = followed(room100(pillar=False), path, method, 0)
    assert (found.rows, found.nees < 2.5, found.outside < 0.08) == (STEPS, True, True)


@pytest.mark.statistics
@pytest.mark.parametrize("method", ["apf", "map", "fix"])
def test_a_target_on_the_line_of_all_cameras_is_known_as_stated(method: str) -> None:
    """Sight lines are parallel but for noise; without the uncertainty of distances `fix` has a NEES of 1e5."""
    scene = Scene((camera("a", (0, 50), 0), camera("b", (30, 50), 0), camera("c", (100, 50), 180)), room=ROOM)
    path = np.column_stack([np.linspace(10, 95, STEPS), 50.0 + 0.2 * np.random.default_rng(3).standard_normal(STEPS)])
    found = [followed(scene, path, method, seed) for seed in range(2)]
    assert np.mean([f.nees for f in found]) < 4.0
    assert np.mean([f.outside for f in found]) < 0.15


def test_bearings_that_say_nothing_have_a_flag_or_a_wide_covariance() -> None:
    """300 px of noise with a focal length of 70 px."""
    scene = room100(pillar=False, sigma_read_px=300.0)
    path = walk(STEPS, np.random.default_rng(4))
    assert followed(scene, path, "fix", 0).nees < 2.0
    assert followed(scene, path, "map", 0).fallbacks["unobservable"] > 0.5 * STEPS

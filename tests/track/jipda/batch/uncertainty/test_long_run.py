"""What errors of boxes are in the long run, and covariances that hold it."""

from functools import cache

import numpy as np
import pytest
from crowds import crowd

from occlog.settings import configure
from occlog.track.methods.jipda.batch.smooth import smooth
from occlog.track.methods.jipda.batch.uncertainty import long_run_variance
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.filter import initial_state, step


def correlated(r, series, observations):
    """Series of unit variance whose correlation falls by r from look to look: their keys, looks and values."""
    generator = np.random.default_rng(0)
    value = [generator.normal(size=series)]
    for _ in range(observations - 1):
        value.append(r * value[-1] + np.sqrt(1.0 - r * r) * generator.normal(size=series))
    key, observation = np.meshgrid(np.arange(series), np.arange(observations), indexing="ij")
    return key.ravel(), observation.ravel(), np.transpose(value).ravel()


@pytest.mark.parametrize("r", [0.0, 0.6])
def test_the_long_run_variance_of_geometric_errors_is_known(r):
    key, observation, value = correlated(r, 400, 60)
    expected = (1.0 + r) / (1.0 - r)
    assert long_run_variance(key, observation, value, 15) == pytest.approx(expected, rel=0.1)


def test_looks_of_other_series_and_looks_that_are_missing_are_not_compared():
    key, observation, value = np.array([0, 0, 1, 1]), np.array([0, 2, 0, 3]), np.array([1.0, 1.0, 1.0, -1.0])
    assert long_run_variance(key, observation, value, 1) == 1.0
    assert long_run_variance(key, observation, value, 2) == 3.0
    assert long_run_variance(key, observation, value, 3) == 1.0


@cache
def filtered():
    """A small crowd, the filter's state at the end, and what it stated."""
    scene = crowd(5, cameras=4, frames=60, hz=5.0, seed=4)
    state, snapshots = initial_state(scene.scene, scene.scene.cameras, configure(JipdaConfig.in_unit("m"), {})), []
    for frames_of_step in scene.moments:
        state, snapshot = step(state, frames_of_step)
        snapshots.append(snapshot)
    return scene, state, snapshots


def swaying(observation, pixels):
    """The look with boxes that are all so far to the side, to and fro in 3 s, in each camera at another time."""
    shift = pixels * np.sin(2.0 * np.pi * (observation.t_ns / 3e9 + 0.3 * observation.camera))
    return observation._replace(boxes=observation.boxes + np.array([shift, 0.0, shift, 0.0]))


def variances(pixels):
    scene, state, snapshots = filtered()
    frames_of_step = [[swaying(frame_detections, pixels) for frame_detections in group] for group in scene.moments]
    smoothed = smooth(state, frames_of_step, snapshots, np.random.default_rng(0))
    return np.concatenate([m.covariance[:, 0, 0] for m in smoothed])


@pytest.mark.jit
def test_covariances_are_wider_where_errors_of_boxes_last_longer_than_was_learned():
    assert np.median(variances(16.0)) > 1.25 * np.median(variances(0.0))

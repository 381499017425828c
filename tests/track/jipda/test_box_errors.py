"""Errors of boxes that are learned: from disagreements made with known ones."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.detector_model import (
    EdgeErrorStatistics,
    correlated_noise,
    correlated_noise_factor,
    edge_noise_variance,
    gait_variance,
    prior_edge_errors,
    update_edge_errors,
)
from occlog.track.methods.jipda.kernels.detections import PackedDetections
from occlog.track.methods.jipda.kernels.lasting_errors.camera_disagreement import BoxDisagreement

N = 8


@cache
def taught(
    *,
    lasting: float = 0.0,
    sway: float = 0.0,
    bias: float = 0.0,
    similar: float = 0.0,
    seed: int = 0,
    frames: int = 300,
) -> EdgeErrorStatistics:
    """What is learned of one camera, 10 looks a second, middles with 3 px and 1 % of the height."""
    rng = np.random.default_rng(seed)
    edges = prior_edge_errors(1, 1.0, JipdaConfig())
    boxes = PackedDetections(np.zeros(1, dtype=np.int64), np.zeros(1), np.array([0, N]), np.zeros((N, 4)),
                  np.ones((N, 4), dtype=bool), np.zeros(N))  # fmt: skip
    size = np.tile(rng.uniform(60.0, 400.0, (N, 1)), (1, 4))
    noise = rng.normal(size=(N, 4))
    slow, walk = rng.normal(0.0, lasting, (N, 4)), rng.normal(size=(N, 2))
    velocity, keep = rng.normal(size=(N, 2)), np.exp(-0.1 / 0.5)
    for t in range(frames):
        slow = keep * slow + np.sqrt(1.0 - keep**2) * rng.normal(0.0, lasting, (N, 4))
        velocity += rng.normal(0.0, np.sqrt(0.06 * 0.1), (N, 2))
        walk += 0.1 * velocity
        noise = similar * noise + np.sqrt(1.0 - similar**2) * rng.normal(size=(N, 4))
        residual = 3.0 * noise + rng.normal(0.0, 0.01, (N, 4)) * size
        residual[:, [0, 2]] += (slow * size)[:, [0, 2]]
        residual[:, 3] += bias * size[:, 3] - edges.bias[0, 3] * size[:, 3]
        place = walk + rng.normal(0.0, np.hypot(0.03, sway), (N, 2))
        found = BoxDisagreement(residual, np.ones((N, 4)), size, place, np.full(N, 0.03**2))
        edges = update_edge_errors(
            edges, round(t * 1e8), boxes, found, key=np.arange(N), owner=np.arange(N), lasts=np.ones(1)
        )
    return edges


def test_noise_is_a_constant_and_a_share_of_the_size() -> None:
    noise = edge_noise_variance(taught(frames=600))
    np.testing.assert_allclose(np.sqrt(noise[:, 0]), 3.0, rtol=0.25)
    np.testing.assert_allclose(np.sqrt(noise[[1, 3], 1]), 0.01, rtol=0.35)


@pytest.mark.jit
def test_errors_that_last_are_distinguished_from_those_that_do_not() -> None:
    assert correlated_noise(taught()) < 0.007**2
    assert np.sqrt(correlated_noise(taught(lasting=0.03, frames=600))) == pytest.approx(0.03, rel=0.25)


@pytest.mark.jit
def test_the_sway_of_bodies_is_what_white_acceleration_does_not_explain() -> None:
    assert np.sqrt(gait_variance(taught(sway=0.08, frames=600))) == pytest.approx(0.08, rel=0.2)
    assert np.sqrt(gait_variance(taught())) < 0.045


@pytest.mark.jit
def test_errors_that_go_on_from_look_to_look_are_distinguished_from_those_that_are_new() -> None:
    assert correlated_noise_factor(taught()) < 1.2
    assert correlated_noise_factor(taught(lasting=0.03, bias=0.06)) < 1.6
    # Noise of 3 px has a correlation of 0.6 and 1 % of the height is new each time
    edges = taught(similar=0.6, frames=600)
    assert 1.4 < correlated_noise_factor(edges) < 1.6 / 0.4
    # Of every third observation the errors are alike to the third power
    similar = (correlated_noise_factor(edges) - 1.0) / (correlated_noise_factor(edges) + 1.0)
    assert correlated_noise_factor(edges, 3.0) == pytest.approx((1.0 + similar**3) / (1.0 - similar**3))


def test_the_bias_of_a_camera_is_found() -> None:
    assert taught(bias=0.06).bias[0, 3] == pytest.approx(0.06, abs=0.01)


def test_at_first_the_settings_hold() -> None:
    config = JipdaConfig()
    noise = edge_noise_variance(prior_edge_errors(2, 1.0, config))
    np.testing.assert_allclose(noise[:, 0], np.array([0.5, 2.0, 0.5, 2.0]) * config.edge_noise_px**2, rtol=1e-6)
    assert gait_variance(prior_edge_errors(2, 100.0, config)) == pytest.approx(
        1e4 * gait_variance(prior_edge_errors(2, 1.0, config))
    )

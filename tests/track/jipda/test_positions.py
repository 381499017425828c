"""Positions on the ground in the filter: as a Kalman filter, next to boxes, with errors that are learned."""

from __future__ import annotations

import numpy as np
import pytest
from people_boxes import box, camera

from occlog.records.scene import Scene
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.detector_model import gait_variance
from occlog.track.methods.jipda.filter import JipdaState, initial_state, step
from occlog.track.methods.jipda.interface import FrameDetections, PositionSource, TrackSnapshot
from occlog.track.methods.jipda.lasting_errors import position_errors
from occlog.track.methods.jipda.lasting_errors.position_errors import (
    lasting_error,
    learned_sigma,
    learned_sigma_ratio,
    position_covariances,
    position_noise_of,
)

pytestmark = pytest.mark.jit
STEP_S = 0.25
SOURCE = PositionSource("bev")
CALM = JipdaConfig(manoeuvre_interval_s=1e9, posture_change_interval_s=1e9, exclusion_radius=0.0)


def positions(
    k: int, at: np.ndarray, covariance: np.ndarray | None = None, view: int = 0, score: float = np.nan
) -> FrameDetections:
    """A frame of a source with positions (n, 2)."""
    n = len(at)
    stated = np.full((n, 3), np.nan) if covariance is None else np.tile(covariance, (n, 1))
    none, both = np.full(n, -1), np.concatenate([at, at], axis=1)
    row = 100 * k + np.arange(n)
    return FrameDetections(round(k * STEP_S * 1e9), view, both, np.full(n, score), none, np.zeros((n, 0)), row, stated)


def walk(k: int) -> np.ndarray:
    return np.array([[1.0 + 1.2 * k * STEP_S, 2.0 - 0.3 * k * STEP_S]])


def test_one_target_is_followed_as_by_a_kalman_filter() -> None:
    """With one position a frame the mixture over associations is its update, but for the odds that it is clutter."""
    covariance, config = np.array([0.04, 0.015, 0.02]), CALM
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky([[0.04, 0.015], [0.015, 0.02]])
    state = initial_state(Scene(), [SOURCE], config)
    F, Q = np.eye(6), np.zeros((6, 6))
    F[0, 2] = F[1, 3] = STEP_S
    H, m, P = np.concatenate([np.eye(2), np.zeros((2, 2)), np.eye(2)], axis=1), np.zeros(6), np.eye(6)
    q = position_errors.WALK_RATIO * config.process_noise_density
    Q[:4, :4] = q * np.kron([[STEP_S**3 / 3, STEP_S**2 / 2], [STEP_S**2 / 2, STEP_S]], np.eye(2))
    for k in range(25):
        z = walk(k) + rng.normal(size=(1, 2)) @ root.T
        (lasting, tau), gait = lasting_error(state.positions), gait_variance(state.edges)
        xx, xy, yy = position_covariances(state.positions, 0, covariance[None])[0]
        R = np.array([[xx, xy], [xy, yy]]) + gait * np.eye(2)
        state, found = step(state, [positions(k, z, covariance)])
        if k == 0:
            m[:2], P = z[0], np.diag([0.0, 0.0, *2 * [config.sigma_initial_velocity**2], lasting, lasting])
            P[:2, :2] = R + lasting * np.eye(2)
            P[:2, 4:] = P[4:, :2] = -lasting * np.eye(2)
        else:
            rho = np.exp(-STEP_S / tau)
            F[4:, 4:], Q[4:, 4:] = rho * np.eye(2), lasting * (1.0 - rho**2) * np.eye(2)
            m, P = F @ m, F @ P @ F.T + Q
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            m, P = m + K @ (z[0] - H @ m), P - K @ H @ P
        assert k < 2 or len(found.ids) == 1
    np.testing.assert_allclose(found.mean[0, :4], m[:4], atol=1e-3)
    np.testing.assert_allclose(found.covariance[0, :2, :2], P[:2, :2], rtol=0.02)
    assert found.covariance[0, 0, 1] > 0.0


def test_missed_positions_end_a_track_and_clutter_begins_none() -> None:
    rng = np.random.default_rng(1)
    state, ids = initial_state(Scene(), [SOURCE], JipdaConfig()), []
    for k in range(60):
        others = np.array([[20.0, 20.0], [22.0, 18.0]]) + rng.normal(0.0, 0.05, (2, 2))
        clutter = rng.uniform(0.0, 25.0, (rng.poisson(0.5), 2))
        there = [walk(k) + rng.normal(0.0, 0.05, (1, 2))] if k < 30 else []
        state, found = step(state, [positions(k, np.concatenate([*there, others, clutter]))])
        ids.append(found.ids)
        near = np.hypot(*(found.mean[:, :2] - walk(k)).T) < 1.0
        if 5 <= k < 30:
            assert near.sum() == 1
    # The two who stay have one identity each; who left is no longer reported
    assert len(np.unique(np.concatenate(ids[40:]))) <= 4
    assert len(ids[-1]) == 2


def crowd(sigma: float, lasting: float, frames: int = 150) -> tuple[JipdaState, list[float]]:
    """Eight who walk apart from each other; errors of the positions last, with a correlation time of 1 s."""
    rng, state = np.random.default_rng(2), initial_state(Scene(), [SOURCE], JipdaConfig())
    at, velocity = 8.0 * np.stack([np.arange(8) % 4, np.arange(8) // 4], axis=1), rng.normal(0.0, 0.6, (8, 2))
    b, rho, squares = np.zeros((8, 2)), np.exp(-STEP_S), []
    for k in range(frames):
        velocity += rng.normal(0.0, np.sqrt(0.04 * STEP_S), (8, 2)) - 0.05 * STEP_S * velocity
        at = at + STEP_S * velocity
        b = rho * b + np.sqrt(1.0 - rho**2) * rng.normal(0.0, sigma * np.sqrt(lasting), (8, 2))
        z = at + b + rng.normal(0.0, sigma * np.sqrt(1.0 - lasting), (8, 2))
        state, found = step(state, [positions(k, z)])
        if k > 20:
            away = found.mean[:, None, :2] - at
            nearest = np.argmin(np.hypot(away[..., 0], away[..., 1]), axis=1)
            e = found.mean[:, :2] - at[nearest]
            squares += np.einsum("ni,nij,nj->n", e, np.linalg.inv(found.covariance[:, :2, :2]), e).tolist()
    return state, squares


@pytest.mark.parametrize(("sigma", "lasting"), [(0.05, 0.0), (0.2, 0.9)])
def test_errors_are_learned_from_innovations(sigma: float, lasting: float) -> None:
    """The initial value is 0.1 m; 8 targets and 150 frames give some 2400 innovations, a tenth of the spread."""
    state, squares = crowd(sigma, lasting)
    assert learned_sigma(state.positions, 0) == pytest.approx(sigma, rel=0.45)
    noise = position_noise_of(state.positions, 0)
    assert noise.lasting < 0.6 * sigma**2 if lasting == 0.0 else noise.lasting > 0.5 * sigma**2
    # 2 where covariances are right; without what lasts it would be 8
    assert 0.7 < np.mean(squares) < 3.5


def test_innovations_contradict_a_stated_error() -> None:
    """A source that states a quarter of its standard deviation is used as it states, and found out."""
    rng, state = np.random.default_rng(3), initial_state(Scene(), [SOURCE], JipdaConfig())
    for k in range(150):
        z = walk(k) + 4.0 * np.outer(np.arange(4), [0.0, 1.0]) + rng.normal(0.0, 0.2, (4, 2))
        state, _ = step(state, [positions(k, z, np.array([0.05**2, 0.0, 0.05**2]))])
    assert learned_sigma(state.positions, 0) == pytest.approx(0.05)
    assert 2.5 < learned_sigma_ratio(state.positions, 0) < 5.5


def followed(with_boxes: bool, with_positions: bool) -> tuple[float, list[TrackSnapshot]]:
    """Mean distance of a person from their track, with two cameras and a source of positions, or one of these."""
    rng = np.random.default_rng(4)
    cameras = [camera("a"), camera("b")] if with_boxes else []
    views = [*cameras, *([SOURCE] if with_positions else [])]
    state, away, snapshots = initial_state(Scene(cameras=tuple(cameras)), views, JipdaConfig()), [], []
    for k in range(40):
        at = np.array([[3.0 + 0.1 * k, 4.0 + 0.05 * k]])
        frames = []
        for c, each in enumerate(cameras):
            edges = box(each, *at[0]) + rng.normal(0.0, 2.0, 4)
            none = np.zeros(1, dtype=np.int64)
            frames.append(
                FrameDetections(
                    round(k * STEP_S * 1e9), c, edges[None], np.ones(1), none - 1, np.zeros((1, 0)), none + k
                )
            )
        z = at + rng.normal(0.0, 0.1, (1, 2))
        frames += [positions(k, z, view=len(cameras))] if with_positions else []
        state, found = step(state, frames)
        snapshots.append(found)
        if k > 10:
            assert len(found.ids) == 1
            away.append(float(np.hypot(*(found.mean[0, :2] - at[0]))))
    return float(np.mean(away)), snapshots


def test_boxes_and_positions_are_of_one_person() -> None:
    both, snapshots = followed(True, True)
    assert both < followed(False, True)[0]
    assert both < 0.12
    last = snapshots[-1]
    assert last.visibility.shape == (1, 3)
    assert set(last.support.camera.tolist()) == {0, 1, 2}
    assert last.mean[0, 4] == pytest.approx(1.7, abs=0.2)


def test_who_leaves_the_covered_area_is_no_miss() -> None:
    """A source that never reported a position there says nothing of who is seen there by cameras."""
    state = initial_state(Scene(), [SOURCE], JipdaConfig())
    state, _ = step(state, [positions(0, np.array([[0.0, 0.0], [10.0, 10.0]]))])
    lens = state.views.lens[0]
    np.testing.assert_allclose(lens[:4], [-1.0, -1.0, 11.0, 11.0])

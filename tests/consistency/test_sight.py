"""Residuals at estimates, and candidates that are left."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from occlog.array_types import NS, Floats
from occlog.consistency.bearings import (
    GATE_SIGMAS,
    BearingBuffer,
    BearingConsistency,
    ComparedBearings,
    bearing_residuals,
)
from occlog.core.geometry.camera import azimuth_to_u
from occlog.records.scene import Camera, MicrophoneArray, Scene, camera_rotation
from occlog.records.tables import Bearings, Diagnostics, Residuals, Tracks

F = 200.0


def whole(
    tracks: Tracks, bearings: Bearings, scene: Scene, diagnostics: Diagnostics | None, window_ns: int = 0
) -> ComparedBearings:
    return ComparedBearings(*BearingConsistency(scene, window_ns).compare(tracks, bearings, diagnostics))


def camera(name: str, x: float, y: float, yaw_deg: float, **noise: float) -> Camera:
    rotation = camera_rotation(math.radians(yaw_deg), 0.0, 0.0)
    return Camera(name, np.array([x, y, 0.0]), rotation, np.array([F, F]), np.zeros(2), **noise)


SCENE = Scene((camera("east", 0, 5, 0), camera("north", 5, 0, 90)))


def estimates(xy: Floats, sigma: float = 0.1, target: int = 0, every_s: float = 0.2) -> Tracks:
    n = len(xy)
    return Tracks.of(
        t_ns=np.round(np.arange(n) * every_s * NS).astype(np.int64),
        target_id=np.full(n, target, np.int32),
        x=xy[:, 0],
        y=xy[:, 1],
        vx=np.zeros(n),
        vy=np.zeros(n),
        cov_xx=np.full(n, sigma**2),
        cov_xy=np.zeros(n),
        cov_yy=np.full(n, sigma**2),
    )


def seen_from(
    sensor: Camera, t_ns: Floats, xy: Floats, target: int = 0, sigma: float = 0.01, off: float = 0.0
) -> Bearings:
    away = xy - sensor.position[:2]
    n = len(xy)
    return Bearings.of(
        t_ns=t_ns,
        sensor=np.full(n, sensor.name),
        target_id=np.full(n, target, np.int32),
        seen=np.ones(n, bool),
        bearing=np.arctan2(away[:, 1], away[:, 0]) + off,
        sigma=np.full(n, sigma),
        u_px=np.full(n, np.nan),
        sigma_px=np.full(n, np.nan),
        score=np.full(n, np.nan),
    )


def standing(n: int, x: float = 5.0, y: float = 5.0) -> Floats:
    return np.tile([x, y], (n, 1))


def used(tracks: Tracks, cameras: str) -> Diagnostics:
    n = len(tracks)
    nothing, none = np.full(n, np.nan), np.zeros(n, np.int32)
    return Diagnostics.of(
        t_ns=tracks.t_ns,
        target_id=tracks.target_id,
        ess=nothing,
        log_likelihood=nothing,
        n_observing=none,
        n_detected=none,
        fallback=np.full(n, ""),
        cameras=np.full(n, cameras),
        n_available=none,
        selected=np.full(n, ""),
        predicted_mse=nothing,
    )


def test_residual_and_its_variance_by_hand() -> None:
    # 5 m in front of the camera, 0.02 rad off, sigma 0.01 rad; the estimate's 0.03 m across make 0.006 rad
    sensor = SCENE.cameras[0]
    rows = seen_from(sensor, np.zeros(1, np.int64), standing(1), off=0.02)
    residuals = bearing_residuals(rows, sensor, standing(1), np.diag([9.0, 0.03**2])[None])
    assert residuals.residual[0] == pytest.approx(2.0)
    assert residuals.spread[0] == pytest.approx(0.36)


def test_pixels_have_the_variance_of_eq_2_at_the_estimate() -> None:
    # 45 degrees off the axis, 5 m ahead; dz = f / cos^2 dtheta
    sensor = camera("east", 0, 0, 0, sigma_position=0.1, sigma_yaw=0.01)
    xy = np.array([[5.0, 5.0]])
    rows = seen_from(sensor, np.zeros(1, np.int64), xy, off=0.05)
    rows = dataclasses.replace(rows, u_px=azimuth_to_u(rows.bearing, 0.0, F), sigma_px=np.array([3.0]))
    residuals = bearing_residuals(rows, sensor, xy, np.zeros((1, 2, 2)))
    eq2 = F**2 * 4 * 0.01**2 + F**2 * 2 / 25 * 0.1**2 + 3.0**2
    assert residuals.residual[0] == pytest.approx(0.05 / (math.sqrt(eq2) / (2 * F)))


def test_squares_of_a_kalman_filter_are_as_expected() -> None:
    """A target that stands, seen by two cameras, estimated by recursive least squares: NIS 1."""
    rng, n, sigma = np.random.default_rng(0), 200, 0.01
    squares = expected = 0.0
    for _ in range(5):
        truth, xy, information, score = standing(n), np.empty((n, 2)), np.eye(2), np.zeros(2)
        offs = sigma * rng.standard_normal((2, n))
        P = np.empty((n, 2, 2))
        for k in range(n):
            for s, g in enumerate(np.array([[0.0, 0.2], [-0.2, 0.0]])):
                information = information + np.outer(g, g) / sigma**2
                score = score + g * offs[s, k] / sigma**2
            P[k] = np.linalg.inv(information)
            xy[k] = truth[k] + P[k] @ score
        tracks = dataclasses.replace(estimates(xy), cov_xx=P[:, 0, 0], cov_xy=P[:, 0, 1], cov_yy=P[:, 1, 1])
        parts = [seen_from(c, tracks.t_ns, truth, off=offs[s]) for s, c in enumerate(SCENE.cameras)]
        found = whole(tracks, Bearings.merge(parts), SCENE, None).residuals
        squares += float((found.residual[found.expected_variance > 0.1] ** 2).sum())
        expected += float(found.expected_variance[found.expected_variance > 0.1].sum())
    assert squares / expected == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("sigmas", "believed"), [(GATE_SIGMAS - 1e-6, 1.0), (GATE_SIGMAS + 1e-6, 0.0)])
def test_a_bearing_beyond_the_gate_is_not_believed(sigmas: float, believed: float) -> None:
    tracks = estimates(standing(1), sigma=0.0)
    bearings = seen_from(SCENE.cameras[0], tracks.t_ns, standing(1), off=sigmas * 0.01)
    assert whole(tracks, bearings, SCENE, None).residuals.inlier_probability.tolist() == [believed]


def test_the_nearest_candidate_counts_and_the_others_are_left() -> None:
    tracks = estimates(standing(10))
    own = seen_from(SCENE.cameras[0], tracks.t_ns, standing(10), target=-1, off=0.005)
    other = seen_from(SCENE.cameras[0], tracks.t_ns, standing(10, 5, 8), target=-1)
    found = whole(tracks, Bearings.merge([own, other]), SCENE, None)
    np.testing.assert_allclose(found.residuals.residual, 0.5)
    (frames,) = found.frames
    assert frames.candidates.tolist() == [2] * 10
    assert frames.unexplained.tolist() == [1] * 10
    assert frames.again.tolist() == [False] + [True] * 9


def test_candidates_that_come_anywhere_do_not_stay() -> None:
    rng = np.random.default_rng(1)
    tracks = estimates(standing(200))
    n = len(tracks)
    false = seen_from(SCENE.cameras[0], tracks.t_ns, standing(n), target=-1, off=rng.uniform(0.2, 0.8, n))
    (frames,) = whole(tracks, false, SCENE, None).frames
    assert frames.unexplained.sum() == n
    assert 0.05 < frames.again.mean() < 0.5


def test_a_sensor_with_a_label_for_the_target_has_no_candidates_for_it() -> None:
    tracks = estimates(standing(4))
    own = seen_from(SCENE.cameras[0], tracks.t_ns, standing(4))
    near = seen_from(SCENE.cameras[0], tracks.t_ns, standing(4), target=-1, off=0.001)
    assert len(whole(tracks, Bearings.merge([own, near]), SCENE, None).residuals) == 4


def test_sensors_that_an_estimate_did_not_use_are_left_out() -> None:
    tracks = estimates(standing(4))
    both = Bearings.merge([seen_from(c, tracks.t_ns, standing(4)) for c in SCENE.cameras])
    assert set(whole(tracks, both, SCENE, used(tracks, "north")).residuals.sensor.tolist()) == {"north"}
    assert len(whole(tracks, both, SCENE, used(tracks, "north,east")).residuals) == 8
    # A name that is part of another one is not that sensor
    assert len(whole(tracks, both, SCENE, used(tracks, "northeast")).residuals) == 0


@pytest.mark.parametrize(("early_ns", "found"), [(0, 3), (5, 3), (6, 0)])
def test_an_estimate_holds_for_bearings_up_to_the_window_before_it(early_ns: int, found: int) -> None:
    tracks = estimates(standing(4))
    bearings = seen_from(SCENE.cameras[0], tracks.t_ns[1:] - early_ns, standing(3))
    assert len(whole(tracks, bearings, SCENE, None, window_ns=5).residuals) == found


@pytest.mark.parametrize("label", [0, -1])
def test_an_estimate_without_a_covariance_is_not_judged(label: int) -> None:
    tracks = estimates(standing(4))
    for name in ("cov_xx", "cov_xy", "cov_yy"):
        getattr(tracks, name)[1] = np.nan
    bearings = seen_from(SCENE.cameras[0], tracks.t_ns, standing(4), target=label)
    found = whole(tracks, bearings, SCENE, None, window_ns=5)
    assert found.residuals.t_ns.tolist() == tracks.t_ns[[0, 2, 3]].tolist()
    assert sum(len(frames.t_ns) for frames in found.frames) == (3 if label < 0 else 0)


def test_a_tilted_array_is_not_judged() -> None:
    tilted = Scene((), (MicrophoneArray("ear", np.zeros(3), pitch=0.3),))
    tracks = estimates(standing(3))
    rows = dataclasses.replace(seen_from(SCENE.cameras[0], tracks.t_ns, standing(3)), sensor=np.full(3, "ear"))
    assert len(whole(tracks, rows, tilted, None).residuals) == 0


def test_a_witness_compares_chunk_by_chunk_as_all_at_once() -> None:
    rng, n = np.random.default_rng(2), 50
    tracks = estimates(standing(n) + 0.05 * rng.standard_normal((n, 2)))
    rows = Bearings.merge(
        [seen_from(c, tracks.t_ns, standing(n), off=0.01 * rng.standard_normal(n)) for c in SCENE.cameras]
        + [seen_from(SCENE.cameras[0], tracks.t_ns, standing(n, 5, 8), target=-1)]
    )
    diagnostics = used(tracks, "east,north")
    witness, parts, left = BearingBuffer(SCENE, 0, unlabelled=True), [], 0
    chunks = witness.watch(rows.take(slice(k, k + 13)) for k in range(0, len(rows), 13))
    given = 0
    for chunk in chunks:
        ready = int(np.searchsorted(tracks.t_ns, chunk.t_ns[-1]))
        out = witness.compare(tracks.take(slice(given, ready)), diagnostics.take(slice(given, ready)))
        parts.append(out.residuals)
        left += sum(int(f.unexplained.sum()) for f in out.frames)
        given = ready
    last = witness.compare(tracks.take(slice(given, n)), diagnostics.take(slice(given, n)))
    left += sum(int(f.unexplained.sum()) for f in last.frames)
    streamed, at_once = Residuals.concat([*parts, last.residuals]), whole(tracks, rows, SCENE, diagnostics).residuals
    for c in Residuals.columns():
        np.testing.assert_array_equal(getattr(streamed, c.name), getattr(at_once, c.name))
    assert left == n


def test_without_unlabelled_candidates_none_is_left() -> None:
    tracks = estimates(standing(5))
    rows = seen_from(SCENE.cameras[0], tracks.t_ns, standing(5, 5, 8), target=-1)
    witness = BearingBuffer(SCENE, 0, unlabelled=False)
    list(witness.watch([rows]))
    assert witness.compare(tracks, used(tracks, "east")).frames == ()


def test_no_estimates_leave_nothing() -> None:
    residuals, frames = BearingConsistency(SCENE).compare(Tracks.empty(), Bearings.empty())
    assert (len(residuals), frames) == (0, ())

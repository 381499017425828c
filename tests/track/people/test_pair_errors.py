"""Errors of single cameras by the evidence of normal equations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from occlog.track.people.camera_checks import pair_errors
from occlog.track.people.camera_checks.pair_errors import (
    BODIES,
    COMMON,
    FAULT,
    FOCAL,
    HEIGHT,
    LATE,
    MOVED,
    OWN,
    PITCH,
    PRIOR,
    RADIAL,
    USUAL,
    YAW,
    Evidence,
    camera_errors,
    movements,
    static_errors,
)

C, T, ROWS = 3, 48, 6
K = OWN * C + COMMON
USUAL_PRIOR = np.diag(np.append(np.tile(USUAL, C), np.ones(COMMON)) ** 2)


def measured(true: np.ndarray, seed: int, later: np.ndarray | None = None, since: int = T) -> tuple[np.ndarray, ...]:
    """(T, R, K) rows and (T, R) measurements of parameters, of others from a step on; errors of variance 1."""
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(T, ROWS, K))
    x = np.array([true if t < since or later is None else later for t in range(T)])
    return H, (H @ x[..., None])[..., 0] + rng.normal(size=(T, ROWS))


def normal(H: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(T, K, K + 1) normal equations of rows."""
    return np.concatenate([H.transpose(0, 2, 1) @ H, H.transpose(0, 2, 1) @ y[..., None]], axis=2)


def log_density(H: np.ndarray, y: np.ndarray, prior: np.ndarray) -> float:
    """Logarithm of the density of measurements (n,) with rows (n, K) and a normal prior."""
    return float(multivariate_normal.logpdf(y, np.zeros(len(y)), H @ prior @ H.T + np.eye(len(y))))


@pytest.mark.parametrize("kind", [YAW, RADIAL, FOCAL, HEIGHT, LATE])
def test_the_evidence_of_an_error_is_the_ratio_of_densities(kind: int) -> None:
    H, y = measured(np.zeros(K), seed=kind)
    now = Evidence(normal(H, y), USUAL_PRIOR)
    rows, values = H.reshape(-1, K), y.ravel()
    (own,) = (e for e in static_errors(now, now.solved()[2], 4.0) if e.kind == kind and e.cameras == (1,))
    prior = USUAL_PRIOR.copy()
    for k in [YAW, PITCH] if kind == YAW else [kind]:
        prior[OWN + k, OWN + k] += FAULT[k] ** 2
    ratio = log_density(rows, values, prior) - log_density(rows, values, USUAL_PRIOR)
    assert own.log_ratio == pytest.approx(ratio - BODIES / 4.0)


def test_the_evidence_of_a_movement_is_the_ratio_of_densities_over_all_times() -> None:
    later = np.zeros(K)
    later[OWN : OWN + 2] = 1.0, -0.5
    H, y = measured(np.zeros(K), 5, later, since=20)
    found = next(e for e in movements(Evidence(normal(H, y), USUAL_PRIOR)) if e.cameras == (1,))
    densities = []
    margin = 6
    for since in range(margin, T - margin):
        moved = H[..., OWN : OWN + 2].copy()
        moved[:since] = 0.0
        rows = np.concatenate([H, moved], axis=2).reshape(-1, K + 2)
        prior = np.zeros((K + 2, K + 2))
        prior[:K, :K], prior[K:, K:] = USUAL_PRIOR, FAULT[YAW] ** 2 * np.eye(2)
        densities.append(log_density(rows, y.ravel(), prior))
    best = int(np.argmax(densities))
    assert found.since == margin + best
    assert abs(found.since - 20) <= 1
    alone = log_density(H.reshape(-1, K), y.ravel(), USUAL_PRIOR)
    assert found.log_ratio == pytest.approx(densities[best] - alone - np.log(len(densities)) - MOVED)
    assert found.values == pytest.approx(later[None, OWN : OWN + 2] * PRIOR[:2], abs=0.3 * PRIOR[0])


def test_nothing_is_found_in_errors_of_boxes_alone() -> None:
    for seed in range(20):
        assert camera_errors(normal(*measured(np.zeros(K), seed)), 4.0, lambda _: True) == []


@pytest.mark.parametrize("kind", [YAW, RADIAL, FOCAL, HEIGHT, LATE])
@pytest.mark.parametrize("camera", range(C))
def test_one_error_of_one_camera_is_found_alone(kind: int, camera: int) -> None:
    true = np.zeros(K)
    true[OWN * camera + kind] = 1.5
    (found,) = camera_errors(normal(*measured(true, 7)), 4.0, lambda _: True)
    assert (found.cameras, found.kind, found.since) == ((camera,), kind, 0)
    assert found.values[0, 0] == pytest.approx(1.5 * PRIOR[kind], abs=0.3 * PRIOR[kind])


def test_an_error_that_all_cameras_share_is_found_once() -> None:
    true = np.zeros(K)
    true[RADIAL:-COMMON:OWN] = 0.8
    (found,) = camera_errors(normal(*measured(true, 8)), 4.0, lambda _: True)
    assert (found.cameras, found.kind) == (tuple(range(C)), RADIAL)


def test_a_pitch_that_all_cameras_share_is_the_shape_of_bodies() -> None:
    true = np.zeros(K)
    true[PITCH:-COMMON:OWN] = 0.7
    assert camera_errors(normal(*measured(true, 9)), 4.0, lambda _: True) == []


def test_errors_that_do_not_matter_are_not_stated() -> None:
    true = np.zeros(K)
    true[FOCAL] = 1.5
    assert camera_errors(normal(*measured(true, 10)), 4.0, lambda error: error.kind != FOCAL) == []


def test_velocities_at_times_a_nanosecond_apart_are_unknown_and_take_no_memory() -> None:
    """The time steps before and after would be a thousand million away."""
    people, steps = np.random.default_rng(0).uniform(0.0, 5.0, (40, 2)), np.repeat(np.arange(20), 2)
    assert not pair_errors._velocities(people, steps, np.ones(40, dtype=np.bool_), np.arange(20), 1.7).any()
    walk = np.column_stack([0.1 * np.arange(20.0), np.zeros(20)])
    t_ns = 100_000_000 * np.arange(20)
    found = pair_errors._velocities(walk, np.arange(20), np.ones(20, dtype=np.bool_), t_ns, 1.7)
    np.testing.assert_allclose(found[9:11], [[1.0, 0.0]] * 2, rtol=1e-9)

"""Offsets of the cameras' clocks: the normal equations, and the offsets and standard errors that follow."""

from __future__ import annotations

import numpy as np
import pytest
from people_boxes import box, hall

from occlog.track.methods.jipda.kernels.body_box import pack_views
from occlog.track.methods.jipda.kernels.detections import PackedDetections
from occlog.track.methods.jipda.kernels.lasting_errors.clock_residuals import clock_residuals
from occlog.track.methods.jipda.lasting_errors.clock_offset import (
    clock_drifts,
    clock_offsets,
    prior_clocks,
    update_clocks,
)
from occlog.track.methods.jipda.lasting_errors.normal_equations import BATCH_S, MAX_BATCHES, MIN_BATCHES

SCENE = hall("abcd")
C = len(SCENE.cameras)


def time_step(rng: np.random.Generator, late: np.ndarray, px: float, turned: np.ndarray) -> tuple[np.ndarray, ...]:
    """People (P, 6), boxes, owners: three of four cameras see each; cameras may be late and shift boxes [px]."""
    P = 5
    mean = np.column_stack([rng.uniform(3.0, 7.0, (P, 2)), rng.normal(0.0, 1.0, (P, 2)), np.tile([1.75, 0.5], (P, 1))])
    rows, cameras, owners = [], [], []
    for c, each in enumerate(SCENE.cameras):
        for i in range(P):
            if (i + c) % C:
                at = mean[i, :2] - late[c] * mean[i, 2:4]
                # The tracks themselves lag by something that differs between people
                rows.append(box(each, *(at + 0.02 * (i - 2) * mean[i, 2:4])) + rng.normal(0.0, px, 4) + turned[c])
                cameras.append(c)
                owners.append(i)
    count = np.bincount(cameras, minlength=C)
    boxes = PackedDetections(
        camera=np.arange(C),
        delay=np.zeros(C),
        first=np.concatenate([[0], np.cumsum(count)]),
        box=np.array(rows),
        usable=np.ones((len(rows), 4), dtype=np.bool_),
        clutter=np.zeros(len(rows)),
    )
    return mean, boxes, np.array(owners)


def test_normal_equations_are_those_of_dense_least_squares() -> None:
    """The offsets of the persons are eliminated: as a Schur complement of the dense system."""
    rng = np.random.default_rng(0)
    mean, boxes, owner = time_step(rng, np.array([0.2, 0.0, -0.1, 0.0]), 1.0, np.zeros(C))
    views, late, centre = pack_views(SCENE.cameras), np.array([0.05, 0.0, 0.0, 0.0]), rng.normal(0.0, 0.01, (C, 4))
    boxes = boxes._replace(delay=-late)
    normal, sums = clock_residuals(mean, views, boxes, owner, np.ones(len(owner), np.bool_), late, centre)
    P = len(mean)
    dense, right = np.zeros((C + P, C + P)), np.zeros(C + P)
    for j, i in enumerate(owner):
        c = int(np.searchsorted(boxes.first, j, side="right") - 1)
        h = 1e-4

        def centre_of(delay: float, c: int = c, i: int = i) -> np.ndarray:
            at = mean[i, :2] + delay * mean[i, 2:4]
            expected = np.empty(4)
            from occlog.track.methods.jipda.kernels.body_box import expected_box

            expected_box(views.lens[c], *at, *mean[i, 4:], expected)
            return np.append(0.5 * (expected[:2] + expected[2:]), expected[3] - expected[1])

        low, here, high = (centre_of(d - late[c]) for d in (-h, 0.0, h))
        v = (high - low)[:2] / (2.0 * h) / here[2]
        r = (0.5 * (boxes.box[j, :2] + boxes.box[j, 2:]) - here[:2]) / here[2] - late[c] * v
        r, v = r - centre[c, :2], v - centre[c, 2:]
        # r = (m_i - d_c) v
        row = np.zeros(C + P)
        row[c], row[C + i] = -1.0, 1.0
        dense += v @ v * np.outer(row, row)
        right += r @ v * row
    inner = np.linalg.inv(dense[C:, C:])
    np.testing.assert_allclose(normal[:, :C], dense[:C, :C] - dense[:C, C:] @ inner @ dense[C:, :C], atol=1e-3)
    np.testing.assert_allclose(normal[:, C], right[:C] - dense[:C, C:] @ inner @ right[C:], atol=1e-3)
    np.testing.assert_array_equal(sums[:, 0], np.diff(boxes.first))


@pytest.mark.jit
@pytest.mark.parametrize("late", [np.zeros(4), np.array([0.0, -0.3, 0.0, 0.1])])
def test_offsets_are_found_with_honest_errors(late: np.ndarray) -> None:
    """40 repetitions: the errors of unflagged and flagged offsets agree with the standard errors."""
    views, rng = pack_views(SCENE.cameras), np.random.default_rng(1)
    turned = np.array([6.0, 0.0, 0.0, -4.0])
    clocks = prior_clocks(C)
    for k in range(round(1.2 * BATCH_S * MAX_BATCHES / 0.2)):
        mean, boxes, owner = time_step(rng, late, 3.0, turned)
        boxes = boxes._replace(delay=-clocks.late)
        good = np.ones(len(owner), dtype=np.bool_)
        sums = clock_residuals(mean, views, boxes, owner, good, clocks.late, clocks.centre)
        clocks = update_clocks(clocks, round(0.2 * k * 1e9), *sums)
        if k * 0.2 < MIN_BATCHES * BATCH_S:
            assert not clocks.late.any()
    assert len(clocks.batches.kept) <= MAX_BATCHES
    assert (clocks.limit < 0.05).all()
    np.testing.assert_array_equal(clocks.late != 0.0, late != 0.0)
    np.testing.assert_allclose(clocks.late, late, atol=0.5 * clocks.limit.max())


def test_cameras_that_share_no_people_have_no_offset() -> None:
    late, limit = clock_offsets(np.zeros((20, 3, 4)))
    assert not late.any()
    assert np.isinf(limit).all()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("seconds", [60.0, 300.0])
def test_a_drift_is_found_in_the_whole_recording(seconds: float, seed: int) -> None:
    """The third of four cameras drifts by 1500 ppm; the last one is late by a constant."""
    rng, laplacian = np.random.default_rng(seed), 4.0 * np.eye(4) - 1.0
    for ppm in (0.0, 1500.0):
        clocks = prior_clocks(4)
        for t_s in np.arange(0.0, seconds, 0.25):
            late = np.array([0.0, 0.0, 1e-6 * ppm * t_s, 0.1])
            right = laplacian @ (late + rng.normal(0.0, 0.02, 4))
            normal = np.column_stack([laplacian, right])
            clocks = update_clocks(clocks, round(t_s * 1e9), normal, np.zeros((4, 5)))
        assert len(clocks.history) <= MAX_BATCHES
        drifts, limits = clock_drifts(clocks.history, clocks.history_s)
        assert np.flatnonzero(drifts).tolist() == ([2] if ppm else [])
        if ppm:
            assert abs(1e6 * drifts[2] - ppm) < 1e6 * limits[2] < ppm


def test_a_drift_is_not_estimated_in_short_recordings() -> None:
    drifts, limits = clock_drifts(np.ones((10, 2, 3)), np.arange(10.0))
    assert not drifts.any()
    assert np.isinf(limits).all()

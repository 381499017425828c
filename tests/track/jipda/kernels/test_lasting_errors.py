"""Errors that last, from the boxes of one time step: least squares in dense form."""

from __future__ import annotations

import math
from typing import Any

import jipda_reference as textbook
import numpy as np
import pytest
from random_frames import Scene, random_scene

from occlog.array_types import Bools, Floats, Ints
from occlog.track.methods.jipda.interface import PositionSource
from occlog.track.methods.jipda.kernels.body_box import cover_positions, pack_views
from occlog.track.methods.jipda.kernels.lasting_errors.bias_effects import bias_effects
from occlog.track.methods.jipda.kernels.lasting_errors.camera_disagreement import camera_disagreement
from occlog.track.methods.jipda.kernels.lasting_errors.clock_residuals import clock_residuals
from occlog.track.methods.jipda.kernels.lasting_errors.pose_residuals import centre_rows, pose_residuals
from occlog.track.methods.jipda.lasting_errors.pose_offset import corrected, prior_poses

TO_ERRORS = np.linalg.inv(textbook.EDGES)
"""From edges to centre x, width, centre y and height."""
POSITION_AND_BODY = [0, 1, 4, 5]


def scene(seed: int) -> tuple[Scene, Ints, Bools]:
    """A random scene in which each box is owned by the person whose expected box is nearest, and some are not good."""
    s, rng = random_scene(seed), np.random.default_rng(seed)
    owner = np.empty(len(s.boxes.box), dtype=np.int64)
    for j, box in enumerate(s.boxes.box):
        c = camera_of(s, j)
        drawn = [textbook.outline_of(s.cameras[c], m, s.boxes.delay[c]) for m in s.mean]
        owner[j] = np.argmin([np.abs(each - box).sum() for each in drawn])
    return s, owner, rng.random(len(owner)) < 0.8


def camera_of(s: Scene, j: int) -> int:
    return int(np.searchsorted(s.boxes.first, j, side="right") - 1)


def expected(s: Scene, j: int, state: Floats, delay: float = 0.0) -> Any:
    """Box `j` as it is expected of a person."""
    c = camera_of(s, j)
    return textbook.predicted(s.cameras[c], state, np.eye(6), s.boxes.delay[c] + delay, s.detectors[c])


@pytest.mark.parametrize("seed", range(3))
def test_disagreement_is_what_a_weighted_fit_of_position_and_body_leaves(seed: int) -> None:
    s, owner, good = scene(seed)
    got = camera_disagreement(s.mean, s.covariance, s.views, s.boxes, s.rates, owner, good)
    for i, state in enumerate(s.mean):
        rows = [j for j in range(len(owner)) if owner[j] == i and good[j]]
        prior = np.diag([0.0, 0.0, 1.0 / s.covariance[i, 4, 4], 1.0 / s.covariance[i, 5, 5]])
        A, b, H, r, R = prior.copy(), np.zeros(4), {}, {}, {}
        for j in rows:
            seen, d = expected(s, j, state), s.detectors[camera_of(s, j)]
            H[j] = TO_ERRORS @ seen.H[:, POSITION_AND_BODY]
            r[j] = TO_ERRORS @ (s.boxes.box[j] - seen.box)
            R[j] = TO_ERRORS @ textbook.edge_covariance(seen.box, d, 1.0) @ TO_ERRORS.T
            A, b = A + H[j].T @ np.linalg.solve(R[j], H[j]), b + H[j].T @ np.linalg.solve(R[j], r[j])
            width, height = seen.box[2:] - seen.box[:2]
            np.testing.assert_allclose(got.size[j], [height, width, height, height], rtol=1e-6)
        C = np.linalg.inv(A) if rows else prior
        for j in rows:
            np.testing.assert_allclose(got.residual[j], r[j] - H[j] @ C @ b, rtol=1e-4, atol=1e-3)
            leverage = np.diag(H[j] @ C @ H[j].T) / np.diag(R[j])
            np.testing.assert_allclose(got.kept[j], np.maximum(1.0 - leverage, 0.0), rtol=1e-4, atol=1e-5)
        if len(rows) < 2:
            assert np.isnan(got.position[i]).all()
            assert got.variance[i] == 0.0
        else:
            np.testing.assert_allclose(got.position[i], state[:2] + (C @ b)[:2], atol=1e-5)
            assert got.variance[i] == pytest.approx(0.5 * (C[0, 0] + C[1, 1]), rel=1e-4)
    assert not got.residual[~good].any()
    assert not got.kept[~good].any()
    assert (got.size[~good] == 1.0).all()


def box_centre(state: Floats, s: Scene, j: int) -> Floats:
    """Centre of the box of a person without the detector's bias."""
    outline = expected(s, j, state).outline
    return np.asarray(0.5 * (outline[:2] + outline[2:]))


def body_centre(state: Floats, s: Scene, j: int, angles: Floats) -> Floats:
    """Pixel of the centre of a body in the camera of a box, turned by two angles."""
    c, poses = camera_of(s, j), prior_poses(s.views)
    poses.angles[c] = angles
    lens, delay = corrected(s.views, poses).lens[c], s.boxes.delay[c]
    at = np.array([*(state[:2] + delay * state[2:4]), 0.5 * state[4]]) - lens[:3]
    q = lens[3:12].reshape(3, 3).T @ at
    return np.asarray(lens[12:14] * q[:2] / q[2] + lens[14:16])


@pytest.mark.parametrize("seed", range(2))
def test_rows_of_a_pose_are_derivatives_by_position_height_and_two_rotations(seed: int) -> None:
    s, owner, _ = scene(seed)
    used = 0
    for j, i in enumerate(owner):
        c, state, out = camera_of(s, j), s.mean[i], np.zeros((2, 10))
        n = centre_rows(state, c, s.views.lens[c], s.boxes.delay[c], s.boxes.box[j], s.rates, out)
        outline = expected(s, j, state).outline
        residual = 0.5 * (s.boxes.box[j, :2] + s.boxes.box[j, 2:]) - box_centre(state, s, j)
        size = outline[2:] - outline[:2]
        if np.abs(residual).max() > 0.4 * size[1]:
            assert n == 0
            assert not out.any()
            continue
        used += 1
        assert n == 2
        R = TO_ERRORS @ textbook.edge_covariance(outline, s.detectors[c], 1.0) @ TO_ERRORS.T
        weight = 1.0 / np.sqrt(np.diag(R)[[0, 2]])
        for k, entry in enumerate((0, 1, 4)):
            h = 1e-4 * np.eye(6)[entry]
            wanted = weight * (box_centre(state + h, s, j) - box_centre(state - h, s, j)) / 2e-4
            np.testing.assert_allclose(out[:, k], wanted, rtol=1e-4, atol=1e-4)
        for k, h in enumerate(1e-6 * np.eye(2)):
            wanted = weight * (body_centre(state, s, j, h) - body_centre(state, s, j, -h)) / 2e-6
            np.testing.assert_allclose(out[:, 3 + 2 * c + k], wanted, rtol=1e-5, atol=1e-4)
        np.testing.assert_allclose(out[:, -1], weight * residual, rtol=1e-5, atol=1e-5)
        assert not np.delete(out, [0, 1, 2, 3 + 2 * c, 4 + 2 * c, 9], axis=1).any()
    assert used > 5


def test_a_box_is_used_up_to_four_tenths_of_its_height_from_its_person() -> None:
    s, owner, _ = scene(0)
    c, state = camera_of(s, 0), s.mean[owner[0]]
    outline = expected(s, 0, state).outline
    for share, n in ((0.399, 2), (0.401, 0)):
        for axis in range(2):
            box = outline + share * (outline[3] - outline[1]) * np.tile(np.eye(2)[axis], 2)
            out = np.zeros((2, 10))
            assert centre_rows(state, c, s.views.lens[c], s.boxes.delay[c], box, s.rates, out) == n
            many = s.boxes._replace(box=np.concatenate([box[None], s.boxes.box[1:]]))
            mine = np.arange(len(owner)) == 0
            sums = clock_residuals(s.mean, s.views, many, owner, mine, np.zeros(3), np.zeros((3, 4)))[1]
            assert sums[c, 0] == n // 2


@pytest.mark.parametrize("seed", range(3))
def test_normal_equations_of_poses_are_schur_complements(seed: int) -> None:
    """Those of all parameters, the positions and heights of the people eliminated; single views are left out."""
    s, owner, good = scene(seed)
    N, boxes = len(s.mean), range(len(owner))
    wanted = np.zeros((6, 7))
    for i in range(N):
        rows = []
        for j in boxes:
            out, c = np.zeros((2, 10)), camera_of(s, j)
            if owner[j] == i and good[j]:
                n = centre_rows(s.mean[i], c, s.views.lens[c], s.boxes.delay[c], s.boxes.box[j], s.rates, out)
                rows += [out] if n else []
        if len(rows) > 1:
            J = np.concatenate([*rows, np.zeros((1, 10))])
            J[-1, 2] = 1.0 / np.sqrt(s.covariance[i, 4, 4])
            own, others = J[:, :3], J[:, 3:]
            left = others - own @ np.linalg.lstsq(own, others, rcond=None)[0]
            wanted += (left.T @ left)[:-1]
    got = pose_residuals(s.mean, s.covariance, s.views, s.boxes, s.rates, owner, good)
    np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())
    assert np.abs(wanted).max() > 0.0


@pytest.mark.parametrize("seed", range(2))
def test_normal_equations_of_clocks_eliminate_the_delay_of_each_track(seed: int) -> None:
    s, owner, good = scene(seed)
    late, centre = np.array([0.03, 0.0, -0.05]), np.random.default_rng(seed).normal(0.0, 0.02, (3, 4))
    wanted, sums = np.zeros((3, 4)), np.zeros((3, 5))
    for i, state in enumerate(s.mean):
        rows, right, weight = [], [], []
        for j in range(len(owner)):
            c, outline = camera_of(s, j), expected(s, j, state).outline
            height = outline[3] - outline[1]
            later, earlier = (expected(s, j, state, h).outline for h in (1e-4, -1e-4))
            v = 0.5 * ((later - earlier)[:2] + (later - earlier)[2:]) / 2e-4 / height
            r = 0.5 * ((s.boxes.box[j] - outline)[:2] + (s.boxes.box[j] - outline)[2:]) / height
            if owner[j] != i or not good[j] or np.abs(r).max() > 0.4:
                continue
            r = r - late[c] * v
            sums[c] += [1.0, *r, *v]
            r, v = r - centre[c, :2], v - centre[c, 2:]
            # r = (m - d_c) v
            rows.append([*-np.eye(3)[c], 1.0])
            right.append(r @ v / (v @ v))
            weight.append(v @ v)
        if len(rows) > 1:
            J, root = np.array(rows), np.sqrt(weight)
            own, others = root * J[:, 3], root[:, None] * np.column_stack([J[:, :3], right])
            left = others - np.outer(own, own @ others) / (own @ own)
            wanted += (left.T @ left)[:-1]
    normal, got = clock_residuals(s.mean, s.views, s.boxes, owner, good, late, centre)
    np.testing.assert_allclose(got, sums, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(normal, wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())


def test_people_who_stand_say_nothing_of_clocks() -> None:
    s, owner, good = scene(0)
    still = s.mean * [1.0, 1.0, 0.0, 0.0, 1.0, 1.0]
    normal, sums = clock_residuals(still, s.views, s.boxes, owner, good, np.zeros(3), np.zeros((3, 4)))
    assert not normal.any()
    assert sums[:, 0].sum() > 3.0


@pytest.mark.parametrize("limit", ["range", "width", "height", "left", "top"])
@pytest.mark.parametrize("beyond", [-1.0, 1.0])
def test_a_bias_of_the_body_shifts_by_cameras_with_the_centre_in_range_and_image(limit: str, beyond: float) -> None:
    """Camera 1 has the box of the first person just within the limit, or just beyond it."""
    s, c = random_scene(1), 1
    size, reach, moved = np.full((3, 2), [1280.0, 720.0]), np.full(3, 100.0), np.zeros((3, 2))
    outline = textbook.outline_of(s.cameras[c], s.mean[0], 0.0)
    middle = 0.5 * (outline[:2] + outline[2:])
    if limit == "range":
        reach[c] = np.hypot(*(s.mean[0, :2] - s.cameras[c].position[:2])) - 1e-3 * beyond
    elif limit in ("width", "height"):
        size[c, int(limit == "height")] = middle[int(limit == "height")] - beyond
    else:
        moved[c, int(limit == "top")] = -middle[int(limit == "top")] - beyond
    lens = s.views.lens.copy()
    lens[:, 14:16] += moved
    views = s.views._replace(size=size, range=reach, lens=lens)
    got, share, _ = bias_effects(s.mean, s.covariance, views, s.rates, np.zeros((3, 2)))
    for i, state in enumerate(s.mean):
        A, b, used = np.diag([0.0, 0.0, 1.0 / s.covariance[i, 4, 4], 1.0 / s.covariance[i, 5, 5]]), [], []
        for k, camera in enumerate(s.cameras):
            seen = textbook.predicted(camera, state, np.eye(6), 0.0, s.detectors[k])
            assert seen is not None
            H = TO_ERRORS @ seen.H[:, POSITION_AND_BODY]
            R = TO_ERRORS @ textbook.edge_covariance(seen.outline, s.detectors[k], 1.0) @ TO_ERRORS.T
            at, away = 0.5 * (seen.outline[:2] + seen.outline[2:]) + moved[k], state[:2] - camera.position[:2]
            if (at > 0.0).all() and (at < size[k]).all() and np.hypot(*away) < reach[k]:
                used.append(k)
                A = A + H.T @ np.linalg.solve(R, H)
                b.append(H[2] / R[2, 2] * (seen.outline[3] - seen.outline[1]))
        assert i > 0 or (c in used) == (beyond < 0.0)
        shifts = np.array([np.linalg.solve(A, each)[:2] for each in b]).reshape(-1, 2)
        np.testing.assert_allclose(got[i], shifts.sum(axis=0), rtol=1e-4, atol=1e-7)
        total = np.hypot(*shifts.T).sum()
        assert share[i] == pytest.approx(math.hypot(*got[i]) / total if total > 0.0 else 1.0, rel=1e-4)


@pytest.mark.parametrize(("x", "y"), [(1.0, 4.0), (9.0, 4.0), (5.0, 3.0), (5.0, 5.0)])
def test_positions_within_the_covered_area_have_no_bias_of_the_body(x: float, y: float) -> None:
    s = random_scene(0, cameras=2)
    views = pack_views([*s.cameras, PositionSource("lidar")])
    views = cover_positions(views, 2, np.array([[2.0, 4.0], [8.0, 4.0]]), 1.0)
    rates = s.rates._replace(detection=np.ones(3), bias=np.zeros((3, 4)))
    away = np.array([x - 5.0, y - 4.0])
    for share, inside in ((0.999, True), (1.0, False)):
        at = np.array([[*(np.array([5.0, 4.0]) + share * away), 0.0, 0.0, 1.7, 0.5]])
        shift, found, _ = bias_effects(at, s.covariance[:1], views, rates, np.zeros((3, 2)))
        assert (found[0] == 0.0) == inside
        assert not (inside and shift.any())

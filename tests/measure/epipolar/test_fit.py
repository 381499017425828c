"""Fits against a general optimiser, slopes against differences, errors against repeated noise."""

import numpy as np
import pytest
from epipolar_rigs import flat_points, matches, rig, room_points
from scipy.optimize import least_squares

from occlog.core.geometry.fundamental import epipolar_lines, homogeneous, line_distances, scaled
from occlog.measure.epipolar.fit import (
    eight_points,
    fit_affine,
    fit_homography,
    fit_perspective,
    homography_distances,
    homography_parallax,
    sampson,
    sampson_slopes,
)

SMALL = np.diag([0.005, 0.005, 1.0])
"""Changes units, so that the entries of a matrix are of one size."""


def rank2(entries):
    """From 8 numbers: the third column is a mix of the first two."""
    m = np.array(entries[:6]).reshape(3, 2)
    return np.column_stack([m, m @ entries[6:8]])


def test_sampson_distance_is_the_value_over_its_slope():
    rng = np.random.default_rng(0)
    f, a, b = rng.normal(size=(3, 3)), rng.normal(size=(20, 2)), rng.normal(size=(20, 2))

    def value(z):
        return np.append(z[2:], 1.0) @ f @ np.append(z[:2], 1.0)

    for k, got in enumerate(sampson(f, a, b)):
        z, h = np.concatenate([a[k], b[k]]), 1e-6
        slope = [(value(z + h * e) - value(z - h * e)) / (2 * h) for e in np.eye(4)]
        assert got == pytest.approx(value(z) / np.linalg.norm(slope), rel=1e-6)


def test_slopes_are_differences():
    rng = np.random.default_rng(1)
    f, a, b = rng.normal(size=(3, 3)), rng.normal(size=(20, 2)), rng.normal(size=(20, 2))
    got, h = sampson_slopes(f, a, b), 1e-6
    for i in range(3):
        for j in range(3):
            e = np.zeros((3, 3))
            e[i, j] = h
            np.testing.assert_allclose(got[:, i, j], (sampson(f + e, a, b) - sampson(f - e, a, b)) / (2 * h), atol=1e-7)


def test_perspective_fit_is_as_good_as_a_general_optimiser_from_the_truth():
    for seed in range(8):
        rng = np.random.default_rng(seed)
        cameras = rig(rng)
        a, b = matches(rng, cameras, room_points(rng, 30), 0.7)
        fit = fit_perspective(a, b)
        assert np.linalg.svd(fit.matrix)[1][2] < 1e-9
        clean = eight_points(*matches(rng, cameras, room_points(rng, 200), 0.0))
        m = np.linalg.inv(SMALL) @ clean @ np.linalg.inv(SMALL)
        m /= np.linalg.norm(m)
        mix = np.linalg.lstsq(m[:, :2], m[:, 2], rcond=None)[0]
        start = np.concatenate([m[:, :2].ravel(), mix])
        best = least_squares(lambda p, a=a, b=b: sampson(SMALL @ rank2(p) @ SMALL, a, b), start, x_scale="jac")
        assert (fit.residuals**2).sum() <= 2 * best.cost * (1 + 1e-6)


def test_affine_fit_is_as_good_as_a_general_optimiser():
    for seed in range(8):
        rng = np.random.default_rng(seed)
        a, b = matches(rng, rig(rng, 1e4), room_points(rng, 25), 0.7)
        fit = fit_affine(a, b)
        both = np.hstack([b, a]) - np.hstack([b, a]).mean(axis=0)

        def plane(p, both=both):
            return (both @ p[:4] + p[4]) / np.linalg.norm(p[:4])

        best = min(least_squares(plane, rng.normal(size=5), x_scale="jac").cost for _ in range(4))
        assert (fit.residuals**2).sum() == pytest.approx(2 * best, rel=1e-6)
        assert not fit.matrix[:2, :2].any()


def test_noise_free_matches_give_the_matrix_back():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        cameras = rig(rng)
        a, b = matches(rng, cameras, room_points(rng, 20), 0.0)
        fit = fit_perspective(a, b)
        new = matches(rng, cameras, room_points(rng, 100), 0.0)
        assert np.abs(sampson(fit.matrix, *new)).max() < 1e-5
        assert fit.noise_px < 1e-6


def off_lines(matrix, truth, a, b):
    """Errors of lines in view b, as far to both sides of the true images as these spread."""
    lines = epipolar_lines(truth, a)
    along = np.column_stack([-lines[:, 1], lines[:, 0]])
    reach = np.sqrt(((b - b.mean(axis=0)) ** 2).sum() / len(b))
    new = epipolar_lines(matrix, a)
    return np.concatenate([line_distances(new, b + side * reach * along) for side in (-1, 1)])


@pytest.mark.parametrize(("distance", "fitting"), [(None, fit_perspective), (1e5, fit_affine)])
def test_expected_errors_are_those_of_repeated_noise(distance, fitting):
    """250 repeats of 7 (4) unknowns: the mean square has an error of 6 % where one unknown counts most; 4 sigma."""
    rng = np.random.default_rng(5)
    cameras = rig(rng, distance)
    a, b = matches(rng, cameras, room_points(rng, 40), 0.0)
    truth = fitting(a, b).matrix
    squares, expected, noise = [], [], []
    for _ in range(250):
        na, nb = a + rng.normal(0, 0.5, a.shape), b + rng.normal(0, 0.5, b.shape)
        fit = fitting(na, nb)
        both = (off_lines(fit.matrix, truth, a, b), off_lines(fit.matrix.T, truth.T, b, a))
        squares.append(np.mean([(d**2).mean() for d in both]))
        expected.append(fit.error_px**2)
        noise.append(fit.noise_px**2)
    assert np.mean(squares) == pytest.approx(np.mean(expected), rel=0.25)
    assert np.mean(noise) == pytest.approx(0.25, rel=0.05)  # 33 left of each of 250: error 1.6 %


def test_planes_leave_their_noise_and_rooms_leave_parallax():
    """Error bar: 52 numbers left of 30 matches, 10 % of the noise each; 20 seeds."""
    noise, room = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        cameras = rig(rng)
        a, b = matches(rng, cameras, flat_points(rng, 30), 0.5)
        noise.append(homography_parallax(a, b))
        room.append(homography_parallax(*matches(rng, cameras, room_points(rng, 30), 0.5)))
    assert np.median(noise) == pytest.approx(0.5, rel=0.1)
    assert min(room) > 5.0


def test_homographies_map_points_and_tell_distances():
    rng = np.random.default_rng(3)
    mapping = np.array([[1.1, 0.1, 5.0], [-0.05, 0.9, 8.0], [2e-4, -1e-4, 1.0]])
    a = rng.uniform(0, 600, (4000, 2))
    h = homogeneous(a) @ mapping.T
    b = h[:, :2] / h[:, 2:]
    np.testing.assert_allclose(scaled(fit_homography(a, b)), scaled(mapping), atol=1e-9)
    np.testing.assert_allclose(homography_distances(mapping, a, b), 0, atol=1e-8)
    got = homography_distances(mapping, a + rng.normal(0, 0.3, a.shape), b + rng.normal(0, 0.3, b.shape))
    assert (got**2).mean() == pytest.approx(2 * 0.09, rel=0.06)  # chi-square of 2, 4000 times: 1.6 %
    horizon = np.array([[0.0, -mapping[2, 2] / mapping[2, 1]]])
    assert np.isinf(homography_distances(mapping, horizon, horizon))

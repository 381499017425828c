"""Lines and checks of two views against projected points and rays."""

import numpy as np
import pytest
from epipolar_rigs import matches, rig, room_points

from occlog.core.geometry.fundamental import (
    check_fundamental,
    epipolar_distances,
    epipolar_lines,
    fundamental_from_poses,
    line_distances,
    scaled,
    symmetric_errors,
)


def inner(camera):
    return np.array(
        [[camera.focal_px[0], 0, camera.principal_px[0]], [0, camera.focal_px[1], camera.principal_px[1]], [0, 0, 1]]
    )


def fundamental(a, b):
    return fundamental_from_poses(inner(a), a.rotation, a.position, inner(b), b.rotation, b.position)


@pytest.mark.parametrize("distance", [None, 100.0, 1e5])
def test_points_lie_on_the_lines_of_their_matches(distance):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        cameras = rig(rng, distance)
        f = fundamental(*cameras)
        a, b = matches(rng, cameras, room_points(rng, 50), 0.0)
        assert epipolar_distances(f, a, b).max() < (1e-8 if distance is None else 1e-4)
        assert np.linalg.norm(f) == pytest.approx(1.0)
        assert f.flat[np.abs(f).argmax()] > 0
        back = fundamental(*cameras[::-1])
        np.testing.assert_allclose(back, scaled(f.T), atol=1e-12)


def test_the_line_of_a_point_is_the_image_of_its_ray():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        first, second = rig(rng)
        a, _ = matches(rng, (first, second), room_points(rng, 10), 0.0)
        near, far = (second.project(first.position + t * first.rays(a)) for t in (6.0, 15.0))
        ok = np.isfinite(near).all(axis=1) & np.isfinite(far).all(axis=1)
        lines = epipolar_lines(fundamental(first, second), a)[ok]
        assert ok.any()
        assert np.abs(line_distances(lines, near[ok])).max() < 1e-7
        assert np.abs(line_distances(lines, far[ok])).max() < 1e-7


def test_cameras_at_one_place_have_no_lines():
    first, _ = rig(np.random.default_rng(0))
    with pytest.raises(ValueError, match="same position"):
        fundamental(first, first)
    with pytest.raises(ValueError, match="finite"):
        scaled(np.zeros((3, 3)))


def test_distances_are_those_of_the_nearest_point_of_the_line():
    rng = np.random.default_rng(1)
    f, a, b = scaled(rng.normal(size=(3, 3))), rng.normal(size=(30, 2)), rng.normal(size=(30, 2))
    got = epipolar_distances(f, a, b)
    for k in range(30):
        l1, l2, l3 = f @ [*a[k], 1.0]
        t = np.linspace(-50, 50, 200_001)
        foot = -l3 * np.array([l1, l2]) / (l1**2 + l2**2)
        line = foot + t[:, None] * np.array([-l2, l1]) / np.hypot(l1, l2)
        assert got[k, 1] == pytest.approx(np.linalg.norm(line - b[k], axis=1).min(), abs=1e-5)
    np.testing.assert_allclose(epipolar_distances(f.T, b, a), got[:, ::-1])
    np.testing.assert_allclose(symmetric_errors(f, a, b), np.sqrt((got**2).sum(axis=1) / 2))


def test_the_epipole_has_no_line():
    f = np.array([[0.0, -1, 10], [1, 0, -20], [-10, 20, 0]])  # lines through (20, 10)
    lines = epipolar_lines(f, np.array([[20.0, 10.0], [20.0, 10.0 + 1e-9]]))
    assert np.isnan(lines[0]).all()
    assert np.isfinite(lines[1]).all()
    assert np.isnan(epipolar_lines(np.zeros((3, 3)), np.array([3.0, 4.0]))).all()


def test_right_matrices_fit_and_wrong_ones_do_not():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        cameras = rig(rng)
        a, b = matches(rng, cameras, room_points(rng, 40), 0.5, wrong=0.3)
        f = fundamental(*cameras)
        good = check_fundamental(f, a, b, tolerance_px=3.0)
        assert good.fits
        assert good.share > 0.55  # 0.7 but for points near an epipole, whose lines are less exact
        assert good.chance < 0.1
        for wrong in (scaled(f.T), fundamental(*rig(rng))):
            bad = check_fundamental(wrong, a, b, tolerance_px=3.0)
            assert not bad.fits
            assert bad.share < 0.4
            assert bad.median_px > 5.0


def test_a_matrix_that_fits_everything_by_chance_is_not_taken_for_right():
    """Points in a few rows: any pairing lies on the lines."""
    rng = np.random.default_rng(2)
    rows = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    a, b = (np.column_stack([rng.uniform(0, 300, 30), rng.normal(100, 0.3, 30)]) for _ in range(2))
    check = check_fundamental(rows, a, b, tolerance_px=3.0)
    assert check.share > 0.95
    assert not check.fits


def test_few_matches_tell_nothing():
    with pytest.raises(ValueError, match="7 matches"):
        check_fundamental(np.eye(3), np.zeros((7, 2)), np.zeros((7, 2)), tolerance_px=3.0)


ROWS = np.array([[0.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""The matrix of two views in which a point keeps its row."""


def in_rows(a, b):
    """Points in given rows, at different columns."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    columns = 10.0 * np.arange(len(a))
    return np.column_stack([columns, a]), np.column_stack([columns + 7.0, b])


@pytest.mark.parametrize(("good", "fits"), [(16, False), (17, True)])
def test_a_matrix_fits_from_three_standard_deviations_above_chance_on(good, fits):
    """20 matches in two rows: about half of the wrong pairings fit, so the bar is 0.482 + 3 sqrt(0.25 / 20) = 0.817."""
    a = np.repeat([0.0, 100.0], 10)
    b = a.copy()
    b[: 20 - good] = 100.0
    assert check_fundamental(ROWS, *in_rows(a, b), tolerance_px=3.0).fits == fits


def test_half_of_the_matches_have_to_fit_unless_another_share_is_given():
    rows = 100.0 * np.arange(8)
    half, fewer = rows + np.repeat([0.0, 50.0], 4), rows + np.repeat([0.0, 50.0], [3, 5])
    assert check_fundamental(ROWS, *in_rows(rows, half), tolerance_px=3.0).fits
    assert not check_fundamental(ROWS, *in_rows(rows, fewer), tolerance_px=3.0).fits
    assert check_fundamental(ROWS, *in_rows(rows, fewer), tolerance_px=3.0, min_share=0.375).fits


def test_a_match_fits_up_to_the_tolerance_from_both_lines():
    rows = 100.0 * np.arange(8)
    assert check_fundamental(ROWS, *in_rows(rows, rows + 3.0), tolerance_px=3.0).share == 1.0
    assert check_fundamental(ROWS, *in_rows(rows, rows + 3.0 + 1e-9), tolerance_px=3.0).share == 0.0
    assert check_fundamental(ROWS, *in_rows(rows, rows + 3.5), tolerance_px=3.5).share == 1.0


def test_eight_matches_are_enough():
    assert check_fundamental(ROWS, *in_rows(100.0 * np.arange(8), 100.0 * np.arange(8)), tolerance_px=3.0).fits


@pytest.mark.parametrize("scale", [10.0, 0.1])
def test_a_match_has_to_be_near_its_line_in_both_views(scale):
    """Rows of view b are `scale` times those of view a, so that 20 px in one view are 2 px in the other."""
    rows, a = 100.0 * np.arange(8), scaled(np.array([[0.0, 0, 0], [0, 0, -1], [0, scale, 0]]))
    off = 20.0 if scale > 1.0 else 2.0
    assert check_fundamental(a, *in_rows(rows, scale * rows), tolerance_px=3.0).share == 1.0
    assert check_fundamental(a, *in_rows(rows, scale * rows + off), tolerance_px=3.0).share == 0.0


def test_one_point_alone_has_its_line_and_its_distance():
    line = epipolar_lines(ROWS, np.array([3.0, 4.0]))
    assert line.shape == (3,)
    assert abs(line_distances(line, np.array([10.0, 9.0]))) == 5.0

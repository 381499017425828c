"""Epipolar geometry of two views without distortion: lines, distances, and whether matches fit, [Qu] Sec. 3.2.

A fundamental matrix F of views a and b makes b' F a = 0 for the images a and b (x, y, 1) of
one point.  F takes points of view a to lines of view b, its transpose those of b to lines
of a.  It has norm 1 and its largest entry is positive.  A line (l1, l2, l3) has
l1^2 + l2^2 = 1, so that l . (x, y, 1) is the signed distance of a point [px].

Points have to be where a camera without distortion would show them.  Matrices of matches and of calibrated
cameras are made in `occlog.measure.epipolar`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

MIN_MATCHES = 8
"""Minimum number of matches for a test of a fundamental matrix."""


class FitCheck(NamedTuple):
    """Whether matches of points fit a fundamental matrix, with their median error and the share of them that fit.

    Also the share of wrong pairings that would fit by chance.
    """

    fits: bool
    median_px: float  # of the symmetric errors
    share: float  # of the matches with both distances within the tolerance
    chance: float  # the same of all wrong pairings of their points


def homogeneous(points: Floats) -> Floats:
    """Return homogeneous coordinates (..., 3) of points (..., 2): x, y, 1."""
    p = np.asarray(points, dtype=np.float64)
    return np.concatenate([p, np.ones((*p.shape[:-1], 1))], axis=-1)


def scaled(matrix: Floats) -> Floats:
    """Return a matrix (3, 3) divided by its norm, with the sign that makes its entry of largest size positive.

    Raises:
        ValueError: the matrix is 0 or not finite.
    """
    norm = float(np.linalg.norm(matrix))
    if not (np.isfinite(norm) and norm > 0.0):
        raise ValueError("a fundamental matrix must be finite and not all 0")
    return np.asarray(matrix / (norm * np.sign(matrix.flat[int(np.abs(matrix).argmax())])))


def fundamental_from_poses(
    inner_a: Floats, rotation_a: Floats, centre_a: Floats, inner_b: Floats, rotation_b: Floats, centre_b: Floats
) -> Floats:
    """Return the fundamental matrix of two cameras without distortion: F = K_b^-T [t]_x R K_a^-1.

    It has norm 1 and its entry of largest size is positive; b^T F a = 0 for the images a and b of a point.

    Args:
        inner_a: (3, 3) inner matrix K (focal lengths, principal point) of camera a.
        rotation_a: (3, 3) world-from-camera rotation of camera a.
        centre_a: (3,) position of camera a in the world.
        inner_b: (3, 3) inner matrix of camera b.
        rotation_b: (3, 3) world-from-camera rotation of camera b.
        centre_b: (3,) position of camera b in the world.

    Raises:
        ValueError: the two cameras are at the same position, so that there are no epipolar lines.
    """
    baseline = np.asarray(centre_a, dtype=np.float64) - centre_b
    largest = max(float(np.abs(centre_a).max()), float(np.abs(centre_b).max()))
    if not float(np.linalg.norm(baseline)) > 1e-12 * largest:
        raise ValueError("the two cameras are at the same position: a point has no epipolar line")
    tx, ty, tz = rotation_b.T @ baseline / np.linalg.norm(baseline)
    cross = np.array([[0.0, -tz, ty], [tz, 0.0, -tx], [-ty, tx, 0.0]])
    return scaled(np.linalg.inv(inner_b).T @ cross @ rotation_b.T @ rotation_a @ np.linalg.inv(inner_a))


def epipolar_lines(matrix: Floats, points: Floats) -> Floats:
    """Return the (..., 3) epipolar lines in view b of points in view a, with unit normal (l1, l2).

    NaN for the epipole, and for a matrix that gives no line.

    Args:
        matrix: (3, 3) fundamental matrix from view a to view b; its transpose for points of view b.
        points: (..., 2) points without distortion [px].
    """
    lines = homogeneous(points) @ np.asarray(matrix).T
    with np.errstate(divide="ignore", invalid="ignore"):
        out = lines / np.hypot(lines[..., 0], lines[..., 1])[..., None]
    return np.asarray(np.where(np.isfinite(out), out, np.nan))


def line_distances(lines: Floats, points: Floats) -> Floats:
    """Return the signed distances (...) [px] of points (..., 2) from lines (..., 3) with unit normal (l1, l2)."""
    return np.asarray((lines * homogeneous(points)).sum(axis=-1))


def epipolar_distances(matrix: Floats, a: Floats, b: Floats) -> Floats:
    """Return the (N, 2) distances [px] of matched points from each other's epipolar lines: in view a, in view b.

    Args:
        matrix: (3, 3) fundamental matrix from view a to view b.
        a: (N, 2) points in view a [px].
        b: (N, 2) their matches in view b [px].
    """
    back = line_distances(epipolar_lines(np.asarray(matrix).T, b), a)
    return np.abs(np.column_stack([back, line_distances(epipolar_lines(matrix, a), b)]))


def symmetric_errors(matrix: Floats, a: Floats, b: Floats) -> Floats:
    """Return the (N,) root mean square [px] of the epipolar distances of each match in the two views.

    Args:
        matrix: (3, 3) fundamental matrix from view a to view b.
        a: (N, 2) points in view a [px].
        b: (N, 2) their matches in view b [px].
    """
    return np.asarray(np.sqrt((epipolar_distances(matrix, a, b) ** 2).mean(axis=1)))


def check_fundamental(matrix: Floats, a: Floats, b: Floats, tolerance_px: float, min_share: float = 0.5) -> FitCheck:
    """Return whether matches, some of which may be wrong, agree with a fundamental matrix, with figures of the test.

    It fits when at least `min_share` of the matches lie within the tolerance of both epipolar lines, and this share
    exceeds that of wrong pairings of the points by three standard deviations.

    Args:
        matrix: (3, 3) fundamental matrix from view a to view b.
        a: (N, 2) points of view a [px].
        b: (N, 2) their matches in view b [px].
        tolerance_px: largest distance from both lines of a match that supports the matrix [px].
        min_share: least share of supporting matches, 0 to 1.

    Raises:
        ValueError: fewer than 8 matches.
    """
    # Share of matches within the tolerance of both lines
    n = len(a)
    if n < MIN_MATCHES:
        raise ValueError(f"{n} matches are too few to test a fundamental matrix; give at least {MIN_MATCHES}")
    good = (epipolar_distances(matrix, a, b) <= tolerance_px).all(axis=1)
    # The same share of all n (n - 1) wrong pairings: what chance gives
    to_b, to_a = epipolar_lines(matrix, a), epipolar_lines(np.asarray(matrix).T, b)
    pairs = (np.abs(to_b @ homogeneous(b).T) <= tolerance_px) & (np.abs(to_a @ homogeneous(a).T) <= tolerance_px).T
    chance = float((pairs.sum() - np.diagonal(pairs).sum()) / (n * (n - 1)))
    # The bar: chance and three standard deviations of a share of n matches by chance
    share = float(good.mean())
    bar = chance + 3.0 * float(np.sqrt(chance * (1.0 - chance) / n))
    errors = symmetric_errors(matrix, a, b)
    median = float(np.median(np.where(np.isnan(errors), np.inf, errors)))
    return FitCheck(share >= min_share and share > bar, median, share, chance)

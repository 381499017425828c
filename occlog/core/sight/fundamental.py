"""Epipolar geometry of two views without distortion: lines, bands, errors and checks, [Qu] Sec. 3.2.

A fundamental matrix F of views a and b makes b' F a = 0 for the images a and b (x, y, 1) of
one point.  F takes points of view a to lines of view b, its transpose those of b to lines
of a.  It has norm 1 and its largest entry is positive.  A line (l1, l2, l3) has
l1^2 + l2^2 = 1, so that l . (x, y, 1) is the signed distance of a point [px].

Points have to be where a camera without distortion would show them.  Matrices from matches
are in `epipolar_fit` and `occlog.measure.epipolar.of_scene`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

TOLERANCE_PX = 3.0
"""A match within this distance of both epipolar lines speaks for a fundamental matrix."""

FEWEST = 8
"""Matches below which nothing is said about whether a fundamental matrix fits."""


class FitCheck(NamedTuple):
    """Whether matches agree with a fundamental matrix."""

    fits: bool
    median_px: float  # of the symmetric errors
    share: float  # of the matches whose two distances are within the tolerance
    chance: float  # the same of all wrong pairings of their points


def homogeneous(points: Floats) -> Floats:
    """(..., 2) points as (..., 3) with a 1 behind."""
    p = np.asarray(points, dtype=np.float64)
    return np.concatenate([p, np.ones((*p.shape[:-1], 1))], axis=-1)


def scaled(matrix: Floats) -> Floats:
    """(3, 3) the same matrix with norm 1 and its largest entry positive; ValueError for one that is 0 or not finite."""
    norm = float(np.linalg.norm(matrix))
    if not (np.isfinite(norm) and norm > 0.0):
        raise ValueError("a fundamental matrix must be finite and not all 0")
    return np.asarray(matrix / (norm * np.sign(matrix.flat[int(np.abs(matrix).argmax())])))


def fundamental_from_poses(
    inner_a: Floats, rotation_a: Floats, centre_a: Floats, inner_b: Floats, rotation_b: Floats, centre_b: Floats
) -> Floats:
    """Fundamental matrix of two cameras without distortion.

    Args:
        inner_a: (3, 3) matrix of focal lengths and principal point of camera a.
        rotation_a: (3, 3) world-from-camera.
        centre_a: (3,) in the world.
        inner_b: the same of camera b.
        rotation_b: of camera b.
        centre_b: of camera b.

    Returns:
        (3, 3); ValueError for two cameras at the same place, which have no epipolar lines.
    """
    apart = np.asarray(centre_a, dtype=np.float64) - centre_b
    largest = max(float(np.abs(centre_a).max()), float(np.abs(centre_b).max()))
    if not float(np.linalg.norm(apart)) > 1e-12 * largest:
        raise ValueError("the two cameras are at the same place: a point has no epipolar line")
    tx, ty, tz = rotation_b.T @ apart / np.linalg.norm(apart)
    cross = np.array([[0.0, -tz, ty], [tz, 0.0, -tx], [-ty, tx, 0.0]])
    return scaled(np.linalg.inv(inner_b).T @ cross @ rotation_b.T @ rotation_a @ np.linalg.inv(inner_a))


def epipole(matrix: Floats) -> Floats:
    """(3,) unit vector: the image in view a of camera b; its last entry is near 0 for one far outside the image."""
    return np.asarray(np.linalg.svd(matrix)[2][2])


def epipolar_lines(matrix: Floats, points: Floats) -> Floats:
    """(..., 3) lines in view b of points (..., 2) in view a; NaN for the epipole, and for a matrix that gives no line.

    For points of view b give the transposed matrix.
    """
    lines = homogeneous(points) @ np.asarray(matrix).T
    with np.errstate(divide="ignore", invalid="ignore"):
        out = lines / np.hypot(lines[..., 0], lines[..., 1])[..., None]
    return np.asarray(np.where(np.isfinite(out), out, np.nan))


def line_distances(lines: Floats, points: Floats) -> Floats:
    """Signed distances [px] of points (..., 2) from lines (..., 3)."""
    return np.asarray((lines * homogeneous(points)).sum(axis=-1))


def epipolar_distances(matrix: Floats, a: Floats, b: Floats) -> Floats:
    """(N, 2) distances [px] of points a (N, 2) from the lines of their matches b (N, 2), and of b from those of a."""
    back = line_distances(epipolar_lines(np.asarray(matrix).T, b), a)
    return np.abs(np.column_stack([back, line_distances(epipolar_lines(matrix, a), b)]))


def symmetric_errors(matrix: Floats, a: Floats, b: Floats) -> Floats:
    """(N,) root mean square of the two `epipolar_distances` of each match [px]."""
    return np.asarray(np.sqrt((epipolar_distances(matrix, a, b) ** 2).mean(axis=1)))


def consistent(matrix: Floats, a: Floats, b: Floats, radius_a: Floats | float, radius_b: Floats | float) -> Bools:
    """(N,) the loop check of [Qu] Sec. 3.4.2: both distances are at most the radius of the target in that view."""
    distances = epipolar_distances(matrix, a, b)
    return np.asarray((distances[:, 0] <= radius_a) & (distances[:, 1] <= radius_b))


def epipolar_bands(matrix: Floats, ellipses: Floats) -> Floats:
    """Bands in view b in which the ellipses of view a can be.

    Args:
        matrix: (3, 3).
        ellipses: (N, 5) in view a, see `occlog.core.image.ellipse`.

    Returns:
        (N, 2, 3): the lines of the two points at which lines from the epipole touch an
        ellipse, turned so that distances from them have different signs inside the band and
        equal ones outside.  NaN for an ellipse that holds the epipole: it can be anywhere.
    """
    e = np.asarray(ellipses, dtype=np.float64)
    x, y, w = epipole(matrix)
    dx, dy = x - w * e[:, 0], y - w * e[:, 1]
    c, s = np.cos(e[:, 4]), np.sin(e[:, 4])
    # Where the ellipse is the unit circle: direction and distance (as a cosine) of the epipole
    u, v = (c * dx + s * dy) / e[:, 2], (-s * dx + c * dy) / e[:, 3]
    sign = 1.0 if w >= 0 else -1.0
    far = np.hypot(u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.arccos(np.where(far > abs(w), abs(w) / far, np.nan))
    angle = np.arctan2(sign * v, sign * u)[:, None] + half[:, None] * np.array([-1.0, 1.0])
    p, q = e[:, 2:3] * np.cos(angle), e[:, 3:4] * np.sin(angle)
    touch = e[:, None, :2] + np.stack([c[:, None] * p - s[:, None] * q, s[:, None] * p + c[:, None] * q], axis=-1)
    return _facing(epipolar_lines(matrix, touch), epipolar_lines(matrix, e[:, :2]), epipole(np.asarray(matrix).T))


def _facing(bands: Floats, middle: Floats, other_epipole: Floats) -> Floats:
    """The bands with the second line turned so that points of the middle line have distances of different signs."""
    # On the middle line, away from the epipole of view b, where all three lines meet
    x, y, w = other_epipole
    along = np.stack([-middle[:, 1], middle[:, 0]], axis=-1)
    foot = -middle[:, 2:] * middle[:, :2]
    if abs(w) > 1e-12:
        reach = 1.0 + float(np.hypot(x, y)) / abs(w)
        foot = np.array([x, y]) / w + reach * along
    product = line_distances(bands[:, 0], foot) * line_distances(bands[:, 1], foot)
    out = bands.copy()
    out[:, 1] *= np.where(product > 0.0, -1.0, 1.0)[:, None]
    return out


def band_distances(bands: Floats, points: Floats) -> Floats:
    """(N,) distances [px] of points (N, 2) from bands (N, 2, 3), 0 inside; 0 for a NaN band, which is everywhere."""
    d = line_distances(bands, np.asarray(points)[:, None, :])
    outside = d[:, 0] * d[:, 1] > 0.0
    return np.where(outside, np.abs(d).min(axis=1), 0.0)


def check_fundamental(
    matrix: Floats, a: Floats, b: Floats, tolerance_px: float = TOLERANCE_PX, min_share: float = 0.5
) -> FitCheck:
    """Whether matches, some of which may be wrong, agree with a fundamental matrix.

    It fits when at least `min_share` of the matches lie within the tolerance of both lines,
    and more than wrong pairings of the same points do by three standard deviations.

    Args:
        matrix: (3, 3).
        a: (N, 2) points of view a [px].
        b: (N, 2) their matches in view b.
        tolerance_px: largest distance from a line.
        min_share: 0 to 1.

    Raises:
        ValueError: fewer than 8 matches.
    """
    n = len(a)
    if n < FEWEST:
        raise ValueError(f"{n} matches do not tell whether a fundamental matrix fits; give at least {FEWEST}")
    good = (epipolar_distances(matrix, a, b) <= tolerance_px).all(axis=1)
    to_b, to_a = epipolar_lines(matrix, a), epipolar_lines(np.asarray(matrix).T, b)
    pairs = (np.abs(to_b @ homogeneous(b).T) <= tolerance_px) & (np.abs(to_a @ homogeneous(a).T) <= tolerance_px).T
    chance = float((pairs.sum() - np.diagonal(pairs).sum()) / (n * (n - 1)))
    share = float(good.mean())
    bar = chance + 3.0 * float(np.sqrt(chance * (1.0 - chance) / n))
    errors = symmetric_errors(matrix, a, b)
    median = float(np.median(np.where(np.isnan(errors), np.inf, errors)))
    return FitCheck(share >= min_share and share > bar, median, share, chance)

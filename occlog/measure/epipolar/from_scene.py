"""Fundamental matrices from camera poses, and robustly from matches.

Degenerate sets of matches are refused: too few, on one line, on one plane, or from one position. The floor is such a
plane: a matrix from people's feet is wrong by tens of pixels for their heads.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import fdtrc

from occlog.array_types import Bools, Floats
from occlog.core.geometry.fundamental import fundamental_from_poses
from occlog.core.geometry.lens import undistort
from occlog.records.scene import Camera

from .config import EpipolarConfig
from .fit import (
    BEST_NOISE_PX,
    FundamentalMatrixFit,
    fit_affine,
    fit_homography,
    fit_perspective,
    homography_distances,
    homography_parallax,
    sampson,
)

MIN_MATCHES = 20
PARALLAX = 3.0
"""Matches must differ from those of a plane by this many times their noise."""
OFF_PLANE_NOISE = 4.0
"""A match this many times the noise away from a plane's is off it."""
OFF_PLANE = 8
"""Matches off the plane of most matches, at least, that have to agree."""
OFF_PLANE_SHARE = 1 / 3
"""Minimum share of all matches off that plane that have to agree."""
AGREEING = 0.75
"""Share of the least number of matches that has to agree."""
AFFINE_DRAWS = 500
"""Sets of four matches that the robust affine fit tries."""


class FundamentalFit(NamedTuple):
    """A fundamental matrix estimated from N matches of views a and b.

    Attributes:
        matrix: (3, 3) matrix F with b' F a = 0 for homogeneous points a, b [px].
        inliers: (N,) mask of the matches that it rests on.
        noise_px: standard deviation of a coordinate of the inliers [px].
        error_px: expected error of its epipolar lines [px].
        parallax_px: RMS parallax of the inliers relative to a plane [px].
        affine: whether the affine model (parallel rays) was sufficient.
    """

    matrix: Floats
    inliers: Bools
    noise_px: float
    error_px: float  # expected error of its lines, see `occlog.measure.epipolar.fit.fit_perspective`
    parallax_px: float
    affine: bool


def ideal_pixels(camera: Camera, pixels: Floats) -> Floats:
    """(N, 2) undistorted pixels of recorded pixels (N, 2), by the camera's lens model."""
    normalised = (np.asarray(pixels, dtype=np.float64) - camera.principal_px) / camera.focal_px
    return undistort(normalised, camera.distortion, camera.distortion_model) * camera.focal_px + camera.principal_px


def ideal_pixels_anywhere(camera: Camera, pixels: Floats) -> Floats:
    """(N, 2) undistorted pixels of recorded pixels (N, 2), also outside the image.

    Outside, where the lens model may have no solution, the shift is that of the nearest point at the image border.
    """
    p = np.asarray(pixels, dtype=np.float64)
    if camera.image_size is None or camera.straight:
        return ideal_pixels(camera, p)
    inside = np.clip(p, -0.5, np.array(camera.image_size) - 0.5)
    return ideal_pixels(camera, inside) + (p - inside)


def fundamental_of_cameras(a: Camera, b: Camera) -> Floats:
    """(3, 3) fundamental matrix from camera a to camera b of a scene, for undistorted pixels (`ideal_pixels`).

    Raises:
        ValueError: a camera's pose is unknown, or both are at the same position.
    """
    for camera in (a, b):
        if not camera.placed:
            raise ValueError(f"camera {camera.name} has no pose; estimate the matrix from matches")
    try:
        return fundamental_from_poses(
            inner_a=_inner(a),
            rotation_a=a.rotation,
            centre_a=a.position,
            inner_b=_inner(b),
            rotation_b=b.rotation,
            centre_b=b.position,
        )
    except ValueError as error:
        raise ValueError(f"cameras {a.name} and {b.name}: {error}") from error


def _inner(camera: Camera) -> Floats:
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def estimate_fundamental(
    a: Floats,
    b: Floats,
    config: EpipolarConfig | None = None,
    *,
    min_matches: int = MIN_MATCHES,
) -> FundamentalFit:
    """Estimate the fundamental matrix of matches, by random sampling (MAGSAC) and least squares over the inliers.

    Args:
        a: (N, 2) points of view a without distortion [px].
        b: (N, 2) their matches in view b.
        config: `model`, where `auto` means affine unless perspective fits significantly better (F test at 1 %);
            `inlier_threshold_px`, the initial largest Sampson distance of an inlier, later three standard deviations of
            the noise; `max_epipolar_error_px`, the largest expected error of the lines. None: the defaults.
        min_matches: minimum number of matches; three quarters of it must be inliers.

    Raises:
        ValueError: the matches are not finite, too few, on a line or a plane, from one position, or do not
            determine the matrix well enough.
    """
    a, b = np.ascontiguousarray(a, dtype=np.float64), np.ascontiguousarray(b, dtype=np.float64)
    config = config or EpipolarConfig()
    threshold_px = config.inlier_threshold_px
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 2 or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError(f"matches must be two arrays (N, 2) of finite points; got {a.shape} and {b.shape}")
    if len(a) < min_matches:
        raise ValueError(f"{len(a)} matches; a fundamental matrix needs at least {min_matches}: add matches")
    # Fit robustly: MAGSAC, then least squares over the inliers; affine by random sampling
    _not_on_a_line(a, b, threshold_px)
    fit, inliers, affine = _robust(a, b, config.model, threshold_px)
    agree = int(inliers.sum())
    if agree < AGREEING * min_matches:
        raise ValueError(
            f"{agree} of {len(a)} matches agree with the best fundamental matrix, must be at least "
            f"{AGREEING * min_matches:g}; correct the others, or add matches"
        )
    # Refuse degenerate sets: a line, a plane, one position
    _not_on_a_line(a[inliers], b[inliers], threshold_px)
    parallax = _not_on_a_plane(a, b, inliers, max(fit.noise_px, BEST_NOISE_PX))
    if not fit.error_px <= config.max_epipolar_error_px:
        raise ValueError(
            f"the fundamental matrix has an expected error of {fit.error_px:.3g} px, must be at most "
            f"{config.max_epipolar_error_px:g}; add matches, spread in depth and over the images"
        )
    return FundamentalFit(
        matrix=fit.matrix,
        inliers=inliers,
        noise_px=fit.noise_px,
        error_px=fit.error_px,
        parallax_px=parallax,
        affine=affine,
    )


def _not_on_a_line(a: Floats, b: Floats, threshold_px: float) -> None:
    for points, view in ((a, "first"), (b, "second")):
        across = float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1]) / np.sqrt(len(points))
        if across < threshold_px:
            raise ValueError(
                f"the matches are on a line in the {view} view (spread across it {across:.2g} px, "
                f"must be at least {threshold_px:g}); add matches off the line"
            )


def _not_on_a_plane(a: Floats, b: Floats, inliers: Bools, noise: float) -> float:
    """Parallax [px] of the inlier matches relative to one plane; ValueError if it is insignificant.

    If all inliers are on one plane, two degrees of freedom are determined by few wrong matches. So enough inliers must
    be off the plane, and a third of the matches off the plane must be inliers.

    Args:
        a: (N, 2) points in the first view [px].
        b: (N, 2) their matches in the second view.
        inliers: (N,) mask of inliers of the fundamental matrix.
        noise: standard deviation of a coordinate [px].
    """
    parallax = homography_parallax(a[inliers], b[inliers])
    if parallax < PARALLAX * noise:
        raise ValueError(
            f"the matches fit one plane, or cameras at one position: they deviate from it by {parallax:.2g} px, "
            f"must be at least {PARALLAX * noise:.2g} ({PARALLAX:g} x noise); add matches off the plane"
        )
    off = _off_the_plane(a, b, noise)
    agree, all_off = int((inliers & off).sum()), int(off.sum())
    if agree < OFF_PLANE or agree < OFF_PLANE_SHARE * all_off:
        raise ValueError(
            f"the matches are of one plane, or the cameras at one position: only {agree} of {all_off} off the plane "
            f"agree, must be at least {max(OFF_PLANE, math.ceil(OFF_PLANE_SHARE * all_off))}; add matches off the plane"
        )
    return parallax


def _off_the_plane(a: Floats, b: Floats, noise: float) -> Bools:
    """(N,) mask of the matches a, b (N, 2) that are off the plane (or camera rotation) that fits most of them.

    The views may see the plane from the same or from opposite sides. `noise` is the standard deviation of a coordinate
    [px].
    """
    front, behind = (_off_one_plane(a, b, side, noise) for side in (1.0, -1.0))
    return front if front.sum() <= behind.sum() else behind


def _off_one_plane(a: Floats, b: Floats, side: float, noise: float) -> Bools:
    """(N,) mask of the matches that are off the plane that fits most of them; all True if none is found.

    Args:
        a: (N, 2) points in the first view [px].
        b: (N, 2) their matches in the second view.
        side: 1: both views see the same side of the plane; -1: opposite sides.
        noise: standard deviation of a coordinate [px].
    """
    mirror = np.array([side, 1.0])
    mapping, _ = cv2.findHomography(a, b * mirror, cv2.USAC_MAGSAC, PARALLAX * noise, maxIters=5_000, confidence=0.9999)
    off = np.ones(len(a), dtype=np.bool_)
    if mapping is None:
        return off
    again = homography_distances(np.diag([side, 1.0, 1.0]) @ mapping, a, b) > OFF_PLANE_NOISE * noise
    while again.sum() < off.sum():
        off = again
        if len(a) - off.sum() >= OFF_PLANE:
            again = homography_distances(fit_homography(a[~off], b[~off]), a, b) > OFF_PLANE_NOISE * noise
    return off


def _robust(a: Floats, b: Floats, model: str, threshold_px: float) -> tuple[FundamentalMatrixFit, Bools, bool]:
    """Robust fit of a fundamental matrix, the mask (N,) of its inliers, and whether it is affine.

    ValueError if no matrix agrees with the matches.

    Args:
        a: (N, 2) points in the first view [px].
        b: (N, 2) their matches in the second view.
        model: `affine`, `perspective`, or `auto` for the better one.
        threshold_px: largest Sampson distance of an inlier at first.
    """
    candidates: list[tuple[FundamentalMatrixFit, Bools, bool]] = []
    if model != "affine":
        found = _magsac(a, b, threshold_px)
        if found is not None:
            candidates.append((*_settle(a, b, found, threshold_px, affine=False), False))
    if model != "perspective":
        candidates.append((*_settle(a, b, _sampled_affine(a, b, threshold_px), threshold_px, affine=True), True))
    if not candidates:
        raise ValueError(
            "no fundamental matrix agrees with the matches: they are wrong, too few or on a plane; correct or add some"
        )
    if len(candidates) == 1:
        return candidates[0]
    return candidates[1] if _affine_will_do(a, b, candidates[0], candidates[1]) else candidates[0]


def _affine_will_do(
    a: Floats,
    b: Floats,
    full: tuple[FundamentalMatrixFit, Bools, bool],
    affine: tuple[FundamentalMatrixFit, Bools, bool],
) -> bool:
    """Whether the perspective fit is not significantly better than the affine one (F test at 1 %, 3 more unknowns).

    With few inliers, or many fewer affine ones, the fit with more inliers is preferred.

    Args:
        a: (N, 2) points in the first view [px].
        b: (N, 2) their matches in the second view.
        full: perspective fit, mask of its inliers, False.
        affine: affine fit, mask of its inliers, True.
    """
    inliers, fit = full[1], full[0]
    n = int(inliers.sum())
    if n < MIN_MATCHES or affine[1].sum() < 0.9 * n:
        return int(affine[1].sum()) > n
    left = float((fit.residuals**2).sum())
    more = float((fit_affine(a[inliers], b[inliers]).residuals ** 2).sum()) - left
    floor = max(left / (n - 7), 1e-6 * BEST_NOISE_PX**2)
    return bool(fdtrc(3, n - 7, max(more, 0.0) / 3.0 / floor) > 0.01)


def _magsac(a: Floats, b: Floats, threshold_px: float) -> Floats | None:
    """(3, 3) fundamental matrix of matches a, b (N, 2) by OpenCV's MAGSAC++ (deterministic); None if none is found.

    `threshold_px` is its inlier threshold.
    """
    try:
        matrix, _ = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, threshold_px, 0.9999, 10_000)
    except cv2.error:
        return None
    if matrix is None or matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not matrix.any():
        return None
    return np.asarray(matrix, dtype=np.float64)


def _sampled_affine(a: Floats, b: Floats, threshold_px: float) -> Floats:
    """(3, 3) affine fundamental matrix: the best of `AFFINE_DRAWS` random sets of 4 matches by truncated squared error.

    The draws are the same each time; distances of the matches a, b (N, 2) are truncated at `threshold_px`.
    """
    both = np.hstack([b, a])
    rng = np.random.default_rng(0)  # the same sets every time
    sets = both[np.argsort(rng.random((AFFINE_DRAWS, len(both))), axis=1)[:, :4]]
    normals = np.linalg.svd(sets[:, 1:] - sets[:, :1])[2][:, 3]
    offsets = -(normals * sets[:, 0]).sum(axis=1)
    squares = np.minimum((normals @ both.T + offsets[:, None]) ** 2, threshold_px**2)
    best = int(squares.sum(axis=1).argmin())
    (p, q, r, s), t = normals[best], offsets[best]
    return np.array([[0.0, 0.0, p], [0.0, 0.0, q], [r, s, t]])


def _settle(
    a: Floats, b: Floats, matrix: Floats, threshold_px: float, *, affine: bool
) -> tuple[FundamentalMatrixFit, Bools]:
    """Alternate least squares over the inliers and reselection of inliers, until these are stable.

    Args:
        a: (N, 2) points in the first view [px].
        b: (N, 2) their matches in the second view.
        matrix: (3, 3) start.
        threshold_px: largest Sampson distance of an inlier at first.
        affine: fit an affine matrix.

    Returns:
        The last fit, and the mask (N,) of its inliers.
    """
    fewest = 5 if affine else 8
    inliers = np.abs(sampson(matrix, a, b)) <= threshold_px
    fit = FundamentalMatrixFit(matrix, np.zeros(int(inliers.sum())), np.inf, np.inf)
    for _ in range(10):
        if inliers.sum() < fewest:
            break
        fit = fit_affine(a[inliers], b[inliers]) if affine else fit_perspective(a[inliers], b[inliers], fit.matrix)
        residuals = np.abs(sampson(fit.matrix, a, b))
        count = int(inliers.sum())
        spread = 1.4826 * float(np.median(residuals[inliers])) * math.sqrt(count / (count - fewest + 1))
        again = residuals <= min(max(3.0 * spread, 3.0 * BEST_NOISE_PX), 3.0 * threshold_px)
        if np.array_equal(again, inliers):
            break
        inliers = again
    return fit, inliers

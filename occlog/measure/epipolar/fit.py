"""Least-squares fits of fundamental matrices and homographies to matches, with the expected error of the lines.

The error of a match is its Sampson distance: the first-order distance, in the four coordinates of its two points, from
an exact match. With noise of standard deviation s in every coordinate it has standard deviation s.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.fundamental import epipolar_lines, homogeneous, scaled

BEST_NOISE_PX = 0.1
"""Minimum noise assumed for a match [px]."""


class FundamentalMatrixFit(NamedTuple):
    """A fundamental matrix (3, 3) from view a to view b with its fit to N matches.

    `residuals` (N,) are Sampson distances [px]; `noise_px` the standard deviation of a coordinate of a match, from
    them; `error_px` the expected root mean square error of the epipolar lines, infinite if they do not determine
    the matrix.
    """

    matrix: Floats  # (3, 3)
    residuals: Floats  # (N,) Sampson distances [px]
    noise_px: float  # standard deviation of a coordinate of a match, from the residuals
    error_px: float  # expected error of its lines, see `fit_affine` and `fit_perspective`; inf: not given


def sampson(matrix: Floats, a: Floats, b: Floats) -> Floats:
    """(N,) signed Sampson distances [px] of matches a, b (N, 2) by the fundamental matrix (3, 3): b' F a = 0."""
    fa, fb = homogeneous(a) @ matrix.T, homogeneous(b) @ matrix
    value = (homogeneous(b) * fa).sum(axis=1)
    length = np.sqrt(fa[:, 0] ** 2 + fa[:, 1] ** 2 + fb[:, 0] ** 2 + fb[:, 1] ** 2)
    return np.asarray(value / np.maximum(length, 1e-300))


def sampson_slopes(matrix: Floats, a: Floats, b: Floats) -> Floats:
    """(N, 3, 3) derivatives of Sampson distances with respect to the entries of the fundamental matrix (3, 3).

    Matches are points a (N, 2) and b (N, 2) [px] of both views, with b' F a = 0.
    """
    ha, hb = homogeneous(a), homogeneous(b)
    fa, fb = ha @ matrix.T, hb @ matrix
    fa[:, 2], value = 0.0, (hb * fa).sum(axis=1)
    fb[:, 2] = 0.0
    length = np.maximum(np.sqrt((fa**2).sum(axis=1) + (fb**2).sum(axis=1)), 1e-300)[:, None, None]
    change = fa[:, :, None] * ha[:, None, :] + hb[:, :, None] * fb[:, None, :]
    return np.asarray(hb[:, :, None] * ha[:, None, :] / length - value[:, None, None] * change / length**3)


def fit_affine(a: Floats, b: Floats) -> FundamentalMatrixFit:
    """Best affine fundamental matrix of two views with parallel rays (distant cameras with long lenses).

    The matches are on a hyperplane of their four coordinates, found by linear least squares. `error_px` is the expected
    root mean square error of the epipolar lines, by propagation of the errors of the four unknowns.

    Args:
        a: (N, 2) points of the first view [px], N >= 5.
        b: (N, 2) their matches in the second view.
    """
    both = np.hstack([b, a])
    mean = both.mean(axis=0)
    _, _, turns = np.linalg.svd(both - mean, full_matrices=False)
    matrix = scaled(_affine_matrix(turns[3], -float(turns[3] @ mean)))
    length = float(np.linalg.norm(matrix[[0, 1, 2, 2], [2, 2, 0, 1]]))
    tangents = [_affine_matrix(length * t, -length * float(t @ mean)) for t in turns[:3]]
    return _judged(matrix, np.array([*tangents, _affine_matrix(np.zeros(4), length)]), a, b)


def _affine_matrix(normal: Floats, offset: float) -> Floats:
    """(3, 3) affine fundamental matrix of the hyperplane normal . (xb, yb, xa, ya) + offset = 0; `normal` is (4,)."""
    matrix = np.zeros((3, 3))
    matrix[0, 2], matrix[1, 2], matrix[2, 0], matrix[2, 1] = normal
    matrix[2, 2] = offset
    return matrix


def eight_points(a: Floats, b: Floats) -> Floats:
    """(3, 3) fundamental matrix of rank 2 from matches a, b (N, 2), N >= 8, by the normalised eight-point algorithm.

    Norm 1; b' F a = 0 (Hartley and Zisserman).
    """
    # Normalised eight-point algorithm: linear least squares, then the nearest matrix of rank 2
    a1, b1, change_a, change_b = _about_zero(a, b)
    rows = homogeneous(b1)[:, :, None] * homogeneous(a1)[:, None, :]
    u, sizes, vt = np.linalg.svd(_least(rows.reshape(-1, 9)).reshape(3, 3))
    return scaled(change_b.T @ (u @ np.diag([sizes[0], sizes[1], 0.0]) @ vt) @ change_a)


def _least(rows: Floats) -> Floats:
    """Return the (9,) unit vector x that minimises |rows x|, for `rows` (N, 9) with N >= 8."""
    padded = np.vstack([rows, np.zeros((1, 9))])  # 8 rows have 9 directions, too
    return np.asarray(np.linalg.svd(padded, full_matrices=False)[2][8])


def fit_perspective(a: Floats, b: Floats, start: Floats | None = None, steps: int = 50) -> FundamentalMatrixFit:
    """Rank 2 fundamental matrix that minimises the sum of squared Sampson distances (Levenberg-Marquardt).

    `error_px` is the expected root mean square error of its epipolar lines, at the spread of the points along the line
    on both sides of the match, by first-order propagation of the errors of the seven unknowns. It is large for
    degenerate sets of matches.

    Args:
        a: (N, 2) points of the first view [px], N >= 8.
        b: (N, 2) their matches in the second view.
        start: (3, 3) matrix to start from; None: that of `eight_points`.
        steps: maximum number of iterations.
    """
    a1, b1, change_a, change_b = _about_zero(a, b)
    first = eight_points(a, b) if start is None else start
    u, sizes, vt = np.linalg.svd(np.linalg.inv(change_b).T @ first @ np.linalg.inv(change_a))
    angle, damping = float(np.arctan2(sizes[1], sizes[0])), 1e-3
    residual = sampson(_rank2(u, angle, vt), a1, b1)
    # Levenberg-Marquardt on the manifold of matrices of rank 2
    for _ in range(steps):
        slopes = np.einsum("nij,kij->nk", sampson_slopes(_rank2(u, angle, vt), a1, b1), _tangents(u, angle, vt))
        normal, downhill = slopes.T @ slopes, slopes.T @ residual
        normal += damping * np.diag(np.diagonal(normal) + 1e-15)
        step = -np.linalg.lstsq(normal, downhill, rcond=None)[0]
        trial = (u @ _turn(step[:3]), angle + float(step[6]), _turn(step[3:6]).T @ vt)
        tried = sampson(_rank2(*trial), a1, b1)
        if tried @ tried < residual @ residual:
            gain = 1.0 - (tried @ tried) / (residual @ residual)
            (u, angle, vt), residual, damping = trial, tried, 0.1 * damping
            if gain < 1e-12:
                break
        elif damping > 1e6:
            break
        else:
            damping *= 10.0
    matrix = change_b.T @ _rank2(u, angle, vt) @ change_a
    tangents = change_b.T @ _tangents(u, angle, vt) @ change_a
    norm = np.linalg.norm(matrix) * np.sign(matrix.flat[int(np.abs(matrix).argmax())])
    return _judged(matrix / norm, tangents / norm, a, b)


def _about_zero(a: Floats, b: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Normalise points a and b (N, 2) of two views to mean 0 and scale 1; return both with their transforms (3, 3).

    The scale is common to both, so that ratios of distances are preserved.
    """
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    size = float(np.sqrt((((a - mean_a) ** 2).sum() + ((b - mean_b) ** 2).sum()) / (2 * len(a))))
    s = 1.0 / max(size, 1e-12)
    changes = [np.array([[s, 0.0, -s * m[0]], [0.0, s, -s * m[1]], [0.0, 0.0, 1.0]]) for m in (mean_a, mean_b)]
    return s * (a - mean_a), s * (b - mean_b), changes[0], changes[1]


_CROSS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)
"""(3, 3, 3) small turns about x, y, z."""


def _turn(vector: Floats) -> Floats:
    """Return the (3, 3) rotation matrix of a rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-15:
        return np.eye(3)
    cross = np.tensordot(vector / angle, _CROSS, axes=1)
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def _rank2(u: Floats, angle: float, vt: Floats) -> Floats:
    return np.asarray(u @ np.diag([np.cos(angle), np.sin(angle), 0.0]) @ vt)


def _tangents(u: Floats, angle: float, vt: Floats) -> Floats:
    """(7, 3, 3) derivatives of the matrix u diag(cos angle, sin angle, 0) vt.

    By three rotations of u (3, 3), three of v (`vt` (3, 3) is its transpose), and the angle [rad].
    """
    middle = np.diag([np.cos(angle), np.sin(angle), 0.0])
    moved = np.diag([-np.sin(angle), np.cos(angle), 0.0])
    return np.concatenate(
        [u @ _CROSS @ middle @ vt, u @ middle @ _CROSS.transpose(0, 2, 1) @ vt, (u @ moved @ vt)[None]]
    )


def _judged(matrix: Floats, tangents: Floats, a: Floats, b: Floats) -> FundamentalMatrixFit:
    """Fit of a fundamental matrix with its residuals, noise and expected error of the epipolar lines.

    Args:
        matrix: (3, 3) fundamental matrix from view a to view b.
        tangents: (p, 3, 3) derivatives of the matrix by its p degrees of freedom.
        a: (N, 2) points in the first view [px].
        b: (N, 2) their matches in the second view.
    """
    residuals = sampson(matrix, a, b)
    free = max(len(a) - len(tangents), 1)
    noise = float(np.sqrt((residuals**2).sum() / free))
    slopes = np.einsum("nij,kij->nk", sampson_slopes(matrix, a, b), tangents)
    sizes, turns = np.linalg.svd(slopes, full_matrices=False)[1:]
    if len(sizes) < len(tangents) or sizes[-1] < 1e-9 * sizes[0]:
        return FundamentalMatrixFit(matrix, residuals, noise, np.inf)
    per_unit = (turns / sizes[:, None]).T  # unknowns for uncorrelated errors of standard deviation 1
    spread = max(noise, BEST_NOISE_PX) * per_unit
    errors = [
        _line_variance(matrix=matrix, tangents=tangents, spread=spread, a=a, b=b),
        _line_variance(matrix=matrix.T, tangents=tangents.transpose(0, 2, 1), spread=spread, a=b, b=a),
    ]
    return FundamentalMatrixFit(matrix, residuals, noise, float(np.sqrt(np.mean(errors))))


def _line_variance(matrix: Floats, tangents: Floats, spread: Floats, a: Floats, b: Floats) -> float:
    """Mean squared error [px^2] of epipolar lines in view b, at distances along them equal to the spread of points.

    Args:
        matrix: (3, 3) fundamental matrix from view a to view b.
        tangents: (p, 3, 3) derivatives of the matrix by its p degrees of freedom.
        spread: (p, p) square root S of their covariance S S'.
        a: (N, 2) points in view a [px].
        b: (N, 2) their matches in view b.
    """
    lines = epipolar_lines(matrix, a)
    along = np.column_stack([-lines[:, 1], lines[:, 0]])
    reach = float(np.sqrt(((b - b.mean(axis=0)) ** 2).sum() / len(b)))
    foot = b - (lines * homogeneous(b)).sum(axis=1)[:, None] * lines[:, :2]
    raw = homogeneous(a) @ matrix.T
    length = np.hypot(raw[:, 0], raw[:, 1])
    total = 0.0
    for side in (-reach, reach):
        position = homogeneous(foot + side * along)
        change = np.einsum("ni,kij,nj->nk", position, tangents, homogeneous(a)) @ spread / length[:, None]
        total += float((change**2).sum(axis=1).mean())
    return 0.5 * total


def fit_homography(a: Floats, b: Floats) -> Floats:
    """(3, 3) homography from view a to view b, by a linear fit to matches a, b (N, 2) [px], N >= 4."""
    a1, b1, change_a, change_b = _about_zero(a, b)
    ha, x, y = homogeneous(a1), b1[:, :1], b1[:, 1:]
    zero = np.zeros_like(ha)
    rows = np.concatenate([np.hstack([ha, zero, -x * ha]), np.hstack([zero, ha, -y * ha])])
    mapping = _least(rows).reshape(3, 3)
    return np.asarray(np.linalg.inv(change_b) @ mapping @ change_a)


def homography_distances(mapping: Floats, a: Floats, b: Floats) -> Floats:
    """(N,) distances [px] of matches from a homography; infinite where the mapping is undefined.

    They are first-order distances, in the four coordinates of a match, from an exact match. With noise of standard
    deviation s in each, the square is s^2 times a chi-square with 2 degrees of freedom.

    Args:
        mapping: (3, 3) homography from a to b.
        a: (N, 2) points in the first view [px].
        b: (N, 2) their matches in the second view.
    """
    h = homogeneous(a) @ np.asarray(mapping).T
    with np.errstate(divide="ignore", invalid="ignore"):
        there = h[:, :2] / h[:, 2:]
        slopes = (mapping[None, :2, :2] - there[:, :, None] * mapping[None, 2:, :2]) / h[:, 2, None, None]
        variance = np.eye(2) + slopes @ slopes.transpose(0, 2, 1)
        left = b - there
    out, good = np.full(len(a), np.inf), np.isfinite(variance).all(axis=(1, 2)) & np.isfinite(left).all(axis=1)
    solved = np.linalg.solve(variance[good], left[good][:, :, None])[:, :, 0]
    out[good] = np.sqrt((left[good] * solved).sum(axis=1))
    return out


def homography_parallax(a: Floats, b: Floats) -> float:
    """Parallax [px] of matches a, b (N, 2), N >= 5, relative to a homography (one plane, or one camera position).

    Root sum of squared `homography_distances` from the fitted homography per degree of freedom: noise of standard
    deviation s in every coordinate gives about s.
    """
    squares = homography_distances(fit_homography(a, b), a, b) ** 2
    return float(np.sqrt(squares.sum() / max(2 * len(a) - 8, 1)))

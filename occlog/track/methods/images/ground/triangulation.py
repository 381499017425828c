"""Triangulation: the positions of N points from their centres in the images of V views, by weighted least squares.

A camera without distortion shows X at f (x / z, y / z) + c, where (x, y, z) is X - centre in
the camera's axes.  Residuals are weighted by the inverse covariances of the centres
(Gauss-Newton); the covariance of a position is the inverse of the information.  A point in one
view alone has a position only with a prior on its height.  `triangulate_in_space` omits single views
with a tracker on something else.

Covariances of positions from views that may contradict each other.

Each view is on the target or on another person, at even odds unless set otherwise.  A hypothesis
is the set of views that are on the target.  Its weight is the marginal likelihood of all
centres: the views of the set meet at one position (Laplace's approximation of the integral over the
positions), and the others may be anywhere in their images.  The covariance is the second moment of
the mixture of the hypotheses' positions about the position that is reported.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from occlog.array_types import Bools, Floats, Ints

MET = 0
TOO_FEW = 1
NEAR_PARALLEL = 2
BEHIND = 3
DISAGREEING = 4
STATUS = ("met", "too few views", "sight lines nearly parallel", "behind a camera", "views contradict each other")
"""Meaning of the status numbers of a `GroundPosition`."""

STEPS = 30
"""Steps of Gauss-Newton, at most."""
HALVINGS = 12
"""Halvings of a step, at most."""
RELATIVE_COST_TOLERANCE = 1e-10
"""The search ends when the cost would fall by less than this share of 1 + cost: such a step is far below 1 sigma."""


class CameraRig(NamedTuple):
    """V cameras without lens distortion: focal lengths, principal points, rotations and positions."""

    focal: Floats  # (V, 2) [px]
    principal: Floats  # (V, 2) [px]
    rotation: Floats  # (V, 3, 3) world-from-camera
    centre: Floats  # (V, 3) position in the world


class CentresInViews(NamedTuple):
    """Undistorted image positions [px] of N points in V views, with covariances.

    `there` (N, V): whether the view shows the point; elsewhere `pixels` (N, V, 2) and the positive definite
    `covariance` (N, V, 2, 2) [px^2] may be anything finite.
    """

    there: Bools  # (N, V) whether the view shows the point; without it the other fields may be anything finite
    pixels: Floats  # (N, V, 2)
    covariance: Floats  # (N, V, 2, 2) [px^2], positive definite

    def take(self, rows: Bools | Ints) -> CentresInViews:
        """Return the points selected by a mask (N,) or by indices."""
        return CentresInViews(self.there[rows], self.pixels[rows], self.covariance[rows])


class TargetHeightPrior(NamedTuple):
    """Gaussian prior on the height z of a point that is visible in a single view: mean and standard deviation.

    Both are in the scene's length unit.
    """

    mean: float
    sigma: float


class GroundPosition(NamedTuple):
    """Triangulated positions of N points in the world, with covariance, status, views used and misfit.

    `status` is an index in `STATUS`: `MET` with a position, else the reason why there is none, and then the position
    and its covariance are NaN. `misfit` is the sum of squared standardised residuals, chi-square with 2 views - 3
    degrees of freedom.
    """

    xyz: Floats  # (N, 3)
    covariance: Floats  # (N, 3, 3)
    status: Ints  # (N,) see STATUS
    used: Bools  # (N, V) views that were used
    misfit: Floats  # (N,) sum of squared standardised residuals, chi-square of 2 views - 3


class LeastSquares(NamedTuple):
    """Weighted least-squares problem of the positions of N points, seen by V cameras.

    The image centres with their inverse covariances as weights (0 where a view does not show the point), and the
    Gaussian prior on the height, which counts for the points with `known` 1.
    """

    sights: CentresInViews
    weights: Floats  # (N, V, 2, 2) inverse covariances, 0 where the view does not show the point
    known: Floats  # (N,) 1 where the prior on the height counts, else 0
    height: TargetHeightPrior
    rig: CameraRig

    def take(self, rows: Bools | Ints) -> LeastSquares:
        """Return the least-squares problem of the points selected by a mask (N,) or by indices."""
        return self._replace(sights=self.sights.take(rows), weights=self.weights[rows], known=self.known[rows])


def triangulate_points(
    sights: CentresInViews, rig: CameraRig, height: TargetHeightPrior | None, min_sine: float
) -> GroundPosition:
    """Triangulate points by weighted least squares from all views that show them, a single view with the height prior.

    The status is `TOO_FEW` for points with too few views, `NEAR_PARALLEL` below `min_sine`, `BEHIND` where the search
    starts behind a camera. The misfit of a point in one view is near 0: it has as many unknowns as measurements.

    Args:
        sights: undistorted centres of N points in V views.
        rig: the V cameras.
        height: prior on z of points that one view shows; None: they have no position.
        min_sine: least sine of the angle at which two lines of sight cross, or at which a single one meets the plane.
    """
    # Status by the geometry of the lines of sight
    count = sights.there.sum(axis=1)
    rays = _rays(sights.pixels, rig)
    prior = (count == 1) & (height is not None)
    sine = np.where(count == 1, np.where(sights.there, np.abs(rays[:, :, 2]), 0.0).max(axis=1), _crossing(rays, sights))
    status = np.where(count - ~prior < 1, TOO_FEW, np.where(sine < min_sine, NEAR_PARALLEL, MET))
    good = np.flatnonzero(status == MET)
    n = len(count)
    out = GroundPosition(np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), status, sights.there, np.full(n, np.nan))
    if not len(good):
        return out
    # Linear start, then Gauss-Newton
    some = sights.take(good)
    problem = LeastSquares(
        sights=some,
        weights=np.asarray(np.linalg.inv(some.covariance), dtype=np.float64) * some.there[:, :, None, None],
        known=np.where(prior[good], 1.0, 0.0),
        height=height if height is not None else TargetHeightPrior(0.0, 1.0),
        rig=rig,
    )
    xyz, information, cost = _refine(_start(rays[good], problem), problem)
    ok = np.isfinite(cost)
    out.status[good[~ok]] = BEHIND
    out.xyz[good[ok]] = xyz[ok]
    out.covariance[good[ok]] = np.linalg.inv(information[ok] + _ridge(information[ok]))
    out.misfit[good[ok]] = cost[ok]
    return out


def _rays(pixels: Floats, rig: CameraRig) -> Floats:
    """Return (N, V, 3) unit vectors in the world along the lines of sight through undistorted `pixels` (N, V, 2)."""
    local = np.concatenate([(pixels - rig.principal) / rig.focal, np.ones((*pixels.shape[:2], 1))], axis=2)
    rays = np.einsum("vij,nvj->nvi", rig.rotation, local)
    return np.asarray(rays / np.linalg.norm(rays, axis=2, keepdims=True))


def _crossing(rays: Floats, sights: CentresInViews) -> Floats:
    """Return (N,) largest sine of the angle between two lines of sight of a point; 0 for fewer than two lines.

    `rays` (N, V, 3) are unit vectors; only views that show the point count.
    """
    widest = np.zeros(len(rays))
    for i in range(rays.shape[1]):
        for j in range(i):
            sine = np.linalg.norm(np.cross(rays[:, i], rays[:, j]), axis=1)
            widest = np.maximum(widest, np.where(sights.there[:, i] & sights.there[:, j], sine, 0.0))
    return widest


def _start(rays: Floats, problem: LeastSquares) -> Floats:
    """Return (N, 3) initial positions: the points with the least sum of squared distances to their lines of sight.

    `rays` (N, V, 3) are unit vectors along the lines of sight. For a single line it is the point at the prior height.
    """
    sights, known = problem.sights, problem.known
    across = (np.eye(3) - rays[:, :, :, None] * rays[:, :, None, :]) * sights.there[:, :, None, None]
    A, b = across.sum(axis=1), np.einsum("nvij,vj->ni", across, problem.rig.centre)
    A[:, 2, 2] += known
    b[:, 2] += known * problem.height.mean
    return np.asarray(np.linalg.solve(A, b[:, :, None])[:, :, 0])


def _refine(start: Floats, problem: LeastSquares) -> tuple[Floats, Floats, Floats]:
    """Return positions refined by Gauss-Newton with step halving, their information matrices and costs.

    Args:
        start: (N, 3) initial positions, not changed.
        problem: image centres, weights and cameras of the points.

    Returns:
        Positions (N, 3), information (N, 3, 3) and cost (N,), the sum of squared standardised residuals; inf for a
        point that starts behind a camera.
    """
    xyz = start.copy()
    cost = _cost(xyz, _reprojection_errors(xyz, problem)[0], problem)
    information = np.broadcast_to(np.eye(3), (len(xyz), 3, 3)).copy()
    moving = np.flatnonzero(np.isfinite(cost))
    for _ in range(STEPS):
        if not len(moving):
            break
        some, here = problem.take(moving), xyz[moving]
        # Normal equations
        left, local = _reprojection_errors(here, some)
        matrix, slope = _normal(here, left, local, some)
        information[moving] = matrix
        step: Floats = np.asarray(
            np.linalg.solve(matrix + _ridge(matrix), slope[:, :, None])[:, :, 0], dtype=np.float64
        )
        # Line search
        xyz[moving], cost[moving] = _shortened(here, step, cost[moving], some)
        # Points go on as long as their cost would still fall by enough
        moving = moving[(step * slope).sum(axis=1) > RELATIVE_COST_TOLERANCE * (1.0 + cost[moving])]
    return xyz, information, cost


def _shortened(here: Floats, step: Floats, cost: Floats, problem: LeastSquares) -> tuple[Floats, Floats]:
    """Return (N, 3) positions and (N,) costs after a Gauss-Newton `step` (N, 3), halved until `cost` does not grow.

    Args:
        here: (N, 3) positions before the step. Points without such a step within `HALVINGS` halvings stay there.
        step: (N, 3) full step.
        cost: (N,) costs at `here`.
        problem: least-squares problem of these points.
    """
    size = np.ones(len(here))
    for _ in range(HALVINGS):
        trial = here + size[:, None] * step
        new = _cost(trial, _reprojection_errors(trial, problem)[0], problem)
        worse = ~(new <= cost)
        if not worse.any():
            return trial, new
        size[worse] *= 0.5
    return np.where(worse[:, None], here, trial), np.where(worse, cost, new)


def _ridge(matrix: Floats) -> Floats:
    """Return (N, 3, 3) multiples of the identity, 1e-14 of the traces of `matrix` (N, 3, 3), against singularity."""
    return np.asarray(1e-14 * np.trace(matrix, axis1=1, axis2=2)[:, None, None] * np.eye(3))


def _reprojection_errors(xyz: Floats, problem: LeastSquares) -> tuple[Floats, Floats]:
    """Return (N, V, 2) reprojection residuals of world positions `xyz` (N, 3), and (N, V, 3) these in camera axes.

    Residuals are measured minus expected [px], 0 in a view that does not show the point, NaN behind a camera that does.
    """
    sights, rig = problem.sights, problem.rig
    local = np.einsum("nvi,vij->nvj", xyz[:, None, :] - rig.centre, rig.rotation)
    depth = np.where(local[:, :, 2] > 0.0, local[:, :, 2], np.nan)[:, :, None]
    left = sights.pixels - (rig.focal * local[:, :, :2] / depth + rig.principal)
    return np.where(sights.there[:, :, None], left, 0.0), local


def _cost(xyz: Floats, left: Floats, problem: LeastSquares) -> Floats:
    """Return (N,) sums of squared standardised residuals, with that of the height where its prior counts.

    `xyz` (N, 3) are the positions, `left` (N, V, 2) the reprojection residuals there [px]. Costs are inf where a
    residual is NaN, that is, behind a camera.
    """
    known, height = problem.known, problem.height
    total = np.einsum("nvi,nvij,nvj->n", left, problem.weights, left)
    total = total + known * ((xyz[:, 2] - height.mean) / height.sigma) ** 2
    return np.where(np.isnan(total), np.inf, total)


def _normal(xyz: Floats, left: Floats, local: Floats, problem: LeastSquares) -> tuple[NDArray[np.float64], Floats]:
    """Return the Gauss-Newton information matrix (N, 3, 3) and the gradient (N, 3) of minus half the cost.

    Args:
        xyz: (N, 3) positions in the world.
        left: (N, V, 2) reprojection residuals at the positions [px]; NaN counts as 0.
        local: (N, V, 3) positions in the cameras' axes.
        problem: weights, cameras and height prior of the points.
    """
    rig, known, height = problem.rig, problem.known, problem.height
    # Jacobian of the projections
    depth = np.where(local[:, :, 2] > 0.0, local[:, :, 2], 1.0)[:, :, None, None]
    flat = np.zeros((*local.shape[:2], 2, 3))
    flat[:, :, [0, 1], [0, 1]] = 1.0
    flat[:, :, :, 2] = -local[:, :, :2] / depth[:, :, :, 0]
    slopes = rig.focal[None, :, :, None] * flat / depth @ rig.rotation.transpose(0, 2, 1)
    weighted = np.einsum("nvki,nvkl->nvil", slopes, problem.weights)
    information = np.einsum("nvil,nvlj->nij", weighted, slopes)
    slope = np.einsum("nvil,nvl->ni", weighted, np.where(np.isnan(left), 0.0, left))
    information[:, 2, 2] += known / height.sigma**2
    slope[:, 2] -= known * (xyz[:, 2] - height.mean) / height.sigma**2
    return information, slope


def triangulate_in_space(
    sights: CentresInViews,
    rig: CameraRig,
    height: TargetHeightPrior | None = None,
    gate: float = 1e-3,
    min_crossing: float = np.radians(5.0),
) -> GroundPosition:
    """Triangulate points, and leave out views that contradict the others.

    Views agree when their misfit passes a chi-square test. Where they do not, the view without which the others agree
    best is omitted, as long as two or more remain. Two views that do not agree give no position (status
    `DISAGREEING`), since either may be right.

    Args:
        sights: undistorted centres of N points in V views.
        rig: the V cameras.
        height: prior on z of points that one view shows; None: they have no position.
        gate: level of the test, the probability of rejecting views that are all right.
        min_crossing: least angle [rad] at which lines of sight cross, or at which a single one meets the plane.
    """
    # Gate: chi-square with 2 views - 3 degrees of freedom
    limits = np.array([np.inf, np.inf, *(chdtri(2 * n - 3, gate) for n in range(2, sights.there.shape[1] + 1))])
    met = triangulate_points(sights, rig, height, np.sin(min_crossing))
    for _ in range(sights.there.shape[1] - 2):
        count = met.used.sum(axis=1)
        again = np.flatnonzero(_bad(met, limits) & (count > 2))
        if not len(again):
            break
        met = _replaced(met, again, _without_one(sights.take(again), met.used[again], rig, np.sin(min_crossing)))
    inconsistent = _bad(met, limits)
    return met._replace(
        xyz=np.where(inconsistent[:, None], np.nan, met.xyz),
        covariance=np.where(inconsistent[:, None, None], np.nan, met.covariance),
        status=np.where(inconsistent & (met.status == MET), DISAGREEING, met.status),
    )


def _bad(met: GroundPosition, limits: Floats) -> Bools:
    """Return (N,) booleans: the views of the point do not agree, or the point lies behind one of them.

    `met` are triangulated points; `limits` (V + 1,) the largest allowed misfit by the number of views used.
    """
    bad: Bools = (met.status == BEHIND) | ((met.status == MET) & (met.misfit > limits[met.used.sum(axis=1)]))
    return bad


def _without_one(sights: CentresInViews, used: Bools, rig: CameraRig, min_sine: float) -> GroundPosition:
    """Return for each of N points the best fit without one of the views used before; misfit inf if there is none.

    Args:
        sights: image centres of the N points in V views.
        used: (N, V) views that were used before.
        rig: the V cameras.
        min_sine: least sine of the angle at which lines of sight cross.

    Raises:
        ValueError: V is 0.
    """
    best: GroundPosition | None = None
    for view in range(used.shape[1]):
        there = used.copy()
        there[:, view] = False
        trial = triangulate_points(sights._replace(there=there), rig, None, min_sine)
        ok = (trial.status == MET) & used[:, view]
        trial = trial._replace(misfit=np.where(ok, trial.misfit, np.inf))
        if best is None:
            best = trial
        else:
            better = np.flatnonzero(trial.misfit < best.misfit)
            best = _replaced(best, better, _taken(trial, better))
    if best is None:
        raise ValueError("points must have at least one view")
    return best


def _taken(met: GroundPosition, rows: Ints) -> GroundPosition:
    """Return the triangulated positions with the indices `rows` (K,), with all their fields."""
    return GroundPosition(met.xyz[rows], met.covariance[rows], met.status[rows], met.used[rows], met.misfit[rows])


def _replaced(met: GroundPosition, rows: Ints, others: GroundPosition) -> GroundPosition:
    """Return a copy of `met` in which the points `rows` are replaced by `others`, in this order."""
    out = GroundPosition(met.xyz.copy(), met.covariance.copy(), met.status.copy(), met.used.copy(), met.misfit.copy())
    for old, new in zip(out, others, strict=True):
        old[rows] = new
    return out


ALL_SUBSETS = 5
"""Maximum number of views of which all subsets are hypotheses; with more views, only single views, pairs and subsets
that omit at most two."""
HEIGHTS = 30.0
"""Heights of positions that several views find are uniform over this multiple of the height's standard deviation."""


class ViewOdds(NamedTuple):
    """Model of views that may be on another target: prior odds, and the densities of right and wrong image centres.

    `right`: prior probability that a view is on the target, in (0, 1]. `agreement`: variance of the residuals of right
    views, in units of the stated variance. `areas` (V,) [px^2]: a wrong view's centre is uniform over its image.
    """

    right: float  # probability that a view is on the target, in (0, 1]; 1: all are
    agreement: float  # variance of the residuals of views on one target, in units of the stated one, > 0
    areas: Floats  # (V,) sizes of the images [px^2]


class ViewContradictions(NamedTuple):
    """Covariances of N positions, and the probability of each that one of its views is on something else.

    `covariance` (N, 3, 3) is NaN where there is no position; `contested` (N,) is 0 for a single view, and 1 where
    several views give no position.
    """

    covariance: Floats  # (N, 3, 3) NaN where there is no position
    contested: Floats  # (N,) probability that a view is on something else; 0 for one view, 1 if no views agree


def covariances_with_contradiction(
    met: GroundPosition,
    sights: CentresInViews,
    rig: CameraRig,
    height: TargetHeightPrior | None,
    odds: ViewOdds,
    sine: float,
) -> ViewContradictions:
    """Return covariances of positions as mixtures over the hypotheses about which views are on the target.

    A covariance is the second moment of the hypotheses' positions about the position reported, weighted by their
    probabilities. With `odds.right` of 1 the covariances stay as they are.

    Args:
        met: reported positions of the N points; not changed.
        sights: undistorted centres of the N points in V views.
        rig: the V cameras.
        height: prior on z of points that one view shows; None: single views are no hypotheses.
        odds: prior probability that a view is on the target, and error models of right and wrong views.
        sine: least sine of the angle at which lines of sight cross.
    """
    covariance, contested = met.covariance.copy(), np.where(met.status == MET, 0.0, 1.0)
    several = sights.there.sum(axis=1) > 1
    contested[~several] = 0.0
    if odds.right >= 1.0:
        return ViewContradictions(covariance, contested)
    for pattern in np.unique(sights.there[several & (met.status == MET)], axis=0):
        rows = np.flatnonzero((sights.there == pattern).all(axis=1) & (met.status == MET))
        some = sights.take(rows)
        spread, everyone = _mixture(met.xyz[rows], some, pattern, rig, height, odds, sine)
        # Where no hypothesis has a position the covariance stays
        known = np.isfinite(spread).all(axis=(1, 2))
        covariance[rows[known]] = spread[known]
        contested[rows] = 1.0 - everyone
    return ViewContradictions(covariance, contested)


def _mixture(
    xyz: Floats,
    sights: CentresInViews,
    pattern: Bools,
    rig: CameraRig,
    height: TargetHeightPrior | None,
    odds: ViewOdds,
    sine: float,
) -> tuple[Floats, Floats]:
    """Return (N, 3, 3) mixture covariances about positions, and (N,) probabilities that all views are right.

    The mixture is over all sets of views that may be on the target (`_sets`). Covariances are NaN where no set gives a
    position, and the probability is then 0.

    Args:
        xyz: (N, 3) reported positions.
        sights: undistorted centres of the points, which are all shown by the same views.
        pattern: (V,) whether a view shows the points.
        rig: all V cameras.
        height: prior on z for single views; None: single views are no hypotheses.
        odds: prior probability that a view is on the target, and error models of right and wrong views.
        sine: least sine of the angle at which lines of sight cross.
    """
    density = np.log(2.0 * np.pi) + 0.5 * np.linalg.slogdet(sights.covariance)[1] + np.log(odds.agreement)
    logs, moments = [], []
    for views in _sets(pattern):
        fit = triangulate_points(sights._replace(there=np.broadcast_to(views, sights.there.shape)), rig, height, sine)
        found = fit.status == MET
        cov = np.where(found[:, None, None], fit.covariance, np.eye(3))
        # Laplace: the integral of the likelihood over the positions
        free = 2.0 if views.sum() == 1 else 3.0
        log = -0.5 * fit.misfit / odds.agreement + 0.5 * np.linalg.slogdet(cov)[1] + 0.5 * free * np.log(odds.agreement)
        if views.sum() > 1 and height is not None:
            log = log + np.log(np.sqrt(2.0 * np.pi) / HEIGHTS)
        # Views of the set are right, the others anywhere in their images
        log = log + (views * (np.log(odds.right) - density)).sum(axis=1)
        log = log + ((pattern & ~views) * (np.log1p(-odds.right) - np.log(odds.areas))).sum()
        off = np.where(found[:, None], fit.xyz - xyz, 0.0)
        logs.append(np.where(found, log, -np.inf))
        moments.append(cov + off[:, :, None] * off[:, None, :])
    stacked = np.stack(logs)
    top = stacked.max(axis=0)
    weights = np.exp(stacked - np.where(np.isfinite(top), top, 0.0))
    total = weights.sum(axis=0)
    weights = weights / np.where(total > 0.0, total, np.nan)
    # The first set holds all the views
    return np.einsum("hn,hnij->nij", weights, np.stack(moments)), np.nan_to_num(weights[0])


def _sets(pattern: Bools) -> Iterator[Bools]:
    """Generate the nonempty subsets of the views in `pattern` (V,) as masks (V,), the largest first.

    Of more than `ALL_SUBSETS` views, only the subsets of one or two views and those that omit at most two.
    """
    views = np.flatnonzero(pattern)
    for size in range(len(views), 0, -1):
        if len(views) <= ALL_SUBSETS or size >= len(views) - 2 or size <= 2:
            for chosen in combinations(views.tolist(), size):
                mask = np.zeros(len(pattern), dtype=np.bool_)
                mask[list(chosen)] = True
                yield mask

"""What priors of moving occluders say of a trajectory: which bearings to doubt, and where the target may be.

Let P_i(x) be the probability that no moving occluder hides position x from camera i ([Ercan] Sec. 4.2,
`occlog.core.occlusion.occlusion_probability`), 0 where the camera cannot see x anyway, and D its probability of
detection.

* A bearing is the less probably the target's, the smaller P_i is where the target is thought to be: log P_i, averaged
  over where it may be, is added to the log odds of true and false bearings.
* An accepted bearing means that the target is in plain view, with the likelihood P_i(x); a camera that had a frame
  and did not detect the target means that it is hidden or out of view, with 1 - D P_i(x).

The latter are neither smooth (at borders of views and behind walls) nor convex.  They are replaced by a quadratic
term of each state: the Gaussian factor that has, with all other information on the state, the mean and covariance that
the product with the likelihood has (expectation propagation: Minka 2001, UAI, pp. 362-369), but for curvature below
0.  As that depends on the trajectory, search and terms alternate.

Errors of priors last for many scans; all probabilities have the exponent `temper`, unless positions are known exactly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.geometry.visibility import seen_from
from occlog.core.occlusion.occlusion_probability import IMPROVED, visibility_probability

from .kernels.problem import QuadraticPriors
from .record import TargetRecord
from .search.problem_of_record import Pending

MIN_PROBABILITY = 1e-4
"""Lower bound of probabilities, so that no single camera decides."""
OCCLUDER_SUPPORT_SIGMAS = 5.5
"""Standard deviations at which a Gaussian prior is truncated."""
NODES = 7
"""Points of the quadrature for each axis."""
MAX_RELATIVE_SIGMA = 0.04
"""Maximum standard deviation of a state, as a share of the scene's extent, for priors of occluders to be used: a wider
state is no Gaussian."""
MIN_CAVITY_SHARE = 1e-6
"""Minimum share of the state's information that must come from other sources for priors of occluders to be used."""


class OccluderCostTerms(NamedTuple):
    """What moving occluders add to the cost of a trajectory with N bearings and T states.

    `lean` (N,) is added to the log odds that each bearing is true, at most 0; `hints` are quadratic terms of the
    positions.
    """

    lean: Floats  # (N,) added to the log odds that each is true, at most 0
    hints: QuadraticPriors


def occlusion_terms(
    pending: Pending, record: TargetRecord, X: Floats, spread: Floats, inlier: Bools, before: OccluderCostTerms | None
) -> OccluderCostTerms:
    """Compute the terms of moving occluders along a trajectory, by expectation propagation at each time with priors.

    Args:
        pending: unreleased part of the target's record: settings and sensors.
        record: measurements of the target at T times, with the priors of occluders.
        X: (T, 4) states x, vx, y, vy of the trajectory.
        spread: (T, 4, 4) their covariances, with the earlier terms of occluders.
        inlier: (N,) which bearings count as the target's.
        before: the earlier terms, along a trajectory nearby; quadratic terms go half of the way from there. None: none.
    """
    rows, config = record.rows, pending.config
    lean, line = np.zeros(len(inlier)), np.cumsum(rows.seen) - 1
    camera = pending.at.focal_px > 0.0
    nodes, weights = quadrature()
    bounds = np.searchsorted(record.state, np.arange(len(X) + 1))
    old = {} if before is None else {int(t): m for m, t in enumerate(before.hints.step)}
    made: list[tuple[int, Floats, Floats, Floats]] = []
    for t in np.unique(record.state).tolist():
        priors = record.priors(t)
        own = np.arange(bounds[t], bounds[t + 1])
        own = own[camera[rows.sensor[own]]]
        if priors is None or not len(own):
            continue
        temper = 1.0 if not priors.sigma.any() else config.occlusion_tempering
        # All other information on the state
        reported = None if before is None or t not in old else _term(before.hints, old[t])
        rest = cavity_distribution(X[t, ::2], spread[t, ::2, ::2], reported)
        if rest is None or math.sqrt(np.linalg.eigvalsh(rest[1])[-1]) > MAX_RELATIVE_SIGMA * pending.extent:
            continue
        mean, covariance = rest
        points = mean + nodes @ np.linalg.cholesky(covariance).T
        # Likelihood of who saw it and who did not
        total = np.zeros(len(points))
        for r in own.tolist():
            i = int(rows.sensor[r])
            xy, (x0, y0) = points + pending.origin, pending.sensors.xy[i].tolist()
            clear = visibility_probability(xy, np.arange(len(xy)), x0, y0, priors, IMPROVED, OCCLUDER_SUPPORT_SIGMAS)
            if rows.seen[r]:
                lean[line[r]] = temper * math.log(max(float(weights @ clear), MIN_PROBABILITY))
                if inlier[line[r]]:
                    total += np.log(np.maximum(clear, MIN_PROBABILITY))
            else:
                total += np.log(
                    np.maximum(
                        1.0 - _detection(pending, i) * seen_from(xy, i, pending.sensors) * clear, MIN_PROBABILITY
                    )
                )
        if not config.use_missed_detections or float(np.ptp(total)) == 0.0:
            continue
        # The Gaussian factor that leads to the same moments
        site = matched(points, weights * np.exp(temper * (total - total.max())), mean, covariance)
        made.append((t, *(site if reported is None else _between(reported, site))))
    return OccluderCostTerms(lean, _hints(made))


def _detection(pending: Pending, i: int) -> float:
    """Return the detection probability of the camera with index `i`: its own, or that of the settings; 1 if unknown."""
    own = float(pending.at.detection[i])
    if math.isnan(own):
        own = 1.0 if pending.config.detection_probability is None else pending.config.detection_probability
    return own


def quadrature() -> tuple[Floats, Floats]:
    """Return (Q, 2) nodes and (Q,) weights of the 2-D Gauss-Hermite rule for a standard normal."""
    x, w = np.polynomial.hermite_e.hermegauss(NODES)
    first, second = np.meshgrid(x, x, indexing="ij")
    weights = np.outer(w, w).ravel()
    return np.column_stack([first.ravel(), second.ravel()]), weights / weights.sum()


def cavity_distribution(
    position: Floats, covariance: Floats, term: tuple[Floats, Floats, Floats] | None
) -> tuple[Floats, Floats] | None:
    """Return the mean (2,) and covariance (2, 2) of a Gaussian position with one quadratic term removed.

    None if little information (`MIN_CAVITY_SHARE`) is left.

    Args:
        position: (2,) mean with the term.
        covariance: (2, 2) covariance with the term.
        term: centre (2,), slope (2,) and curvature (2, 2) of its cost; None: there is no term.
    """
    if term is None:
        return position, covariance
    centre, slope, bend = term
    precision = np.linalg.inv(covariance)
    rest = precision - bend
    if not np.linalg.eigvalsh(rest)[0] > MIN_CAVITY_SHARE * np.linalg.eigvalsh(precision)[0]:
        return None
    left = np.linalg.inv(rest)
    return position + left @ (slope + bend @ (position - centre)), np.asarray(left, dtype=np.float64)


def matched(points: Floats, weights: Floats, mean: Floats, covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the quadratic term that turns a Gaussian into one with the moments of weighted points.

    Args:
        points: (Q, 2) quadrature nodes of the Gaussian.
        weights: (Q,) quadrature weights times the likelihood, up to a factor.
        mean: (2,) of the Gaussian.
        covariance: (2, 2) of the Gaussian.

    Returns:
        Centre (2,), slope (2,) of the cost there, and curvature (2, 2), made positive semidefinite.
    """
    weights = weights / weights.sum()
    centre = weights @ points
    away = points - centre
    then, precision = (weights[:, None] * away).T @ away, np.linalg.inv(covariance)
    # In the Gaussian's own coordinates curvature is 1 / variance - 1 along the axes of the moments
    root = np.linalg.cholesky(covariance)
    inverse = np.linalg.inv(root)
    values, axes = np.linalg.eigh(inverse @ then @ inverse.T)
    gained = np.maximum(1.0 / np.maximum(values, 1e-12) - 1.0, 0.0)
    bend = inverse.T @ (axes * gained) @ axes.T @ inverse
    return centre, precision @ (mean - centre), bend


def _between(a: tuple[Floats, Floats, Floats], b: tuple[Floats, Floats, Floats]) -> tuple[Floats, Floats, Floats]:
    """Return the mean of two quadratic terms about the centre of `b`.

    A term is centre (2,), slope (2,) there and curvature (2, 2).
    """
    slope = a[1] + a[2] @ (b[0] - a[0])
    return b[0], 0.5 * (slope + b[1]), 0.5 * (a[2] + b[2])


def _term(hints: QuadraticPriors, m: int) -> tuple[Floats, Floats, Floats]:
    """Return the quadratic term with index `m`: centre (2,), slope (2,) there, and curvature (2, 2)."""
    xx, xy, yy = hints.bend[m]
    return hints.position[m], hints.slope[m], np.array([[xx, xy], [xy, yy]])


def _hints(made: list[tuple[int, Floats, Floats, Floats]]) -> QuadraticPriors:
    """Return K quadratic terms, given as (state index, centre (2,), slope (2,), curvature (2, 2)), as arrays."""
    return QuadraticPriors(
        np.array([t for t, *_ in made], dtype=np.int64),
        np.array([c for _, c, _, _ in made]).reshape(-1, 2),
        np.array([g for _, _, g, _ in made]).reshape(-1, 2),
        np.array([(H[0, 0], H[0, 1], H[1, 1]) for *_, H in made]).reshape(-1, 3),
    )

"""The planes xy, yz and zx of projected planes selection ([Lee] Sec. 2.2).

Directions of a scan become angles of the planes (`plane_angles`), two planes are chosen (`choose_pair`),
particles of a plane are weighed (`log_likelihood`), and the two planes' estimates become one in space
(`combine`, Eqs. 2.17-2.21 and 2.26) with the covariance of what their errors have in common (`errors_after`).

Errors of the three planes' estimates, and how they go together.

Each plane's filter knows its own covariance, but not what its errors share with the others': all three began
from one prior, move by one target's acceleration, and hear one noise, with projected angles that are
correlated (`occlog.core.geometry.projected_planes.projected_covariance`).  An estimate that is combined of two planes
has the covariance of the combination, for which their cross-covariance is needed.  It obeys the recursion
of Bar-Shalom (1981) for two tracks,

    P_pq = (I - K_p H_p) (F P_pq F^T + Q_pq) (I - K_q H_q)^T + K_p R_pq K_q^T,

which is run here for all planes at once: the state is the (12,) error of (a, b, va, vb) of xy, yz and zx.  After each
scan the blocks on the diagonal are set to what the particles say (`rescaled`), correlations being kept.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.bounds.in_space import plane_axes
from occlog.core.geometry.projected_planes import (
    AXES,
    XY,
    YZ,
    blind_planes,
    direction,
    projected_angles,
    projected_covariance,
    select_as_printed,
    select_by_variance,
)
from occlog.filtering.motion.white_acceleration import AccelerationModel

from .importance_step import drift_matrix, factors, process_noise
from .kernels.importance import ScanRows
from .kernels.likelihood import UNIFORM_AZIMUTH, ReportProbabilities, log_in_plane, scan_log_likelihood
from .sensing import ScanDirections

PLANE_ROWS = tuple(slice(4 * p, 4 * p + 4) for p in range(3))
TO_PLANES = np.eye(6)[[k for p in range(3) for k in plane_axes(p)]]
"""(12, 6) from the state in space to those of the planes."""
MIN_RELATIVE_VARIANCE = 1e-12
"""Variances below this share of the largest count as so much."""


def initial_errors(covariance: Floats) -> Floats:
    """Return the (12, 12) joint error covariance of the three planes' states, from a (6, 6) covariance in space.

    A plane's state is (a, b, va, vb) on its axes; the planes are xy, yz and zx. The state in space is (x, y, z, vx, vy,
    vz).
    """
    return np.asarray(TO_PLANES @ covariance @ TO_PLANES.T)


def moved_errors(errors: Floats, motion: AccelerationModel, dt: float) -> Floats:
    """Return the (12, 12) joint error covariance of the three planes' states a time `dt` [s] later.

    All planes share the process noise of one motion in space, `motion`.
    """
    F = np.kron(np.eye(3), drift_matrix(2, dt))
    return np.asarray(F @ errors @ F.T + initial_errors(process_noise(motion, dt)))


def measured_errors(errors: Floats, positions: Floats, sensor: Floats, angles: Floats, used: Bools) -> Floats:
    """Return the (12, 12) joint error covariance of the planes after a direction of one sensor.

    Each plane is updated by its own Kalman gain.

    Args:
        errors: (12, 12) before.
        positions: (3, 2) estimated position of the target on each plane's axes.
        sensor: (3,) position of the sensor.
        angles: (3, 3) covariance of the direction's angles projected to the planes [rad^2].
        used: (3,) whether the plane was updated with its angle.
    """
    K, H = np.zeros((12, 3)), np.zeros((3, 12))
    for p in np.flatnonzero(used):
        rows = PLANE_ROWS[p]
        a, b = positions[p] - sensor[list(AXES[p])]
        square = a * a + b * b
        if square > 0.0:
            h = np.array([-b, a, 0.0, 0.0]) / square
            H[p, rows] = h
            K[rows, p] = errors[rows, rows] @ h / (h @ errors[rows, rows] @ h + angles[p, p])
    kept = np.eye(12) - K @ H
    return np.asarray(kept @ errors @ kept.T + K @ angles @ K.T)


def rescaled(errors: Floats, covariances: dict[int, Floats]) -> Floats:
    """Return the (12, 12) joint error covariance with given diagonal blocks for some planes, correlations being kept.

    The errors of a plane are mapped by the symmetric matrix that changes Gaussians of the one covariance into those of
    the other with the least motion (Olkin and Pukelsheim 1982).

    Args:
        errors: (12, 12) before.
        covariances: (4, 4) new covariance of a plane's state, by plane.
    """
    T = np.eye(12)
    for p, covariance in covariances.items():
        rows = PLANE_ROWS[p]
        root, inverse = _roots(errors[rows, rows])
        T[rows, rows] = inverse @ _roots(root @ covariance @ root)[0] @ inverse
    return np.asarray(T @ errors @ T.T)


def reactivated(errors: Floats, plane: int, combination: Floats) -> Floats:
    """Return the (12, 12) joint error covariance of three planes after one was restarted from the combined estimate.

    The states are (a, b, va, vb) of the planes xy, yz and zx, in this order.

    Args:
        errors: (12, 12) joint error covariance before.
        plane: the restarted plane, 0 to 2.
        combination: (6, 12) matrix that gives the combined state (x, y, z, vx, vy, vz) from the planes' states.
    """
    T = np.eye(12)
    T[PLANE_ROWS[plane]] = TO_PLANES[PLANE_ROWS[plane]] @ combination
    return np.asarray(T @ errors @ T.T)


def combination_of(planes: tuple[int, int], shared: int, shares: Floats) -> Floats:
    """Return the (6, 12) matrix that combines the states of two planes to the state in space.

    Args:
        planes: numbers of two different planes.
        shared: the coordinate axis that both have, 0 to 2.
        shares: (2, 2) weights of the two planes (rows) for position and velocity (columns) of that axis.
    """
    W = np.zeros((6, 12))
    for n, p in enumerate(planes):
        for index, k in enumerate(AXES[p]):
            for part in range(2):
                W[k + 3 * part, 4 * p + index + 2 * part] = shares[n, part] if k == shared else 1.0
    return W


def _roots(covariance: Floats) -> tuple[Floats, Floats]:
    """Return the symmetric square root of a covariance (n, n), and its inverse.

    Eigenvalues below `MIN_RELATIVE_VARIANCE` of the largest are raised to it.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    sd = np.sqrt(np.maximum(values, max(MIN_RELATIVE_VARIANCE * values[-1], 1e-300)))
    return (vectors * sd) @ vectors.T, (vectors / sd) @ vectors.T


GATE_SIGMAS = 5.0
"""Standard deviations from a plane's estimate within which an angle counts as taken in."""


class PlanePosterior(NamedTuple):
    """Posterior of the filter of one plane: mean (a, b, va, vb), covariance, log evidence, effective sample size."""

    mean: Floats  # (4,) a, b, va, vb
    covariance: Floats  # (4, 4)
    log_evidence: float  # of the scan: log of the sum of the unnormalised weights
    ess: float


class CombinedPosterior(NamedTuple):
    """State in space (x, y, z, vx, vy, vz) combined from two planes' posteriors, with covariance.

    `combination` (6, 12) is the matrix by which it is made of the three planes' states.
    """

    mean: Floats  # (6,) x, y, z, vx, vy, vz
    covariance: Floats  # (6, 6)
    combination: Floats  # (6, 12) of the three planes' states, see `occlog.track.methods.in_space.planes`


def shared_axis(p: int, q: int) -> int:
    """Return the coordinate axis (0, 1 or 2 for x, y, z) that the different planes `p` and `q` have in common."""
    return next(k for k in AXES[p] if k in AXES[q])


def combine(
    planes: tuple[int, int], flat: tuple[PlanePosterior, PlanePosterior], rule: str, errors: Floats
) -> CombinedPosterior:
    """Return the state in space that combines the posteriors of two planes.

    The common axis is a weighted mean; its covariance includes what the planes' errors have in common.

    Args:
        planes: numbers of two different planes.
        flat: posteriors of the two planes.
        rule: `inverse` weighs position and velocity by inverse variance, `planes-weighted` by the sums of the
            unnormalised weights (Eq. 2.19), `equal` evenly (Eq. 2.21).
        errors: (12, 12) joint error covariance of all planes.
    """
    k = shared_axis(*planes)
    rows = [[AXES[p].index(k), AXES[p].index(k) + 2] for p in planes]
    # Eqs. 2.18 and 2.20, the axes that one plane alone has; Eqs. 2.19 and 2.21, the redundant axis
    W = combination_of(planes, k, _shares(flat, rows, rule))
    states = np.zeros(12)
    for p, f in zip(planes, flat, strict=True):
        states[PLANE_ROWS[p]] = f.mean
    return CombinedPosterior(W @ states, W @ errors @ W.T, W)


def _shares(flat: tuple[PlanePosterior, PlanePosterior], rows: list[list[int]], rule: str) -> Floats:
    """Return the (2, 2) weights of two planes (rows) for position and velocity (columns) of their common axis.

    Columns sum to 1.

    Args:
        flat: posteriors of the two planes.
        rows: for each plane, the indices of position and velocity of the common axis in its state.
        rule: `inverse`: by inverse variance; `planes-weighted`: by the evidence of the planes; `equal`: one half each.
    """
    if rule == "equal":
        return np.full((2, 2), 0.5)
    if rule == "planes-weighted":
        gap = flat[1].log_evidence - flat[0].log_evidence
        first = 1.0 / (1.0 + math.exp(min(gap, 700.0))) if math.isfinite(gap) else 0.5
        return np.array([[first, first], [1.0 - first, 1.0 - first]])
    precision = np.array([1.0 / np.maximum(np.diag(f.covariance)[r], 1e-300) for f, r in zip(flat, rows, strict=True)])
    return np.asarray(precision / precision.sum(axis=0))


Pair = tuple[tuple[int, int], tuple[int, int]]
"""Two (sensor of the scan, plane); sensor -1: no sensor measures in that plane."""
NOTHING: Pair = ((-1, XY), (-1, YZ))


class ProjectedAngles(NamedTuple):
    """R directions of a scan projected to the planes xy, yz and zx: angles with their errors [rad].

    `blind` (R, 3) marks planes in which a direction is uninformative; angle, sigma and covariance are not to be used
    there.
    """

    angle: Floats  # (R, 3) [rad]
    sigma: Floats  # (R, 3) [rad]
    covariance: Floats  # (R, 3, 3) of a row's three angles; what is blind is not to be read
    blind: Bools  # (R, 3) planes in which a row is uninformative, or its sigma does not hold
    toward: Floats  # (R, 3) unit vectors in the world


def plane_angles(heard: ScanDirections) -> ProjectedAngles:
    """Return the R directions of a scan projected to the three planes, with their noise.

    A direction without elevation counts in plane xy only.
    """
    s = heard.sights
    phi = np.where(heard.flat, 0.5 * math.pi, s.phi)
    toward = np.einsum("rij,rj->ri", heard.rotation, direction(heard.theta, phi))
    noise = (heard.theta, phi, s.sigma_theta, s.sigma_phi, heard.rotation)
    covariance = projected_covariance(*noise, pole_term=True)
    covariance[heard.flat] = np.diag([1.0, 0.0, 0.0]) * s.sigma_theta[heard.flat, None, None] ** 2
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    blind = blind_planes(*noise)
    blind = np.where(heard.flat[:, None], np.array([False, True, True]), blind | ~(variance > 0))
    return ProjectedAngles(projected_angles(toward), np.sqrt(np.where(blind, 1.0, variance)), covariance, blind, toward)


def choose_pair(rule: str, heard: ScanDirections, angles: ProjectedAngles, near: Floats, before: Pair) -> Pair:
    """Return the two planes to use, each with the most informative sensor of the scan in it.

    Of a sensor's candidates, the one nearest to the predicted position counts. Planes are taken from `before` where the
    scan does not determine them.

    Args:
        rule: `variance`: least variances of the projected angles; `printed`: the rule printed in [Lee].
        heard: the scan.
        angles: directions of the scan projected to the planes.
        near: (3,) predicted position of the target; NaN: unknown, each sensor's first direction counts.
        before: planes and sensors selected before.
    """
    rows = nearest_rows(heard, angles, near)
    if not (rows >= 0).any():
        return before
    if rule == "printed":
        return _printed(heard, rows, before)
    variance = np.where(rows[:, None] >= 0, angles.sigma[rows] ** 2, np.nan)
    chosen = select_by_variance(variance, angles.blind[rows])
    return _filled([(int(s), int(p)) for s, p in chosen if p >= 0], before)


def _printed(heard: ScanDirections, rows: Ints, before: Pair) -> Pair:
    """Select the two planes and sensors with the rule as [Lee] prints it, which compares polar angles with 45 deg.

    Sensors without elevation are ignored. If none has an elevation, the first plane is xy of the first sensor with a
    direction, and the other one is taken from `before`.

    Args:
        heard: the scan of N sensors.
        rows: (N,) row of each sensor's direction, -1: none.
        before: planes and sensors selected before.
    """
    phi = np.where(rows >= 0, heard.sights.phi[rows], np.nan)
    finite = np.flatnonzero(~np.isnan(phi))
    if not len(finite):
        return _filled([(int(np.flatnonzero(rows >= 0)[0]), XY)], before)
    (s, p), (t, q) = select_as_printed(phi[finite])
    return (int(finite[s]), int(p)), (int(finite[t]), int(q))


def _filled(found: list[tuple[int, int]], before: Pair) -> Pair:
    """Return two (sensor, plane) pairs with different planes: those found, completed by `before`, then by xy or yz.

    The sensor of an added plane is -1: no sensor of the scan measures in it.
    """
    planes = [p for _, p in found]
    spare = [p for _, p in (*before, *NOTHING) if p not in planes]
    found = [*found, *((-1, p) for p in dict.fromkeys(spare))]
    return found[0], found[1]


def nearest_rows(heard: ScanDirections, angles: ProjectedAngles, near: Floats) -> Ints:
    """Return (N,) the row of each sensor's direction that points nearest to the position `near` (3,).

    -1 for a sensor without a direction; the sensor's first row if `near` is NaN.

    Args:
        heard: R directions of a scan of N sensors.
        angles: these directions as unit vectors, with their projected angles.
        near: (3,) position.
    """
    first = heard.sights.first
    to = near - heard.sights.position
    away = -np.einsum("ri,ri->r", angles.toward, to) / np.maximum(np.linalg.norm(to, axis=1), 1e-300)
    away = np.where(np.isnan(away), 0.0, away)
    found = [a + int(np.argmin(away[a:b])) if b > a else -1 for a, b in pairwise(first.tolist())]
    return np.array(found, dtype=np.int64).reshape(-1)


class PlaneSights(NamedTuple):
    """Angles of a scan projected to one plane: the K of the scan's R directions that count there."""

    rows: Bools  # (R,) of the scan
    first: Ints  # (N + 1,) rows of each sensor among those that count
    position: Floats  # (K, 2) of their sensors on the plane's axes
    angle: Floats  # (K,) [rad]
    sigma: Floats  # (K,) [rad]


def sights_in_plane(plane: int, heard: ScanDirections, angles: ProjectedAngles, only: int | None = None) -> PlaneSights:
    """Return the angles of a scan projected to plane number `plane`.

    A sensor counts only if all of its candidates can be projected to this plane, as an excluded one might be the
    target's.

    Args:
        plane: 0, 1, 2 for xy, yz, zx.
        heard: the scan.
        angles: directions of the scan projected to the planes.
        only: index of the one sensor of the scan to use; None: all.
    """
    s = heard.sights
    counts = np.diff(s.first)
    of = np.repeat(np.arange(len(counts)), counts)
    usable = np.bincount(of, weights=angles.blind[:, plane], minlength=len(counts)) == 0
    if only is not None:
        usable &= np.arange(len(counts)) == only
    rows = usable[of]
    first = np.concatenate([[0], np.cumsum(np.where(usable, counts, 0))])
    position = np.ascontiguousarray(s.position[rows][:, list(AXES[plane])])
    return PlaneSights(rows, first, position, angles.angle[rows, plane], angles.sigma[rows, plane])


def log_likelihood(ab: Floats, own: PlaneSights, heard: ScanDirections, chances: ReportProbabilities) -> Floats:
    """Return (L,) log likelihoods of a scan for positions on a plane's axes, up to a constant; 0 without an angle.

    Args:
        ab: (2, L) positions.
        own: angles of the scan in the plane.
        heard: the scan.
        chances: probabilities of false alarms, candidates and clutter.
    """
    if not len(own.angle):
        return np.zeros(ab.shape[1])
    s = heard.sights
    each = log_in_plane(ab, own.position, own.angle, own.sigma, s.reach[own.rows], chances.soften)
    uniform = np.full(len(each), UNIFORM_AZIMUTH)
    return scan_log_likelihood(each, own.first, s.labelled, s.share[own.rows], uniform, chances)


def lines_in_plane(own: PlaneSights, heard: ScanDirections, chances: ReportProbabilities) -> ScanRows:
    """Return a plane's angles of a scan as residuals for the importance density, as azimuths in a space of three axes.

    The third axis is irrelevant.

    Args:
        own: angles of the scan in the plane.
        heard: the scan.
        chances: probabilities of false alarms, candidates and clutter.
    """
    none, c, s = np.zeros(len(own.angle)), np.cos(own.angle), np.sin(own.angle)
    share = heard.sights.share[own.rows]
    scale, rival = factors(heard, own.first, share, np.full(len(share), UNIFORM_AZIMUTH), chances)
    return ScanRows(
        first=own.first,
        position=np.column_stack([own.position, none]),
        along=np.column_stack([c, s, none]),
        left=np.column_stack([-s, c, none]),
        above=np.column_stack([none, none, none + 1.0]),
        variance=np.stack([own.sigma**2, np.full(len(share), np.inf)], axis=1),
        scale=scale,
        rival=rival,
    )


def errors_after(
    errors: Floats,
    heard: ScanDirections,
    angles: ProjectedAngles,
    own: dict[int, PlaneSights],
    flats: dict[int, PlanePosterior],
) -> Floats:
    """Return the (12, 12) joint error covariance of the planes' states after a scan.

    Of a sensor's candidates, the one nearest to the planes' estimates counts, if within `GATE_SIGMAS` standard
    deviations. The diagonal blocks are set to the covariances of the planes' particles.

    Args:
        errors: (12, 12) before the scan, at its time.
        heard: the scan.
        angles: directions of the scan projected to the planes.
        own: projected angles with which each plane was updated, by plane.
        flats: posterior of each plane that was updated, by plane.
    """
    s = heard.sights
    positions = np.zeros((3, 2))
    for p, f in flats.items():
        positions[p] = f.mean[:2]
    for a, b in pairwise(s.first.tolist()):
        if a == b:
            continue
        off = np.full((b - a, 3), np.inf)
        for p, found in own.items():
            if found.rows[a]:
                to = positions[p] - s.position[a, list(AXES[p])]
                gap = angles.angle[a:b, p] - math.atan2(to[1], to[0])
                off[:, p] = np.abs(np.remainder(gap + math.pi, 2.0 * math.pi) - math.pi) / angles.sigma[a:b, p]
        row = int(np.argmin(off.min(axis=1)))
        used = off[row] < GATE_SIGMAS
        if used.any():
            errors = measured_errors(errors, positions, s.position[a], angles.covariance[a + row], used)
    return rescaled(errors, {p: f.covariance for p, f in flats.items()})

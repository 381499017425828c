"""Microphone arrays from people whom calibrated cameras see: position, yaw, height and offset of the clock.

Directions of arrival carry no identity: each is of one of the people who are there, or of another source.  They are a
mixture of Gaussian distributions about the directions of all people and a uniform one, of which expectation and
maximisation (Dempster, Laird and Rubin 1977) with Gauss-Newton steps finds the maximum.  The search starts from the
poses at which most directions agree with people, by a histogram of the differences of yaw over a grid of positions and
offsets of the clock (Hough 1962).

Standard deviations are the larger of those of the curvature and of the sandwich of Huber (1967), with scores added over
blocks of time, since errors of directions last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.records.scene import MicrophoneArray

from ..starts.alignment import Complexes

X, Y, YAW, LATE, DROP = range(5)
"""Parameters: position, correction of the yaw [rad], by how much the clock is late [s], and height of the array above
the mouths of people."""
PARAMETERS = 5
LATE_SIGMA = 4
"""Index of the clock among the standard deviations of a result."""
MIN_LATE_S = 0.05
"""Least offset of a clock that is stated [s]: the time sound takes for 17 m."""
FEW, LOOSE, AMBIGUOUS = (
    "too few of its directions are of people",
    "its directions leave more than 0.5 m or 5 deg of its pose open",
    "two poses fit about as well",
)
"""Reasons why an array is left as it was stated."""
STEP_S = 0.1
"""Step of the grid on which paths are interpolated [s]."""
MAX_GAP_S = 1.0
"""Longest gap of a path that is interpolated [s]."""
MAX_DIRECTIONS, SEARCHED = 6000, 300
"""Directions of an array that are used at most, evenly spread, and those with which the search starts."""
MOUTH_OFF = 0.1
"""Standard deviation of the mouth from the axis of the body, per axis [m]."""
BINS = 60
"""Bins of the histogram of yaw, over a turn."""
CHUNK = 256
"""Positions of the search at a time."""
GRID, GRID_LATE_S = 0.5, 0.4
"""Steps of the search: position [m], and offset of the clock [s]."""
AROUND = 4.0
"""An array is searched within this distance of the paths [m]."""
PROPOSED, JUDGED = 100, 5
"""Poses with most votes at each offset of the clock, and how many times as many are judged by the likelihood."""
STARTS, KEPT = 40, 6
"""Poses from which the search starts, and those that are refined."""
ANNEALING = (4.0, 3.0, 2.0, 1.5)
"""Factors of the standard deviations of directions in the first steps."""
STEPS, FEW_STEPS, TOLERANCE = 60, 12, 1e-4
"""Steps at most at the end and of each start, and the step in standard deviations that ends the search."""
NARROWEST, WIDEST = 1.0, 4.0
"""Limits of the factor of the standard deviations of directions that is estimated."""
BLOCK_S = 2.0
"""Length of the blocks of time over which errors are correlated [s]."""
MIN_DIRECTIONS, MIN_GAIN = 80, 20.0
"""Directions of people at least, and logarithm of the likelihood over that of chance."""
MIN_LEAD = 8.0
"""Logarithm of the likelihood over that of the next pose."""
MAX_SIGMA, MAX_SIGMA_YAW = 0.5, np.radians(5.0)
"""Largest standard deviations of a position [m] and a yaw that count as determined."""


class Path(NamedTuple):
    """Path of a person on the ground: times (n,) [s] by the common clock, and positions (n,) as x + i y."""

    t_s: Floats
    xy: Complexes


class Directions(NamedTuple):
    """K directions of arrival of one array.

    Attributes:
        t_s: (K,) stamped times [s].
        azimuth: (K,) azimuths in the world, by the yaw with which they were recorded [rad].
        elevation: (K,) elevations [rad]; NaN: not measured.
        sigma: (K,) standard deviations of the azimuths [rad].
        sigma_elevation: (K,) standard deviations of the elevations [rad].
    """

    t_s: Floats
    azimuth: Floats
    elevation: Floats
    sigma: Floats
    sigma_elevation: Floats

    def take(self, rows: Ints) -> Directions:
        """Select directions by indices."""
        return Directions(*(each[rows] for each in self))


class ArrayPrior(NamedTuple):
    """Prior knowledge of an array and of people; lengths in the unit of the scene.

    Attributes:
        recorded_yaw: yaw with which directions were recorded [rad].
        max_late_s: largest offset of the clock [s]; 0: the clock is right.
        mouth: mean height of mouths.
        sigma_mouth: standard deviation of that mean.
        metre: length of a metre in scene units.
    """

    recorded_yaw: float
    max_late_s: float
    mouth: float
    sigma_mouth: float
    metre: float


class ArrayResult(NamedTuple):
    """Result of the estimation of one array.

    Attributes:
        array: array with its estimated pose.
        reason: why it is left as it was stated; empty: it was estimated.
        sigma: (5,) standard deviations of x, y, z, yaw [rad] and clock [s]; NaN: not estimated.
        late_s: delay of its clock [s].
        directions: number of directions.
        share: share of them that are of people, 0 to 1.
        scale: estimated factor of the stated standard deviations of directions.
    """

    array: MicrophoneArray
    reason: str
    sigma: Floats
    late_s: float
    directions: int
    share: float
    scale: float

    @property
    def is_late(self) -> bool:
        """Whether the offset of the clock is significant (3 sigma) and at least `MIN_LATE_S`."""
        return not self.reason and abs(self.late_s) > max(3.0 * float(self.sigma[LATE_SIGMA]), MIN_LATE_S)


def place_array(array: MicrophoneArray, heard: Directions, paths: Sequence[Path], prior: ArrayPrior) -> ArrayResult:
    """Estimate the pose and the clock offset of a microphone array by the people whom it hears.

    Args:
        array: array as stated.
        heard: its directions of arrival.
        paths: paths of people, in the frame of the result, by the common clock.
        prior: prior knowledge of the array.

    Returns:
        Estimated array; with a `reason`, the array as it was stated.
    """
    none = ArrayResult(array, FEW, np.full(5, np.nan), 0.0, len(heard.t_s), 0.0, 1.0)
    if not paths:
        return none
    problem = _Problem.of(heard, paths, prior)
    if np.count_nonzero(problem.near()) < MIN_DIRECTIONS:
        return none
    found = _searched(problem, prior)
    if not found or found[0].gain < MIN_GAIN or found[0].of_people < MIN_DIRECTIONS:
        return none._replace(share=found[0].share if found else 0.0)
    best = found[0]
    sigma = np.sqrt(np.diag(best.covariance))
    out = none._replace(reason="", share=best.share, scale=best.scale)
    if max(sigma[X], sigma[Y]) > MAX_SIGMA * prior.metre or sigma[YAW] > MAX_SIGMA_YAW:
        return out._replace(reason=LOOSE)
    if len(found) > 1 and best.gain - found[1].gain < MIN_LEAD:
        return out._replace(reason=AMBIGUOUS)
    return _placed(out, best, sigma, prior, problem)


def _placed(out: ArrayResult, best: _PoseMaximum, sigma: Floats, prior: ArrayPrior, problem: _Problem) -> ArrayResult:
    """Return the result with the pose, standard deviations and clock offset of a fit.

    Args:
        out: result without them.
        best: fit.
        sigma: (5,) standard deviations of its parameters: x, y, correction of the yaw, clock offset, height above
            mouths.
        prior: prior knowledge of the array.
        problem: problem that was fitted.
    """
    x, y, turned, late, drop = best.values.tolist()
    z, sigma_z = float(out.array.position[2]), float("nan")
    if problem.raised:
        z, sigma_z = prior.mouth + drop, float(np.hypot(sigma[DROP], prior.sigma_mouth))
    yaw = float(wrap_angle(np.array(prior.recorded_yaw + turned)))
    return out._replace(
        array=replace(out.array, position=np.array([x, y, z]), yaw=yaw),
        sigma=np.array([sigma[X], sigma[Y], sigma_z, sigma[YAW], sigma[LATE] if prior.max_late_s else 0.0]),
        late_s=late,
    )


class _PoseMaximum(NamedTuple):
    """A local maximum of the likelihood of a microphone array's pose.

    `values` (5,): x, y, correction of the yaw [rad], delay of the clock [s], height above mouths; `gain`:
    log-likelihood ratio to all directions being of other sources; `of_people`: expected number of directions of
    people, and `share` of all; `scale`: factor of the stated standard deviations; `covariance` (5, 5) of the
    values, empty if not computed.
    """

    values: Floats
    gain: float  # logarithm of the likelihood over that of directions of no person
    of_people: float  # number of directions
    share: float
    scale: float
    covariance: Floats = np.zeros((0, 0))


@dataclass
class _Problem:
    """Estimation problem of one array: directions, and paths of people on a grid of times.

    Attributes:
        heard: K directions.
        start_s: first time of the grid [s].
        xy: (P, T) positions x + i y of P people, in scene units, at T times `STEP_S` apart; NaN: absent.
        metre: length of a metre in scene units.
        max_late_s: largest offset of the clock [s]; 0: fixed.
    """

    heard: Directions
    start_s: float
    xy: Complexes
    metre: float
    max_late_s: float

    @classmethod
    def of(cls, heard: Directions, paths: Sequence[Path], prior: ArrayPrior) -> _Problem:
        """Create the problem of one array.

        Args:
            heard: directions of the array; at most `MAX_DIRECTIONS` of them near the times of the paths are kept.
            paths: paths of people, which are interpolated to a grid of times.
            prior: gives the length of a metre and the largest offset of the array's clock.
        """
        start = min(float(p.t_s[0]) for p in paths)
        stop = max(float(p.t_s[-1]) for p in paths)
        times: Floats = start + STEP_S * np.arange(int((stop - start) / STEP_S) + 2, dtype=np.float64)
        xy = np.array([_on_grid(p, times) for p in paths])
        near = np.flatnonzero((heard.t_s > start - prior.max_late_s) & (heard.t_s < stop + prior.max_late_s))
        return cls(heard.take(_spread(near, MAX_DIRECTIONS)), start, xy, prior.metre, prior.max_late_s)

    @property
    def raised(self) -> bool:
        """Whether there are enough elevations to determine the height of the array."""
        return bool(np.count_nonzero(np.isfinite(self.heard.elevation)) >= MIN_DIRECTIONS)

    def part(self) -> _Problem:
        """Return the problem with at most `SEARCHED` directions, at times with a person, to start the search with."""
        near = np.flatnonzero(self.near())
        return replace(self, heard=self.heard.take(_spread(near, SEARCHED)))

    def near(self) -> Bools:
        """(K,) mask of directions at times with a person, if the clock is right."""
        return np.asarray(np.isfinite(self.positions(0.0)[0]).any(axis=0))

    def positions(self, late_s: float) -> tuple[Complexes, Complexes]:
        """Positions (P, K) of P people at the times of K directions, and their velocities (P, K); NaN: absent.

        Both are complex, x + i y, in scene units and in scene units per second. `late_s` is the assumed delay of the
        array's clock [s].
        """
        at = (self.heard.t_s - late_s - self.start_s) / STEP_S
        k = np.clip(np.floor(at).astype(np.int64), 0, self.xy.shape[1] - 2)
        share = at - k
        a, b = self.xy[:, k], self.xy[:, k + 1]
        inside = (share >= 0.0) & (share <= 1.0)
        return np.where(inside, a + share * (b - a), np.nan), np.where(inside, (b - a) / STEP_S, np.nan)


def _on_grid(path: Path, times: Floats) -> Complexes:
    """(T,) positions x + i y of a path at the times of a grid (T,) [s]; NaN outside, and in gaps above `MAX_GAP_S`."""
    out = np.interp(times, path.t_s, path.xy.real) + 1j * np.interp(times, path.t_s, path.xy.imag)
    k = np.clip(np.searchsorted(path.t_s, times), 1, len(path.t_s) - 1)
    gap = path.t_s[k] - path.t_s[k - 1] > MAX_GAP_S
    out[(times < path.t_s[0]) | (times > path.t_s[-1]) | gap] = np.nan
    return np.asarray(out)


def _spread(rows: Ints, most: int) -> Ints:
    """Select at most `most` of the rows, evenly spread."""
    if len(rows) <= most:
        return rows
    return np.asarray(rows[np.linspace(0, len(rows) - 1, most).round().astype(np.int64)])


def _searched(problem: _Problem, prior: ArrayPrior) -> list[_PoseMaximum]:
    """Search for the maxima of the likelihood: from many starts with few directions, then from the best with all.

    Returns:
        Maxima, the largest first, that are not close to each other; only the first has a covariance.
    """
    part = problem.part()
    first = [_climbed(part, values, FEW_STEPS, ANNEALING) for values in _starts(part, prior)]
    first.sort(key=lambda each: -each.gain)
    out: list[_PoseMaximum] = []
    for each in _distinct(first, problem.metre)[:KEPT]:
        out.append(_climbed(problem, each.values, STEPS, ANNEALING[-1:]))
    out.sort(key=lambda each: -each.gain)
    out = _distinct(out, problem.metre)
    return [out[0]._replace(covariance=_covariance(problem, out[0])), *out[1:]] if out else out


def _distinct(fits: Sequence[_PoseMaximum], metre: float) -> list[_PoseMaximum]:
    """Remove from fits, best first, those near to a better one; `metre` is the length of a metre in scene units."""
    out: list[_PoseMaximum] = []
    for each in fits:
        if not any(_near(each.values, other.values, metre) for other in out):
            out.append(each)
    return out


def _near(a: Floats, b: Floats, metre: float) -> bool:
    """Whether two poses, given as parameters (5,) of which x, y and yaw count, are within a metre and 0.35 rad.

    `metre` is the length of a metre in scene units.
    """
    turned = abs(float(wrap_angle(np.array(a[YAW] - b[YAW]))))
    return bool(np.hypot(a[X] - b[X], a[Y] - b[Y]) < metre and turned < 0.35)


def _starts(part: _Problem, prior: ArrayPrior) -> list[Floats]:
    """Initial parameters for the search, at most `STARTS`: poses at which most directions agree with people.

    Votes over a grid of positions, yaws and clock offsets propose them; the likelihood selects. Each is (5,): x, y, yaw
    [rad], delay of the clock [s], and 0 for the height above mouths.

    Args:
        part: problem with few directions.
        prior: length of a metre in scene units.
    """
    step, around = GRID * prior.metre, AROUND * prior.metre
    there = part.xy[np.isfinite(part.xy)]
    low = complex(there.real.min() - around, there.imag.min() - around)
    high = complex(there.real.max() + around, there.imag.max() + around)
    xs = np.arange(low.real, high.real + step, step)
    ys = np.arange(low.imag, high.imag + step, step)
    places = (xs[:, None] + 1j * ys[None, :]).ravel()
    lates = GRID_LATE_S * np.arange(-np.floor(part.max_late_s / GRID_LATE_S), part.max_late_s / GRID_LATE_S + 1e-9)
    centres = 2.0 * np.pi * (np.arange(BINS) + 0.5) / BINS
    found: list[tuple[float, Floats]] = []
    for late in lates.tolist():
        at, _ = part.positions(late)
        votes = _votes(at, places, part.heard.azimuth)
        best = votes.argmax(axis=1)
        for k in np.argsort(-votes.max(axis=1), kind="stable")[:PROPOSED].tolist():
            values = np.array([places[k].real, places[k].imag, centres[best[k]], late, 0.0])
            found.append((float(votes[k, best[k]]), values))
    # Of the proposals with most votes those with the largest likelihood of azimuths with wide errors
    flat = replace(part, heard=part.heard._replace(elevation=np.full(len(part.heard.t_s), np.nan)))
    wide = ANNEALING[0]
    found = [
        (_weighed(flat, _terms(flat, values), wide, 0.5).gain, values)
        for _, values in sorted(found, key=lambda each: -each[0])[: JUDGED * PROPOSED]
    ]
    found.sort(key=lambda each: -each[0])
    out: list[Floats] = []
    for _, values in found:
        if not any(_near(values, other, prior.metre) for other in out):
            out.append(values)
    return out[:STARTS]


def _votes(at: Complexes, places: Complexes, azimuth: Floats) -> Floats:
    """(G, BINS) numbers of directions that agree with a person, by yaw bin, at each of G positions, less their mean.

    A direction has one vote for a bin, however many people are present.

    Args:
        at: (P, K) positions x + i y of P people at the times of K directions; NaN: absent.
        places: (G,) positions x + i y of the array.
        azimuth: (K,) azimuths as recorded [rad].
    """
    out = np.zeros((len(places), BINS))
    turn, K = np.exp(-1j * azimuth), len(azimuth)
    for g0 in range(0, len(places), CHUNK):
        own = places[g0 : g0 + CHUNK]
        hit = np.zeros((len(own), BINS, K), dtype=np.bool_)
        for person in at:
            k = np.flatnonzero(np.isfinite(person))
            off = np.angle((person[k] - own[:, None]) * turn[k]) % (2.0 * np.pi)
            bins = np.minimum((off / (2.0 * np.pi) * BINS).astype(np.int64), BINS - 1)
            hit[np.arange(len(own))[:, None], bins, k] = True
        near = hit | np.roll(hit, 1, axis=1) | np.roll(hit, -1, axis=1)
        out[g0 : g0 + CHUNK] = near.sum(axis=2)
    return np.asarray(out - out.mean(axis=1, keepdims=True))


class _Terms(NamedTuple):
    """Residuals of K directions to P people, and their derivatives by five parameters.

    The parameters are x, y, correction of the yaw, delay of the clock, height above mouths.

    Attributes:
        azimuth: (P, K) residuals of azimuths [rad].
        elevation: (P, K) residuals of elevations [rad]; NaN: not measured.
        slope, slope_up: (P, K, 5) derivatives of azimuths and of elevations.
        spread: (P, K) standard deviation that the position of the mouth adds [rad].
        there: (P, K) mask of people who are present at the time of the direction.
    """

    azimuth: Floats
    elevation: Floats
    slope: Floats
    slope_up: Floats
    spread: Floats
    there: Bools


def _terms(problem: _Problem, values: Floats) -> _Terms:
    """Residuals of the K directions to each of P people, and their derivatives by the parameters.

    `values` (5,): x, y, correction of the yaw [rad], delay of the clock [s], height above mouths.
    """
    heard = problem.heard
    at, speed = problem.positions(float(values[LATE]))
    there = np.isfinite(at)
    d = np.where(there, at - complex(values[X], values[Y]), 1.0)
    v = np.where(there, speed, 0.0)
    away = np.maximum(np.abs(d), 0.2 * problem.metre)
    off = np.angle(np.exp(1j * (heard.azimuth + values[YAW])) * np.conj(d))
    slope = np.zeros((*d.shape, PARAMETERS))
    slope[..., X], slope[..., Y], slope[..., YAW] = -d.imag / away**2, d.real / away**2, 1.0
    slope[..., LATE] = (np.conj(d) * v).imag / away**2
    up = heard.elevation - np.arctan2(-values[DROP], away)
    slope_up = np.zeros_like(slope)
    square = away**2 + values[DROP] ** 2
    slope_up[..., DROP] = away / square
    slope_up[..., X] = values[DROP] / square * d.real / away
    slope_up[..., Y] = values[DROP] / square * d.imag / away
    slope_up[..., LATE] = values[DROP] / square * (np.conj(d) * v).real / away
    if not problem.max_late_s:
        slope[..., LATE] = slope_up[..., LATE] = 0.0
    return _Terms(off, up, slope, slope_up, MOUTH_OFF * problem.metre / away, there)


class _Normal(NamedTuple):
    """Normal equations of a Gauss-Newton step: matrix (5, 5) and right side (5,).

    Also the scores (K, 5), derivatives of the log-likelihood of each of K directions, and the information (5, 5) that
    is missing because the associations are unknown. The five parameters are x, y, yaw, clock and height above mouths.
    """

    matrix: Floats
    right: Floats
    scores: Floats
    missing: Floats


class _Weighed(NamedTuple):
    """Association of K directions with P people, at given parameters.

    Attributes:
        of_person: (P, K) probability that a direction is of a person.
        variance, variance_up: (P, K) variances of azimuths and of elevations [rad^2].
        gain: log-likelihood ratio to all directions being of other sources.
        chance: share of directions of no person.
    """

    of_person: Floats
    variance: Floats
    variance_up: Floats
    gain: float
    chance: float


def _weighed(problem: _Problem, terms: _Terms, scale: float, chance: float) -> _Weighed:
    """Responsibilities of the mixture: probability of each direction to be of each person.

    Args:
        problem: has the K directions.
        terms: residuals of the directions to P people.
        scale: factor of the directions' standard deviations.
        chance: share of directions of no person, 0 to 1.
    """
    heard = problem.heard
    variance = (scale * heard.sigma) ** 2 + terms.spread**2
    variance_up = (scale * heard.sigma_elevation) ** 2 + terms.spread**2
    measured = np.isfinite(terms.elevation)
    log = -0.5 * terms.azimuth**2 / variance - 0.5 * np.log(2.0 * np.pi * variance)
    with np.errstate(invalid="ignore"):
        log_up = -0.5 * terms.elevation**2 / variance_up - 0.5 * np.log(2.0 * np.pi * variance_up)
    log += np.where(measured, log_up, 0.0)
    # Other sources are even over the sphere, or over all azimuths
    other = -np.log(2.0 * np.pi) + np.where(
        np.isfinite(heard.elevation), np.log(0.5 * np.maximum(np.cos(heard.elevation), 1e-3)), 0.0
    )
    count = terms.there.sum(axis=0)
    ratio = np.where(terms.there, np.exp(np.clip(log - other, -700.0, 50.0)), 0.0)
    ratio *= (1.0 - chance) / np.maximum(count, 1)
    total = chance + ratio.sum(axis=0)
    heard_any = count > 0
    share = ratio / total
    gain = float(np.log(total[heard_any]).sum())
    return _Weighed(share, variance, variance_up, gain, float(1.0 - share.sum() / max(np.count_nonzero(heard_any), 1)))


def _normal(terms: _Terms, w: _Weighed, late_precision: float, values: Floats) -> _Normal:
    """Normal equations of a Gauss-Newton step, scores, and the information lost to unknown associations.

    Args:
        terms: residuals and derivatives.
        w: association probabilities.
        late_precision: inverse variance of the prior of the clock offset, around 0 [1/s^2].
        values: (5,) parameters: x, y, correction of the yaw [rad], delay of the clock [s], height above mouths.
    """
    pull = w.of_person / w.variance
    up = np.isfinite(terms.elevation)
    pull_up = np.where(up, w.of_person / w.variance_up, 0.0)
    matrix = np.einsum("pk,pki,pkj->ij", pull, terms.slope, terms.slope)
    matrix += np.einsum("pk,pki,pkj->ij", pull_up, terms.slope_up, terms.slope_up)
    of_pair = -(terms.azimuth / w.variance)[..., None] * terms.slope
    of_pair -= np.where(up, terms.elevation / w.variance_up, 0.0)[..., None] * terms.slope_up
    scores = np.einsum("pk,pki->ki", w.of_person, of_pair)
    missing = np.einsum("pk,pki,pkj->ij", w.of_person, of_pair, of_pair) - scores.T @ scores
    right = scores.sum(axis=0)
    matrix[LATE, LATE] += late_precision
    right[LATE] -= late_precision * values[LATE]
    return _Normal(matrix, right, scores, missing)


def _late_precision(problem: _Problem) -> float:
    """Inverse variance of the prior of the clock offset [1/s^2]: the largest offset is two standard deviations.

    1 if no offset is allowed.
    """
    return 4.0 / problem.max_late_s**2 if problem.max_late_s else 1.0


def _climbed(problem: _Problem, start: Floats, limit: int, annealing: Sequence[float]) -> _PoseMaximum:
    """Local maximum of the likelihood from the parameters `start` (5,), by EM with Gauss-Newton steps; no covariance.

    Args:
        problem: directions and paths.
        start: initial parameters, not changed.
        limit: maximum number of steps.
        annealing: factors of the standard deviations in the first steps.
    """
    values, scale, chance = start.copy(), 1.0, 0.3
    loose = np.diag([1e-6 / problem.metre**2] * 2 + [1e-6, 1e-6, 1e-6])
    for n in range(limit):
        wide = annealing[n] if n < len(annealing) else 1.0
        terms = _terms(problem, values)
        w = _weighed(problem, terms, scale * wide, chance)
        matrix, right, *_ = _normal(terms, w, _late_precision(problem), values)
        # Steps of at most a metre and a quarter of a turn
        step = np.linalg.solve(matrix + loose + np.diag(1e-3 * np.diag(matrix)), right)
        size = np.max(np.abs(step) / [problem.metre, problem.metre, 0.8, 0.5, problem.metre])
        values = values + step / max(float(size), 1.0)
        values[LATE] = np.clip(values[LATE], -problem.max_late_s, problem.max_late_s)
        chance = float(np.clip(w.chance, 0.01, 0.98))
        if n >= len(annealing):
            total = max(float(w.of_person.sum()), 1.0)
            square = float((w.of_person * terms.azimuth**2 / w.variance).sum()) / total
            scale = float(np.clip(scale * np.sqrt(square), NARROWEST, WIDEST))
            if float(step @ matrix @ step) < TOLERANCE**2:
                break
    w = _weighed(problem, _terms(problem, values), scale, chance)
    count = float(w.of_person.sum())
    return _PoseMaximum(values, w.gain, count, count / max(len(problem.heard.t_s), 1), scale)


def _covariance(problem: _Problem, fit: _PoseMaximum) -> Floats:
    """(5, 5) covariance of a fit's parameters, by curvature, widened for errors correlated in time (Huber 1967)."""
    terms = _terms(problem, fit.values)
    w = _weighed(problem, terms, fit.scale, float(np.clip(1.0 - fit.share, 0.01, 0.98)))
    matrix, _, scores, missing = _normal(terms, w, _late_precision(problem), fit.values)
    unit = np.array([problem.metre, problem.metre, 1.0, 1.0, problem.metre])
    inverse = _inverse(matrix, missing, unit)
    block = ((problem.heard.t_s - problem.start_s) // BLOCK_S).astype(np.int64)
    block -= block.min()
    sums = np.zeros((int(block.max()) + 1, PARAMETERS))
    np.add.at(sums, block, scores)
    filled = max(len(np.unique(block)), 2)
    sandwich = inverse @ (sums.T @ sums) @ inverse * filled / (filled - 1)
    wider = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(inverse), 1.0))
    return np.asarray(wider[:, None] * inverse * wider)


def _inverse(matrix: Floats, missing: Floats, unit: Floats) -> Floats:
    """(5, 5) inverse of the observed information (Louis 1982): complete information less what is missing.

    At least a tenth of the complete information is kept. An undetermined parameter has a standard deviation of a
    thousand of its units.

    Args:
        matrix: (5, 5) information if all associations were known.
        missing: (5, 5) information lost because they are not.
        unit: (5,) units of the parameters: a metre in scene units, 1 rad or 1 s.
    """
    scaled = (matrix + np.diag(1e-6 / unit**2)) * np.outer(unit, unit)
    root = np.linalg.cholesky(scaled)
    inner = np.linalg.inv(root)
    lost, axes = np.linalg.eigh(inner @ (missing * np.outer(unit, unit)) @ inner.T)
    kept = inner.T @ axes
    return np.asarray((kept / np.maximum(1.0 - lost, 0.1)) @ kept.T * np.outer(unit, unit))

"""Method `fix`: each scan's position from that scan's bearings and measurements of distances alone.

By a mixture of true and false bearings (`occlog.track.methods.fix.estimators`), with ranges and their like as well
(`occlog.track.methods.fix.lines_and_distances`), or by [Lenth] 1981 (`occlog.track.methods.fix.estimators`).

Nothing is carried from one scan to the next but how many bearings were false.  A scan that tells no position (one
bearing, parallel lines, lines that meet behind the sensors) gives no row.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats, Ints
from occlog.errors import UsageError
from occlog.filtering.false_bearings import FalseBearings
from occlog.filtering.likelihood.distances import RangeMeasurements
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import BearingResiduals, Estimate, Online

from .config import BENDS, MIXTURE, FixConfig
from .estimators import Fix, Modes, crossings, fix, modes, pooled_factor, spread_of
from .false_lines import FalseLines, Region, depends_on_one, false_line_moment
from .lines_and_distances import (
    GRID_REACH_EXTENTS,
    MIN_SECOND_MODE_PROBABILITY,
    BearingLines,
    has_rival_mode,
    measured_at,
    modes_of,
)

MAX_PAIRS = 40_000
"""Pairs of candidates that are tried; beyond, the least certain candidates are omitted."""
STATED, PAIR, AMBIGUOUS = "stated_covariance", "two_lines", "ambiguous"
UNVERIFIED, POSSIBLE_OUTLIER = "unverified", "possible_outlier"


class FixState(NamedTuple):
    """State of method `fix`: settings, sensors (cameras, then arrays), room, and the statistics of false bearings."""

    config: FixConfig
    positions: Floats  # (S, 2), as in `sensor_names`
    width: Floats  # (S,) fields of view [rad]
    room: Floats | None  # (K, 2) corners
    region: Region
    false: FalseBearings = FalseBearings()


def init(scene: Scene, config: FixConfig, rng: Generator) -> FixState:  # noqa: ARG001
    """Return the state before the first scan, with sensors and room of the scene; `rng` is not used.

    Without a room the region of possible targets is the sensors' bounding box with a margin.
    """
    found = [c.ground for c in scene.cameras] + [a.position[:2] for a in scene.arrays]
    positions = np.array(found, dtype=np.float64).reshape(-1, 2)
    width = np.array([c.fov for c in scene.cameras] + [2.0 * math.pi] * len(scene.arrays))
    around = positions if scene.room is None else scene.room
    low, high = (around.min(axis=0), around.max(axis=0)) if len(around) else (np.zeros(2), np.zeros(2))
    reach = GRID_REACH_EXTENTS * float((high - low).max()) if scene.room is None else 0.0
    return FixState(config, positions, width, scene.room, Region(low - reach, high + reach))


def step(state: FixState, scan: Scan, rng: Generator) -> tuple[FixState, Estimate | None]:  # noqa: ARG001
    """Return the state with updated statistics of false bearings, and the scan's estimate; None if undetermined.

    The estimate depends on earlier scans by those statistics alone, and has no velocity (NaN); `rng` is not used.
    """
    config = state.config
    # Associate: rows of the target, and the candidates that agree best
    rows = _rows(state, scan)
    if scan.measured is not None:
        return state, _mixed(state, scan, rows, scan.measured.distances)
    if len(rows) < 2:
        return state, None
    # Estimate ([Lenth] 1981)
    positions, bearings, sigma = state.positions[scan.sensor[rows]], scan.bearing[rows], scan.sigma[rows]
    if config.estimator == MIXTURE:
        state, found = _mixture(state, scan.sensor[rows], bearings, sigma)
    else:
        found = _estimated(config, positions, bearings, sigma)
    if found is None:
        return state, None
    # Score: log-likelihood of the bearings at the estimate
    off = _wrapped(bearings - np.arctan2(found.xy[1] - positions[:, 1], found.xy[0] - positions[:, 0]))
    score = -0.5 * (off / sigma) ** 2 - np.log(sigma * math.sqrt(2.0 * math.pi))
    observing, used = np.unique(scan.sensor), np.unique(scan.sensor[rows])
    # Two lines leave no residuals from which their spread could be estimated, and none of them can be false.
    scarce = PAIR if len(rows) == 2 else STATED
    cause = "" if found.estimated or (config.covariance != "residuals" and len(rows) > 2) else scarce
    if config.covariance == "stated":
        cause = ""
    inlier = found.weights if config.estimator == MIXTURE else _inlier_probabilities(off / sigma)
    saw = np.unique(scan.sensor[rows][inlier >= 0.5])
    return state, Estimate(
        xy=found.xy,
        velocity=np.full(2, np.nan),
        covariance=found.covariance,
        ess=math.nan,
        log_likelihood=float(score.sum()),
        n_observing=len(observing),
        n_detected=len(used),
        fallback=cause,
        used=tuple(used.tolist()),
        seen_by=tuple(saw.tolist()),
        fit=BearingResiduals(
            np.zeros(len(rows), dtype=np.int64),
            scan.sensor[rows],
            off / sigma,
            _expected(positions, sigma, found),
            inlier,
        ),
    )


def _mixed(state: FixState, scan: Scan, rows: Ints, distances: RangeMeasurements) -> Estimate | None:
    """Return the position estimate from bearings and measurements of distances of a scan; None if undetermined.

    UsageError for an estimator that takes bearings alone.

    Args:
        state: settings, sensors and room.
        scan: the scan.
        rows: indices of the scan's rows with bearings to use.
        distances: measurements of distances.
    """
    config = state.config
    if config.estimator != MIXTURE:
        raise UsageError(
            f"estimator {config.estimator} takes bearings alone; with ranges, signal strengths or "
            f"time differences use estimator={MIXTURE}",
            id="not-applicable",
        )
    if len(rows) + len(distances.kind) < 2:
        return None
    lines = BearingLines(state.positions[scan.sensor[rows]], scan.bearing[rows], scan.sigma[rows], config.bent)
    found = modes_of(lines, distances, state.room)
    if found is None:
        return None
    spread = spread_of(found, pooled=config.covariance == "pooled")
    # Residuals, and their variance: 1 less the leverage
    at = measured_at(lines, distances, found.xy[:1])
    inlier, gradient = found.inlier_probability[0], at.gradient[0]
    information = (gradient * inlier[:, None]).T @ gradient
    leverage = inlier * np.einsum("ni,ij,nj->n", gradient, np.linalg.pinv(information), gradient)
    sigma = np.concatenate([lines.sigma, distances.sigma])
    score = -0.5 * found.residual[0] ** 2 - np.log(sigma * math.sqrt(2.0 * math.pi))
    sensor = np.concatenate([scan.sensor[rows], distances.station])
    used = np.unique(sensor)
    return Estimate(
        xy=found.xy[0],
        velocity=np.full(2, np.nan),
        covariance=spread,
        ess=math.nan,
        log_likelihood=float(score.sum()),
        n_observing=len(np.unique(np.concatenate([scan.sensor, distances.station]))),
        n_detected=len(used),
        fallback=_fallback(found, config.covariance),
        used=tuple(used.tolist()),
        seen_by=tuple(np.unique(sensor[inlier >= 0.5]).tolist()),
        fit=BearingResiduals(
            row=np.zeros(len(sensor), dtype=np.int64),
            sensor=sensor,
            residual=found.residual[0],
            expected_variance=np.clip(1.0 - leverage, 0.0, 1.0),
            inlier_probability=inlier,
        ),
    )


def _fallback(found: Modes, spread: str) -> str:
    """Return why a position is doubtful, empty if it is not: rival modes, two measurements, or a possible false one.

    `spread` is the setting `covariance`; with `stated`, a position from two measurements is not doubtful.
    """
    if len(found.xy) > 1 and found.probability[1] >= MIN_SECOND_MODE_PROBABILITY:
        return AMBIGUOUS
    inlier = found.inlier_probability[0]
    if len(inlier) == 2:
        return PAIR if spread != "stated" else ""
    if np.count_nonzero(inlier >= 0.5) <= 2:
        return UNVERIFIED
    return POSSIBLE_OUTLIER if has_rival_mode(found) else ""


def _mixture(state: FixState, sensor: Ints, bearings: Floats, sigma: Floats) -> tuple[FixState, Fix | None]:
    """Return the state with updated statistics of false bearings, and the position by the mixture likelihood.

    The position is None if undetermined; its weights are the probabilities that bearings are true.

    Args:
        state: settings, sensors and statistics of false bearings.
        sensor: (n,) rows of `state.positions`.
        bearings: (n,) bearings [rad].
        sigma: (n,) standard deviations [rad].
    """
    config, positions = state.config, state.positions[sensor]
    found = modes(positions, bearings, sigma, config.bent)
    if found is None:
        return state, None
    spread, false = spread_of(found, pooled=config.covariance == "pooled"), state.false
    epsilon = false.probability(config.false_bearing_probability)
    if epsilon > 0.0 and depends_on_one(found, positions, sigma):
        lines = FalseLines(state.width[sensor], epsilon, config.bent, epsilon > config.false_bearing_probability)
        probability, moment = false_line_moment(found, positions, bearings, sigma, lines, state.region)
        spread = (1.0 - probability) * spread + probability * moment
    if len(sensor) > 2:
        # Two bearings alone always agree
        false = false.counted(found.probability @ found.inlier_probability)
    weights, kappa = found.inlier_probability[0], float((1.0 / sigma**2).mean())
    return state._replace(false=false), Fix(found.xy[0], spread, weights, kappa, estimated=False)


def _estimated(config: FixConfig, positions: Floats, bearings: Floats, sigma: Floats) -> Fix | None:
    """Return the position by an estimator of [Lenth], with covariance by `config.covariance`; None if undetermined.

    `positions` (n, 2) are the sensors', `bearings` (n,) in [rad], `sigma` (n,) stated standard deviations [rad].
    """
    pooled, median = config.covariance == "pooled", config.estimator in ("rmr", "jrmr")
    learned = config.covariance == "residuals" or (pooled and not median)
    fixed = fix(positions, bearings, sigma, config.estimator, config.bent, learned)
    if fixed is None or not pooled:
        return fixed
    # As stated, then scaled by what residuals and statement say together
    stated = float((1.0 / sigma**2).mean())
    off = _wrapped(bearings - np.arctan2(fixed.xy[1] - positions[:, 1], fixed.xy[0] - positions[:, 0])) / sigma
    factor = pooled_factor(float(fixed.weights @ off**2), max(float(fixed.weights.sum()) - 2.0, 0.0))
    return fixed._replace(covariance=factor * fixed.kappa / stated * fixed.covariance, estimated=False)


def _inlier_probabilities(residual: Floats) -> Floats:
    """Return (n,) probabilities that bearings are true, by their normalised residuals (n,).

    They are 1/2 at 3.7 standard deviations, the threshold of the estimator `mixture`.
    """
    return np.asarray(1.0 / (1.0 + np.exp(np.minimum(0.5 * (residual**2 - BENDS[MIXTURE] ** 2), 700.0))))


def _expected(positions: Floats, sigma: Floats, found: Fix) -> Floats:
    """Return (n,) expected variances of the normalised residuals of true bearings at `found`: 1 minus the leverage.

    `positions` (n, 2) are the sensors', `sigma` (n,) standard deviations of the bearings [rad].
    """
    away = found.xy - positions
    squared = np.maximum((away**2).sum(axis=1), 1e-24)
    across = np.column_stack([-away[:, 1], away[:, 0]]) / (squared * sigma)[:, None]
    information = (across * found.weights[:, None]).T @ across
    leverage = found.weights * np.einsum("ni,ij,nj->n", across, np.linalg.pinv(information), across)
    return np.asarray(np.clip(1.0 - leverage, 0.0, 1.0))


def _rows(state: FixState, scan: Scan) -> Ints:
    """Return the indices of the scan's rows to use: those labelled as the target, and unlabelled candidates that agree.

    With the setting `candidates=ignore`, the labelled ones alone.
    """
    usable = scan.seen & np.isfinite(scan.bearing) & np.isfinite(scan.sigma) & (scan.sigma > 0.0)
    if state.config.candidates == "ignore":
        usable &= scan.labelled
    rows = np.flatnonzero(usable)
    if scan.labelled[rows].all():
        return rows
    return _agreed(state, scan, rows)


def _agreed(state: FixState, scan: Scan, rows: Ints) -> Ints:
    """Return the rows of a scan that agree on a crossing of two lines of sight, at most one for each sensor.

    The crossing is the one with the least sum of squared residuals, each limited to the gate. Of more rows than
    `MAX_PAIRS` pairs allow, unlabelled and then uncertain ones are omitted.

    Args:
        state: sensors and settings.
        scan: bearings of one time.
        rows: indices of the bearings to choose from.
    """
    if len(rows) ** 2 > MAX_PAIRS:
        keep = np.lexsort((scan.sigma[rows], ~scan.labelled[rows]))[: int(MAX_PAIRS**0.5)]
        rows = rows[np.sort(keep)]
    sensor, bearings, sigma = scan.sensor[rows], scan.bearing[rows], scan.sigma[rows]
    positions, gate = state.positions[sensor], state.config.gate
    ahead = crossings(positions, bearings)
    both = np.isfinite(ahead[:, :, 0]) & np.isfinite(ahead[:, :, 0].T)  # in front of the two sensors
    i, j = np.nonzero(np.triu(both & (sensor[:, None] != sensor[None, :])))
    best, chosen = math.inf, np.empty(0, dtype=np.int64)
    members = [np.flatnonzero(sensor == s) for s in np.unique(sensor)]
    for point in ahead[i, j]:
        off = _wrapped(bearings - np.arctan2(point[1] - positions[:, 1], point[0] - positions[:, 0])) / sigma
        nearest = np.array([own[np.argmin(np.abs(off[own]))] for own in members])
        cost = float(np.minimum(off[nearest] ** 2, gate**2).sum())
        if cost < best:
            best, chosen = cost, nearest[np.abs(off[nearest]) < gate]
    return rows[np.sort(chosen)]


def _wrapped(angle: Floats) -> Floats:
    """Return angles [rad] wrapped to [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


METHOD = Online(
    config=FixConfig, init=init, step=step, started=lambda _: False, measured=True, judges=True, consistent=True
)

"""Bearings against the truth, look by look: what a sensor said of a target and what it should have said.

A look is one frame of one sensor together with one true target of which the frame says
something: a labelled row (`target_id` >= 0, seen or not), or unlabelled candidates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..columns import Bools, Floats, Ints
from ..core.camera import wrap_angle
from ..core.metrics import pair_within
from ..core.sight import behind_objects
from ..records import Bearings
from .evaluate_config import EvaluateConfig
from .evaluate_paths import Expected, Path, Sensor


@dataclass(frozen=True, eq=False)
class Looks:
    """Looks of one sensor; residuals and noise are NaN where no bearing was reported."""

    t_ns: Ints
    target: Ints  # identity in the truth
    truth: Bools  # whether the target's true position at that time is known
    xy: Floats  # (N, 2) true position, held where not known
    reported: Bools  # a bearing was reported (for candidates: one was paired with the target)
    hit: Bools  # it is within the gate of the true direction
    visible: Bools  # the target should have been seen
    in_view: Bools  # the target was in the field of view, hidden or not
    residual_px: Floats  # reported minus true u_px
    residual: Floats  # reported minus true azimuth [rad]
    normalised: Floats  # residual over its standard deviation (Eq. 2 for cameras)
    sigma_px: Floats
    sigma: Floats

    def take(self, rows: Bools) -> Looks:
        """The looks selected by a mask."""
        return Looks(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


class SensorLooks(NamedTuple):
    """All looks of one sensor, and the candidates that are of nothing in the truth."""

    looks: Looks
    frames: int  # with a known truth
    stray: int  # candidates in these frames that are near no true object


def look_at(
    sensor: Sensor,
    rows: Bearings,
    labels: Mapping[int, int],
    targets: Mapping[int, Path],
    others: Mapping[int, Path],
    config: EvaluateConfig,
) -> SensorLooks:
    """Compare one sensor's rows with the truth.

    Args:
        sensor: whose rows these are.
        rows: bearings of that sensor only.
        labels: identity in the bearings to identity in the truth; rows of other identities are left out.
        targets: true paths of the targets.
        others: true paths of the moving occluders.
        config: gates, limit in time, diameter of moving objects.
    """
    everyone = {**targets, **others}
    labelled = np.isin(rows.target_id, list(labels))
    known = rows.take(labelled)
    target = np.array([labels[k] for k in known.target_id.tolist()], dtype=np.int64)
    first = _looks(sensor, known, target, everyone, config)
    candidates = rows.take(rows.target_id < 0)
    paired, target, stray = _pair_candidates(sensor, candidates, first, targets, everyone, config)
    looks = _concat(first, _looks(sensor, paired, target, everyone, config))
    frames = len(np.unique(looks.t_ns[looks.truth]))
    return SensorLooks(looks, frames, stray)


def _concat(a: Looks, b: Looks) -> Looks:
    return Looks(**{n: np.concatenate([getattr(a, n), getattr(b, n)]) for n in a.__dataclass_fields__})


def _looks(sensor: Sensor, rows: Bearings, target: Ints, everyone: Mapping[int, Path], config: EvaluateConfig) -> Looks:
    xy, truth = np.full((len(rows), 2), np.nan), np.zeros(len(rows), dtype=np.bool_)
    hidden = np.zeros(len(rows), dtype=np.bool_)
    for k in np.unique(target).tolist():
        mine = target == k
        xy[mine] = everyone[k].roughly_at(rows.t_ns[mine])
        truth[mine] = everyone[k].at(rows.t_ns[mine], config.limit_ns)[1]
        hidden[mine] = _behind_moving(sensor, rows.t_ns[mine], xy[mine], k, everyone, config)
    expected = sensor.expect(xy)
    residual = _residuals(rows, expected)
    return Looks(
        t_ns=rows.t_ns,
        target=target,
        truth=truth,
        xy=xy,
        reported=rows.seen,
        hit=rows.seen & (_distance(residual, config) <= 1.0),
        visible=expected.clear & ~hidden,
        in_view=expected.in_view,
        residual_px=residual.px,
        residual=residual.rad,
        normalised=residual.normalised,
        sigma_px=rows.sigma_px,
        sigma=rows.sigma,
    )


def _behind_moving(
    sensor: Sensor, t_ns: Ints, xy: Floats, target: int, everyone: Mapping[int, Path], config: EvaluateConfig
) -> Bools:
    """Which looks a moving object blocks ([Ercan] Fig. 3); cameras only, and only if a diameter is given."""
    rest = [path for k, path in everyone.items() if k != target]
    if config.occluder_diameter is None or sensor.camera is None or not rest:
        return np.zeros(len(t_ns), dtype=np.bool_)
    places = np.stack([path.at(t_ns, config.limit_ns)[0] for path in rest], axis=1)
    return behind_objects(sensor.ground, xy, places, config.occluder_diameter)


class _Residuals(NamedTuple):
    """Reported minus expected, in pixels, radians and standard deviations."""

    px: Floats
    rad: Floats
    normalised: Floats


def _residuals(rows: Bearings, expected: Expected, cross: bool = False) -> _Residuals:
    """Residuals of N rows, one by one or (N, M) against every expectation.

    A target that is not in front of a camera is infinitely far off.
    """
    columns = (rows.bearing, rows.u_px, rows.sigma_px, rows.sigma)
    bearing, u_px, sigma_px, sigma = (c[:, None] if cross else c for c in columns)
    rad = wrap_angle(bearing - expected.bearing)
    pixels = np.isfinite(u_px) & np.isfinite(sigma_px)
    behind = pixels & np.isnan(expected.u_px)
    px = np.where(behind, np.inf, u_px - expected.u_px)
    normalised = np.where(pixels, px / np.sqrt(expected.variance_px + sigma_px**2), rad / sigma)
    return _Residuals(px, rad, np.where(behind, np.inf, normalised))


def _distance(residual: _Residuals, config: EvaluateConfig) -> Floats:
    """Absolute residual as a share of the gate: up to 1 is within; NaN where nothing was reported."""
    by_sigma = np.abs(residual.normalised) / config.gate_sigma
    if config.gate_px is None:
        return by_sigma
    return np.asarray(np.where(np.isnan(residual.px), by_sigma, np.abs(residual.px) / config.gate_px))


def _pair_candidates(
    sensor: Sensor,
    rows: Bearings,
    labelled: Looks,
    targets: Mapping[int, Path],
    everyone: Mapping[int, Path],
    config: EvaluateConfig,
) -> tuple[Bearings, Ints, int]:
    """One row for each frame with candidates and each target without a labelled row there.

    The row is the candidate paired with the target, or a `not seen` one.  A candidate may
    also be of an occluder: it is stray only if it is near no true object at all.

    Returns:
        The rows, the target of each, and the number of stray candidates.
    """
    times, first = np.unique(rows.t_ns, return_index=True)
    places = {k: path.at(times, config.limit_ns) for k, path in everyone.items()}
    told = set(zip(labelled.t_ns.tolist(), labelled.target.tolist(), strict=True))
    picked: list[tuple[int, int, bool]] = []  # row, target, whether that row is of the target
    stray = 0
    for n, (start, end) in enumerate(pairwise([*first.tolist(), len(rows)])):
        present = [k for k in everyone if places[k][1][n]]
        if not any(k in targets for k in present):
            continue
        candidates = start + np.flatnonzero(rows.seen[start:end])
        xy = np.array([places[k][0][n] for k in present])
        found = {present[j]: int(candidates[i]) for i, j in _pair(sensor, rows, candidates, xy, config)}
        stray += len(candidates) - len(found)
        asked = [k for k in present if k in targets and (int(times[n]), k) not in told]
        picked += [(found.get(k, start), k, k in found) for k in asked]
    row, target, seen = (np.array(column) for column in zip(*picked, strict=True)) if picked else [_NONE] * 3
    return _chosen(rows, row.astype(np.int64), seen.astype(np.bool_)), target.astype(np.int64), stray


_NONE = np.zeros(0, dtype=np.int64)


def _chosen(rows: Bearings, row: Ints, seen: Bools) -> Bearings:
    """These rows, without their measurement where they are not of the target."""
    taken = rows.take(row)
    measured = {
        name: np.where(seen, getattr(taken, name), np.nan) for name in ("bearing", "sigma", "u_px", "sigma_px", "score")
    }
    return Bearings(t_ns=taken.t_ns, sensor=taken.sensor, target_id=taken.target_id, seen=seen, **measured)


def _pair(
    sensor: Sensor, rows: Bearings, candidates: Ints, xy: Floats, config: EvaluateConfig
) -> list[tuple[int, int]]:
    """One-to-one pairs (candidate, object) within the gate, nearest first in all."""
    cost = _distance(_residuals(rows.take(candidates), sensor.expect(xy), cross=True), config)
    return pair_within(cost, 1.0)

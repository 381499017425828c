"""Bearings against the truth, look by look: what a sensor said of a target and what it should have said.

A look is one frame of one sensor together with one true target of which the frame says
something: a labelled row (`target_id` >= 0, seen or not), or unlabelled candidates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.records.tables import Bearings

from .config import EvaluateConfig
from .pairing import pair_candidates
from .paths import Path, Sensor
from .residuals import behind_moving, gated, residuals


@dataclass(frozen=True, eq=False)
class Looks:
    """Looks of one sensor; residuals and noise are NaN where no bearing was reported."""

    t_ns: Ints
    target: Ints  # identity in the truth
    truth: Bools  # whether the target's true position at that time is known
    xy: Floats  # (N, 2) true position, held where not known
    z: Floats  # true height, held likewise; NaN if the truth has none
    reported: Bools  # a bearing was reported (for candidates: one was paired with the target)
    hit: Bools  # it is within the gate of the true direction
    visible: Bools  # the target should have been seen
    in_view: Bools  # the target was in the field of view, hidden or not
    residual_px: Floats  # reported minus true u_px
    residual: Floats  # reported minus true azimuth [rad]
    normalised: Floats  # residual over its standard deviation (Eq. 2 for cameras)
    sigma_px: Floats
    sigma: Floats
    elevation: Floats  # as reported [rad]; NaN where none was
    sigma_elevation: Floats
    residual_elevation: Floats  # reported minus true, about the sensor's own axes [rad]
    normalised_elevation: Floats

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
    known = rows.take(np.isin(rows.target_id, list(labels)))
    target = np.array([labels[k] for k in known.target_id.tolist()], dtype=np.int64)
    told = set(zip(known.t_ns.tolist(), target.tolist(), strict=True))
    paired = pair_candidates(sensor, rows.take(rows.target_id < 0), told, targets, everyone, config)
    looks = _concat(
        _looks(sensor, known, target, everyone, config),
        _looks(sensor, paired.rows, paired.target, everyone, config),
    )
    return SensorLooks(looks, len(np.unique(looks.t_ns[looks.truth])), paired.stray)


def _concat(a: Looks, b: Looks) -> Looks:
    return Looks(**{n: np.concatenate([getattr(a, n), getattr(b, n)]) for n in a.__dataclass_fields__})


def _looks(sensor: Sensor, rows: Bearings, target: Ints, everyone: Mapping[int, Path], config: EvaluateConfig) -> Looks:
    xy, truth = np.full((len(rows), 2), np.nan), np.zeros(len(rows), dtype=np.bool_)
    z = np.full(len(rows), np.nan)
    hidden = np.zeros(len(rows), dtype=np.bool_)
    for k in np.unique(target).tolist():
        mine = target == k
        xy[mine] = everyone[k].roughly_at(rows.t_ns[mine])
        z[mine] = everyone[k].rough_height_at(rows.t_ns[mine])
        truth[mine] = everyone[k].at(rows.t_ns[mine], config.limit_ns)[1]
        hidden[mine] = behind_moving(sensor, rows.t_ns[mine], xy[mine], k, everyone, config)
    expected = sensor.expect(xy, z)
    residual = residuals(rows, expected, sensor)
    return Looks(
        t_ns=rows.t_ns,
        target=target,
        truth=truth,
        xy=xy,
        z=z,
        reported=rows.seen,
        hit=rows.seen & (gated(residual, config) <= 1.0),
        visible=expected.clear & ~hidden,
        in_view=expected.in_view,
        residual_px=residual.px,
        residual=residual.rad,
        normalised=residual.normalised,
        sigma_px=rows.sigma_px,
        sigma=rows.sigma,
        elevation=rows.elevation,
        sigma_elevation=rows.sigma_elevation,
        residual_elevation=residual.elevation,
        normalised_elevation=residual.elevation_normalised,
    )

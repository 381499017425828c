"""How well bearings tell where the targets are: detections, misses, false alarms, errors of the bearings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

import numpy as np

from occlog.core.metrics.errors import ratio
from occlog.core.metrics.sums import Sum
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.looks import SensorLooks, look_at
from occlog.evaluate.matching.paths import paths_of, sensors_of
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Truth

Metrics = dict[str, float]


@dataclass(frozen=True)
class Counts:
    """Counts and sums over looks with a known truth; they add up over sensors."""

    frames: int = 0  # of a sensor
    looks: int = 0  # frame and target
    visible: int = 0  # looks in which the target should have been seen
    detected: int = 0  # of these, with a bearing within the gate
    detected_hidden: int = 0  # a bearing within the gate although the target should have been hidden
    false_alarms: int = 0  # bearings that are of no true object, or of the target but away from it
    correct_rejections: int = 0  # hidden, and nothing reported
    without_truth: int = 0  # looks whose truth is not known; in no other count
    n_px: int = 0  # bearings of visible targets within the gate: number, sums of residuals and their squares
    sum_px: float = 0.0
    square_px: float = 0.0
    square_rad: float = 0.0
    square_normalised: float = 0.0
    n_elevation: int = 0  # the same for elevations
    square_elevation: float = 0.0
    square_elevation_normalised: float = 0.0

    @property
    def missed(self) -> int:
        """Looks at a visible target without a bearing within the gate."""
        return self.visible - self.detected


def count(found: SensorLooks) -> Counts:
    """Counts of one sensor."""
    looks = found.looks.take(found.looks.truth)
    good = looks.visible & looks.hit
    up = good & np.isfinite(looks.residual_elevation)
    px = looks.residual_px[good & np.isfinite(looks.residual_px)]
    away = looks.reported & ~looks.hit
    return Counts(
        frames=found.frames,
        looks=len(looks.t_ns),
        visible=int(np.count_nonzero(looks.visible)),
        detected=int(np.count_nonzero(good)),
        detected_hidden=int(np.count_nonzero(looks.hit & ~looks.visible)),
        false_alarms=int(np.count_nonzero(away)) + found.stray,
        correct_rejections=int(np.count_nonzero(~looks.visible & ~looks.reported)),
        without_truth=int(np.count_nonzero(~found.looks.truth)),
        n_px=len(px),
        sum_px=float(px.sum()),
        square_px=float(np.sum(px**2)),
        square_rad=float(np.sum(looks.residual[good] ** 2)),
        square_normalised=float(np.sum(looks.normalised[good] ** 2)),
        n_elevation=int(np.count_nonzero(up)),
        square_elevation=float(np.sum(looks.residual_elevation[up] ** 2)),
        square_elevation_normalised=float(np.sum(looks.normalised_elevation[up] ** 2)),
    )


def looks_of(
    bearings: Bearings, truth: Truth, scene: Scene, pairs: Mapping[int, int], config: EvaluateConfig
) -> dict[str, SensorLooks]:
    """Looks of every sensor in the bearings, by its name.

    Args:
        bearings: labelled or not.
        truth: targets and moving occluders.
        scene: sensors, walls.
        pairs: identity in the bearings to identity in the truth.
        config: gates, limits.
    """
    targets, others = paths_of(truth, "target"), paths_of(truth, "occluder")
    sensors = sensors_of(scene, np.unique(bearings.sensor).tolist())
    return {
        name: look_at(sensor, bearings.take(bearings.sensor == name), pairs, targets, others, config)
        for name, sensor in sensors.items()
    }


class DetectionFigures:
    """Counts looks while they stream by."""

    def __init__(self) -> None:
        """No look yet."""
        self._sensors: dict[str, dict[str, Sum]] = {}

    def update(self, looks: Mapping[str, SensorLooks]) -> None:
        """Looks of some more frames, by sensor."""
        for name, found in looks.items():
            own = self._sensors.setdefault(name, {f.name: Sum() for f in fields(Counts)})
            part = count(found)
            for f in fields(Counts):
                own[f.name].add(float(getattr(part, f.name)))

    def result(self) -> Metrics:
        """Figures over all sensors, from sums, then for each sensor."""
        counts = {name: _counts(own) for name, own in sorted(self._sensors.items())}
        out = _figures(add_counts(counts.values()), "")
        for name, part in counts.items():
            out |= _figures(part, f"_sensor_{name}")
        return out


def _counts(sums: Mapping[str, Sum]) -> Counts:
    """Whole numbers, and sums."""
    whole = {f.name: isinstance(f.default, int) for f in fields(Counts)}
    return Counts(**{name: int(s.value) if whole[name] else s.value for name, s in sums.items()})  # type: ignore[arg-type]


def add_counts(parts: Iterable[Counts]) -> Counts:
    """All parts together."""
    rows = list(parts)
    return Counts(**{f.name: sum(getattr(c, f.name) for c in rows) for f in fields(Counts)})


def _figures(c: Counts, whose: str) -> Metrics:
    of_elevations = {
        f"elevation_rms{whose}_mrad": 1e3 * math.sqrt(ratio(c.square_elevation, c.n_elevation)),
        f"elevation_nis{whose}": ratio(c.square_elevation_normalised, c.n_elevation),
    }
    return (of_elevations if c.n_elevation else {}) | {
        f"detection_frames{whose}": c.frames,
        f"detection_looks{whose}": c.looks,
        f"detection_looks_without_truth{whose}": c.without_truth,
        f"visible{whose}": c.visible,
        f"detected{whose}": c.detected,
        f"missed{whose}": c.missed,
        f"detected_hidden{whose}": c.detected_hidden,
        f"correct_rejections{whose}": c.correct_rejections,
        f"false_alarms{whose}": c.false_alarms,
        f"false_alarms_per_frame{whose}": ratio(c.false_alarms, c.frames),
        f"detection_rate{whose}": ratio(c.detected, c.visible),
        f"bearing_rms{whose}_px": math.sqrt(ratio(c.square_px, c.n_px)),
        f"bearing_bias{whose}_px": ratio(c.sum_px, c.n_px),
        f"bearing_rms{whose}_mrad": 1e3 * math.sqrt(ratio(c.square_rad, c.detected)),
        f"bearing_nis{whose}": ratio(c.square_normalised, c.detected),
    }

"""Leave one sensor out: how well tracks made without it predict what it saw.

The tracks must have been made without the sensor (`occlog track --without NAME`): then
its bearings are an independent test that needs no ground truth.  Labelled rows are
compared directly; of unlabelled candidates the nearest is taken, which flatters any
track where there are many.  So every figure is given once more with the sensor's
frames paired with predictions for other times: what chance, and a target that stays
about where it is, would give.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import quantile, ratio, root_mean_square
from occlog.core.sight.camera import wrap_angle
from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import Expected, Path, Sensor, paths_of, sensors_of
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Tracks

Metrics = dict[str, float]

SHIFTS = 16
"""Cyclic shifts in time, evenly spread between a tenth and nine tenths of the recording, that stand for chance."""


class Frames(NamedTuple):
    """Frames of one sensor with the bearings that each reported."""

    t_ns: Ints  # (N,)
    bearing: Floats  # (N, K) azimuths, NaN where there are fewer than K
    u_px: Floats  # (N, K)


class Prediction(NamedTuple):
    """Residuals of the nearest reported bearing, one a frame in which the target should be in view."""

    px: Floats  # (F,) reported minus predicted; NaN where the frame reported nothing, or not a camera
    rad: Floats  # (F,)


def held_out_metrics(tracks: Tracks, bearings: Bearings, scene: Scene, config: EvaluateConfig) -> Metrics:
    """Figures for every sensor held out, and over all of them if there are several."""
    sensors = sensors_of(scene, config.held_out, "held out")
    real: list[Prediction] = []
    chance: list[Prediction] = []
    out: Metrics = {}
    for name, sensor in sensors.items():
        rows = bearings.take(bearings.sensor == name)
        if not len(rows):
            raise InputError(f"bearings: no row of the held-out sensor {name!r}; give bearings that include it")
        found, by_chance = _predict_sensor(sensor, rows, tracks, config)
        out |= _figures(found, by_chance, f"_sensor_{name}", config)
        real += found
        chance += by_chance
    return _figures(real, chance, "", config) | out


def _predict_sensor(
    sensor: Sensor, rows: Bearings, tracks: Tracks, config: EvaluateConfig
) -> tuple[list[Prediction], list[Prediction]]:
    """Predictions of every track in one sensor's frames, and the same with frames and predictions shifted in time."""
    real, chance = [], []
    for target, path in paths_of(tracks).items():
        mine = rows.take((rows.target_id == target) | (rows.target_id < 0))
        if not len(mine):
            continue
        frames = frames_of(mine)
        expected, usable = _expect(sensor, frames, path, config)
        real.append(_nearest(frames, expected, usable, 0))
        shifts = np.unique(np.rint(np.linspace(0.1, 0.9, SHIFTS) * len(frames.t_ns)).astype(int))
        chance += [_nearest(frames, expected, usable, s) for s in shifts.tolist() if 0 < s < len(frames.t_ns)]
    return real, chance


def frames_of(rows: Bearings) -> Frames:
    """Rows of one sensor, gathered by time."""
    times, frame = np.unique(rows.t_ns, return_inverse=True)
    seen = np.flatnonzero(rows.seen)
    count = np.bincount(frame[seen], minlength=len(times))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    slot = np.arange(len(seen)) - first[frame[seen]]
    shape = (len(times), max(1, int(count.max(initial=0))))
    bearing, u_px = np.full(shape, np.nan), np.full(shape, np.nan)
    bearing[frame[seen], slot], u_px[frame[seen], slot] = rows.bearing[seen], rows.u_px[seen]
    return Frames(times, bearing, u_px)


def _expect(sensor: Sensor, frames: Frames, path: Path, config: EvaluateConfig) -> tuple[Expected, Bools]:
    """What the sensor should report at each frame, and where the track says that the target is in view and clear."""
    xy, good = path.at(frames.t_ns, config.bridge_ns)
    expected = sensor.expect(xy, path.height_at(frames.t_ns, config.bridge_ns))
    return expected, good & expected.clear


def _nearest(frames: Frames, expected: Expected, usable: Bools, shift: int) -> Prediction:
    """Residual of the bearing nearest to the prediction in each usable frame; frame n + shift is paired with n."""
    bearing, u_px = (np.roll(a, -shift, axis=0)[usable] for a in (frames.bearing, frames.u_px))
    rad = wrap_angle(bearing - expected.bearing[usable][:, None])
    px = u_px - expected.u_px[usable][:, None]
    nearest = np.argmin(np.where(np.isnan(rad), np.inf, np.abs(rad)), axis=1)[:, None]
    return Prediction(np.take_along_axis(px, nearest, axis=1)[:, 0], np.take_along_axis(rad, nearest, axis=1)[:, 0])


def _figures(real: list[Prediction], chance: list[Prediction], whose: str, config: EvaluateConfig) -> Metrics:
    px, rad = _joined(real)
    chance_px, chance_rad = _joined(chance)
    near = np.abs(rad) <= config.held_out_gate
    within = px[near & np.isfinite(px)]
    px, chance_px = px[np.isfinite(px)], chance_px[np.isfinite(chance_px)]
    reported = rad[np.isfinite(rad)]
    by_chance = np.count_nonzero(np.abs(chance_rad) <= config.held_out_gate)
    return {
        f"held_out_frames{whose}": len(rad),
        f"held_out_reported{whose}": len(reported),
        f"held_out_share_within{whose}": ratio(int(np.count_nonzero(near)), len(rad)),
        f"held_out_share_within_chance{whose}": ratio(int(by_chance), len(chance_rad)),
        f"held_out_median{whose}_px": quantile(np.abs(px), 0.5),
        f"held_out_median_chance{whose}_px": quantile(np.abs(chance_px), 0.5),
        f"held_out_p95{whose}_px": quantile(np.abs(px), 0.95),
        f"held_out_rms{whose}_px": root_mean_square(px),
        f"held_out_rms_within{whose}_px": root_mean_square(within),
        f"held_out_bias{whose}_px": ratio(float(px.sum()), len(px)),
        f"held_out_median{whose}_mrad": 1e3 * quantile(np.abs(reported), 0.5),
        f"held_out_rms{whose}_mrad": 1e3 * root_mean_square(reported),
    }


def _joined(parts: list[Prediction]) -> tuple[Floats, Floats]:
    nothing = np.zeros(0)
    return np.concatenate([nothing, *(p.px for p in parts)]), np.concatenate([nothing, *(p.rad for p in parts)])

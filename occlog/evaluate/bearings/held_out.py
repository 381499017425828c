"""Leave one sensor out: how well tracks made without it predict what it saw.

The tracks must have been made without the sensor (`occlog track --without NAME`): then
its bearings are an independent test that needs no ground truth.  Labelled rows are
compared directly; of unlabelled candidates the nearest is taken, which flatters any
track where there are many.  So every figure is given once more with the sensor's
frames paired with predictions for other times: what chance, and a target that stays
about where it is, would give.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import ratio
from occlog.core.metrics.sums import Sum
from occlog.core.sight.camera import wrap_angle
from occlog.errors import InputError
from occlog.evaluate.errors.sums import quantiles_of
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import Path, Sensor, sensors_of
from occlog.io.files.put_aside.blocks import BLOCK, IN_MEMORY, Blocks
from occlog.io.files.put_aside.spool import Spool
from occlog.records.scene import Scene
from occlog.records.tables import Bearings

Metrics = dict[str, float]

SHIFTS = 16
"""Cyclic shifts in time, evenly spread between a tenth and nine tenths of the recording, that stand for chance."""


MOST_ASIDE = 64
"""Tracks times sensors whose frames are put aside, each in a file of its own; of more all are kept in memory."""
FRAME = np.dtype([("bearing", "f8"), ("u_px", "f8"), ("usable", "?"), ("first", "i8"), ("reported", "i8")])
"""What a track predicts of a frame, whether it can be seen there, and which bearings were reported."""
REPORTED = np.dtype([("bearing", "f8"), ("u_px", "f8")])


class Frames(NamedTuple):
    """Frames of one sensor with the bearings that each reported."""

    t_ns: Ints  # (N,)
    bearing: Floats  # (N, K) azimuths, NaN where there are fewer than K
    u_px: Floats  # (N, K)


class Prediction(NamedTuple):
    """Residuals of the nearest reported bearing, one a frame in which the target should be in view."""

    px: Floats  # (F,) reported minus predicted; NaN where the frame reported nothing, or not a camera
    rad: Floats  # (F,)


class HeldOutFigures:
    """Predictions of sensors that are held out: figures for each of them, and over all of them.

    Frames are put aside, since those that stand for chance are paired with predictions of other times.
    """

    def __init__(
        self,
        scene: Scene,
        targets: Sequence[int],
        config: EvaluateConfig,
        block: int = BLOCK,
        in_memory: int = IN_MEMORY,
    ) -> None:
        """Nothing came yet.

        Args:
            scene: the sensors.
            targets: identities of all tracks, ascending.
            config: which sensors are held out, gates, gaps that are bridged.
            block: frames that are worked on at once.
            in_memory: how many bytes, and how many residuals, are kept in memory.

        Raises:
            InputError: the scene has no such sensor.
        """
        self._config, self._targets, self._block = config, targets, block
        self._sensors = sensors_of(scene, config.held_out, "held out")
        self._rows = dict.fromkeys(self._sensors, 0)
        files = len(self._sensors) * len(targets)
        self._each = in_memory // (2 * files) if 0 < files <= MOST_ASIDE else sys.maxsize
        self._in_memory = in_memory
        self._aside: dict[tuple[str, int], _Aside] = {}

    def update(self, rows: Bearings, paths: Mapping[int, Path]) -> None:
        """The bearings of another stretch, and the tracks about it."""
        for name, sensor in self._sensors.items():
            own = rows.take(rows.sensor == name)
            self._rows[name] += len(own)
            for target in self._targets:
                mine = own.take((own.target_id == target) | (own.target_id < 0))
                if len(mine):
                    frames = frames_of(mine)
                    aside = self._aside.setdefault((name, target), _Aside(self._block, self._each))
                    aside.add(frames, *_expect(sensor, frames, paths.get(target), self._config))

    def result(self) -> Metrics:
        """All figures.

        Raises:
            InputError: no bearing is of a sensor that is held out.
        """
        whole, out = _Figures(self._config, self._in_memory), Metrics()
        for name in self._sensors:
            if not self._rows[name]:
                raise InputError(f"bearings: no row of the held-out sensor {name!r}; give bearings that include it")
            figures = _Figures(self._config, self._in_memory)
            for target in self._targets:
                aside = self._aside.get((name, target))
                for real, part in () if aside is None else aside.predictions():
                    for each in (figures, whole):
                        each.update(part, real=real)
            out |= figures.result(f"_sensor_{name}")
        return whole.result("") | out


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


def _expect(sensor: Sensor, frames: Frames, path: Path | None, config: EvaluateConfig) -> tuple[Floats, Floats, Bools]:
    """(N,) bearings and offsets that the sensor should report at each frame, and where the track says that it can."""
    if path is None:
        unknown = np.full(len(frames.t_ns), np.nan)
        return unknown, unknown, np.zeros(len(frames.t_ns), dtype=np.bool_)
    xy, good = path.at(frames.t_ns, config.bridge_ns)
    expected = sensor.expect(xy, path.height_at(frames.t_ns, config.bridge_ns))
    return expected.bearing, expected.u_px, good & expected.clear


class _Aside:
    """Frames of one sensor, and what one track predicts of them."""

    def __init__(self, block: int, in_memory: int) -> None:
        self._block = block
        self._frames, self._reported = Blocks(FRAME, block, in_memory), Blocks(REPORTED, block, in_memory)
        self._count = self._rows = 0

    def add(self, frames: Frames, bearing: Floats, u_px: Floats, usable: Bools) -> None:
        reported = np.isfinite(frames.bearing)
        rows = np.empty(int(reported.sum()), dtype=REPORTED)
        rows["bearing"], rows["u_px"] = frames.bearing[reported], frames.u_px[reported]
        out = np.empty(len(usable), dtype=FRAME)
        out["bearing"], out["u_px"], out["usable"], out["reported"] = bearing, u_px, usable, reported.sum(axis=1)
        out["first"] = self._rows + np.cumsum(out["reported"]) - out["reported"]
        self._frames.append(out)
        self._reported.append(rows)
        self._count, self._rows = self._count + len(out), self._rows + len(rows)

    def predictions(self) -> Iterator[tuple[bool, Prediction]]:
        """Residuals in every frame, in pieces, and those in frames of other times; whether they are the former."""
        for blocks in (self._frames, self._reported):
            blocks.end()
        shifts = np.unique(np.rint(np.linspace(0.1, 0.9, SHIFTS) * self._count).astype(int))
        for shift in (0, *(s for s in shifts.tolist() if 0 < s < self._count)):
            # Frame n + shift is paired with the prediction n; after the last frame comes the first one
            for begin, end, at in ((0, self._count - shift, shift), (self._count - shift, self._count, 0)):
                for start in range(begin, end, self._block):
                    stop = min(start + self._block, end)
                    yield shift == 0, self._nearest(start, stop, at + start - begin)

    def _nearest(self, start: int, stop: int, at: int) -> Prediction:
        """Residuals of the bearings of frames from `at` on that are nearest to the predictions of these."""
        own = self._frames.rows(start, stop)
        usable = own["usable"]
        own, theirs = own[usable], self._frames.rows(at, at + stop - start)[usable]
        if not len(own):
            return Prediction(np.zeros(0), np.zeros(0))
        rows = self._reported.rows(int(theirs["first"][0]), int(theirs["first"][-1] + theirs["reported"][-1]))
        slots = np.arange(max(1, int(theirs["reported"].max())))
        there = slots < theirs["reported"][:, None]
        place = np.where(there, theirs["first"][:, None] - theirs["first"][0] + slots, 0)
        rad, px = np.full(place.shape, np.nan), np.full(place.shape, np.nan)
        rad[there] = wrap_angle(
            rows["bearing"][place[there]] - np.broadcast_to(own["bearing"][:, None], place.shape)[there]
        )
        px[there] = rows["u_px"][place[there]] - np.broadcast_to(own["u_px"][:, None], place.shape)[there]
        nearest = np.argmin(np.where(np.isnan(rad), np.inf, np.abs(rad)), axis=1)[:, None]
        return Prediction(np.take_along_axis(px, nearest, axis=1)[:, 0], np.take_along_axis(rad, nearest, axis=1)[:, 0])


class _Figures:
    """Figures of residuals that come in parts."""

    def __init__(self, config: EvaluateConfig, in_memory: int) -> None:
        self._gate = config.held_out_gate
        self._px, self._rad, self._chance_px = (Spool(in_memory // 8) for _ in range(3))
        self._frames = self._near = self._within = self._chance = self._by_chance = 0
        self._squares, self._squares_within, self._sum, self._squares_rad = Sum(), Sum(), Sum(), Sum()

    def update(self, found: Prediction, *, real: bool) -> None:
        near = np.abs(found.rad) <= self._gate
        px = found.px[np.isfinite(found.px)]
        if not real:
            self._chance += len(found.rad)
            self._by_chance += int(np.count_nonzero(near))
            self._chance_px.add(np.abs(px))
            return
        reported, within = found.rad[np.isfinite(found.rad)], found.px[near & np.isfinite(found.px)]
        self._frames += len(found.rad)
        self._near += int(np.count_nonzero(near))
        self._within += len(within)
        self._px.add(np.abs(px))
        self._rad.add(np.abs(reported))
        self._squares.add(float(np.sum(px**2)))
        self._squares_within.add(float(np.sum(within**2)))
        self._squares_rad.add(float(np.sum(reported**2)))
        self._sum.add(float(px.sum()))

    def result(self, whose: str) -> Metrics:
        middle, high = quantiles_of(self._px, (0.5, 0.95))
        return {
            f"held_out_frames{whose}": self._frames,
            f"held_out_reported{whose}": self._rad.count,
            f"held_out_share_within{whose}": ratio(self._near, self._frames),
            f"held_out_share_within_chance{whose}": ratio(self._by_chance, self._chance),
            f"held_out_median{whose}_px": middle,
            f"held_out_median_chance{whose}_px": quantiles_of(self._chance_px, (0.5,))[0],
            f"held_out_p95{whose}_px": high,
            f"held_out_rms{whose}_px": _root(self._squares, self._px.count),
            f"held_out_rms_within{whose}_px": _root(self._squares_within, self._within),
            f"held_out_bias{whose}_px": ratio(self._sum.value, self._px.count),
            f"held_out_median{whose}_mrad": 1e3 * quantiles_of(self._rad, (0.5,))[0],
            f"held_out_rms{whose}_mrad": 1e3 * _root(self._squares_rad, self._rad.count),
        }


def _root(squares: Sum, count: int) -> float:
    return math.sqrt(squares.value / count) if count else math.nan

"""Evaluation by a held-out sensor: how well tracks made without it predict its measurements.

The tracks must have been made without the sensor (`occlog track --without NAME`): then its bearings are an independent
test that needs no ground truth. Labelled rows are compared directly; of unlabelled candidates the nearest is taken,
which flatters any track where there are many. So every figure is also computed with the sensor's frames paired with
predictions for other times, as a chance level. With tracks of all people, the boxes of a held-out camera are
compared with the boxes that the tracks predict.

The tracks must have been made without the camera (`occlog track --without NAME`).  At each of its frames every track
is expected in its image, where the middle of the person and the feet project to; boxes and tracks are paired one to
one.  A box that no track predicts is a person who is missed, or a false box; a track in the image without a box is
false, or hidden.  Figures are given once more with the camera's frames paired with tracks of other times.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.metrics.errors import Sum, pair_within, quantile, ratio_or_nan
from occlog.core.numerics.interpolate import interpolate_positions
from occlog.errors import InputError, abridged, option
from occlog.evaluate.errors.sums import quantiles_of
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import ObjectPath, SensorGeometry, sensors_of
from occlog.io.files.spill import RECORD_BYTES_IN_MEMORY, RECORDS_PER_BLOCK, Blocks, Spool
from occlog.records.declared.people import PeopleTracks
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Bearings, Boxes, Views
from occlog.settings import METRES

Metrics = dict[str, float]

CHANCE_SHIFTS = 16
"""Cyclic shifts in time, evenly spread between a tenth and nine tenths of the recording, that represent chance."""


MAX_SPILLED_SERIES = 64
"""Tracks times sensors with frames that are buffered on disk, each in its own file; of more all are kept in memory."""
FRAME = np.dtype([("bearing", "f8"), ("u_px", "f8"), ("usable", "?"), ("first", "i8"), ("reported", "i8")])
"""Predictions of a track in a frame, its visibility, and the reported bearings."""
REPORTED = np.dtype([("bearing", "f8"), ("u_px", "f8")])


class HeldOutFrames(NamedTuple):
    """Frames of one sensor with the bearings reported in each.

    `t_ns`: (N,) times [ns]; `bearing`: (N, K) azimuths [rad] and `u_px`: (N, K) horizontal pixel offsets, both NaN
    where a frame has fewer than K bearings.
    """

    t_ns: Ints  # (N,)
    bearing: Floats  # (N, K) azimuths, NaN where there are fewer than K
    u_px: Floats  # (N, K)


class HeldOutResiduals(NamedTuple):
    """Residuals of the nearest bearing in each of F frames in which the target should be in view.

    `px` and `rad`: (F,) reported minus predicted [px] and [rad]; NaN where the frame has no bearing, `px` also without
    pixels.
    """

    px: Floats  # (F,) reported minus predicted; NaN where the frame reported nothing, or not a camera
    rad: Floats  # (F,)


class HeldOutFigures:
    """Accumulates the residuals of held-out sensors, predicted by tracks that were made without them.

    Figures are for each sensor and over all of them, each with a chance level, for which frames are paired with
    predictions of other times. Therefore frames are buffered, in memory or on disk.
    """

    def __init__(
        self,
        scene: Scene,
        targets: Sequence[int],
        config: EvaluateConfig,
        block: int = RECORDS_PER_BLOCK,
        in_memory: int = RECORD_BYTES_IN_MEMORY,
    ) -> None:
        """Create empty statistics.

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
        self._each = in_memory // (2 * files) if 0 < files <= MAX_SPILLED_SERIES else sys.maxsize
        self._in_memory = in_memory
        self._aside: dict[tuple[str, int], _SpilledFrames] = {}

    def update(self, rows: Bearings, paths: Mapping[int, ObjectPath]) -> None:
        """Add the bearings of the next time interval.

        Args:
            rows: bearings of any sensors; those of held-out sensors are used, labelled or not.
            paths: tracks by identity, in that interval and a little around it.
        """
        for name, sensor in self._sensors.items():
            own = rows.take(rows.sensor == name)
            self._rows[name] += len(own)
            for target in self._targets:
                mine = own.take((own.target_id == target) | (own.target_id < 0))
                if len(mine):
                    frames = frames_of(mine)
                    aside = self._aside.setdefault((name, target), _SpilledFrames(self._block, self._each))
                    aside.add(frames, *_expect(sensor, frames, paths.get(target), self._config))

    def result(self) -> Metrics:
        """Return all figures by name.

        Raises:
            InputError: no bearing is of a sensor that is held out.
        """
        whole, out = _Figures(self._config, self._in_memory), Metrics()
        for name in self._sensors:
            if not self._rows[name]:
                raise InputError(
                    f"bearings: no row of the held-out sensor {name!r}; give bearings that include it", id="empty-input"
                )
            figures = _Figures(self._config, self._in_memory)
            for target in self._targets:
                aside = self._aside.get((name, target))
                for real, part in () if aside is None else aside.predictions():
                    for each in (figures, whole):
                        each.update(part, real=real)
            out |= figures.result(f"_sensor_{name}")
        return whole.result("") | out


def frames_of(rows: Bearings) -> HeldOutFrames:
    """Return the detections of one sensor grouped by time: arrays (F, M) for F frames with up to M each, NaN-padded."""
    times, frame = np.unique(rows.t_ns, return_inverse=True)
    seen = np.flatnonzero(rows.seen)
    count = np.bincount(frame[seen], minlength=len(times))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    slot = np.arange(len(seen)) - first[frame[seen]]
    shape = (len(times), max(1, int(count.max(initial=0))))
    bearing, u_px = np.full(shape, np.nan), np.full(shape, np.nan)
    bearing[frame[seen], slot], u_px[frame[seen], slot] = rows.bearing[seen], rows.u_px[seen]
    return HeldOutFrames(times, bearing, u_px)


def _expect(
    sensor: SensorGeometry, frames: HeldOutFrames, path: ObjectPath | None, config: EvaluateConfig
) -> tuple[Floats, Floats, Bools]:
    """Predict what a sensor measures of a track at each of N frames.

    Args:
        sensor: the held-out sensor.
        frames: its frames.
        path: the track; None: it has no rows nearby.
        config: largest gap in time that is interpolated.

    Returns:
        Azimuths (N,) [rad], horizontal pixel offsets (N,), NaN if unknown, and a mask (N,): the target should be in
            view.
    """
    if path is None:
        unknown = np.full(len(frames.t_ns), np.nan)
        return unknown, unknown, np.zeros(len(frames.t_ns), dtype=np.bool_)
    xy, good = path.at(frames.t_ns, config.bridge_ns)
    expected = sensor.expect(xy, path.height_at(frames.t_ns, config.bridge_ns))
    return expected.bearing, expected.u_px, good & expected.clear


class _SpilledFrames:
    """Frames of one sensor with the predictions from one track, buffered in memory or on disk."""

    def __init__(self, block: int, in_memory: int) -> None:
        self._block = block
        self._frames, self._reported = Blocks(FRAME, block, in_memory), Blocks(REPORTED, block, in_memory)
        self._count = self._rows = 0

    def add(self, frames: HeldOutFrames, bearing: Floats, u_px: Floats, usable: Bools) -> None:
        reported = np.isfinite(frames.bearing)
        rows = np.empty(int(reported.sum()), dtype=REPORTED)
        rows["bearing"], rows["u_px"] = frames.bearing[reported], frames.u_px[reported]
        out = np.empty(len(usable), dtype=FRAME)
        out["bearing"], out["u_px"], out["usable"], out["reported"] = bearing, u_px, usable, reported.sum(axis=1)
        out["first"] = self._rows + np.cumsum(out["reported"]) - out["reported"]
        self._frames.append(out)
        self._reported.append(rows)
        self._count, self._rows = self._count + len(out), self._rows + len(rows)

    def predictions(self) -> Iterator[tuple[bool, HeldOutResiduals]]:
        """Generate residuals of the nearest bearings, part by part.

        Each comes with a flag: True for predictions of the frames' own times, False for those of other times (cyclic
        shifts), which give the chance level.
        """
        for blocks in (self._frames, self._reported):
            blocks.end()
        shifts = np.unique(np.rint(np.linspace(0.1, 0.9, CHANCE_SHIFTS) * self._count).astype(int))
        for shift in (0, *(s for s in shifts.tolist() if 0 < s < self._count)):
            # Frame n + shift is paired with the prediction n; after the last frame comes the first one
            for begin, end, at in ((0, self._count - shift, shift), (self._count - shift, self._count, 0)):
                for start in range(begin, end, self._block):
                    stop = min(start + self._block, end)
                    yield shift == 0, self._nearest(start, stop, at + start - begin)

    def _nearest(self, start: int, stop: int, at: int) -> HeldOutResiduals:
        """Return the residuals of the bearings that are nearest to the predictions for frames `start` to `stop`.

        Bearings are taken from as many frames from index `at` on; with `at` equal to `start` they are those of the same
        frames.
        """
        own = self._frames.rows(start, stop)
        usable = own["usable"]
        own, theirs = own[usable], self._frames.rows(at, at + stop - start)[usable]
        if not len(own):
            return HeldOutResiduals(np.zeros(0), np.zeros(0))
        rows = self._reported.rows(int(theirs["first"][0]), int(theirs["first"][-1] + theirs["reported"][-1]))
        slots = np.arange(max(1, int(theirs["reported"].max())))
        there = slots < theirs["reported"][:, None]
        index = np.where(there, theirs["first"][:, None] - theirs["first"][0] + slots, 0)
        rad, px = np.full(index.shape, np.nan), np.full(index.shape, np.nan)
        rad[there] = wrap_angle(
            rows["bearing"][index[there]] - np.broadcast_to(own["bearing"][:, None], index.shape)[there]
        )
        px[there] = rows["u_px"][index[there]] - np.broadcast_to(own["u_px"][:, None], index.shape)[there]
        nearest = np.argmin(np.where(np.isnan(rad), np.inf, np.abs(rad)), axis=1)[:, None]
        return HeldOutResiduals(
            np.take_along_axis(px, nearest, axis=1)[:, 0], np.take_along_axis(rad, nearest, axis=1)[:, 0]
        )


class _Figures:
    """Accumulated residuals [rad, px] of held-out sensors, and those of predictions of other times (chance level)."""

    def __init__(self, config: EvaluateConfig, in_memory: int) -> None:
        self._gate = config.held_out_gate
        self._px, self._rad, self._chance_px = (Spool(in_memory // 8) for _ in range(3))
        self._frames = self._near = self._within = self._chance = self._by_chance = 0
        self._squares, self._squares_within, self._sum, self._squares_rad = Sum(), Sum(), Sum(), Sum()

    def update(self, found: HeldOutResiduals, *, real: bool) -> None:
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

    def result(self, suffix: str) -> Metrics:
        middle, high = quantiles_of(self._px, (0.5, 0.95))
        return {
            f"held_out_frames{suffix}": self._frames,
            f"held_out_reported{suffix}": self._rad.count,
            f"held_out_share_within{suffix}": ratio_or_nan(self._near, self._frames),
            f"held_out_share_within_chance{suffix}": ratio_or_nan(self._by_chance, self._chance),
            f"held_out_median{suffix}_px": middle,
            f"held_out_median_chance{suffix}_px": quantiles_of(self._chance_px, (0.5,))[0],
            f"held_out_p95{suffix}_px": high,
            f"held_out_rms{suffix}_px": _root(self._squares, self._px.count),
            f"held_out_rms_within{suffix}_px": _root(self._squares_within, self._within),
            f"held_out_bias{suffix}_px": ratio_or_nan(self._sum.value, self._px.count),
            f"held_out_median{suffix}_mrad": 1e3 * quantiles_of(self._rad, (0.5,))[0],
            f"held_out_rms{suffix}_mrad": 1e3 * _root(self._squares_rad, self._rad.count),
        }


def _root(squares: Sum, count: int) -> float:
    return math.sqrt(squares.value / count) if count else math.nan


HEIGHT = 1.7
"""Height of people with a track that has none [m]."""


class BoxFrames(NamedTuple):
    """Boxes of one camera, sorted by frame: those of frame k have the indices start[k] to start[k + 1].

    `t_ns`: (F,) increasing times of the frames [ns]; `start`: (F + 1,); `middle` and `feet`: (n, 2) pixels of the
    centre and of the middle of the lower edge of each of the n boxes.
    """

    t_ns: Ints  # (F,) times of the frames, ascending
    start: Ints  # (F + 1,) first box of each frame
    middle: Floats  # (n, 2) middle of each box [px]
    feet: Floats  # (n, 2) middle of its lower edge [px]


class Walker(NamedTuple):
    """One track: times (M,) [ns] and states (M, 3): x, y and body height, in the scene's unit of length."""

    t_ns: Ints
    state: Floats  # (M, 3) x, y, height


class HeldOutTally(NamedTuple):
    """Result of pairing boxes with projected tracks, summed over the frames of a camera.

    `boxes`: number of boxes; `middles` and `feet`: distances [px] of the pairs between box centres, and between lower
    edges of boxes, and the projections; `expected`: number of projections in the image.
    """

    boxes: int
    middles: Floats
    feet: Floats
    expected: int


def held_out_box_metrics(tracks: PeopleTracks, boxes: Boxes | Views, scene: Scene, config: EvaluateConfig) -> Metrics:
    """Compare the boxes of held-out cameras with the projections of tracks that were made without these cameras.

    Returns figures over all held-out cameras, and of each if there are several (suffix `_sensor_NAME`):
    `held_out_boxes_share`: share of boxes with a centre that is predicted within `held_out_gate_px`;
    `held_out_boxes_feet_share`: with a lower edge that is; `held_out_boxes_precision`: share of the projections in the
    image that predict a box; `held_out_boxes_median_px`: median distance of the pairs; `held_out_boxes_share_chance`:
    share with predictions of other times. InputError for a camera without boxes or without a pose.
    """
    cameras = {camera.name: camera for camera in scene.cameras if camera.placed}
    height = HEIGHT / METRES.get(scene.length_unit, 1.0)
    walkers = _walkers(tracks, height)
    real: list[HeldOutTally] = []
    chance: list[HeldOutTally] = []
    out: Metrics = {}
    for name in config.held_out:
        if name not in cameras:
            raise InputError(
                f"{option('held_out')} {name}: no camera of this name with a pose is in the scene; it has: "
                f"{abridged(cameras)}",
                id="unknown-sensor",
            )
        frames = frames_of_boxes(boxes, name)
        if not len(frames.t_ns):
            raise InputError(
                f"{option('views')}: no row of the held-out camera {name!r}; give boxes that include it",
                id="empty-input",
            )
        own = tally(cameras[name], frames, walkers, config, 0)
        steps = np.unique(np.rint(np.linspace(0.1, 0.9, CHANCE_SHIFTS) * len(frames.t_ns)).astype(int)).tolist()
        other = [tally(cameras[name], frames, walkers, config, s) for s in steps if 0 < s < len(frames.t_ns)]
        out |= _figures([own], other, f"_sensor_{name}")
        real.append(own)
        chance += other
    return _figures(real, chance, "") | (out if len(config.held_out) > 1 else {})


def frames_of_boxes(boxes: Boxes | Views, camera: str) -> BoxFrames:
    """Return the boxes of one camera by frame. Times of rows without a box are frames, too."""
    rows = boxes.take(boxes.sensor == camera)
    times = np.unique(rows.t_ns)
    if isinstance(rows, Boxes):
        rows = rows.take(rows.box >= 0)
    rows = rows.take(np.argsort(rows.t_ns, kind="stable"))
    across = rows.left_px + 0.5 * rows.width_px
    low = rows.top_px + rows.height_px
    return BoxFrames(
        t_ns=times,
        start=np.append(np.searchsorted(rows.t_ns, times), len(rows)),
        middle=np.column_stack([across, rows.top_px + 0.5 * rows.height_px]),
        feet=np.column_stack([across, low]),
    )


def _walkers(tracks: PeopleTracks, height: float) -> list[Walker]:
    """Return every track with the person's height.

    `height`: used where a track has none; in the scene's unit of length.
    """
    out = []
    for label in np.unique(tracks.target_id).tolist():
        own = tracks.take(tracks.target_id == label)
        tall = np.where(np.isfinite(own.height), own.height, height)
        out.append(Walker(own.t_ns, np.column_stack([own.x, own.y, tall])))
    return out


def tally(camera: Camera, frames: BoxFrames, walkers: list[Walker], config: EvaluateConfig, shift: int) -> HeldOutTally:
    """Pair the boxes of each frame one to one with the tracks, projected at the frame `shift` frames later.

    Args:
        camera: the held-out camera.
        frames: its boxes.
        walkers: tracks with heights.
        config: gate [px] of a pair, and largest gap of a track that is interpolated.
        shift: number of frames, cyclic; 0 gives true pairs, others give pairs by chance.
    """
    times = np.roll(frames.t_ns, -shift)
    states = [interpolate_positions(times, w.t_ns, w.state, config.bridge_ns)[0] for w in walkers]
    # (F, K, 3) position of each track at each time, NaN where it is not
    state = np.stack(states, axis=1) if states else np.full((len(times), 0, 3), np.nan)
    middle = project(camera, state, 0.5)
    feet = project(camera, state, 0.0)
    middles: list[float] = []
    below: list[float] = []
    inside = 0
    for f in range(len(times)):
        rows = slice(int(frames.start[f]), int(frames.start[f + 1]))
        seen = _in_image(camera, middle[f])
        inside += int(np.count_nonzero(seen))
        for found, box, expected in ((middles, frames.middle[rows], middle[f]), (below, frames.feet[rows], feet[f])):
            away = np.hypot(*np.moveaxis(box[:, None] - expected[None, seen], 2, 0))
            found += [float(away[i, j]) for i, j in pair_within(away, config.held_out_gate_px)]
    return HeldOutTally(int(frames.start[-1]), np.array(middles), np.array(below), inside)


def project(camera: Camera, state: Floats, share: float) -> Floats:
    """Project a point of each of K people at F times into the image; return pixels (F, K, 2), NaN where unknown.

    Args:
        camera: the camera.
        state: (F, K, 3) x, y and height of each person in the world; NaN: absent.
        share: height of the point over that of the person, 0 (feet) to 1.
    """
    flat = state.reshape(-1, 3)
    out = np.full((len(flat), 2), np.nan)
    known = np.isfinite(flat).all(axis=1)
    out[known] = camera.project(flat[known] * [1.0, 1.0, share])
    return out.reshape(*state.shape[:2], 2)


def _in_image(camera: Camera, pixels: Floats) -> Bools:
    """Return the mask (K,) of the `pixels` (K, 2) that are in the image; without an image size, of those not NaN."""
    known: Bools = np.isfinite(pixels[:, 0]) & np.isfinite(pixels[:, 1])
    if camera.image_size is None:
        return known
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0.0) & (pixels < camera.image_size)
    return known & inside[:, 0] & inside[:, 1]


def _figures(real: list[HeldOutTally], chance: list[HeldOutTally], suffix: str) -> Metrics:
    """Return the figures of held-out cameras by name.

    Args:
        real: pairs of boxes and projections of equal times, of each camera.
        chance: pairs with projections of other times.
        suffix: ending of the names.
    """
    boxes, middles = sum(t.boxes for t in real), np.concatenate([np.zeros(0), *(t.middles for t in real)])
    feet = sum(len(t.feet) for t in real)
    other, met = sum(t.boxes for t in chance), sum(len(t.middles) for t in chance)
    return {
        f"held_out_boxes{suffix}": boxes,
        f"held_out_boxes_share{suffix}": ratio_or_nan(len(middles), boxes),
        f"held_out_boxes_share_chance{suffix}": ratio_or_nan(met, other),
        f"held_out_boxes_feet_share{suffix}": ratio_or_nan(feet, boxes),
        f"held_out_boxes_precision{suffix}": ratio_or_nan(len(middles), sum(t.expected for t in real)),
        f"held_out_boxes_median{suffix}_px": quantile(middles, 0.5),
    }

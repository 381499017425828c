"""Evaluation of bearings, views and directions of arrival against truth.

Bearings against true positions: detections, misses, false alarms, bearing errors.

Views (regions or detector boxes) against true boxes: recall, precision, horizontal error. True boxes have three
classes: `clear`, with hardly any overlap with another box; `front`, in front of others; `hidden`, partly behind others.
Of two boxes the one that reaches further down in the image is nearer, since people stand on the ground.

Directions of arrival against true ones: unordered sets with optimal assignment.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Bools, Floats, Ints
from occlog.console.text import in_seconds
from occlog.core.metrics.errors import Sum, intersection_areas, intersection_over_union, pair_within, ratio_or_nan
from occlog.errors import InputError
from occlog.evaluate.errors.sums import quantiles_of
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.observations import SensorObservationSet, observe
from occlog.evaluate.matching.paths import paths_of, sensors_of
from occlog.io.files.spill import NUMBERS_IN_MEMORY, Spool
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Doa, Truth, TruthBoxes, Views

Metrics = dict[str, float]


@dataclass(frozen=True)
class DetectionCounts:
    """Counts and sums over one sensor's frames with known true positions; counts of several sensors may be added.

    Attributes:
        frames: number of frames of the sensor.
        n_frames: number of pairs of a frame and a target.
        visible: pairs in which the target is in view and not occluded.
        detected: of these, pairs with a bearing within the gate.
        detected_hidden: pairs with a bearing within the gate although the target is out of view or occluded.
        false_alarms: bearings of no true object, or of a target but outside its gate.
        correct_rejections: pairs in which the target is hidden and nothing is reported.
        without_truth: pairs with unknown true position; they are in no other count.
        n_px, sum_px, square_px: number, sum and sum of squares of the residuals [px] of visible targets within the
            gate.
        square_rad: sum of squares of these residuals in rad.
        square_normalised: sum of squares of these residuals over their standard deviations.
        n_elevation: number of elevations of visible targets within the gate.
        square_elevation, square_elevation_normalised: sums of squares of their residuals, in rad and normalised.
    """

    frames: int = 0  # of a sensor
    n_frames: int = 0  # frame and target
    visible: int = 0  # observations in which the target should have been seen
    detected: int = 0  # of these, with a bearing within the gate
    detected_hidden: int = 0  # a bearing within the gate although the target should have been hidden
    false_alarms: int = 0  # bearings that are of no true object, or of the target but away from it
    correct_rejections: int = 0  # hidden, and nothing reported
    without_truth: int = 0  # observations with unknown truth; in no other count
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
        """Observations of a visible target without a bearing within the gate."""
        return self.visible - self.detected


def count(found: SensorObservationSet) -> DetectionCounts:
    """Return counts and sums of squared residuals of one sensor, over its observations with a known true position."""
    observations = found.observations.take(found.observations.truth)
    good = observations.visible & observations.hit
    up = good & np.isfinite(observations.residual_elevation)
    px = observations.residual_px[good & np.isfinite(observations.residual_px)]
    away = observations.reported & ~observations.hit
    return DetectionCounts(
        frames=found.frames,
        n_frames=len(observations.t_ns),
        visible=int(np.count_nonzero(observations.visible)),
        detected=int(np.count_nonzero(good)),
        detected_hidden=int(np.count_nonzero(observations.hit & ~observations.visible)),
        false_alarms=int(np.count_nonzero(away)) + found.stray,
        correct_rejections=int(np.count_nonzero(~observations.visible & ~observations.reported)),
        without_truth=int(np.count_nonzero(~found.observations.truth)),
        n_px=len(px),
        sum_px=float(px.sum()),
        square_px=float(np.sum(px**2)),
        square_rad=float(np.sum(observations.residual[good] ** 2)),
        square_normalised=float(np.sum(observations.normalised[good] ** 2)),
        n_elevation=int(np.count_nonzero(up)),
        square_elevation=float(np.sum(observations.residual_elevation[up] ** 2)),
        square_elevation_normalised=float(np.sum(observations.normalised_elevation[up] ** 2)),
    )


def observations_of(
    bearings: Bearings, truth: Truth, scene: Scene, pairs: Mapping[int, int], config: EvaluateConfig
) -> dict[str, SensorObservationSet]:
    """Compare the bearings of every sensor with the truth; return the observations by name of the sensor.

    Args:
        bearings: labelled or not.
        truth: targets and moving occluders.
        scene: sensors, walls.
        pairs: identity in the bearings to identity in the truth; rows of other identities are skipped.
        config: gates, limits.
    """
    targets, others = paths_of(truth, "target"), paths_of(truth, "occluder")
    sensors = sensors_of(scene, np.unique(bearings.sensor).tolist())
    return {
        name: observe(sensor, bearings.take(bearings.sensor == name), pairs, targets, others, config)
        for name, sensor in sensors.items()
    }


class DetectionFigures:
    """Accumulates detection counts over a stream of observations."""

    def __init__(self) -> None:
        """Create figures without sensors and observations."""
        self._sensors: dict[str, dict[str, Sum]] = {}

    def update(self, observations: Mapping[str, SensorObservationSet]) -> None:
        """Add the observations of further frames to the counts.

        `observations`: by name of the sensor.
        """
        for name, found in observations.items():
            own = self._sensors.setdefault(name, {f.name: Sum() for f in fields(DetectionCounts)})
            part = count(found)
            for f in fields(DetectionCounts):
                own[f.name].add(float(getattr(part, f.name)))

    def result(self) -> Metrics:
        """Return rates, counts and residuals by name of the figure.

        They are over all sensors together (from the added counts), then of each sensor, with the suffix `_sensor_NAME`.
        """
        counts = {name: _counts(own) for name, own in sorted(self._sensors.items())}
        out = _figures(add_counts(counts.values()), "")
        for name, part in counts.items():
            out |= _figures(part, f"_sensor_{name}")
        return out


def _counts(sums: Mapping[str, Sum]) -> DetectionCounts:
    """Return the accumulated sums of one sensor, by name of the field, as `DetectionCounts`.

    Integer fields are converted.
    """
    whole = {f.name: isinstance(f.default, int) for f in fields(DetectionCounts)}
    return DetectionCounts(**{name: int(s.value) if whole[name] else s.value for name, s in sums.items()})  # type: ignore[arg-type]


def add_counts(parts: Iterable[DetectionCounts]) -> DetectionCounts:
    """Return the sum of the counts of several parts or sensors."""
    rows = list(parts)
    return DetectionCounts(**{f.name: sum(getattr(c, f.name) for c in rows) for f in fields(DetectionCounts)})


def _figures(c: DetectionCounts, suffix: str) -> Metrics:
    of_elevations = {
        f"elevation_rms{suffix}_mrad": 1e3 * math.sqrt(ratio_or_nan(c.square_elevation, c.n_elevation)),
        f"elevation_nis{suffix}": ratio_or_nan(c.square_elevation_normalised, c.n_elevation),
    }
    return (of_elevations if c.n_elevation else {}) | {
        f"detection_frames{suffix}": c.frames,
        f"detection_opportunities{suffix}": c.n_frames,
        f"detection_opportunities_without_truth{suffix}": c.without_truth,
        f"visible{suffix}": c.visible,
        f"detected{suffix}": c.detected,
        f"missed{suffix}": c.missed,
        f"detected_hidden{suffix}": c.detected_hidden,
        f"correct_rejections{suffix}": c.correct_rejections,
        f"false_alarms{suffix}": c.false_alarms,
        f"false_alarms_per_frame{suffix}": ratio_or_nan(c.false_alarms, c.frames),
        f"detection_rate{suffix}": ratio_or_nan(c.detected, c.visible),
        f"bearing_rms{suffix}_px": math.sqrt(ratio_or_nan(c.square_px, c.n_px)),
        f"bearing_bias{suffix}_px": ratio_or_nan(c.sum_px, c.n_px),
        f"bearing_rms{suffix}_mrad": 1e3 * math.sqrt(ratio_or_nan(c.square_rad, c.detected)),
        f"bearing_nis{suffix}": ratio_or_nan(c.square_normalised, c.detected),
    }


CLEAR, FRONT, HIDDEN = 0, 1, 2
CLASSES = ("clear", "front", "hidden")
SHARED = 0.1
"""Share of a box's area that another must cover before the box counts as overlapped or hidden."""


class FrameResult(NamedTuple):
    """True boxes of one frame of a camera after pairing with the views (detected silhouettes).

    `kind`: (n,) class of each true box, `CLEAR`, `FRONT` or `HIDDEN`; `error_px`: (n,) horizontal centre of the paired
    view minus that of the true box [px], positive to the right, NaN if none is paired; `found`: (n,) mask of paired
    boxes; `views`: number of views in the frame.
    """

    kind: Ints  # (n,)
    error_px: Floats  # (n,) view minus truth, to the right
    found: Bools  # (n,)
    views: int


def box_classes(boxes: Floats) -> Ints:
    """Return the class (n,) of each true box (n, 4: left, top, width, height) of one frame.

    `HIDDEN` if a nearer box (with its bottom edge lower in the image) covers more than `SHARED` of it, `FRONT` if
    another box does, else `CLEAR`.
    """
    area = np.prod(boxes[:, 2:], axis=1)
    cover = intersection_areas(boxes, boxes) / area[:, None]  # [i, j]: share of i that j covers
    np.fill_diagonal(cover, 0.0)
    bottom = boxes[:, 1] + boxes[:, 3]
    nearer = bottom[None, :] > bottom[:, None]
    hidden = np.max(np.where(nearer, cover, 0.0), axis=1, initial=0.0) > SHARED
    touched = np.max(cover, axis=1, initial=0.0) > SHARED
    return np.asarray(np.where(hidden, HIDDEN, np.where(touched, FRONT, CLEAR)), dtype=np.int64)


def match_frame(views: Views, truth: TruthBoxes, min_overlap: float) -> FrameResult:
    """Pair the views (silhouettes) of one frame one to one with its true boxes, as many as overlap enough.

    Args:
        views: silhouettes in one frame of one camera.
        truth: true boxes of that frame; rows without a box are skipped.
        min_overlap: minimum intersection over union of a pair, 0 to 1.

    Returns:
        Occlusion class, horizontal error [px] (NaN: not detected) and detection mask of each true box; number of views.
    """
    real = truth.take(truth.box >= 0)
    boxes = _boxes(real)
    pairs = pair_within(1.0 - intersection_over_union(_boxes(views), boxes), 1.0 - min_overlap)
    error = np.full(len(real), np.nan)
    for i, j in pairs:
        error[j] = views.x_px[i] - (boxes[j, 0] + 0.5 * boxes[j, 2])
    return FrameResult(box_classes(boxes), error, np.isfinite(error), len(views))


def _boxes(table: Views | TruthBoxes) -> Floats:
    return np.column_stack([table.left_px, table.top_px, table.width_px, table.height_px])


def _frames(table: Views | TruthBoxes) -> Iterator[tuple[tuple[str, int], Ints]]:
    """Generate (sensor, time [ns]) of every frame of a table, sorted, with the indices (n,) of its rows."""
    order = np.lexsort((table.t_ns, table.sensor))
    t_ns, sensor = table.t_ns[order], table.sensor[order]
    change = (t_ns[1:] != t_ns[:-1]) | (sensor[1:] != sensor[:-1])
    for rows in np.split(order, np.flatnonzero(change) + 1):
        if not len(rows):
            continue
        yield (str(table.sensor[rows[0]]), int(table.t_ns[rows[0]])), rows


class RegionFigures:
    """Accumulates recall, precision and errors of views, over frames with true boxes or known to have none.

    Frames are matched by sensor and time.
    """

    def __init__(self, config: EvaluateConfig, in_memory: int = NUMBERS_IN_MEMORY // 8) -> None:
        """Start without frames; up to `in_memory` errors of each kind stay in memory."""
        self._overlap, self._in_memory = config.iou_threshold, in_memory
        self._whole = _Results(in_memory)
        self._classes = [_Results(in_memory) for _ in CLASSES]
        self._sensors: dict[str, _Results] = {}
        self._used = self._shared = self._views = 0
        self._first_view: tuple[str, int] | None = None
        self._first_box: tuple[str, int] | None = None

    def update(self, views: Views, truth: TruthBoxes) -> None:
        """Pair the views with the true boxes of equal sensor and time, frame by frame, and add counts and errors.

        Views of frames without true boxes are only counted. A frame must not be divided between two calls.
        """
        self._first_view = self._first_view or _first(views)
        self._first_box = self._first_box or _first(truth)
        by_frame = dict(_frames(views))
        self._views += len(views)
        for (sensor, t), rows in _frames(truth):
            mine = by_frame.get((sensor, t), np.zeros(0, dtype=np.int64))
            self._shared += (sensor, t) in by_frame
            self._used += len(mine)
            result = match_frame(views.take(mine), truth.take(rows), self._overlap)
            self._whole.update(result, result.found)
            for number, own in enumerate(self._classes):
                own.update(result, result.found & (result.kind == number), int(np.count_nonzero(result.kind == number)))
            self._sensors.setdefault(sensor, _Results(self._in_memory)).update(result, result.found)

    def result(self) -> Metrics:
        """Return recall, precision and errors by name: over all sensors, for each class of true boxes, for each sensor.

        Raises:
            InputError: both tables have rows, and no frame is in both.
        """
        view, box = self._first_view, self._first_box
        if view is not None and box is not None and not self._shared:
            raise InputError(
                f"views: no frame of theirs (first: {view[0]} at {in_seconds(view[1])} s) has true boxes (first: "
                f"{box[0]} at {in_seconds(box[1])} s); use equal times and sensor names",
                id="disjoint-inputs",
            )
        out = self._whole.figures("") | {"views_without_truth": self._views - self._used}
        for own, name in zip(self._classes, CLASSES, strict=True):
            out |= own.figures_of_class(name)
        if len(self._sensors) > 1:
            for sensor, own in sorted(self._sensors.items()):
                out |= own.figures(f"_sensor_{sensor}")
        return out


def _first(table: Views | TruthBoxes) -> tuple[str, int] | None:
    """Return sensor and time [ns] of the first row of a table; None if the table is empty."""
    return (str(table.sensor[0]), int(table.t_ns[0])) if len(table) else None


class _Results:
    """Accumulated counts of frames, true boxes, views and detections, and horizontal errors of the detections [px].

    Up to `in_memory` absolute errors stay in memory for the median; more go to a temporary file.
    """

    def __init__(self, in_memory: int) -> None:
        self._frames = self._boxes = self._found = 0
        self._views = 0
        self._sum, self._squares, self._sizes = Sum(), Sum(), Spool(in_memory)

    def update(self, result: FrameResult, found: Bools, boxes: int | None = None) -> None:
        """Add one frame of n true boxes.

        `found`: (n,) mask of the detected boxes that count; `boxes`: number of true boxes that count, None: n.
        """
        errors = result.error_px[found]
        self._frames, self._views = self._frames + 1, self._views + result.views
        self._boxes += len(result.kind) if boxes is None else boxes
        self._found += len(errors)
        self._sum.add(float(errors.sum()))
        self._squares.add(float(np.square(errors).sum()))
        self._sizes.add(np.abs(errors))

    def figures(self, suffix: str) -> Metrics:
        return {
            f"views_frames{suffix}": self._frames,
            f"views_true_boxes{suffix}": self._boxes,
            f"views_matched{suffix}": self._found,
            f"views_false{suffix}": self._views - self._found,
            f"views_recall{suffix}": ratio_or_nan(self._found, self._boxes),
            f"views_precision{suffix}": ratio_or_nan(self._found, self._views),
            **self._errors(suffix),
        }

    def figures_of_class(self, name: str) -> Metrics:
        return {
            f"views_true_boxes_{name}": self._boxes,
            f"views_recall_{name}": ratio_or_nan(self._found, self._boxes),
            **self._errors(f"_{name}"),
        }

    def _errors(self, suffix: str) -> Metrics:
        return {
            f"views_error_rms{suffix}_px": math.sqrt(ratio_or_nan(self._squares.value, self._found)),
            f"views_error_median{suffix}_px": quantiles_of(self._sizes, (0.5,))[0],
            f"views_error_bias{suffix}_px": ratio_or_nan(self._sum.value, self._found),
        }


class Pairing(NamedTuple):
    """Result of pairing the directions of one time with the true ones.

    Attributes:
        true: number of true directions.
        found: number of reported directions.
        errors: (k,) reported minus true direction of each pair [rad], wrapped.
    """

    true: int  # number of true directions
    found: int
    errors: Floats  # (k,) estimate minus truth of the pairs [rad], wrapped


def doa_metrics(found: Doa, truth: Doa, gate: float, gap_ns: int) -> dict[str, float]:
    """Return figures of directions of arrival over all sets and by number of true directions; angles in degrees.

    A set is all azimuths of one sensor at one time. In each set estimates and true azimuths are paired one to one by
    the least sum of 1 - cos(error): unlike the sum of absolute errors, which has several minima if an estimate is far
    off, it has a unique minimum, whatever the order of the rows.

    Args:
        found: estimated azimuths, any number per sensor and time.
        truth: true azimuths; a set is compared with the nearest one in time of its sensor.
        gate: pairs further apart [rad] count as a missed and a false direction; their errors are still counted.
        gap_ns: largest difference in time between a set and its truth [ns]; other sets are not compared.
    """
    pairs, without = [], 0
    for sensor in np.unique(np.concatenate([found.sensor, truth.sensor])).tolist():
        own, true = found.take(found.sensor == sensor), truth.take(truth.sensor == sensor)
        for pairing in _sets(own, true, gap_ns):
            if pairing is None:
                without += 1
            else:
                pairs.append(pairing)
    errors = _errors(pairs)
    out = {
        "doa_sets": len(pairs),
        "doa_sets_without_truth": without,
        **_azimuth_counts(pairs, gate),
        **_spread(errors, gate),
    }
    for n in sorted({p.true for p in pairs}):
        some = _errors([p for p in pairs if p.true == n])
        out[f"doa_of_{n}_pairs"] = len(some)
        out |= {f"doa_of_{n}_{name}": value for name, value in _quantiles(some).items()}
    return out


def _sets(found: Doa, truth: Doa, gap_ns: int) -> Iterator[Pairing | None]:
    """Generate the pairing of each set of azimuths of one sensor with the truth, by time; None without a truth.

    Then follow the true sets that no set was paired with, as pairings without estimates.

    Args:
        found: estimated azimuths; rows of one time are a set.
        truth: true azimuths; rows of one time are a set.
        gap_ns: largest difference in time of a set and its truth [ns].
    """
    times = np.unique(truth.t_ns)
    used: Bools = np.zeros(len(times), dtype=np.bool_)
    for t_ns in np.unique(found.t_ns).tolist():
        nearest = int(np.argmin(np.abs(times - t_ns))) if len(times) else -1
        if nearest < 0 or abs(int(times[nearest]) - t_ns) > gap_ns:
            yield None
            continue
        used[nearest] = True
        yield paired(found.azimuth[found.t_ns == t_ns], truth.azimuth[truth.t_ns == times[nearest]])
    for t_ns in times[~used].tolist():
        yield Pairing(int((truth.t_ns == t_ns).sum()), 0, np.empty(0))


def paired(found: Floats, truth: Floats) -> Pairing:
    """Pair estimated azimuths `found` (n,) with true ones (m,) [rad] by the least sum of 1 - cos(error).

    Returns:
        How many true and estimated azimuths there are, and errors (min(n, m),), estimated minus true, [rad] in -pi to
        pi.
    """
    difference = (found[:, None] - truth[None, :] + np.pi) % (2.0 * np.pi) - np.pi
    i, j = linear_sum_assignment(1.0 - np.cos(difference))
    return Pairing(len(truth), len(found), np.asarray(difference[i, j], dtype=np.float64))


def _errors(pairs: list[Pairing]) -> Floats:
    return np.concatenate([p.errors for p in pairs]) if pairs else np.empty(0)


def _azimuth_counts(pairs: list[Pairing], gate: float) -> dict[str, float]:
    true, found = sum(p.true for p in pairs), sum(p.found for p in pairs)
    hits = int((np.abs(_errors(pairs)) <= gate).sum())
    return {
        "doa_true": true,
        "doa_found": found,
        "doa_hits": hits,
        "doa_missed": true - hits,
        "doa_false": found - hits,
        "doa_recall": hits / true if true else np.nan,
        "doa_precision": hits / found if found else np.nan,
    }


def _spread(errors: Floats, gate: float) -> dict[str, float]:
    near = np.degrees(errors[np.abs(errors) <= gate])
    return {
        **{f"doa_{name}": value for name, value in _quantiles(errors).items()},
        "doa_hits_rms_deg": float(np.sqrt((near**2).mean())) if len(near) else np.nan,
        "doa_hits_bias_deg": float(near.mean()) if len(near) else np.nan,
    }


def _quantiles(errors: Floats) -> dict[str, float]:
    """Return median, 90 % quantile and maximum of the absolute errors, by name, in degrees; NaN without errors.

    `errors`: (n,) [rad].
    """
    if not len(errors):
        return dict.fromkeys(("error_median_deg", "error_p90_deg", "error_max_deg"), np.nan)
    size = np.degrees(np.abs(errors))
    return {
        "error_median_deg": float(np.median(size)),
        "error_p90_deg": float(np.percentile(size, 90)),
        "error_max_deg": float(size.max()),
    }

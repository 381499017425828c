"""Reading of person boxes, in any known format (`FORMATS`).

From the first to the last time with a box in the files each camera has frames, at its own rate: a frame without a row
has no detection. `frames` selects another range of frame numbers, for all cameras or for one. A camera may number its
frames in steps: numbers between are not frames. If rows have times, the times of all frames are computed from these.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Strings
from occlog.errors import InputError, UsageError, abridged, option
from occlog.io.files.limits import describe_unsupported
from occlog.io.files.names import check_meaning, match_sensor, means_none
from occlog.io.files.texts.by_reader import reader_of
from occlog.io.files.texts.csv_rows import CsvRows, check_one_sensor, is_header
from occlog.io.files.texts.formats import FileFormat, Probe, by_cells, is_folder, recognise
from occlog.io.files.timing.frame_choice import ALL_FRAMES, FrameChoice
from occlog.io.files.timing.frame_times import FrameTimes, is_unit_factor
from occlog.io.files.timing.times import check_unit, parse_times, time_column
from occlog.io.files.timing.utc import time_words
from occlog.records.columns import MAX_NS
from occlog.records.declared.sensors import MAX_FRAMES
from occlog.records.losses import Loss
from occlog.records.tables import Boxes

from .annotations import is_cvat, open_cvat
from .columns import (
    COLUMNS,
    SHARE_HEIGHT,
    SHARE_WIDTH,
    SHARE_X,
    SHARE_Y,
    WHAT,
    BoxReadOptions,
    BoxSource,
    both_sizes,
    commented_columns,
    disagree,
    open_csv,
    open_mot,
)
from .datasets import is_annotations, is_kitti, is_vatic, open_annotations, open_folder, open_kitti, open_vatic
from .objects import open_json
from .rows import (
    FileBoxRows,
    UnusableBoxes,
    check_classes,
    check_identities,
    check_range,
    class_labels,
    fill_frames,
    in_frames,
    join,
    times_of,
    usable,
    wanted_rows,
    without_copies,
)


def note_times(
    rows: CsvRows,
    boxes: FileBoxRows,
    cameras: list[str],
    stamps: dict[str, dict[int, int]],
    heads: dict[str, CsvRows] | None = None,
) -> None:
    """Collect the time of every frame that has rows, if the file has a column of times.

    Args:
        rows: rows of the file, as text.
        boxes: the same rows as numbers.
        cameras: names by index.
        stamps: time [ns] by camera and frame; extended in place.
        heads: first row of each camera; extended in place; None: not collected.

    Raises:
        InputError: a frame of a camera has two times.
    """
    unit = time_column(rows)
    if unit is None:
        return
    t_ns = parse_times(rows, unit, unit)
    for n, name in enumerate(cameras):
        mine = np.flatnonzero(boxes.camera == n)
        found = stamps.setdefault(name, {})
        if heads is not None and len(mine):
            heads.setdefault(name, rows.pick(mine[:1]))
        for row in mine.tolist():
            frame, t = int(boxes.frame[row]), int(t_ns[row])
            if found.setdefault(frame, t) != t:
                raise rows.fail(
                    row,
                    f"frame {frame} of camera {name} has two times ({time_words(found[frame])} and {time_words(t)}); "
                    "give one",
                )


COLUMN_OF_TIMES = "column of times"
"""Source of the times of frames in a table of boxes."""


def table_times(found: dict[int, int], first: int, stop: int, where: str) -> FrameTimes:
    """Times of frames 0 to `stop` - 1 from those of some frames; others are interpolated, or extrapolated evenly.

    Args:
        found: time [ns] of each frame with a row.
        first: first frame that is needed.
        stop: frame after the last.
        where: file and camera, for messages.

    Raises:
        InputError: no frame has a time, only one has and several are needed, or times do not increase or are out of
            range.
    """
    if not found:
        raise InputError(f"{where}: no frame has a time; give the frame rate ({option('fps')})", id="missing-times")
    frames = np.array(sorted(found), dtype=np.int64)
    t_ns = np.array([found[int(f)] for f in frames], dtype=np.int64)
    if (np.diff(t_ns) <= 0).any():
        k = int(np.flatnonzero(np.diff(t_ns) <= 0)[0])
        raise InputError(
            f"{where}: frame {frames[k + 1]} has time {time_words(t_ns[k + 1])}, not after the "
            f"{time_words(t_ns[k])} of frame {frames[k]}; correct the times",
            id="unsorted-times",
        )
    step = (t_ns[-1] - t_ns[0]) / max(int(frames[-1] - frames[0]), 1)
    if not step and stop - first > 1:
        raise InputError(
            f"{where}: only frame {frames[0]} has a time, which does not determine the others; give the frame rate "
            f"({option('fps')})",
            id="missing-times",
        )
    wanted = np.arange(stop)
    # Relative to the first time: float64 cannot hold ns since 1970 exactly.
    relative = np.interp(wanted, frames, (t_ns - t_ns[0]).astype(np.float64))
    before, after = wanted < frames[0], wanted > frames[-1]
    relative[before] = (wanted[before] - frames[0]) * step
    relative[after] = float(t_ns[-1] - t_ns[0]) + (wanted[after] - frames[-1]) * step
    if np.abs(relative).max(initial=0.0) > MAX_NS:
        raise InputError(
            f"{where}: frames {step / NS:g} s apart lead to times that are out of range (1824 to 2115); check the unit "
            "of times",
            id="time-out-of-range",
        )
    table = np.round(relative).astype(np.int64) + t_ns[0]
    table[frames[frames < stop]] = t_ns[frames < stop]
    return FrameTimes(COLUMN_OF_TIMES, 0, table)


B = TypeVar("B", bound=Boxes)
NORMALISED_PX = 1.5
"""Largest coordinate up to which many boxes are taken to be given in shares of the image, not in pixels."""
RESTART_SHARE = 0.2
"""Share of the range of frames within which the numbers of a second recording in a file begin."""
STOPPED_BOXES, STOPPED_FRAMES, END_FRAMES = 2, 10, 3
"""Boxes in one of the first or last `END_FRAMES` frames with boxes that show that the camera did not run beyond them,
for people come and go one by one, where it would have no box in so many more frames."""
COUNTER_BITS, COUNTER_SLACK = (8, 16, 24), 10
"""Sizes of counters that begin again at 0, and frames without a box before and after that, at most."""
MIN_LISTED_FRAMES, MIN_BOX_FRAMES = 3, 20
"""Frames of a camera from which those between are none where all are multiples of a step: where the file lists its
frames, and where it has those with boxes alone."""


def counter_bits(before: int, after: int) -> int:
    """Number of bits (8, 16 or 24) of a counter that overflowed between two successive frame numbers; 0 if none did."""
    ends = (bits for bits in COUNTER_BITS if after < COUNTER_SLACK and 0 < 2**bits - before <= COUNTER_SLACK)
    return next(ends, 0)


@dataclass(frozen=True)
class BoxOptions:
    """Options for reading box files.

    Attributes:
        frames: frames that are selected; of a camera without a selection those from the first to the last in the files.
        first_number: number of frame 0, if neither the format nor `BoxFile` states it.
        confidence_scale: number by which confidences are divided.
        scores: what a confidence is: `probability`; `logit`: any number, converted by the logistic function; `unknown`:
            of no use, so that it is not kept.
        ignore_extra: skip unknown columns instead of refusing them.
        drop_zero: omit boxes with a confidence of 0.
        use_confidence: False: confidences, which may then be any number, are not kept.
        classes: classes that are read, by number or name; empty: the boxes must all be of one class; None: classes are
            ignored.
        sizes: width and height of each camera's images [px], for boxes in shares of them; None: not known yet.
        others: cameras that match none of the known ones are accepted under their own names.
        lenient: boxes without a size, and copies, are omitted and counted; otherwise the first one is an error.
    """

    frames: FrameChoice = ALL_FRAMES
    first_number: int = 0
    confidence_scale: float = 1.0
    scores: str = "probability"
    ignore_extra: bool = False
    drop_zero: bool = False
    use_confidence: bool = True
    classes: tuple[str, ...] | None = None
    sizes: Mapping[str, tuple[int, int]] | None = None
    others: bool = False
    lenient: bool = False


class BoxFile(NamedTuple):
    """A file or folder of boxes.

    Attributes:
        path: the file or folder.
        camera: the camera; None: the file itself names the cameras.
        first_number: number of frame 0; None: as the format or the options state.
    """

    path: Path
    camera: str | None
    first_number: int | None = None


@dataclass(frozen=True, eq=False)
class BoxSurvey:
    """Result of the first pass through the box files.

    Attributes:
        cameras: names of the cameras.
        ranges: frames of each camera: from its first to its last box, in its step; empty without any box.
        ordered: frame numbers do not decrease in any file.
        times: frame times by camera, from the files' own column of times.
        rows: number of boxes in the selected frames.
        beyond: number of boxes in other frames.
        given: selection of frames; a camera has all frames in its selected range.
        reach: by camera, how many frames without a box it may have had before its range and after it.
        recorded: number of frames of the cameras for which it is known from video.
        kinds: formats of the files, in words.
        classes: number of boxes that are read, by class; one without a name: not stated.
        left_out: number of boxes of other classes, by class.
        shares: cameras with boxes in shares of the image.
        of_files: cameras of each file; a camera is in one.
        sizes: width and height of the images [px] by camera, where files state it.
        restarts: cameras with frame numbers that restart once: line number, and the frames before and after.
        unused: keys of the files that are not used.
    """

    cameras: tuple[str, ...]
    ranges: Mapping[str, range]
    ordered: bool
    times: Mapping[str, FrameTimes]
    rows: int
    beyond: int = 0
    given: FrameChoice = ALL_FRAMES
    reach: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    recorded: Mapping[str, int] = field(default_factory=dict)
    kinds: tuple[str, ...] = ()
    classes: Counter[tuple[str, ...]] = field(default_factory=Counter)
    left_out: Counter[tuple[str, ...]] = field(default_factory=Counter)
    shares: frozenset[str] = frozenset()
    of_files: tuple[tuple[str, ...], ...] = ()
    sizes: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    restarts: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    unused: tuple[str, ...] = ()

    @property
    def first(self) -> int:
        """First frame number over all cameras."""
        return min((each[0] for each in self.ranges.values() if each), default=0)

    @property
    def stop(self) -> int:
        """Last frame number over all cameras, plus 1."""
        return max((each[-1] for each in self.ranges.values() if each), default=-1) + 1

    def frames(self, times: Mapping[str, FrameTimes]) -> dict[str, range]:
        """Frames of each camera from the first to the last time at which any camera has a box.

        Times are relative to frame 0 of each camera, so that origins of clocks do not matter. A camera with a selected
        range, or that seems to have stopped recording, has only the frames of its own range; so have all if the rates
        are unknown.

        Args:
            times: frame times by camera.

        Raises:
            UsageError: a camera has no times, or one range of frames is selected for cameras of different frame rates.
        """
        own = {name: (each, times_of(name, times)) for name, each in self.ranges.items()}
        self._check_rates({n: t.interval_ns() for n, (_, t) in own.items() if n not in self.given.own})
        if self.given.common or any(clock.table_ns is None and clock.rate is None for _, clock in own.values()):
            return dict(self.ranges)
        there = [(each, clock) for each, clock in own.values() if each]
        slack = 0.5 * min(clock.interval_ns() * each.step for each, clock in there)
        slack = slack if math.isfinite(slack) else 0.0
        begin = min(clock.elapsed_ns(each[0]) for each, clock in there) - slack
        end = max(clock.elapsed_ns(each[-1]) for each, clock in there) + slack
        frames = {}
        for name, (each, clock) in own.items():
            if self.given.of(name) is not None:
                frames[name] = each
                continue
            last = min(clock.until(end), self.recorded.get(name, MAX_FRAMES) - 1)
            frames[name] = _extended(each, clock.until(begin), last, self.reach.get(name, (math.inf, math.inf)))
        return frames

    def _check_rates(self, intervals: Mapping[str, float]) -> None:
        """UsageError if one range of frame numbers is selected for cameras of different frame rates.

        It would mean other times in each camera. `intervals` has the time from frame to frame of each camera [ns].
        """
        known = {name: step for name, step in intervals.items() if math.isfinite(step) and step > 0}
        if not self.given.common or not known:
            return
        fast, slow = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
        if known[slow] > RATES_DIFFER * known[fast]:
            first, stop = self.given.common
            rates = " and ".join(f"{NS / known[name]:.3g} ({name})" for name in (fast, slow))
            raise UsageError(
                f"{option('frames')} {first}:{stop}: cameras have {rates} frames per second, so these differ in "
                f"time; give each camera its own range: {fast}={first}:{stop}",
                id="ambiguous-input",
            )


RATES_DIFFER = 1.5
"""Ratio of frame rates from which a range of numbers means other times in each camera."""


def _extended(own: range, before: int, last: int, reach: tuple[float, float]) -> range:
    """Extend a range of frames, in its steps, down to `before` + 1 and up to `last`; an empty one becomes that range.

    Args:
        own: range of a camera.
        before: last frame before the extended range.
        last: its last frame.
        reach: most frames that may be added before and after; an end that would need more is unchanged.
    """
    if not own:
        return range(max(before + 1, 0), last + 1)
    earlier = max((own.start - max(before + 1, 0)) // own.step, 0)
    later = max((last - own[-1]) // own.step, 0)
    earlier, later = (0 if count > most else count for count, most in zip((earlier, later), reach, strict=True))
    return range(own.start - earlier * own.step, own.stop + later * own.step, own.step)


def survey_boxes(files: Sequence[BoxFile], known: Sequence[str], options: BoxOptions) -> BoxSurvey:
    """Read the box files once to find their cameras, frame ranges, times and classes.

    Args:
        files: the files, of any mix of formats.
        known: names of the cameras of the scene, with which labels in a file are matched; empty: labels are used as
            they are. If the files have no box, these are the cameras.
        options: how to read the files.

    Raises:
        InputError: there is no box and no selection of frames, boxes of several classes, or boxes that seem to be in
            shares of the image rather than pixels.
    """
    found = _BoxScan()
    for file in files:
        _survey_file(file, known, options, found)
    where = ", ".join(str(f.path) for f in files)
    if options.classes is not None:
        check_classes(where, options.classes, found.classes, found.classes + found.left_out)
    spans = [each for each in found.frames.values() if each.count]
    if not spans and not options.frames:
        raise InputError(
            f"{where}: no row with a box; if all frames are without a detection, state their range "
            f"({option('frames')} A:B)",
            id="empty-input",
        )
    for name, farthest in found.farthest.items():
        if farthest <= NORMALISED_PX and found.boxes[name] > 1:
            path = next(file for file, own in zip(found.files, found.of_files, strict=True) if name in own)
            raise InputError(
                f"{path}: camera {name}: no box reaches beyond {farthest:.3g} px; these seem to be fractions of the "
                "image size: write pixels",
                id="unit-mismatch",
            )
    # Files without any box name no camera: no camera detected anything
    cameras = tuple(found.cameras or known)
    ranges = {name: _range_of(found.frames.get(name, _CameraFrames()), options.frames.of(name)) for name in cameras}
    there = [each for each in ranges.values() if each]
    first, stop = min((each[0] for each in there), default=0), max((each[-1] + 1 for each in there), default=0)
    check_range(first, stop, where)
    return BoxSurvey(
        cameras=cameras,
        ranges=ranges,
        ordered=found.ordered,
        times=_column_times(found, first, stop, where),
        rows=found.rows - found.beyond,
        beyond=found.beyond,
        given=options.frames,
        reach={name: each.reach for name, each in found.frames.items()},
        kinds=tuple(dict.fromkeys(found.kinds)),
        classes=found.classes,
        left_out=found.left_out,
        shares=frozenset(found.shares),
        of_files=tuple(found.of_files),
        sizes=found.sizes,
        restarts={name: one for name, each in found.frames.items() if (one := each.restart) is not None},
        unused=tuple(found.unused),
    )


def classes_in(file: BoxFile) -> Counter[tuple[str, ...]]:
    """Number of boxes in a file by class (all labels of a box, in lower case); nothing if the file has no classes."""
    source = _open(file, (), BoxOptions(ignore_extra=True))
    found: Counter[tuple[str, ...]] = Counter()
    for chunk in source.chunks:
        found.update(class_labels(chunk))
    return found


@dataclass
class _CameraFrames:
    """Frame numbers of one camera in box files: range, step, and where they decrease.

    Attributes:
        low: lowest frame number.
        high: highest frame number.
        step: greatest common divisor of the differences from the lowest number.
        listed: number of frames that the file lists, with or without boxes.
        boxed: number of frames with boxes, counted in each part of the file.
        ends: number of boxes in the lowest and highest `END_FRAMES` frames with boxes.
        last: last frame number read.
        first_low: lowest frame number before the first decrease.
        last_high: highest frame number after it.
        backs: (line, frame before, frame after) of the first two decreases.
        by_frame: rows have neither identities nor classes, by which they could be sorted.
    """

    low: int = 0
    high: int = 0
    step: int = 0
    listed: int = 0
    boxed: int = 0
    ends: dict[int, int] = field(default_factory=dict)
    last: int = -1
    first_low: float = math.inf
    last_high: float = -math.inf
    backs: list[tuple[int, int, int]] = field(default_factory=list)
    by_frame: bool = True  # files with identities or classes may be sorted by these

    @property
    def restart(self) -> tuple[int, int, int] | None:
        """(line, frame before, frame after) at which the frame numbers restart; None unless they do so exactly once.

        Either a counter of 8, 16 or 24 bits overflows, or rows that are sorted by frame begin again near the lowest
        number.
        """
        if len(self.backs) != 1 or self.boxed < MIN_BOX_FRAMES:
            return None
        _, before, after = self.backs[0]
        if counter_bits(before, after):
            return self.backs[0]
        if not self.by_frame:
            return None
        near = RESTART_SHARE * (self.high - self.low)
        overlap = self.last_high >= self.first_low
        return self.backs[0] if after - self.low <= near and before - after > near and overlap else None

    def follow(self, rows: CsvRows, frames: Ints) -> None:
        """Note where the frame numbers (n,) of the camera's next rows decrease, with the lines of the rows."""
        before = np.concatenate([[self.last], frames[:-1]])
        found = np.flatnonzero(frames < before)[: 2 - len(self.backs)].tolist()
        begin = len(frames) if not (found or self.backs) else 0 if self.backs else found[0]
        self.first_low = min([self.first_low, *frames[:begin].tolist()])
        self.last_high = max([self.last_high, *frames[begin:].tolist()])
        self.backs += [(int(rows.lines[row]), int(before[row]), int(frames[row])) for row in found]
        self.last = int(frames[-1])

    @property
    def count(self) -> int:
        """Number of frames of the camera that are listed by the file, or that have boxes; the larger of both."""
        return max(self.listed, self.boxed)

    def take(self, frames: Ints, *, listed: bool = False) -> None:
        """Add frame numbers (n,): those that the file lists (`listed`), or that of each box."""
        if not len(frames):
            return
        low, high = int(frames.min()), int(frames.max())
        if not self.count:
            self.low, self.high = low, high
        self.step = math.gcd(self.step, int(np.gcd.reduce(frames - self.low)))
        self.low, self.high = min(low, self.low), max(high, self.high)
        numbers, counts = np.unique(frames, return_counts=True)
        if listed:
            self.listed += len(numbers)
            return
        self.boxed += len(numbers)
        for k in {*range(len(numbers))[:END_FRAMES], *range(len(numbers))[-END_FRAMES:]}:
            self.ends[int(numbers[k])] = self.ends.get(int(numbers[k]), 0) + int(counts[k])
        order = sorted(self.ends)
        self.ends = {n: self.ends[n] for n in {*order[:END_FRAMES], *order[-END_FRAMES:]}}

    @property
    def range(self) -> range:
        """Frames from the lowest to the highest in their common step; step 1 if the camera has few frames."""
        enough = self.count >= (MIN_LISTED_FRAMES if self.listed else MIN_BOX_FRAMES)
        step = self.step if enough and self.step else 1
        return range(self.low, self.high + step, step)

    @property
    def reach(self) -> tuple[float, float]:
        """How many frames without a box the camera may have had before its lowest and after its highest frame.

        0 if the file lists its frames; few if several boxes are in the first or last frames, as if recording began or
        ended there; else infinitely many.
        """
        if self.listed > self.boxed and self.listed >= MIN_LISTED_FRAMES:
            return 0.0, 0.0
        order = sorted(self.ends)
        first, last = (
            max((self.ends[n] for n in part), default=0) for part in (order[:END_FRAMES], order[-END_FRAMES:])
        )
        before, after = (math.inf if boxes < STOPPED_BOXES else STOPPED_FRAMES for boxes in (first, last))
        return before, after


def _range_of(found: _CameraFrames, chosen: tuple[int, int] | None) -> range:
    """Frames of a camera: the selected ones (first, stop) in the step of its file, or those from its first to its last.

    Args:
        found: frames of the camera in the files.
        chosen: first frame and frame after the last; None: no selection.
    """
    own = found.range if found.count else range(0)
    if chosen is None:
        return own
    first, stop = chosen
    step = own.step if found.count >= MIN_BOX_FRAMES else 1
    return range(first + (own.start - first) % step, stop, step)


def _chosen(boxes: FileBoxRows, cameras: Sequence[str], frames: FrameChoice) -> Bools:
    """(n,) mask of the boxes in the frames that the selection has for their cameras; `cameras` are names by index."""
    chosen = np.ones(len(boxes.frame), dtype=np.bool_)
    for n in np.unique(boxes.camera).tolist() if frames else ():
        if (own := frames.of(cameras[n])) is not None:
            mine = boxes.camera == n
            chosen[mine] = (boxes.frame[mine] >= own[0]) & (boxes.frame[mine] < own[1])
    return chosen


def _column_times(found: _BoxScan, first: int, stop: int, where: str) -> dict[str, FrameTimes]:
    """Frame times of each camera with a column of times, from frame 0 to the last time at which any camera has a box.

    Args:
        found: times of frames by camera.
        first: first frame that is needed.
        stop: frame after the last that is needed at least.
        where: the files, for messages.
    """
    ends: dict[str, float] = {}  # of each camera: time from frame 0 to its last one, and from frame to frame [ns]
    steps: dict[str, float] = {}
    for name, stamps in found.stamps.items():
        frames = np.array(sorted(stamps), dtype=np.int64)
        t_ns = np.array([stamps[int(f)] for f in frames], dtype=np.float64)
        if len(frames) > 1:
            check_unit(found.heads[name], np.diff(t_ns) / np.diff(frames) / NS)
            steps[name] = float(t_ns[-1] - t_ns[0]) / float(frames[-1] - frames[0])
            ends[name] = steps[name] * float(frames[-1])
    _check_units(found, steps)
    out = {}
    for name, stamps in found.stamps.items():
        step = steps.get(name, 0.0)
        needed = min(math.ceil(max(ends.values()) / step) + 2, MAX_FRAMES) if step > 0 else 0
        out[name] = table_times(stamps, first, max(stop, needed), f"{where}: camera {name}")
    return out


def _check_units(found: _BoxScan, steps: Mapping[str, float]) -> None:
    """InputError if the time stamps of one camera seem to be in another unit than those of the others.

    `steps` has the time from frame to frame of each camera [ns].
    """
    for name, step in steps.items():
        usual = float(np.median([each for other, each in steps.items() if other != name] or [step]))
        if min(step, usual) > 0.0 and is_unit_factor(step / usual) and (step > usual or len(steps) > 2):
            raise InputError(
                f"{found.heads[name].path}: camera {name}: frames are {step / NS:.4g} s apart, those of other cameras "
                f"{usual / NS:.4g} s; name the time column of each by its unit: t_s, t_ms, t_us or t_ns",
                id="missing-unit",
            )


@dataclass
class _BoxScan:
    """What a survey of box files has found so far: cameras, frames, times, classes, image sizes and counts."""

    cameras: list[str] = field(default_factory=list)
    stamps: dict[str, dict[int, int]] = field(default_factory=dict)
    heads: dict[str, CsvRows] = field(default_factory=dict)
    frames: dict[str, _CameraFrames] = field(default_factory=dict)
    rows: int = 0
    beyond: int = 0
    ordered: bool = True
    kinds: list[str] = field(default_factory=list)
    classes: Counter[tuple[str, ...]] = field(default_factory=Counter)
    left_out: Counter[tuple[str, ...]] = field(default_factory=Counter)
    shares: set[str] = field(default_factory=set)
    farthest: dict[str, float] = field(default_factory=dict)
    boxes: Counter[str] = field(default_factory=Counter)
    of_files: list[tuple[str, ...]] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    unused: dict[str, None] = field(default_factory=dict)

    def take(self, name: str, frames: Ints, *, listed: bool = False) -> None:
        """Add frame numbers (n,) of the camera `name`; `listed`: the file lists these frames, with or without boxes."""
        self.frames.setdefault(name, _CameraFrames()).take(frames, listed=listed)


def _survey_file(file: BoxFile, known: Sequence[str], options: BoxOptions, found: _BoxScan) -> None:
    source = _open(file, known, options)
    how = _numbering(file, source, options)
    found.kinds.append(source.kind)
    found.unused |= dict.fromkeys(source.unused)
    named = (file.camera,) if file.camera is not None else _matched(source.cameras, known, file, options, {})
    for label, numbers in source.listed.items():
        stated = [file.camera] if file.camera is not None else _matched([label], known, file, options, {})
        for name in stated:
            found.take(name, numbers - how.first_number, listed=True)
    if file.camera is not None:
        found.sizes |= dict.fromkeys([file.camera][: len(source.sizes)], next(iter(source.sizes.values()), (0, 0)))
    else:
        found.sizes |= {_matched([c], known, file, options, {})[0]: size for c, size in source.sizes.items()}
    last = -1
    own = dict.fromkeys(named)
    unusable = UnusableBoxes() if how.lenient else None
    for chunk, boxes in _read(file, source, found.cameras, known, how, found.left_out, unusable):
        for n in np.unique(boxes.camera).tolist():
            own.setdefault(found.cameras[n])
            found.take(found.cameras[n], boxes.frame[boxes.camera == n])
            mine, frames = np.flatnonzero(boxes.camera == n), found.frames[found.cameras[n]]
            frames.by_frame &= not chunk.has("id") and not class_labels(chunk)
            frames.follow(chunk.pick(mine), boxes.frame[mine])
        ordered = last <= boxes.frame[0] and bool((np.diff(boxes.frame) >= 0).all())
        last, found.rows, found.ordered = int(boxes.frame[-1]), found.rows + len(boxes.frame), found.ordered and ordered
        found.beyond += int(np.count_nonzero(~_chosen(boxes, found.cameras, how.frames)))
        note_times(chunk, boxes, found.cameras, found.stamps, found.heads)
        found.classes.update(class_labels(chunk) if options.classes is not None else ())
        if chunk.has(SHARE_X):
            found.shares |= {found.cameras[n] for n in np.unique(boxes.camera).tolist()}
            found.farthest |= dict.fromkeys(found.shares, math.inf)
        for n in np.unique(boxes.camera).tolist():
            name, edges = found.cameras[n], (boxes.left + boxes.width)[boxes.camera == n]
            found.boxes[name] += len(edges)
            found.farthest[name] = max(found.farthest.get(name, -math.inf), float(edges.max()))
    if unusable is not None:
        unusable.check()
        for name, ends in unusable.frames.items():
            found.take(name, np.array(ends, dtype=np.int64))
    found.cameras += [name for name in named if name not in found.cameras]
    for before, other in zip(found.files, found.of_files, strict=False):
        double = next((name for name in own if name in other), None)
        if double is not None:
            raise InputError(
                f"{file.path}: camera {double}: has boxes in {before}, too, and a frame without a box is one without "
                "a detection; give one of the files, or join them",
                id="conflicting-values",
            )
    found.files.append(str(file.path))
    found.of_files.append(tuple(own))


def read_boxes(
    files: Sequence[BoxFile],
    survey: BoxSurvey,
    times: Mapping[str, FrameTimes],
    known: Sequence[str],
    options: BoxOptions,
    table: type[B],
    losses: list[Loss] | None = None,
) -> Iterator[B]:
    """Yield tables of boxes with a row for every frame of every camera; frames without a box have `box` = -1.

    Memory is bounded for files sorted by frame; others are sorted as a whole.

    Args:
        files: files of the survey, in its order.
        survey: result of `survey_boxes` for these files.
        times: frame times by camera.
        known: names of the cameras of the scene, with which labels in a file are matched.
        options: how to read the files.
        table: `Boxes` or `TruthBoxes`.
        losses: the boxes that are omitted are added after the last table, if the options are `lenient`.
    """
    ranges = survey.frames(times)
    unusable = UnusableBoxes() if options.lenient else None
    for file, own in zip(files, survey.of_files, strict=True):
        source = _open(file, known, options)
        how = _numbering(file, source, options)
        # In files without any box no camera detected anything
        cameras = list(own) if any(survey.of_files) else list(survey.cameras if file is files[0] else ())
        chunks: Iterator[FileBoxRows] = (
            boxes.pick(np.flatnonzero(_chosen(boxes, cameras, how.frames)))
            for _, boxes in _read(file, source, cameras, known, how, Counter(), unusable)
        )
        if not survey.ordered:
            chunks = iter([join(parts)] if (parts := list(chunks)) else [])
        whole = in_frames(chunks, survey.first, survey.stop)
        # A detector may give one box to several classes, which the rows no longer show
        if options.classes is None or len(options.classes) < 2:
            whole = without_copies(whole, cameras, file.path, unusable)
        if options.classes is not None:
            whole = check_identities(whole, cameras, file.path)
        yield from fill_frames(whole, table, cameras, [ranges[name] for name in cameras], times)
    if unusable is not None and losses is not None:
        losses += unusable.losses()


def box_source(path: Path) -> BoxSource:
    """Open a box file of any format, and read its first rows.

    A file without camera names is of a camera named after it.

    Raises:
        InputError: it is not a box file, or cannot be read.
    """
    for camera in (None, path.stem):
        try:
            source = _open(BoxFile(path, camera), (), BoxOptions())
            first = list(islice(source.chunks, 1))
            return source._replace(chunks=chain(first, source.chunks))
        except InputError:
            if camera is not None:
                raise
    raise AssertionError("the last one returns or raises")


def box_rows(rows: CsvRows, cameras: list[str], first_number: int = 0) -> FileBoxRows:
    """Convert rows of a box file to numbers; InputError, with the position, for an impossible box.

    Confidences may be any number, and are converted to 0 to 1 by the logistic function.

    Args:
        rows: of a `BoxSource`.
        cameras: names of the cameras so far; new ones are appended.
        first_number: number of frame 0.
    """
    options = BoxOptions(first_number=first_number, scores="logit")
    labels = rows.cells["camera"] if rows.has("camera") else None
    file = BoxFile(rows.path, rows.path.stem if labels is None else None)
    camera = _number_cameras(file, rows, labels, cameras, (), options, {})
    return usable(rows, _numbers(rows, camera, cameras, options), cameras, None)[1]


def is_json(probe: Probe) -> bool:
    """Whether a file, which no reader plug-in reads, begins like a JSON list or object."""
    return not is_folder(probe) and reader_of(probe.path) is None and probe.start[:1] in (b"{", b"[")


def is_table(probe: Probe) -> bool:
    """Whether a text file has a line that names its columns, which may begin with `#`."""
    return is_header(probe.cells) or bool(commented_columns(probe))


ZIP_MAGIC = b"PK\x03\x04"
"""First bytes of a ZIP archive, and of a workbook of Excel."""
BoxFormat = FileFormat[Callable[[Path, BoxReadOptions], BoxSource]]
FORMATS: dict[str, BoxFormat] = {
    "wildtrack": BoxFormat(open_annotations, "WILDTRACK: a folder with one JSON file a frame", is_annotations),
    "yolo": BoxFormat(open_folder, "YOLO: a folder with one text file a frame, one folder a camera", is_folder),
    "cvat": BoxFormat(open_cvat, "XML of CVAT, for video or for images, one camera", is_cvat),
    "json": BoxFormat(open_json, "JSON: COCO, or records of supervision and Ultralytics", is_json),
    "vatic": BoxFormat(open_vatic, "VATIC text (CAMPUS), one camera", by_cells(is_vatic)),
    "kitti": BoxFormat(open_kitti, "KITTI's text of tracked boxes, one camera", by_cells(is_kitti)),
    "csv": BoxFormat(open_csv, "a table (CSV) with a header line", is_table),
    "mot": BoxFormat(open_mot, "MOTChallenge text, one camera", lambda _: True),
}
"""Every format of boxes; text of no other one is taken for that of MOTChallenge."""


def _open(file: BoxFile, known: Sequence[str], options: BoxOptions) -> BoxSource:
    """Open a box file in the format that its content shows; labels of cameras may mean `known` (names in use)."""
    probe = Probe(file.path, WHAT)
    if file.path.is_file() and reader_of(file.path) is None and probe.start[:4] == ZIP_MAGIC:
        raise InputError(f"{file.path}: is {describe_unsupported(file.path)}", id="unsupported-format")
    name = recognise(FORMATS, probe)
    assert name is not None
    if name == "csv":
        _check_corner(file.path, {*(commented_columns(probe) or probe.cells)})
    return FORMATS[name].read(file.path, BoxReadOptions(file.camera, known, options.ignore_extra))


def _check_corner(path: Path, names: set[str]) -> None:
    """InputError if boxes have columns x and y, which may be a corner or the centre, and no column of a left edge.

    `names` are those of all columns.
    """
    if {"x", "y"} <= names and names & {"w", "width"} and not names & set(COLUMNS["left"]):
        raise InputError(
            f"{path}: columns x and y: they may be a corner or the middle of a box; call them left and top, or give "
            "left, top, right and bottom",
            id="ambiguous-input",
        )


def _numbering(file: BoxFile, source: BoxSource, options: BoxOptions) -> BoxOptions:
    """Copy of the options with the number of frame 0 that the format or else the user states for this file."""
    own = [n for n in (source.first_number, file.first_number) if n is not None]
    return replace(options, first_number=own[0]) if own else options


def _read(
    file: BoxFile,
    source: BoxSource,
    cameras: list[str],
    known: Sequence[str],
    options: BoxOptions,
    left_out: Counter[tuple[str, ...]],
    unusable: UnusableBoxes | None = None,
) -> Iterator[tuple[CsvRows, FileBoxRows]]:
    """Yield the usable rows of a box file in parts, each as text and as numbers; boxes of other classes are omitted.

    Args:
        file: with the camera that the user states, if any.
        source: its content.
        cameras: names by index; new ones are appended.
        known: names of cameras that labels may mean.
        options: of the reader.
        left_out: number of boxes of other classes, updated.
        unusable: boxes without a valid size are counted in it; None: they are an error.
    """
    meant: dict[str, str] = {}
    label = ""
    for chunk in source.chunks:
        if file.camera is not None and chunk.has("camera"):
            label = label or str(chunk.cells["camera"][0])
            check_one_sensor(chunk, "camera", file.camera, label)
        rows = chunk
        if options.classes and len(rows):
            wanted = wanted_rows(rows, options.classes)
            left_out.update(class_labels(rows.pick(np.flatnonzero(~wanted))))
            rows = rows.pick(np.flatnonzero(wanted))
        labels = rows.cells["camera"] if rows.has("camera") and file.camera is None else None
        camera = _number_cameras(file, rows, labels, cameras, known, options, meant)
        rows, boxes = usable(rows, _numbers(rows, camera, cameras, options), cameras, unusable)
        if options.drop_zero and (boxes.confidence == 0).any():
            kept = np.flatnonzero(boxes.confidence != 0)
            rows, boxes = rows.pick(kept), boxes.pick(kept)
        if len(rows):
            yield rows, boxes


def _number_cameras(
    file: BoxFile,
    rows: CsvRows,
    labels: Strings | None,
    cameras: list[str],
    known: Sequence[str],
    options: BoxOptions,
    meant: dict[str, str],
) -> Ints:
    """(n,) index in `cameras` of each row's camera, after matching labels with known names.

    Args:
        file: with the camera that the user states, if any.
        rows: n rows of the file.
        labels: (n,) cameras as in the file; None: the file names none.
        cameras: names by index; new ones are appended.
        known: names of cameras that labels may mean.
        options: of the reader.
        meant: label of each camera so far, updated.
    """
    if labels is None:
        name = file.camera or ""
        if name not in cameras:
            cameras.append(name)
        return np.full(len(rows), cameras.index(name), dtype=np.int64)
    unique, inverse = np.unique(labels, return_inverse=True)
    names = _matched([str(label) for label in unique], known, file, options, meant)
    for name in names:
        if name not in cameras:
            cameras.append(name)
    return np.array([cameras.index(name) for name in names], dtype=np.int64)[inverse]


def _matched(
    labels: Sequence[str], known: Sequence[str], file: BoxFile, options: BoxOptions, meant: dict[str, str]
) -> list[str]:
    """Name of the camera that each label means; labels themselves if no names are known.

    Args:
        labels: as in the file.
        known: names of cameras that they may mean.
        file: for messages.
        options: `others` accepts labels that mean none of the known cameras.
        meant: label of each camera so far, updated.

    Raises:
        InputError: a label means no known camera, or two labels mean the same one.
    """
    if not known:
        return list(labels)
    external_table = [label for label in labels if means_none(label, known)]
    if external_table and not options.others:
        text = abridged(map(repr, external_table))
        one = len(external_table) == 1
        remedy = "use the same names"
        if file.path.is_dir():
            remedy = f"give each folder with its camera (CAMERA={file.path / external_table[0]})"
        raise InputError(
            f"{file.path}: {'camera' if one else 'cameras'} {text} {'is' if one else 'are'} none of "
            f"{abridged(known)}; {remedy}, calibrate {'it' if one else 'them'}, or give "
            f"{option('allow_uncalibrated')}",
            id="missing-pose",
        )
    names = [label if label in external_table else match_sensor(label, known, str(file.path)) for label in labels]
    for label, name in zip(labels, names, strict=True):
        check_meaning(meant, label, name, str(file.path))
    return names


def _numbers(rows: CsvRows, camera: Ints, cameras: Sequence[str], options: BoxOptions) -> FileBoxRows:
    frame = rows.ints("frame") - options.first_number
    if (frame < 0).any():
        row = int(np.flatnonzero(frame < 0)[0])
        lowest = int(frame.min()) + options.first_number
        remedy = f"give {option('first_number')} {lowest}" if lowest >= 0 else "number frames from 0"
        raise rows.fail(
            row, f"frame {rows.cells['frame'][row]} is before the first one, {options.first_number}; {remedy}"
        )
    if (frame >= MAX_FRAMES).any():
        row = int(np.flatnonzero(frame >= MAX_FRAMES)[0])
        raise rows.fail(row, f"frame {rows.cells['frame'][row]}; it must be below {MAX_FRAMES}; correct or remove it")
    left, top, width, height = _edges(rows, camera, cameras, options)
    return FileBoxRows(
        frame=frame,
        camera=camera,
        target_id=_identities(rows) if rows.has("id") else np.full(len(frame), -1, dtype=np.int64),
        left=left,
        top=top,
        width=width,
        height=height,
        confidence=_confidence(rows, options),
    )


def _edges(
    rows: CsvRows, camera: Ints, cameras: Sequence[str], options: BoxOptions
) -> tuple[Floats, Floats, Floats, Floats]:
    """Left, top, width and height of boxes, each (n,) [px].

    In shares of the image, if the file has these and image sizes are not known yet. Empty cells are NaN, and infinite
    ones remain, if the options are `lenient`; else they are an error.

    Args:
        rows: n rows of the file.
        camera: (n,) index of each row's camera.
        cameras: names by index.
        options: has the image sizes.

    Raises:
        UsageError: the file has shares of the image, and the size of a camera's images is missing.
    """
    sizes, values = options.sizes, partial(rows.floats, blank=options.lenient, infinite=options.lenient)
    if not rows.has(SHARE_X):
        left, top = values("left"), values("top")
        with np.errstate(over="ignore", invalid="ignore"):  # the caller checks their sizes
            width = _size(rows, "width", "right", left, options.lenient)
            height = _size(rows, "height", "bottom", top, options.lenient)
        return left, top, width, height
    size = np.ones((len(cameras), 2))
    for n in np.unique(camera).tolist() if sizes is not None else ():
        if sizes is None or cameras[n] not in sizes:
            raise UsageError(
                f"{rows.path}: boxes are fractions of the image size, which is unknown for camera {cameras[n]}; give "
                f"{option('image_size')}, a calibration that states it, or the video",
                id="missing-image-size",
            )
        size[n] = sizes[cameras[n]]
    across, down = size[camera].T
    width, height = values(SHARE_WIDTH) * across, values(SHARE_HEIGHT) * down
    left, top = values(SHARE_X) * across, values(SHARE_Y) * down
    with np.errstate(invalid="ignore"):
        return left - width / 2, top - height / 2, width, height


def _size(rows: CsvRows, size: str, far: str, near: Floats, lenient: bool) -> Floats:
    """(n,) widths or heights of boxes [px], from a column of sizes or of far edges.

    Args:
        rows: n rows of the file.
        size: name of the column with the size.
        far: name of the column with the far edge.
        near: (n,) near edges [px].
        lenient: empty and infinite cells are no error.

    Raises:
        InputError: the file has both columns, and they contradict each other.
    """
    values = partial(rows.floats, blank=lenient, infinite=lenient)
    if not rows.has(size):
        return values(far) - near
    sizes = values(size)
    if rows.has(far):
        ends = rows.floats(far, blank=True, infinite=lenient)
        disagreement = disagree(sizes, near, ends) & np.isfinite(ends - near - sizes)
        if disagreement.any():
            row = int(np.flatnonzero(disagreement)[0])
            raise rows.fail(row, both_sizes(size, float(sizes[row]), far, str(rows.cells[far][row]), float(near[row])))
    return sizes


def _confidence(rows: CsvRows, options: BoxOptions) -> Floats:
    """(n,) confidences, divided by the scale or converted by the logistic function as the options state.

    NaN if missing, -1 (except for logits), or not used.
    """
    if not (rows.has("confidence") and options.use_confidence) or options.scores == "unknown":
        return np.full(len(rows), np.nan)
    given = rows.floats("confidence", blank=True)
    if options.scores == "logit":
        with np.errstate(over="ignore"):
            return np.asarray(1.0 / (1.0 + np.exp(-given / options.confidence_scale)))
    return np.where(given == -1, np.nan, given / options.confidence_scale)


def _identities(rows: CsvRows) -> Ints:
    return rows.ints("id", blank=-1)

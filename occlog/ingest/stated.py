"""Checks of what files state about their pictures and boxes, and of their agreement."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Ints
from occlog.consistency.clock_offsets import (
    MIN_BLOCKS,
    ClockChange,
    cause_of,
    change_of,
    drift_finding,
    offset_words,
)
from occlog.errors import InputError
from occlog.io.files.provenance import hash_file
from occlog.io.files.timing.frame_times import FrameTimes, is_unit_factor
from occlog.io.files.timing.utc import utc
from occlog.io.formats.boxes.reader import COLUMN_OF_TIMES, BoxSurvey, counter_bits
from occlog.io.frames.camera_source import CameraSource
from occlog.records.messages import listed
from occlog.records.verdicts import Check, finding, outcome

from .plan import IngestPlan

PICTURES, STARTS, SIDECARS, ENDS = "picture metadata", "video start times", "unit of time stamps", "frames with boxes"
CLOCKS = "clocks by frame numbers"
"""Names of checks."""
MIN_START_S = 0.1
"""Time stamp of a first frame [s] from which it is noted; a container may count from the first packet."""
BLACK_RUN = "pictures-black-run"
"""Fact of a decoder, of each run of black images, and id of the finding on the longest."""
MIN_BLACK_S = 3.0
"""Time for which images must be black [s], in a video that is not, to be stated: shorter ones are of its beginning."""
MIN_COUNTED = 20
"""Frames that are 1 s apart from which their times may be numbers of frames."""
MAX_BOXLESS_SHARE = 0.1
"""Share of frames after a camera's last box above which the numbering of the boxes is doubtful."""
STRIDE_TOLERANCE = 0.05
"""Relative difference of a ratio of frames to a whole number that may be a stride."""
MAX_COMPARED, MAX_LATER_FRAMES, MIN_OFF_FRAMES = 2000, 1, 3
"""Frames of two cameras that are compared; numbers by which their last frames may differ, and frame intervals by which
their times must if one clock is off: a camera of another rate, or with frames missing, has other numbers instead."""
NTSC_PPM, NTSC_TOLERANCE_PPM = 1000.0, 3.0
"""Rates of 30 and 30000/1001 fps differ by this [ppm]."""


def source_checks(
    plan: IngestPlan,
    sources: Sequence[CameraSource],
    survey: BoxSurvey | None,
    times: Mapping[str, FrameTimes],
) -> tuple[Check, ...]:
    """Checks of what files state about their pictures, boxes and times against each other.

    They are: metadata of pictures, starts of videos, units of time stamp files, clocks of cameras by frame numbers, and
    the ends and numbering of boxes.

    Args:
        plan: inputs and options.
        sources: cameras with a video or images.
        survey: of the box files; None: there are none.
        times: frame times by camera.

    Returns:
        Findings, or for each check without any its outcome.
    """
    stamped = {} if plan.frames else _stamped(sources, survey, times)
    no_times = "no two cameras have times of frames"
    no_video = "" if plan.video else "there is no video"
    counted = [*_counted(times)]
    no_sidecar = "" if (plan.video and plan.timestamps) or counted else "no video has time stamps in a file"
    numbers = [] if survey is None else [*_restarts(survey)]
    both = [s for s in sources if survey is not None and s.name in survey.ranges and s.decoder.frames]
    numbers += _ends(plan, both, survey)
    return (
        *outcome(PICTURES, _facts(sources), unless="" if sources else "there are no pictures"),
        *outcome(STARTS, _starts(plan, sources), unless=no_video),
        *outcome(SIDECARS, chain(_units(sources), counted), unless=no_sidecar),
        *outcome(CLOCKS, clock_faults(stamped), unless="" if len(stamped) > 1 else no_times),
        *outcome(ENDS, numbers, unless="" if both or numbers else "no camera has pictures and boxes"),
    )


def _facts(sources: Sequence[CameraSource]) -> Iterator[Check]:
    """Yield a finding for each peculiarity of pictures that the decoders of the cameras report."""
    for source in sources:
        for id, values in source.decoder.facts:
            if id != BLACK_RUN:
                yield finding(PICTURES, id, None, sensors=[source.name], targets=(), **values)
        yield from _black_run(
            source, [(int(v["first"]), int(v["last"])) for n, v in source.decoder.facts if n == BLACK_RUN]
        )
    for one, other in combinations([source for source in sources if source.path.is_file()], 2):
        if one.path.stat().st_size == other.path.stat().st_size and hash_file(one.path) == hash_file(other.path):
            yield finding(PICTURES, "videos-identical", sensors=[one.name, other.name])


def _black_run(source: CameraSource, runs: Sequence[tuple[int, int]]) -> Iterator[Check]:
    """Yield a finding if a camera has black images in a row for `MIN_BLACK_S` or more, with the longest of the rows.

    `runs` are the first and last frame of each. Nothing if the frames have no times.
    """
    try:
        lasting = [(int(end) - int(begin), int(begin)) for begin, end in map(source.times.at, map(np.array, runs))]
    except InputError:
        return
    long = [(ns, -n) for n, (ns, _) in enumerate(lasting) if ns >= MIN_BLACK_S * NS]
    if long:
        ns, n = max(long)
        first, last = runs[-n]
        more = f", and in {len(long) - 1} more rows" if len(long) > 1 else ""
        time, seconds, name = utc(lasting[-n][1]), ns / NS, source.name
        yield finding(
            PICTURES,
            BLACK_RUN,
            sensors=[name],
            first=first,
            last=last,
            seconds=seconds,
            time=time,
            more=more,
        )


def _starts(plan: IngestPlan, sources: Sequence[CameraSource]) -> Iterator[Check]:
    """Yield a finding for each video with a first time stamp of at least `MIN_START_S` from 0.

    Not if all videos start at about the same time, nor for a camera with time stamps or a start time in `plan`.
    """
    given = {name for name, _ in (*plan.start_time, *plan.timestamps)}
    starts = {
        s.name: s.decoder.start_s
        for s in sources
        if s.name in plan.video and s.decoder.start_s is not None and not s.times.source.startswith("sidecar")
    }
    similar = len(starts) > 1 and max(starts.values()) - min(starts.values()) < MIN_START_S
    for name, start_s in starts.items():
        if abs(start_s) >= MIN_START_S and not similar and name not in given:
            yield finding(STARTS, "video-start", sensors=[name], start_s=start_s)


def _units(sources: Sequence[CameraSource]) -> Iterator[Check]:
    """Yield a finding for each time stamp file with a duration that differs from the video's by a factor of units."""
    for source in sources:
        table, rate, frames = source.times.table_ns, source.decoder.rate_hz, source.decoder.frames
        if table is None or len(table) < 2 or not rate or not frames or not source.times.source.startswith("sidecar"):
            continue
        ratio = float(table[-1] - table[0]) / (len(table) - 1) * rate / NS
        if is_unit_factor(ratio):
            yield finding(SIDECARS, "time-stamps-unit", sensors=[source.name], ratio=ratio, other="its video")


def _counted(times: Mapping[str, FrameTimes]) -> Iterator[Check]:
    """Yield a finding for the cameras of which boxes have the number of the frame, and nothing else, as time."""
    own = {n: t.table_ns for n, t in times.items() if t.source == COLUMN_OF_TIMES and t.table_ns is not None}
    names = [n for n, t in own.items() if len(t) >= MIN_COUNTED and (np.diff(t) == NS).all()]
    if names:
        yield finding(SIDECARS, "times-count-frames", sensors=names)


def _restarts(survey: BoxSurvey) -> Iterator[Check]:
    """Yield a finding for each camera with frame numbers of boxes that restart.

    The cause is a counter that overflows at a power of two, or files that were joined.
    """
    for name, (line, before, after) in survey.restarts.items():
        if bits := counter_bits(before, after):
            yield finding(
                ENDS,
                "boxes-counter-restart",
                sensors=[name],
                line=line,
                before=before,
                after=after,
                bits=bits,
                count=2**bits,
            )
        else:
            yield finding(ENDS, "boxes-restart", sensors=[name], line=line, before=before, after=after)


def _ends(plan: IngestPlan, sources: Sequence[CameraSource], survey: BoxSurvey | None) -> Iterator[Check]:
    """Yield a finding for each camera with boxes that end long before its pictures, as if frames had been skipped.

    The last boxes are missing from more than `MAX_BOXLESS_SHARE` of the frames.

    Args:
        plan: nothing is reported if it selects frames.
        sources: cameras that have pictures and boxes.
        survey: of the boxes; None: there are none.
    """
    for source in sources if survey is not None and not plan.frames else ():
        frames, stop = source.decoder.frames or 0, survey.ranges[source.name].stop if survey is not None else 0
        if frames - stop > MAX_BOXLESS_SHARE * frames:
            stride = round(frames / stop)
            is_stride = stride > 1 and abs(frames / stop / stride - 1) < STRIDE_TOLERANCE
            hint = f"if they are of every frame in {stride}, number them so" if is_stride else "check their numbers"
            yield finding(ENDS, "boxes-end-early", sensors=[source.name], last=stop - 1, frames=frames, hint=hint)


class StampedFrames(NamedTuple):
    """Times of the consecutively numbered frames of a camera.

    Attributes:
        first: number of the first frame.
        t_ns: (n,) times of this and the following frames [ns].
        counted: a file states the numbers; otherwise they are those of the frames that were stored.
    """

    first: int
    t_ns: Ints
    counted: bool

    @property
    def stop(self) -> int:
        """Number of the last frame plus 1."""
        return self.first + len(self.t_ns)


def _stamped(
    sources: Sequence[CameraSource], survey: BoxSurvey | None, times: Mapping[str, FrameTimes]
) -> dict[str, StampedFrames]:
    """Frame numbers and times of each camera that has individual time stamps for more than `MIN_BLOCKS` frames.

    Numbers are those of the images or, without any, of the boxes. `times` has the frame times by camera.
    """
    ranges = {} if survey is None else {name: (each.start, each.stop, True) for name, each in survey.ranges.items()}
    ranges |= {source.name: (0, source.decoder.frames or 0, False) for source in sources}
    found = {}
    for name, (first, stop, counted) in ranges.items():
        table = times[name].table_ns if name in times else None
        if table is not None and min(stop, len(table)) - first > MIN_BLOCKS:
            found[name] = StampedFrames(first, table[first:stop], counted)
    return found


def clock_faults(stamped: Mapping[str, StampedFrames]) -> Iterator[Check]:
    """Yield findings on cameras with a clock that jumps, drifts or is offset against those of the other cameras.

    The times of frames of equal numbers are compared pairwise; a camera is reported if it differs from most others.
    """
    drifts: dict[str, list[tuple[str, float]]] = {}
    offset: set[str] = set()
    for name, own in stamped.items():
        changes = {other: _change(own, each) for other, each in stamped.items() if other != name}
        steps = [change.step_s for change in changes.values() if change.step_s > 0.0]
        if 2 * len(steps) >= len(changes) and steps:
            step_s, time = float(np.median(steps)), utc(int(own.t_ns[np.argmax(np.diff(own.t_ns))]))
            yield finding(CLOCKS, "clock-jump", "warning", sensors=[name], jump_s=step_s, time=time, cause="")
        drifting = [(other, 1e6 * change.drift) for other, change in changes.items() if change.drift]
        if 2 * len(drifting) > len(changes):
            drifts[name] = drifting
        others = [other for other in stamped if other != name and other not in offset]
        starts_s = [start_s for other in others if cause_of(start_s := _begins_later(own, stamped[other]))]
        if 2 * len(starts_s) > len(others) and not steps and not drifting:
            offset.add(name)
            start_s, cause = float(np.median(starts_s)), cause_of(starts_s[0])
            words, other = offset_words(start_s), listed(others)
            yield finding(CLOCKS, "clock-offset", sensors=[name], offset_s=start_s, other=other, cause=cause, **words)
    if len(stamped) == 2 and drifts:
        drifts.popitem()  # either may be the one
    for name, drifting in drifts.items():
        drift = 1e-6 * float(np.median([each for _, each in drifting]))
        compared = f"those of {listed([other for other, _ in drifting])} by the frame numbers"
        yield drift_finding(CLOCKS, name, drift, compared)


def _ends_alike(own: StampedFrames, other: StampedFrames) -> bool:
    """Whether the last frames of two cameras have the same number, to within `MAX_LATER_FRAMES`."""
    return abs(own.stop - other.stop) <= MAX_LATER_FRAMES


def _begins_later(own: StampedFrames, other: StampedFrames) -> float:
    """How much later the first frame of a camera is than that of another [s].

    0 if their last frames have different numbers, or they have no common time.
    """
    if not _ends_alike(own, other) or own.t_ns[0] > other.t_ns[-1] or other.t_ns[0] > own.t_ns[-1]:
        return 0.0
    return float(own.t_ns[0] - other.t_ns[0]) / NS


def _change(own: StampedFrames, other: StampedFrames) -> ClockChange:
    """Jump and drift of the clock of the camera `own` relative to that of `other`, by frames of the same numbers.

    Zero where they are less than `MIN_OFF_FRAMES` frame intervals, where the drift is the ratio of NTSC frame rates, or
    where too few numbers are common.
    """
    first = max(own.first, other.first)
    count = min(own.stop, other.stop) - first
    similar = _ends_alike(own, other)
    if count < MIN_BLOCKS or not (similar or own.counted):
        return ClockChange(0.0, 0, 0.0)
    stride = max(count // MAX_COMPARED, 1)
    mine, its = (each.t_ns[first - each.first :][:count:stride] for each in (own, other))
    t_s, offset_s = (its - its[0]) / NS, ((mine - mine[0]) - (its - its[0])) / NS
    found, least_s = change_of(t_s, offset_s), MIN_OFF_FRAMES * float(np.median(np.diff(its))) / NS / stride
    rates = abs(abs(1e6 * found.drift) - NTSC_PPM) < NTSC_TOLERANCE_PPM
    drifts = similar and abs(found.drift) * t_s[-1] >= least_s and not rates
    return found._replace(
        step_s=found.step_s if abs(found.step_s) > least_s else 0.0, drift=found.drift if drifts else 0.0
    )

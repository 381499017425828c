"""Checks of the times in a new recording: disjoint sensors, jumps, a truth with other times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import NS, Ints, Ints32
from occlog.consistency.clock_offsets import cause_of
from occlog.consistency.frozen import MAX_LAG_NS, FrozenCameras, RepeatedBoxes
from occlog.io.files.timing.frame_times import is_unit_factor
from occlog.io.files.timing.utc import utc
from occlog.io.recording.writer import RecordingWriter
from occlog.records.columns import ColumnTable
from occlog.records.tables import Boxes, Doa, Positions, Truth, TruthBoxes
from occlog.records.verdicts import Check, Severity, finding, outcome

SENSORS, FRAMES, TRUE, RATES = "sensor clocks", "frame intervals", "truth times", "frame rates"
FROZEN, REPEATED = "repeated frames", "repeated boxes"
"""Names of checks."""
FRAMES_APART_NS, ROWS_APART_NS = 60 * NS, 3600 * NS
"""Gap above which a sensor's times count as disjoint, if also above the others' duration; rows are only where
something was detected."""
MIN_RATE_HZ, MAX_RATE_HZ = 0.5, 240.0
"""Frame rates [Hz] at which people can be tracked, and which cameras have."""
MAX_TRUE_RATE_HZ = 2000.0
"""Rate of true positions [Hz] above which their times have another unit: those of days are some 100,000 Hz."""
FEWEST, JUMP, JUMP_NS = 20, 0.5, 60 * NS
"""Minimum number of frames for a check; share of the duration and minimum length [ns] of an interval that is a jump."""


MIN_LATER_NS, ALIKE = NS, 0.05
"""A sensor without frames was set forward if it ends later than all others by this [ns] and by its longest interval,
with this relative difference."""


@dataclass
class TimeSpanNs:
    """First and last of some times [ns]; first > last if there is none."""

    first: int = 2**63
    last: int = -(2**63)

    def take(self, first: int, last: int) -> None:
        """Extend the span to include the times `first` and `last` [ns]."""
        self.first, self.last = min(self.first, first), max(self.last, last)

    def __str__(self) -> str:
        """Format both times for messages."""
        return f"{utc(self.first)} to {utc(self.last)}"


@dataclass
class EventTimes(TimeSpanNs):
    """Time range, number and largest interval of the times of rows or frames that are added in order.

    Attributes:
        count: number of different times.
        longest: largest interval between successive times [ns].
        before: time before the largest interval [ns].
    """

    count: int = 0
    longest: int = 0
    before: int = 0

    def add(self, t_ns: Ints) -> None:
        """Add sorted times (n,) [ns], n > 0; the first may equal the last one that was added before."""
        whole = t_ns if not self.count else np.concatenate([[self.last], t_ns])
        if len(whole) > 1:
            k = int(np.argmax(np.diff(whole)))
            if whole[k + 1] - whole[k] > self.longest:
                self.longest, self.before = int(whole[k + 1] - whole[k]), int(whole[k])
        self.count += len(t_ns) - int(t_ns[0] == self.last)
        self.take(int(t_ns[0]), int(t_ns[-1]))

    @property
    def rate_hz(self) -> float:
        """Mean number of times per second [Hz], with the longest interval omitted."""
        return (self.count - 2) * NS / max(self.last - self.first - self.longest, 1)


@dataclass
class Times:
    """Times of all data written to a recording, by sensor, for checks of clocks and rates.

    Attributes:
        frames: times of the frames of each camera.
        rows: times of the rows of boxes, positions and directions of each sensor.
        rates: sensors with rows for each of their frames, so that rows give the frame rate.
        true: time span of the truth.
        true_rate_hz: rate of true positions [Hz]: median rate of the target with most rows in a table, maximum over
            tables.
        pictures: repeated images of cameras.
        boxes: repeated boxes of cameras.
        repeated: boxes that a detector holds, or that a part of a video repeats.
    """

    frames: dict[str, EventTimes] = field(default_factory=dict)
    rows: dict[str, EventTimes] = field(default_factory=dict)
    rates: set[str] = field(default_factory=set)
    true: TimeSpanNs = field(default_factory=TimeSpanNs)
    true_rate_hz: float = 0.0
    pictures: FrozenCameras = field(default_factory=FrozenCameras)
    boxes: FrozenCameras = field(default_factory=FrozenCameras)
    repeated: RepeatedBoxes = field(default_factory=RepeatedBoxes)

    def table(self, table: ColumnTable) -> None:
        """Add the times of a table's rows; repeated boxes of a camera are noted, too.

        Tables other than truth, boxes, directions and positions are ignored.
        """
        if not len(table):
            return
        t_ns: Ints = table.t_ns  # type: ignore[attr-defined]
        if isinstance(table, Truth | TruthBoxes):
            self.true.take(int(t_ns.min()), int(t_ns.max()))
            self.true_rate_hz = max(self.true_rate_hz, _rate_hz(t_ns, table.target_id))
        elif isinstance(table, Boxes | Doa | Positions):
            for name in dict.fromkeys(table.sensor.tolist()):
                mine = table.sensor == name
                self.rows.setdefault(name, EventTimes()).add(np.unique(t_ns[mine]))
                if not isinstance(table, Doa):
                    self.rates.add(name)
            if isinstance(table, Boxes):
                self.boxes.add_boxes(table)
                self.repeated.add_boxes(table)

    def checks(self) -> tuple[Check, ...]:
        """Checks of the added times: sensor clocks, frame intervals, truth times, frame rates and repeated frames."""
        several = "" if max(len(self.frames), len(self.rows)) > 1 else "there is one sensor"
        rated = any(each.count >= FEWEST for each in (*self.frames.values(), *(self.rows[n] for n in self.rates)))
        rated = rated or self.true_rate_hz > MAX_TRUE_RATE_HZ
        long = any(own.count >= FEWEST for own in (*self.frames.values(), *self.rows.values()))
        truth = "" if self.true.first <= self.true.last and (self.frames or self.rows) else "there is no truth"
        units = {check.sensors[0]: check for times in (self.frames, self.rows) for check in _units(times)}
        similar = [{n: own for n, own in each.items() if n not in units} for each in (self.frames, self.rows)]
        disjoint = (*units.values(), *_apart(similar[0], FRAMES_APART_NS), *_apart(similar[1], ROWS_APART_NS))
        return (
            *outcome(SENSORS, disjoint, unless=several),
            *outcome(FRAMES, self._jumps(), unless="" if long else f"no sensor has {FEWEST} times"),
            *outcome(TRUE, () if truth else self._of_truth(), unless=truth),
            *outcome(RATES, self._rates(), unless="" if rated else f"no sensor has {FEWEST} frames"),
            *outcome(FROZEN, self._frozen(), unless=several),
            *outcome(REPEATED, self._repeated()),
        )

    def _rates(self) -> Iterator[Check]:
        """Yield a finding for each sensor with an implausible frame rate, which suggests a wrong time unit.

        Also for the truth.
        """
        for name, own in sorted({**{n: self.rows[n] for n in self.rates}, **self.frames}.items()):
            if own.count >= FEWEST and not MIN_RATE_HZ <= own.rate_hz <= MAX_RATE_HZ:
                rate_hz, least, most = own.rate_hz, MIN_RATE_HZ, MAX_RATE_HZ
                yield finding(RATES, "rate-implausible", sensors=[name], rate_hz=rate_hz, least=least, most=most)
        if self.true_rate_hz > MAX_TRUE_RATE_HZ:
            yield finding(RATES, "truth-rate-implausible", rate_hz=self.true_rate_hz, most=MAX_TRUE_RATE_HZ)

    def _frozen(self) -> Iterator[Check]:
        """Yield a finding for each run of frames in which a camera repeats one image or the same boxes."""
        for run in (*self.pictures.found(), *self.boxes.found()):
            yield finding(
                FROZEN,
                "camera-frozen",
                sensors=[run.camera],
                count=run.frames,
                duration_s=(run.last_ns - run.first_ns) / NS,
                time=utc(run.first_ns),
            )

    def _repeated(self) -> Iterator[Check]:
        """Yield findings on boxes that are held for several frames, and on those of a video that was played again."""
        for n, names in self.repeated.held().items():
            lag_ns = self.repeated.lag_ns(names, n)
            severity: Severity | None = None if lag_ns > MAX_LAG_NS else "note"
            lag_s, allowed = lag_ns / NS, MAX_LAG_NS / NS
            yield finding(REPEATED, "boxes-repeated", severity, sensors=names, n=n, lag_s=lag_s, allowed=allowed)
        for part in self.repeated.looped():
            yield finding(
                REPEATED,
                "boxes-looped",
                sensors=[part.camera],
                count=part.frames,
                time=utc(part.first_ns),
                later_s=part.later_ns / NS,
            )

    def _jumps(self) -> Iterator[Check]:
        """Yield findings on jumps of clocks.

        A camera's clock jumps if one interval is longer than half of its whole duration, and than 60 s. The clock of a
        sensor without frames was set forward if it ends later than all others by about its longest interval.
        """
        for name, times in sorted(self.frames.items()):
            if times.count >= FEWEST and times.longest > max(JUMP * (times.last - times.first), JUMP_NS):
                yield finding(
                    FRAMES,
                    "clock-jump",
                    sensors=[name],
                    jump_s=times.longest / NS,
                    time=utc(times.before),
                    cause=cause_of(times.longest / NS),
                )
        for name, own in sorted(self.rows.items()):
            last = max((each.last for other, each in self.rows.items() if other != name), default=own.last)
            later = own.last - last
            set_forward = later > MIN_LATER_NS and abs(later - own.longest) < ALIKE * own.longest
            if name not in self.rates and own.count >= FEWEST and set_forward:
                jump_s, time = own.longest / NS, utc(own.before)
                yield finding(FRAMES, "clock-jump", "warning", sensors=[name], jump_s=jump_s, time=time, cause="")

    def _of_truth(self) -> Iterator[Check]:
        """Yield a finding if the truth has no time in common with any measurement."""
        measured = TimeSpanNs()
        for own in (*self.frames.values(), *self.rows.values()):
            measured.take(own.first, own.last)
        apart_ns = max(measured.first - self.true.last, self.true.first - measured.last)
        if apart_ns > 0:
            yield finding(TRUE, "truth-times-disjoint", separation_s=apart_ns / NS)


def _rate_hz(t_ns: Ints, target_id: Ints32) -> float:
    """Median rate [Hz] of rows of the target with the most rows; 0 if it has fewer than `FEWEST`.

    Args:
        t_ns: (N,) times of rows [ns].
        target_id: (N,) targets of the rows; those below 0 are ignored.
    """
    targets, counts = np.unique(target_id[target_id >= 0], return_counts=True)
    if not len(targets) or counts.max() < FEWEST:
        return 0.0
    steps = np.diff(np.sort(t_ns[target_id == targets[np.argmax(counts)]]))
    return NS / max(float(np.median(steps)), 1.0)


class TimedWriter(RecordingWriter):
    """Writer of a recording that also adds the times of frames and rows to `times`, which must be set before use."""

    times: Times

    def image(self, sensor: str, t_ns: int, index: int, data: bytes, kind: str) -> None:
        """Write a compressed image, and note its time and content.

        Args:
            sensor: name of the camera.
            t_ns: time [ns since the Unix epoch].
            index: number of the frame, from 0.
            data: the compressed image.
            kind: its format, as `jpeg`.
        """
        self.times.frames.setdefault(sensor, EventTimes()).add(np.array([t_ns]))
        self.times.pictures.add(sensor, t_ns, hash(data))
        super().image(sensor, t_ns, index, data, kind)

    def video_frame(self, sensor: str, t_ns: int, index: int) -> None:
        """Write and note the time `t_ns` [ns] of the frame `index` (from 0) of the linked video of a camera."""
        self.times.frames.setdefault(sensor, EventTimes()).add(np.array([t_ns]))
        super().video_frame(sensor, t_ns, index)

    def table(self, table: ColumnTable) -> None:
        """Write the rows of a table, and note their times."""
        self.times.table(table)
        super().table(table)


def _units(times: Mapping[str, EventTimes]) -> Iterator[Check]:
    """Yield a finding for each sensor with a duration that differs from the others' by the factor of a time unit.

    A factor of 1000, for instance, suggests ms read as s; a shorter duration is reported only among at least three
    sensors.
    """
    spans = {name: float(own.last - own.first) for name, own in times.items() if own.count >= FEWEST}
    for name, span in sorted(spans.items()):
        usual = float(np.median([each for other, each in spans.items() if other != name] or [0.0]))
        ratio = span / usual if usual > 0.0 else 1.0
        if is_unit_factor(ratio) and (ratio > 1.0 or len(spans) > 2):
            yield finding(SENSORS, "time-stamps-unit", sensors=[name], ratio=ratio, other="the others")


def _apart(times: Mapping[str, TimeSpanNs], least: int) -> Iterator[Check]:
    """Yield a finding for each sensor with times that do not overlap with those of any other sensor, and are far away.

    Far is more than `least` [ns] and than the duration of the others together; or the offset is a known difference of
    clocks, such as a time zone.
    """
    for name, own in sorted(times.items()):
        others = [each for other, each in times.items() if other != name]
        far = min((max(each.first - own.last, own.first - each.last) for each in others), default=0)
        if far <= 0:
            continue
        begin, end = min(each.first for each in others), max(each.last for each in others)
        offset_s = (own.first - begin) / NS
        cause = cause_of(offset_s)
        if far > max(least, end - begin) or cause:
            yield finding(SENSORS, "sensor-times-disjoint", sensors=[name], offset_s=offset_s, cause=cause)

"""Frozen sensors: a stream that repeats one frame or value, after it has lost its source, while others continue.

Values of a sensor that is quantised coarsely, or without noise, repeat rightly, above all of a target that stands. A
repeated value is judged only where the sensor otherwise has noise of several of its resolutions: its differences of
fourth order are larger than those of third order (those of a smooth path are smaller), and few values repeat.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.records.declared.sensors import Measurements
from occlog.records.tables import Bearings, Boxes
from occlog.records.verdicts import Check, finding, outcome

MIN_FROZEN_NS, MIN_FROZEN_FRAMES = 3 * NS, 10
"""Duration [ns] and number of identical frames from which a camera counts as frozen."""
MAX_COMMON_SHARE = 0.5
"""Share of that time in which another camera may be frozen, too, and still counts as moving."""
MIN_BLOCKS, MIN_BLOCK_SHARE = 10, 0.9
"""Blocks of frames with equal boxes, and share of them with the same number of frames, from which a detector holds."""
MAX_LAG_NS = NS // 10
"""Time for which a detector may hold boxes [ns]: those of a video with each frame twice are no fault."""
MIN_LOOP_FRAMES, MIN_LOOP_SHARE = 30, 0.9
"""Different frames that are repeated, and share of the frames meanwhile, from which a video was played again."""
MAX_FRAMES = 200_000
"""Frames of a camera that are compared, the first ones."""
FROZEN = "repeated values"
"""Name of the check of values."""
MAX_VALUES = 100_000
"""Values of a sensor and target that are checked, the first ones."""
MIN_NOISY, MAX_REPEATED_SHARE = 20, 0.05
"""Values outside of the run that are needed, and share of them that may repeat the one before."""
MIN_NOISE_STEPS, MIN_ROUGHNESS = 5.0, 1.2
"""Median second difference, in resolutions of the values, and median fourth difference over the third, from which a
sensor has noise that two successive values hardly share. For white noise the ratio is 1.87."""


def frame_contents(boxes: Boxes) -> Iterator[tuple[str, int, Hashable]]:
    """Generate camera, time [ns] and content of complete frames, by camera and time; None: the frame has no boxes.

    Contents are equal if number and sums of boxes are.
    """
    for name in np.unique(boxes.sensor).tolist():
        own = boxes.take(np.flatnonzero(boxes.sensor == name))
        first = np.flatnonzero(np.diff(own.t_ns, prepend=-1) != 0)
        edges = np.column_stack([own.left_px, own.top_px, own.width_px, own.height_px])
        sums = np.add.reduceat(edges, first) if len(first) else edges
        counts = np.diff(np.append(first, len(own)))
        for t_ns, count, values in zip(own.t_ns[first].tolist(), counts.tolist(), sums.tolist(), strict=True):
            yield name, t_ns, (count, *values) if values[0] == values[0] else None


class FrozenFrames(NamedTuple):
    """A run of identical frames of one camera: first and last time [ns], and number of frames."""

    camera: str
    first_ns: int
    last_ns: int
    frames: int


@dataclass
class _CameraRuns:
    """State of one camera: content of its last frame, current run of identical frames, and earlier long runs (`runs`).

    `first_ns` and `last_ns` are the times of its first and last frame [ns].
    """

    first_ns: int
    last_ns: int
    content: Hashable = None
    run: FrozenFrames | None = None
    runs: list[FrozenFrames] = field(default_factory=list)


class FrozenCameras:
    """Finds runs of identical frames of each camera; frames of a camera are added in the order of time."""

    def __init__(self) -> None:
        """Start without frames."""
        self._cameras: dict[str, _CameraRuns] = {}

    def add(self, camera: str, t_ns: int, content: Hashable) -> None:
        """Add the next frame of a camera at time `t_ns` [ns].

        `content` is equal for frames with equal pictures or boxes, None if the frame is empty.
        """
        known = self._cameras.setdefault(camera, _CameraRuns(t_ns, t_ns))
        if known.run is not None and content is not None and content == known.content:
            known.run = known.run._replace(last_ns=t_ns, frames=known.run.frames + 1)
        else:
            self._end(known)
            known.content, known.run = content, FrozenFrames(camera, t_ns, t_ns, 1)
        known.last_ns = t_ns

    def add_boxes(self, boxes: Boxes) -> None:
        """Add the boxes of complete frames, in the order of time; frames are equal if number and sums of boxes are."""
        for name, t_ns, content in frame_contents(boxes):
            self.add(name, t_ns, content)

    def found(self) -> Iterator[FrozenFrames]:
        """Generate the longest run of each camera that is frozen while another camera is not.

        Cameras without such a run are skipped. Call it after the last frame.
        """
        for known in self._cameras.values():
            self._end(known)
        for name, known in sorted(self._cameras.items()):
            runs = [run for run in known.runs if any(self._moves(o, run) for o in self._cameras if o != name)]
            if runs:
                yield max(runs, key=lambda run: run.last_ns - run.first_ns)

    def _moves(self, camera: str, run: FrozenFrames) -> bool:
        """Return whether `camera` has frames during the run of another camera, most of which differ from each other."""
        other = self._cameras[camera]
        common = min(run.last_ns, other.last_ns) - max(run.first_ns, other.first_ns)
        still = sum(max(min(run.last_ns, o.last_ns) - max(run.first_ns, o.first_ns), 0) for o in other.runs)
        return common >= MIN_FROZEN_NS and still <= MAX_COMMON_SHARE * common

    @staticmethod
    def _end(known: _CameraRuns) -> None:
        """End the current run of identical frames of a camera, and keep it if it is long enough."""
        run = known.run
        if run is not None and run.last_ns - run.first_ns >= MIN_FROZEN_NS and run.frames >= MIN_FROZEN_FRAMES:
            known.runs.append(run)
        known.run = None


class RepeatedPart(NamedTuple):
    """Part of a camera's boxes that repeats an earlier part, frame by frame.

    `first_ns` is its first time [ns], `frames` are its frames with boxes that are repeated, `later_ns` is how much
    later they are [ns].
    """

    camera: str
    first_ns: int
    frames: int
    later_ns: int


class RepeatedBoxes:
    """Finds boxes that a detector holds for several frames, and those of a video that was played again."""

    def __init__(self) -> None:
        """Start without frames."""
        self._frames: dict[str, list[tuple[int, Hashable]]] = {}

    def add_boxes(self, boxes: Boxes) -> None:
        """Add the boxes of complete frames, in the order of time."""
        for name, t_ns, content in frame_contents(boxes):
            own = self._frames.setdefault(name, [])
            if len(own) < MAX_FRAMES:
                own.append((t_ns, content if content is None else hash(content)))

    def held(self) -> dict[int, list[str]]:
        """Return the cameras with boxes that change in every n-th frame only, by n > 1."""
        out: dict[int, list[str]] = {}
        for name, own in sorted(self._frames.items()):
            contents = [content for _, content in own]
            starts = [n for n in range(len(own)) if not n or contents[n] != contents[n - 1]]
            # The first and the last may be cut off, and frames without boxes may be missing
            ends = [*starts[1:], len(own)]
            blocks = [(a, b) for a, b in zip(starts[1:-1], ends[1:-1], strict=True) if contents[a] is not None]
            lengths = Counter(b - a for a, b in blocks)
            n, count = max(lengths.items(), key=lambda each: each[1], default=(1, 0))
            if n > 1 and count >= MIN_BLOCKS and count >= MIN_BLOCK_SHARE * len(blocks):
                out.setdefault(n, []).append(name)
        return out

    def lag_ns(self, cameras: Iterable[str], n: int) -> float:
        """Return how long the boxes of cameras are held [ns] if they change in every n-th frame: n - 1 intervals."""
        intervals = [np.median(np.diff([t_ns for t_ns, _ in self._frames[name]])) for name in cameras]
        return float(max(intervals)) * (n - 1)

    def looped(self) -> Iterator[RepeatedPart]:
        """Generate the part of each camera that repeats an earlier one, while other cameras do not repeat theirs."""
        found = {name: self._repeated(name) for name in sorted(self._frames)}
        for part in found.values():
            if part is None:
                continue
            others = [name for name, each in found.items() if each is None or each.later_ns != part.later_ns]
            if any(t_ns >= part.first_ns and content is not None for o in others for t_ns, content in self._frames[o]):
                yield part

    def _repeated(self, name: str) -> RepeatedPart | None:
        """Return the part of a camera's boxes that repeats an earlier one with most frames; None without any."""
        own = [(n, t_ns, content) for n, (t_ns, content) in enumerate(self._frames[name]) if content is not None]
        first: dict[Hashable, int] = {}
        again: dict[int, list[int]] = {}  # number of the frame, by how many frames it is later
        before: Hashable = None
        for n, _, content in own:
            if content != before and first.setdefault(content, n) < n:
                again.setdefault(n - first[content], []).append(n)
            before = content
        later, frames = max(again.items(), key=lambda each: len(each[1]), default=(0, []))
        if len(frames) < MIN_LOOP_FRAMES:
            return None
        during = sum(frames[0] <= n <= frames[-1] for n, _, _ in own)
        if len(frames) < MIN_LOOP_SHARE * during:
            return None
        times = [t_ns for t_ns, _ in self._frames[name]]
        return RepeatedPart(name, times[frames[0]], len(frames), times[frames[0]] - times[frames[0] - later])


class FrozenValues:
    """Finds bearings or ranges of a sensor that repeat one value to all digits, while those of others change."""

    def __init__(self) -> None:
        """Start without values."""
        self._kept: dict[tuple[str, int, str], list[tuple[Ints, Floats]]] = {}  # of what, target and sensor
        self._counts: dict[tuple[str, int, str], int] = {}

    def watch(self, chunks: Iterable[Bearings]) -> Iterator[Bearings]:
        """Generate the chunks unchanged, and collect their bearings."""
        for chunk in chunks:
            self._collect("bearings", chunk, chunk.bearing, chunk.seen & np.isfinite(chunk.bearing))
            yield chunk

    def watch_ranges(self, chunks: Iterable[Measurements]) -> Iterator[Measurements]:
        """Generate the chunks unchanged, and collect their ranges."""
        for chunk in chunks:
            self._collect("ranges", chunk, chunk.range, np.isfinite(chunk.range))
            yield chunk

    def _collect(self, what: str, table: Bearings | Measurements, values: Floats, use: Bools) -> None:
        """Collect values (N,) of the rows to use (N,), `MAX_VALUES` of each sensor and target at most."""
        rows = np.flatnonzero(use)
        if not len(rows):
            return
        target, (names, sensor) = table.target_id[rows], np.unique(table.sensor[rows], return_inverse=True)
        order = np.lexsort((sensor, target))  # stable: times stay in order
        cuts = np.flatnonzero((np.diff(target[order]) != 0) | (np.diff(sensor[order]) != 0)) + 1
        for own in np.split(order, cuts):
            key = (what, int(target[own[0]]), str(names[sensor[own[0]]]))
            if self._counts.get(key, 0) < MAX_VALUES:
                self._counts[key] = self._counts.get(key, 0) + len(own)
                self._kept.setdefault(key, []).append((table.t_ns[rows[own]], values[rows[own]]))

    def checks(self) -> tuple[Check, ...]:
        """Return the check, with a finding for each sensor that repeats one value while others change."""
        several = len({name for _, _, name in self._kept}) > 1
        return outcome(FROZEN, self._findings(), unless="" if several else "there is one sensor")

    def _findings(self) -> Iterator[Check]:
        """Generate a finding for the longest run of each sensor; times are from the first value of all."""
        series = {
            key: (np.concatenate([t for t, _ in kept]), np.concatenate([v for _, v in kept]))
            for key, kept in self._kept.items()
        }
        begin_ns = min((int(t_ns[0]) for t_ns, _ in series.values()), default=0)
        named: set[str] = set()
        for what, target in dict.fromkeys((what, target) for what, target, _ in series):
            own = {name: series[what, target, name] for w, t, name in series if (w, t) == (what, target)}
            if not any(_may_repeat(*each) for each in own.values()):
                continue
            frozen = FrozenCameras()
            for name, (t_ns, values) in own.items():
                # Where a frame has several values, none is followed
                alone = (np.diff(t_ns, prepend=-1) != 0) & (np.diff(t_ns, append=-1) != 0)
                for t, value, single in zip(t_ns.tolist(), values.tolist(), alone.tolist(), strict=True):
                    frozen.add(name, t, value if single else None)
            for run in frozen.found():
                t_ns, values = own[run.camera]
                if run.camera not in named and _noisy(values, (t_ns >= run.first_ns) & (t_ns <= run.last_ns)):
                    named.add(run.camera)
                    begin_s, duration_s = (run.first_ns - begin_ns) / NS, (run.last_ns - run.first_ns) / NS
                    yield finding(
                        FROZEN,
                        "sensor-frozen",
                        sensors=[run.camera],
                        count=run.frames,
                        duration_s=duration_s,
                        begin_s=begin_s,
                        what=what,
                    )


def _may_repeat(t_ns: Ints, values: Floats) -> bool:
    """Return whether some value (N,) at times (N,) [ns] is repeated for as long as a frozen sensor does."""
    edges = np.flatnonzero(np.diff(values) != 0.0).tolist()
    runs = pairwise([-1, *edges, len(values) - 1])
    return any(b - a >= MIN_FROZEN_FRAMES and t_ns[b] - t_ns[a + 1] >= MIN_FROZEN_NS for a, b in runs)


def _noisy(values: Floats, run: Bools) -> bool:
    """Return whether values (N,) outside of a run (N,) have noise far above their resolution.

    Bearings are continuous there: a turn more or less only adds a few outliers to the medians.
    """
    outside = values[~run]
    if len(outside) < MIN_NOISY or np.mean(np.diff(outside) == 0.0) > MAX_REPEATED_SHARE:
        return False
    second, third, fourth = (np.median(np.abs(np.diff(outside, n))) for n in (2, 3, 4))
    # Steps of rounding in other units are not equal to the last bits
    gaps = np.diff(np.unique(outside))
    resolution = gaps[gaps > 1e-9 * np.ptp(outside)].min()
    return bool(second >= MIN_NOISE_STEPS * resolution and fourth >= MIN_ROUGHNESS * third)

"""Search for mistakes of a set-up that explain boxes that do not fit.

Wrong extrinsics, clocks or image sizes, or exchanged files. Each camera locates people by itself; they are projected
into the other cameras (`pair_overlap`) with the calibration as given, and with each usual mistake undone. The mistake
is reported for which most projections overlap a box.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.core.geometry.camera import array_rotation
from occlog.records.scene import Camera

from ..frame_detections import FrameDetectionsWithIds
from .pair_errors import (
    FOCAL,
    HEIGHT,
    LATE,
    MIN_LOG_RATIO,
    MIN_LOG_RATIO_ROTATED,
    RADIAL,
    YAW,
    CameraError,
    camera_errors,
    fit_pairs,
    lens_matters,
    lens_offset,
    rotation,
    without_radial_error,
)
from .pair_overlap import (
    BODY_HEADS,
    BoxesOfCamera,
    Overlap,
    PairOverlaps,
    clearly_larger,
    in_image,
    located,
    paired_rows,
    person_heights,
    projected_people,
)

MAX_STEPS = 240
"""Time steps that are kept; beyond that every second one is dropped."""
MAX_BOXES = 1000
"""Boxes of all cameras, about, that are compared: of fewer time steps in crowds."""
MAX_BOXES_OF_PAIRS = 2000
"""Boxes of all cameras, about, from which errors are estimated by pairs of cameras."""
MIN_EXPECTED = 40
"""People expected in the images of others, at least, of a camera that is judged."""
LOW_SHARE, LOW = 0.8, 0.6
"""Where something is wrong, a camera is examined if its agreement is below this share of that of the best camera, or
below this value; sound cameras have 0.6 to 0.85."""
MIN_FIT, MIN_MORE = 0.3, 0.2
"""Least agreement with a mistake mended, and how much more that is than without: shares beyond those by chance."""
MIN_RATE_FIT = 0.5
"""Least agreement with another frame rate of a camera."""
MIN_PAIRED = 0.45
"""Least agreement of cameras that are compared by pairs of boxes: in dense crowds many boxes fit another person."""
SIMPLER = 0.01
"""Mean overlap by which a mistake must be better than one that is tried before it."""
FLIPS = {"mirrored": (True, False), "turned by 180 degrees": (True, True), "upside down (y from below)": (False, True)}
"""Mistakes with images: whether x and y are flipped."""
INVERTED = "inverted (camera-to-world for world-to-camera)"
SCALES = (0.5, 2.0, 2.0 / 3.0, 1.5, 0.75, 4.0 / 3.0, 1.0 / 3.0, 3.0, 0.25, 4.0)
"""Factors between sizes of images."""
SIZED = "about their centres"
SIZES = (1.0 / 1.3, 1.3, 1.0 / 1.15, 1.15, 1.0 / 1.5, 1.5)
"""Factors between right and given sizes of boxes about their centres."""
RATES = (2.0, 0.5, 1.2, 1.0 / 1.2, 1.5, 1.0 / 1.5, 2.5, 0.4, 3.0, 1.0 / 3.0, 4.0, 0.25, 5.0, 0.2)
"""Factors between right and given intervals of the frames of a camera."""
TURNS_DEG = (180.0, 90.0, -90.0)
"""Mistakes with the yaw of a camera."""
LATE_S = (0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0)
"""Delays that are tried, rounded to time steps."""
MAX_TURN, TURN_CELL, MIN_TURN = np.radians(9.0), np.radians(1.0), np.radians(1.0)
"""Largest rotation of a camera that is searched for, size of the cells of the search, and smallest that is stated."""
REFINEMENTS = 5
"""Medians of the differences within a cell about the one before."""
WINDOW_S, MIN_WINDOWS, MAX_WINDOWS = 1.5, 6, 24
"""Duration of the parts of a recording that are compared, and their number."""
MIN_FOCAL, MIN_RAISED, MIN_ROTATION, MIN_LATE_S = 0.02, 0.06, math.radians(0.4), 0.03
"""Least errors of calibrations that are stated: share of the focal length, height of a camera in heights of people,
rotation [rad], and delay [s]."""
MIN_GAP_S, MIN_GAP_FRAMES = 2.0, 10.0
"""Shortest time without a box that is stated, also in intervals between frames with boxes."""
MIN_IN_WINDOW, BAD_SHARE = 12, 0.55
"""People expected in a part that is judged, and share of the usual agreement below which it is bad."""


class FittingChange(NamedTuple):
    """A correction of cameras after which their boxes overlap the people that the other cameras locate.

    Attributes:
        cameras: indices of the cameras that are changed.
        words: description of the mistake, for a message.
        fit: share, after the correction, of the people expected in an image that overlap a box there.
        now: that share with the cameras as given.
    """

    cameras: tuple[int, ...]
    words: str
    fit: float
    now: float


class DetectionGap(NamedTuple):
    """An interval in which a camera has no box, although other cameras detect people in its view.

    Attributes:
        camera: index of the camera.
        begin_s, end_s: first and last time step without a box [s], after the first time step of the recording.
        people: number of detections of another camera in its view meanwhile.
        share: length of the gap as a share of the recording.
    """

    camera: int
    begin_s: float
    end_s: float
    people: int
    share: float


class _Change(NamedTuple):
    """A candidate correction: its description `words`, and the corrected cameras with boxes, by camera index.

    `least` is the least agreement with it: a correction that many values are tried of agrees more often by chance.
    """

    words: str
    views: Mapping[int, BoxesOfCamera]
    least: float = MIN_FIT


class CameraFaults:
    """Keeps a sample of the boxes of a recording, and searches it for mistakes of the set-up.

    Mistakes are wrong or exchanged extrinsics, image sizes, box formats and clocks.
    """

    def __init__(self, cameras: Sequence[Camera], person_height: float = 1.7) -> None:
        """Start without boxes; `person_height` in the scene's unit."""
        self._cameras, self._height = list(cameras), person_height
        self._samples: list[tuple[int, dict[int, Floats]]] = []
        self._step = self._count = 0
        self._last: tuple[int, _Search] | None = None
        self._intervals: list[list[int]] = [[] for _ in cameras]  # of the first frames of each [ns]
        self._times = [-1] * len(self._cameras)

    def add(self, t_ns: int, frames: Sequence[FrameDetectionsWithIds]) -> None:
        """Add the boxes of one time step at `t_ns`.

        An evenly spaced subset of at most `MAX_STEPS` time steps is kept.
        """
        for c in (each.detections.camera for each in frames):
            if self._times[c] >= 0 and len(self._intervals[c]) < MAX_STEPS:
                self._intervals[c].append(t_ns - self._times[c])
            self._times[c] = t_ns
        self._count += 1
        if self._count % (1 << self._step):
            return
        boxes = {each.detections.camera: each.detections.boxes for each in frames if len(each.detections.boxes)}
        self._samples.append((t_ns, boxes))
        if len(self._samples) > MAX_STEPS:
            self._samples, self._step = self._samples[1::2], self._step + 1

    def found(self, unit: str, *, doubtful: bool) -> list[FittingChange]:
        """Corrections of the set-up that make cameras agree, the most significant first.

        Args:
            unit: length unit, for messages.
            doubtful: something is known to be wrong; otherwise only cameras that agree with none are examined.
        """
        return self._search.found(unit, doubtful=doubtful) if self._compared else []

    def errors(self, unit: str, *, rotated: bool = False) -> list[tuple[tuple[int, ...], str]]:
        """Small calibration errors: (indices of the cameras, description).

        They are too small to change the overlap of boxes much. Lasting rotations are omitted, since the filter corrects
        them, unless another error explains nearly as much.

        Args:
            unit: of lengths, for the words.
            rotated: the filter finds rotated cameras, so that something is wrong.
        """
        if not self._compared:
            return []
        out: list[tuple[tuple[int, ...], str]] = []
        errors = self._search.errors
        if rotated and not errors:
            errors = self._search.errors_of(range(len(self._cameras)), MIN_LOG_RATIO_ROTATED)[:1]
        for each in errors:
            if words := self._search.sized(each):
                out.append((each.cameras, words))
                break
            # The filter states and corrects rotations that last; what remains with them may be their consequence
            lasting = each.kind == YAW and not (each.since or each.until)
            if lasting and (each.rival is None or each.rival.kind == YAW):
                break
            cameras = dict.fromkeys(c for error in each.either for c in error.cameras)
            out.append((tuple(cameras), self._search.words_of(each, unit)))
            if lasting:
                break
        return out

    def heights(self) -> Floats:
        """Return (C,) median heights of people by the kept boxes of each camera [scene unit]; NaN: too few boxes."""
        boxes = (_of_camera(c, camera, self._samples).boxes for c, camera in enumerate(self._cameras))
        return person_heights([*boxes], self._cameras)

    def gaps(self) -> list[DetectionGap]:
        """The longest interval without boxes of each camera that has one while others detect people in its view."""
        return self._search.gaps() if self._compared else []

    @property
    def _compared(self) -> bool:
        return len(self._cameras) > 1 and len(self._samples) > 1

    @property
    def _search(self) -> _Search:
        """Search over the time steps kept so far; made once for a number of added time steps."""
        if self._last is None or self._last[0] != self._count:
            search = _Search(self._cameras, self._samples, self._height)
            search.intervals = [float(np.median(each or [0])) for each in self._intervals]
            self._last = self._count, search
        return self._last[1]


class _Search:
    """Search, over a set of time steps, for wrong poses, lenses, clocks or image sizes of cameras, and swapped files.

    People located by each camera are projected into the others; of the corrections tried, the one with which most
    projections overlap a box counts.
    """

    def __init__(
        self, cameras: Sequence[Camera], samples: Sequence[tuple[int, dict[int, Floats]]], person_height: float
    ) -> None:
        count = sum(len(each) for _, boxes in samples for each in boxes.values())
        self.t_ns: Ints = np.array([t for t, _ in samples], dtype=np.int64)
        self.height = person_height
        self.intervals = [0.0] * len(cameras)  # between frames [ns]
        self.views = [_of_camera(c, camera, samples) for c, camera in enumerate(cameras)]
        # Time steps that are compared, while boxes keep all of them: delays are searched for in small steps
        self.every = max(1, round(count / MAX_BOXES))

    def found(self, unit: str, *, doubtful: bool) -> list[FittingChange]:
        """Return mistakes that last for the whole recording; those of a part of it without any, or if they fit better.

        Args:
            unit: length unit, for messages.
            doubtful: another check has failed; otherwise only cameras that agree with no other one are examined.
        """
        trusted = list(range(len(self.views)))
        agreement = self._agreement(trusted)
        limit = max(LOW_SHARE * max(agreement), LOW) if doubtful else MIN_FIT
        low = sorted((c for c, own in enumerate(agreement) if own < limit), key=agreement.__getitem__)
        if not (doubtful or max(agreement) >= LOW or any(math.isfinite(agreement[c]) for c in low)):
            low = []  # views hardly overlap
        if max(agreement) < LOW and low and (whole := self._best(self._of_all(unit))) is not None:
            return [whole]
        out: list[FittingChange] = []
        while low and len(trusted) > 1:
            # Of two cameras that do not agree either may be wrong
            tried = low if len(trusted) == 2 else low[:1]
            corrections = [
                each for c in tried for each in self._corrections(c, unit) if set(each.views) <= set(trusted)
            ]
            # Least squares tell rotations from other small errors; the search for them does not
            searched = self._best(iter(corrections), trusted) is None
            changes = (self._changes(c, trusted, rotations=searched) for c in tried)
            best = self._best(chain(corrections, *changes), trusted)
            # A camera that agrees with none, for a reason that is not found, says nothing about the others
            wrong = best.cameras if best is not None else [c for c in tried if agreement[c] < MIN_FIT]
            out += [best] if best is not None else []
            if wrong and (best is not None or len(trusted) - len(wrong) > 1):
                trusted = [c for c in trusted if c not in wrong]
                agreement = self._agreement(trusted)
            low = [c for c in low if c not in tried and c in trusted and agreement[c] < limit]
        partial = self._for_a_while()
        better = {each.cameras: each for each in partial}
        return [max(each, better.get(each.cameras, each), key=lambda one: one.fit) for each in out] or partial

    @cached_property
    def errors(self) -> list[CameraError]:
        """Calibration errors of the fitting cameras by least squares over pairs of cameras (`pair_errors`)."""
        return self.errors_of(self._fitting)

    @cached_property
    def _fitting(self) -> tuple[int, ...]:
        """Indices of the cameras with an agreement of at least `MIN_PAIRED`.

        Boxes of other cameras would be paired by chance.
        """
        return tuple(c for c, own in enumerate(self._agreement(range(len(self.views)))) if own >= MIN_PAIRED)

    def errors_of(self, cameras: Sequence[int], least: float = MIN_LOG_RATIO) -> list[CameraError]:
        """Return calibration errors of the cameras with these indices, by least squares over their pairs.

        `least`: logarithm of the ratio of evidences from which an error is significant. [] for fewer than two cameras.
        """
        if len(cameras) < 2:
            return []
        views = [self.views[c] for c in cameras]
        every = max(1, round(sum(len(view.boxes) for view in views) / MAX_BOXES_OF_PAIRS))
        normal = fit_pairs(views, self.t_ns, self.height, every)

        def named(error: CameraError) -> CameraError:
            rival = named(error.rival) if error.rival is not None else None
            return error._replace(cameras=tuple(cameras[c] for c in error.cameras), rival=rival)

        out: list[CameraError] = []
        counts = (np.unique(view.steps, return_counts=True)[1] for view in views)
        people = max((float(np.median(each)) for each in counts if len(each)), default=1.0)
        for each in camera_errors(normal, people, lambda error: self._matters(named(error)), least):
            if each.since:
                # Boxes are paired better with one orientation of each camera; either part may be as calibrated
                ends = (0, each.since - 1), (each.since, len(self.t_ns))
                parts = ([view.during(*end) for view in views] for end in ends)
                c = each.cameras[0]
                before, after = (rotation(fit_pairs(part, self.t_ns, self.height, every), c) for part in parts)
                if np.linalg.norm(after) >= np.linalg.norm(before):
                    each = each._replace(values=after[None])
                else:
                    each = each._replace(values=before[None], since=0, until=each.since)
            out.append(named(each))
        return out

    def sized(self, error: CameraError) -> str:
        """Words for boxes of the camera of an error that are too large or small, if that explains more; else empty."""
        if error.since or error.until or error.kind not in (YAW, FOCAL, HEIGHT):
            return ""
        c, own = error.cameras[0], self.views[error.cameras[0]]
        corrected = [
            _Change("", {each.cameras[0]: self._corrected(each.cameras[0], each.kind, each.values[0])})
            for each in error.either
        ]
        forms = ((words, boxes) for words, boxes in _other_forms(own) if SIZED in words)
        sized = [
            _Change(f"boxes of {own.camera.name} are {words}", {c: own._replace(boxes=boxes)}) for words, boxes in forms
        ]
        best = self._best(chain(corrected, sized))
        return best.words if best is not None else ""

    def _matters(self, error: CameraError) -> bool:
        """Return whether a camera error is as large as the threshold of its kind from which it is reported."""
        if error.kind == RADIAL:
            pairs = zip(error.cameras, error.values[:, 0].tolist(), strict=True)
            return any(lens_matters(self.views[c], k, shared=len(error.cameras) > 1) for c, k in pairs)
        least = {YAW: MIN_ROTATION, FOCAL: MIN_FOCAL, HEIGHT: MIN_RAISED, LATE: MIN_LATE_S}[error.kind]
        return float(np.linalg.norm(error.values, axis=1).max()) >= least

    def _corrections(self, c: int, unit: str) -> Iterator[_Change]:
        """Generate candidate corrections of lasting calibration errors that concern camera `c`.

        All lenses are corrected at once, other errors one by one. `unit` is the length unit, for messages.
        """
        # Boxes of two cameras that do not agree are compared, too: overlaps show whether an error explains them
        cameras = tuple(sorted({c, *self._fitting})) if len(self.views) > 2 else (0, 1)
        errors = self.errors if cameras == self._fitting else self.errors_of(cameras)
        errors = [each for each in errors if each.kind != LATE and not (each.since or each.until)]
        lenses = [each for each in errors if each.kind == RADIAL]
        for group in (lenses, *([each] for each in errors if each.kind != RADIAL)):
            if any(c in each.cameras for each in group):
                words = " and ".join(self.words_of(each, unit) for each in group)
                pairs = [pair for each in group for pair in zip(each.cameras, each.values, strict=True)]
                yield _Change(words, {k: self._corrected(k, group[0].kind, values) for k, values in pairs})

    def _corrected(self, c: int, kind: int, values: Floats) -> BoxesOfCamera:
        """Return camera `c` with a calibration error removed.

        `kind` is `YAW`, `RADIAL`, `FOCAL` or `HEIGHT`; `values` (1 or 2,) is its size, as in `CameraError.values`.
        """
        view, value = self.views[c], float(values[0])
        if kind == RADIAL:
            return without_radial_error(view, value)
        camera = view.camera
        if kind == YAW:
            return _rotated(view, -values)
        if kind == FOCAL:
            return view._replace(camera=replace(camera, focal_px=camera.focal_px / (1.0 + value)))
        raised = np.array([0.0, 0.0, value * self.height])
        return view._replace(camera=replace(camera, position=camera.position + raised))

    def words_of(self, error: CameraError, unit: str) -> str:
        """Return the description of a camera error, and of its rival if there is one, for a message.

        `unit` is the length unit.
        """
        return ", or ".join(self.words(each, unit) for each in error.either)

    def words(self, error: CameraError, unit: str) -> str:
        """Return the description of a camera error, without its rival, for a message; `unit` of lengths."""
        c, value = error.cameras[0], float(error.values[0, 0])
        name = self.views[c].camera.name
        if error.kind == RADIAL:
            pairs = list(zip(error.cameras, error.values[:, 0].tolist(), strict=True))
            px = [lens_offset(self.views[c], k) for c, k in pairs]
            size = f"{px[0]:+.0f} px" if len(px) == 1 else f"{min(px):+.0f} to {max(px):+.0f} px"
            owner = name if len(px) == 1 else "all cameras"
            return f"the lens of {owner} is off by {size} at the border (missing, or of another model)"
        if error.kind == FOCAL:
            return f"the focal length of {name} is {abs(value):.1%} too {'long' if value > 0.0 else 'short'}"
        if error.kind == HEIGHT:
            side = "above" if value > 0.0 else "below"
            return f"{name} is {abs(value) * self.height:.2g} {unit} {side} its stated height"
        if error.kind == LATE:
            return f"the clock of {name} is {abs(value):.2g} s {'ahead' if value > 0.0 else 'behind'}"
        begin_s, end_s = (float(self.t_ns[k] - self.t_ns[0]) / NS for k in (error.since, error.until))
        when = f"from {begin_s:.1f} s on" if error.since else f"until {end_s:.1f} s" if error.until else ""
        return f"{_rotation_words(self.views[c], -error.values[0])} {when}".rstrip()

    def _agreement(self, trusted: Sequence[int]) -> list[float]:
        """Return the agreement of each camera with the cameras `trusted` (indices): chance-corrected overlap.

        -inf if too few people are expected in its image and from it in others.
        """
        found = self._own
        if len(trusted) < len(self.views):
            found = [self._overlap({c: view}, trusted) for c, view in enumerate(self.views)]
        return [each.excess if len(each.met) >= MIN_EXPECTED else -math.inf for each in found]

    @cached_property
    def _own(self) -> list[Overlap]:
        """Overlaps of each camera with all others, with the set-up as given."""
        return self._pairs.of_each()

    def gaps(self) -> list[DetectionGap]:
        """Return the longest interval without boxes of each camera that otherwise detects most people in its view."""
        at_s = (self.t_ns - self.t_ns[0]) / NS
        out: list[DetectionGap] = []
        for c, (view, found) in enumerate(zip(self.views, self._own, strict=True)):
            own = np.unique(view.steps)
            if len(own) < 2 or len(found.met) < MIN_EXPECTED or found.excess < MIN_FIT:
                continue
            spacing_s = float(np.median(np.diff(at_s[own])))
            ends = np.concatenate([[-1], own, [len(at_s)]])
            k = int(np.argmax(np.diff(ends)))
            first, last = int(ends[k]) + 1, int(ends[k + 1]) - 1
            if last < first or at_s[last] - at_s[first] < max(MIN_GAP_S, MIN_GAP_FRAMES * spacing_s):
                continue
            people = self._seen_by_others(c, first, last)
            if people >= MIN_EXPECTED:
                begin_s, end_s = float(at_s[first]), float(at_s[last])
                out.append(DetectionGap(c, begin_s, end_s, people, (end_s - begin_s) / float(at_s[-1])))
        return out

    def _seen_by_others(self, c: int, first: int, last: int) -> int:
        """Return the number of people that another camera locates in the view of camera `c` from step first to last.

        It is the maximum over the other cameras.
        """
        count = 0
        for o, other in enumerate(self.views):
            if o != c:
                people = located(other.during(first, last), self.height)
                boxes = projected_people(self.views[c].camera, people[np.isfinite(people).all(axis=1)])
                inside = in_image(boxes, self.views[c].size)
                count = max(count, int(np.count_nonzero(inside)))
        return count

    def _for_a_while(self) -> list[FittingChange]:
        """Return mistakes that apply to a part of the recording only, with the best correction of that part."""
        span_s = float(self.t_ns[-1] - self.t_ns[0]) / NS
        count = int(min(max(span_s / WINDOW_S, MIN_WINDOWS), MAX_WINDOWS))
        steps = len(self.t_ns)
        window = np.minimum(np.arange(steps) * count // steps, count - 1)
        shares = np.array([_by_window(each, window, count) for each in self._own])
        parts = [(c, part) for c, own in enumerate(shares) if (part := _worst_part(own)) is not None]
        out: list[FittingChange] = []
        for c, (first, last, limit) in sorted(
            parts, key=lambda each: float(np.nanmean(shares[each[0], each[1].first : each[1].end]))
        ):
            if any(c in each.cameras for each in out):
                continue
            low, high = (int(np.flatnonzero(window == w)[k]) for w, k in ((first, 0), (last - 1, -1)))
            trusted = [o for o in range(len(self.views)) if not any(o in each.cameras for each in out)]
            within = self._during(low, high)
            # All time steps may disagree with the few that are compared over the whole recording
            if within._overlap({c: within.views[c]}, trusted).excess >= limit:
                continue
            # Of two cameras that do not agree either may be wrong
            tried = trusted if len(trusted) == 2 else [c]
            changes = (change for k in tried for change in within._changes(k, trusted, for_a_while=True))
            best = within._best(changes, trusted)
            if best is not None:
                begin, end = ((int(self.t_ns[k]) - int(self.t_ns[0])) / NS for k in (low, high))
                out.append(best._replace(words=f"{best.words} from {begin:.1f} to {end:.1f} s"))
        return out

    def _during(self, low: int, high: int) -> _Search:
        """Return the same search restricted to the time steps with the indices low to high."""
        other = _Search.__new__(_Search)
        other.t_ns, other.height, other.every, other.intervals = self.t_ns, self.height, 1, self.intervals
        other.views = [view.during(low, high) for view in self.views]
        return other

    @cached_property
    def _pairs(self) -> PairOverlaps:
        """Comparison of all pairs of cameras over the subset of time steps that is compared."""
        return PairOverlaps([view.every(self.every) for view in self.views], len(self.t_ns), self.height)

    def _overlap(self, changed: Mapping[int, BoxesOfCamera], of: Sequence[int] | None = None) -> Overlap:
        """Overlaps of cameras, changed or not, with the cameras `of`, over the time steps that are compared."""
        given = {c: view.every(self.every) for c, view in changed.items() if view is not self.views[c]}
        return self._pairs.overlap(changed, given, of)

    def _best(self, changes: Iterator[_Change], trusted: Sequence[int] | None = None) -> FittingChange | None:
        """Return the correction with the largest mean overlap of boxes; None if none is clearly better than no change.

        `trusted` are the indices of the cameras compared with; None: all.
        """
        best, mean = None, -1.0
        before: dict[tuple[int, ...], Overlap] = {}
        for change in changes:
            own = tuple(change.views)
            if own not in before:
                before[own] = self._overlap({c: self.views[c] for c in own}, trusted)
            now, after = before[own], self._overlap(change.views, trusted)
            gained = not len(now.met) or after.excess - now.excess >= MIN_MORE or clearly_larger(after, now)
            if (
                len(after.met) >= MIN_EXPECTED
                and gained
                and after.excess >= change.least
                and after.mean > mean + SIMPLER
            ):
                share = now.share if len(now.met) else 0.0
                best, mean = FittingChange(own, change.words, after.share, share), after.mean
        return best

    def _of_all(self, unit: str) -> Iterator[_Change]:
        """Generate candidate corrections that concern all cameras at once; `unit` is the length unit for messages."""
        yield from (each for each in self._corrections(0, unit) if len(each.views) > 1)
        yield _Change(f"extrinsics of all cameras are {INVERTED}", {c: _inverted(v) for c, v in enumerate(self.views)})
        for scale in SCALES:
            scaled = {c: _scaled(view, scale) for c, view in enumerate(self.views)}
            yield _Change(f"boxes of all cameras are {_multiplied(scale)}", scaled)
        for words, axes in FLIPS.items():
            flipped = {c: _flipped(view, axes) for c, view in enumerate(self.views)}
            yield _Change(f"images of all cameras are {words}", flipped)
        forms = [_other_forms(view) for view in self.views]
        for each in zip(*forms, strict=True):
            views = {c: self.views[c]._replace(boxes=boxes) for c, (_, boxes) in enumerate(each)}
            yield _Change(f"boxes of all cameras are {each[0][0]}", views)

    def _changes(
        self, c: int, trusted: Sequence[int], *, for_a_while: bool = False, rotations: bool = True
    ) -> Iterator[_Change]:
        """Generate candidate corrections of camera `c`, the simplest first.

        Args:
            c: index of the camera.
            trusted: indices of the cameras that it is compared with.
            for_a_while: only faults that can begin and end during a recording.
            rotations: search for small rotations, too.
        """
        own, name = self.views[c], self.views[c].camera.name
        for o in trusted:
            if o != c:
                other = self.views[o]
                views = {c: own.with_boxes_of(other), o: other.with_boxes_of(own)}
                yield _Change(f"boxes of {name} and {other.camera.name} are exchanged", views)
        if not for_a_while:
            yield _Change(f"extrinsics of {name} are {INVERTED}", {c: _inverted(own)})
            for turn in TURNS_DEG:
                rotation = array_rotation(math.radians(turn), 0.0, 0.0) @ own.camera.rotation
                turned = own._replace(camera=replace(own.camera, rotation=rotation))
                yield _Change(f"{name} is turned by {turn:.0f} degrees about the vertical", {c: turned})
            for words, axes in FLIPS.items():
                yield _Change(f"images of {name} are {words}", {c: _flipped(own, axes)})
        # A stream may change its size, too
        for scale in SCALES:
            yield _Change(f"boxes of {name} are {_multiplied(scale)}", {c: _scaled(own, scale)})
        if not for_a_while:
            for words, boxes in _other_forms(own):
                yield _Change(f"boxes of {name} are {words}", {c: own._replace(boxes=boxes)})
            yield from self._other_rates(c)
        # Frames that were dropped and not counted shift all later ones
        yield from self._late(c)
        if rotations:
            yield from self._turned(c, trusted)

    def _other_rates(self, c: int) -> Iterator[_Change]:
        """Generate corrections of the frame rate of camera `c`, for frames that it counts by itself."""
        own, times, interval = self.views[c], self.t_ns - self.t_ns[0], self.intervals[c]
        tolerance = 0.5 * float(np.median(np.diff(times)))
        for ratio in RATES if interval > 0.0 else ():
            when = times[own.steps] * ratio
            nearest = np.clip(np.searchsorted(times, when - tolerance), 0, len(times) - 1)
            there = np.abs(times[nearest] - when) <= tolerance
            moved = BoxesOfCamera(own.camera, own.boxes[there], nearest[there])
            rate = f"{own.camera.name}={NS / (interval * ratio):.4g}"
            yield _Change(f"{own.camera.name} has another frame rate (ingest --fps {rate})", {c: moved}, MIN_RATE_FIT)

    def _late(self, c: int) -> Iterator[_Change]:
        """Generate corrections of the clock of camera `c`: its boxes at earlier or later time steps.

        The delays are `LATE_S`, rounded to time steps.
        """
        step_s = max(float(np.median(np.diff(self.t_ns))) / NS, 1e-9)
        own, last = self.views[c], len(self.t_ns) - 1
        for k in dict.fromkeys(max(round(late_s / step_s), 1) for late_s in LATE_S if late_s > 0.5 * step_s):
            for sign, words in ((-1, "ahead"), (1, "behind")):
                steps = own.steps + sign * k
                there = (steps >= 0) & (steps <= last)
                moved = BoxesOfCamera(own.camera, own.boxes[there], steps[there])
                yield _Change(f"the clock of {own.camera.name} is {k * step_s:.2g} s {words}", {c: moved})

    def _turned(self, c: int, trusted: Sequence[int]) -> Iterator[_Change]:
        """Generate the rotation that aligns boxes of camera `c` with people whom other cameras locate, if large enough.

        It is found by a Hough transform; `trusted` are the indices of the other cameras.
        """
        own = self.views[c]
        apart = [np.zeros((0, 2))]
        for o in trusted:
            if o != c:
                people = located(self.views[o], self.height)
                known = np.flatnonzero(np.isfinite(people).all(axis=1))
                there = projected_people(own.camera, people[known])
                apart.append(_differences(own, there, self.views[o].steps[known]) / own.camera.focal_px)
        angles = np.concatenate(apart)
        angles = angles[(np.abs(angles) < MAX_TURN).all(axis=1)]
        if len(angles) < MIN_EXPECTED:
            return
        # Cells of the search overlap by half: each is two by two of the histogram's
        half = 0.5 * TURN_CELL
        edges = np.arange(-MAX_TURN - half, MAX_TURN + half, half)
        counts = np.histogram2d(angles[:, 0], angles[:, 1], bins=[edges, edges])[0]
        counts = counts[:-1] + counts[1:]
        fullest = np.argmax(counts[:, :-1] + counts[:, 1:])
        centre = edges[1:-1][list(np.unravel_index(fullest, (len(edges) - 2,) * 2))]
        near = angles[(np.abs(angles - centre) < half).all(axis=1)]
        for _ in range(REFINEMENTS):
            near = angles[np.linalg.norm(angles - np.median(near, axis=0), axis=1) < TURN_CELL]
        yaw, pitch = np.median(near, axis=0)
        if np.hypot(yaw, pitch) < MIN_TURN:
            return
        angles = np.array([yaw, pitch])
        yield _Change(_rotation_words(own, angles), {c: _rotated(own, angles)})


def _rotation_words(view: BoxesOfCamera, angles: Floats) -> str:
    """Return the description, for a message, of a camera rotated by `angles` (2,): yaw and pitch [rad]."""
    yaw_deg, pitch_deg = np.degrees(angles)
    return f"{view.camera.name} is rotated by {yaw_deg:+.1f} deg about the vertical and {pitch_deg:+.1f} deg in pitch"


def _rotated(view: BoxesOfCamera, angles: Floats) -> BoxesOfCamera:
    """Return the camera rotated by small `angles` (2,), yaw and pitch [rad], as a shift of its principal point."""
    camera = view.camera
    return view._replace(camera=replace(camera, principal_px=camera.principal_px + angles * camera.focal_px))


def _of_camera(c: int, camera: Camera, samples: Sequence[tuple[int, dict[int, Floats]]]) -> BoxesOfCamera:
    """Return the boxes of camera `c`, each with the index of its time step.

    `samples` are time [ns] and boxes (n, 4) by camera index of each time step.
    """
    parts = [(step, boxes[c]) for step, (_, boxes) in enumerate(samples) if c in boxes]
    steps = np.concatenate(
        [np.full(len(boxes), step, dtype=np.int64) for step, boxes in parts] or [np.zeros(0, np.int64)]
    )
    return BoxesOfCamera(camera, np.concatenate([boxes for _, boxes in parts] or [np.zeros((0, 4))]), steps)


def _by_window(found: Overlap, window: Ints, count: int) -> Floats:
    """Return the chance-corrected overlap (W,) in each of W = `count` intervals; NaN if too few people are expected.

    `window` (T,) is the interval of each time step.
    """
    own = window[found.steps]
    out = np.full(count, np.nan)
    for w in range(count):
        inside = own == w
        if np.count_nonzero(inside) >= MIN_IN_WINDOW:
            out[w] = Overlap(found.steps[inside], found.met[inside], found.chance[inside]).excess
    return out


class _BadPart(NamedTuple):
    """Intervals of time, from `first` to before `end`, in which the agreement of a camera is below `limit`."""

    first: int
    end: int
    limit: float


def _worst_part(shares: Floats) -> _BadPart | None:
    """Longest run of two or more intervals with an agreement far below the usual.

    None if there is no such run, or if the usual agreement is too low for a comparison.
    """
    known = shares[np.isfinite(shares)]
    if len(known) < MIN_WINDOWS - 2:
        return None
    usual = float(np.quantile(known, 0.8))
    limit = BAD_SHARE * usual
    bad = shares < limit
    if usual < MIN_FIT or not bad.any():
        return None
    runs: list[_BadPart] = []
    begin = None
    for w, each in enumerate([*(bad | ~np.isfinite(shares)), False]):
        if each and begin is None:
            begin = w
        elif not each and begin is not None:
            if np.count_nonzero(bad[begin:w]) > 1:
                runs.append(_BadPart(begin, w, limit))
            begin = None
    return max(runs, key=lambda run: run.end - run.first) if runs else None


def _inverted(view: BoxesOfCamera) -> BoxesOfCamera:
    """Return the camera with the inverse extrinsics, as if R and T had been given in the other direction."""
    own = view.camera
    return view._replace(camera=replace(own, rotation=own.rotation.T, position=-own.rotation.T @ own.position))


def _other_forms(view: BoxesOfCamera) -> Iterator[tuple[str, Floats]]:
    """Generate the box formats that may have been misread: description, and the boxes (n, 4) re-read in that format.

    These are left, top, right, bottom [px].
    """
    boxes = view.boxes
    near, far = boxes[:, :2], boxes[:, 2:]
    middle, size = 0.5 * (near + far), far - near
    yield "left, top, right, bottom (xyxy), read as left, top, width, height", np.hstack([near, size])
    yield "centres and sizes, read as left, top, width, height", boxes - np.tile(0.5 * size, 2)
    yield "left, top, right, bottom (xyxy), read as centres and sizes", np.hstack([middle, size])
    yield "left, top, width, height, read as centres and sizes", boxes + np.tile(0.5 * size, 2)
    yield (
        "of heads (give boxes of whole bodies)",
        np.column_stack(
            [middle[:, 0] - size[:, 0], near[:, 1], middle[:, 0] + size[:, 0], near[:, 1] + BODY_HEADS * size[:, 1]]
        ),
    )
    for factor in SIZES:
        yield _sized_words(factor), np.hstack([middle - 0.5 * factor * size, middle + 0.5 * factor * size])
    exchanged, ratio = boxes[:, [1, 0, 3, 2]], view.size / view.size[::-1]
    yield "y, x in place of x, y", exchanged
    if ratio[0] != 1.0:
        yield "y, x in place of x, y (as shares)", exchanged * np.tile(ratio, 2)
    yield "of exchanged widths and heights", np.hstack([near, near + size[:, ::-1]])
    yield (
        "of exchanged widths and heights about their centres",
        np.hstack([middle - 0.5 * size[:, ::-1], middle + 0.5 * size[:, ::-1]]),
    )
    left, top, right, bottom = boxes.T
    height, width = view.size[::-1]
    yield "of images rotated by 90 degrees clockwise", np.column_stack([top, height - right, bottom, height - left])
    yield "of images rotated by 90 degrees anticlockwise", np.column_stack([width - bottom, left, width - top, right])
    thousandths = np.tile(view.size / 1000.0, 2)
    yield "thousandths of the image", boxes * thousandths
    yield "percents of the image", boxes * 10.0 * thousandths
    yield "thousandths of the image with y, x in place of x, y", exchanged * thousandths
    side = view.size.max()
    yield (
        "shares of square images with bars (letterbox)",
        boxes * np.tile(side / view.size, 2) - np.tile(0.5 * (side - view.size), 2),
    )


def _sized_words(factor: float) -> str:
    return f"{abs(1.0 / factor - 1.0):.0%} too {'large' if factor < 1.0 else 'small'} {SIZED}"


def _multiplied(scale: float) -> str:
    return f"multiplied by {scale:.3g} (images of another size)"


def _scaled(view: BoxesOfCamera, scale: float) -> BoxesOfCamera:
    return view._replace(boxes=view.boxes * scale)


def _flipped(view: BoxesOfCamera, axes: tuple[bool, bool]) -> BoxesOfCamera:
    """Return the camera with boxes as in images flipped along those `axes` (x, y) that are True."""
    out, size = view.boxes.copy(), view.size
    for axis, flipped in enumerate(axes):
        if flipped:
            out[:, axis], out[:, axis + 2] = size[axis] - view.boxes[:, axis + 2], size[axis] - view.boxes[:, axis]
    return view._replace(boxes=out)


def _differences(view: BoxesOfCamera, expected: Floats, steps: Ints) -> Floats:
    """Return offsets (k, 2) [px] of box centres from centres of expected boxes, for all pairs of one time step.

    `expected` (m, 4) are expected boxes, `steps` (m,) their time steps; pairs with NaN are omitted.
    """
    whom, box = paired_rows(steps, view.steps)
    middles = [0.5 * (each[:, :2] + each[:, 2:]) for each in (view.boxes[box], expected[whom])]
    apart = middles[0] - middles[1]
    return np.asarray(apart[np.isfinite(apart).all(axis=1)])

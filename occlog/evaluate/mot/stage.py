"""Tracks of many targets in images against true boxes: failure rates of [Qu], CLEAR-MOT, IDF1, HOTA and GOSPA.

The target assigned to a track is the one of its number, the first one it is on, or the one it is on most. `on_ground`
compares tracks on the ground. The comparison is frame by frame in bounded memory: tables are read four times, for the
cameras, for their frames and identities, and twice for the figures. Tables in memory are one chunk.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Strings
from occlog.console.text import in_seconds
from occlog.core.metrics.mot import failure_rates
from occlog.core.metrics.mot.failure_rates import NO_TARGET
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, numbered, of_boxes, of_points
from occlog.core.metrics.mot.hota import IdentityCounts
from occlog.core.numerics.assignment import maximum_weight_matching
from occlog.errors import InputError, abridged, option
from occlog.evaluate.results import Evaluation
from occlog.records.declared.views import Failures
from occlog.records.tables import Boxes, TruthBoxes

from .config import MultiTargetConfig
from .figures import FailureCounts, GospaFigures, Metrics, MotFigures, centres, of_view
from .misfit import MAX_ROWS, SampledBoxes, misfit
from .truth_and_tracks import TruthAndTracks, asked_for, boxes_in_true_frames, compared_views


class NearPairs(NamedTuple):
    """n pairs of a true row and a track's row of one frame that are near each other.

    `truth`, `track`: (n,) indices of the rows; `share`: (n,) distance over the limit tau of the true row, 0 to 1.
    """

    truth: Ints
    track: Ints
    share: Floats  # distance over tau


def assigned_targets(truth: Objects, tracks: Objects, tau: Floats, t_ns: Ints, how: str) -> Ints:
    """Return the identity (m,) of the target assigned to the track of each row; `NO_TARGET` if none is.

    Args:
        truth: n points.
        tracks: m points; rows of one identity are one track, in all views.
        tau: (n,) distance within which a track is on the true row.
        t_ns: (m,) time of each row of the tracks [ns].
        how: `id`: the target of the same identity; `start`: the first target that the track is on, in any view, of
            several at that time the nearest in terms of tau; `optimal`: by the one-to-one assignment over all views in
            which most estimates are on their own target.
    """
    found = AssignedTargets(how)
    found.update(truth, tracks, tau, t_ns)
    return found.of(tracks.label)


class AssignedTargets:
    """Determines the target assigned to each track ([Qu] Eq. 9), over parts of a recording in the order of time."""

    def __init__(self, how: str) -> None:
        """Create an assignment without rows, by the rule `how` (`id`, `start` or `optimal`, see `assigned_targets`)."""
        self._how = how
        self._first: dict[int, int] = {}
        self._met: Counter[tuple[int, int]] = Counter()

    def update(self, truth: Objects, tracks: Objects, tau: Floats, t_ns: Ints) -> None:
        """Add the rows of a further part, in the order of time; nothing is needed if tracks are assigned by identity.

        Args:
            truth: n points.
            tracks: m points.
            tau: (n,) distance within which a track is on the true row.
            t_ns: (m,) time of each row of the tracks [ns].
        """
        if self._how == "id":
            return
        near = _near(truth, tracks, tau)
        track, target = tracks.label[near.track], truth.label[near.truth]
        if self._how == "start":
            for row in np.lexsort((target, near.share, t_ns[near.track])).tolist():
                self._first.setdefault(int(track[row]), int(target[row]))
            return
        pairs, count = np.unique(np.column_stack([track, target]), axis=0, return_counts=True)
        self._met.update(dict(zip(map(tuple, pairs.tolist()), count.tolist(), strict=True)))

    def of(self, labels: Ints) -> Ints:
        """Return the identity (n,) of the target assigned to each track in `labels` (n,); `NO_TARGET` if none is."""
        if self._how == "id":
            return labels
        own = self._first if self._how == "start" else self._best
        keys, number = np.unique(labels, return_inverse=True)
        return np.array([own.get(int(k), NO_TARGET) for k in keys], dtype=np.int64)[number]

    @cached_property
    def _best(self) -> dict[int, int]:
        """One-to-one assignment of tracks to targets, by identity, with the most rows at most tau apart."""
        couples = sorted(self._met.items())
        track, target = np.array([couple for couple, _ in couples], dtype=np.int64).reshape(-1, 2).T
        met = np.array([count for _, count in couples], dtype=np.float64)
        made = maximum_weight_matching(track, target, met)
        return dict(zip(track[made].tolist(), target[made].tolist(), strict=True))


def _near(truth: Objects, tracks: Objects, tau: Floats) -> NearPairs:
    """Return all pairs of a true row and a track's row of one frame and view that are at most `tau` (n,) apart.

    `tau`: distance limit of each of the n true rows.
    """
    frames = of_points(truth, tracks, 1.0)
    parts = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
    reach = tau[frames.truth_row]
    for t in frames.meeting():
        left, right = frames.rows(t)
        share = frames.compare(t)[0] / reach[left, None]
        i, j = np.nonzero(share <= 1.0)
        parts.append((frames.truth_row[left][i], frames.track_row[right][j], share[i, j]))
    return NearPairs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class PointTracks(NamedTuple):
    """Truth and tracks as points in common frames, with distance limits, for failure rates.

    Attributes:
        truth: true positions, n rows.
        tracks: estimated positions.
        tau: (n,) largest distance of a tracker that is on the target of a true row.
        views: names of the cameras.
        t_ns: for each view the times of its frames [ns].
        number: for each view the numbers of its frames.
        visible: (n,) visible share of each true row, 0 to 1; NaN: unknown.
        unit: unit of distances.
    """

    truth: Objects
    tracks: Objects
    tau: Floats  # (n,) how near a tracker on a true row must be
    views: tuple[str, ...]
    t_ns: tuple[Ints, ...]  # for each view the times of its frames
    number: tuple[Ints, ...]  # for each view the numbers of its frames
    visible: Floats  # (n,) visible share of each true row
    unit: str  # of distances

    def times(self, side: Objects) -> Ints:
        """Return the time (n,) [ns] of each of the n rows of `side` (truth or tracks)."""
        return self._at(self.t_ns, side)

    def numbers(self, side: Objects) -> Ints:
        """Return the frame number (n,), in its camera's stream, of each of the n rows of `side` (truth or tracks)."""
        return self._at(self.number, side)

    def _at(self, values: tuple[Ints, ...], side: Objects) -> Ints:
        starts = np.cumsum([0, *(len(each) for each in values)])
        return np.concatenate([*values, np.zeros(0, np.int64)])[starts[_views_of(side)] + side.frame]


def keys_of(side: Objects) -> Ints:
    """Return view and identity (G, 2) of every distinct object, sorted."""
    return np.unique(np.column_stack([_views_of(side), side.label]), axis=0).astype(np.int64)


class ImageTrackFigures:
    """Accumulates all multi-target figures in images over parts of a recording, in two passes: `prepare`, `update`.

    Memory grows with the number of targets and tracks, not of frames.
    """

    def __init__(self, views: tuple[str, ...], targets: Ints, tracks: Ints, config: MultiTargetConfig) -> None:
        """Start without frames.

        Args:
            views: names of the cameras.
            targets: (G, 2) view and label of every target, ascending.
            tracks: (K, 2) view and label of every track, ascending.
            config: options.
        """
        self._views, self._keys, self._config = views, (targets, tracks), config
        self._owners = AssignedTargets(config.assigned_target)
        self._pooled = _ImageFigures(targets, tracks, config)
        # Objects of one view alone have no view
        own = [[side[side[:, 0] == v] * [0, 1] for side in self._keys] for v in range(len(views))]
        self._each = [_ImageFigures(theirs, ours, config) for theirs, ours in own] if len(views) > 1 else []
        self._labels = labels = [np.unique(side[:, 1]) for side in self._keys]
        self._across = IdentityCounts(len(labels[0]), len(labels[1]), config.match_iou)

    def prepare(self, part: TruthAndTracks, begin: Sequence[int]) -> None:
        """First pass: add a part, in the order of time; `begin`: number of frames of each view before it."""
        points = centres_and_limits(part, self._config)
        self._owners.update(points.truth, points.tracks, points.tau, points.times(points.tracks))
        self._pooled.prepare(part.truth, part.tracks, begin)
        for v, each in enumerate(self._each):
            each.prepare(of_view(part.truth, v), of_view(part.tracks, v), begin[v : v + 1])

    def update(self, part: TruthAndTracks, begin: Sequence[int]) -> Failures:
        """Second pass: add a part, in the order of time; return its failures.

        `begin`: number of frames of each view before it.
        """
        points = centres_and_limits(part, self._config)
        found = find_failures(points, self._owners)
        self._pooled.update(part.truth, part.tracks, begin, found, found.frame >= 0)
        for v, each in enumerate(self._each):
            each.update(of_view(part.truth, v), of_view(part.tracks, v), begin[v : v + 1], found, found.view == v)
        if len(self._views) > 1:
            self._across.update(_across_views(part.truth, part.tracks, self._labels))
        return failure_rows(found, points)

    def merge(self, other: ImageTrackFigures) -> None:
        """Add another recording with different cameras; no frame may be added afterwards.

        Figures of single views are dropped.
        """
        # Of one view identities across views are those of the view
        self._across, across = (
            each._across if len(each._views) > 1 else deepcopy(each._pooled.mot.identity) for each in (self, other)
        )
        self._across.merge(across)
        self._pooled.merge(other._pooled)
        self._views, self._each = (*self._views, *other._views), []

    def result(self, frames: Sequence[int], counts: Mapping[str, float]) -> Metrics:
        """Return all figures by name: over all views, then of each view (`_sensor_NAME`) if there are several.

        Args:
            frames: number of frames of each view.
            counts: numbers of compared and skipped rows, which are added.
        """
        out = self._pooled.result(sum(frames), counts)
        if len(self._views) > 1:
            got = self._across.result()
            out |= {"idf1_across_views": got.idf1, "idp_across_views": got.idp, "idr_across_views": got.idr}
        for v, each in enumerate(self._each):
            suffix = f"_sensor_{self._views[v]}"
            out |= each.result(frames[v], {f"frames{suffix}": frames[v]}, suffix)
        return {name: float(value) for name, value in out.items()}

    def notes(self) -> list[str]:
        """Return a note for the user if no track has the number of a target although tracks are assigned by number."""
        theirs, ours = self._labels
        return unrelated_ids_note(ours, theirs, self._config)


class _ImageFigures:
    """Accumulated figures (failure rates, CLEAR-MOT, HOTA, GOSPA) of one view, or of all together."""

    def __init__(self, targets: Ints, tracks: Ints, config: MultiTargetConfig) -> None:
        self._keys, self._config, self._failures = (targets, tracks), config, FailureCounts()
        self._sizes = len(targets), len(tracks)
        none = np.zeros(0, dtype=np.int64)
        empty = Objects(none, none, np.zeros((0, 4)))
        self.mot = MotFigures(numbered(of_boxes(empty, empty), targets, tracks), config)
        self._centres = None if config.gospa_px is None else GospaFigures(config, config.gospa_px)

    def _frames_of(self, truth: Objects, tracks: Objects, begin: Sequence[int]) -> MatchedFrames:
        found = numbered(of_boxes(truth, tracks), *self._keys)
        return found._replace(frame=found.frame + np.asarray(begin, dtype=np.int64)[found.view])

    def prepare(self, truth: Objects, tracks: Objects, begin: Sequence[int]) -> None:
        self.mot.prepare(self._frames_of(truth, tracks, begin))

    def update(
        self, truth: Objects, tracks: Objects, begin: Sequence[int], found: failure_rates.FailureRates, own: Bools
    ) -> None:
        self.mot.update(self._frames_of(truth, tracks, begin))
        if self._centres is not None and self._config.gospa_px is not None:
            self._centres.update(of_points(centres(truth), centres(tracks), self._config.gospa_px))
        self._failures.update(found, own, len(truth.frame))

    def merge(self, other: _ImageFigures) -> None:
        self.mot.merge(other.mot)
        self._failures.merge(other._failures)
        self._sizes = self._sizes[0] + other._sizes[0], self._sizes[1] + other._sizes[1]
        if self._centres is not None and other._centres is not None:
            self._centres.merge(other._centres)

    def result(self, cells: int, counts: Mapping[str, float], suffix: str = "") -> Metrics:
        out = self._failures.result(suffix) | self.mot.result(cells, suffix)
        known: Metrics = {f"targets{suffix}": self._sizes[0], f"tracks{suffix}": self._sizes[1]}
        out |= known | dict(counts) if suffix else dict(counts) | known
        return out if self._centres is None else out | self._centres.result(cells, suffix, "px")


def _across_views(truth: Objects, tracks: Objects, labels: Sequence[Ints]) -> MatchedFrames:
    """Return truth and tracks of all views with identities common to the views, as for several cameras of one scene.

    Frames of different views remain different frames. `labels`: all identities of the truth and of the tracks, sorted.
    """
    sides = []
    for side in (truth, tracks):
        sides.append(Objects(side.frame + (_views_of(side) << 40), side.label, side.position))
    keys = (np.column_stack([np.zeros(len(each), np.int64), each]) for each in labels)
    return numbered(of_boxes(*sides), *keys)


def centres_and_limits(compared: TruthAndTracks, config: MultiTargetConfig) -> PointTracks:
    """Return the centres of the boxes as points, with the distance limit tau of each true box [px].

    It is `distance_gate_px`, or `distance_gate` times sqrt(half width * half height) of the true box.
    """
    radius = 0.5 * np.sqrt(compared.truth.position[:, 2] * compared.truth.position[:, 3])
    tau = (
        config.distance_gate * radius
        if config.distance_gate_px is None
        else np.full(len(radius), config.distance_gate_px)
    )
    return PointTracks(
        truth=centres(compared.truth),
        tracks=centres(compared.tracks),
        tau=tau,
        views=compared.views,
        t_ns=compared.t_ns,
        number=compared.number,
        visible=compared.visible,
        unit="px",
    )


def find_failures(points: PointTracks, owners: AssignedTargets) -> failure_rates.FailureRates:
    """Return the position and label failures [Qu] of the trackers; `owners`: target assigned to each track."""
    own = owners.of(points.tracks.label)
    return failure_rates.failures(points.truth, points.tracks, points.tau, own)


def failure_rows(found: failure_rates.FailureRates, points: PointTracks) -> Failures:
    """Return failures as a table, sorted by time, camera and target; `points`: has times and names for them."""
    view = found.view.astype(np.int64)
    at = Objects(found.frame, found.target, np.zeros((len(view), 2)), view)
    names: Strings = np.array([*points.views, ""], dtype=np.str_)
    columns = {
        "t_ns": points.times(at),
        "sensor": names[view],
        "frame": points.numbers(at),
        "target_id": found.target.astype(np.int32),
        "kind": np.where(found.label, "label", "position"),
        "other_id": found.other.astype(np.int32),
        "cause": np.array(found.causes(points.unit), dtype=np.str_),
        "visible": _visible(at, points),
    }
    order = np.lexsort([columns[name] for name in ("kind", *reversed(Failures.KEY))])
    return Failures.of(**{name: column[order] for name, column in columns.items()})


def _views_of(side: Objects) -> Ints:
    return np.zeros(len(side.frame), dtype=np.int64) if side.view is None else side.view


def _visible(at: Objects, points: PointTracks) -> Floats:
    """Return the visible share (n,), 0 to 1, of the true target of each row of `at`.

    NaN if unknown or absent in the frame.
    """
    known = zip(_views_of(points.truth).tolist(), points.truth.frame.tolist(), points.truth.label.tolist(), strict=True)
    share = dict(zip(known, points.visible.tolist(), strict=True))
    rows = zip(_views_of(at).tolist(), at.frame.tolist(), at.label.tolist(), strict=True)
    return np.array([share.get(row, np.nan) for row in rows], dtype=np.float64)


def skipped_cameras_note(names: Sequence[str]) -> list[str]:
    """Return a note on the cameras `names`, which the truth has and no track is in; empty without names."""
    return [f"skipped: {', '.join(names)}: in the truth, but without any track"] if names else []


def unrelated_ids_note(ours: Ints, theirs: Ints, config: MultiTargetConfig) -> list[str]:
    """Return a note if no track has the number of a target although tracks are assigned by number; else empty.

    Args:
        ours: (n,) sorted numbers of the tracks.
        theirs: (m,) sorted numbers of the targets.
        config: settings, of which `assigned_target` states how tracks are assigned to targets.
    """
    if config.assigned_target != "id" or not len(ours) or np.isin(ours, theirs).any():
        return []
    return [
        f"no track has the number of a target ({_some(ours)}; {_some(theirs)}), so that every tracker is on another "
        "target than its own; own start gives each track the first target that it is on"
    ]


def _some(numbers: Ints) -> str:
    shown = ", ".join(str(n) for n in numbers[:6].tolist())
    return f"{shown}, ..." if len(numbers) > 6 else shown


Sides = Callable[[], Iterator[tuple[Boxes, TruthBoxes]]]
"""Gives tracks and true boxes in chunks of the same frames, in the order of time, as often as asked."""


@dataclass
class _Side:
    """Cameras and frames of one side of a comparison, tracks or truth.

    `cameras`: of all rows; `wanted`: of the selected rows; `frames`: lowest and highest frame number of all rows;
    `rows`: number of selected rows.
    """

    cameras: set[str] = field(default_factory=set)
    wanted: set[str] = field(default_factory=set)
    frames: tuple[int, int] | None = None
    rows: int = 0

    def update(self, boxes: Boxes, config: MultiTargetConfig) -> None:
        keep = asked_for(boxes, config)
        self.cameras.update(np.unique(boxes.sensor).tolist())
        self.wanted.update(np.unique(boxes.sensor[keep]).tolist())
        self.rows += int(np.count_nonzero(keep))
        if len(boxes):
            low, high = self.frames or (int(boxes.frame[0]), int(boxes.frame[0]))
            self.frames = min(low, int(boxes.frame.min())), max(high, int(boxes.frame.max()))

    def check(self, what: str, config: MultiTargetConfig) -> None:
        """Raise InputError if a selected camera has no rows, or the truth has none in the selected frames.

        `what`: `truth` or `tracks`, which this side is.
        """
        if missing := [name for name in config.cameras if name not in self.cameras]:
            raise InputError(
                f"{what}: no rows of camera {abridged(missing)}; choose with {option('camera')}: "
                f"{abridged(sorted(self.cameras))}",
                id="unknown-sensor",
            )
        if what == "truth" and config.frames is not None and self.frames is not None and not self.rows:
            first, stop = config.frames
            raise InputError(
                f"truth: no row in frames {first}:{stop} of {option('frames')}; its frames are {self.frames[0]} to "
                f"{self.frames[1]}",
                id="empty-input",
            )


class ComparedBoxes:
    """Tracks in images and true boxes, in the frames of the truth.

    Attributes:
        views: names of the cameras that are compared.
        left_out: cameras of the truth that no track is in.
        frames: number of true frames of each view.
        counts: numbers of compared and skipped rows by name.
        targets: (G, 2) view and identity of each target.
        tracks: (K, 2) view and identity of each track.
    """

    def __init__(
        self,
        sides: Sides,
        config: MultiTargetConfig,
        *,
        cameras: Collection[str] = (),
        by_number: bool = False,
        adjust: Callable[[TruthAndTracks], TruthAndTracks] | None = None,
    ) -> None:
        """Read both sides once, to determine their cameras, frames and identities.

        Args:
            sides: generates tracks and truth; rows of cameras and frames that are not selected are skipped.
            config: options.
            cameras: cameras that are compared even if no track is in them.
            by_number: frames are equal if camera and frame number are; otherwise if camera and time are.
            adjust: change of each part, such as dropping tracks of distractors; None: none.

        Raises:
            InputError: nothing can be compared, or an object has no identity, or the same one twice in a frame.
        """
        self._sides, self._config, self._by_number, self._adjust = sides, config, by_number, adjust
        ours, theirs = _Side(cameras=set(cameras), wanted=set(cameras)), _Side()
        for tracks, truth in sides():
            ours.update(tracks, config)
            theirs.update(truth, config)
        theirs.check("truth", config)
        ours.check("tracks", config)
        self.views, self.left_out = compared_views(ours.wanted, theirs.wanted)
        frames, met = np.zeros(len(self.views), dtype=np.int64), 0
        self.targets: Ints = np.zeros((0, 2), dtype=np.int64)
        self.tracks: Ints = np.zeros((0, 2), dtype=np.int64)
        counts: dict[str, float] = {}
        for _, part in self.parts():
            frames += part.frames
            met += int(part.counts["frames"] - part.counts["frames_without_tracks"])
            counts = {name: counts.get(name, 0.0) + n for name, n in part.counts.items()}
            self.targets = np.unique(np.concatenate([self.targets, keys_of(part.truth)]), axis=0)
            self.tracks = np.unique(np.concatenate([self.tracks, keys_of(part.tracks)]), axis=0)
        self.frames: list[int] = frames.tolist()
        if counts.get("estimates_other_frames") and not counts["estimates_compared"]:
            raise InputError(self._disjoint_note(), id="disjoint-inputs")
        del counts["estimates_compared"]
        self.counts = counts | {
            "frames": float(sum(self.frames)),
            "frames_without_tracks": float(sum(self.frames) - met),
            "views_without_tracks": float(len(self.left_out)),
        }

    def _wanted(self) -> Iterator[tuple[Boxes, TruthBoxes]]:
        """Generate tracks and truth in chunks, restricted to the selected cameras and frames."""
        for tracks, truth in self._sides():
            if self._config.cameras or self._config.frames is not None:
                yield tracks.take(asked_for(tracks, self._config)), truth.take(asked_for(truth, self._config))
            else:
                yield tracks, truth

    def parts(self) -> Iterator[tuple[list[int], TruthAndTracks]]:
        """Generate the parts of the comparison in the order of time.

        Each comes with the numbers of frames, for each view, before it.
        """
        begin = [0] * len(self.views)
        for tracks, truth in self._wanted():
            part = boxes_in_true_frames(tracks, truth, self.views, by_number=self._by_number)
            part = part if self._adjust is None else self._adjust(part)
            yield begin, part
            begin = [n + more for n, more in zip(begin, part.frames, strict=True)]

    def _disjoint_note(self) -> str:
        """Return the message that no track is in a frame of the truth, with examples of both."""
        found, true = (_first_of(rows) for rows in zip(*self._wanted(), strict=True))
        if self._by_number:
            return (
                f"tracks: none of their frame numbers ({found[1]}) is in the truth ({true[1]}); frames must have "
                "the same numbers"
            )
        return (
            f"tracks: none of their times (first: {found[0]}) is a time of the true boxes (first: {true[0]}); times "
            "must be the same"
        )

    def figures(self, take: Callable[[Failures], None] | None = None) -> ImageTrackFigures:
        """Compare all parts and return the accumulated figures.

        `take` (if any) is called with the failures of each part.
        """
        out = ImageTrackFigures(self.views, self.targets, self.tracks, self._config)
        for begin, part in self.parts():
            out.prepare(part, begin)
        for begin, part in self.parts():
            failures = out.update(part, begin)
            if take is not None:
                take(failures)
        return out

    def evaluate(self, take: Callable[[Failures], None] | None = None) -> Evaluation:
        """Return figures, notes and checks of the comparison.

        `take` (if any) is called with the failures of each part.
        """
        found = self.figures(take)
        notes = (*skipped_cameras_note(self.left_out), *found.notes())
        metrics = found.result(self.frames, self.counts)
        return Evaluation(metrics, notes=notes, checks=misfit(*self._sampled(), metrics))

    def _sampled(self) -> tuple[SampledBoxes, SampledBoxes]:
        """Return boxes from the beginning of tracks and truth, to search for wrong frame numbers or formats.

        Frames are numbered by frame number, or by rounded multiples of the truth's time step.
        """
        tracks: list[SampledBoxes] = []
        truth: list[SampledBoxes] = []
        first, step = 0, 0
        for ours, theirs in self._wanted():
            times = np.unique(theirs.t_ns)
            if not step and len(times) > 1:
                first, step = int(times[0]), int(np.median(np.diff(times)))
            for kept, rows in ((tracks, ours), (truth, theirs)):
                frame = rows.frame if self._by_number else np.round((rows.t_ns - first) / max(step, 1)).astype(np.int64)
                if sum(len(each.frame) for each in kept) < MAX_ROWS:
                    kept.append(SampledBoxes.of(rows, self.views, frame))
        return SampledBoxes.merge(tracks), SampledBoxes.merge(truth)


def _first_of(parts: Iterable[Boxes]) -> tuple[str, str]:
    """Return, for a message, camera and time of the first row with a box, and the range of the frames with boxes."""
    rows = [part.take(part.box >= 0) if not isinstance(part, TruthBoxes) else part for part in parts if len(part)]
    rows = [part for part in rows if len(part)]
    low, high = min(int(part.frame.min()) for part in rows), max(int(part.frame.max()) for part in rows)
    return f"{rows[0].sensor[0]} at {in_seconds(int(rows[0].t_ns[0]))} s", f"{low} to {high}"

"""Run of `occlog track` with a method that tracks in images: read, track, write, and sum up.

Tracks and losses are counted while they stream past; the summary and the warnings are made of
the counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, fields, replace
from itertools import combinations

import numpy as np

from occlog.consistency.estimates import EffectiveSampleSizes
from occlog.consistency.verdict import MAX_DEPLETED_SHARE, depleted_particles
from occlog.console.notes import threads_by_default
from occlog.errors import InputError, UsageError, abridged, option
from occlog.measure.detect.by_background.one_camera import segments
from occlog.records.declared.views import ViewTracks
from occlog.records.losses import Loss
from occlog.records.tables import Boxes, FusedTracks
from occlog.records.verdicts import Check, finding, outcome, summary_of, texts_of
from occlog.runner import Job, Tables
from occlog.settings import configure
from occlog.track.methods.images.ground.stage import GroundConsistency
from occlog.track.methods.images.initiation.config import ViewsConfig
from occlog.track.methods.images.initiation.regions import RegionStream
from occlog.track.methods.images.methods.config import CONFIGS, LoopCheckConfig, MipfConfig
from occlog.track.request import ViewsRequest

from .frame_synchronisation import in_step
from .inputs import ViewsInput
from .stage import Checks, TrackingSetup, ViewsPart, track_views

NUMBER, AT_ONCE, PARTICLES = "number of targets", "targets per frame", "effective sample size"
FIRST, SHARED, ENDS = "initial ellipses", "view collaboration", "end of each view"
GEOMETRY, PLACES = "fundamental matrices", "ground positions"
"""Names of checks."""
MAX_TARGETS_PER_FRAME = 30.0
"""Targets in a frame that regions can be: one man without a calibration gives 72, the rendered balls of [Qu] 8.8."""
MIN_LOOP_CHECKS = 20
"""Loop checks below which the summary does not judge a fundamental matrix."""
BIN_PX, BINS = 0.1, 20_001
"""Width and number of the bins of the histogram of distances; the last bin holds all that are farther."""
EARLY_PERIODS = 3
"""A view ends early when others go on for more of its frame periods than this."""


class ViewsSummary:
    """Counts of a run that tracks in images, added up part by part; the summary and the warnings are made of them.

    Per view: frames, latest time, rows and unusable frames. Per pair of views: failed loop checks and a histogram of
    their distances. In total: targets, events, modes of the likelihood, and triangulated positions.
    """

    def __init__(self, method: str, inputs: ViewsInput) -> None:
        """Start with all counts at 0, for tracking with `method` in the views of `inputs`."""
        self.method, self.inputs = method, inputs
        n = len(inputs.views)
        self.rows = 0
        self.targets: set[int] = set()
        self.frames = np.zeros(n, dtype=np.int64)
        self.last_ns = np.full(n, -1, dtype=np.int64)
        self.events: Counter[str] = Counter()
        self.begun: set[str] = set()
        self.modes: Counter[str] = Counter()
        self.lost: list[list[tuple[int, str]]] = [[] for _ in range(n)]
        self.failed = np.zeros((n, n), dtype=np.int64)
        self.distances = {pair: np.zeros(BINS, dtype=np.int64) for pair in combinations(range(n), 2)}
        self.dropped: list[tuple[int, int]] = []
        self.triangulation: Counter[str] = Counter()
        self.verdict = GroundConsistency()
        self.particles = EffectiveSampleSizes()
        self.rows_of: Counter[str] = Counter()

    def add(self, part: ViewsPart) -> None:
        """Add a part, the output of some time steps, to the counts."""
        self.rows += len(part.tracks)
        self.rows_of.update(part.tracks.sensor.tolist())
        self.particles.add(part.tracks.ess)
        self.targets.update(part.tracks.target_id.tolist())
        self.frames += part.frames
        self.last_ns = np.maximum(self.last_ns, part.last_ns)
        self.events.update(e for e in part.tracks.lifecycle.tolist() if e)
        self.begun.update(part.tracks.sensor[part.tracks.lifecycle == "start"].tolist())
        self.modes.update(m for m in part.tracks.likelihood_mode.tolist() if m)
        for view, frame, why in part.lost:
            self.lost[view].append((frame, why))
        self._check(part.checks)
        self._check(part.start_checks)
        self.dropped += part.dropped

    def _check(self, checks: Checks) -> None:
        """Add loop checks to the counts of failures and to the histogram of distances of each pair of views."""
        for a, b, radii, px in zip(*(column.tolist() for column in checks), strict=True):
            self.failed[int(a), int(b)] += radii > 1.0
            self.distances[int(a), int(b)][int(min(px / BIN_PX, BINS - 1))] += 1

    def losses(self) -> list[Loss]:
        """Return the frames that could not be used as losses, runs of consecutive frames of a camera joined."""
        return [
            loss for view, lost in zip(self.inputs.views, self.lost, strict=True) for loss in segments(view.name, lost)
        ]

    def summary(self) -> dict[str, object]:
        """Return the figures of the summary by name.

        Numbers of targets, rows, frames by view and events; shares of rows by mode of the likelihood; loop checks and
        failures by pair of views; and, with ground positions, counts of `ground_tracks` and the figures of
        `GroundConsistency`.
        """
        names = self.inputs.names
        total = max(sum(self.modes.values()), 1)
        checks = {
            f"{names[a]}-{names[b]}": {"checks": int(n), "failed": int(self.failed[a, b])}
            for (a, b), distances in self.distances.items()
            if (n := distances.sum())
        }
        return {
            "targets": len(self.targets),
            "rows": self.rows,
            "frames": dict(zip(names, self.frames.tolist(), strict=True)),
            "initiated": self.events["start"],
            "left_image": self.events["left"],
            "terminated": self.events["terminated"],
            "modes": {mode: n / total for mode, n in sorted(self.modes.items())},
            "loop_checks": checks,
            **(
                {"triangulation": dict(sorted(self.triangulation.items())), **self.verdict.figures()}
                if self.triangulation
                else {}
            ),
        }

    def checks(self) -> tuple[Check, ...]:
        """Return the checks of the tracks with their findings."""
        pairs = sum(int(each.sum()) >= MIN_LOOP_CHECKS for each in self.distances.values())
        uncounted = "" if self._uses_regions else "trackers do not begin from what moves in the images"
        depleted = "" if self.particles.rows else "the method has no particles"
        note = "" if self.triangulation else "no ground positions were requested"
        return (
            *outcome(NUMBER, self._none(), targets=len(self.targets), rows=self.rows),
            *outcome(
                AT_ONCE,
                () if uncounted else self._too_many(),
                unless=uncounted,
                per_frame=max(self._at_a_time().values(), default=0.0),
                allowed=MAX_TARGETS_PER_FRAME,
            ),
            *outcome(
                PARTICLES,
                depleted_particles(PARTICLES, self.particles, MAX_DEPLETED_SHARE, "note"),
                unless=depleted,
                median=self.particles.median,
            ),
            *outcome(FIRST, self._first()),
            *outcome(SHARED, self._alone()),
            *outcome(ENDS, self._ends(), unless="" if len(self.inputs.views) > 1 else "there is one view"),
            *outcome(
                GEOMETRY,
                (self._misfit(a, b) for a, b in self._misfits()),
                unless="" if pairs else f"no two views have {MIN_LOOP_CHECKS} loop checks",
            ),
            *outcome(
                PLACES,
                () if note else self.verdict.findings(PLACES),
                unless=note,
            ),
        )

    @property
    def _uses_regions(self) -> bool:
        """Return whether trackers start from a file of detections or from moving foreground.

        False where they start from initial ellipses alone, or from boxes of a detector in the recording.
        """
        request, boxes = self.inputs.request, self.inputs.recording.has(Boxes)
        return request.births != "initial" and (request.detections is not None or not boxes)

    def _at_a_time(self) -> dict[str, float]:
        """Return the mean number of targets per frame of each view."""
        frames = zip(self.inputs.names, self.frames.tolist(), strict=True)
        return {name: self.rows_of[name] / count for name, count in frames if count}

    def _none(self) -> Iterator[Check]:
        """Generate the finding that no target was tracked, if so."""
        if not self.rows:
            yield finding(NUMBER, "no-view-tracks")

    def _too_many(self) -> Iterator[Check]:
        """Generate findings about views with more than `MAX_TARGETS_PER_FRAME` targets per frame on average."""
        for name, count in self._at_a_time().items():
            if count > MAX_TARGETS_PER_FRAME:
                yield finding(
                    AT_ONCE, "too-many-targets", sensors=[name], per_frame=count, allowed=MAX_TARGETS_PER_FRAME
                )

    def _first(self) -> Iterator[Check]:
        """Generate findings about initial ellipses that started no tracker, and views without one."""
        if (late := self.inputs.given - self.events["start"]) > 0:
            yield finding(FIRST, "initial-ellipses-unused", count=late, given=self.inputs.given)
        bare = [name for name in self.inputs.names if name not in self.begun]
        if self.begun and bare and self.inputs.request.births == "initial":
            yield finding(FIRST, "view-without-tracks", sensors=bare)

    def _alone(self) -> Iterator[Check]:
        """Generate a finding if a method for several views has a single view or no known fundamental matrix."""
        config = CONFIGS[self.method]
        if not issubclass(config, LoopCheckConfig):
            return
        if len(self.inputs.views) == 1:
            yield finding(SHARED, "single-view", method=self.method, does=config.ALONE)
        elif not np.isfinite(self.inputs.geometry.fundamental).any():
            yield finding(SHARED, "views-without-links", method=self.method, does=config.ALONE)

    def _ends(self) -> Iterator[Check]:
        """Generate findings about views that end more than `EARLY_PERIODS` frame periods before the latest one."""
        latest = int(self.last_ns.max(initial=-1))
        for s, last, n in zip(self.inputs.surveyed, self.last_ns.tolist(), self.frames.tolist(), strict=True):
            if last >= 0 and latest - last > EARLY_PERIODS * max(s.period_ns, 2 * self.inputs.window_ns):
                early_s = (latest - last) / 1e9
                yield finding(ENDS, "view-ends-early", sensors=[s.view.name], early_s=early_s, frames=n)

    def _misfits(self) -> list[tuple[int, int]]:
        """Return pairs of views with a fundamental matrix that most loop checks contradict or that was dropped."""
        most = [
            pair
            for pair, distances in self.distances.items()
            if (n := int(distances.sum())) >= MIN_LOOP_CHECKS and 2 * int(self.failed[pair]) > n
        ]
        return sorted({*most, *self.dropped})

    def _misfit(self, a: int, b: int) -> Check:
        """Return the finding about the fundamental matrix of views `a` and `b` (numbers), contradicted by loop checks.

        It states the share of failed checks, their number and the median distance from epipolar lines [px].
        """
        distances = self.distances[a, b]
        n = int(distances.sum())
        median = BIN_PX * (int(np.searchsorted(np.cumsum(distances), 0.5 * n)) + 0.5)
        names = self.inputs.names
        return finding(
            GEOMETRY,
            "fundamental-misfit",
            sensors=[names[a], names[b]],
            share=self.failed[a, b] / n if n else float("nan"),
            checks=n,
            median_px=median,
            dropped=float((a, b) in self.dropped),
            allowed=0.5,
        )


def run_track_views(request: ViewsRequest, job: Job) -> tuple[dict[str, object], list[Loss]]:
    """Track in images as requested, and write the tables.

    Return the figures of the summary, and the losses of the inputs and of frames that could not be used.
    """
    config, stage = view_settings(request)
    inputs = ViewsInput(request, stage)
    if request.ground_tracks is not None:
        inputs.check_world()
    starts, next_id = inputs.starts()
    setup = TrackingSetup(
        views=inputs.views,
        geometry=inputs.geometry,
        config=config,
        stage=stage,
        starts=starts,
        next_id=next_id,
        period_ns=tuple(s.period_ns for s in inputs.surveyed),
    )
    stream = inputs.region_stream()
    if request.initial_ellipses is None and request.detections is None:
        source = "the boxes in the recording" if inputs.recording.has(Boxes) else "what moves in the images"
        job.note(f"no {option('initial_ellipses')} and no {option('detections')}: trackers begin from {source}")
    window = request.window_ns if request.window_ns is not None else inputs.window_ns
    frames = job.progress(inputs.recording.frames(inputs.names), "track", inputs.frames)
    frame_sets = in_step(
        frames, inputs.views, window, threads_by_default(), stage.bit_depth, inputs.background(job.quiet)
    )
    parts = track_views(frame_sets, setup, request.seed, stream)
    parameters = {
        "method": request.method,
        "births": request.births,
        "cameras": list(inputs.names),
        "window_ns": window,
        "geometry": inputs.known.sources,
        **asdict(stage),
        **asdict(config),
    }
    earlier = inputs.losses
    made = job.provenance(parameters, earlier, request.seed)
    summary = ViewsSummary(request.method, inputs)
    with job.tables(made, inputs.length_unit, {"ground_tracks": FusedTracks}) as tables:
        passed = _written(parts, tables, summary)
        if request.ground_tracks is not None:
            for part in inputs.on_ground(passed, window):
                tables.write(ground_tracks=part.tracks)
                summary.triangulation += part.counts
                summary.verdict.add(part)
        for _ in passed:
            pass
        _check_met(stream, request, inputs)
        losses = [*earlier, *summary.losses()]
        made = replace(made, losses=tuple(losses)).with_checks(summary.checks())
        tables.annotate(made)
    for line in inputs.known.notes:
        job.note(line)
    for text in texts_of(made.judged, "track"):
        job.note(text)
    world = {} if request.ground_tracks is None else {"ground_tracks": str(request.ground_tracks)}
    figures = {"method": request.method, **summary.summary(), **summary_of(made.judged)}
    return {"tracks": str(request.output), **world, **figures}, losses


def _check_met(stream: RegionStream | None, request: ViewsRequest, inputs: ViewsInput) -> None:
    """Raise InputError if a stream had regions, but none at the time of a frame."""
    if stream is not None and stream.read and not stream.met:
        raise InputError(
            f"{request.detections or request.bearings}: none of its {stream.read} regions is of the time of a frame "
            f"of {abridged(inputs.names)}; give detections that were made from this recording",
            id="disjoint-inputs",
        )


def _written(parts: Iterator[ViewsPart], tables: Tables, summary: ViewsSummary) -> Iterator[ViewTracks]:
    """Generate the view tracks of each part, after writing them to `tables` and adding the part to `summary`."""
    for part in parts:
        tables.write(output=part.tracks)
        summary.add(part)
        yield part.tracks


def view_settings(request: ViewsRequest) -> tuple[MipfConfig, ViewsConfig]:
    """Return the method's settings and those of births and ends; UsageError for an unknown setting."""
    around = {f.name for f in fields(ViewsConfig)}
    own = {name: value for name, value in request.settings.items() if name not in around}
    others = {name: value for name, value in request.settings.items() if name in around}
    config, stage = configure(CONFIGS[request.method](), own), configure(ViewsConfig(), others)
    if stage.confirmation_frames == 0 and request.initial_ellipses is None:
        raise UsageError(
            "confirmation_frames is 0, so detections initiate no tracker; give "
            f"{option('initial_ellipses')}, or set confirmation_frames to 1 or more",
            id="not-applicable",
        )
    return config, stage

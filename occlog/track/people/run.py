"""Run of `occlog track` with a multi-person method: read boxes, track, write, and sum up."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np

from occlog import console
from occlog.array_types import Floats
from occlog.errors import UsageError, option
from occlog.records.declared.people import COASTING, PREDICTED
from occlog.records.losses import OUTSIDE_IMAGE, Loss
from occlog.records.tables import Events, PeopleTracks, PeopleViews
from occlog.records.verdicts import Check, finding, outcome, summary_of, texts_of
from occlog.request import load
from occlog.runner import Job
from occlog.settings import configure
from occlog.track.catalogue import METHODS
from occlog.track.methods.jipda.filter import JipdaState
from occlog.track.methods.jipda.lasting_errors.position_errors import PositionErrors, learned_sigma, learned_sigma_ratio
from occlog.track.methods.sort.config import SortConfig
from occlog.track.request import TrackInImagesRequest, TrackPeopleRequest

from .camera_checks.agreement import CameraAgreement
from .image_tracks import ImageTracksPart, track_in_images
from .inputs import ImageInput, PeopleInput, inconsistent_cameras
from .reidentification import GalleryReidentification
from .rows import SnapshotTables
from .speeds import PeopleSpeeds
from .stage import PeopleTracker, Tabulator, track_people

OUTSIDE, SIZES, IDENTITIES = "boxes skipped at ingest", "person heights per camera", "expected identity switches"
FRAMES, SMOOTHED, FOUND = "frame numbering", "region error correlation", "number of people"
"""Names of checks."""
POSITION_NOISE = "position noise"
MAX_SIGMA_RATIO = 1.6
"""Maximum ratio of the learned standard deviation of positions to the stated one, or its inverse: two steps of the
bank."""
UNSIZED = "too few boxes are whole to compare cameras"
SWITCHES_PER_TARGET_NOTE, SWITCHES_PER_TARGET_WARNING = 0.2, 0.6
"""Expected identity switches per person that cause a note, and that cause a warning."""
MIN_SUCCESSIVE_SHARE, MIN_PAIRS = 0.02, 50
"""Share of frames with boxes that follow the one numbered before them that is suspicious, of so many frames."""
MAX_SKIPPED_SHARE = 0.2
"""Share of a camera's boxes that were omitted before, as they lie outside its image, that matters."""


class _Counts:
    """Counts and checks that the summaries of tracks on the ground and in the images have in common.

    People (identities), rows, rows without a box, times with people, events by kind, and expected identity switches.
    """

    def __init__(self, inputs: PeopleInput) -> None:
        """Start with all counts at 0; `inputs` is the tracker's input, with its counts of boxes."""
        self.inputs = inputs
        self.people: set[int] = set()
        self.rows = self.unseen = 0
        self.existence = self.exchanges = 0.0
        self.times = 0
        self.events: defaultdict[str, float] = defaultdict(float)

    def identities(self) -> tuple[Check, ...]:
        """Return the check of the expected number of identity switches per person."""
        each = self.exchanges / (self.rows / self.times) if self.rows else 0.0
        return outcome(
            IDENTITIES,
            self._doubtful(),
            unless="" if self.rows else "no person was found",
            switches=round(self.exchanges, 1),
            per_person=each,
            allowed=SWITCHES_PER_TARGET_WARNING,
        )

    def numbering(self) -> tuple[Check, ...]:
        """Return the check that frame numbers of each camera are mostly successive."""
        return outcome(FRAMES, self._numbers(), unless="" if self.inputs.numbers else "frames are not numbered")

    def found(self) -> tuple[Check, ...]:
        """Return the check that there are tracks, with their counts; finding `no-tracks` without any row."""
        return outcome(FOUND, self._no_tracks(), people=len(self.people), rows=self.rows)

    def count_events(self, events: Events) -> None:
        """Count the events by kind, and add the probabilities of possible switches to the expected number."""
        for kind, number in events.counts().items():
            self.events[kind] += number
        self.exchanges += float(np.nansum((events.shares() * events.probability)[events.kind == "possible_switch"]))

    def _no_tracks(self) -> Iterator[Check]:
        """Generate a finding if there are no tracks."""
        if not self.rows:
            yield finding(FOUND, "no-tracks")

    def _lost(self) -> Iterator[Check]:
        """Generate findings about cameras of which many boxes were omitted when the input was made.

        They lay outside the image; the share is above `MAX_SKIPPED_SHARE`.
        """
        tally = self.inputs.tally
        kept = tally.boxes + tally.outside + tally.twice
        for c, name in enumerate(self.inputs.names):
            gone = (each for each in self.inputs.losses if each.source == name)
            lost = sum(each.count for each in gone if each.what.startswith(OUTSIDE_IMAGE))
            whole = int(kept[c]) + lost
            if lost > MAX_SKIPPED_SHARE * whole:
                yield finding(
                    OUTSIDE,
                    "boxes-skipped",
                    sensors=[name],
                    count=lost,
                    boxes=whole,
                    share=lost / whole,
                    allowed=MAX_SKIPPED_SHARE,
                )

    def _numbers(self) -> Iterator[Check]:
        """Generate findings about cameras with frame numbers that are hardly ever successive."""
        for name, each in sorted(self.inputs.numbers.items()):
            successive = each.pairs - each.left_out
            if each.pairs >= MIN_PAIRS and successive < MIN_SUCCESSIVE_SHARE * each.pairs:
                yield finding(
                    FRAMES,
                    "frame-numbers-sparse",
                    sensors=[name],
                    count=successive,
                    frames=each.pairs,
                    share=successive / each.pairs,
                    allowed=MIN_SUCCESSIVE_SHARE,
                )

    def _doubtful(self) -> Iterator[Check]:
        """Generate a finding if the expected number of identity switches per person is high."""
        each = self.exchanges / (self.rows / self.times) if self.rows else 0.0
        if each >= SWITCHES_PER_TARGET_NOTE:
            yield finding(
                IDENTITIES,
                "identity-switches-likely",
                "warning" if each >= SWITCHES_PER_TARGET_WARNING else "note",
                switches=round(self.exchanges, 1),
                per_person=each,
                allowed=SWITCHES_PER_TARGET_WARNING,
            )


class PeopleSummary(_Counts):
    """Counts over a stream of tables, for the figures and checks of the summary of tracks on the ground."""

    def __init__(self, inputs: PeopleInput, agreement: CameraAgreement) -> None:
        """Start with all counts at 0; `agreement` counts what cameras detect in common, for the checks."""
        super().__init__(inputs)
        self.agreement = agreement
        self.speeds = PeopleSpeeds(agreement.person_height)
        self.positions: PositionErrors | None = None

    def learned(self, state: object) -> None:
        """Take the learned error models of position sensors from the last filter state.

        There are none (None) if the state is of another method.
        """
        self.positions = state.positions if isinstance(state, JipdaState) else None

    def add(self, part: SnapshotTables) -> None:
        """Add the tables of one part of the output to the counts."""
        self.people.update(part.tracks.target_id.tolist())
        self.rows += len(part.tracks)
        self.times += len(np.unique(part.tracks.t_ns))
        self.unseen += int(np.count_nonzero(np.char.startswith(part.tracks.quality_flags, COASTING)))
        self.existence += float(part.tracks.existence_probability.sum())
        self.speeds.add(part.tracks)
        self.count_events(part.events)

    def figures(self) -> dict[str, object]:
        """Return the figures of the summary by name.

        people, rows: of the tracks.  mean_people: at the times that have any.  coasting_share: share of the rows
        without a box of any camera. expected_switches: sum of the probabilities of possible identity switches. boxes:
        of each camera, those in use, associated and unassociated (expected numbers; a merged box of two people counts
        once), and confirmed: people whom another camera detects at the same time. detection_rates: of each camera, the
        share of the people detected by another camera and unoccluded in this one that it detects.
        common_position_error: standard deviation per axis and correlation time of the error that all cameras share.
        static_clutter: number of static objects that a camera reports as people. clock_offsets: delay [s] of a camera's
        clock (positive: frames show the past). position_sigma: standard deviation of each position sensor.
        """
        tally, used = self.inputs.tally, self.agreement.used
        boxes = {
            name: {
                "boxes": int(tally.boxes[c]),
                "associated": round(float(used[c]), 1),
                "unassociated": round(max(float(tally.boxes[c] - used[c]), 0.0), 1),
                **({"confirmed": int(self.agreement.confirmed[c])} if len(self.inputs.names) > 1 else {}),
                **({"outside_image": int(tally.outside[c])} if tally.outside[c] else {}),
                **({"duplicates": int(tally.twice[c])} if tally.twice[c] else {}),
            }
            for c, name in enumerate(self.inputs.names)
        }
        sees = {
            name: float(share)
            for name, share in zip(self.inputs.names, self.agreement.shares.tolist(), strict=True)
            if np.isfinite(share)
        }
        return {
            "people": len(self.people),
            "rows": self.rows,
            **({"mean_people": self.rows / self.times} if self.times else {}),
            **(
                {"mean_existence_probability": self.existence / self.rows, "coasting_share": self.unseen / self.rows}
                if self.rows
                else {}
            ),
            "initiated": round(self.events["initiated"]),
            "terminated": round(self.events["terminated"]),
            "possible_switches": round(self.events["possible_switch"]),
            "expected_switches": round(self.exchanges, 1),
            "frames": dict(zip(self.inputs.names, self.inputs.tally.frames.tolist(), strict=True)),
            "boxes": boxes,
            **({"detection_rates": sees} if sees else {}),
            **self._detectors(),
            **({"position_sigma": self._position_sigmas()} if self.positions and self.inputs.sources else {}),
        }

    def _detectors(self) -> dict[str, object]:
        """Return figures about detectors by name: common position error, static clutter and clock offsets.

        Those unknown or 0 are omitted.
        """
        found = self.agreement
        static = {name: n for name, n in zip(self.inputs.names, found.static.tolist(), strict=True) if n}
        late = {name: round(s, 3) for name, s in zip(self.inputs.names, found.late.tolist(), strict=True) if s}
        common = {"sigma": round(found.common_sigma, 4), "correlation_time_s": round(found.common_time_s, 2)}
        return {
            **({"common_position_error": common} if np.isfinite(found.common_sigma) else {}),
            **({"static_clutter": static} if static else {}),
            **({"clock_offsets": late} if late else {}),
        }

    def _position_sigmas(self) -> dict[str, float]:
        """Return the standard deviation per axis, stated or learned, of each position sensor, by name."""
        first, errors = len(self.inputs.cameras), self.positions
        if errors is None:
            return {}
        return {name: round(learned_sigma(errors, first + k), 4) for k, name in enumerate(self.inputs.sources)}

    def checks(self) -> tuple[Check, ...]:
        """Return all checks of the tracks on the ground, with their findings."""
        tally, heights = self.inputs.tally, self.agreement.person_heights()
        compared = np.count_nonzero(np.isfinite(heights)) > 1
        return (
            *self.agreement.checks(tally, self.inputs.scene.length_unit),
            *outcome(OUTSIDE, self._lost()),
            *outcome(SIZES, self._tall(heights), unless="" if compared else UNSIZED),
            *self.identities(),
            *self.numbering(),
            *self.speeds.checks(self.inputs.scene.length_unit),
            *outcome(SMOOTHED, self._smoothed()),
            *self.found(),
            *outcome(
                POSITION_NOISE, self._position_noise(), unless="" if self._sigma_ratios() else "no noise is stated"
            ),
        )

    def _sigma_ratios(self) -> dict[str, float]:
        """Return the ratio of the learned to the stated standard deviation of positions, by sensor name.

        Sensors that state none are omitted.
        """
        errors = self.positions
        if errors is None:
            return {}
        first = len(self.inputs.cameras)
        found = {name: learned_sigma_ratio(errors, first + k) for k, name in enumerate(self.inputs.sources)}
        return {name: ratio for name, ratio in found.items() if np.isfinite(ratio)}

    def _position_noise(self) -> Iterator[Check]:
        """Generate findings about position sensors with innovations that contradict the stated standard deviations."""
        for name, ratio in self._sigma_ratios().items():
            if ratio > MAX_SIGMA_RATIO:
                what = f"positions of {name}"
                yield finding(
                    POSITION_NOISE, "nis-large", sensors=[name], what=what, factor=ratio, nis=ratio**2,
                    allowed=MAX_SIGMA_RATIO**2,
                )  # fmt: skip
            elif ratio < 1.0 / MAX_SIGMA_RATIO:
                what = f"positions of {name}"
                yield finding(
                    POSITION_NOISE, "nis-small", sensors=[name], what=what, factor=1.0 / ratio, nis=ratio**2,
                    allowed=1.0 / MAX_SIGMA_RATIO**2,
                )  # fmt: skip

    def _smoothed(self) -> Iterator[Check]:
        """Generate the finding that regions of video have time-correlated errors, if they were smoothed."""
        if self.inputs.regions_smoothed and self.rows:
            yield finding(SMOOTHED, "correlated-region-errors")

    def _tall(self, heights: Floats) -> Iterator[Check]:
        """Generate findings about cameras in which people are much taller or shorter than in the others.

        `heights` (C,) are the median heights by the boxes of each camera; NaN: unknown.
        """
        unit = self.inputs.scene.length_unit
        for c, height in inconsistent_cameras(heights).items():
            name = self.inputs.names[c]
            yield finding(SIZES, "calibration-inconsistent", sensors=[name], height=height, unit=unit)


class ImageSummary(_Counts):
    """Counts over a stream of tables, for the figures and checks of the summary of tracks in the images."""

    def add(self, part: ImageTracksPart) -> None:
        """Add the rows and events of a part to the counts."""
        self.people.update(part.tracks.target_id.tolist())
        self.rows += len(part.tracks)
        keys = np.rec.fromarrays([part.tracks.t_ns, part.tracks.sensor])
        self.times += len(np.unique(keys)) if len(keys) else 0
        self.unseen += int(np.count_nonzero(part.tracks.likelihood_mode == PREDICTED))
        self.count_events(part.events)

    def figures(self) -> dict[str, object]:
        """Return the figures of the summary by name.

        identities, rows: of the tracks.  mean_people: in the frames that have any.  predicted_share: share of the rows
        without a box of their frame.  expected_switches: sum of the probabilities of possible identity switches.
        frames, boxes: of each camera, those that were read.
        """
        names, tally = self.inputs.names, self.inputs.tally
        return {
            "identities": len(self.people),
            "rows": self.rows,
            **({"mean_people": self.rows / self.times} if self.times else {}),
            **({"predicted_share": self.unseen / self.rows} if self.rows else {}),
            "possible_switches": round(self.events["possible_switch"]),
            "expected_switches": round(self.exchanges, 1),
            "frames": dict(zip(names, tally.frames.tolist(), strict=True)),
            "boxes": dict(zip(names, tally.boxes.tolist(), strict=True)),
        }

    def checks(self) -> tuple[Check, ...]:
        """Return all checks of the tracks in the images, with their findings."""
        return (*outcome(OUTSIDE, self._lost()), *self.identities(), *self.numbering(), *self.found())


def run_track_in_images(request: TrackInImagesRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Track in the image of each camera as requested, and write the tables.

    Return the figures of the summary, and the losses recorded in the input.

    Raises:
        UsageError: a time window is requested, which this method does not use.
    """
    if request.window is not None:
        raise UsageError(
            f"{option('window')}: method {request.method} takes each frame of a camera by itself; leave it out",
            id="not-applicable",
        )
    inputs = ImageInput(request)
    config = configure(SortConfig(), request.settings)
    parameters = {"method": request.method, "births": "detections", "cameras": list(inputs.names), **asdict(config)}
    made = job.provenance(parameters, inputs.losses, request.seed)
    summary = ImageSummary(inputs)
    with job.tables(made, inputs.scene.length_unit, {"output": PeopleViews}) as tables:
        for part in track_in_images(job.progress(inputs.frames, "track"), inputs.cameras, config):
            tables.write(output=part.tracks, events=part.events)
            summary.add(part)
        made = made.with_checks(summary.checks())
        tables.annotate(made)
    console.note_findings(texts_of(made.judged, "track"), job.quiet)
    names_of = {"output": "tracks"}
    written = {names_of.get(name, name): str(path) for name, path in request.files(output=True).items()}
    return {**written, "method": request.method, **summary.figures(), **summary_of(made.judged)}, inputs.losses


def run_track_people(request: TrackPeopleRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Track all people on the ground as requested, and write the tables.

    Return the figures of the summary, and the losses recorded in the inputs and of this run.
    """
    inputs = PeopleInput(request)
    for line in inputs.notes:
        job.note(line)
    names = None if request.gallery is None else GalleryReidentification(request.gallery, inputs)
    follower: PeopleTracker[object, object] = load(METHODS[request.method].method)
    steps = job.progress(inputs.time_steps, "track")
    in_images = request.view_tracks is not None
    height, room = inputs.config.person_height, inputs.scene.room
    tabulator = Tabulator(
        inputs.views, in_images=in_images, person_height=height, room=room, common_noise=inputs.scene.common_noise
    )
    summary = PeopleSummary(inputs, tabulator.agreement)
    seen = track_people(
        steps, inputs.scene, inputs.views, inputs.config, follower, request.seed, inputs.heard(), summary.learned
    )
    parameters = {
        "method": request.method,
        "births": "detections",
        "cameras": list(inputs.names),
        "window_ns": inputs.window_ns,
        **asdict(inputs.config),
        **({} if names is None else names.parameters),
    }
    provenance = job.provenance(parameters, inputs.losses, request.seed)
    wider = {"output": PeopleTracks, "view_tracks": PeopleViews}
    with job.tables(provenance, inputs.scene.length_unit, wider) as tables:
        parts = ((some, tabulator.tables(some)) for some in seen)
        for part in (part for _, part in parts) if names is None else names.named(parts):
            tables.write(output=part.tracks, associations=part.support, events=part.events, view_tracks=part.views)
            summary.add(part)
        losses = tuple(dict.fromkeys((*inputs.losses, *(() if names is None else names.losses))))
        made = replace(provenance, losses=losses).with_checks(summary.checks())
        tables.annotate(made)
    for line in () if names is None else names.notes():
        job.note(line)
    console.note_findings(texts_of(made.judged, "track"), job.quiet)
    names_of = {"output": "tracks"}
    written = {names_of.get(name, name): str(path) for name, path in request.files(output=True).items()}
    metrics = {} if names is None else names.figures()
    return {
        **written,
        "method": request.method,
        **summary.figures(),
        **inputs.clock_figures(),
        **summary_of(made.judged),
        **metrics,
    }, losses

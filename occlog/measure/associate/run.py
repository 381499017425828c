"""`occlog label`: read, assign, write.

With `--gallery`, compare boxes with a gallery, and write matches and renamed tracks.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, replace

import numpy as np

from occlog.errors import InputError, UsageError, option
from occlog.io.open import input_losses, open_in_unit, open_input
from occlog.measure.appearance.config import MatchConfig
from occlog.measure.appearance.run import SightingFiles, SightingInput
from occlog.measure.appearance.sightings import SightingTally
from occlog.measure.appearance.stage import EvidenceTally, identities, match, renamed, sides_of, tracks_together
from occlog.records.declared.people import SAME, AppearanceMatches, Gallery
from occlog.records.losses import Loss
from occlog.records.tables import PeopleTracks, Tracks
from occlog.runner import Job
from occlog.scans.grouping import choose_sensors
from occlog.scans.inputs import MeasurementInputs
from occlog.settings import configure

from .config import LabelConfig, NamingConfig
from .request import LabelRequest, MatchRequest
from .stage import Labelled, label


def run_label(request: LabelRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Label candidate bearings by tracks, and write them; return the summary and the losses of the inputs.

    InputError if no track exists at the time of any frame.
    """
    inputs = MeasurementInputs(request.bearings, request.scene, request.doa, request.doa_labels)
    tracks = inputs.open(request.tracks, Tracks)
    sensors = choose_sensors(inputs.scene, request.cameras, request.without)
    config = configure(LabelConfig(), request.settings)
    parameters = {"sensors": sorted(sensors), "doa_labels": request.doa_labels, **asdict(config)}
    losses, tally = inputs.losses, LabelTally()
    chunks = job.progress(inputs.chunks, "label")
    with job.tables(job.provenance(parameters, losses), inputs.scene.length_unit) as tables:
        for part in label(chunks, tracks, inputs.scene, config, sensors):
            tables.write(output=part.bearings)
            tally.add(part)
        if not tally.frames:
            raise InputError(
                f"{request.tracks}: no track is there at the time of any frame of {request.bearings}; give tracks of "
                f"the same recording, or a longer {option('max_gap')}",
                id="disjoint-inputs",
            )
    return {"bearings": str(request.output), **tally.summary()}, losses


class LabelTally:
    """Counts of labelled rows for the summary."""

    def __init__(self) -> None:
        """Start all counts at 0."""
        self.rows = 0
        self.labelled: Counter[int] = Counter()
        self.not_seen: Counter[int] = Counter()
        self.left = 0
        self.frames = 0

    def add(self, part: Labelled) -> None:
        """Add the counts of one part of the labelled bearings."""
        self.rows += len(part.bearings)
        self.labelled.update(part.given.tolist())
        self.not_seen.update(part.missed.tolist())
        self.left += part.left
        self.frames += part.frames

    def summary(self) -> dict[str, object]:
        """Return the figures of the summary by name.

        rows: rows of the output. frames_of_tracks: frames with a track at their time. labelled, missed_detections:
        by target, rows that got its label and rows that were added. unassigned_candidates: candidates without a
        label.
        """
        return {
            "rows": self.rows,
            "frames_of_tracks": self.frames,
            "labelled": dict(sorted(self.labelled.items())),
            "missed_detections": dict(sorted(self.not_seen.items())),
            "unassigned_candidates": self.left,
        }


def run_match(request: MatchRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Match boxes with a gallery of appearances and write the matches; optionally also the tracks, renamed by them.

    Args:
        request: inputs, outputs and settings.
        job: writes the outputs.

    Returns:
        Summary, and losses of the inputs.

    Raises:
        UsageError: renamed tracks are requested without tracks.
        InputError: no box could be compared.
    """
    if request.reidentified is not None and request.tracks is None:
        raise UsageError(
            f"{option('reidentified')}: needs tracks to rename; give {option('tracks')}", id="missing-option"
        )
    naming = NamingConfig(**request.naming)  # type: ignore[arg-type]
    opened = open_input(request.gallery, Gallery)
    sides = sides_of(opened.read(Gallery))
    seen_in = SightingFiles(request.bearings, request.images, request.tracks, request.scene)
    inputs = SightingInput(seen_in, request.labelled)
    unit = inputs.scene.length_unit
    config: MatchConfig = configure(MatchConfig.in_unit(unit), request.settings)
    tracks = None
    if request.reidentified is not None and request.tracks is not None:
        tracks = open_in_unit(request.tracks, unit, PeopleTracks).read(PeopleTracks)
    tally, decisions, evidence = SightingTally(), DecisionTally(), EvidenceTally()
    seen = inputs.sightings(job, "label", config, sides.levels, tally)
    parameters = {
        "positions": inputs.positions,
        "labelled": inputs.own_identity,
        **asdict(config),
        **asdict(naming),
    }
    made = job.provenance(parameters)
    before = (*input_losses([opened]), *inputs.losses)
    with job.tables(made, unit, later=("reidentified",)) as tables:
        for part in match(seen, sides, config):
            tables.write(output=part)
            decisions.add(part)
            evidence.add(part)
        losses = tuple(dict.fromkeys((*before, *tally.losses())))
        final = replace(made, losses=losses)
        tables.annotate(final)
        if not decisions.rows:
            raise InputError(
                f"{request.bearings}: no box was compared with the gallery: {tally.boxes} boxes in {tally.frames} "
                "frames; check that boxes and images are of one recording",
                id="disjoint-inputs",
            )
        summary: dict[str, object] = {"matches": str(request.output), "frames": tally.frames, **decisions.summary()}
        if tracks is not None:
            found = evidence.evidence()
            together_there = tracks_together(tracks, found.track)
            named = identities(found, together_there, config.min_similarity, naming.min_boxes)
            table, names = renamed(tracks, named, sides.target.tolist())
            tables.open("reidentified", final, PeopleTracks)
            tables.write(reidentified=table)
            summary |= {
                "reidentified": str(request.reidentified),
                "tracks": len(names),
                "tracks_of_gallery": len(named),
                "identities": {str(track): target for track, target in sorted(named.items())},
            }
    return summary, losses


class DecisionTally:
    """Counts of gallery decisions for the summary."""

    def __init__(self) -> None:
        """Start all counts at 0."""
        self.rows = self.boxes = self.same = self.decided = 0
        self.reasons: Counter[str] = Counter()

    def add(self, part: AppearanceMatches) -> None:
        """Count the boxes, pairs and decisions of a table of whole frames, sorted by frame and box."""
        fresh = np.append(True, (part.box[1:] != part.box[:-1]) | (part.sensor[1:] != part.sensor[:-1]))
        first = np.flatnonzero(fresh[: len(part)])
        self.rows += len(part)
        self.boxes += len(first)
        self.same += int(np.count_nonzero(part.decision == SAME))
        self.decided += int(np.count_nonzero(np.isfinite(part.rho)))
        self.reasons.update(part.reason[part.reason != ""].tolist())

    def summary(self) -> dict[str, object]:
        """Figures of the summary by name.

        boxes: boxes of all frames. labelled: boxes identified as a person of the gallery. compared: pairs of a box and
        a target. suspended: number of pairs that were not compared, by reason.
        """
        return {
            "boxes": self.boxes,
            "labelled": self.same,
            "compared": self.decided,
            "suspended": dict(sorted(self.reasons.items())),
        }

"""What `occlog label` does: read, assign, write."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING

from occlog.errors import InputError, option
from occlog.records.tables import Tracks
from occlog.runner import Job
from occlog.scans.grouping import choose_sensors
from occlog.scans.inputs import Inputs
from occlog.settings import configure

from .config import LabelConfig
from .request import LabelRequest
from .stage import Labelled, label

if TYPE_CHECKING:
    from occlog.records.losses import Loss


def run_label(request: LabelRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Label and write; the summary, and what had been lost before."""
    inputs = Inputs(request.bearings, request.scene, request.doa, request.doa_labels)
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
                f"the same recording, or a longer {option('max_gap')}"
            )
    return {"bearings": str(request.output), **tally.summary()}, losses


class LabelTally:
    """Figures of the summary, gathered while streaming."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.rows = 0
        self.labelled: Counter[int] = Counter()
        self.not_seen: Counter[int] = Counter()
        self.left = 0
        self.frames = 0

    def add(self, part: Labelled) -> None:
        """Count some more rows."""
        self.rows += len(part.bearings)
        self.labelled.update(part.given.tolist())
        self.not_seen.update(part.missed.tolist())
        self.left += part.left
        self.frames += part.frames

    def summary(self) -> dict[str, object]:
        """The figures.

        rows: in the output.  frames_of_tracks: at whose time there is a track.  labelled, not_seen:
        rows of each target that got a label, or were added.  candidates_left: those of nobody.
        """
        return {
            "rows": self.rows,
            "frames_of_tracks": self.frames,
            "labelled": dict(sorted(self.labelled.items())),
            "not_seen": dict(sorted(self.not_seen.items())),
            "candidates_left": self.left,
        }

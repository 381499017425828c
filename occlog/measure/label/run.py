"""What `occlog label` does: read, assign, write."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from occlog import console
from occlog.errors import InputError
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.files.tables.table_writer import TableWriter
from occlog.records.tables import Bearings, Tracks
from occlog.scans.grouping import choose_sensors
from occlog.scans.inputs import Inputs

from .config import LabelConfig
from .stage import Labelled, label

if TYPE_CHECKING:
    from occlog.records.losses import Loss


@dataclass(frozen=True)
class LabelFiles:
    """What to read and to write."""

    bearings: Path
    tracks: Path
    scene: Path | None
    doa: Path | None
    doa_labels: bool
    output: Path
    overwrite: bool

    @property
    def inputs(self) -> list[Path]:
        """Every file that is read."""
        given = (self.bearings, self.tracks, self.scene, self.doa)
        return [p for p in given if p is not None]


@dataclass(frozen=True)
class Sensors:
    """Names of sensors to use; empty: all of the scene but those left out."""

    only: tuple[str, ...]
    without: tuple[str, ...]


def run_label(
    files: LabelFiles, use: Sensors, config: LabelConfig, quiet: bool
) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Label and write; the summary, and what had been lost before."""
    inputs = Inputs(files.bearings, files.scene, files.doa, files.doa_labels)
    tracks = inputs.open(files.tracks, Tracks)
    sensors = choose_sensors(inputs.scene, use.only, use.without)
    parameters = {"sensors": sorted(sensors), "doa_labels": files.doa_labels, **asdict(config)}
    losses = inputs.losses
    provenance = Provenance("label", parameters, None, hash_inputs(files.inputs), losses)
    unit, tally = inputs.scene.length_unit, LabelTally()
    chunks = console.progress(inputs.chunks, "label", quiet=quiet)
    with TableWriter(files.output, Bearings, provenance, overwrite=files.overwrite, length_unit=unit) as writer:
        for part in label(chunks, tracks, inputs.scene, config, sensors):
            writer.write(part.bearings)
            tally.add(part)
        if not tally.frames:
            raise InputError(
                f"{files.tracks}: no track is there at the time of any frame of {files.bearings}; give tracks of the "
                "same recording, or a longer --max-gap"
            )
    return {"bearings": str(files.output), **tally.summary()}, losses


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

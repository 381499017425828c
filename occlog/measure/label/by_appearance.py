"""What `occlog label --gallery` does: compare boxes with a gallery, write the matches, and the tracks renamed."""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from occlog import console
from occlog.errors import InputError, UsageError
from occlog.io.files.atomic import Together
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.open import losses_of, open_in_unit, open_input
from occlog.measure.appearance.config import MatchConfig
from occlog.measure.appearance.identities import EvidenceTally, identities, renamed, tracks_together
from occlog.measure.appearance.inputs import SightingFiles, SightingInput
from occlog.measure.appearance.sightings import SightingTally, sightings
from occlog.measure.appearance.stage import match, sides_of
from occlog.records.declared.gallery import SAME, AppearanceMatches, Gallery
from occlog.records.losses import Loss
from occlog.records.tables import PeopleTracks
from occlog.settings import configure

from .config import NamingConfig


@dataclass(frozen=True)
class MatchFiles:
    """What to read and to write."""

    seen: SightingFiles
    gallery: Path
    labelled: bool  # the identities of boxes are those of the tracks
    output: Path
    named: Path | None
    overwrite: bool

    @property
    def inputs(self) -> list[Path]:
        """Every file that is read."""
        return [*self.seen.paths, self.gallery]


def run_match(
    files: MatchFiles, settings: dict[str, object], naming: NamingConfig, quiet: bool
) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Match and write; the summary, and what was lost."""
    if files.named is not None and files.seen.tracks is None:
        raise UsageError("named: writes tracks under other identities, and there are none; give tracks")
    opened = open_input(files.gallery, Gallery)
    sides = sides_of(opened.read(Gallery))
    inputs = SightingInput(files.seen, files.labelled)
    scene, unit = inputs.scene, inputs.scene.length_unit
    config: MatchConfig = configure(MatchConfig.in_unit(unit), settings)
    tracks = None
    if files.named is not None and files.seen.tracks is not None:
        tracks = open_in_unit(files.seen.tracks, unit, PeopleTracks).read(PeopleTracks)
    tally, decisions, evidence = SightingTally(), DecisionTally(), EvidenceTally()
    seen = sightings(
        console.progress(inputs.boxes(), "label", quiet=quiet),
        inputs.images(),
        inputs.walks(config),
        scene,
        config,
        levels=sides.levels,
        own_identity=inputs.own_identity,
        tally=tally,
    )
    parameters = {
        "positions": inputs.positions,
        "labelled": inputs.own_identity,
        **asdict(config),
        **asdict(naming),
    }
    made = Provenance("label", parameters, None, hash_inputs(files.inputs))
    before = (*losses_of([opened]), *inputs.losses)
    with ExitStack() as stack:
        together = stack.enter_context(Together())
        writer = stack.enter_context(
            TableWriter(
                files.output, AppearanceMatches, made, overwrite=files.overwrite, length_unit=unit, together=together
            )
        )
        for part in match(seen, sides, config):
            writer.write(part)
            decisions.add(part)
            evidence.add(part)
        losses = tuple(dict.fromkeys((*before, *tally.losses())))
        final = Provenance("label", parameters, None, made.inputs, losses)
        writer.annotate(final)
        if not writer.rows:
            raise InputError(
                f"{files.seen.boxes}: no box was compared: {tally.boxes} boxes in {tally.frames} frames; check that "
                "boxes and images are of one recording"
            )
        summary: dict[str, object] = {"matches": str(files.output), "frames": tally.frames, **decisions.summary()}
        if tracks is not None and files.named is not None:
            found = evidence.evidence()
            together_there = tracks_together(tracks, found.track)
            named = identities(found, together_there, config.least_likeness, naming.least_boxes)
            table, names = renamed(tracks, named, sides.target.tolist())
            with TableWriter(
                files.named, PeopleTracks, final, overwrite=files.overwrite, length_unit=unit, together=together
            ) as out:
                out.write(table)
            summary |= {
                "named": str(files.named),
                "tracks": len(names),
                "tracks_of_gallery": len(named),
                "identities": {str(track): target for track, target in sorted(named.items())},
            }
    return summary, losses


class DecisionTally:
    """Figures of the summary, gathered while streaming."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.boxes = self.same = self.decided = 0
        self.reasons: Counter[str] = Counter()

    def add(self, part: AppearanceMatches) -> None:
        """Count the rows of whole frames."""
        fresh = np.append(True, (part.box[1:] != part.box[:-1]) | (part.sensor[1:] != part.sensor[:-1]))
        first = np.flatnonzero(fresh[: len(part)])
        self.boxes += len(first)
        self.same += int(np.count_nonzero(part.decision == SAME))
        self.decided += int(np.count_nonzero(np.isfinite(part.rho)))
        self.reasons.update(part.reason[part.reason != ""].tolist())

    def summary(self) -> dict[str, object]:
        """The figures.

        boxes: of all frames.  labelled: boxes that are somebody of the gallery.  compared: pairs of a box and a target.
        suspended: pairs that were not compared, by the reason.
        """
        return {
            "boxes": self.boxes,
            "labelled": self.same,
            "compared": self.decided,
            "suspended": dict(sorted(self.reasons.items())),
        }

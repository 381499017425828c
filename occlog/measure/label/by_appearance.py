"""What `occlog label --gallery` does: compare boxes with a gallery, write the matches, and the tracks renamed."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, replace

import numpy as np

from occlog.errors import InputError, UsageError, option
from occlog.io.open import losses_of, open_in_unit, open_input
from occlog.measure.appearance.config import MatchConfig
from occlog.measure.appearance.identities import EvidenceTally, identities, renamed, tracks_together
from occlog.measure.appearance.inputs import SightingFiles, SightingInput
from occlog.measure.appearance.sightings import SightingTally, sightings
from occlog.measure.appearance.stage import match, sides_of
from occlog.records.declared.gallery import SAME, AppearanceMatches, Gallery
from occlog.records.losses import Loss
from occlog.records.tables import PeopleTracks
from occlog.runner import Job
from occlog.settings import configure

from .config import NamingConfig
from .request import MatchRequest


def run_match(request: MatchRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Match and write; the summary, and what was lost."""
    if request.named is not None and request.tracks is None:
        raise UsageError(
            f"{option('named')}: writes tracks under other identities, and there are none; give {option('tracks')}"
        )
    naming = NamingConfig(**request.naming)  # type: ignore[arg-type]
    opened = open_input(request.gallery, Gallery)
    sides = sides_of(opened.read(Gallery))
    seen_in = SightingFiles(request.bearings, request.images, request.tracks, request.scene)
    inputs = SightingInput(seen_in, request.labelled)
    scene, unit = inputs.scene, inputs.scene.length_unit
    config: MatchConfig = configure(MatchConfig.in_unit(unit), request.settings)
    tracks = None
    if request.named is not None and request.tracks is not None:
        tracks = open_in_unit(request.tracks, unit, PeopleTracks).read(PeopleTracks)
    tally, decisions, evidence = SightingTally(), DecisionTally(), EvidenceTally()
    seen = sightings(
        job.progress(inputs.boxes(), "label"),
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
    made = job.provenance(parameters)
    before = (*losses_of([opened]), *inputs.losses)
    with job.tables(made, unit, later=("named",)) as tables:
        for part in match(seen, sides, config):
            tables.write(output=part)
            decisions.add(part)
            evidence.add(part)
        losses = tuple(dict.fromkeys((*before, *tally.losses())))
        final = replace(made, losses=losses)
        tables.annotate(final)
        if not decisions.rows:
            raise InputError(
                f"{request.bearings}: no box was compared: {tally.boxes} boxes in {tally.frames} frames; check that "
                "boxes and images are of one recording"
            )
        summary: dict[str, object] = {"matches": str(request.output), "frames": tally.frames, **decisions.summary()}
        if tracks is not None:
            found = evidence.evidence()
            together_there = tracks_together(tracks, found.track)
            named = identities(found, together_there, config.least_likeness, naming.least_boxes)
            table, names = renamed(tracks, named, sides.target.tolist())
            tables.open("named", final, PeopleTracks)
            tables.write(named=table)
            summary |= {
                "named": str(request.named),
                "tracks": len(names),
                "tracks_of_gallery": len(named),
                "identities": {str(track): target for track, target in sorted(named.items())},
            }
    return summary, losses


class DecisionTally:
    """Figures of the summary, gathered while streaming."""

    def __init__(self) -> None:
        """Nothing yet."""
        self.rows = self.boxes = self.same = self.decided = 0
        self.reasons: Counter[str] = Counter()

    def add(self, part: AppearanceMatches) -> None:
        """Count the rows of whole frames."""
        fresh = np.append(True, (part.box[1:] != part.box[:-1]) | (part.sensor[1:] != part.sensor[:-1]))
        first = np.flatnonzero(fresh[: len(part)])
        self.rows += len(part)
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

"""What `occlog appearance learn` does: read boxes with their images, gather their colours, write a gallery."""

from __future__ import annotations

from dataclasses import asdict

from occlog.errors import InputError, UsageError, option
from occlog.records.declared.gallery import Gallery
from occlog.records.losses import Loss
from occlog.runner import Job
from occlog.settings import configure

from .config import LearnConfig
from .inputs import SightingFiles, SightingInput
from .request import LearnRequest
from .sightings import SightingTally, sightings
from .stage import learn


def run_learn(request: LearnRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Learn and write; the summary, and what was lost."""
    if request.boxes is not None and request.views is not None:
        raise UsageError(f"{option('boxes')} and {option('views')} are two sources of boxes; give one of them")
    boxes = request.boxes or request.views or request.recording
    inputs = SightingInput(SightingFiles(boxes, request.recording, request.tracks, request.scene), request.labelled)
    config: LearnConfig = configure(LearnConfig.in_unit(inputs.scene.length_unit), request.settings)
    tally = SightingTally()
    seen = sightings(
        job.progress(inputs.boxes(), "learn"),
        inputs.images(),
        inputs.walks(config),
        inputs.scene,
        config,
        levels=config.levels,
        own_identity=inputs.own_identity,
        tally=tally,
    )
    gallery = learn(seen, config)
    if not len(gallery):
        raise InputError(
            f"{boxes}: no side of anybody was seen in {config.least_samples} boxes: of {tally.boxes} boxes "
            f"{tally.of_tracks} are of a track; check that boxes, images and {inputs.positions} are of one recording"
        )
    losses = (*inputs.losses, *tally.losses())
    parameters = {"positions": inputs.positions, "labelled": inputs.own_identity, **asdict(config)}
    with job.tables(job.provenance(parameters, losses), inputs.scene.length_unit) as tables:
        tables.write(output=gallery.sorted())
    return {"gallery": str(request.output), **_figures(gallery, tally), "positions": inputs.positions}, losses


def _figures(gallery: Gallery, tally: SightingTally) -> dict[str, object]:
    """Figures of the summary; `sides` has the viewing angles that each target was learnt at."""
    sides: dict[int, list[int]] = {}
    for target, angle in zip(gallery.target_id.tolist(), gallery.angle.tolist(), strict=True):
        sides.setdefault(target, []).append(angle)
    return {
        "frames": tally.frames,
        "boxes": tally.boxes,
        "boxes_of_tracks": tally.of_tracks,
        "samples": int(gallery.samples.sum()),
        "angles": int(gallery.angles[0]),
        "bins": int(gallery.bins[0]),
        "targets": len(sides),
        "sides": {str(target): " ".join(map(str, angles)) for target, angles in sides.items()},
    }

"""What `occlog appearance learn` does: read boxes with their images, gather their colours, write a gallery."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from occlog import console
from occlog.errors import InputError
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.table_writer import write_table
from occlog.records.declared.gallery import Gallery
from occlog.records.losses import Loss
from occlog.settings import configure

from .config import LearnConfig
from .inputs import SightingFiles, SightingInput
from .sightings import SightingTally, sightings
from .stage import learn


def run_learn(
    files: SightingFiles,
    labelled: bool,
    settings: dict[str, object],
    output: Path,
    overwrite: bool,
    quiet: bool,
) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Learn and write; the summary, and what was lost."""
    inputs = SightingInput(files, labelled)
    config: LearnConfig = configure(LearnConfig.in_unit(inputs.scene.length_unit), settings)
    tally = SightingTally()
    seen = sightings(
        console.progress(inputs.boxes(), "learn", quiet=quiet),
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
            f"{files.boxes}: no side of anybody was seen in {config.least_samples} boxes: of {tally.boxes} boxes "
            f"{tally.of_tracks} are of a track; check that boxes, images and {inputs.positions} are of one recording"
        )
    losses = (*inputs.losses, *tally.losses())
    parameters = {"positions": inputs.positions, "labelled": inputs.own_identity, **asdict(config)}
    provenance = Provenance("appearance learn", parameters, None, hash_inputs(files.paths), losses)
    write_table(output, gallery, provenance, overwrite=overwrite, length_unit=inputs.scene.length_unit)
    summary: dict[str, object] = {"gallery": str(output), **_figures(gallery, tally), "positions": inputs.positions}
    return summary, losses


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

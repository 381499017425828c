"""Run of `occlog track` with a tracker of one camera: read boxes, follow each camera's, write, and sum up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from occlog import console
from occlog.errors import InputError, UsageError
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.open import open_input
from occlog.plugins.chosen import Chosen
from occlog.plugins.interface import ViewTracker
from occlog.plugins.loading import Plugin
from occlog.records.losses import Loss
from occlog.records.tables import Boxes, Views
from occlog.track.catalogue import METHODS

from .stage import Trackers, follow

REMEDY = "give a recording with boxes of a detector, or the boxes or views that one has found"


@dataclass(frozen=True)
class SingleViewRequest:
    """Whose boxes to follow, and how, as the user asks for it."""

    boxes: Path
    scene: Path | None
    method: str
    settings: Mapping[str, object]
    only: tuple[str, ...]  # cameras; empty: all
    without: tuple[str, ...]
    seed: int

    @property
    def paths(self) -> list[Path]:
        """All inputs, each once."""
        return list(dict.fromkeys(p for p in (self.boxes, self.scene) if p is not None))


def run_track_single_view(
    request: SingleViewRequest, output: Path, overwrite: bool, quiet: bool
) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Follow and write; return the summary, and what had been lost before."""
    opened = open_input(request.boxes, Boxes, Views, remedy=REMEDY)
    unit = opened.length_unit or "m"
    chosen = Chosen(_plugin(request.method), request.settings)
    seen: set[str] = set()

    def make(camera: str) -> ViewTracker:
        rng = np.random.default_rng([request.seed, *camera.encode()])
        tracker: ViewTracker = chosen.make(unit, rng)
        return tracker

    def used(camera: str) -> bool:
        seen.add(camera)
        return (not request.only or camera in request.only) and camera not in request.without

    told = chosen.provenance(unit)
    parameters = {
        "method": request.method,
        "births": "detections",
        "only": list(request.only),
        "without": list(request.without),
        "plugin": told.pop("package"),
        **told,
    }
    provenance = Provenance("track", parameters, request.seed, hash_inputs(request.paths), opened.losses)
    trackers = Trackers(chosen.plugin, make)
    rows = opened.rows(Boxes) if opened.has(Boxes) else opened.rows(Views)
    with TableWriter(output, Boxes, provenance, overwrite=overwrite, length_unit=unit) as writer:
        for part in follow(console.progress(rows, "track", quiet=quiet), trackers, used):
            writer.write(part)
        for name in (*request.only, *request.without):
            if name not in seen:
                raise UsageError(f"no camera {name!r} in {request.boxes}; there are {', '.join(sorted(seen))}")
        if not trackers.cameras:
            raise InputError(f"{request.boxes}: no camera is left to track in; use at least one")
    summary: dict[str, object] = {"tracks": str(output), "method": request.method, "plugin": chosen.plugin.origin}
    summary |= {"cameras": trackers.cameras, "frames": trackers.frames, "boxes": trackers.boxes}
    return summary | {"left_out": trackers.of_nobody, "identities": len(trackers.numbers)}, opened.losses


def _plugin(method: str) -> Plugin:
    """The plug-in of a method that is one."""
    plugin = METHODS[method].plugin
    if plugin is None:
        raise UsageError(f"method {method} is no tracker of one camera")
    return plugin

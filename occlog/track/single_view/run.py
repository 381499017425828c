"""Run of `occlog track` with a tracker of one camera: read boxes, follow each camera's, write, and sum up."""

from __future__ import annotations

import numpy as np

from occlog.errors import InputError, UsageError, abridged, option
from occlog.io.open import open_input
from occlog.plugins.interface import ViewTracker
from occlog.plugins.loading import Chosen, Plugin
from occlog.records.losses import Loss
from occlog.records.tables import Boxes, Views
from occlog.records.verdicts import finding, outcome
from occlog.runner import Job
from occlog.track.catalogue import METHODS
from occlog.track.request import SingleViewRequest

from .stage import CameraTrackers, follow

FOUND = "number of people"
"""Name of the check."""
REMEDY = "give a recording with boxes of a detector, or the boxes or views that one has found"


def run_track_single_view(request: SingleViewRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Track in each camera as requested, and write the tables.

    Return the figures of the summary, and the losses of earlier steps. UsageError for a window or an unknown camera,
    InputError if no camera is left.
    """
    if request.window is not None:
        raise UsageError(
            f"{option('window')}: method {request.method} takes each frame of a camera by itself; leave it out",
            id="not-applicable",
        )
    opened = open_input(request.bearings, Boxes, Views, remedy=REMEDY)
    unit = opened.length_unit or "m"
    chosen = Chosen(_plugin(request.method), request.settings)
    seen: set[str] = set()

    def make(camera: str) -> ViewTracker:
        rng = np.random.default_rng([request.seed, *camera.encode()])
        tracker: ViewTracker = chosen.make(unit, rng)
        return tracker

    def used(camera: str) -> bool:
        seen.add(camera)
        return (not request.cameras or camera in request.cameras) and camera not in request.without

    recorded = chosen.provenance(unit)
    parameters = {
        "method": request.method,
        "births": "detections",
        "only": list(request.cameras),
        "without": list(request.without),
        "plugin": recorded.pop("package"),
        **recorded,
    }
    provenance = job.provenance(parameters, opened.losses, request.seed)
    trackers = CameraTrackers(chosen.plugin, make)
    rows = opened.rows(Boxes) if opened.has(Boxes) else opened.rows(Views)
    with job.tables(provenance, unit) as tables:
        for part in follow(job.progress(rows, "track"), trackers, used):
            tables.write(output=part)
        for name in (*request.cameras, *request.without):
            if name not in seen:
                raise UsageError(
                    f"no camera {name!r} in {request.bearings}; there are {abridged(sorted(seen))}",
                    id="unknown-sensor",
                )
        if not trackers.cameras:
            raise InputError(
                f"{request.bearings}: no camera is left to track in; exclude fewer ({option('without')})",
                id="too-few-sensors",
            )
        empty = () if trackers.numbers else (finding(FOUND, "no-tracks"),)
        tables.annotate(job.judged(provenance, outcome(FOUND, empty, people=len(trackers.numbers))))
    summary: dict[str, object] = {
        "tracks": str(request.output),
        "method": request.method,
        "plugin": chosen.plugin.origin,
    }
    summary |= {"cameras": trackers.cameras, "frames": trackers.frames, "boxes": trackers.boxes}
    return summary | {"skipped": trackers.unassigned, "identities": len(trackers.numbers)}, opened.losses


def _plugin(method: str) -> Plugin:
    """Return the plug-in that the method is from; UsageError for a method of another kind."""
    plugin = METHODS[method].plugin
    if plugin is None:
        raise UsageError(
            f"method {method} is not a plug-in that tracks in the images of one camera; use one, or method sort",
            id="not-applicable",
        )
    return plugin

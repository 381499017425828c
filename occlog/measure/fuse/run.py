"""`occlog fuse`: open bearings and views, fuse, and write them; figures of the fusion."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict

from occlog import console
from occlog.consistency.verdict import MIN_SAMPLES, exceeds_share
from occlog.errors import UsageError, option
from occlog.io.open import open_input
from occlog.records.frames import skipped_frames_of
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import Tracks, Views
from occlog.records.verdicts import Check, finding, outcome
from occlog.runner import Job
from occlog.scans.inputs import MeasurementInputs
from occlog.settings import configure

from .config import FuseConfig
from .request import FuseRequest
from .rows import in_step
from .stage import FusedPart, fuse
from .views import placed_cameras

AGREE = "camera agreement"
"""Name of the check."""
MAX_REMOVED = 0.2
"""Share of a camera's detections of targets that the fusion removes that matters, beyond its stated false ones."""


def run_fuse(request: FuseRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Fuse the detections of several cameras and write bearings and views; return the summary and the inputs' losses.

    Raises:
        UsageError: fused views are requested without views, or the file holds tracks.
    """
    if request.fused_views is not None and request.views is None:
        raise UsageError(
            f"{option('fused_views')} requires the views of the bearings; give them with {option('views')}",
            id="missing-option",
        )
    if open_input(request.bearings).table == Tracks.NAME:
        raise UsageError(
            f"{request.bearings}: holds tracks; to fuse them add tracks of other cameras with {option('with')}, or "
            "give bearings",
            id="wrong-content",
        )
    inputs = MeasurementInputs(request.bearings, request.scene)
    views = [] if request.views is None else inputs.open(request.views, Views)
    unit = inputs.scene.length_unit
    config = configure(FuseConfig.in_unit(unit), request.settings)
    kept = {} if request.views is None else skipped_frames_of(open_input(request.views).provenance.parameters)
    provenance = job.provenance({**asdict(config), **kept}, inputs.losses)
    chunks = job.progress(inputs.chunks, "fuse")
    tally = FuseTally(inputs.scene, config)
    with job.tables(provenance, unit) as tables:
        for part in fuse(in_step(views, chunks), inputs.scene, config):
            tables.write(output=part.bearings, fused_views=part.views)
            tally.add(part)
        tables.annotate(job.judged(provenance, tally.checks()))
    tally.warn(job.quiet)
    return {"bearings": str(request.output), **tally.summary()}, inputs.losses


class FuseTally:
    """Counts of a fusion for the summary."""

    def __init__(self, scene: Scene, config: FuseConfig) -> None:
        """Start with counts of 0 for the cameras of a scene with a pose."""
        cameras = placed_cameras(scene, config)
        self._false = dict(zip(cameras.names, cameras.p_false.tolist(), strict=True))
        self.totals: Counter[str] = Counter()
        self.cameras: dict[str, Counter[str]] = {}
        self._of_targets: dict[str, Counter[str]] = {}  # detections with a label

    def add(self, part: FusedPart) -> None:
        """Count the rows of one more part."""
        for name, counts in part.counts.items():
            self.cameras.setdefault(name, Counter()).update(counts)
        for name, (kept, removed) in part.targets.items():
            self._of_targets.setdefault(name, Counter()).update(kept=kept, removed=removed)
        self.totals.update(moments=part.moments, declared=part.declared, not_declared=part.absent, alone=part.alone)

    def summary(self) -> dict[str, object]:
        """Return the figures of the summary by name; `cameras` has the counts of each camera.

        declared: objects declared, counted once per time step. not_declared: objects with detections that were not
        declared. kept, recovered, removed: detections.
        """
        whole: Counter[str] = Counter()
        for counts in self.cameras.values():
            whole.update(counts)
        out: dict[str, object] = {"time_steps": self.totals["moments"]}
        out |= {k: self.totals[k] for k in ("declared", "not_declared")}
        out |= {k: whole[k] for k in ("kept", "recovered", "removed")}
        return out | {"cameras": {name: dict(counts) for name, counts in self.cameras.items()}}

    def checks(self) -> tuple[Check, ...]:
        """Check the agreement of the cameras: the share of labelled detections that the fusion removes.

        A finding about the worst camera if its share is significantly above `MAX_REMOVED` plus its stated
        probability of false alarms. Without a camera with `MIN_SAMPLES` labelled detections the check is not made.
        """
        removed = {name: own["removed"] for name, own in self._of_targets.items()}
        whole = {name: own.total() for name, own in self._of_targets.items()}
        counted = [name for name, count in whole.items() if count >= MIN_SAMPLES]
        few = f"no camera has {MIN_SAMPLES} detections with a label; of those without one many may be false"
        limits = {name: MAX_REMOVED + self._false[name] for name in counted}
        worst = max(counted, key=lambda name: removed[name] / whole[name] - limits[name], default="")
        share, limit = (removed[worst] / whole[worst], limits[worst]) if counted else (math.nan, math.nan)
        found: tuple[Check, ...] = ()
        if counted and exceeds_share(removed[worst], whole[worst], limit):
            found = (
                finding(
                    AGREE,
                    "many-detections-rejected",
                    sensors=[worst],
                    count=removed[worst],
                    detections=whole[worst],
                    share=share,
                    allowed=limit,
                ),
            )
        return outcome(AGREE, found, unless="" if counted else few, share=share, allowed=limit)

    def warn(self, quiet: bool) -> None:
        """Note if only a single camera has a frame at most time steps, so that there is nothing to fuse."""
        alone, n_steps = self.totals["alone"], self.totals["moments"]
        if 2 * alone > n_steps:
            console.note(
                f"warning: at {alone} of {n_steps} times only one camera delivered a frame; bring frames that are "
                f"close in time together with {option('window')} SECONDS (detect: {option('fuse_window')})",
                quiet,
            )

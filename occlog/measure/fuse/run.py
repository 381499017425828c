"""What `occlog fuse` does: open bearings and views, fuse, write; and the figures of a fusion."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import TYPE_CHECKING

from occlog import console
from occlog.errors import UsageError, option
from occlog.io.open import open_input
from occlog.records.left_out_frames import carried
from occlog.records.tables import Tracks, Views
from occlog.runner import Job
from occlog.scans.inputs import Inputs
from occlog.settings import configure

from .config import FuseConfig
from .moments import together
from .request import FuseRequest
from .stage import Fused, fuse

if TYPE_CHECKING:
    from occlog.records.losses import Loss


def run_fuse(request: FuseRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Fuse and write; the summary, and what had been lost before."""
    if request.fused_views is not None and request.views is None:
        raise UsageError(f"{option('fused_views')} wants the views of the bearings; give them with {option('views')}")
    if open_input(request.bearings).table == Tracks.NAME:
        raise UsageError(
            f"{request.bearings}: holds tracks; name those of another group of cameras with {option('with')}, or give "
            "bearings"
        )
    inputs = Inputs(request.bearings, request.scene)
    views = [] if request.views is None else inputs.open(request.views, Views)
    unit = inputs.scene.length_unit
    config = configure(FuseConfig.in_unit(unit), request.settings)
    kept = {} if request.views is None else carried(open_input(request.views).provenance.parameters)
    provenance = job.provenance({**asdict(config), **kept}, inputs.losses)
    chunks = job.progress(inputs.chunks, "fuse")
    tally = FuseTally()
    with job.tables(provenance, unit) as tables:
        for part in fuse(together(views, chunks), inputs.scene, config):
            tables.write(output=part.bearings, fused_views=part.views)
            tally.add(part)
    tally.warn(job.quiet)
    return {"bearings": str(request.output), **tally.summary()}, inputs.losses


class FuseTally:
    """Figures of the summary of a fusion, gathered while streaming."""

    def __init__(self) -> None:
        """Start with no figures."""
        self.totals: Counter[str] = Counter()
        self.cameras: dict[str, Counter[str]] = {}

    def add(self, part: Fused) -> None:
        """Count the rows of one more part."""
        for name, counts in part.counts.items():
            self.cameras.setdefault(name, Counter()).update(counts)
        self.totals.update(moments=part.moments, declared=part.declared, not_declared=part.absent, alone=part.alone)

    def summary(self) -> dict[str, object]:
        """Figures of all cameras, and of each.

        declared: objects, one a moment and object; not_declared: those with detections that were not.
        """
        whole: Counter[str] = Counter()
        for counts in self.cameras.values():
            whole.update(counts)
        out: dict[str, object] = {k: self.totals[k] for k in ("moments", "declared", "not_declared")}
        out |= {k: whole[k] for k in ("kept", "recovered", "removed")}
        return out | {"cameras": {name: dict(counts) for name, counts in self.cameras.items()}}

    def warn(self, quiet: bool) -> None:
        """Print a note if at most moments a single camera delivered a frame, so that there is nothing to fuse."""
        alone, moments = self.totals["alone"], self.totals["moments"]
        if 2 * alone > moments:
            console.note(
                f"warning: at {alone} of {moments} times only one camera delivered a frame; bring frames that are "
                f"close in time together with {option('window')} SECONDS (detect: {option('fuse_window')})",
                quiet,
            )

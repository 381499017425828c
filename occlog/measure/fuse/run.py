"""What `occlog fuse` does: open bearings and views, fuse, write; and the figures of a fusion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from occlog import console
from occlog.errors import UsageError
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.files.tables.table_writer import TableWriter
from occlog.io.open import open_input
from occlog.records.columns import Table
from occlog.records.left_out_frames import carried
from occlog.records.tables import Bearings, Tracks, Views
from occlog.scans.inputs import Inputs
from occlog.settings import configure

from .config import FuseConfig
from .moments import together
from .stage import Fused, fuse

if TYPE_CHECKING:
    from occlog.records.losses import Loss


@dataclass(frozen=True)
class FuseFiles:
    """What to read and to write."""

    bearings: Path
    views: Path | None
    scene: Path | None
    output: Path
    fused_views: Path | None
    overwrite: bool

    @property
    def inputs(self) -> list[Path]:
        """Every file that is read."""
        return [p for p in (self.bearings, self.views, self.scene) if p is not None]


def run_fuse(files: FuseFiles, values: Mapping[str, object], quiet: bool) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Fuse and write; the summary, and what had been lost before.

    Args:
        files: inputs and outputs.
        values: settings of `FuseConfig` that were given.
        quiet: no progress and no notes.
    """
    if files.fused_views is not None and files.views is None:
        raise UsageError("--fused-views wants the views of the bearings; give them with --views")
    if open_input(files.bearings).table == Tracks.NAME:
        raise UsageError(
            f"{files.bearings}: holds tracks; name those of another group of cameras with --with, or give bearings"
        )
    inputs = Inputs(files.bearings, files.scene)
    views = [] if files.views is None else inputs.open(files.views, Views)
    unit = inputs.scene.length_unit
    config = configure(FuseConfig.in_unit(unit), values)
    losses = inputs.losses
    kept = {} if files.views is None else carried(open_input(files.views).provenance.parameters)
    provenance = Provenance("fuse", {**asdict(config), **kept}, None, hash_inputs(files.inputs), losses)
    chunks = console.progress(inputs.chunks, "fuse", quiet=quiet)
    tally = FuseTally()
    with ExitStack() as stack:

        def writer(path: Path, table: type[Table]) -> TableWriter:
            made = TableWriter(path, table, provenance, overwrite=files.overwrite, length_unit=unit)
            return stack.enter_context(made)

        rows = writer(files.output, Bearings)
        boxes = None if files.fused_views is None else writer(files.fused_views, Views)
        for part in fuse(together(views, chunks), inputs.scene, config):
            rows.write(part.bearings)
            if boxes is not None:
                boxes.write(part.views)
            tally.add(part)
    tally.warn(quiet)
    return {"bearings": str(files.output), **tally.summary()}, losses


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
                "close in time together with --window SECONDS (detect: --fuse-window)",
                quiet,
            )

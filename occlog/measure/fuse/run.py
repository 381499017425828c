"""What `occlog fuse` does: read, fuse, write."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from occlog.cli import options
from occlog.errors import UsageError
from occlog.io.files.parquet import TableWriter
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.measure.scans.inputs import Inputs
from occlog.records.tables import Bearings, Views

from .config import FuseConfig, in_scene
from .moments import together
from .options import FuseTally
from .stage import fuse

if TYPE_CHECKING:
    from occlog.records.losses import Loss


class Files(NamedTuple):
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


def run_fuse(files: Files, values: Mapping[str, Any], quiet: bool) -> tuple[dict[str, Any], tuple[Loss, ...]]:
    """Fuse and write; the summary, and what had been lost before."""
    if files.fused_views is not None and files.views is None:
        raise UsageError("--fused-views wants the views of the bearings; give them with --views")
    inputs = Inputs(files.bearings, files.scene)
    views = [] if files.views is None else inputs.open(files.views, Views)
    config = in_scene(FuseConfig(**values), inputs.scene)
    losses = inputs.losses
    provenance = Provenance("fuse", asdict(config), None, hash_inputs(files.inputs), losses)
    chunks = options.progress(inputs.chunks, "fuse", quiet=quiet)
    tally, unit = FuseTally(), inputs.scene.length_unit
    with ExitStack() as stack:

        def writer(path: Path, table: type[Any]) -> TableWriter:
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

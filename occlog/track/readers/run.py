"""Run of `occlog track` with a method that takes reads: open, locate, write, sum up."""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from occlog import console
from occlog.errors import InputError, UsageError
from occlog.io.files.atomic import Together
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.files.tables.table_writer import TableWriter
from occlog.records.losses import Loss
from occlog.records.tables import TagTracks
from occlog.records.tables import VirtualSensors as RegionTable
from occlog.records.verdicts import Check, finding, outcome, summary_of, texts_of

from .config import VirtualConfig
from .inputs import ReadsInput, ReadsRequest
from .sights import refined
from .stage import UNMATCHED, region_table, track_rssi, track_virtual

OFTEN = 0.05
"""Share of rows with a doubt that a user must know."""
REMEDIES = {
    UNMATCHED: "ranges are not as stated, or reads are missed; state detection and stray, or fit them",
    "restart": "no place explained the reads; check the path losses and the places of the readers",
    "depleted": "so few particles count that the covariance says little; use more",
}


@dataclass(frozen=True)
class ReadsFiles:
    """Tables to write; None: not that one."""

    tracks: Path
    virtual_sensors: Path | None = None

    @property
    def paths(self) -> list[Path | None]:
        """All of them."""
        return [self.tracks, self.virtual_sensors]


class ReadsSummary:
    """Figures of the summary, counted while tables stream by."""

    def __init__(self) -> None:
        """Begin with all counts at 0."""
        self.tags: set[int] = set()
        self.rows = 0
        self.doubts: Counter[str] = Counter()
        self.spread = 0.0
        self.refined = 0

    def add(self, part: TagTracks) -> None:
        """Count some more rows."""
        self.tags.update(part.target_id.tolist())
        self.rows += len(part)
        self.doubts.update(reason for text in part.doubt.tolist() for reason in text.split(",") if reason)
        self.spread += float(np.sqrt(part.cov_xx + part.cov_yy).sum())
        self.refined += int(np.count_nonzero(part.refined_by != ""))

    def figures(self) -> dict[str, object]:
        """The figures.

        tags, rows: of the tracks.  refined: rows that cameras refined.  mean_spread: root of the covariance's trace.
        doubts: rows of each kind.
        """
        return {
            "tags": len(self.tags),
            "rows": self.rows,
            **({"refined": self.refined} if self.refined else {}),
            "mean_spread": self.spread / self.rows if self.rows else float("nan"),
            **({"doubts": dict(sorted(self.doubts.items()))} if self.doubts else {}),
        }

    def checks(self) -> tuple[Check, ...]:
        """What was checked of the tracks, and what was found."""
        shares = {name: n / self.rows for name, n in sorted(self.doubts.items())}
        return outcome(
            "doubts of the rows",
            (
                finding(
                    "doubts of the rows",
                    "warning",
                    name,
                    f"{share:.0%} of the rows have the doubt {name} (limit {OFTEN:.0%}): {REMEDIES[name]}",
                    share=share,
                    allowed=OFTEN,
                )
                for name, share in shares.items()
                if share > OFTEN
            ),
            unless="" if self.rows else "there are no rows",
            rows=self.rows,
        )


def run_track_reads(
    request: ReadsRequest, wanted: ReadsFiles, overwrite: bool, quiet: bool
) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Track tags and write; return the summary, and what had been lost before."""
    inputs = ReadsInput(request)
    windows = console.progress(inputs.windows(), "track", quiet=quiet)
    config, regions = None, None
    if request.method == VirtualConfig.OWNER:
        config, regions, thresholds = inputs.virtual()
        tracked = track_virtual(windows, regions, inputs.names, thresholds, config.detection, config.stray)
        parameters, lines, form = inputs.parameters(config), inputs.sight_lines(config), config.form
    else:
        if wanted.virtual_sensors is not None:
            raise UsageError(f"method {request.method} has no virtual sensors to write")
        rssi, rules = inputs.rssi()
        tracked = track_rssi(windows, rules, inputs.names, request.seed)
        parameters, lines, form = inputs.parameters(rssi), inputs.sight_lines(rssi), rssi.form
    if lines is not None:
        tracked = (refined(part, lines, form) for part in tracked)
    provenance = Provenance("track", parameters, request.seed, hash_inputs(request.paths), inputs.losses)
    unit = inputs.scene.length_unit
    summary = ReadsSummary()
    with ExitStack() as stack:
        together = stack.enter_context(Together())
        writer = stack.enter_context(
            TableWriter(wanted.tracks, TagTracks, provenance, overwrite=overwrite, length_unit=unit, together=together)
        )
        table = None
        if wanted.virtual_sensors is not None and regions is not None:
            table = stack.enter_context(
                TableWriter(
                    wanted.virtual_sensors,
                    RegionTable,
                    provenance,
                    overwrite=overwrite,
                    length_unit=unit,
                    together=together,
                )
            )
            table.write(region_table(regions, inputs.names, inputs.first_ns))
        for part in tracked:
            writer.write(part)
            summary.add(part)
        if not summary.rows:
            raise InputError(f"{request.reads}: no read is as strong as the threshold; lower it")
        made = provenance.with_checks(summary.checks())
        for each in (writer, table):
            if each is not None:
                each.annotate(made)
    console.note_findings(texts_of(made.judged, "track"), quiet)
    more = {} if regions is None else {"virtual_sensors": len(regions.area)}
    figures = {**more, **summary.figures(), **summary_of(made.judged)}
    return {"tracks": str(wanted.tracks), "method": request.method, **figures}, inputs.losses

"""Run of `occlog track` with a method that takes reads: open, locate, write, sum up."""

from __future__ import annotations

from collections import Counter

import numpy as np

from occlog import console
from occlog.consistency.estimates import MIN_EFFECTIVE_SAMPLE_SIZE
from occlog.errors import InputError, UsageError, option
from occlog.records.losses import Loss
from occlog.records.tables import TagTracks
from occlog.records.verdicts import Check, finding, outcome, summary_of, texts_of
from occlog.runner import Job
from occlog.track.request import ReadsRequest

from .config import VirtualConfig
from .inputs import ReadsInput
from .refine import refined_positions
from .stage import NO_MATCHING_REGION, region_table, track_rssi, track_virtual

MAX_FLAGGED_SHARE = 0.05
"""Share of rows with a doubt that a user must know."""
FLAGS = {NO_MATCHING_REGION: "no-matching-region", "restart": "reads-unexplained", "depleted": "particles-depleted"}
"""Values of `quality_flags`, and the ids of their messages."""


class ReadsSummary:
    """Counts of a run that tracks tags, added up part by part, and the figures of the summary."""

    def __init__(self) -> None:
        """Start with all counts at 0."""
        self.tags: set[int] = set()
        self.rows = 0
        self.doubts: Counter[str] = Counter()
        self.spread = 0.0
        self.refined = 0

    def add(self, part: TagTracks) -> None:
        """Add the counts of a part of the tracks."""
        self.tags.update(part.target_id.tolist())
        self.rows += len(part)
        self.doubts.update(reason for text in part.quality_flags.tolist() for reason in text.split(",") if reason)
        self.spread += float(np.sqrt(part.cov_xx + part.cov_yy).sum())
        self.refined += int(np.count_nonzero(part.refined_by != ""))

    def figures(self) -> dict[str, object]:
        """Return the figures of the summary by name.

        `tags`, `rows`: of the tracks. `refined`: rows that cameras refined, if any. `mean_sigma`: mean root of the
        trace of the position covariance. `quality_flags`: rows with each flag, if any.
        """
        return {
            "tags": len(self.tags),
            "rows": self.rows,
            **({"refined": self.refined} if self.refined else {}),
            "mean_sigma": self.spread / self.rows if self.rows else float("nan"),
            **({"quality_flags": dict(sorted(self.doubts.items()))} if self.doubts else {}),
        }

    def checks(self) -> tuple[Check, ...]:
        """Return the check of quality flags, with a finding for each flag of too many rows (`MAX_FLAGGED_SHARE`)."""
        return outcome(
            "quality flags",
            (
                finding(
                    "quality flags",
                    FLAGS[name],
                    count=count,
                    rows=self.rows,
                    share=count / self.rows,
                    allowed=MAX_FLAGGED_SHARE,
                    least=MIN_EFFECTIVE_SAMPLE_SIZE,
                )
                for name, count in sorted(self.doubts.items())
                if count > MAX_FLAGGED_SHARE * self.rows
            ),
            unless="" if self.rows else "there are no rows",
            rows=self.rows,
        )


def run_track_reads(request: ReadsRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Track tags as requested, and write the tables.

    Return the figures of the summary, and the losses recorded in the inputs. InputError if no window gives a position.
    """
    inputs = ReadsInput(request)
    windows = job.progress(inputs.windows(), "track")
    config, regions = None, None
    if request.method == VirtualConfig.OWNER:
        config, regions, thresholds = inputs.virtual()
        tracked = track_virtual(
            windows, regions, inputs.names, thresholds, config.detection_probability, config.false_alarm_probability
        )
        parameters, lines, form = inputs.parameters(config), inputs.lines_of_sight(config), config.refine_method
    else:
        if request.virtual_sensors is not None:
            raise UsageError(
                f"{option('virtual_sensors')}: method {request.method} has no virtual sensors to "
                "write; leave it out, or use method virtual",
                id="not-applicable",
            )
        rssi, tag_model = inputs.rssi()
        tracked = track_rssi(windows, tag_model, inputs.names, request.seed, rssi)
        parameters, lines, form = inputs.parameters(rssi), inputs.lines_of_sight(rssi), rssi.refine_method
    if lines is not None:
        tracked = (refined_positions(part, lines, form) for part in tracked)
    provenance = job.provenance(parameters, inputs.losses, request.seed)
    unit = inputs.scene.length_unit
    summary = ReadsSummary()
    with job.tables(provenance, unit, {"output": TagTracks}) as tables:
        if regions is not None:
            tables.write(virtual_sensors=region_table(regions, inputs.names, inputs.first_ns))
        for part in tracked:
            tables.write(output=part)
            summary.add(part)
        if not summary.rows:
            raise InputError(
                f"{request.bearings}: no read reaches the threshold (min_rssi_dbm); give a lower one",
                id="insufficient-data",
            )
        made = provenance.with_checks(summary.checks())
        tables.annotate(made)
    console.note_findings(texts_of(made.judged, "track"), job.quiet)
    more = {} if regions is None else {"virtual_sensors": len(regions.area)}
    figures = {**more, **summary.figures(), **summary_of(made.judged)}
    return {"tracks": str(request.output), "method": request.method, **figures}, inputs.losses

"""Checks of what files state about their pictures and boxes, and of their agreement."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from occlog.array_types import NS
from occlog.io.formats.boxes.reader import BoxSurvey, counter_bits
from occlog.io.frames.camera_source import CameraSource
from occlog.records.verdicts import Check, finding, outcome

from .plan import IngestPlan

PICTURES, STARTS, SIDECARS, ENDS = "picture metadata", "video start times", "unit of time stamps", "frames with boxes"
"""Names of checks."""
UNIT_FACTORS, UNIT_TOLERANCE = (1e3, 1e6, 1e9), 1.5
"""Ratios of units of time, and how much a ratio of durations may differ from one that states a wrong unit."""
MIN_START_S = 0.1
"""Time stamp of a first frame [s] from which it is noted; a container may count from the first packet."""
MAX_BOXLESS_SHARE = 0.1
"""Share of frames after a camera's last box above which the numbering of the boxes is doubtful."""
STRIDE_TOLERANCE = 0.05
"""Relative difference of a ratio of frames to a whole number that may be a stride."""


def source_checks(plan: IngestPlan, sources: Sequence[CameraSource], survey: BoxSurvey | None) -> tuple[Check, ...]:
    """Checks of the videos and images of cameras, and of boxes against the frames of the same cameras.

    Args:
        plan: inputs and options.
        sources: cameras with a video or images.
        survey: of the box files; None: there are none.

    Returns:
        The checks, with findings: properties of pictures, starts of videos, units of time stamp files, ends of boxes.
    """
    no_video = "" if plan.video else "there is no video"
    no_sidecar = "" if plan.video and plan.timestamps else "no video has time stamps in a file"
    numbers = [] if survey is None else [*_restarts(survey)]
    both = [s for s in sources if survey is not None and s.name in survey.ranges and s.decoder.frames]
    numbers += _ends(plan, both, survey)
    return (
        *outcome(PICTURES, _facts(sources), unless="" if sources else "there are no pictures"),
        *outcome(STARTS, _starts(plan, sources), unless=no_video),
        *outcome(SIDECARS, _units(sources), unless=no_sidecar),
        *outcome(ENDS, numbers, unless="" if both or numbers else "no camera has pictures and boxes"),
    )


def _facts(sources: Sequence[CameraSource]) -> Iterator[Check]:
    """Findings of the decoders about the files' pictures."""
    for source in sources:
        for id, values in source.decoder.facts:
            yield finding(PICTURES, id, None, sensors=[source.name], targets=(), **values)


def _starts(plan: IngestPlan, sources: Sequence[CameraSource]) -> Iterator[Check]:
    """Report videos with a first time stamp other than 0.

    Nothing is reported if all videos have the same one, nor for a camera with time stamps or a start time in `plan`.
    """
    given = {name for name, _ in (*plan.start_time, *plan.timestamps)}
    starts = {
        s.name: s.decoder.start_s
        for s in sources
        if s.name in plan.video and s.decoder.start_s is not None and not s.times.source.startswith("sidecar")
    }
    alike = len(starts) > 1 and max(starts.values()) - min(starts.values()) < MIN_START_S
    for name, start_s in starts.items():
        if abs(start_s) >= MIN_START_S and not alike and name not in given:
            yield finding(STARTS, "video-start", sensors=[name], start_s=start_s)


def _units(sources: Sequence[CameraSource]) -> Iterator[Check]:
    """Report time stamps with a duration that differs from the video's by the factor of another time unit."""
    for source in sources:
        table, rate, frames = source.times.table_ns, source.decoder.rate_hz, source.decoder.frames
        if table is None or len(table) < 2 or not rate or not frames or not source.times.source.startswith("sidecar"):
            continue
        ratio = float(table[-1] - table[0]) / (len(table) - 1) * rate / NS
        if any(abs(math.log(max(ratio, 1 / ratio) / factor)) < math.log(UNIT_TOLERANCE) for factor in UNIT_FACTORS):
            yield finding(SIDECARS, "time-stamps-unit", sensors=[source.name], ratio=ratio)


def _restarts(survey: BoxSurvey) -> Iterator[Check]:
    """Report cameras with frame numbers that restart, as in two joined files."""
    for name, (line, before, after) in survey.restarts.items():
        if bits := counter_bits(before, after):
            yield finding(
                ENDS,
                "boxes-counter-restart",
                sensors=[name],
                line=line,
                before=before,
                after=after,
                bits=bits,
                count=2**bits,
            )
        else:
            yield finding(ENDS, "boxes-restart", sensors=[name], line=line, before=before, after=after)


def _ends(plan: IngestPlan, sources: Sequence[CameraSource], survey: BoxSurvey | None) -> Iterator[Check]:
    """Report cameras with boxes that end long before their pictures, as if frames had been skipped or renumbered.

    Args:
        plan: nothing is reported if it selects frames.
        sources: cameras that have pictures and boxes.
        survey: of the boxes; None: there are none.
    """
    for source in sources if survey is not None and not plan.frames else ():
        frames, stop = source.decoder.frames or 0, survey.ranges[source.name].stop if survey is not None else 0
        if frames - stop > MAX_BOXLESS_SHARE * frames:
            stride = round(frames / stop)
            is_stride = stride > 1 and abs(frames / stop / stride - 1) < STRIDE_TOLERANCE
            hint = f"if they are of every frame in {stride}, number them so" if is_stride else "check their numbers"
            yield finding(ENDS, "boxes-end-early", sensors=[source.name], last=stop - 1, frames=frames, hint=hint)

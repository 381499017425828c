"""Result of a comparison, and its formatting for the terminal, Markdown and JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from occlog.core.metrics.paired import MANY_RECORDINGS, MIN_SEGMENTS, PairedDifference
from occlog.records.losses import Loss


class Condition(NamedTuple):
    """Condition of failure (`--fail-if`): a later method's metric is worse than the first one's by over a margin."""

    figure: str
    margin: float = 0.0

    def __str__(self) -> str:
        """Return the condition as in the option: `FIGURE worse by MARGIN`."""
        return f"{self.figure} worse" + (f" by {self.margin:g}" if self.margin else "")


@dataclass(frozen=True)
class ComparisonRow:
    """Comparison of one method with the first one in one metric.

    Attributes:
        method: index among the methods, from 0 (the first one, which has no rows).
        figure: name of the metric.
        found: both values, difference and test.
        holm: p-value, with all rows of a comparison tested together (Holm 1979); NaN: undecided.
        verdict: `better`, `worse`, `no difference shown` or `not decided`, for this method.
    """

    method: int
    figure: str
    found: PairedDifference
    holm: float
    verdict: str


class Implausible(NamedTuple):
    """Tracks that a stage of processing found implausible.

    Attributes:
        method: index among the methods, from 0.
        recording: name of the recording.
        warnings: messages that state why.
    """

    method: int
    recording: str
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class MetricComparison:
    """Result of `occlog compare`: comparisons of all later methods with the first one, in all requested metrics.

    Attributes:
        rows: one comparison for each method and metric.
        recordings: their names.
        frames: number of true frames of all recordings.
        unit: unit of lengths.
        failed: one sentence for each condition of failure that is met.
        losses: data losses when tracks and truths were made.
        implausible: tracks that a stage found implausible.
    """

    rows: tuple[ComparisonRow, ...]
    recordings: tuple[str, ...]
    frames: int
    unit: str
    failed: tuple[str, ...]
    losses: tuple[Loss, ...]
    implausible: tuple[Implausible, ...]


HEAD = ("figure", "first", "this", "difference", "95 % interval", "p", "verdict")
LEVEL = "p has all rows together in view (Holm); a verdict needs p < 0.05"


def rows_of(found: MetricComparison, method: int) -> list[tuple[str, ...]]:
    """Return the table rows of one method (index from 0) as text: a row for each metric, columns as in `HEAD`."""
    return [_cells(row) for row in found.rows if row.method == method]


def _cells(row: ComparisonRow) -> tuple[str, ...]:
    d = row.found
    interval = "-" if math.isnan(d.low) else f"{d.low:+.4f} to {d.high:+.4f}"
    p = "-" if math.isnan(row.holm) else f"{row.holm:.2g}"
    return (row.figure, f"{d.a:.4f}", f"{d.b:.4f}", f"{d.difference:+.4f}", interval, p, row.verdict)


def table(found: MetricComparison, methods: Sequence[Path]) -> str:
    """Return the comparison as text for the terminal, a table for each method after the first."""
    out = []
    for m in range(1, len(methods)):
        lines = [HEAD, *rows_of(found, m)]
        widths = [max(len(line[k]) for line in lines) for k in range(len(HEAD))]
        out.append(f"{methods[m]} against {methods[0]}")
        out += ["  " + "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
    return "\n".join(line.rstrip() for line in [*out, basis(found), *implausible_notes(found, methods)])


def basis(found: MetricComparison) -> str:
    """Return the sentence about the basis of the comparison: number of recordings, frames, test."""
    count = len(found.recordings)
    what = f"{found.frames} frames of {count} recording{'s' if count > 1 else ''}"
    if not found.rows:
        return f"{what}."
    whole = found.rows[0].found.recordings
    if whole:
        return f"{what}; {count} recordings exchanged, both runs at once; about recordings like these. {LEVEL}."
    few = (
        f"fewer than {MIN_SEGMENTS} independent ones decide nothing; "
        f"of identities fewer than {MANY_RECORDINGS} recordings"
    )
    return f"{what}; time intervals exchanged, both runs at once; about these recordings alone; {few}. {LEVEL}."


def implausible_notes(found: MetricComparison, methods: Sequence[Path]) -> list[str]:
    """Return a sentence for each method with tracks that are not plausible, with the first warning."""
    out = []
    for m, method in enumerate(methods):
        own = [each for each in found.implausible if each.method == m]
        if own:
            where = f" of {own[0].recording}" if own[0].recording else ""
            share = f" in {len(own)} of {len(found.recordings)} recordings" if len(found.recordings) > 1 else ""
            out.append(f"{method}: tracks are not plausible{share}; the first warning{where}: {own[0].warnings[0]}")
    return out


def markdown(found: MetricComparison, methods: Sequence[Path]) -> str:
    """Return the comparison as Markdown, a table for each method after the first."""
    out = []
    for m in range(1, len(methods)):
        out += [f"### `{methods[m]}` against `{methods[0]}`", "", "| " + " | ".join(HEAD) + " |"]
        out += ["|---|---:|---:|---:|---:|---:|---|", *("| " + " | ".join(c) + " |" for c in rows_of(found, m)), ""]
    notes = [f"\n**Failed**: {line}" for line in found.failed]
    notes += [f"\n**Not plausible**: {line}" for line in implausible_notes(found, methods)]
    return "\n".join([*out, basis(found), *notes, ""])


def as_dict(found: MetricComparison, methods: Sequence[Path]) -> dict[str, object]:
    """Return the comparison as values for JSON; None for numbers that are not finite."""

    def known(value: float) -> float | None:
        return value if math.isfinite(value) else None

    rows = [
        {
            "method": str(methods[row.method]),
            "figure": row.figure,
            "first": known(row.found.a),
            "this": known(row.found.b),
            "difference": known(row.found.difference),
            "low": known(row.found.low),
            "high": known(row.found.high),
            "standard_error": known(row.found.se),
            "p": known(row.found.p),
            "p_holm": known(row.holm),
            "verdict": row.verdict,
            "stretches": row.found.segments,
        }
        for row in found.rows
    ]
    return {
        "first": str(methods[0]),
        "recordings": list(found.recordings),
        "frames": found.frames,
        "length_unit": found.unit,
        "rows": rows,
        "failed": list(found.failed),
        "implausible": [
            {"method": str(methods[each.method]), "recording": each.recording, "warnings": list(each.warnings)}
            for each in found.implausible
        ],
    }

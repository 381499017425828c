"""The summary that `occlog report A B` prints."""

from __future__ import annotations

import math

from occlog.array_types import NS
from occlog.evaluate.compare.model import Row
from occlog.records.verdicts import all_plausible
from occlog.records.verdicts import summary_of as verdict_summary
from occlog.report.request import BesideRequest

from . import words
from .comparison.partings import Moment
from .model import Beside


def summary_of(found: Beside, request: BesideRequest) -> dict[str, object]:
    """What was written, whether the runs differ, where they part and who became another one."""
    first, truth = found.partings.first, found.against_truth
    out: dict[str, object] = {"page": request.output}
    out |= {} if request.markdown is None else {"markdown": request.markdown}
    out |= {letter.lower(): side.name for letter, side in found.sides}
    out |= {"heading": words.heading(found), "same": found.same, "frames": found.partings.frames}
    out |= {"frames_parted": found.partings.parted, "tolerance": found.tolerance, "length_unit": found.unit}
    if first is not None:
        out["first_parting"] = {"kind": first[0], **_moment(found, first[1])}
    out["changes"] = {letter: len(each.changes) for letter, each in zip("ab", words.followed(found), strict=True)}
    if truth is not None:
        out["switches"] = dict(zip("ab", truth.switches, strict=True))
        out["true_frames"] = truth.comparison.frames  # which figures are of, as those of `compare`
        out["figures"] = {row.figure: _figure(row) for row in truth.comparison.rows}
    out |= {"notes": list(found.notes)} if found.notes else {}
    judged = {letter.lower(): side.data.verdicts for letter, side in found.sides}
    if any(judged.values()):
        out["plausible"] = all_plausible([each for verdicts in judged.values() for each in verdicts])
        out["warnings"] = [
            {"run": letter, **warning}
            for letter, verdicts in judged.items()
            for warning in verdict_summary(verdicts).get("warnings", [])  # type: ignore[attr-defined]
        ]
    return out


def _figure(row: Row) -> dict[str, object]:
    """What is known of a figure of both."""
    d = row.found
    values = {"a": d.a, "b": d.b, "difference": d.difference, "low": d.low, "high": d.high, "p": row.holm}
    return {name: value for name, value in values.items() if math.isfinite(value)} | {"verdict": row.verdict}


def _moment(found: Beside, moment: Moment) -> dict[str, object]:
    """Values of a moment that are known."""
    values: dict[str, object] = {"seconds": (moment.t_ns - found.time.start_ns) / NS, "t_ns": moment.t_ns}
    values |= {name: label for name, label in (("a", moment.a), ("b", moment.b)) if label is not None}
    return values | ({"distance": moment.distance} if math.isfinite(moment.distance) else {})

"""Labels against the continuity of motion: flags of rows, and what the verdict says of them."""

from __future__ import annotations

import math
from collections.abc import Iterator

from occlog.array_types import NS
from occlog.records.tables import Diagnostics
from occlog.records.verdicts import Check, finding, outcome
from occlog.scans.label_continuity import LabelEvents

from .estimates import EXCHANGED_LABELS, LABEL_JUMP, flagged

CONTINUITY = "continuity of labels"
"""Name of the check."""


def flag_labels(diagnostics: Diagnostics, events: LabelEvents) -> Diagnostics:
    """Diagnostics with the flags of rows while labels were exchanged, and while they jumped."""
    if not events.exchanges and not events.jumps:
        return diagnostics
    exchanged, jumped = events.at(diagnostics.t_ns, diagnostics.target_id)
    return flagged(flagged(diagnostics, exchanged, EXCHANGED_LABELS), jumped, LABEL_JUMP)


def label_checks(events: LabelEvents | None, unit: str) -> tuple[Check, ...]:
    """What is against the continuity of labels; None: they were not followed."""
    unless = "" if events is not None and events.labels else "no bearing has a label"
    return outcome(CONTINUITY, () if events is None else _findings(events, unit), unless=unless)


def _findings(events: LabelEvents, unit: str) -> Iterator[Check]:
    """Exchanged labels, and of each target the fastest jump."""
    for one in events.exchanges:
        begin_s = (one.begin_ns - events.origin_ns) / NS
        until = "the end" if one.end_ns is None else f"{(one.end_ns - events.origin_ns) / NS:.4g} s"
        yield finding(
            CONTINUITY,
            "labels-exchanged",
            sensors=[one.sensor] if one.sensor else [],
            targets=one.targets,
            begin_s=begin_s,
            until=until,
            where=f"in {one.sensor}" if one.sensor else "in all sensors",
            done="exchanged back" if events.repaired else "kept as given",
            end_s=math.nan if one.end_ns is None else (one.end_ns - events.origin_ns) / NS,
        )
    for target in sorted({jump.target for jump in events.jumps}):
        own = [jump for jump in events.jumps if jump.target == target]
        worst = max(own, key=lambda jump: jump.speed)
        yield finding(
            CONTINUITY,
            "label-jump",
            targets=[target],
            count=len(own),
            distance=worst.distance,
            speed=worst.speed,
            unit=unit,
            at_s=(worst.begin_ns - events.origin_ns) / NS,
            allowed=events.allowed_speed,
        )

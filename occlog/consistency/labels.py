"""Checks of labels against the continuity of motion: flags of rows, and findings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from occlog.array_types import NS
from occlog.records.tables import Diagnostics
from occlog.records.verdicts import Check, Severity, finding, outcome
from occlog.scans.label_continuity import LabelEvents

from .estimates import EXCHANGED_LABELS, LABEL_JUMP, flagged
from .verdict import MOTION, exceeds_share

CONTINUITY, OUTLIERS = "continuity of labels", "bearings against the motion"
"""Names of the checks."""
MAX_CONTRADICTED_SHARE = 0.03
"""Share of rows with a bearing that contradicts the target's motion that matters."""


MAX_MOTION_FACTOR = 1.45
"""Factor of the motion's variance that matters, the mean over all bearings of a target."""


class MotionCheck(NamedTuple):
    """Noise of a method's motion model compared with that by which label continuity is checked.

    `setting` is the name of the setting that states it; `ratio` the variance of the method's motion over that of the
    labels.
    """

    setting: str  # that states how irregularly targets move
    ratio: float  # variance of the method's motion, over that of the labels
    severity: Severity


def motion_checks(
    events: LabelEvents | None, motion: MotionCheck | None, rows: int, unless: str = ""
) -> tuple[Check, ...]:
    """Return the check of whether targets move as the method's motion model states, by labelled bearings.

    Args:
        events: findings about the labels; None: they were not followed.
        motion: noise of the method's motion; None: it has none, or judges it itself, and there is no check.
        rows: number of estimates.
        unless: why the check does not apply; empty: it applies.
    """
    if motion is None:
        return ()
    if events is None or not events.motion:
        unless = unless or "no target has enough labelled bearings"
        return outcome(MOTION, (), unless=unless)
    against = len({(target, t_ns) for target, t_ns, _ in events.contradicting})
    if events.exchanges or events.jumps or exceeds_share(against, rows, MAX_CONTRADICTED_SHARE):
        unless = unless or "bearings contradict the motion"
    limit = MAX_MOTION_FACTOR * motion.ratio
    found = [
        finding(
            MOTION,
            "process-noise-small",
            motion.severity,
            targets=[target],
            factor=math.sqrt(factor / motion.ratio),
            allowed=math.sqrt(MAX_MOTION_FACTOR),
            setting=motion.setting,
        )
        for target, factor in sorted(events.motion.items())
        if factor > limit and not unless
    ]
    return outcome(MOTION, found, unless=unless, factor=math.sqrt(max(events.motion.values()) / motion.ratio))


def flag_labels(diagnostics: Diagnostics, events: LabelEvents) -> Diagnostics:
    """Return diagnostics with the flags `exchanged_labels` and `label_jump` added in the rows of the events."""
    if not events.exchanges and not events.jumps:
        return diagnostics
    exchanged, jumped = events.at(diagnostics.t_ns, diagnostics.target_id)
    return flagged(flagged(diagnostics, exchanged, EXCHANGED_LABELS), jumped, LABEL_JUMP)


def label_checks(events: LabelEvents | None, unit: str, rows: int = 0) -> tuple[Check, ...]:
    """Return the checks of labels that contradict the continuity of motion, with their findings.

    Args:
        events: findings about the labels; None: labels were not followed.
        unit: unit of lengths.
        rows: number of estimates of a method that cannot reject false bearings; 0: the method does so.
    """
    unless = "" if events is not None and events.labels else "no bearing has a label"
    found = outcome(CONTINUITY, () if events is None else _findings(events, unit), unless=unless)
    if events is None or not rows or unless:
        return found
    return *found, *outcome(OUTLIERS, _outliers(events, rows), rows=rows)


def _outliers(events: LabelEvents, rows: int) -> Iterator[Check]:
    """Generate a finding if too many estimates have a bearing that contradicts the motion.

    `rows`: number of estimates of a method that does not reject outliers.
    """
    steps = {(target, t_ns) for target, t_ns, _ in events.contradicting}
    if exceeds_share(len(steps), rows, MAX_CONTRADICTED_SHARE):
        sensors = sorted({name for _, _, name in events.contradicting})
        share = len(steps) / rows
        allowed = MAX_CONTRADICTED_SHARE
        yield finding(OUTLIERS, "outliers", sensors=sensors, count=len(steps), rows=rows, share=share, allowed=allowed)


def _findings(events: LabelEvents, unit: str) -> Iterator[Check]:
    """Generate findings of exchanged labels, and of the fastest jump of each target; lengths are in `unit`."""
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
            allowed=worst.allowed,
        )

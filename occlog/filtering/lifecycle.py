"""Life cycle of a single-target filter: initiation, gaps, track loss, reinitialisation.

This frame decides whether a scan updates a filter or initiates a new one:

    initiate("")          nothing is known before the first scan
    initiate("gap")       the time since the last scan exceeds `max_gap_s`
    update(dt)            otherwise: predict over dt [s], then update by the scan
    initiate("restart")   no state explains the scan, or the evidence for a lost track exceeds its limit

The evidence for a lost track is a count of reports that contradict the posterior, less those that agree with it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from occlog.array_types import NS

GAP, RESTART = "gap", "restart"
"""Reasons of a reinitialisation, values of the column `fallback`."""
MAX_LOSS_CHANGE_PER_SCAN = 2
"""A scan changes the track-loss counter by at most this, so that many sensors that err together do not end a track."""

Posterior = TypeVar("Posterior")
Count = TypeVar("Count")


def elapsed(before_ns: int | None, t_ns: int) -> float:
    """Return the time [s] from the last scan, at `before_ns`, to the scan at `t_ns`; 0 if there was none (None).

    ValueError for a scan that is earlier than the last one.
    """
    if before_ns is None:
        return 0.0
    if t_ns < before_ns:
        raise ValueError(f"scan at {t_ns} ns is earlier than the last one at {before_ns} ns; sort the scans by time")
    return (t_ns - before_ns) / NS


def advance(
    dt: float,
    max_gap_s: float,
    *,
    known: bool,
    initiate: Callable[[str], Posterior],
    update: Callable[[float], Posterior | None],
    loss: Callable[[Posterior], tuple[Count, bool]],
) -> tuple[Posterior, Count]:
    """Update or initiate a filter with a scan, and return its posterior and track-loss count.

    It is initiated with reason "gap" after a gap, "" without prior, and "restart" if no state explains the scan or the
    track is lost; else it is updated.

    Args:
        dt: time since the last scan [s]; 0 for the first one.
        max_gap_s: after a longer time the prediction is discarded [s].
        known: whether there is a prior to update: a given start, or an earlier scan.
        initiate: makes a posterior from the scan alone, given the reason.
        update: makes a posterior by prediction over dt and the scan; None where no state explains the scan.
        loss: returns the count after the scan, and whether the track is lost.
    """
    found = initiate(GAP) if dt > max_gap_s else update(dt) if known else initiate("")
    done = initiate(RESTART) if found is None else found
    count, lost = loss(done)
    return (initiate(RESTART) if lost else done), count


def track_loss_count(before: int, against: int, reports: int) -> int:
    """Return the track-loss counter after a scan, at least 0.

    It grows by the number of reports that contradict the posterior minus that of the others, by at most
    `MAX_LOSS_CHANGE_PER_SCAN` either way.

    Args:
        before: the counter before the scan.
        against: number of reports of the scan that contradict the posterior.
        reports: number of all reports of the scan.
    """
    return max(0, before + max(-MAX_LOSS_CHANGE_PER_SCAN, min(MAX_LOSS_CHANGE_PER_SCAN, 2 * against - reports)))


def is_lost(count: int, lost_after: int) -> bool:
    """Return whether `count` has reached the limit `lost_after`; a limit of 0 disables it."""
    return 0 < lost_after <= count

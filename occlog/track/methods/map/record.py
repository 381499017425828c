"""A target's record as method `map` solves it: its scans in columns, joined, cut, and filled with more times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Ints
from occlog.core.occlusion.priors import Priors
from occlog.errors import InputError
from occlog.filtering.likelihood import distances
from occlog.filtering.likelihood.distances import RangeMeasurements
from occlog.scans.grouping import Scan, concat

MAX_STATES = 10_000_000
"""States that `max_state_gap_s` may make."""


NO_STATES = np.empty(0, dtype=np.int64)


class TargetRecord(NamedTuple):
    """Measurements of one target at T times; the estimated trajectory has one state per time.

    `t_ns` (T,) rise; `rows` are R bearing rows (detections and misses), each of the time with the index `state` (R,);
    `occluders` has the priors of moving occluders of the first times (None, and beyond these: unknown); `measured` are
    ranges, signal strengths and differences, of the times `measured_state` (None: missing).
    """

    t_ns: Ints  # (T,) ascending
    state: Ints  # (R,) which time each row is of, ascending
    rows: Scan  # R rows; the time and the occluders of this scan mean nothing
    occluders: tuple[Priors | None, ...] = ()  # of the first times, in order; None, and beyond these: nothing is known
    measured: RangeMeasurements | None = None  # ranges and their like; None: missing at all
    measured_state: Ints = NO_STATES  # (m,) which time each of them is of, ascending

    def priors(self, state: int) -> Priors | None:
        """Return the priors of moving occluders at the time with index `state`; None if unknown."""
        return self.occluders[state] if state < len(self.occluders) else None


EMPTY = TargetRecord(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), Scan.of(0, []))
"""A record of no times."""


def record_of(scans: Sequence[Scan]) -> TargetRecord:
    """Return the record of a target's scans in time order: one time per scan, rows concatenated."""
    counts = [len(scan.sensor) for scan in scans]
    t_ns = np.array([scan.t_ns for scan in scans], dtype=np.int64)
    rows, occluders = concat([EMPTY.rows, *scans]), tuple(scan.occluders for scan in scans)
    record = TargetRecord(t_ns, np.repeat(np.arange(len(scans)), counts), rows, _occluder_priors_of(occluders))
    measured = [(t, scan.measured.distances) for t, scan in enumerate(scans) if scan.measured is not None]
    if not measured:
        return record
    state = np.repeat([t for t, _ in measured], [len(rows.kind) for _, rows in measured])
    return record._replace(measured=distances.concat([rows for _, rows in measured]), measured_state=state)


def join(a: TargetRecord, b: TargetRecord) -> TargetRecord:
    """Return record `a` followed by record `b`, which must be later; the state indices of `b` are shifted."""
    state = np.concatenate([a.state, b.state + len(a.t_ns)])
    silent = (None,) * (len(a.t_ns) - len(a.occluders))
    occluders = _occluder_priors_of((*a.occluders, *silent, *b.occluders))
    parts = [rows for rows in (a.measured, b.measured) if rows is not None]
    return TargetRecord(
        t_ns=np.concatenate([a.t_ns, b.t_ns]),
        state=state,
        rows=concat([a.rows, b.rows]),
        occluders=occluders,
        measured=distances.concat(parts) if parts else None,
        measured_state=np.concatenate([a.measured_state, b.measured_state + len(a.t_ns)]),
    )


def after(record: TargetRecord, state: int) -> TargetRecord:
    """Return the part of the record from the time with index `state` on, which gets the index 0."""
    rows = record.state >= state
    own = record.measured_state >= state
    return TargetRecord(
        t_ns=record.t_ns[state:],
        state=record.state[rows] - state,
        rows=record.rows.take(rows),
        occluders=record.occluders[state:],
        measured=None if record.measured is None else record.measured.take(own),
        measured_state=record.measured_state[own] - state,
    )


def _occluder_priors_of(occluders: tuple[Priors | None, ...]) -> tuple[Priors | None, ...]:
    """Return the tuple of occluder priors by time; empty if they are unknown (None) at all times."""
    return () if all(priors is None for priors in occluders) else occluders


def fill(record: TargetRecord, longest_s: float | None) -> TargetRecord:
    """Return the record with times without measurements inserted, evenly, in gaps longer than `longest_s` [s].

    None: the record itself.

    Raises:
        InputError: the record would have more than `MAX_STATES` times.
    """
    if longest_s is None or len(record.t_ns) < 2:
        return record
    gaps = np.diff(record.t_ns)
    # Pieces of whole ns may be a little longer, and must not be filled again with the next block.
    pieces = np.maximum(1.0, np.ceil((gaps - 2) / (longest_s * NS) - 1e-9))
    if pieces.sum() > MAX_STATES:
        raise InputError(
            f"map: max_state_gap_s {longest_s:g} makes {pieces.sum():.3g} states of {len(record.t_ns)} times; "
            f"at most {MAX_STATES:.0e} are possible: give a larger one",
            id="problem-too-large",
        )
    pieces = pieces.astype(np.int64)
    if not (pieces > 1).any():
        return record
    first = np.concatenate([[0], np.cumsum(pieces)])
    inside = np.arange(first[-1]) - np.repeat(first[:-1], pieces)
    # inside * gap // pieces, in two parts: the product alone may be above what 64 bits hold.
    whole, rest = np.repeat(gaps // pieces, pieces), np.repeat(gaps % pieces, pieces)
    t_ns = np.repeat(record.t_ns[:-1], pieces) + inside * whole + inside * rest // np.repeat(pieces, pieces)
    occluders: list[Priors | None] = [None] * (int(first[-1]) + 1) if record.occluders else []
    for t, priors in enumerate(record.occluders):
        occluders[first[t]] = priors
    filled = np.append(t_ns, record.t_ns[-1])
    return record._replace(
        t_ns=filled,
        state=first[record.state],
        occluders=tuple(occluders),
        measured_state=first[record.measured_state],
    )

"""A target's record as it grows and is given out: joined, cut, filled."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .map_config import NS
from .method import Record

MOST_STATES = 10_000_000
"""States that `fill_s` may make."""


def fill(record: Record, longest_s: float | None) -> Record:
    """The record with times added where there is none for a longer time than `longest_s` [s]; None: nowhere."""
    if longest_s is None or len(record.t_ns) < 2:
        return record
    gaps = np.diff(record.t_ns)
    # Pieces of whole ns may be a little longer, and must not be filled again with the next block.
    pieces = np.maximum(1.0, np.ceil((gaps - 2) / (longest_s * NS) - 1e-9))
    if pieces.sum() > MOST_STATES:
        raise InputError(
            f"map: fill_s {longest_s:g} would make {pieces.sum():.3g} states of {len(record.t_ns)} times, "
            f"at most {MOST_STATES:.0e} are possible; raise it"
        )
    pieces = pieces.astype(np.int64)
    if not (pieces > 1).any():
        return record
    first = np.concatenate([[0], np.cumsum(pieces)])
    inside = np.arange(first[-1]) - np.repeat(first[:-1], pieces)
    # inside * gap // pieces, in two parts: the product alone may be above what 64 bits hold.
    whole, rest = np.repeat(gaps // pieces, pieces), np.repeat(gaps % pieces, pieces)
    t_ns = np.repeat(record.t_ns[:-1], pieces) + inside * whole + inside * rest // np.repeat(pieces, pieces)
    return record._replace(t_ns=np.append(t_ns, record.t_ns[-1]), state=first[record.state])


def join(a: Record, b: Record) -> Record:
    """One record and what came after it."""
    if not len(a.t_ns):
        return b
    b = b._replace(state=b.state + len(a.t_ns))
    return Record(*(np.concatenate(pair) for pair in zip(a, b, strict=True)))


def after(record: Record, state: int) -> Record:
    """What the record has from a state on."""
    rows = record.state >= state
    return Record(
        record.t_ns[state:], record.state[rows] - state, record.sensor[rows], record.seen[rows], record.bearing[rows],
        record.sigma[rows], record.u_px[rows], record.sigma_px[rows],
    )  # fmt: skip


def empty_record() -> Record:
    """A record of no times."""
    no, none = np.empty(0, dtype=np.int64), np.empty(0)
    return Record(no, no, no, np.empty(0, dtype=np.bool_), none, none, none, none)

"""Joins the rows of two tables: by key, by order among equal keys, and by nearest time."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Ints
from occlog.records.columns import Table
from occlog.records.pieces import times

T = TypeVar("T", bound=Table)


class Join(NamedTuple):
    """Pairs of rows of A and B, and rows without a partner.

    `rank_a` and `rank_b` order the rows of both tables alike, by their keys.
    """

    a: Ints  # (M,) rows of A, by rising key
    b: Ints  # (M,) their partners in B
    only_a: Ints  # by rising key
    only_b: Ints
    rank_a: Ints  # (N_a,)
    rank_b: Ints  # (N_b,)


def join(a: T, b: T, time_ns: int = 0) -> Join:
    """Join two tables of one kind.

    Rows with the same key are paired in their order.  With `time_ns` > 0, each row that is left is
    paired with the row nearest in time, at most so far away, that has the rest of the key in common.
    """
    rank_a, rank_b = _ranks(a, b, type(a).KEY)
    unique_a, unique_b = _numbered(rank_a, rank_b)
    _, rows_a, rows_b = np.intersect1d(unique_a, unique_b, assume_unique=True, return_indices=True)
    alone_a, alone_b = _others(rows_a, len(a)), _others(rows_b, len(b))
    if time_ns > 0 and len(alone_a) and len(alone_b):
        more_a, more_b = _nearest(a, b, alone_a, alone_b, time_ns)
        rows_a, rows_b = np.concatenate([rows_a, more_a]), np.concatenate([rows_b, more_b])
        alone_a, alone_b = _others(rows_a, len(a)), _others(rows_b, len(b))
    order = np.argsort(rank_a[rows_a], kind="stable")
    return Join(
        a=rows_a[order],
        b=rows_b[order],
        only_a=alone_a[np.argsort(rank_a[alone_a], kind="stable")],
        only_b=alone_b[np.argsort(rank_b[alone_b], kind="stable")],
        rank_a=rank_a,
        rank_b=rank_b,
    )


def _ranks(a: Table, b: Table, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """Return the rank of each row's key among all keys of both tables; equal keys have equal ranks."""
    rank = np.zeros(len(a) + len(b), dtype=np.int64)
    for name in names:
        values: NDArray[np.generic] = np.concatenate([getattr(a, name), getattr(b, name)])
        found, code = np.unique(values, return_inverse=True)
        # Renumber after each column from 0 without gaps, so that the product cannot overflow.
        _, rank = np.unique(rank * max(len(found), 1) + code, return_inverse=True)
    return rank[: len(a)], rank[len(a) :]


def _numbered(rank_a: Ints, rank_b: Ints) -> tuple[Ints, Ints]:
    """Return ranks that differ for equal keys of one table too, by their order."""
    number_a, number_b = _occurrence(rank_a), _occurrence(rank_b)
    most = int(max(number_a.max(initial=0), number_b.max(initial=0))) + 1
    return rank_a * most + number_a, rank_b * most + number_b


def _occurrence(rank: Ints) -> Ints:
    """Return the number of equal values before each."""
    order = np.argsort(rank, kind="stable")
    ordered = rank[order]
    start = np.flatnonzero(np.concatenate([[True], np.diff(ordered) != 0])) if len(rank) else np.empty(0, np.int64)
    length = np.diff(np.append(start, len(rank)))
    out = np.empty(len(rank), dtype=np.int64)
    out[order] = np.arange(len(rank)) - np.repeat(start, length)
    return out


def _others(rows: Ints, n: int) -> Ints:
    mask: Bools = np.ones(n, dtype=np.bool_)
    mask[rows] = False
    return np.flatnonzero(mask)


def _nearest(a: Table, b: Table, rows_a: Ints, rows_b: Ints, time_ns: int) -> tuple[Ints, Ints]:
    """Pair rows that are each other's nearest in time within a group of equal keys, closest pairs first."""
    t_a, t_b = times(a)[rows_a], times(b)[rows_b]
    rest = tuple(name for name in type(a).KEY if name != "t_ns")
    group_a, group_b = _ranks(a.take(rows_a), b.take(rows_b), rest)
    pairs_a, pairs_b = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for group in np.intersect1d(group_a, group_b):
        own_a, own_b = np.flatnonzero(group_a == group), np.flatnonzero(group_b == group)
        found_a, found_b = _mutual(t_a[own_a], t_b[own_b], time_ns)
        pairs_a.append(rows_a[own_a[found_a]])
        pairs_b.append(rows_b[own_b[found_b]])
    return np.concatenate(pairs_a), np.concatenate(pairs_b)


def _mutual(t_a: Ints, t_b: Ints, time_ns: int) -> tuple[Ints, Ints]:
    """Return indices of pairs within `time_ns`: mutual nearest neighbours, then again among the rows left."""
    left_a, left_b = np.argsort(t_a, kind="stable"), np.argsort(t_b, kind="stable")
    pairs_a, pairs_b = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    while len(left_a) and len(left_b):
        to_b, to_a = _closest(t_a[left_a], t_b[left_b]), _closest(t_b[left_b], t_a[left_a])
        mutual = to_a[to_b] == np.arange(len(left_a))
        mutual &= np.abs(t_a[left_a] - t_b[left_b[to_b]]) <= time_ns
        if not mutual.any():
            break
        found_a, found_b = left_a[mutual], left_b[to_b[mutual]]
        pairs_a.append(found_a)
        pairs_b.append(found_b)
        left_a = left_a[~mutual]
        left_b = left_b[~np.isin(left_b, found_b)]
    return np.concatenate(pairs_a), np.concatenate(pairs_b)


def _closest(t: Ints, known: Ints) -> Ints:
    """Return the index of the nearest of the sorted times `known` for each t; the earlier of two equally near."""
    after = np.minimum(np.searchsorted(known, t), len(known) - 1)
    before = np.maximum(after - 1, 0)
    chosen = np.where(np.abs(known[after] - t) < np.abs(t - known[before]), after, before)
    # Take the first of equal times, so that nearest neighbours of duplicates can be mutual.
    return np.searchsorted(known, known[chosen])

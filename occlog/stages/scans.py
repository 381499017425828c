"""Bearings to scans: what all sensors say about one target at one time."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from ..columns import Ints
from ..errors import InputError
from ..records import UNLABELLED, Bearings
from ..trackers.method import Scan


class Group(NamedTuple):
    """Rows that form one scan, of all targets."""

    t_ns: int
    rows: Bearings
    sensor: Ints  # (R,) place of each row's sensor


def groups(
    chunks: Iterable[Bearings], sensors: tuple[str, ...], used: frozenset[str], window_ns: int = 0
) -> Iterator[Group]:
    """Scans in the order of time.

    Args:
        chunks: bearings in the order of time; a scan may be spread over chunks.
        sensors: names of all sensors of the scene.
        used: names of the sensors to use; rows of others are left out.
        window_ns: rows at most this far apart form one scan, unless a sensor speaks twice; its
            time is that of its last row.

    Raises:
        InputError: a sensor that the scene does not have, or time stamps that go back or repeat.
    """
    places = {name: i for i, name in enumerate(sensors)}
    rest = Bearings.empty()
    for chunk in chunks:
        _check_follows(rest, chunk)
        table = Bearings.concat([rest, _known(chunk, places, used)])
        starts = _starts(table, window_ns)
        for first, last in itertools.pairwise(starts):
            yield _group(table.take(slice(first, last)), places)
        rest = table.take(slice(starts[-1], None)) if len(table) else table
    if len(rest):
        yield _group(rest, places)


def _check_follows(before: Bearings, chunk: Bearings) -> None:
    if len(before) and len(chunk) and chunk.t_ns[0] < before.t_ns[-1]:
        raise InputError(
            f"bearings: sensor {chunk.sensor[0]}: time {chunk.t_ns[0]} ns comes after "
            f"{before.t_ns[-1]} ns; sort by t_ns"
        )


def _known(chunk: Bearings, places: dict[str, int], used: frozenset[str]) -> Bearings:
    names = np.unique(chunk.sensor)
    for name in names:
        if str(name) not in places:
            known = ", ".join(places) or "none"
            raise InputError(
                f"bearings: sensor {name!s} is not in the scene, which has: {known}; give the right --scene"
            )
    keep = [str(n) for n in names if str(n) in used]
    return chunk if len(keep) == len(names) else chunk.take(np.isin(chunk.sensor, keep))


def _starts(table: Bearings, window_ns: int) -> list[int]:
    """First rows of the groups; the last group may go on in the next chunk."""
    if window_ns == 0 or not len(table):
        return [0, *(np.flatnonzero(np.diff(table.t_ns)) + 1).tolist()]
    starts = [0]
    seen: dict[str, int] = {}
    for row, (t_ns, sensor) in enumerate(zip(table.t_ns.tolist(), table.sensor.tolist(), strict=True)):
        if t_ns - table.t_ns[starts[-1]] > window_ns or seen.get(sensor, t_ns) != t_ns:
            starts.append(row)
            seen = {}
        seen[sensor] = t_ns
    return starts


def _group(rows: Bearings, places: dict[str, int]) -> Group:
    sensor = np.array([places[str(s)] for s in rows.sensor], dtype=np.int64)
    order = np.lexsort((rows.target_id, sensor))
    rows, sensor = _reorder(rows, order), sensor[order]
    same = (np.diff(sensor) == 0) & (np.diff(rows.target_id) == 0) & (rows.target_id[1:] != UNLABELLED)
    if same.any():
        row = int(np.flatnonzero(same)[0])
        raise InputError(
            f"bearings: sensor {rows.sensor[row]}: two rows for target {rows.target_id[row]} at {rows.t_ns[row]} ns; "
            "a sensor has one row a target and time (candidates of unknown origin have target_id -1)"
        )
    return Group(int(rows.t_ns.max()), rows, sensor)


def _reorder(rows: Bearings, order: Ints) -> Bearings:
    """Rows in another order, with one time for all, as a scan has."""
    values = {c.name: getattr(rows, c.name)[order] for c in Bearings.columns()}
    values["t_ns"] = np.full(len(order), rows.t_ns.max(), dtype=np.int64)
    return Bearings(**values)


def scan_of(group: Group, target_id: int) -> Scan | None:
    """What a scan says about one target: its own rows, and candidates of sensors that have none; None for nothing."""
    rows = group.rows
    own = rows.target_id == target_id
    told = np.isin(group.sensor, group.sensor[own])
    take = own | ((rows.target_id == UNLABELLED) & ~told)
    if not take.any():
        return None
    return Scan(
        t_ns=group.t_ns,
        sensor=group.sensor[take],
        labelled=own[take],
        seen=rows.seen[take],
        bearing=rows.bearing[take],
        sigma=rows.sigma[take],
        u_px=rows.u_px[take],
        sigma_px=rows.sigma_px[take],
        score=rows.score[take],
    )

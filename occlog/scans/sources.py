"""Streams of bearings: from directions of arrival, joined in the order of time, and with rows omitted.

`bearings_of_doa` converts directions to bearings, `within_times` merges streams, `round_robin` keeps one sensor at a
time, and `only_measured` reverts the rows recovered by the fusion of detections.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from occlog.array_types import NS
from occlog.core.geometry.camera import wrap_angle
from occlog.errors import InputError, option
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Doa

T = TypeVar("T", Bearings, Measurements)
MODES = ("ignore", "use")
MEASURED = ("bearing", "sigma", "u_px", "sigma_px", "score", "elevation", "sigma_elevation")


def only_measured(chunks: Iterable[Bearings]) -> Iterator[Bearings]:
    """Generate the chunks with recovered rows reverted to missed detections.

    A recovered row repeats what other cameras measured at the same time, and is not an independent measurement.
    """
    for chunk in chunks:
        recovered = chunk.cause == "recovered"
        if not recovered.any():
            yield chunk
            continue
        columns = {name: np.where(recovered, np.nan, getattr(chunk, name)) for name in MEASURED}
        yield replace(chunk, seen=chunk.seen & ~recovered, **columns)


def bearings_of_doa(
    chunks: Iterable[Doa], scene: Scene, labels: bool = False, recorded: Scene | None = None
) -> Iterator[Bearings]:
    """Generate bearings from directions of arrival, unlabelled unless `labels` is True.

    A direction without a standard deviation has that of its array. Where the scene states another yaw of an array than
    that with which its directions were recorded, they are turned by the difference.

    Args:
        chunks: directions in the order of time.
        scene: must have the arrays.
        labels: identities that the source gives are those of targets; otherwise they are its own and not kept. A
            direction without identity is a candidate in any case.
        recorded: scene with which the directions were recorded; None: as `scene`.

    Raises:
        InputError: an array that the scene does not have; or, at the end, `labels` of a log in which no direction has
            an identity.
    """
    sigmas = {a.name: float(a.sigma) for a in scene.arrays}
    across = {a.name: float(a.sigma if a.sigma_elevation is None else a.sigma_elevation) for a in scene.arrays}
    before = {} if recorded is None else {a.name: float(a.yaw) for a in recorded.arrays}
    turned = {a.name: float(a.yaw) - before.get(a.name, float(a.yaw)) for a in scene.arrays}
    offset, noted = 0, False
    for chunk in chunks:
        for name in np.unique(chunk.sensor).tolist():
            if name not in sigmas:
                row = offset + int(np.flatnonzero(chunk.sensor == name)[0])
                known = ", ".join(sigmas) or "none"
                raise InputError(
                    f"doa: row {row}: the scene has no microphone array {name!r}; it has: {known}", id="unknown-sensor"
                )
        own = np.array([sigmas[name] for name in chunk.sensor.tolist()], dtype=np.float64)
        upward = np.array([across[name] for name in chunk.sensor.tolist()], dtype=np.float64)
        upward = np.where(np.isnan(chunk.sigma_elevation), upward, chunk.sigma_elevation)
        azimuth = chunk.azimuth
        if any(turned.values()):
            azimuth = wrap_angle(azimuth + np.array([turned[name] for name in chunk.sensor.tolist()]))
        n = len(chunk)
        offset += n
        noted = noted or bool((chunk.source_id >= 0).any())
        yield Bearings.of(
            t_ns=chunk.t_ns,
            sensor=chunk.sensor,
            target_id=np.where(labels & (chunk.source_id >= 0), chunk.source_id, UNLABELLED).astype(np.int32),
            seen=np.ones(n, dtype=np.bool_),
            bearing=azimuth,
            sigma=np.where(np.isnan(chunk.sigma_azimuth), own, chunk.sigma_azimuth),
            u_px=np.full(n, np.nan),
            sigma_px=np.full(n, np.nan),
            score=chunk.confidence,
            elevation=chunk.elevation,
            sigma_elevation=np.where(np.isnan(chunk.elevation), np.nan, upward),
        )
    if labels and not noted:
        raise InputError(
            f"doa: none of {offset} directions has an identity (source_id); leave {option('doa_labels')} out, or give "
            "the log a column `id`",
            id="missing-labels",
        )


def round_robin(chunks: Iterable[Bearings], names: Sequence[str], seconds: float) -> Iterator[Bearings]:
    """Generate the rows of one sensor at a time, in turns, as if the others had no frame (a network without overlap).

    The first of `names` has the first turn, which begins with the first row of any of them; after the last it is the
    first one's turn again. A row at the very time at which turns change is of the next turn. Rows of other sensors are
    omitted. The result does not depend on the chunks.

    Args:
        chunks: bearings in the order of time.
        names: names of the sensors, each once, at least one.
        seconds: length of a turn [s], above 0; rounded to whole nanoseconds.
    """
    turn_ns = max(round(seconds * NS), 1)
    index_of = {name: i for i, name in enumerate(names)}
    begin: int | None = None
    for chunk in chunks:
        found, inverse = np.unique(chunk.sensor, return_inverse=True)
        own = np.array([index_of.get(name, -1) for name in found.tolist()], dtype=np.int64)[inverse]
        if begin is None:
            if not (own >= 0).any():
                continue
            begin = int(chunk.t_ns[np.argmax(own >= 0)])
        keep = own == (chunk.t_ns - begin) // turn_ns % len(names)
        if keep.any():
            yield chunk.take(keep)


def within_times(streams: Sequence[Iterable[T]]) -> Iterator[T]:
    """Generate the rows of several streams as one stream in the order of time; one chunk of each is buffered.

    Each stream is sorted by time. Rows of equal time keep the order of the streams.
    """
    if len(streams) == 1:
        yield from streams[0]
        return
    ahead = [filter(len, stream) for stream in streams]
    held = [next(stream, None) for stream in ahead]
    while any(chunk is not None for chunk in held):
        # Nothing later than this can be given away before a stream has shown its next chunk.
        until = min(int(chunk.t_ns[-1]) for chunk in held if chunk is not None)
        ready = []
        for i, chunk in enumerate(held):
            if chunk is None:
                continue
            cut = int(np.searchsorted(chunk.t_ns, until, side="right"))
            ready.append(chunk.take(slice(None, cut)))
            held[i] = chunk.take(slice(cut, None)) if cut < len(chunk) else next(ahead[i], None)
        yield _by_time(ready)


def _by_time(parts: list[T]) -> T:
    """Return tables that overlap in time as one, sorted; rows of equal time keep the order of the parts."""
    table = type(parts[0])
    order = np.argsort(np.concatenate([part.t_ns for part in parts]), kind="stable")
    columns = {c.name: np.concatenate([getattr(part, c.name) for part in parts])[order] for c in table.columns()}
    return table(**columns)

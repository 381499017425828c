"""Several sources of measurements as one stream of bearings in the order of time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ..errors import InputError
from ..records import UNLABELLED, Bearings, Doa
from ..scene import Scene


def bearings_of_doa(chunks: Iterable[Doa], scene: Scene) -> Iterator[Bearings]:
    """Directions of arrival as candidate bearings, which may be of any object; elevations are left out.

    A direction without a standard deviation has that of its array.  Identities that the
    source gives are its own, not those of targets, so they are not kept.  InputError for an
    array that the scene does not have.
    """
    sigmas = {a.name: float(a.sigma) for a in scene.arrays}
    offset = 0
    for chunk in chunks:
        for name in np.unique(chunk.sensor).tolist():
            if name not in sigmas:
                row = offset + int(np.flatnonzero(chunk.sensor == name)[0])
                known = ", ".join(sigmas) or "none"
                raise InputError(f"doa: row {row}: the scene has no array {name!r}; it has: {known}")
        own = np.array([sigmas[name] for name in chunk.sensor.tolist()], dtype=np.float64)
        n = len(chunk)
        offset += n
        yield Bearings.of(
            t_ns=chunk.t_ns,
            sensor=chunk.sensor,
            target_id=np.full(n, UNLABELLED, dtype=np.int32),
            seen=np.ones(n, dtype=np.bool_),
            bearing=chunk.azimuth,
            sigma=np.where(np.isnan(chunk.sigma_azimuth), own, chunk.sigma_azimuth),
            u_px=np.full(n, np.nan),
            sigma_px=np.full(n, np.nan),
            score=chunk.confidence,
        )


def in_time(streams: Sequence[Iterable[Bearings]]) -> Iterator[Bearings]:
    """One stream of chunks from several, each in the order of time; holds one chunk of each.

    Rows of equal time keep the order of the streams.
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


def _by_time(parts: list[Bearings]) -> Bearings:
    """One table of parts that overlap in time; rows of equal time keep the order of the parts."""
    order = np.argsort(np.concatenate([part.t_ns for part in parts]), kind="stable")
    columns = {c.name: np.concatenate([getattr(part, c.name) for part in parts])[order] for c in Bearings.columns()}
    return Bearings(**columns)

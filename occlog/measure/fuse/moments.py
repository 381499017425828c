"""Views and bearings in parts of whole moments, and the rows of each moment."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError
from occlog.measure.detections import Detections
from occlog.records.tables import Bearings, Views

T = TypeVar("T", Views, Bearings)


@dataclass(frozen=True, eq=False)
class Part:
    """Some whole moments: their views, their bearings, and the first row of each moment in the bearings."""

    views: Views
    bearings: Bearings
    starts: Ints  # (M + 1,) of the bearings; 0 first, number of rows last
    losses: Detections  # what came with them: losses and numbers of frames


def whole_moments(parts: Iterable[Detections], window_ns: int) -> Iterator[Part]:
    """Parts that never end amid a moment; where the input is cut does not matter to the moments.

    Rows at most `window_ns` apart are of one moment, unless a sensor speaks at two times.  Views go with the
    bearings of their time.

    Raises:
        InputError: times that go back from one part to the next.
    """
    views, bearings = Views.empty(), Bearings.empty()
    for part in parts:
        views, bearings = _joined(views, part.views), _joined(bearings, part.bearings)
        starts = moments(bearings, window_ns)
        cut = int(starts[-2]) if len(bearings) else 0  # the last moment may go on in the next part
        first_ns = int(bearings.t_ns[cut]) if len(bearings) else None
        over = len(views) if first_ns is None else int(np.searchsorted(views.t_ns, first_ns))
        whole = starts[:-1] if len(bearings) else starts
        yield Part(views.take(slice(0, over)), bearings.take(slice(0, cut)), whole, part)
        views, bearings = views.take(slice(over, None)), bearings.take(slice(cut, None))
    nothing = Detections(Views.empty(), Bearings.empty(), (), 0, 0)
    yield Part(views, bearings, moments(bearings, window_ns), nothing)


def _joined(held: T, more: T) -> T:
    if len(held) and len(more) and more.t_ns[0] < held.t_ns[-1]:
        raise InputError(f"{held.NAME}: time {more.t_ns[0]} ns comes after {held.t_ns[-1]} ns; sort the rows by t_ns")
    return type(held).concat([held, more.sorted()])


def moments(bearings: Bearings, window_ns: int) -> Ints:
    """(M + 1,) first rows of the moments, then the number of rows."""
    t = bearings.t_ns
    if not len(t):
        return np.zeros(1, dtype=np.int64)
    if window_ns == 0:
        return np.concatenate([[0], np.flatnonzero(np.diff(t)) + 1, [len(t)]]).astype(np.int64)
    starts = [0]
    spoke: dict[str, int] = {}
    for row, (t_ns, sensor) in enumerate(zip(t.tolist(), bearings.sensor.tolist(), strict=True)):
        if t_ns - int(t[starts[-1]]) > window_ns or spoke.get(sensor, t_ns) != t_ns:
            starts.append(row)
            spoke = {}
        spoke[sensor] = t_ns
    return np.array([*starts, len(t)], dtype=np.int64)


def together(views: Iterable[Views], bearings: Iterable[Bearings]) -> Iterator[Detections]:
    """Tables of their own as parts: each chunk of bearings with the views up to its last time."""
    ahead = iter(views)
    held = Views.empty()
    for chunk in bearings:
        if not len(chunk):
            continue
        last = int(chunk.t_ns[-1])
        while not len(held) or held.t_ns[-1] <= last:
            more = next(ahead, None)
            if more is None:
                break
            held = Views.concat([held, more])
        over = int(np.searchsorted(held.t_ns, last, side="right"))
        yield Detections(held.take(slice(0, over)), chunk, (), 0, 0)
        held = held.take(slice(over, None))
    for more in (held, *ahead):
        yield Detections(more, Bearings.empty(), (), 0, 0)

"""Two runs in the same moments: the times of both, from the later of their starts to the earlier of their ends."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.core.metrics.mot.frame_pairs import Objects
from occlog.errors import InputError
from occlog.evaluate.matching.paths import Path as Way
from occlog.records.tables import Tracks


@dataclass(frozen=True, eq=False)
class Laid:
    """Estimates of a run in common frames, in the order of frame and identity.

    Attributes:
        frame: (n,) number of the frame.
        row: (n,) row of the run's table: the estimate itself, or the latest one before an interpolated place.
        xy: (n, 2) places.
        label: (n,) identities.
    """

    frame: Ints
    row: Ints
    xy: Floats
    label: Ints

    def objects(self) -> Objects:
        """The places, to be laid against others."""
        return Objects(self.frame, self.label, self.xy)

    def table(self, tracks: Tracks, times: Ints) -> Tracks:
        """The run's table as it is in the frames at these times."""
        own = tracks.take(self.row)
        return replace(own, t_ns=times[self.frame], x=self.xy[:, 0], y=self.xy[:, 1])


def common_times(a: Tracks, b: Tracks) -> Ints:
    """(T,) times at which one run or the other has estimates, while both last.

    Raises:
        InputError: they have no time in common.
    """
    spans = [(int(each.t_ns[0]), int(each.t_ns[-1])) for each in (a, b)]
    start, end = max(s for s, _ in spans), min(e for _, e in spans)
    if start > end:
        told = " and ".join(f"{s / NS:.3f} s to {e / NS:.3f} s" for s, e in spans)
        raise InputError(f"the runs have no time in common: {told}; name two runs of one recording")
    times = np.union1d(a.t_ns, b.t_ns)
    found: Ints = times[(times >= start) & (times <= end)]
    return found


def laid(tracks: Tracks, times: Ints) -> Laid:
    """A run's estimates at some times.

    At times of its own a person is there who has a row.  At times of the other run alone places are interpolated, over
    gaps of a usual step of the person's rows (`Path.usual_gap_ns`).
    """
    place = np.searchsorted(times, tracks.t_ns)
    inside = np.minimum(place, len(times) - 1)
    rows = np.flatnonzero((place < len(times)) & (times[inside] == tracks.t_ns))
    frames, places = [place[rows]], [np.column_stack([tracks.x, tracks.y])[rows]]
    sources, labels = [rows], [tracks.target_id[rows].astype(np.int64)]
    others = np.flatnonzero(~np.isin(times, tracks.t_ns))
    order = np.argsort(tracks.target_id, kind="stable")
    names, first = np.unique(tracks.target_id[order], return_index=True)
    for name, own in zip(names.tolist(), np.split(order, first[1:]), strict=True):
        if not len(others):
            break
        t_ns = tracks.t_ns[own]
        xy, good = Way(t_ns, np.column_stack([tracks.x[own], tracks.y[own]])).at(times[others], None)
        frames.append(others[good])
        places.append(xy[good])
        sources.append(own[np.searchsorted(t_ns, times[others[good]], side="right") - 1])
        labels.append(np.full(int(good.sum()), name, dtype=np.int64))
    frame, label = np.concatenate(frames), np.concatenate(labels)
    sort = np.lexsort((label, frame))
    return Laid(frame[sort], np.concatenate(sources)[sort], np.concatenate(places)[sort], label[sort])

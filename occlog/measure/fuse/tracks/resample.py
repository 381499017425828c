"""Tracks of several groups of cameras at common moments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.records.tables import PeopleTracks

JUST_UNDER = 0.49
"""Moments are so much of the shortest period long, so that none has two rows of one track."""
STRAIGHT = (
    *("x", "y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy", "cov_x_vx", "cov_x_vy", "cov_y_vx", "cov_y_vy"),
    *("cov_vx_vx", "cov_vx_vy", "cov_vy_vy", "existence", "height", "width", "sd_height", "sd_width"),
)
"""Columns that a straight line bridges.  The covariance of a place on the line is at most that of its ends in the same
shares, whatever their errors have in common."""


def default_window(groups: Sequence[PeopleTracks]) -> int:
    """Just under half the shortest period of all groups [ns]; 0 where none has two times."""
    periods = [np.median(np.diff(times)) for g in groups if len(times := np.unique(g.t_ns)) > 1]
    return int(JUST_UNDER * min(periods)) if periods else 0


def moments_of(groups: Sequence[PeopleTracks], window_ns: int) -> Ints:
    """(T,) the common moments [ns]: the first of all times that are at most a window after it."""
    times = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(g.t_ns for g in groups)]))
    starts: list[int] = []
    at = 0
    while at < len(times):
        starts.append(int(times[at]))
        at = int(np.searchsorted(times, times[at] + window_ns, side="right"))
    return np.array(starts, dtype=np.int64)


def at_moments(tracks: PeopleTracks, moments: Ints, window_ns: int, gap_ns: int) -> PeopleTracks:
    """Rows of all tracks at the moments at which they are there, ordered by time and identity.

    A row at a moment stays as it is.  Between rows that are at most `gap_ns` apart lies a straight line; a row that is
    at most `window_ns` from a moment is moved there with its velocity where there is no line.
    """
    order = np.lexsort((tracks.t_ns, tracks.target_id))
    starts = np.flatnonzero(np.diff(tracks.target_id[order], prepend=-1)) if len(order) else np.zeros(0, dtype=np.int64)
    parts = [
        _one_at_moments(tracks.take(rows), moments, window_ns, gap_ns)
        for rows in np.split(order, starts[1:])
        if len(rows)
    ]
    return PeopleTracks.merge(parts)


def _one_at_moments(track: PeopleTracks, moments: Ints, window_ns: int, gap_ns: int) -> PeopleTracks:
    t = track.t_ns
    asked = moments[np.searchsorted(moments, t[0] - window_ns) : np.searchsorted(moments, t[-1] + window_ns, "right")]
    # The rows before and after each moment; at the ends of the track the same row twice
    before = np.clip(np.searchsorted(t, asked, side="right") - 1, 0, len(t) - 1)
    after = np.clip(np.searchsorted(t, asked, side="left"), 0, len(t) - 1)
    nearest = np.where(asked - t[before] <= t[after] - asked, before, after)
    inside = (t[before] <= asked) & (asked <= t[after]) & (t[after] - t[before] <= gap_ns)
    good = inside | (np.abs(asked - t[nearest]) <= window_ns)
    before, after = np.where(inside, before, nearest)[good], np.where(inside, after, nearest)[good]
    asked, nearest = asked[good], nearest[good]
    # Interpolate; outside of lines, move on with the velocity
    share = (asked - t[before]) / np.maximum(t[after] - t[before], 1)
    share[before == after] = 0.0
    delay = np.where(before == after, (asked - t[before]) / NS, 0.0)
    values = {name: _line(getattr(track, name), before, after, share) for name in STRAIGHT}
    for place, speed in (("x", "vx"), ("y", "vy")):
        values[place] = values[place] + np.where(np.isfinite(values[speed]), delay * values[speed], 0.0)
    columns = {c.name: getattr(track, c.name)[nearest] for c in PeopleTracks.columns()}
    return PeopleTracks(**{**columns, **values, "t_ns": asked})


def _line(values: Floats, before: Ints, after: Ints, share: Floats) -> Floats:
    """Values between two rows; one that is not known at an end where nothing of it counts does no harm."""
    same = before == after
    between: Floats = (1.0 - share) * values[before] + share * values[after]
    return np.where(same, values[before], between)

"""Which track errors are of: they name the true target, and a tracker of everybody has names of its own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from occlog.records.tables import Errors, Tracks

LOOKS = 200
"""Errors of each target that are looked up among the tracks, evenly taken."""


def relabelled(found: Mapping[int, int | None]) -> bool:
    """Whether tracks have names of their own, and errors those of the truth, of what `followers` found."""
    return any(target != track for target, track in found.items())


def followers(errors: Errors, tracks: Tracks) -> dict[int, int | None]:
    """By the identity that errors name, that of the track whose estimates they are of.

    An error is of the estimate of its time and place.

    Args:
        errors: of `occlog evaluate`, or some of them.
        tracks: in the order of time, or some of their times.

    Returns:
        By target its track; None where errors of one target are of several tracks.  A target is left out if no
        estimate of its errors is among the tracks.
    """
    out: dict[int, int | None] = {}
    shared = np.isin(errors.t_ns, tracks.t_ns)
    for target in np.unique(errors.target_id).tolist():
        rows = np.flatnonzero(shared & (errors.target_id == target))
        some = np.unique(np.linspace(0, max(len(rows) - 1, 0), min(len(rows), LOOKS)).round().astype(np.int64))
        found: set[int] | None = None
        for k in rows[some].tolist():
            start, stop = np.searchsorted(tracks.t_ns, errors.t_ns[k] + np.array([0, 1])).tolist()
            there = (tracks.x[start:stop] == errors.x[k]) & (tracks.y[start:stop] == errors.y[k])
            names = set(tracks.target_id[start:stop][there].tolist())
            if names:
                found = names if found is None else found & names
        if found is not None:
            out[target] = target if target in found else found.pop() if len(found) == 1 else None
    return out

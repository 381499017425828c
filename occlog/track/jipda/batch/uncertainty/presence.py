"""How probably somebody was there already before their first place, and still is after the last one."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

from ..chains import NONE
from ..states import States
from ..tracks import Span, Tracks


def presence(tracks: Tracks, span: Span, walk: States) -> Floats:
    """(K,) probability that the person of each row is there at its moment; 1 from the first to the last place.

    Whoever was not seen after their last place has left at once, or was missed, and missed again, and left, or is
    still there when the recording ends: each with the probability of leaving then times that of all misses before.
    """
    out = np.ones(len(walk.track))
    for ends, step in ((walk.last, 1), (walk.next, -1)):
        rows = np.flatnonzero(~walk.inside & (ends != NONE))
        for place in np.unique(ends[rows]).tolist():
            of = rows[ends[rows] == place]
            out[of] = _still(tracks, span, place, step)[np.abs(walk.moment[of] - tracks.places.moment[place])]
    return out


def _still(tracks: Tracks, span: Span, place: int, step: int) -> Floats:
    """Probabilities of being there 0, 1, .. moments after a last place (step 1), or before a first one (step -1)."""
    here = tracks.places.moment[place]
    at = np.arange(here, len(span.time)) if step > 0 else np.arange(here, -1, -1)
    looked = span.looked[at + 1] - span.looked[here + 1] if step > 0 else span.looked[here] - span.looked[at]
    away = np.abs(span.time[at] - span.time[here])
    missed = np.exp(looked @ tracks.places.miss[place] - away / span.stay)
    # Leaving between a moment and the next; after the last one nobody leaves
    weight = missed * np.append(-np.expm1(-np.diff(away) / span.stay), 1.0)
    return np.asarray(np.cumsum(weight[::-1])[::-1] / weight.sum())

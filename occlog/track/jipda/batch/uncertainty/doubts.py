"""Where two identities may have been exchanged: an exchange of the tails of two tracks that is hardly less likely."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.track.jipda.interface import NOBODY, Event

from ..appearance import together
from ..chains import NONE, Candidates, Chain, Places, Walk, link, may_follow
from ..tracks import Span, Tracks, listed_of

LEAST = 0.05
"""Less probable exchanges are not named."""
APART_S = 4.0
"""Of exchanges of the same two people within so long, the most probable one is named."""


def doubts(tracks: Tracks, span: Span, number: Ints, identity: Ints) -> dict[int, list[Event]]:
    """Exchanges that are doubtful, by the moment from which on the identities may be wrong.

    Args:
        tracks: of the places.
        span: the moments.
        number: (n,) track of each place; NONE: none.
        identity: of each track; NOBODY: it is not reported.
    """
    walk = tracks.walk._replace(reach=min(tracks.walk.reach, 4))
    listed = listed_of(tracks._replace(walk=walk), span)
    i, j, probability = _exchanges(tracks.places, walk, span.looked, listed, tracks.chain, number)
    named: dict[tuple[int, int], list[tuple[float, int]]] = {}
    out: dict[int, list[Event]] = {}
    # The most probable first
    for k in np.argsort(-probability, kind="stable").tolist():
        one, other = int(identity[number[i[k]]]), int(identity[number[j[k]]])
        if NOBODY in (one, other):
            continue
        moment = int(tracks.places.moment[j[k]])
        time = float(span.time[moment])
        pair = (min(one, other), max(one, other))
        if any(abs(time - t) < APART_S for t, _ in named.get(pair, [])):
            continue
        named.setdefault(pair, []).append((time, moment))
        for a, b in (pair, pair[::-1]):
            out.setdefault(moment, []).append(Event("doubt", a, b, float(probability[k])))
    return out


@kernel
def _exchanges(
    places: Places, walk: Walk, looked: Floats, listed: Candidates, chain: Chain, number: Ints
) -> tuple[Ints, Ints, Floats]:
    """Places i and j whose link, with that of the tails that are left, has a probability of at least `LEAST`."""
    before, after, probability = [0], [0], [0.0]
    for i in range(places.moment.shape[0]):
        a = chain.after[i]
        if not chain.used[i] or a == NONE:
            continue
        for k in range(listed.first_next[i], listed.first_next[i + 1]):
            j = listed.next[k]
            if not chain.used[j] or number[j] == number[i]:
                continue
            b = chain.before[j]
            if b == NONE or not may_follow(places, walk, b, a):
                continue
            now = link(places, walk, looked, chain, i, a) + link(places, walk, looked, chain, b, j)
            then = link(places, walk, looked, chain, i, j) + link(places, walk, looked, chain, b, a)
            sums = chain.sums
            now += together(places.alike, sums, i, NONE, a) + together(places.alike, sums, b, NONE, j)
            then += together(places.alike, sums, i, NONE, j) + together(places.alike, sums, b, NONE, a)
            p = 1.0 / (1.0 + np.exp(min(now - then, 50.0)))
            if p >= LEAST:
                before.append(i)
                after.append(j)
                probability.append(p)
    return np.array(before[1:]), np.array(after[1:]), np.array(probability[1:])

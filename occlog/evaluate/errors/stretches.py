"""Tracks and truth side by side in stretches of time, so that memory does not grow with their length.

What must be known of the whole (`survey`) is found in a pass before.  A table of one chunk is one stretch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Ints
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import Path, paths_of
from occlog.records.pieces import Limits, Side, in_step
from occlog.records.tables import Tracks, Truth

from .survey import Survey


class Stretch(NamedTuple):
    """What there is during a stretch of time.

    Attributes:
        rows: estimates.
        truth: true positions, of all roles.
        targets: path of each target that is there or near, in it and about it.
        tracks: path of each track, likewise.
        times: of true targets, each once.
        limits: first moment, and that after the last one.
        sides: tracks and truth, which have as much about the stretch as was asked for.
    """

    rows: Tracks
    truth: Truth
    targets: Mapping[int, Path]
    tracks: Mapping[int, Path]
    times: Ints
    limits: Limits
    sides: tuple[Side[Tracks], Side[Truth]]


class Beside(NamedTuple):
    """Tables that are gone through beside tracks and truth, and how much of these there is about a stretch [ns].

    Attributes:
        sides: the other tables, of which nothing is read yet.
        margins_ns: of each of them.
        tracks_ns: of tracks, if more than what is bridged.
        truth_ns: of the truth, likewise.
    """

    sides: Sequence[Side[Any]] = ()
    margins_ns: Sequence[int] = ()
    tracks_ns: int = 0
    truth_ns: int = 0


def stretches(
    tracks: Iterable[Tracks],
    truth: Iterable[Truth],
    known: Survey,
    config: EvaluateConfig,
    track_gap_ns: int = 0,
    beside: Beside | None = None,
) -> Iterator[Stretch]:
    """Go through tracks and truth side by side.

    A stretch has about it as much as gaps are bridged, so that what is interpolated in it is the same as in the whole.

    Args:
        tracks: chunks in the order of time.
        truth: likewise.
        known: of the same chunks.
        config: how far apart samples may be.
        track_gap_ns: how far apart samples of tracks may be, if that is further.
        beside: other tables, of which rows may be looked at while a stretch is.
    """
    more = beside or Beside()
    limit = max(known.gaps_ns.values(), default=0) if config.limit_ns is None else config.limit_ns
    margin = max(limit, config.bridge_ns, track_gap_ns)
    ours, theirs = Side(tracks, Tracks), Side(truth, Truth)
    margins = (max(margin, more.tracks_ns), max(margin, more.truth_ns), *more.margins_ns)
    for limits in in_step((ours, theirs, *more.sides), margins):
        rows, true = limits.of(ours), limits.of(theirs)
        if not (len(rows) or len(true) or more.sides):
            continue
        targets = {
            label: replace(path, gap_ns=known.gaps_ns[label])
            for label, path in paths_of(limits.about(theirs, margin), "target").items()
        }
        times = np.unique(true.t_ns[true.role == "target"])
        yield Stretch(rows, true, targets, paths_of(limits.about(ours, margin)), times, limits, (ours, theirs))

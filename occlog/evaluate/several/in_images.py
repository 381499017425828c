"""Figures of several recordings in images, in memory that does not grow with the length of tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from occlog.array_types import Ints
from occlog.core.metrics.mot.frame_pairs import Objects
from occlog.evaluate.inputs import Paths
from occlog.evaluate.mot.config import ManyConfig
from occlog.evaluate.mot.figures import Metrics
from occlog.evaluate.mot.in_stretches import Known
from occlog.evaluate.mot.run import box_streams, compared_boxes
from occlog.evaluate.mot.stage import ViewFigures, keys_of
from occlog.evaluate.mot.truth_and_tracks import TruthAndTracks

Parts = Iterator[tuple[list[int], TruthAndTracks]]
"""Number of frames of each view before a part, and the part."""


class _Recording(NamedTuple):
    """A recording that is gone through as often as wanted."""

    known: Known
    config: ManyConfig
    parts: Callable[[], Parts]


def figures_in_images(
    sides: Sequence[Paths], overlap: float, given: Mapping[str, object]
) -> tuple[list[Metrics], Metrics]:
    """Figures of each recording, and those of all together, in which every view of a recording is a view of its own.

    Args:
        sides: tracks and truth of each.
        overlap: intersection over union from which a track is of a true box.
        given: settings of `ManyConfig` that were given.
    """
    recordings = [_opened(paths, overlap, given) for paths in sides]
    places = _places([each.known for each in recordings])
    targets, tracks = (
        np.concatenate([place.keys(keys) for place, keys in zip(places, side, strict=True)])
        for side in ([r.known.targets for r in recordings], [r.known.tracks for r in recordings])
    )
    names = tuple(f"{n}/{view}" for n, each in enumerate(recordings) for view in each.known.views)
    whole = ViewFigures(names, targets, tracks, recordings[-1].config, apart=False)
    own = [ViewFigures(r.known.views, r.known.targets, r.known.tracks, r.config) for r in recordings]
    for recording, figures, place in zip(recordings, own, places, strict=True):
        for begin, part in recording.parts():
            figures.first(part, begin)
            whole.first(*place.among(names, part, begin))
    for recording, figures, place in zip(recordings, own, places, strict=True):
        for begin, part in recording.parts():
            figures.second(part, begin)
            whole.second(*place.among(names, part, begin))
    known = [each.known for each in recordings]
    counts = {name: sum(each.counts[name] for each in known) for name in known[0].counts}
    each = [figures.metrics(one.frames, one.counts) for figures, one in zip(own, known, strict=True)]
    return each, whole.metrics([n for one in known for n in one.frames], counts)


def _opened(paths: Paths, overlap: float, given: Mapping[str, object]) -> _Recording:
    """A recording in pieces, or as one piece that was read: of a format that counts frames, and a short one."""
    found = box_streams(paths, overlap, given)
    if found is not None and found[0].known is not None:
        streams, config = found
        return _Recording(found[0].known, config, partial(streams.parts, found[0].known))
    compared, config, _ = compared_boxes(paths, overlap, given)
    keys = keys_of(compared.truth), keys_of(compared.tracks)
    known = Known(compared.views, compared.left_out, compared.frames, compared.counts, *keys)
    return _Recording(known, config, lambda: iter([([0] * len(compared.views), compared)]))


class _Place(NamedTuple):
    """Where a recording is among all."""

    labels: Ints  # its identities, rising, which are numbered in this order
    used: int  # how many identities the recordings before it have
    views: int  # how many views these have

    def keys(self, keys: Ints) -> Ints:
        """(n, 2) view and label among all."""
        return np.column_stack([keys[:, 0] + self.views, self._numbers(keys[:, 1])])

    def among(self, names: tuple[str, ...], part: TruthAndTracks, begin: list[int]) -> tuple[TruthAndTracks, list[int]]:
        """A part of the recording as one of all, whose views have these names, and the frames before it."""
        before, behind = self.views, len(names) - self.views - len(part.views)
        none: Ints = np.zeros(0, dtype=np.int64)
        return part._replace(
            views=names,
            truth=self._objects(part.truth),
            tracks=self._objects(part.tracks),
            t_ns=(*[none] * before, *part.t_ns, *[none] * behind),
            number=(*[none] * before, *part.number, *[none] * behind),
        ), [*[0] * before, *begin, *[0] * behind]

    def _objects(self, side: Objects) -> Objects:
        view = np.zeros(len(side.frame), dtype=np.int64) if side.view is None else side.view
        return side._replace(label=self._numbers(side.label), view=self.views + view)

    def _numbers(self, labels: Ints) -> Ints:
        return np.asarray(self.used + np.searchsorted(self.labels, labels), dtype=np.int64)


def _places(known: Sequence[Known]) -> list[_Place]:
    """Recordings one after another."""
    out, used, views = [], 0, 0
    for each in known:
        labels = np.unique(np.concatenate([each.targets[:, 1], each.tracks[:, 1]]))
        out.append(_Place(labels, used, views))
        used, views = used + len(labels), views + len(each.views)
    return out

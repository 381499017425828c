"""Boxes of tracks and true boxes in the same frames: of one camera and time, each identity once in a frame.

`boxes_in_true_frames` selects them, `view_boxes` gives those of a view back as tables.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.metrics.mot.frame_pairs import Objects
from occlog.errors import InputError
from occlog.records.tables import Boxes, TruthBoxes

from .config import ManyConfig
from .figures import of_view


class TruthAndTracks(NamedTuple):
    """Truth and tracks in the frames that the truth knows.

    A camera is a view, numbered in the order of names; `frame` of the objects counts the true
    frames of its view in the order of time.

    Attributes:
        views: names of the cameras.
        truth: true objects; places are boxes.
        tracks: estimated objects; places are boxes.
        visible: (n,) visible share of each true object; NaN: not known.
        t_ns: for each view the times of its frames.
        number: for each view the numbers of its frames in the camera's stream.
        counts: what was compared and what was left out.
    """

    views: tuple[str, ...]
    truth: Objects
    tracks: Objects
    visible: Floats
    t_ns: tuple[Ints, ...]
    number: tuple[Ints, ...]
    counts: dict[str, float]

    @property
    def frames(self) -> list[int]:
        """Number of frames of each view."""
        return [len(times) for times in self.t_ns]


def places(boxes: Boxes) -> Floats:
    """(n, 4) left, top, width, height."""
    return np.column_stack([boxes.left_px, boxes.top_px, boxes.width_px, boxes.height_px])


def boxes_in_true_frames(
    tracks: Boxes, truth: TruthBoxes, views: tuple[str, ...], *, by_number: bool = False
) -> TruthAndTracks:
    """Tracks and truth of the frames that the truth has, with a box or known to have none, of a part of a recording.

    Args:
        tracks: boxes with identities; `boxes_of_ellipses` makes them of ellipses.
        truth: true boxes with identities.
        views: cameras that are compared, of which some may be missing in this part.
        by_number: frames are the same when camera and number are; otherwise when camera and time are.

    Raises:
        InputError: an object has no identity, or the same one twice in a frame.
    """
    truth = truth.take(np.isin(truth.sensor, views))
    key = "frame" if by_number else "t_ns"
    times, numbers, keys = _frames(truth, views, key)
    there, found = truth.take(truth.box >= 0), tracks.take(tracks.box >= 0)
    true_view, true_cell = _cells(there, views, keys, key)
    _check_identities("truth", there, true_view, true_cell)
    view, cell = _cells(found, views, keys, key)
    known = cell >= 0
    found, view, cell = found.take(known), view[known], cell[known]
    _check_identities("tracks", found, view, cell)
    counts = {
        "frames": sum(len(t) for t in times),
        "frames_without_tracks": sum(len(t) for t in times) - len(np.unique(view * 2**40 + cell)),
        "estimates_other_frames": int(np.count_nonzero(~known)),
        "views_without_tracks": 0,
        "estimates_compared": len(found),
    }
    return TruthAndTracks(
        views=views,
        truth=Objects(true_cell, there.target_id.astype(np.int64), places(there), true_view),
        tracks=Objects(cell, found.target_id.astype(np.int64), places(found), view),
        visible=there.visible,
        t_ns=times,
        number=numbers,
        counts={name: float(n) for name, n in counts.items()},
    )


def asked_for(boxes: Boxes, config: ManyConfig) -> Bools:
    """(n,) which rows are of the cameras and frames asked for."""
    keep = np.isin(boxes.sensor, config.cameras) if config.cameras else np.ones(len(boxes), dtype=np.bool_)
    if config.frames is not None:
        keep &= (boxes.frame >= config.frames[0]) & (boxes.frame < config.frames[1])
    return keep


def compared_views(ours: Collection[str], theirs: Collection[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Cameras of tracks and truth, and those of the truth without a track.

    Raises:
        InputError: the truth has no camera, or the tracks have others than the truth.
    """
    tracked, true = sorted(ours), sorted(theirs)
    if not true:
        raise InputError("truth: has no boxes; nothing to compare with")
    if not tracked:  # nothing was tracked at all, which is to be counted
        return tuple(true), ()
    both = tuple(name for name in true if name in ours)
    if not both:
        raise InputError(
            f"tracks: their cameras ({', '.join(tracked)}) are none of the truth ({', '.join(true)}); "
            "the names must be the same"
        )
    return both, tuple(name for name in true if name not in ours)


def _frames(truth: TruthBoxes, views: Sequence[str], key: str) -> tuple[tuple[Ints, ...], tuple[Ints, ...], list[Ints]]:
    """Times, numbers and keys of the true frames of each view, by rising key."""
    times, numbers, keys = [], [], []
    for name in views:
        rows = truth.take(truth.sensor == name)
        known, first = np.unique(getattr(rows, key), return_index=True)
        keys.append(known)
        times.append(rows.t_ns[first])
        numbers.append(rows.frame[first])
    return tuple(times), tuple(numbers), keys


def _cells(boxes: Boxes, views: Sequence[str], keys: Sequence[Ints], key: str) -> tuple[Ints, Ints]:
    """View of each row and its place among the true frames; -1 where it is in none."""
    view, cell = np.zeros(len(boxes), dtype=np.int64), np.full(len(boxes), -1, dtype=np.int64)
    values = getattr(boxes, key)
    for v, name in enumerate(views):
        rows = np.flatnonzero(boxes.sensor == name)
        if not len(keys[v]):
            view[rows] = v
            continue
        place = np.minimum(np.searchsorted(keys[v], values[rows]), len(keys[v]) - 1)
        view[rows], cell[rows] = v, np.where(keys[v][place] == values[rows], place, -1)
    return view, cell


def _check_identities(what: str, boxes: Boxes, view: Ints, cell: Ints) -> None:
    """InputError where an object has no identity, or the same one as another in the frame."""
    order = np.lexsort((boxes.target_id, cell, view))
    keys = np.column_stack([view, cell, boxes.target_id])[order]
    same = (keys[1:] == keys[:-1]).all(axis=1)
    for bad, words in ((np.flatnonzero(keys[:, 2] < 0), "a box without an identity"), (np.flatnonzero(same) + 1, "")):
        if len(bad):
            row = order[bad[0]]
            found = words or f"target {boxes.target_id[row]} twice"
            raise InputError(
                f"{what}: camera {boxes.sensor[row]}, frame {boxes.frame[row]}: {found}; "
                "each object needs an identity of its own in every frame"
            )


def joined(parts: Sequence[TruthAndTracks]) -> TruthAndTracks:
    """Parts of a recording, one or more in the order of time, as one."""
    begin = np.zeros(len(parts[0].views), dtype=np.int64)
    truth, tracks = list[Objects](), list[Objects]()
    for part in parts:
        for out, side in ((truth, part.truth), (tracks, part.tracks)):
            assert side.view is not None
            out.append(side._replace(frame=side.frame + begin[side.view]))
        begin += part.frames
    both = [Objects(*(np.concatenate(column) for column in zip(*side, strict=True))) for side in (truth, tracks)]
    times, numbers = ([getattr(part, name) for part in parts] for name in ("t_ns", "number"))
    return parts[0]._replace(
        truth=both[0],
        tracks=both[1],
        visible=np.concatenate([part.visible for part in parts]),
        t_ns=tuple(np.concatenate(view) for view in zip(*times, strict=True)),
        number=tuple(np.concatenate(view) for view in zip(*numbers, strict=True)),
    )


def view_boxes(compared: TruthAndTracks, view: int) -> tuple[TruthBoxes, Boxes]:
    """True boxes and tracks of one view, in the frames that are compared."""
    t_ns, number, name = compared.t_ns[view], compared.number[view], compared.views[view]
    return (
        TruthBoxes.of(**_columns(of_view(compared.truth, view), t_ns, number, name)),
        Boxes.of(**_columns(of_view(compared.tracks, view), t_ns, number, name)),
    )


def _columns(side: Objects, t_ns: Ints, number: Ints, name: str) -> dict[str, object]:
    order = np.lexsort((side.label, side.frame))
    frame, place, n = side.frame[order], side.place[order], len(order)
    return {
        "t_ns": t_ns[frame],
        "sensor": np.full(n, name),
        "frame": number[frame],
        "box": np.arange(n, dtype=np.int32),
        "target_id": side.label[order].astype(np.int32),
        "left_px": place[:, 0],
        "top_px": place[:, 1],
        "width_px": place[:, 2],
        "height_px": place[:, 3],
        "confidence": np.full(n, np.nan),
    }


def frame_rate(compared: TruthAndTracks, view: int) -> float:
    """Frames a second of a view, from the median of its intervals; 1 where it has a single frame."""
    steps = np.diff(compared.t_ns[view]) / np.maximum(np.diff(compared.number[view]), 1)
    return float(NS / np.median(steps)) if len(steps) and np.median(steps) > 0 else 1.0


def image_size(compared: TruthAndTracks, view: int) -> tuple[int, int]:
    """Width and height that hold the true boxes of a view; at least 1 x 1."""
    place: Floats = of_view(compared.truth, view).place
    if not len(place):
        return 1, 1
    far = np.ceil(np.max(place[:, :2] + place[:, 2:], axis=0))
    return max(int(far[0]), 1), max(int(far[1]), 1)

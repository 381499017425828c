"""Boxes of tracks and true boxes in common frames (camera and time), with each identity once per frame.

`boxes_in_true_frames` selects them, `view_boxes` returns those of a view as tables. True boxes of annotation tools have
frame numbers without times: XML (PETS, CAVIAR), VATIC's and KITTI's text. `occlog ingest --truth` reads the same files
by the same readers. Frames are those of the tracks by their numbers, so that times are needed in tables only.

Truth with classes is preprocessed as in MOTChallenge and TrackEval: tracks of a distractor (a person who is not a
pedestrian to be tracked) are dropped, as are true boxes marked 0 or of another class than pedestrian.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.metrics.errors import intersection_over_union
from occlog.core.metrics.mot.frame_pairs import EPS, Objects
from occlog.errors import InputError, UsageError, abridged, option
from occlog.io.files.texts.formats import Probe, recognise
from occlog.io.files.timing.frame_choice import FrameChoice
from occlog.io.files.timing.frame_times import FrameTimes, as_rate
from occlog.io.formats.boxes.mot_challenge import PEDESTRIAN, Marks
from occlog.io.formats.boxes.reader import BoxOptions, table_times
from occlog.io.formats.truth import FORMATS, TruthOptions, read_truth
from occlog.io.frames.streams import rate_times
from occlog.io.open import open_if_ours
from occlog.records.tables import Boxes, TruthBoxes

from .config import MultiTargetConfig
from .figures import of_view


class TruthAndTracks(NamedTuple):
    """Truth and tracks in the frames of the truth.

    Each camera is a view, numbered in the order of names; `frame` of the objects is the index among the true frames of
    its view, in the order of time.

    Attributes:
        views: names of the cameras.
        truth: true objects; positions are boxes (left, top, width, height) [px].
        tracks: estimated objects; positions are boxes.
        visible: (n,) visible share of each true object, 0 to 1; NaN: not known.
        t_ns: for each view the times of its frames [ns].
        number: for each view the numbers of its frames in the camera's stream.
        counts: numbers of compared and skipped rows by name.
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


def box_edges(boxes: Boxes) -> Floats:
    """Return left, top, width and height (n, 4) of boxes [px]."""
    return np.column_stack([boxes.left_px, boxes.top_px, boxes.width_px, boxes.height_px])


def boxes_in_true_frames(
    tracks: Boxes, truth: TruthBoxes, views: tuple[str, ...], *, by_number: bool = False
) -> TruthAndTracks:
    """Select the rows of tracks and truth in the frames that the truth has, including frames known to be empty.

    Args:
        tracks: boxes with identities; `boxes_of_ellipses` makes them of ellipses.
        truth: true boxes with identities.
        views: names of the cameras that are compared; some may be missing in these rows.
        by_number: frames are equal if camera and frame number are; otherwise if camera and time are.

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
        truth=Objects(true_cell, there.target_id.astype(np.int64), box_edges(there), true_view),
        tracks=Objects(cell, found.target_id.astype(np.int64), box_edges(found), view),
        visible=there.visible,
        t_ns=times,
        number=numbers,
        counts={name: float(n) for name, n in counts.items()},
    )


def asked_for(boxes: Boxes, config: MultiTargetConfig) -> Bools:
    """Return the mask (n,) of rows of the cameras and frames that the configuration selects."""
    keep = np.isin(boxes.sensor, config.cameras) if config.cameras else np.ones(len(boxes), dtype=np.bool_)
    if config.frames is not None:
        keep &= (boxes.frame >= config.frames[0]) & (boxes.frame < config.frames[1])
    return keep


def compared_views(ours: Collection[str], theirs: Collection[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the cameras of both tracks (`ours`) and truth (`theirs`), and those of the truth without tracks.

    All sorted. If the tracks have no camera at all, every camera of the truth is compared.

    Raises:
        InputError: the truth has no camera, or both have none in common.
    """
    tracked, true = sorted(ours), sorted(theirs)
    if not true:
        raise InputError("truth: has no boxes; nothing to compare with", id="empty-input")
    if not tracked:  # nothing was tracked at all, which is to be counted
        return tuple(true), ()
    both = tuple(name for name in true if name in ours)
    if not both:
        raise InputError(
            f"tracks: their cameras ({abridged(tracked)}) are none of the truth ({abridged(true)}); use the same "
            "names in both",
            id="disjoint-inputs",
        )
    return both, tuple(name for name in true if name not in ours)


def _frames(truth: TruthBoxes, views: Sequence[str], key: str) -> tuple[tuple[Ints, ...], tuple[Ints, ...], list[Ints]]:
    """Return times [ns], numbers and keys of the true frames of each of the cameras `views`, sorted by key.

    `key`: column that identifies a frame, `t_ns` or `frame`.
    """
    times, numbers, keys = [], [], []
    for name in views:
        rows = truth.take(truth.sensor == name)
        known, first = np.unique(getattr(rows, key), return_index=True)
        keys.append(known)
        times.append(rows.t_ns[first])
        numbers.append(rows.frame[first])
    return tuple(times), tuple(numbers), keys


def _cells(boxes: Boxes, views: Sequence[str], keys: Sequence[Ints], key: str) -> tuple[Ints, Ints]:
    """Return the index of the view (n,) of each row, and the index (n,) of its frame among the true frames.

    -1: in none.

    Args:
        boxes: n rows.
        views: names of the cameras.
        keys: sorted keys (times or numbers) of the true frames, for each view.
        key: column that identifies a frame, `t_ns` or `frame`.
    """
    view, cell = np.zeros(len(boxes), dtype=np.int64), np.full(len(boxes), -1, dtype=np.int64)
    values = getattr(boxes, key)
    for v, name in enumerate(views):
        rows = np.flatnonzero(boxes.sensor == name)
        if not len(keys[v]):
            view[rows] = v
            continue
        index = np.minimum(np.searchsorted(keys[v], values[rows]), len(keys[v]) - 1)
        view[rows], cell[rows] = v, np.where(keys[v][index] == values[rows], index, -1)
    return view, cell


def _check_identities(what: str, boxes: Boxes, view: Ints, cell: Ints) -> None:
    """Raise InputError for a row without identity, or with one that another row of its frame has.

    Args:
        what: `truth` or `tracks`, for the message.
        boxes: n rows.
        view: (n,) index of the view.
        cell: (n,) index of the frame.
    """
    order = np.lexsort((boxes.target_id, cell, view))
    keys = np.column_stack([view, cell, boxes.target_id])[order]
    same = (keys[1:] == keys[:-1]).all(axis=1)
    for bad, words in ((np.flatnonzero(keys[:, 2] < 0), "a box without an identity"), (np.flatnonzero(same) + 1, "")):
        if len(bad):
            row = order[bad[0]]
            found = words or f"target {boxes.target_id[row]} twice"
            raise InputError(
                f"{what}: camera {boxes.sensor[row]}, frame {boxes.frame[row]}: {found}; "
                "each object needs its own identity in every frame",
                id="duplicate-row",
            )


def joined(parts: Sequence[TruthAndTracks]) -> TruthAndTracks:
    """Concatenate one or more parts of a comparison, in the order of time; frames are renumbered."""
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
    """Return true boxes and tracks of the view with the index `view` as tables, in the compared frames."""
    t_ns, number, name = compared.t_ns[view], compared.number[view], compared.views[view]
    return (
        TruthBoxes.of(**_columns(of_view(compared.truth, view), t_ns, number, name)),
        Boxes.of(**_columns(of_view(compared.tracks, view), t_ns, number, name)),
    )


def _columns(side: Objects, t_ns: Ints, number: Ints, name: str) -> dict[str, object]:
    order = np.lexsort((side.label, side.frame))
    frame, position, n = side.frame[order], side.position[order], len(order)
    return {
        "t_ns": t_ns[frame],
        "sensor": np.full(n, name),
        "frame": number[frame],
        "box": np.arange(n, dtype=np.int32),
        "target_id": side.label[order].astype(np.int32),
        "left_px": position[:, 0],
        "top_px": position[:, 1],
        "width_px": position[:, 2],
        "height_px": position[:, 3],
        "confidence": np.full(n, np.nan),
    }


def frame_rate(compared: TruthAndTracks, view: int) -> float:
    """Return the frame rate [Hz] of the view with the index `view`, by the median interval; 1 for a single frame."""
    steps = np.diff(compared.t_ns[view]) / np.maximum(np.diff(compared.number[view]), 1)
    return float(NS / np.median(steps)) if len(steps) and np.median(steps) > 0 else 1.0


def image_size(compared: TruthAndTracks, view: int) -> tuple[int, int]:
    """Return width and height [px] of the smallest image from (0, 0) that holds the true boxes of a view.

    At least 1 x 1.
    """
    position: Floats = of_view(compared.truth, view).position
    if not len(position):
        return 1, 1
    far = np.ceil(np.max(position[:, :2] + position[:, 2:], axis=0))
    return max(int(far[0]), 1), max(int(far[1]), 1)


COUNTING = ("xml", "vatic", "kitti")
"""Formats of one camera's boxes by the number of the frame."""
RATE = 25.0
"""Frames a second of files that have no times."""
MAX_FRAMES = 2_000_000
"""Most frames of text; the truth has a row for each of them."""
SAME_RATE = 0.01
"""Largest relative difference of two frame rates that are the same."""


def annotation_format(path: Path) -> str | None:
    """Return the name of the annotation tool's format (`xml`, `vatic` or `kitti`) of a file; None for others."""
    if not path.is_file() or not path.stat().st_size or open_if_ours(path) is not None:
        return None
    try:
        return recognise({name: FORMATS[name] for name in COUNTING}, Probe(path, "true boxes"))
    except InputError:  # whoever reads it as another kind of file describes the fault
        return None


def read_annotation(path: Path, name: str, camera: str, config: MultiTargetConfig) -> TruthBoxes:
    """Read the true boxes of an annotation tool's file.

    Args:
        path: the file.
        name: name of its format.
        camera: camera of the boxes.
        config: frame rate, number of frame 0, and range of frames.

    Raises:
        InputError: the file is damaged or has no boxes, or its frame numbers are too large.
    """
    how = TruthOptions(
        format=name,
        camera=camera,
        cameras=(camera,),
        times={camera: frame_times(config)},
        boxes=BoxOptions(first_number=config.first_number or 0, frames=FrameChoice(config.frames)),
    )
    tables = [table for table in read_truth(path, how) if isinstance(table, TruthBoxes)]
    truth = TruthBoxes.concat(tables)
    if not len(truth):
        chosen = "" if config.frames is None else f" in frames {config.frames[0]}:{config.frames[1]}"
        raise InputError(f"{path}: has no true box{chosen}; nothing to compare with", id="empty-input")
    return truth


def frame_times(config: MultiTargetConfig) -> FrameTimes:
    """Return the times of numbered frames: by the frame rate in the settings, or by 25 Hz."""
    rate = RATE if config.fps is None else config.fps
    return rate_times(as_rate(rate), "assumed" if config.fps is None else "given")


def timed_like(truth: TruthBoxes, tracks: Boxes, camera: str, config: MultiTargetConfig, path: Path) -> TruthBoxes:
    """Return the truth with the times that its frames have in the tracks.

    Times of frames that the tracks lack are interpolated and extrapolated evenly.

    Args:
        truth: true boxes of a file with frame numbers and no times.
        tracks: a table, which has times.
        camera: camera of the rows.
        config: the frame rate, if it is given.
        path: path of the truth, for messages.

    Raises:
        UsageError: the given frame rate is not that of the tracks.
        InputError: a frame number is too large.
    """
    own = tracks.take(tracks.sensor == camera)
    frame, row = np.unique(own.frame, return_index=True)
    if len(frame) < 2 or not len(truth):
        return truth
    t_ns = own.t_ns[row]
    stop = int(truth.frame.max()) + 1
    if stop > MAX_FRAMES:
        raise InputError(
            f"{path}: frame number {stop - 1} is beyond the limit of {MAX_FRAMES}; correct it", id="input-too-large"
        )
    rate = float(NS / np.median(np.diff(t_ns) / np.diff(frame)))
    if config.fps is not None and abs(config.fps - rate) > SAME_RATE * rate:
        raise UsageError(
            f"{option('fps')} {config.fps:g}: contradicts the times of the tracks ({rate:.4g} frames a second), "
            "which are used; leave it out",
            id="not-applicable",
        )
    known = dict(zip(frame.tolist(), t_ns.tolist(), strict=True))
    return replace(truth, t_ns=table_times(known, 0, stop, f"tracks of {camera}").at(truth.frame))


def check_counted(path: Path, name: str | None, text: bool, config: MultiTargetConfig) -> None:
    """Raise UsageError for a frame rate or first frame number that the truth file does not need.

    Args:
        path: the file.
        name: its annotation format (see `annotation_format`); None: another file.
        text: whether it is MOTChallenge text.
        config: the settings given.
    """
    if config.fps is not None and name is None and not text:
        raise UsageError(
            f"{option('fps')} is for a truth that counts frames; {path} has times, leave it out", id="not-applicable"
        )
    if config.first_number is not None and name != "xml":
        raise UsageError(
            f"{option('first_number')} is for true boxes in XML; {path} has frame numbers of its own, leave it out",
            id="not-applicable",
        )


IOU_THRESHOLD = 0.5
"""Intersection over union from which a track is of a true box here, whatever it is later."""


def pedestrians(compared: TruthAndTracks, marks: Marks, distractors: tuple[int, ...]) -> TruthAndTracks:
    """Drop true boxes that do not count and tracks of distractors, as in MOTChallenge and TrackEval.

    In each frame tracks are paired one to one with all true boxes, of any class and mark, to maximise the sum of
    overlaps (IoU) of at least one half; a track paired with a distractor is dropped.

    Args:
        compared: truth and tracks of one view, with every row of the truth.
        marks: class and mark of each true box.
        distractors: class numbers of distractors.

    Raises:
        KeyError: a true box has no mark.
    """
    known = {key: n for n, key in enumerate(zip(marks.frame.tolist(), marks.target_id.tolist(), strict=True))}
    numbers = compared.number[0][compared.truth.frame].tolist()
    row = np.array([known[key] for key in zip(numbers, compared.truth.label.tolist(), strict=True)], dtype=np.int64)
    kind, counts = marks.kind[row], marks.counts[row]
    ignored = _on(compared, np.isin(kind, distractors))
    keep = counts & (kind == PEDESTRIAN)
    dropped = {"tracks_on_distractors": np.count_nonzero(ignored), "objects_ignored": np.count_nonzero(~keep)}
    return compared._replace(
        truth=_taken(compared.truth, keep),
        tracks=_taken(compared.tracks, ~ignored),
        visible=compared.visible[keep],
        counts=compared.counts | {name: float(n) for name, n in dropped.items()},
    )


def _on(compared: TruthAndTracks, distractor: Bools) -> Bools:
    """Return the mask (m,) of tracks' boxes that are paired with a true box that is in the mask `distractor` (n,).

    Pairs are one to one in each frame, by overlap.
    """
    truth, tracks = _by_frame(compared.truth), _by_frame(compared.tracks)
    out = np.zeros(len(compared.tracks.frame), dtype=np.bool_)
    for frame, ours in tracks.items():
        theirs = truth.get(frame)
        if theirs is None:
            continue
        overlap = intersection_over_union(compared.truth.position[theirs], compared.tracks.position[ours])
        overlap[overlap < IOU_THRESHOLD - EPS] = 0.0
        i, j = linear_sum_assignment(overlap, maximize=True)
        met = overlap[i, j] > EPS
        out[ours[j[met]]] = distractor[theirs[i[met]]]
    return out


def _by_frame(side: Objects) -> dict[int, Ints]:
    """Return the indices of the rows of each frame, by its number, sorted by identity."""
    order = np.lexsort((side.label, side.frame))
    frames, first = np.unique(side.frame[order], return_index=True)
    return dict(zip(frames.tolist(), np.split(order, first)[1:], strict=True))


def _taken(side: Objects, keep: Bools) -> Objects:
    view = None if side.view is None else side.view[keep]
    return Objects(side.frame[keep], side.label[keep], side.position[keep], view)

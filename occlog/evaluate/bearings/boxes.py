"""Views (clusters or detector boxes) against true boxes: recall, precision, horizontal error.

True boxes are put into three classes: `clear`, people that share next to nothing with
another box; `front`, in front of others; `hidden`, partly behind others.  Of two boxes
the one that reaches further down in the image is the nearer, as people stand on the ground.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import box_overlap, intersection_areas, pair_within, ratio
from occlog.core.metrics.sums import Sum
from occlog.errors import InputError
from occlog.evaluate.errors.sums import quantiles_of
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.io.files.put_aside.spool import IN_MEMORY, Spool
from occlog.records.tables import TruthBoxes, Views

Metrics = dict[str, float]

CLEAR, FRONT, HIDDEN = 0, 1, 2
CLASSES = ("clear", "front", "hidden")
SHARED = 0.1
"""Share of a box's area that another must cover before the box counts as overlapped or hidden."""


class FrameResult(NamedTuple):
    """One frame: each true box with its class and the horizontal error of its view (NaN: not found)."""

    kind: Ints  # (n,)
    error_px: Floats  # (n,) view minus truth, to the right
    found: Bools  # (n,)
    views: int


def box_classes(boxes: Floats) -> Ints:
    """(n,) class of each of the (n, 4) true boxes (left, top, width, height) of one frame."""
    area = np.prod(boxes[:, 2:], axis=1)
    cover = intersection_areas(boxes, boxes) / area[:, None]  # [i, j]: share of i that j covers
    np.fill_diagonal(cover, 0.0)
    bottom = boxes[:, 1] + boxes[:, 3]
    nearer = bottom[None, :] > bottom[:, None]
    hidden = np.max(np.where(nearer, cover, 0.0), axis=1, initial=0.0) > SHARED
    touched = np.max(cover, axis=1, initial=0.0) > SHARED
    return np.asarray(np.where(hidden, HIDDEN, np.where(touched, FRONT, CLEAR)), dtype=np.int64)


def match_frame(views: Views, truth: TruthBoxes, min_overlap: float) -> FrameResult:
    """Views of one frame paired with its true boxes: as many pairs of enough overlap as there are."""
    real = truth.take(truth.box >= 0)
    boxes = _boxes(real)
    pairs = pair_within(1.0 - box_overlap(_boxes(views), boxes), 1.0 - min_overlap)
    error = np.full(len(real), np.nan)
    for i, j in pairs:
        error[j] = views.x_px[i] - (boxes[j, 0] + 0.5 * boxes[j, 2])
    return FrameResult(box_classes(boxes), error, np.isfinite(error), len(views))


def _boxes(table: Views | TruthBoxes) -> Floats:
    return np.column_stack([table.left_px, table.top_px, table.width_px, table.height_px])


def _frames(table: Views | TruthBoxes) -> Iterator[tuple[tuple[str, int], Ints]]:
    """Sensor and time of every frame with its rows."""
    order = np.lexsort((table.t_ns, table.sensor))
    t_ns, sensor = table.t_ns[order], table.sensor[order]
    change = (t_ns[1:] != t_ns[:-1]) | (sensor[1:] != sensor[:-1])
    for rows in np.split(order, np.flatnonzero(change) + 1):
        if not len(rows):
            continue
        yield (str(table.sensor[rows[0]]), int(table.t_ns[rows[0]])), rows


class ViewFigures:
    """Recall, precision and errors of views, of the frames that have true boxes or are known to have none.

    Frames are the same when sensor and time are.
    """

    def __init__(self, config: EvaluateConfig, in_memory: int = IN_MEMORY // 8) -> None:
        """No frame yet; `in_memory`: how many errors of a kind are kept in memory."""
        self._overlap, self._in_memory = config.box_overlap, in_memory
        self._whole = _Results(in_memory)
        self._classes = [_Results(in_memory) for _ in CLASSES]
        self._sensors: dict[str, _Results] = {}
        self._used = self._shared = self._views = 0
        self._first_view: tuple[str, int] | None = None
        self._first_box: tuple[str, int] | None = None

    def update(self, views: Views, truth: TruthBoxes) -> None:
        """Views and true boxes of some more times."""
        self._first_view = self._first_view or _first(views)
        self._first_box = self._first_box or _first(truth)
        by_frame = dict(_frames(views))
        self._views += len(views)
        for (sensor, t), rows in _frames(truth):
            mine = by_frame.get((sensor, t), np.zeros(0, dtype=np.int64))
            self._shared += (sensor, t) in by_frame
            self._used += len(mine)
            result = match_frame(views.take(mine), truth.take(rows), self._overlap)
            self._whole.update(result, result.found)
            for number, own in enumerate(self._classes):
                own.update(result, result.found & (result.kind == number), int(np.count_nonzero(result.kind == number)))
            self._sensors.setdefault(sensor, _Results(self._in_memory)).update(result, result.found)

    def result(self) -> Metrics:
        """Figures over all sensors from sums, then for each class, then for each sensor.

        Raises:
            InputError: no frame is in both tables.
        """
        view, box = self._first_view, self._first_box
        if view is not None and box is not None and not self._shared:
            raise InputError(
                f"views: no frame of theirs (first: {view[0]} at {view[1]} ns) is among the true boxes "
                f"(first: {box[0]} at {box[1]} ns); times and sensor names must be the same"
            )
        out = self._whole.figures("") | {"views_without_truth": self._views - self._used}
        for own, name in zip(self._classes, CLASSES, strict=True):
            out |= own.figures_of_class(name)
        if len(self._sensors) > 1:
            for sensor, own in sorted(self._sensors.items()):
                out |= own.figures(f"_sensor_{sensor}")
        return out


def _first(table: Views | TruthBoxes) -> tuple[str, int] | None:
    """Sensor and time of the first row; None without rows."""
    return (str(table.sensor[0]), int(table.t_ns[0])) if len(table) else None


class _Results:
    """Counts and errors of some frames."""

    def __init__(self, in_memory: int) -> None:
        self._frames = self._boxes = self._found = 0
        self._views = 0
        self._sum, self._squares, self._sizes = Sum(), Sum(), Spool(in_memory)

    def update(self, result: FrameResult, found: Bools, boxes: int | None = None) -> None:
        """A frame, and which of its true boxes count as found; `boxes`: how many count, if not all."""
        errors = result.error_px[found]
        self._frames, self._views = self._frames + 1, self._views + result.views
        self._boxes += len(result.kind) if boxes is None else boxes
        self._found += len(errors)
        self._sum.add(float(errors.sum()))
        self._squares.add(float(np.square(errors).sum()))
        self._sizes.add(np.abs(errors))

    def figures(self, whose: str) -> Metrics:
        return {
            f"views_frames{whose}": self._frames,
            f"views_true_boxes{whose}": self._boxes,
            f"views_matched{whose}": self._found,
            f"views_false{whose}": self._views - self._found,
            f"views_recall{whose}": ratio(self._found, self._boxes),
            f"views_precision{whose}": ratio(self._found, self._views),
            **self._errors(whose),
        }

    def figures_of_class(self, name: str) -> Metrics:
        return {
            f"views_true_boxes_{name}": self._boxes,
            f"views_recall_{name}": ratio(self._found, self._boxes),
            **self._errors(f"_{name}"),
        }

    def _errors(self, whose: str) -> Metrics:
        return {
            f"views_error_rms{whose}_px": math.sqrt(ratio(self._squares.value, self._found)),
            f"views_error_median{whose}_px": quantiles_of(self._sizes, (0.5,))[0],
            f"views_error_bias{whose}_px": ratio(self._sum.value, self._found),
        }

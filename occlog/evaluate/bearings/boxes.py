"""Views (clusters or detector boxes) against true boxes: recall, precision, horizontal error.

True boxes are put into three classes: `clear`, people that share next to nothing with
another box; `front`, in front of others; `hidden`, partly behind others.  Of two boxes
the one that reaches further down in the image is the nearer, as people stand on the ground.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import box_overlap, intersection_areas, pair_within, quantile, ratio, root_mean_square
from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
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


def match_views(views: Views, truth: TruthBoxes, config: EvaluateConfig) -> tuple[dict[str, list[FrameResult]], int]:
    """Results of every frame that has true boxes (or is known to have none), by sensor, and views in other frames.

    Frames are the same when sensor and time are.  InputError if no frame is in both tables.
    """
    found: dict[str, list[FrameResult]] = {}
    used = shared = 0
    by_frame = dict(_frames(views))
    for (sensor, t), rows in _frames(truth):
        mine = by_frame.get((sensor, t), np.zeros(0, dtype=np.int64))
        shared += (sensor, t) in by_frame
        used += len(mine)
        result = match_frame(views.take(mine), truth.take(rows), config.box_overlap)
        found.setdefault(sensor, []).append(result)
    if len(views) and len(truth) and not shared:
        raise InputError(
            f"views: no frame of theirs (first: {views.sensor[0]} at {views.t_ns[0]} ns) is among the true boxes "
            f"(first: {truth.sensor[0]} at {truth.t_ns[0]} ns); times and sensor names must be the same"
        )
    return found, len(views) - used


def _frames(table: Views | TruthBoxes) -> Iterator[tuple[tuple[str, int], Ints]]:
    """Sensor and time of every frame with its rows."""
    order = np.lexsort((table.t_ns, table.sensor))
    t_ns, sensor = table.t_ns[order], table.sensor[order]
    change = (t_ns[1:] != t_ns[:-1]) | (sensor[1:] != sensor[:-1])
    for rows in np.split(order, np.flatnonzero(change) + 1):
        if not len(rows):
            continue
        yield (str(table.sensor[rows[0]]), int(table.t_ns[rows[0]])), rows


def view_metrics(views: Views, truth: TruthBoxes, config: EvaluateConfig) -> Metrics:
    """Figures over all sensors from sums, then for each class, then for each sensor."""
    found, elsewhere = match_views(views, truth, config)
    everything = [r for results in found.values() for r in results]
    out = _figures(everything, "") | {"views_without_truth": elsewhere}
    for number, name in enumerate(CLASSES):
        out |= _class_figures(everything, number, name)
    if len(found) > 1:
        for sensor, results in found.items():
            out |= _figures(results, f"_sensor_{sensor}")
    return out


def _figures(results: list[FrameResult], whose: str) -> Metrics:
    matched = sum(int(np.count_nonzero(r.found)) for r in results)
    boxes, views = sum(len(r.kind) for r in results), sum(r.views for r in results)
    return {
        f"views_frames{whose}": len(results),
        f"views_true_boxes{whose}": boxes,
        f"views_matched{whose}": matched,
        f"views_false{whose}": views - matched,
        f"views_recall{whose}": ratio(matched, boxes),
        f"views_precision{whose}": ratio(matched, views),
        **_errors(np.concatenate([np.zeros(0), *(r.error_px[r.found] for r in results)]), whose),
    }


def _class_figures(results: list[FrameResult], number: int, name: str) -> Metrics:
    boxes = sum(int(np.count_nonzero(r.kind == number)) for r in results)
    errors = np.concatenate([np.zeros(0), *(r.error_px[r.found & (r.kind == number)] for r in results)])
    return {
        f"views_true_boxes_{name}": boxes,
        f"views_recall_{name}": ratio(len(errors), boxes),
        **_errors(errors, f"_{name}"),
    }


def _errors(errors: Floats, whose: str) -> Metrics:
    return {
        f"views_error_rms{whose}_px": root_mean_square(errors),
        f"views_error_median{whose}_px": quantile(np.abs(errors), 0.5),
        f"views_error_bias{whose}_px": ratio(float(errors.sum()), len(errors)),
    }

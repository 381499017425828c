"""Recall, precision and horizontal error of views on hand-made frames."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from evaluate_scenes import scene, seconds

from occlog.errors import InputError
from occlog.evaluate.bearings.detections import CLEAR, FRONT, HIDDEN, box_classes
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.records.tables import APPEARANCE_BINS, TruthBoxes, Views

Box = tuple[float, float, float, float]


def views(t: list[float], boxes: list[Box], sensor: str = "cam") -> Views:
    n, b = len(t), np.array(boxes, dtype=np.float64).reshape(-1, 4)
    nan: dict[str, Any] = {
        name: np.full(n, np.nan) for name in ("bearing", "sigma", "u_px", "sigma_px", "confidence", "similarity")
    }
    return Views.of(
        t_ns=seconds(t),
        sensor=np.full(n, sensor),
        frame=np.zeros(n, dtype=np.int64),
        cluster=np.arange(n, dtype=np.int32),
        x_px=b[:, 0] + b[:, 2] / 2,
        y_px=b[:, 1] + b[:, 3] / 2,
        cov_xx_px=np.ones(n),
        cov_xy_px=np.zeros(n),
        cov_yy_px=np.ones(n),
        left_px=b[:, 0],
        top_px=b[:, 1],
        width_px=b[:, 2],
        height_px=b[:, 3],
        area_px=b[:, 2] * b[:, 3],
        target_id=np.full(n, -1, dtype=np.int32),
        appearance=np.full((n, APPEARANCE_BINS), np.nan, dtype=np.float32),
        **nan,
    )


def true_boxes(t: list[float], boxes: list[Box | None], sensor: str = "cam") -> TruthBoxes:
    n = len(t)
    b = np.array([x if x is not None else (np.nan,) * 4 for x in boxes], dtype=np.float64).reshape(-1, 4)
    return TruthBoxes.of(
        t_ns=seconds(t),
        sensor=np.full(n, sensor),
        frame=np.zeros(n, dtype=np.int64),
        box=np.where(np.isnan(b[:, 0]), -1, np.arange(n)).astype(np.int32),
        target_id=np.arange(n, dtype=np.int32),
        left_px=b[:, 0],
        top_px=b[:, 1],
        width_px=b[:, 2],
        height_px=b[:, 3],
        confidence=np.full(n, np.nan),
    )


def figures(found: Views, truth: TruthBoxes, **options) -> dict[str, float]:
    config = EvaluateConfig(**options)
    return evaluate(None, None, None, scene(), config, views=found, truth_boxes=truth).metrics


def test_frames_by_hand() -> None:
    # 0 s: both found, one 2 px off; 1 s: found with too little overlap; 2 s: no one, one false view; 3 s: missed
    truth = true_boxes(
        [0, 0, 1, 2, 3],
        [(0, 0, 20, 50), (100, 0, 20, 50), (0, 0, 20, 50), None, (0, 0, 20, 50)],
    )
    found = views([0, 0, 1, 2], [(2, 0, 20, 50), (100, 0, 20, 50), (12, 0, 20, 50), (50, 0, 20, 50)])
    m = figures(found, truth)
    assert (m["views_frames"], m["views_true_boxes"], m["views_matched"], m["views_false"]) == (4, 4, 2, 2)
    assert m["views_recall"] == 2 / 4
    assert m["views_precision"] == 2 / 4
    assert m["views_error_rms_px"] == pytest.approx(math.sqrt((4 + 0) / 2))
    assert m["views_error_bias_px"] == 1.0
    assert m["views_recall_clear"] == 2 / 4
    assert m["views_true_boxes_hidden"] == 0
    assert math.isnan(m["views_recall_hidden"])


def test_overlap_that_counts_can_be_set() -> None:
    truth, found = true_boxes([0], [(0, 0, 20, 50)]), views([0], [(12, 0, 20, 50)])  # 8 of 32 px: 1/4
    assert figures(found, truth)["views_recall"] == 0.0
    assert figures(found, truth, iou_threshold=0.25)["views_recall"] == 1.0


def test_views_of_frames_without_truth_are_left_out_and_counted() -> None:
    m = figures(views([0, 5, 6], [(0, 0, 20, 50)] * 3), true_boxes([0], [(0, 0, 20, 50)]))
    assert (m["views_precision"], m["views_without_truth"]) == (1.0, 2)


def test_classes_by_depth() -> None:
    # two side by side; one in front of another that it half hides; one barely touched
    boxes = np.array(
        [[0, 0, 20, 50], [30, 0, 20, 50], [100, 0, 20, 50], [110, 5, 20, 60], [200, 0, 20, 50], [219, 5, 20, 50]],
        dtype=float,
    )
    assert box_classes(boxes).tolist() == [CLEAR, CLEAR, HIDDEN, FRONT, CLEAR, CLEAR]
    assert box_classes(boxes[:0]).tolist() == []


def test_figures_of_the_classes() -> None:
    truth = true_boxes([0, 0], [(100, 0, 20, 50), (110, 5, 20, 60)])
    m = figures(views([0], [(111, 5, 20, 60)]), truth)
    assert (m["views_recall_front"], m["views_recall_hidden"]) == (1.0, 0.0)
    assert m["views_error_rms_front_px"] == 1.0
    assert m["views_true_boxes_clear"] == 0


def test_sensors_add_up_from_counts() -> None:
    truth = TruthBoxes.merge([true_boxes([0, 1, 2], [(0, 0, 20, 50)] * 3, "a"), true_boxes([0], [(0, 0, 20, 50)], "b")])
    found = Views.merge([views([0, 1, 2], [(0, 0, 20, 50)] * 3, "a"), views([0], [(90, 0, 20, 50)], "b")])
    m = figures(found, truth)
    assert (m["views_recall_sensor_a"], m["views_recall_sensor_b"], m["views_recall"]) == (1.0, 0.0, 3 / 4)


def test_no_views_at_all() -> None:
    m = figures(views([], []), true_boxes([0, 1], [(0, 0, 20, 50), None]))
    assert m["views_recall"] == 0.0
    assert math.isnan(m["views_precision"])


def test_tables_of_different_recordings() -> None:
    with pytest.raises(InputError, match=r"no frame of theirs .*cam at .* has true boxes"):
        figures(views([0], [(0, 0, 20, 50)]), true_boxes([7], [(0, 0, 20, 50)]))

"""Targets of the identities of boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from detect_scenes import scene

from occlog.errors import InputError
from occlog.measure.detect.config import CAMERA, GLOBAL, DetectConfig
from occlog.measure.detect.from_boxes import detect_boxes, scan_labels
from occlog.records.tables import Bearings, Boxes

NAN = float("nan")


def table(*rows: tuple[int, str, int, int, float]) -> Boxes:
    """Rows of time, camera, box (-1: none in the frame), identity, confidence."""
    t_ns, sensor, box, identity, confidence = zip(*rows, strict=True)
    there = np.array(box) >= 0
    place = {"left_px": 40.0, "top_px": 30.0, "width_px": 10.0, "height_px": 30.0}
    return Boxes.of(
        t_ns=t_ns,
        sensor=sensor,
        frame=t_ns,
        box=np.array(box, dtype=np.int32),
        target_id=np.array(identity, dtype=np.int32),
        confidence=np.array(confidence),
        **{name: np.where(there, value, NAN) for name, value in place.items()},
    )


BOXES = table(
    (0, "a", 0, 7, 0.9),
    (0, "a", 1, -1, 0.9),
    (0, "b", -1, -1, NAN),
    (1, "a", -1, -1, NAN),
    (1, "b", 0, 3, 0.9),
    (2, "a", 0, 7, 0.1),
    (2, "b", 0, 7, NAN),
    (3, "a", -1, -1, NAN),
)
EARLY = (BOXES.take(BOXES.t_ns < 1), BOXES.take(BOXES.t_ns == 1), BOXES.take(BOXES.t_ns > 1))


def labelled(scope: str) -> list[tuple[int, str, int, bool]]:
    """Time, sensor, target and seen of the bearings, chunk by chunk."""
    config = DetectConfig()
    labels = scan_labels(EARLY, scope, config)
    rows = Bearings.concat(part.bearings for part in detect_boxes(EARLY, scene(), config, labels))
    return list(zip(rows.t_ns.tolist(), rows.sensor.tolist(), rows.target_id.tolist(), rows.seen.tolist(), strict=True))


def test_global_identities_are_one_target_in_all_cameras_from_its_first_box_to_its_last() -> None:
    rows = labelled(GLOBAL)
    assert [r for r in rows if r[2] == 7] == [
        (0, "a", 7, True),
        (0, "b", 7, False),
        (1, "a", 7, False),
        (1, "b", 7, False),
        (2, "a", 7, False),  # its box there has too little confidence
        (2, "b", 7, True),
    ]
    assert [r for r in rows if r[2] == 3] == [(1, "a", 3, False), (1, "b", 3, True)]
    assert (0, "a", -1, True) in rows


def test_identities_of_a_camera_are_targets_of_its_own_numbered_again() -> None:
    rows = [row for row in labelled(CAMERA) if row[2] >= 0]
    assert rows == [(0, "a", 0, True), (1, "b", 1, True), (2, "b", 2, True)]


def test_views_have_the_identity_as_a_hint_with_labels_or_without() -> None:
    config = DetectConfig()
    (plain,) = detect_boxes([BOXES], scene(), config)
    assert sorted(plain.views.tracklet_id.tolist()) == [-1, 3, 7, 7]
    assert (plain.views.target_id == -1).all()
    (reported,) = detect_boxes([BOXES], scene(), config, scan_labels([BOXES], GLOBAL, config))
    assert (reported.views.target_id == reported.views.tracklet_id).all()


def test_two_boxes_of_one_identity_in_a_frame_are_refused() -> None:
    twice = replace(BOXES, target_id=np.where(np.arange(len(BOXES)) < 2, np.int32(7), BOXES.target_id))
    with pytest.raises(InputError, match="camera a: frame 0: two boxes have the identity 7"):
        scan_labels([twice], GLOBAL, DetectConfig())


def test_boxes_without_any_identity_are_refused() -> None:
    empty = replace(BOXES, target_id=np.full(len(BOXES), -1, dtype=np.int32))
    with pytest.raises(InputError, match="no box has an identity"):
        scan_labels([empty], CAMERA, DetectConfig())

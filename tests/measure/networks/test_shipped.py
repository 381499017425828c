"""The network that is installed with occlog: its file, its licences, and its numbers against those of 32 bits."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.core.metrics.errors import intersection_over_union
from occlog.io.files.provenance import hash_file
from occlog.measure.networks.config import NetworkConfig
from occlog.measure.networks.detector import Boxed, open_detector
from occlog.measure.networks.shipped import MIN_CONFIDENCE, NMS_IOU, shipped_config, shipped_network

ROOT = Path(__file__).parents[3]


def test_its_licences_and_its_source_are_next_to_it() -> None:
    folder = shipped_network().parent
    assert "Copyright 2020-2021 RangiLyu" in (folder / "LICENSE.nanodet").read_text()
    assert "Apache License" in (folder / "LICENSE.nanodet").read_text()
    assert (folder / "LICENSE.human-models").read_text().startswith("MIT License\n\nCopyright (c) 2021 Vladimir Mandic")
    (stated,) = re.findall(r"`([0-9a-f]{64})`", (folder / "README.md").read_text())
    assert hash_file(shipped_network()) == stated
    assert shipped_network().stat().st_size < 8e6


def test_given_settings_replace_its_own() -> None:
    assert shipped_config({}).nms_iou == NMS_IOU == 0.5
    assert shipped_config({"nms_iou": 0.6}).nms_iou == 0.6
    assert NetworkConfig().nms_iou == 0.7


def frames(video: Path, every: int, count: int) -> list[np.ndarray]:
    film, out = cv2.VideoCapture(str(video)), []
    while len(out) < count:
        ok, image = film.read()
        assert ok
        out.append(image)
        for _ in range(every - 1):
            film.grab()
    return out


def found(network: Path, images: list[np.ndarray], runtime: str, tiles: str | None = None) -> list[Boxed]:
    config = shipped_config({"runtime": runtime, "tiles": tiles})
    detector = open_detector(network, config, (), None, MIN_CONFIDENCE, 2)
    assert detector.names.names[int(detector.wanted[0])] == "person"
    boxed = detector.find([detector.prepare(image) for image in images])
    return [each for each in boxed if each is not None]


@pytest.mark.statistics
@pytest.mark.parametrize("runtime", ["opencv", "onnxruntime"])
def test_weights_of_16_bits_give_the_boxes_of_those_of_32(shared_data: Path, runtime: str) -> None:
    if runtime != "opencv" and not importlib.util.find_spec(runtime):
        pytest.skip(f"{runtime} is not installed")
    images = frames(shared_data / "pets2009_s2l1_view1" / "vtest.avi", 100, 4)
    whole = found(shared_data / "networks" / "nanodet_yolo.onnx", images, runtime)
    halves = found(shipped_network(), images, runtime)
    assert sum(len(each.boxes) for each in whole) >= 16
    for one, other in zip(whole, halves, strict=True):
        assert_allclose(other.score, one.score, atol=1e-6)
        one_sides, other_sides = (np.column_stack([b[:, :2], b[:, 2:] - b[:, :2]]) for b in (one.boxes, other.boxes))
        overlap = np.diag(intersection_over_union(one_sides, other_sides))
        assert (overlap > 1.0 - 1e-6).all()


def test_a_man_on_real_video_is_found_once() -> None:
    images = frames(ROOT / "sample_data" / "pose2sim" / "cam03.mp4", 40, 2)
    for each in found(shipped_network(), images, "opencv"):
        left, top, right, bottom = each.boxes[int(np.argmax(each.score))]
        assert 1.5 < (bottom - top) / (right - left) < 5.0
        assert bottom - top > 0.3 * images[0].shape[0]

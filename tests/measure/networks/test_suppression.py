from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from occlog.measure.networks.detector import suppress

RNG = np.random.default_rng(1)


def boxes(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    corner, side = RNG.uniform(0, 60, (n, 2)), RNG.uniform(5, 40, (n, 2))
    return np.concatenate([corner, corner + side], axis=1), RNG.permutation(n) / n, RNG.integers(0, 3, n)


def share(a: np.ndarray, b: np.ndarray) -> float:
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    both = width * height
    return both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both)


@pytest.mark.parametrize("overlap", [0.0, 0.3, 0.7, 1.0])
def test_the_boxes_that_stay_are_those_of_the_textbook(overlap: float) -> None:
    box, score, label = boxes(80)
    kept: list[int] = []
    for i in sorted(range(80), key=lambda i: -score[i]):
        if all(label[i] != label[j] or share(box[i], box[j]) <= overlap for j in kept):
            kept.append(i)
    assert_array_equal(suppress(box, score, label, overlap), kept)


@pytest.mark.parametrize("overlap", [0.2, 0.5, 0.7])
def test_the_boxes_that_stay_are_those_of_opencv(overlap: float) -> None:
    for _ in range(10):
        box, score, _ = boxes(60)
        rows = np.concatenate([box[:, :2], box[:, 2:] - box[:, :2]], axis=1)
        wanted = np.asarray(cv2.dnn.NMSBoxes(rows.tolist(), score.tolist(), 0.0, overlap)).ravel()
        # OpenCV leaves out a score of 0, which is the last one.
        found = [i for i in suppress(box, score, np.zeros(60, np.int64), overlap).tolist() if score[i] > 0]
        assert found == wanted.tolist()


def test_an_overlap_of_the_limit_itself_stays() -> None:
    box = np.array([[0.0, 0.0, 2.0, 1.0], [1.0, 0.0, 3.0, 1.0]])  # share 1 / 3
    for overlap, kept in ((1 / 3, 2), (np.nextafter(1 / 3, 0), 1)):
        assert len(suppress(box, np.array([0.9, 0.8]), np.zeros(2, np.int64), overlap)) == kept


def test_equal_scores_keep_the_first_and_nothing_gives_nothing() -> None:
    box = np.array([[0.0, 0.0, 2.0, 2.0]] * 3)
    assert suppress(box, np.full(3, 0.5), np.array([0, 0, 1]), 0.5).tolist() == [0, 2]
    assert suppress(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64), 0.5).shape == (0,)

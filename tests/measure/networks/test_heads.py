from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.errors import InputError
from occlog.measure.networks.config import DETR, END2END, RFDETR, RTDETR, RTMDET, ULTRALYTICS_DETR, YOLO, YOLOV5
from occlog.measure.networks.heads import HEADS, NetworkDetections, read, recognise

SIZE = (96, 64)
PLACES = 12 * 8 + 6 * 4 + 3 * 2  # of strides 8, 16 and 32
CLASSES = 4
RNG = np.random.default_rng(2)


def places(n: int, share: bool) -> np.ndarray:
    """Centre and size."""
    scale = (1.0, 1.0) if share else SIZE
    return np.concatenate([RNG.uniform(0.2, 0.8, (n, 2)) * scale, RNG.uniform(0.05, 0.3, (n, 2)) * scale], axis=1)


def edges(box: np.ndarray) -> np.ndarray:
    x, y, w, h = box
    return np.array([x - w / 2, y - h / 2, x + w / 2, y + h / 2])


def outputs(head: str) -> dict[str, np.ndarray]:
    """Outputs of a head for two images, with scores of all kinds."""
    n = 3 * PLACES if head == YOLOV5 else PLACES if head == YOLO else 20
    box = np.stack([places(n, share=head in (RFDETR, DETR, ULTRALYTICS_DETR)) for _ in range(2)])
    score = RNG.uniform(0, 1, (2, n, CLASSES)) ** 4
    label = RNG.integers(0, CLASSES, (2, n))
    corners = np.array([[edges(b) for b in image] for image in box])
    logits = np.log(score / (1 - score))
    found = {
        YOLOV5: {"output0": np.concatenate([box, RNG.uniform(0, 1, (2, n, 1)), score], axis=2)},
        YOLO: {"output0": np.concatenate([box, score], axis=2).transpose(0, 2, 1)},
        END2END: {"output0": np.concatenate([corners, score[:, :, :1], label[:, :, None]], axis=2)},
        RFDETR: {"dets": box, "labels": logits},
        DETR: {"logits": logits, "pred_boxes": box},
        ULTRALYTICS_DETR: {"output0": np.concatenate([box, score], axis=2)},
        RTDETR: {"labels": label, "boxes": corners, "scores": score[:, :, 0]},
        RTMDET: {"dets": np.concatenate([corners, score[:, :, :1]], axis=2), "labels": label},
    }[head]
    return {name: values.astype(np.float32) for name, values in found.items()}


def slowly(head: str, out: dict[str, np.ndarray], n: int, wanted: list[int], least: float) -> list[tuple[float, ...]]:
    """Boxes one by one, as the head's makers describe them."""
    rows = []
    if head in (RFDETR, DETR):
        logits, boxes = (out["labels"], out["dets"]) if head == RFDETR else (out["logits"], out["pred_boxes"])
        flat = sorted(
            ((1 / (1 + np.exp(-np.float64(v))), q, c) for q, row in enumerate(logits[n]) for c, v in enumerate(row)),
            reverse=True,
        )
        for score, q, c in flat[: len(boxes[n])]:
            if c in wanted and score >= least:
                rows.append((*edges(boxes[n][q] * [*SIZE, *SIZE]), score, c))
        return sorted(rows)
    if head in (RTDETR, RTMDET):
        name = "boxes" if head == RTDETR else "dets"
        score = out["scores"] if head == RTDETR else out["dets"][:, :, 4]
        for k, c in enumerate(out["labels"][n].tolist()):
            if c in wanted and score[n][k] >= least:
                rows.append((*out[name][n][k][:4], score[n][k], int(c)))
        return sorted(rows)
    for row in out["output0"][n].T if head == YOLO else out["output0"][n]:
        if head == END2END:
            box, score, c = row[:4], row[4], int(row[5])
        else:
            many = row[5:] * row[4] if head == YOLOV5 else row[4:]
            box, c = edges(row[:4] * ([*SIZE, *SIZE] if head == ULTRALYTICS_DETR else [1] * 4)), int(np.argmax(many))
            score = many[c]
        if c in wanted and score >= least:
            rows.append((*box, score, c))
    return sorted(rows)


def found_rows(found: NetworkDetections) -> list[tuple[float, ...]]:
    return sorted((*box, s, c) for box, s, c in zip(*(v.tolist() for v in found), strict=True))


NAMED = (RFDETR, DETR, RTDETR, RTMDET)


@pytest.mark.parametrize("head", HEADS)
def test_a_head_is_recognised_and_read_as_its_makers_do(head: str) -> None:
    out = outputs(head)
    reading = recognise(out, SIZE, None if head in NAMED else CLASSES, None, {})
    assert reading.head == head
    for n, wanted, least in ((0, [0], 0.3), (1, [1, 3], 0.1), (1, [2], 0.01), (0, [0, 1, 2, 3], 0.0)):
        found = read(reading, out, n, SIZE, np.array(wanted), least)
        assert_allclose(found_rows(found), slowly(head, out, n, wanted, least), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("head", [YOLO, YOLOV5])
def test_yolo_is_reported_by_the_number_of_places_where_it_looks_without_names(head: str) -> None:
    reading = recognise(outputs(head), SIZE, None, None, {})
    assert (reading.head, reading.classes) == (head, CLASSES)


def test_a_score_of_the_limit_itself_counts() -> None:
    out = {"output0": np.array([[[0, 0, 10, 10, 0.5, 0], [0, 0, 20, 10, 0.49, 0]]], np.float32)}
    reading = recognise(out, SIZE, None, None, {})
    assert read(reading, out, 0, SIZE, np.array([0]), 0.5).score.tolist() == [0.5]


def test_masks_and_key_points_after_the_classes_are_left_alone() -> None:
    out = outputs(YOLO)
    longer = {"output0": np.concatenate([out["output0"], np.full((2, 32, PLACES), 9.0, np.float32)], axis=1)}
    longer["output1"] = np.zeros((2, 32, 16, 24), np.float32)
    reading = recognise(longer, SIZE, CLASSES, None, {"task": "segment"})
    wanted = np.arange(CLASSES)
    first = recognise(out, SIZE, CLASSES, None, {})
    assert found_rows(read(reading, longer, 0, SIZE, wanted, 0.3)) == found_rows(read(first, out, 0, SIZE, wanted, 0.3))
    with pytest.raises(InputError, match="no head that is known"):
        recognise(longer, SIZE, None, None, {})


@pytest.mark.parametrize(
    ("shape", "names", "fault"),
    [
        ((1, 300, 84), None, "are of no head that is known: output0 1 x 300 x 84"),
        ((1, 300, 6), 2, "may be of end2end, ultralytics-detr"),
        ((1, 1000), None, "no head that is known"),
        ((1, 4 + 7, PLACES), 9, r"no head that is known.*names 9 classes"),
    ],
)
def test_outputs_that_are_of_no_head_or_of_several_are_refused(
    shape: tuple[int, ...], names: int | None, fault: str
) -> None:
    with pytest.raises(InputError, match=fault):
        recognise({"output0": np.zeros(shape, np.float32)}, SIZE, names, None, {})


def test_a_head_that_is_reported_is_taken_where_it_fits_and_else_refused() -> None:
    out = {"output0": np.zeros((1, 300, 6), np.float32)}
    assert recognise(out, SIZE, 2, ULTRALYTICS_DETR, {}).classes == 2
    assert recognise(out, SIZE, 2, None, {"end2end": "True"}).head == END2END
    with pytest.raises(InputError, match="not those of head rtmdet: output0 1 x 300 x 6"):
        recognise(out, SIZE, 2, RTMDET, {})


def test_one_class_is_distinguished_by_the_number_of_boxes() -> None:
    for n, head in ((3 * PLACES, YOLOV5), (300, END2END)):
        assert recognise({"o": np.zeros((1, n, 6), np.float32)}, SIZE, 1, None, {}).head == head


def test_networks_for_something_else_are_refused() -> None:
    with pytest.raises(InputError, match="the network is for 'obb', not for detection"):
        recognise(outputs(YOLO), SIZE, CLASSES, None, {"task": "obb"})
    detr = {"logits": np.zeros((1, 100, 92), np.float32), "pred_boxes": np.zeros((1, 100, 4), np.float32)}
    with pytest.raises(InputError, match="softmax"):
        recognise(detr, SIZE, None, None, {})


def test_numbers_that_no_such_head_gives_are_refused() -> None:
    out = outputs(YOLO)
    reading = recognise(out, SIZE, CLASSES, None, {})
    raw = {"output0": out["output0"] * np.array([1.0] * 4 + [9.0] * CLASSES, np.float32)[:, None]}
    with pytest.raises(InputError, match="no confidences"):
        read(reading, raw, 0, SIZE, np.array([0]), 0.3)
    small = {"output0": out["output0"] / np.array([100.0] * 4 + [1.0] * CLASSES, np.float32)[:, None]}
    with pytest.raises(InputError, match="no pixels"):
        read(reading, small, 0, SIZE, np.arange(CLASSES), 0.3)
    of_detr = outputs(RFDETR)
    of_detr["dets"] *= 100
    with pytest.raises(InputError, match="no shares"):
        read(recognise(of_detr, SIZE, None, None, {}), of_detr, 0, SIZE, np.arange(CLASSES), 0.0)
    far = outputs(RFDETR)
    far["labels"][:] = np.float32(-1e30)
    assert not len(read(recognise(far, SIZE, None, None, {}), far, 0, SIZE, np.arange(CLASSES), 0.1).score)
    of_rtdetr = outputs(RTDETR)
    of_rtdetr["labels"][0, 3] = np.nan
    with pytest.raises(FloatingPointError):
        read(recognise(of_rtdetr, SIZE, None, None, {}), of_rtdetr, 0, SIZE, np.array([0]), 0.3)
    of_rtdetr["labels"][:] = np.float32(1e30)
    assert not len(read(recognise(of_rtdetr, SIZE, None, None, {}), of_rtdetr, 0, SIZE, np.array([0]), 0.0).score)
    out["output0"][0, 2, 5] = np.nan
    with pytest.raises(FloatingPointError):
        read(reading, out, 0, SIZE, np.array([0]), 0.3)

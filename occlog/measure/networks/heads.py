"""Network heads: formats of outputs, their recognition by names and shapes, and decoding.

| head | outputs | by |
|---|---|---|
| yolov5 | (B, N, 5 + C): centre, size, objectness, classes | YOLOv5, v7 (export without NMS), v6 |
| yolo | (B, 4 + C, N): centre, size, classes | ultralytics YOLOv8, v9, 11, 12 |
| end2end | (B, N, 6): edges, score, class | YOLOv10, 26, ultralytics' export with `nms=True` |
| rfdetr | `dets` (B, N, 4): centre and size as shares; `labels` (B, N, C): logits | RF-DETR |
| detr | `pred_boxes` and `logits`, the same | RT-DETR of transformers |
| ultralytics-detr | (B, N, 4 + C): centre and size as shares, scores | RT-DETR of ultralytics |
| rtdetr | `labels` (B, N), `boxes` (B, N, 4), `scores` (B, N); a second input with the size | RT-DETR, D-FINE |
| rtmdet | `dets` (B, N, 5): edges, score; `labels` (B, N) | RTMDet and others by mmdeploy |

N boxes, C classes.  Boxes come in pixels of the network's image unless they are shares.

Classes of a network by name: from its metadata, from a file, or from COCO's list.
"""

from __future__ import annotations

import ast
import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Floats32, Ints
from occlog.errors import InputError, UsageError, option
from occlog.io.files.limits import check_input

from .config import (
    CORNER,
    DETR,
    END2END,
    IMAGENET,
    IMAGENET_BGR,
    LETTERBOX,
    RFDETR,
    RTDETR,
    RTMDET,
    STRETCH,
    ULTRALYTICS_DETR,
    UNIT,
    YOLO,
    YOLOV5,
)

STRIDES = ((8, 16, 32), (8, 16, 32, 64))
"""Pixels between the positions at which YOLO searches for boxes, in networks of usual and of large images."""
SHARE_SLACK = 2.0
"""Coordinates above this are no shares of an image; boxes of which none is above it are no pixels."""
SCORE_SLACK = 1e-3
WITH_MORE = ("segment", "pose")
"""Tasks of networks with masks or key points in addition to boxes."""
MAX_LABEL = 2**31
"""Numbers of classes above this are none."""
MAX_END2END = 1000
"""Boxes of networks that leave nothing out afterwards, by which they are distinguished from others."""
PLAIN_DETR = 92
"""Classes of the first DETR on COCO: its scores require a softmax, which no head here takes."""


class NetworkDetections(NamedTuple):
    """n boxes in pixels of the network's input, relative to its corner: left, top, right, bottom (n, 4).

    With scores (n,), 0 to 1, and class numbers (n,).
    """

    boxes: Floats  # (n, 4) left, top, right, bottom [px], from the corner
    score: Floats  # (n,)
    label: Ints  # (n,) classes


@dataclass(frozen=True)
class Head:
    """Input and output conventions of a family of networks.

    `fit` and `pixels` are how images are resized and colours scaled; `smooth`: images are averaged when reduced;
    `repeats`: several boxes per object are output, so that non-maximum suppression is needed.
    """

    fit: str
    pixels: str
    smooth: bool  # its makers average where images become smaller
    repeats: bool


HEADS: dict[str, Head] = {
    YOLOV5: Head(LETTERBOX, UNIT, smooth=False, repeats=True),
    YOLO: Head(LETTERBOX, UNIT, smooth=False, repeats=True),
    END2END: Head(LETTERBOX, UNIT, smooth=False, repeats=False),
    RFDETR: Head(STRETCH, IMAGENET, smooth=True, repeats=False),
    DETR: Head(STRETCH, UNIT, smooth=True, repeats=False),
    ULTRALYTICS_DETR: Head(STRETCH, UNIT, smooth=False, repeats=False),
    RTDETR: Head(STRETCH, UNIT, smooth=True, repeats=False),
    RTMDET: Head(CORNER, IMAGENET_BGR, smooth=False, repeats=False),
}
LOGITS = (RFDETR, DETR)
"""Heads with logits of all classes for each box."""
BOXES = dict.fromkeys(LOGITS, ("dets", "pred_boxes", "boxes")) | {RTDETR: ("boxes",), RTMDET: ("dets",)}
SCORES = dict.fromkeys(LOGITS, ("labels", "logits", "pred_logits")) | {RTDETR: ("scores",)}
LABELS = {RTDETR: ("labels",), RTMDET: ("labels",)}
"""Names of outputs, of heads that have several."""

Outputs = Mapping[str, Floats32]
"""Outputs of a network by name, for a batch."""


class Reading(NamedTuple):
    """Interpretation of a network's outputs: its head, number of classes, and the names of the outputs.

    `classes` is None if the outputs do not determine the number; `boxes`, `scores` and `labels` name the outputs
    with these, perhaps all the same one.
    """

    head: str
    classes: int | None  # of the head; None: the outputs do not determine
    boxes: str  # name of the output with boxes
    scores: str  # ... with scores; the same one where there is only one
    labels: str  # ... with classes


def recognise(
    outputs: Outputs, size: tuple[int, int], names: int | None, head: str | None, metadata: Mapping[str, str]
) -> Reading:
    """Determine the head (output format) of a network from its outputs.

    Args:
        outputs: outputs for a batch of images, by name.
        size: width and height of the network's input [px].
        names: number of classes that the file names; None: it names none.
        head: name of the head that the user states; None: recognised.
        metadata: metadata of the file; `task` and `end2end`, as ultralytics writes them, are used.

    Raises:
        InputError: the outputs match no head, or several, or not the stated one, or are not supported.
    """
    task = metadata.get("task", "")
    if task and task not in ("detect", *WITH_MORE):
        raise InputError(f"the network is for {task!r}, not for detection; give a detector", id="unsupported-network")
    more = task in WITH_MORE
    heads = [head] if head is not None else _candidates(outputs, size, names, more)
    if metadata.get("end2end") == "True" and END2END in heads:
        heads = [END2END]
    readings = [each for each in (_reading(outputs, name, names, more) for name in heads) if each is not None]
    if head is not None and not readings:
        raise InputError(
            f"its outputs are not those of head {head}: {shapes(outputs)}{_named_classes(names)}; leave "
            f"{option('head')} out to have it recognised",
            id="unsupported-network",
        )
    if len(readings) != 1:
        maybe = f"may be of {', '.join(each.head for each in readings)}" if readings else "are of no head that is known"
        raise InputError(
            f"its outputs {maybe}: {shapes(outputs)}{_named_classes(names)}; state which head it has "
            f"({option('head')} {', '.join(HEADS)})",
            id="unsupported-network",
        )
    if readings[0].head in LOGITS and readings[0].classes == PLAIN_DETR:
        raise InputError(
            f"the network is DETR, with class scores that need a softmax: unsupported; export RT-DETR or YOLO instead: "
            f"{shapes(outputs)}",
            id="unsupported-network",
        )
    return readings[0]


def _named_classes(names: int | None) -> str:
    return "" if names is None else f" (it names {names} classes)"


def shapes(outputs: Outputs) -> str:
    """Names and shapes of outputs as text, for messages."""
    return ", ".join(f"{name} {' x '.join(map(str, each.shape)) or 'one number'}" for name, each in outputs.items())


def _candidates(outputs: Outputs, size: tuple[int, int], names: int | None, more: bool) -> list[str]:
    """Names of the heads that may have these outputs, by output names, numbers of classes, and YOLO's grid positions.

    Args:
        outputs: outputs for a batch of images, by name.
        size: width and height of the network's input [px].
        names: number of classes that the file names; None: it names none.
        more: outputs may have more columns than classes, for masks or key points.
    """
    of_dets = RTMDET if "dets" in outputs and outputs["dets"].shape[-1:] == (5,) else RFDETR
    for head in (of_dets if "dets" in outputs else DETR, RTDETR):
        if _reading(outputs, head, names) is not None:
            return [head]
    rows, columns = next((each.shape[1:] for each in outputs.values() if each.ndim == 3), (0, 0))
    counts = {sum((size[0] // s) * (size[1] // s) for s in strides) for strides in STRIDES}
    # YOLOv5 has three anchors of boxes at each position.
    anchored = rows in {3 * n for n in counts}
    end2end = (
        rows <= MAX_END2END and not anchored and (columns == 6 or (more and columns > 6 and columns not in counts))
    )
    if names is None:
        fitting = {
            YOLO: columns in counts and not anchored,
            YOLOV5: anchored and columns not in counts,
            END2END: end2end,
        }
    else:
        fitting = {
            YOLO: rows == 4 + names or (more and rows > 4 + names and columns in counts),
            YOLOV5: columns == 5 + names and (anchored or not end2end),
            END2END: end2end,
            ULTRALYTICS_DETR: columns == 4 + names and not anchored,
        }
    return [head for head, fits in fitting.items() if fits]


def _reading(outputs: Outputs, head: str, names: int | None, more: bool = False) -> Reading | None:
    """Interpret the outputs as those of a head; None if impossible.

    Args:
        outputs: outputs for a batch of images, by name.
        head: name of the head.
        names: number of classes that the file names; None: it names none.
        more: columns after the classes, for masks or key points, are permitted.
    """
    if head in BOXES:
        wanted = [_one(outputs, each.get(head)) for each in (BOXES, SCORES, LABELS)]
        if None in wanted:
            return None
        boxes, scores, labels = (name or "" for name in wanted)
        deep = 5 if head == RTMDET else 4
        flat = [outputs[name] for name in (scores, labels) if name]
        if outputs[boxes].ndim != 3 or outputs[boxes].shape[2] != deep:
            return None
        if any(
            each.ndim != (3 if head in LOGITS else 2) or each.shape[:2] != outputs[boxes].shape[:2] for each in flat
        ):
            return None
        count = outputs[scores].shape[2] if head in LOGITS else None
        return Reading(head, count, boxes, scores or boxes, labels or boxes)
    name = next((name for name, each in outputs.items() if each.ndim == 3), None)
    if name is None:
        return None
    rows, columns = outputs[name].shape[1:]
    if head == END2END:
        return Reading(head, None, name, name, name) if columns >= 6 else None
    count = {YOLO: rows - 4, YOLOV5: columns - 5, ULTRALYTICS_DETR: columns - 4}[head]
    if count < 1 or (names is not None and (names > count or (names < count and not more))):
        return None
    # Masks of objects, as an output of four dimensions, come with numbers after the classes that only names
    # distinguish.
    if names is None and (more or any(each.ndim == 4 for each in outputs.values())):
        return None
    return Reading(head, names or count, name, name, name)


def _one(outputs: Outputs, known: Sequence[str] | None) -> str | None:
    """First of the names `known` that an output has; None if it is missing; empty text if `known` is None."""
    return "" if known is None else next((name for name in known if name in outputs), None)


def read(
    reading: Reading, outputs: Outputs, n: int, size: tuple[int, int], wanted: Ints, least: float
) -> NetworkDetections:
    """Decode the boxes of the requested classes with a minimum confidence in one image of a batch.

    As in the original implementations, a box of `yolo`, `yolov5` and `ultralytics-detr` has the class with the highest
    score; for `rfdetr` and `detr` the N highest scores over all boxes and classes are used.

    Args:
        reading: interpretation of the outputs.
        outputs: outputs for the batch, by name.
        n: index of the image in the batch.
        size: width and height of the network's input [px].
        wanted: numbers of the requested classes.
        least: minimum confidence.

    Raises:
        InputError: scores are not 0 to 1, or coordinates not in pixels or shares as the head has them.
        FloatingPointError: a number is not finite.
    """
    head, boxes = reading.head, outputs[reading.boxes][n]
    scores = outputs[reading.scores][n]
    if not all(np.isfinite(outputs[name][n]).all() for name in {reading.boxes, reading.scores, reading.labels}):
        raise FloatingPointError
    if head == YOLO:
        found = _best(boxes[:4].T, boxes[4 : 4 + (reading.classes or 0)].T, None, wanted, least)
    elif head == YOLOV5:
        found = _best(boxes[:, :4], boxes[:, 5 : 5 + (reading.classes or 0)], boxes[:, 4], wanted, least)
    elif head == ULTRALYTICS_DETR:
        found = _best(boxes[:, :4], boxes[:, 4 : 4 + (reading.classes or 0)], None, wanted, least)
    elif head in LOGITS:
        found = _highest(boxes, scores, wanted, least)
    else:
        if head == END2END:
            scores, label = boxes[:, 4], boxes[:, 5]
        elif head == RTMDET:
            scores, label = boxes[:, 4], outputs[reading.labels][n]
        else:
            label = outputs[reading.labels][n]
        label = np.rint(np.clip(label, -1, MAX_LABEL)).astype(np.int64)
        kept = np.isin(label, wanted) & (scores >= least)
        found = NetworkDetections(boxes[kept, :4].astype(np.float64), scores[kept].astype(np.float64), label[kept])
        _check_scores(head, scores)
        _check_places(head, found.boxes, shares=False)
        return found
    _check_places(head, found.boxes, shares=head in (*LOGITS, ULTRALYTICS_DETR))
    return found._replace(boxes=_edges(found.boxes, size if head in (*LOGITS, ULTRALYTICS_DETR) else (1, 1)))


def _best(
    boxes: Floats32, scores: Floats32, objectness: Floats32 | None, wanted: Ints, least: float
) -> NetworkDetections:
    """Boxes with a requested class as their best one; coordinates as given.

    Args:
        boxes: (N, 4) boxes in any convention.
        scores: (N, C) confidences of the classes, 0 to 1.
        objectness: (N,) factors of the scores, 0 to 1; None: no factors.
        wanted: numbers of the requested classes.
        least: minimum confidence.
    """
    if objectness is not None:
        _check_scores(YOLOV5, objectness)
    _check_scores(YOLO, scores)
    # Evaluate fully where a requested class alone is confident enough.
    may = (scores[:, wanted] >= least).any(axis=1)
    if objectness is not None:
        may &= objectness >= least
    some = scores[may] if objectness is None else scores[may] * objectness[may, None]
    label = some.argmax(axis=1).astype(np.int64) if len(some) else np.zeros(0, dtype=np.int64)
    best = some[np.arange(len(some)), label]
    kept: Bools = np.isin(label, wanted) & (best >= least)
    return NetworkDetections(boxes[may][kept].astype(np.float64), best[kept].astype(np.float64), label[kept])


def _highest(boxes: Floats32, logits: Floats32, wanted: Ints, least: float) -> NetworkDetections:
    """Boxes of requested classes among the N highest scores over N boxes and all classes; a box may occur twice.

    Coordinates as given; scores are the logistic function of the logits.

    Args:
        boxes: (N, 4) boxes in any convention.
        logits: (N, C) logits of the classes.
        wanted: numbers of the requested classes.
        least: minimum confidence.
    """
    with np.errstate(over="ignore"):
        scores = 1.0 / (1.0 + np.exp(-logits.astype(np.float64)))
    enough = scores >= least
    if np.count_nonzero(enough) > len(scores):
        # The N-th highest; equal ones count, too.
        enough &= scores >= np.partition(scores, scores.size - len(scores), axis=None)[scores.size - len(scores)]
    row, column = np.nonzero(enough[:, wanted])
    label = wanted[column]
    return NetworkDetections(boxes[row].astype(np.float64), scores[row, label], label)


def _edges(boxes: Floats, size: tuple[float, float]) -> Floats:
    """Edges of boxes that a network states by centre and size.

    Args:
        boxes: (n, 4) x and y of the centre, width, height; in shares of the input image or in pixels.
        size: factors of x and y: width and height of the network's input [px], or 1 and 1.

    Returns:
        (n, 4) left, top, right, bottom [px].
    """
    scale = np.array(size, dtype=np.float64)
    centre, half = boxes[:, :2] * scale, 0.5 * boxes[:, 2:] * scale
    return np.concatenate([centre - half, centre + half], axis=1)


def _check_scores(head: str, scores: Floats32) -> None:
    if scores.size and not (scores.min() >= -SCORE_SLACK and scores.max() <= 1.0 + SCORE_SLACK):
        raise InputError(
            f"scores from {scores.min():.4g} to {scores.max():.4g} are no confidences, 0 to 1, as head {head} has; "
            f"state another {option('head')}, or export it with its last layer",
            id="unsupported-network",
        )


def _check_places(head: str, boxes: Floats, *, shares: bool) -> None:
    if not len(boxes) or (np.abs(boxes).max() <= SHARE_SLACK) == shares:
        return
    what = "shares of an image" if shares else "pixels"
    raise InputError(
        f"box coordinates up to {np.abs(boxes).max():.4g} are no {what}, as head {head} has; state another "
        f"{option('head')}",
        id="unsupported-network",
    )


PERSON = "person"
MAX_NAMES = 100_000
LONGEST_FILE = 4 * 1024 * 1024
# fmt: off
COCO = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat", "traffic light",
    "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog", "horse", "sheep", "cow", "elephant",
    "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard",
    "sports ball", "kite", "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle",
    "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich", "orange", "broccoli",
    "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch", "potted plant", "bed", "dining table", "toilet",
    "tv", "laptop", "mouse", "remote", "keyboard", "cell phone", "microwave", "oven", "toaster", "sink",
    "refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier", "toothbrush",
)
# fmt: on
"""The 80 classes of COCO in their order."""
LEFT_OUT = (0, 12, 26, 29, 30, 45, 66, 68, 69, 71, 83)
"""Numbers from 0 to 90 that no class of COCO has in its annotations."""
COCO_91 = dict(zip((k for k in range(91) if k not in LEFT_OUT), COCO, strict=True))
"""Classes of COCO by COCO's own numbers, as in RF-DETR."""


class ClassNames(NamedTuple):
    """Class names of a network by number, and where they are from, for messages."""

    names: Mapping[int, str]
    source: str


def names_in(metadata: Mapping[str, str]) -> dict[int, str] | None:
    """Parse the class names in the metadata of an ultralytics model (`names`: a dictionary or a list); None if missing.

    Raises:
        InputError: they cannot be read.
    """
    text = metadata.get("names")
    if text is None:
        return None
    try:
        found = ast.literal_eval(text)
        pairs = found.items() if isinstance(found, dict) else enumerate(found)
        out = {int(k): str(name) for k, name in pairs}
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        raise InputError(
            f"its names of classes cannot be read: {text[:60]!r}; give them in a file ({option('names')})",
            id="unsupported-network",
        ) from None
    if not out or min(out) < 0 or max(out) >= MAX_NAMES:
        raise InputError(
            f"its names of classes have numbers out of 0 to {MAX_NAMES - 1}; give them in a file ({option('names')})",
            id="unsupported-network",
        )
    return out


def read_names(path: Path) -> dict[int, str]:
    """Read class names from a text file, one per line, starting with class 0.

    InputError if the file is too large, not UTF-8, or has no or empty lines.
    """
    check_input(path, "names of classes (text, one a line)")
    if path.stat().st_size > LONGEST_FILE:
        raise InputError(
            f"{path}: has {path.stat().st_size} bytes; a file of class names has at most {LONGEST_FILE}",
            id="input-too-large",
        )
    try:
        lines = path.read_text(encoding="utf-8").rstrip().splitlines()
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is not UTF-8 text ({error.reason}); write one class name a line", id="wrong-encoding"
        ) from None
    if not lines:
        raise InputError(f"{path}: holds no class name; write one a line, the first of class 0", id="empty-input")
    if any(not line.strip() for line in lines):
        row = next(k for k, line in enumerate(lines, 1) if not line.strip())
        raise InputError(f"{path}: line {row}: is empty; write one class name a line, the first of class 0")
    return {k: line.strip() for k, line in enumerate(lines)}


def names_of(count: int | None, declared: Mapping[int, str] | None, file: Path | None) -> ClassNames:
    """Class names of a network: from a file, else from the network, else COCO's if their number matches, else none.

    InputError if the names are more or fewer than the classes.

    Args:
        count: number of classes of the network; None: unknown.
        declared: names in the network's metadata; None: it has none.
        file: file with names given by the user; None: not given.
    """
    if file is not None:
        names = read_names(file)
        if count is not None and len(names) != count:
            raise InputError(
                f"{file}: {len(names)} class names, but the network has {count} classes; write one for each",
                id="incompatible-inputs",
            )
        return ClassNames(names, file.name)
    if declared is not None:
        if count is not None and max(declared) >= count:
            raise InputError(
                f"the network names its class {max(declared)}, but has {count} classes; give their names in a file "
                f"({option('names')})",
                id="unsupported-network",
            )
        return ClassNames(declared, "the network")
    if count == len(COCO) or count is None:
        return ClassNames(dict(enumerate(COCO)), "COCO" if count else "COCO, assumed")
    if count == max(COCO_91) + 1:
        return ClassNames(COCO_91, "COCO")
    return ClassNames({}, "")


def wanted_classes(asked: Sequence[str], names: ClassNames, count: int | None) -> Ints:
    """Sorted numbers of the requested classes; default: person, or the only class.

    Args:
        asked: requested names or numbers; empty: the default.
        names: names of the network's classes.
        count: number of its classes; None: unknown.

    Raises:
        UsageError: a class that the network does not have.
    """
    if not asked and count == 1:
        return np.zeros(1, dtype=np.int64)
    numbers = {name.casefold(): k for k, name in sorted(names.names.items(), reverse=True)}
    found = set()
    for each in asked or (PERSON,):
        text = each.strip()
        if text.isdecimal():
            most = count if count is not None else max(names.names, default=0) + 1
            if int(text) >= most:
                raise UsageError(f"class {text}: the network has the classes 0 to {most - 1}", id="unknown-name")
            found.add(int(text))
            continue
        if not names.names:
            raise UsageError(
                f"class {text!r}: the network does not name its {count} classes; give the class's number, or a file of "
                "their names",
                id="unknown-name",
            )
        if text.casefold() not in numbers:
            near = difflib.get_close_matches(text.casefold(), numbers, n=1)
            some = ", ".join(list(names.names.values())[:8]) + (", ..." if len(names.names) > 8 else "")
            hint = f"did you mean {names.names[numbers[near[0]]]!r}?" if near else f"it has {some}"
            raise UsageError(f"class {text!r}: the network has no such class; {hint}", id="unknown-name")
        found.add(numbers[text.casefold()])
    return np.array(sorted(found), dtype=np.int64)

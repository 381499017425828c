"""Classes of a network by name: from its metadata, from a file, or from COCO's list."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError, UsageError
from occlog.io.files.untrusted.inputs import check_input

PERSON = "person"
MOST_NAMES = 100_000
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
"""The same classes by COCO's own numbers, as RF-DETR has them."""


class Names(NamedTuple):
    """Names of a network's classes, and where they are from, for a person."""

    names: Mapping[int, str]
    source: str


def names_in(metadata: Mapping[str, str]) -> dict[int, str] | None:
    """The names that ultralytics writes into a model (`names`: a dictionary or a list); None: there are none.

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
            f"its names of classes cannot be read: {text[:60]!r}; give them in a file (names of classes)"
        ) from None
    if not out or min(out) < 0 or max(out) >= MOST_NAMES:
        raise InputError(
            f"its names of classes have numbers out of 0 to {MOST_NAMES - 1}; give them in a file (names of classes)"
        )
    return out


def read_names(path: Path) -> dict[int, str]:
    """Names from a text file, one a line, the first of class 0."""
    check_input(path, "names of classes (text, one a line)")
    if path.stat().st_size > LONGEST_FILE:
        raise InputError(f"{path}: has {path.stat().st_size} bytes; names of classes have at most {LONGEST_FILE}")
    try:
        lines = path.read_text(encoding="utf-8").rstrip().splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text ({error.reason}); write one name a line") from None
    if not lines:
        raise InputError(f"{path}: holds no name; write one a line")
    if any(not line.strip() for line in lines):
        row = next(k for k, line in enumerate(lines, 1) if not line.strip())
        raise InputError(f"{path}: line {row}: is empty; write one name a line, the first of class 0")
    return {k: line.strip() for k, line in enumerate(lines)}


def names_of(count: int | None, told: Mapping[int, str] | None, file: Path | None) -> Names:
    """Names of a network's classes: the file's, else the network's own, else COCO's if their number fits.

    Args:
        count: classes that the head has; None: not known.
        told: names in the network's metadata.
        file: the user's names.
    """
    if file is not None:
        names = read_names(file)
        if count is not None and len(names) != count:
            raise InputError(f"{file}: {len(names)} names, but the network has {count} classes")
        return Names(names, file.name)
    if told is not None:
        if count is not None and max(told) >= count:
            raise InputError(
                f"names its class {max(told)}, but has {count} classes; give their names in a file (names of classes)"
            )
        return Names(told, "the network")
    if count == len(COCO) or count is None:
        return Names(dict(enumerate(COCO)), "COCO" if count else "COCO, assumed")
    if count == max(COCO_91) + 1:
        return Names(COCO_91, "COCO")
    return Names({}, "")


def wanted_classes(asked: Sequence[str], names: Names, count: int | None) -> Ints:
    """Numbers of the classes asked for, rising; nothing asked for is a person, or the only class.

    Raises:
        UsageError: a class that is not there, with the nearest name.
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
                raise UsageError(f"class {text}: the network has the classes 0 to {most - 1}")
            found.add(int(text))
            continue
        if not names.names:
            raise UsageError(
                f"class {text!r}: the network does not name its {count} classes; give the class's number, or their "
                "names in a file"
            )
        if text.casefold() not in numbers:
            near = difflib.get_close_matches(text.casefold(), numbers, n=1)
            some = ", ".join(list(names.names.values())[:8]) + (", ..." if len(names.names) > 8 else "")
            hint = f"did you mean {names.names[numbers[near[0]]]!r}?" if near else f"it has {some}"
            raise UsageError(f"class {text!r}: the network has no such class; {hint}")
        found.add(numbers[text.casefold()])
    return np.array(sorted(found), dtype=np.int64)

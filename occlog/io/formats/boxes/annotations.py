"""Boxes of the annotation tool CVAT: XML "for video" (tracks) and "for images", of one camera.

`<track id="3" label="person"><box frame="0" outside="0" xtl="1" ytl="2" xbr="3" ybr="4"/>...</track>` has the boxes of
one identity; those that are `outside` are not in the image. `<image id="0" name="f_000.png"><box label="person"
.../></image>` has the boxes of one image, without identities. Frames count from 0, and are the numbers in the names of
images if these skip numbers (`f_000.png`, `f_005.png`). `start_frame` and `stop_frame` of
the task, with the step of `frame_filter`, or the images, state which frames were annotated; the others have no
statement.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError
from occlog.io.files.limits import guarded
from occlog.io.files.names import last_number
from occlog.io.files.texts.documents import parse_xml
from occlog.io.files.texts.formats import Probe
from occlog.records.declared.sensors import MAX_FRAMES

from .columns import ROTATED, BoxReadOptions, BoxSource, chunks_of, stated_sizes

LONGEST_NUMBER = 20
"""Digits of a number of a frame at which it is none."""
MAX_BYTES = 2**28
EDGES = {"xtl": "left", "ytl": "top", "xbr": "right", "ybr": "bottom"}
_OF_TOOL = {"label", "source", "group_id", "subset", "task_id", "occluded", "keyframe", "outside", "z_order"}
KEYS = {
    "track": {"id", *_OF_TOOL},
    "image": {"id", "name", "width", "height", *_OF_TOOL},
    "box": {"frame", "rotation", *EDGES, *_OF_TOOL},
}
"""Attributes of each element that are used, or do not change a box or its frame."""
WHAT = "annotations of CVAT"
_STEP = re.compile(r"step\s*=\s*(\d{1,6})")
Record = tuple[int, dict[str, str]]


def is_cvat(probe: Probe) -> bool:
    """Whether a file is an annotation file of CVAT (XML), by its beginning and suffix."""
    return b"<annotations" in probe.start and probe.path.suffix.lower() == ".xml"


def open_cvat(path: Path, wanted: BoxReadOptions) -> BoxSource:
    """Read the boxes of one camera from annotations of CVAT (XML "for video" or "for images").

    Args:
        path: the file.
        wanted: has the name of the camera.

    Raises:
        InputError: the camera is not named, or the file is no such XML.
    """
    wanted.check_camera(path, "an annotation file of CVAT")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(
            f"{path}: {path.stat().st_size} bytes; {WHAT} of at most {MAX_BYTES} can be read; split it",
            id="input-too-large",
        )
    with guarded(path, WHAT):
        root = parse_xml(path.read_text(encoding="utf-8-sig"), path)
    named = _named(root)
    records = [*_of_tracks(path, root), *_of_images(path, root, named)]
    listed = _listed(path, root, named)
    if not records and listed is None:
        raise InputError(
            f"{path}: has no <track> and no <image>; {WHAT} were expected (CVAT for video, or for images)",
            id="unknown-format",
        )
    records.sort(key=lambda record: _order(record[1]["frame"]))
    return BoxSource(
        chunks_of(path, records, "box"),
        "CVAT",
        {} if listed is None else {"": listed},
        first_number=0,
        sizes=stated_sizes(_sizes(root)),
        unused=tuple(
            sorted({f"{name}.{key}" for name in KEYS for e in root.iter(name) for key in e.attrib.keys() - KEYS[name]})
        ),
    )


def _order(frame: str) -> int:
    """Frame number of a text, for sorting; `MAX_FRAMES` for an invalid text, which is refused later with its row."""
    return int(frame) if frame.isdecimal() and len(frame) < LONGEST_NUMBER else MAX_FRAMES


def _sizes(root: Element) -> Iterator[tuple[str, object, object]]:
    """Yield ("", width, height) as stated by the task and by each image, as text or None."""
    for image in root.iter("image"):
        yield "", image.get("width"), image.get("height")
    for size in root.iter("original_size"):
        yield "", size.findtext("width"), size.findtext("height")


def _of_tracks(path: Path, root: Element) -> Iterator[Record]:
    for track in root.iter("track"):
        identity, label = track.get("id", ""), track.get("label", "")
        for n, box in enumerate(track.iter("box"), start=1):
            if box.get("outside") != "1":
                where = f"{path}: track {identity}: box {n}"
                yield n, {"id": identity, "frame": box.get("frame", ""), "class:label": label, **_edges(box, where)}


def _named(root: Element) -> dict[str, str]:
    """Frame numbers of images by their ids, where these count images, and the names have numbers that skip some.

    Empty if the ids are the frame numbers.
    """
    images = {image.get("id", ""): last_number(Path(image.get("name", "")).stem) or "" for image in root.iter("image")}
    numbers = [(_order(key), _order(name)) for key, name in images.items()]
    steps = {name - key for key, name in numbers}
    rising = all(a < b for (_, a), (_, b) in pairwise(sorted(numbers)))
    return images if len(steps) > 1 and rising and max(name for _, name in numbers) < MAX_FRAMES else {}


def _of_images(path: Path, root: Element, named: Mapping[str, str]) -> Iterator[Record]:
    for image in root.iter("image"):
        number = image.get("id", "")
        for n, box in enumerate(image.iter("box"), start=1):
            where = f"{path}: image {number}: box {n}"
            yield n, {"frame": named.get(number, number), "class:label": box.get("label", ""), **_edges(box, where)}


def _edges(box: Element, where: str) -> dict[str, str]:
    missing = [name for name in EDGES if box.get(name) is None]
    if missing:
        raise InputError(f"{where}: has no {missing[0]}; {', '.join(EDGES)} were expected", id="unknown-format")
    if float(box.get("rotation", "0") or "0"):
        raise InputError(f"{where}: {ROTATED}", id="unsupported-format")
    return {name: str(box.get(key)) for key, name in EDGES.items()}


def _listed(path: Path, root: Element, named: Mapping[str, str]) -> Ints | None:
    """Sorted numbers of the annotated frames: of the images, or of the task's range and step; None if not stated."""
    ids = (image.get("id", "") for image in root.iter("image"))
    images = [named.get(number, number) for number in ids]
    if images and all(number.isdecimal() for number in images):
        last = max(images, key=_order)
        if _order(last) >= MAX_FRAMES:
            raise InputError(
                f"{path}: image {last:.24}: its id, a frame number, must be below {MAX_FRAMES}; correct it"
            )
        return np.unique(np.array([int(number) for number in images], dtype=np.int64))
    first, last = (next((e.text or "" for e in root.iter(name)), "") for name in ("start_frame", "stop_frame"))
    if not (first.isdecimal() and last.isdecimal() and _order(first) <= _order(last) < MAX_FRAMES):
        return None
    # The task has every n-th frame of the video, and counts those of the video
    step = _STEP.search(next((e.text or "" for e in root.iter("frame_filter")), ""))
    return np.arange(int(first), int(last) + 1, max(int(step[1]), 1) if step else 1, dtype=np.int64)

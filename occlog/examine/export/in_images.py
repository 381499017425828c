"""Export of boxes in images: MOTChallenge, KITTI, COCO."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS
from occlog.errors import InputError, UsageError, abridged, option
from occlog.io.formats.boxes.mot_challenge import WrittenSequence
from occlog.records.declared.views import ViewTracks, boxes_of_ellipses
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, Views

CATEGORY, NAME = 1, "person"


def boxes_of(table: Boxes | Views | ViewTracks) -> Boxes:
    """Return the boxes of a table of boxes, of clusters, or of tracks in images.

    Ellipses give their bounding boxes; clusters keep their numbers.
    """
    if isinstance(table, Boxes):
        return table.take(table.box >= 0)
    if isinstance(table, ViewTracks):
        return boxes_of_ellipses(table).sorted()
    return Boxes.of(
        t_ns=table.t_ns,
        sensor=table.sensor,
        frame=table.frame,
        box=table.cluster,
        target_id=table.target_id,
        left_px=table.left_px,
        top_px=table.top_px,
        width_px=table.width_px,
        height_px=table.height_px,
        confidence=table.confidence,
    ).sorted()


class Cameras(NamedTuple):
    """Cameras found in a pass over a table in images.

    Attributes:
        boxed: sorted names of the cameras that have a box.
        ends: for each camera, frame and time of a row with its lowest frame number, and of one with its highest.
        rising: cameras with frame numbers that rise with time.
    """

    boxed: list[str]
    ends: dict[str, tuple[ImageFrame, ImageFrame]]
    rising: frozenset[str]


class ImageFrame(NamedTuple):
    """Number of a frame in its video, and its time [ns]."""

    number: int
    t_ns: int


def survey(pieces: Iterable[Boxes | Views | ViewTracks]) -> Cameras:
    """Find the cameras of a table, given in parts in the order of time that split no time."""
    boxed: set[str] = set()
    ends: dict[str, tuple[ImageFrame, ImageFrame]] = {}
    back: set[str] = set()
    for piece in pieces:
        boxed.update(np.unique(piece.sensor[piece.box >= 0] if isinstance(piece, Boxes) else piece.sensor).tolist())
        for name in np.unique(piece.sensor).tolist():
            own = np.flatnonzero(piece.sensor == name)
            frame, t_ns = piece.frame[own], piece.t_ns[own]
            low, high = (ImageFrame(int(frame[at]), int(t_ns[at])) for at in (np.argmin(frame), np.argmax(frame)))
            first, last = ends.get(name, (low, high))
            later = np.diff(t_ns) > 0
            if (np.diff(frame)[later] <= 0).any() or (np.diff(frame)[~later] != 0).any():
                back.add(name)
            if name in ends and low.number <= last.number:
                back.add(name)
            ends[name] = (low if low.number < first.number else first, high if high.number > last.number else last)
    return Cameras(sorted(boxed), ends, frozenset(ends) - back)


def chosen_camera(cameras: list[str], camera: str | None) -> str | None:
    """Return the camera to export, of the `cameras` with boxes; None without boxes.

    `camera`: the one that the user names; None: none. UsageError if several have boxes and none is named, InputError if
    the named one is missing.
    """
    if camera is None and len(cameras) > 1:
        raise UsageError(
            f"a text of boxes holds one camera, and there are {abridged(cameras)}; choose one ({option('camera')})",
            id="ambiguous-input",
        )
    if camera is not None and camera not in cameras:
        raise InputError(f"no boxes of camera {camera!r}; there are: {abridged(cameras)}", id="unknown-sensor")
    return camera if camera is not None else next(iter(cameras), None)


def sequence_info(found: Cameras, camera: str | None, folder: str, scene: Scene | None) -> WrittenSequence:
    """Return the content of MOTChallenge's `seqinfo.ini` for one camera: frames up to the last with a row, mean rate.

    Args:
        found: cameras of the table; rows of frames without a box count too.
        camera: the camera; None: the first.
        folder: name of the sequence.
        scene: has the sizes of images.

    Raises:
        InputError: the image size is unknown, or there are fewer than two frames for a rate.
    """
    if not found.ends:
        raise InputError(
            "the table has no rows, so that the frames of the video are unknown; give one with rows", id="empty-input"
        )
    chosen = camera if camera is not None else min(found.ends)
    size = next((c.image_size for c in scene.cameras if c.name == chosen), None) if scene is not None else None
    if size is None:
        raise InputError(
            f"the size of the images of {chosen} is not known, which seqinfo.ini needs; give {option('scene')}",
            id="missing-image-size",
        )
    first, last = found.ends[chosen]
    if last.t_ns == first.t_ns:
        raise InputError(
            f"{chosen} has one frame only, so that the frame rate in seqinfo.ini is not known", id="insufficient-data"
        )
    rate_hz = NS * float(last.number - first.number) / float(last.t_ns - first.t_ns)
    return WrittenSequence(folder, last.number + 1, round(rate_hz, 6), *size)


def kitti_text(boxes: Boxes) -> str:
    """Return lines of KITTI's text of tracks: frame, identity, type, box; positions in space are unknown."""
    unknown = "-1 -1 -1 -1000 -1000 -1000 -10"
    rows = zip(
        boxes.frame.tolist(),
        boxes.target_id.tolist(),
        boxes.left_px.tolist(),
        boxes.top_px.tolist(),
        (boxes.left_px + boxes.width_px).tolist(),
        (boxes.top_px + boxes.height_px).tolist(),
        boxes.confidence.tolist(),
        strict=True,
    )
    return "".join(
        f"{frame} {identity} Pedestrian -1 -1 -10 {x1!r} {y1!r} {x2!r} {y2!r} {unknown}"
        + (f" {sure!r}\n" if sure == sure else "\n")
        for frame, identity, x1, y1, x2, y2, sure in rows
    )


def coco_texts(pieces: Callable[[], Iterable[Boxes]], scene: Scene | None) -> Iterator[str]:
    """Generate a COCO data set as text, part by part: an image for each frame with a box, an annotation for each box.

    There is one category, `person`. Images come in a first pass, annotations in a second one.

    Args:
        pieces: returns an iterator over the boxes, at each call, in parts that split no time and in which frames of a
            camera rise with time; or in one part.
        scene: has the sizes of images; None: unknown.
    """
    sizes = {} if scene is None else {c.name: c.image_size for c in scene.cameras}
    count, mark = 0, ""
    yield '{"images": ['
    for boxes in pieces():
        keys, number = _images(boxes, count)
        images = []
        for sensor, frame, t_ns in keys:
            size, image = sizes.get(sensor), number[sensor, frame]
            named = {"id": image, "file_name": f"{sensor}/{frame:06d}.jpg", "camera": sensor}
            named |= {"frame": frame, "t_ns": t_ns}
            images.append(named | ({} if size is None else {"width": size[0], "height": size[1]}))
        yield from _joined(mark, images)
        count, mark = count + len(keys), ", " if images else mark
    yield '], "annotations": ['
    count = first = 0
    mark = ""
    for boxes in pieces():
        keys, number = _images(boxes, count)
        annotations = []
        edges = np.column_stack([boxes.left_px, boxes.top_px, boxes.width_px, boxes.height_px]).tolist()
        columns = (boxes.sensor, boxes.frame, boxes.target_id, boxes.confidence)
        rows = zip(*(column.tolist() for column in columns), edges, strict=True)
        for n, (sensor, frame, identity, sure, box) in enumerate(rows, first + 1):
            found = {"id": n, "image_id": number[sensor, frame], "category_id": CATEGORY, "bbox": box}
            found |= {"area": box[2] * box[3], "iscrowd": 0}
            found |= {} if identity < 0 else {"track_id": identity}
            annotations.append(found | ({} if sure != sure else {"score": sure}))
        yield from _joined(mark, annotations)
        count, first, mark = count + len(keys), first + len(boxes), ", " if annotations else mark
    categories = json.dumps([{"id": CATEGORY, "name": NAME}])
    yield f'], "categories": {categories}}}\n'


def _images(boxes: Boxes, count: int) -> tuple[list[tuple[str, int, int]], dict[tuple[str, int], int]]:
    """Return camera, frame and time [ns] of each image in a part, and its number by (camera, frame).

    Numbers follow those of the `count` images before.
    """
    keys = list(dict.fromkeys(zip(boxes.sensor.tolist(), boxes.frame.tolist(), boxes.t_ns.tolist(), strict=True)))
    return keys, {(sensor, frame): count + n + 1 for n, (sensor, frame, _) in enumerate(keys)}


def _joined(mark: str, values: list[dict[str, object]]) -> Iterator[str]:
    """Generate JSON items of a list without its brackets, after the separator `mark`; nothing without values."""
    if values:
        yield mark + json.dumps(values)[1:-1]

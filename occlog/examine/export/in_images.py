"""Boxes in images in formats of detectors and trackers: MOTChallenge, KITTI, COCO."""

from __future__ import annotations

import json

import numpy as np

from occlog.array_types import NS
from occlog.errors import InputError, UsageError
from occlog.io.boxes.mot_challenge import SequenceInfo
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, Views
from occlog.records.views import ViewTracks, boxes_of_ellipses

CATEGORY, NAME = 1, "person"


def boxes_of(table: Boxes | Views | ViewTracks) -> Boxes:
    """The boxes of a table; those of ellipses touch them, clusters are numbered as they are.

    Args:
        table: boxes, clusters or tracks in images.
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


def of_camera(boxes: Boxes, camera: str | None) -> Boxes:
    """The boxes of one camera; UsageError where there are several and none is named, or that one is not there."""
    cameras = np.unique(boxes.sensor).tolist()
    if camera is None and len(cameras) > 1:
        raise UsageError(f"the text holds one camera, and there are {', '.join(cameras)}; choose one (camera)")
    if camera is not None and camera not in cameras:
        raise InputError(f"no boxes of camera {camera!r}; there are: {', '.join(cameras) or 'none'}")
    return boxes if camera is None else boxes.take(boxes.sensor == camera)


def sequence_info(
    rows: Boxes | Views | ViewTracks, camera: str | None, folder: str, scene: Scene | None
) -> SequenceInfo:
    """What `seqinfo.ini` says of the video of one camera: frames up to the last one that has a row, at their mean rate.

    Args:
        rows: of the table; those of frames without a box count too.
        camera: the camera; None: there is one.
        folder: of the sequence, whose name it has.
        scene: has the sizes of images.

    Raises:
        InputError: the size of the images is not known, or there is one frame only, so that there is no rate.
    """
    names = np.unique(rows.sensor).tolist()
    chosen = camera if camera is not None else names[0]
    size = next((c.image_size for c in scene.cameras if c.name == chosen), None) if scene is not None else None
    if size is None:
        raise InputError(f"the size of the images of {chosen} is not known, which seqinfo.ini has; give their scene")
    own = np.flatnonzero(rows.sensor == chosen)
    first, last = own[np.argmin(rows.frame[own])], own[np.argmax(rows.frame[own])]
    if rows.t_ns[last] == rows.t_ns[first]:
        raise InputError(f"{chosen} has one frame only, so that the frame rate in seqinfo.ini is not known")
    rate_hz = NS * float(rows.frame[last] - rows.frame[first]) / float(rows.t_ns[last] - rows.t_ns[first])
    return SequenceInfo(folder, int(rows.frame[last]) + 1, round(rate_hz, 6), *size)


def kitti_text(boxes: Boxes) -> str:
    """Lines of KITTI's tracks: frame, identity, type, and what is in the image; places in space are not known."""
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


def coco_text(boxes: Boxes, scene: Scene | None) -> str:
    """COCO's data set: an image for each frame with a box, an annotation for each box, one category."""
    sizes = {} if scene is None else {c.name: c.image_size for c in scene.cameras}
    keys = list(dict.fromkeys(zip(boxes.sensor.tolist(), boxes.frame.tolist(), boxes.t_ns.tolist(), strict=True)))
    number = {(sensor, frame): n + 1 for n, (sensor, frame, _) in enumerate(keys)}
    images = []
    for sensor, frame, t_ns in keys:
        size = sizes.get(sensor)
        named = {"id": number[sensor, frame], "file_name": f"{sensor}/{frame:06d}.jpg", "frame": frame, "t_ns": t_ns}
        images.append(named | ({} if size is None else {"width": size[0], "height": size[1]}))
    annotations = []
    edges = np.column_stack([boxes.left_px, boxes.top_px, boxes.width_px, boxes.height_px]).tolist()
    for n, (sensor, frame, box, identity, sure) in enumerate(
        zip(
            boxes.sensor.tolist(),
            boxes.frame.tolist(),
            edges,
            boxes.target_id.tolist(),
            boxes.confidence.tolist(),
            strict=True,
        )
    ):
        found = {"id": n + 1, "image_id": number[sensor, frame], "category_id": CATEGORY, "bbox": box}
        found |= {"area": box[2] * box[3], "iscrowd": 0}
        found |= {} if identity < 0 else {"track_id": identity}
        annotations.append(found | ({} if sure != sure else {"score": sure}))
    categories = [{"id": CATEGORY, "name": NAME}]
    return json.dumps({"images": images, "annotations": annotations, "categories": categories}) + "\n"

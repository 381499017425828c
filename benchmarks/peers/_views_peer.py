"""Boxes tracked with a tracker of another project; run in an environment of its own.

`python _views_peer.py GIVEN.npz OUT.npz NAME`: NAME is norfair, norfair-quick, bytetrack, ocsort or sort.
GIVEN holds `frames` (V,) number of frames of each view, `fps`, and for each box `view`, `frame` from 0 and
`box` (left, top, width, height); every view is tracked alone.  OUT holds `view`, `frame`, `label`, `box` of
the tracks, and the program prints JSON: processor time and version.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Any

import numpy as np

Boxes = Any
Step = Callable[[Boxes], tuple[Any, Boxes]]
"""Corners (n, 4) of a frame's boxes to labels and corners of the tracks."""


def norfair_step(fps: float, **settings: Any) -> Step:
    """Tracker of norfair on corners, compared by IoU as in its own examples."""
    del fps  # it counts frames
    from norfair import Detection, Tracker

    tracker = Tracker("iou", distance_threshold=0.7, **settings)

    def step(corners: Boxes) -> tuple[Any, Boxes]:
        found = tracker.update([Detection(c.reshape(2, 2)) for c in corners])
        return [o.id for o in found], np.reshape([o.estimate for o in found], (-1, 4))

    return step


def roboflow_step(fps: float, kind: str) -> Step:
    """Tracker of roboflow's `trackers` with its defaults, told the frame rate."""
    import supervision
    import trackers

    tracker = getattr(trackers, kind)(frame_rate=fps)

    def step(corners: Boxes) -> tuple[Any, Boxes]:
        found = tracker.update(supervision.Detections(xyxy=corners.astype(np.float32)))
        known = found.tracker_id >= 0  # the others are not confirmed
        return found.tracker_id[known], found.xyxy[known]

    return step


MAKERS: dict[str, tuple[str, Callable[[float], Step]]] = {
    "norfair": ("norfair", norfair_step),
    "norfair-quick": ("norfair", lambda fps: norfair_step(fps, initialization_delay=2)),
    "bytetrack": ("trackers", lambda fps: roboflow_step(fps, "ByteTrackTracker")),
    "ocsort": ("trackers", lambda fps: roboflow_step(fps, "OCSORTTracker")),
    "sort": ("trackers", lambda fps: roboflow_step(fps, "SORTTracker")),
}


def tracked(view: int, boxes: dict[str, Any], frames: int, step: Step) -> Iterator[tuple[int, int, int, Any]]:
    """View, frame, label and box of every track of one view."""
    mine = boxes["view"] == view
    frame, corners = boxes["frame"][mine], boxes["box"][mine].astype(np.float64)
    corners[:, 2:] += corners[:, :2]
    for k in range(frames):
        labels, found = step(corners[frame == k])
        for label, row in zip(labels, found, strict=True):
            yield view, k, int(label), [row[0], row[1], row[2] - row[0], row[3] - row[1]]


def main(given: str, out: str, name: str) -> None:
    """Track all views, one after the other."""
    boxes = dict(np.load(given))
    package, maker = MAKERS[name]
    fps = float(boxes["fps"])
    steps = [maker(fps) for _ in boxes["frames"]]
    begin = time.process_time()
    rows = [
        row for view, frames in enumerate(boxes["frames"]) for row in tracked(view, boxes, int(frames), steps[view])
    ]
    seconds = time.process_time() - begin
    view, frame, label, box = zip(*rows, strict=True) if rows else ((), (), (), np.zeros((0, 4)))
    np.savez(out, view=np.int64(view), frame=np.int64(frame), label=np.int64(label), box=np.reshape(box, (-1, 4)))
    print(json.dumps({"seconds": seconds, "version": version(package)}))


if __name__ == "__main__":
    main(*sys.argv[1:])
